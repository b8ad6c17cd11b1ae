"""The numbers of a report, as a reader sees them: every parameter wherever it stands, with sigma and unit."""

import re
from dataclasses import dataclass
from html.parser import HTMLParser
from math import degrees

_POWERS = str.maketrans("⁰¹²³⁴⁵⁶⁷⁸⁹⁻", "0123456789-")
_NUMBER = re.compile(r"[-+]?\d+(?:\.\d+)?(?:·10[⁰¹²³⁴⁵⁶⁷⁸⁹⁻]+)?|[-+]?10[⁰¹²³⁴⁵⁶⁷⁸⁹⁻]+")
_SI = {"mm": ("m", 1e-3), "ms": ("s", 1e-3), "µs": ("s", 1e-6), "°": ("rad", 1 / degrees(1)), "mrad": ("rad", 1e-3)}
_SI |= {"mrad/s per m/s²": ("rad/s per m/s²", 1e-3), "%": ("", 1e-2)}


@dataclass(frozen=True)
class Shown:
    """A number as it is printed: value and half of its last digit, sigma with the same, and unit, in SI."""

    where: str
    value: float
    half: float
    sigma: float
    sigma_half: float
    unit: str

    def agrees(self, other: "Shown") -> bool:
        """Tell whether both may be the same number, by their printed digits."""
        return (
            self.unit == other.unit
            and abs(self.value - other.value) <= 1.01 * (self.half + other.half)
            and (self.sigma > 0) == (other.sigma > 0)
            and abs(self.sigma - other.sigma) <= 1.01 * (self.sigma_half + other.sigma_half)
        )


def number(text: str) -> tuple[float, float]:
    """Return a printed number, and half of its last digit."""
    text = text.replace("−", "-").replace("+", "").strip()
    mantissa, _, power = text.partition("·10") if "·10" in text else (text, "", "")
    factor = 10.0 ** int(power.translate(_POWERS) or 0)
    decimals = len(mantissa.partition(".")[2])
    return float(mantissa) * factor, 0.5 * 10.0**-decimals * factor


def shown(where: str, value: str, sigma: str, unit: str) -> Shown | None:
    """Return a number of the page; None where there is none."""
    if not _NUMBER.fullmatch(value.replace("−", "-").strip()):
        return None
    told, factor = _SI.get(unit, (unit, 1.0))
    spread = number(sigma) if _NUMBER.fullmatch(sigma.replace("−", "-").strip()) else (0.0, 0.0)
    return Shown(where, *(factor * x for x in (*number(value), *spread)), told)


class Tables(HTMLParser):
    """The tables of a page: (headings above, rows of cells)."""

    def __init__(self, text: str) -> None:
        super().__init__(convert_charrefs=True)
        self.heads: list[str] = []
        self.tables: list[tuple[str, list[list[str]]]] = []
        self.words: list[str] | None = None
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        if tag in ("h2", "h3", "th", "td", "caption", "figcaption"):
            self.words = []
        elif tag == "table":
            self.tables.append((" / ".join(self.heads), []))
        elif tag == "tr" and self.tables:
            self.tables[-1][1].append([])

    def handle_endtag(self, tag):
        if self.words is None or tag not in ("h2", "h3", "th", "td"):
            return
        text = " ".join("".join(self.words).split())
        self.words = None
        if tag == "h2":
            self.heads = [text]
        elif tag == "h3":
            self.heads = [*self.heads[:1], text]
        elif self.tables and self.tables[-1][1]:
            self.tables[-1][1][-1].append(text)

    def handle_data(self, data):
        if self.words is not None:
            self.words.append(data)


def parameters_shown(page: str) -> list[tuple[str, str, Shown]]:
    """Return (table, name, number) of every parameter of the tables of parameters, and of the table of all scalars."""
    found: list[tuple[str, str, Shown]] = []
    for heads, rows in Tables(page).tables:
        group = ""
        for row in rows[1:]:
            if len(row) == 1:
                group = row[0]
            elif rows[0][:2] == ["Parameter", "Estimate ± σ"]:
                value, sigma, unit = _estimate(row[1])
                one = shown(heads, value, sigma, unit)
                found += [] if one is None else [(heads, f"{group} | {row[0]}", one)]
            elif rows[0] == ["parameter", "value", "σ", "start", "prior σ", "unit", "status"]:
                one = shown(heads, row[1], row[2], row[5])
                found += [] if one is None else [("every parameter", row[0], one)]
    return found


def _estimate(cell: str) -> tuple[str, str, str]:
    """Return value, sigma and unit of a cell such as "1.25 ± 0.03 mm"."""
    value, _, rest = cell.partition(" ")
    sigma, _, unit = rest.removeprefix("± ").partition(" ") if rest.startswith("± ") else ("", "", rest)
    return value, sigma, unit
