"""What was noticed: a fact, what follows from it, and what to do about it."""

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
    """

    severity: Severity
    code: str
    message: str
    consequence: str = ""
    cure: str = ""

    def __str__(self) -> str:
        return " ".join(part for part in (self.message, self.consequence, self.cure) if part)
