"""Numbers as a person reads them: digits that mean something, a unit, a sigma; and round ones along a scale."""

from collections.abc import Sequence
from math import ceil, floor, isfinite, log10

import numpy as np

from ..findings import share_words
from ..recording import Floats

MISSING = "–"
"""Shown where there is no number."""
_SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
_PREFIXES = (("", 1.0), ("m", 1e3), ("µ", 1e6), ("n", 1e9))


def power_of_ten(exponent: int) -> str:
    """Return "10⁻⁷" for -7."""
    return f"10{str(exponent).translate(_SUPERSCRIPT)}"


def number_text(value: float, digits: int = 4, *, trim: bool = True) -> str:
    """Return a number with so many significant digits, a true minus sign and powers of ten where they are shorter.

    Zeros at the end are dropped unless `trim` is False, as in columns that are compared.

    Examples
    --------
    >>> number_text(414.8721), number_text(-2.5e-7), number_text(float("nan"))
    ('414.9', '−2.5·10⁻⁷', '–')
    """
    if not isfinite(value):
        return MISSING
    if value == 0:
        return "0"
    if 1e-4 <= abs(value) < 1e7:
        decimals = max(0, digits - 1 - floor(log10(abs(value))))
        text = f"{value:.{decimals}f}"
        text = text.rstrip("0").rstrip(".") if trim and "." in text else text
    else:
        mantissa, exponent = f"{value:.{digits - 1}e}".split("e")
        mantissa = mantissa.rstrip("0").rstrip(".") if "." in mantissa else mantissa
        power = power_of_ten(int(exponent))
        text = power if mantissa == "1" else f"-{power}" if mantissa == "-1" else f"{mantissa}·{power}"
    return text.replace("-", "−")


def fixed_text(value: float, decimals: int, *, sign: bool = False) -> str:
    """Return a number with so many decimals and a true minus sign."""
    if not isfinite(value):
        return MISSING
    rounded = round(value, decimals) + 0.0  # no minus zero
    return f"{rounded:{'+' if sign else ''}.{decimals}f}".replace("-", "−")


def percent_text(value: float) -> str:
    """Return a share of one in percent; the space does not break."""
    return share_words(value).replace(" %", "\u00a0%")


def with_sigma(value: float, sigma: float, *, sign: bool = False) -> tuple[str, str]:
    """Return value and sigma to the second significant digit of sigma.

    A sigma of zero (a value that is fixed) or nan gives an empty second text.

    Examples
    --------
    >>> with_sigma(414.87213, 0.0614)
    ('414.872', '0.061')
    >>> with_sigma(-1.234e-5, 2.1e-7)
    ('−1.234·10⁻⁵', '0.021·10⁻⁵')
    """
    if not isfinite(value):
        return MISSING, ""
    largest = max(abs(value), sigma) if isfinite(sigma) else abs(value)
    power = floor(log10(largest)) if largest > 0 and not 1e-3 <= largest < 1e7 else 0
    tail = f"·{power_of_ten(power)}" if power else ""
    if not (isfinite(sigma) and sigma > 0):
        return (f"+{number_text(value, 6)}" if sign and value > 0 else number_text(value, 6)), ""
    decimals = min(max(0, power + 1 - floor(log10(sigma))), 12)
    scale = 10.0**-power
    return fixed_text(value * scale, decimals, sign=sign) + tail, fixed_text(sigma * scale, decimals) + tail


def si_prefix(largest: float) -> tuple[str, float]:
    """Return the SI prefix and the factor with which a quantity as large as this reads well.

    Examples
    --------
    >>> si_prefix(0.0025)
    ('m', 1000.0)
    """
    if not (isfinite(largest) and largest > 0):
        return _PREFIXES[0]
    return next((p for p in _PREFIXES if largest * p[1] >= 0.5), _PREFIXES[-1])


def quantity_text(value: float, unit: str, digits: int = 3) -> str:
    """Return a number with its unit and a fitting SI prefix, such as "2.65 mrad"; the space does not break."""
    if not isfinite(value):
        return MISSING
    prefix, factor = si_prefix(abs(value)) if value else ("", 1.0)
    return f"{number_text(value * factor, digits, trim=False)}\u00a0{prefix}{unit}"


def positive_or(value: float, otherwise: float = 1.0) -> float:
    """Return a value that is finite and above zero as it is, and another number in place of any other."""
    return float(value) if isfinite(value) and value > 0 else otherwise


def finite_values(values: Floats) -> Floats:
    """Return the finite values, flat."""
    array = np.asarray(values, dtype=np.float64).ravel()
    return array[np.isfinite(array)]


def finite_rms(values: Floats) -> float:
    """Return the root mean square of the finite values; nan without any."""
    kept = finite_values(values)
    return float(np.sqrt(np.mean(kept * kept))) if kept.size else float("nan")


def largest_magnitude(values: Floats) -> float:
    """Return the largest magnitude of the finite values; nan without any."""
    kept = finite_values(values)
    return float(np.max(np.abs(kept))) if kept.size else float("nan")


def highest_finite(values: Floats, otherwise: float = 0.0) -> float:
    """Return the highest of the finite values; another number without any."""
    kept = finite_values(values)
    return float(kept.max()) if kept.size else otherwise


def estimate_text(value: float, sigma: float, *, sign: bool = False) -> str:
    """Return a value with its sigma, where it has one, such as "414.872 ± 0.061"."""
    text, spread = with_sigma(value, sigma, sign=sign)
    return f"{text} ± {spread}" if spread else text


_PRINTED = (
    ("^2", "²"),
    ("^3", "³"),
    ("sqrt(Hz)", "√Hz"),
    ("sqrt(h)", "√h"),
    ("deg/", "°/"),
    ("uT", "µT"),
    ("ug", "µg"),
)


def readable_unit(unit: str) -> str:
    """Return a unit as it is printed, such as "m/s²" for "m/s^2"."""
    for plain, printed in _PRINTED:
        unit = unit.replace(plain, printed)
    return {"deg": "°", "us": "µs"}.get(unit, unit)


_MAGNITUDES = {"m/s^2": ("m/s²", 1.0), "rad/s": ("rad/s", 1.0), "uT": ("T", 1e-6)}
"""Unit of a record -> unit that takes an SI prefix, and what one of the former is in the latter."""


def magnitude_unit(largest: float, si_unit: str) -> tuple[str, float]:
    """Return the unit with a prefix that suits values as large as this, and the factor to it from the record's unit.

    Examples
    --------
    >>> magnitude_unit(0.002, "m/s^2"), magnitude_unit(48.0, "uT"), magnitude_unit(0.01, "")
    (('mm/s²', 1000.0), ('µT', 1.0), ('% of the field', 100.0))
    """
    if si_unit not in _MAGNITUDES:
        return "% of the field", 100.0
    unit, base = _MAGNITUDES[si_unit]
    prefix, factor = si_prefix(largest * base)
    return f"{prefix}{unit}", float(f"{factor * base:.12g}")


def magnitude_text(value: float, si_unit: str, digits: int = 3) -> str:
    """Return a value of a record as text with its unit, such as "2.65 mrad/s" or "1.23 %"."""
    if not isfinite(value):
        return MISSING
    if si_unit not in _MAGNITUDES:
        return f"{number_text(100 * value, digits, trim=False)}\u00a0%"
    unit, base = _MAGNITUDES[si_unit]
    return quantity_text(value * base, unit, digits)


_STEPS = (1.0, 2.0, 2.5, 5.0)


class Scale:
    """Numbers along one direction of a panel.

    Attributes
    ----------
    low, high : numbers at its two ends; the second may be the smaller one
    logarithmic : whether equal lengths are equal ratios
    ticks : numbers that are marked; None for round ones
    most : how many intervals there are between round ticks at most
    whole : whether round ticks are integers
    labelled : whether ticks have labels
    grid : whether lines are drawn across the panel at the ticks
    timed : whether they are seconds since the recording began, so that figures are zoomed together
    """

    def __init__(self, start: float, length: float, most: int) -> None:
        self.low, self.high = 0.0, 1.0
        self.logarithmic = False
        self.ticks: Sequence[float] | None = None
        self.most = most
        self.whole = False
        self.labelled = True
        self.grid = False
        self.timed = False
        self._start, self._length = start, length

    def span(self, low: float, high: float) -> None:
        """Let the panel reach from one number to another."""
        self.low, self.high = float(low), float(high)

    def places(self, values: Floats) -> Floats:
        """Return where numbers (...,) are drawn [figure units]; nan where a logarithm has no place for them."""
        low, high = self.low, self.high
        if self.logarithmic:
            values, low, high = np.log10(np.where(values > 0, values, np.nan)), log10(low), log10(high)
        return self.shares((values - low) / ((high - low) or 1.0))

    def shares(self, values: Floats) -> Floats:
        """Return where shares (...,) of the panel's length are drawn [figure units]."""
        return self._start + values * self._length

    def marks(self) -> list[tuple[float, str]]:
        """Return the ticks within the panel: where they are drawn, and their labels."""
        ticks, labels = self.ticks_within()
        return list(zip(self.places(ticks).tolist(), labels, strict=True))

    def ticks_within(self) -> tuple[Floats, list[str]]:
        """Return the ticks within the panel as numbers of the scale (n,), and their labels."""
        low, high = sorted((self.low, self.high))
        ticks = self.ticks
        if ticks is None:
            ticks = (
                decade_ticks(low, high) if self.logarithmic else round_numbers(low, high, self.most, whole=self.whole)
            )
        margin = 1e-9 * (high - low)
        inside = np.array([tick for tick in ticks if low - margin <= tick <= high + margin])
        return inside, list(map(self._label, inside.tolist()))

    def _label(self, tick: float) -> str:
        if not self.logarithmic:
            return number_text(tick, 6)
        return number_text(tick, 3) if 1e-4 < tick < 1e4 else power_of_ten(round(log10(tick)))


def round_numbers(low: float, high: float, most: int, *, whole: bool = False) -> Sequence[float]:
    """Return the round numbers of a span, in the smallest steps that make so many intervals at most.

    Steps are 1, 2, 2.5 and 5 times a power of ten; `whole` leaves out those that are no integers, and 2.5 times. Where
    there would not be two numbers, smaller steps are taken.
    """
    least = (high - low) / most
    if not (isfinite(least) and least > 0):
        return ()
    power = floor(log10(least))
    steps = [step * 10.0**k for k in (power - 1, power, power + 1) for step in _STEPS]
    if whole:
        steps = [step * 10.0**k for k in range(max(power, 0) + 2) for step in _STEPS if step != 2.5]
    wanted = next(i for i, step in enumerate(steps) if step >= least * (1 - 1e-9))
    ticks: list[float] = []
    for step in reversed(steps[: wanted + 1]):
        ticks = [k * step for k in range(ceil(low / step - 1e-9), floor(high / step + 1e-9) + 1)]
        if len(ticks) > 1:
            break
    return ticks


def decade_ticks(low: float, high: float, most: int = 6) -> Sequence[float]:
    """Return the powers of ten of a span, or so many of them at equal distances."""
    first, last = ceil(log10(low) - 1e-9), floor(log10(high) + 1e-9)
    return [10.0**k for k in range(first, last + 1, max(1, -(-(last - first) // (most - 1))))]
