"""What was noticed: a fact, what follows from it, and what to do about it."""

import re
from dataclasses import dataclass
from typing import Literal

Severity = Literal["good", "info", "warning", "problem"]
"""good: checked and fine; info: good to know; warning: the result suffers; problem: the result cannot be used."""


@dataclass(frozen=True, slots=True, kw_only=True)
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


_STEERING = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u200e\u200f\u202a-\u202e\u2066-\u2069]")
"""Control characters but tab and new line, and those that turn the direction of writing."""


def printable(text: str) -> str:
    """Return a text in which characters that steer a terminal are shown as escapes; files bring them in names."""
    return re.sub(_STEERING, lambda match: match[0].encode("unicode_escape").decode("ascii"), text)


def listed(names: tuple[str, ...]) -> str:
    """Return names as a choice.

    Examples
    --------
    >>> listed(("kalibr", "openvins", "basalt"))
    'kalibr, openvins or basalt'
    """
    *first, last = names
    return f"{', '.join(first)} or {last}" if first else last
