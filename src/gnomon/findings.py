"""What was noticed: a fact, what follows from it, and what to do about it.

The texts are those of the catalogue, `findings.yaml`; code gives facts, and `make_finding` fills them in.
"""

import re
from collections.abc import Mapping, Sequence
from functools import cache
from math import pi
from pathlib import Path
from string import Formatter
from typing import Any, Literal

from .frozen import value_class

Severity = Literal["good", "info", "warning", "problem"]
"""good: checked and fine; info: good to know; warning: the result suffers; problem: the result cannot be used."""


@value_class(eq=True)
class Finding:
    """One thing noticed about a recording or a result.

    Attributes
    ----------
    severity : "good", "info", "warning" or "problem"
    code : a stable name in kebab-case, for programs and for the documentation; "assumed" marks what a reader had to
        take for granted
    message : what was found and where, with numbers and units
    consequence : what follows for the calibration; may be empty
    cure : the next step, in plain words; may be empty
    subject : what it is about, as a path: a sensor or a parameter of it, such as "cam0.line_delay"; empty for all of it
    follows_from : code of the finding that is its cause; empty where it stands for itself
    """

    severity: Severity
    code: str
    message: str
    consequence: str = ""
    cure: str = ""
    subject: str = ""
    follows_from: str = ""

    def __str__(self) -> str:
        return " ".join(part for part in (self.message, self.consequence, self.cure) if part)

    @property
    def label(self) -> str:
        """The code, to be looked up; of a warning also whether the sigmas leave its error out."""
        beyond = self.severity == "warning" and self.code in _beyond_sigmas()
        return f"{self.code}, not in the sigmas" if beyond else self.code


CATALOGUE = Path(__file__).with_suffix(".yaml")

_SCALED = re.compile("(%|m|u|deg)?(.*)", re.DOTALL)
_SCALE = {"%": 100, "m": 1e3, "u": 1e6, "deg": 180 / pi}


class _Template(Formatter):
    """Texts whose numbers may be shown in other units: {share:%.0f}, {shift_s:m.2g} for ms, {angle_rad:deg.1f}."""

    def format_field(self, value: Any, format_spec: str) -> str:
        scale, spec = _SCALED.fullmatch(format_spec).groups()  # pyright: ignore[reportOptionalMemberAccess]
        return format(_SCALE[scale] * value if scale else value, spec)


_TEMPLATE = _Template()


def read_catalogue() -> list[dict[str, Any]]:
    """Return the catalogue of findings in its order; its first lines say what the keys mean."""
    return _parsed(CATALOGUE.read_text(encoding="utf-8"))


def _parsed(text: str) -> list[dict[str, Any]]:
    import yaml

    return yaml.load(text, getattr(yaml, "CSafeLoader", yaml.SafeLoader))


@cache
def _entries() -> dict[str, str]:
    """Return the entry of each code as it is written: of hundreds a recording needs a few."""
    parts = re.split("^- code: ", CATALOGUE.read_text(encoding="utf-8"), flags=re.MULTILINE)[1:]
    return {
        part.partition("\n")[0].strip(): f"- code: {re.split('^- ', part, flags=re.MULTILINE)[0]}" for part in parts
    }


@cache
def _beyond_sigmas() -> set[str]:
    """Return the codes of warnings whose error the sigmas do not hold."""
    return {key.partition("/")[0] for key, entry in _entries().items() if "\n  in_sigmas: false\n" in entry}


@cache
def _template(key: str) -> dict[str, Any]:
    return _parsed(_entries()[key])[0]


def make_finding(
    key: str, /, *, severity: Severity | None = None, case: str | tuple[str, ...] = "", **facts: object
) -> Finding:
    """Return the finding of the catalogue with these facts in its texts; a good one has no consequence and no cure.

    Parameters
    ----------
    key : the code, and after a slash which variant of its texts
    severity : None for that of the catalogue
    case : which of several texts holds, where the catalogue has several; else that of "else", or none
    facts : what the texts name
    """
    entry = _template(key)
    cases = (case,) if isinstance(case, str) else case
    texts = {name: _text(entry.get(name, ""), cases, facts) for name in ("message", "consequence", "cure", "subject")}
    graded: Severity = severity or entry["severity"]
    if graded == "good":
        texts["consequence"] = texts["cure"] = ""
    return Finding(severity=graded, code=key.partition("/")[0], **texts)


def _text(template: str | Mapping[str, str], cases: tuple[str, ...], facts: Mapping[str, object]) -> str:
    if not isinstance(template, str):
        template = next((template[case] for case in (*cases, "else") if case in template), "")
    return _TEMPLATE.vformat(template, (), facts).strip()


_STEERING = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u200e\u200f\u202a-\u202e\u2066-\u2069]")
"""Control characters but tab and new line, and those that turn the direction of writing."""


def printable_text(text: str) -> str:
    """Return a text in which characters that steer a terminal are shown as escapes; files bring them in names."""
    return re.sub(_STEERING, lambda match: match[0].encode("unicode_escape").decode("ascii"), text)


def join_names(names: Sequence[str], last: str = "and") -> str:
    """Return names as a list in a sentence.

    Examples
    --------
    >>> join_names(["kalibr", "openvins", "basalt"], "or")
    'kalibr, openvins or basalt'
    """
    return f"{', '.join(names[:-1])} {last} {names[-1]}" if len(names) > 1 else "".join(names)


def list_first(names: Sequence[str], most: int = 6, between: str = ", ") -> str:
    """Return the first names, and how many more there are.

    Examples
    --------
    >>> list_first(["x", "y", "z"], 2)
    'x, y and 1 more'
    """
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return between.join(names[:most]) + more


def share_words(share: float) -> str:
    """Return a share of one in percent; only the whole is 100 %, and only nothing is 0 %.

    Examples
    --------
    >>> share_words(0.997), share_words(1.0), share_words(0.43), share_words(0.002)
    ('> 99 %', '100 %', '43 %', '< 1 %')
    """
    if 0.995 <= share < 1:
        return "> 99 %"
    return "< 1 %" if 0 < share < 0.005 else f"{100 * share:.0f} %"
