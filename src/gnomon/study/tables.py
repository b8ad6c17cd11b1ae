"""What a study found, as tables of numbers that any program reads."""

import csv
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from io import StringIO

Cell = str | int | float | bool


@dataclass(frozen=True, slots=True, kw_only=True)
class StudyTable:
    """One table; its name is that of its file, its head says the units."""

    name: str
    head: tuple[str, ...]
    rows: Sequence[tuple[Cell, ...]]

    def csv(self) -> str:
        """Return the table as CSV, floating-point numbers with all their digits."""
        text = StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(self.head)
        writer.writerows([repr(float(cell)) if isinstance(cell, float) else cell for cell in row] for row in self.rows)
        return text.getvalue()


@dataclass(frozen=True, slots=True, kw_only=True)
class Claim:
    """Something that a document says or that gnomon promises, and what the study found.

    Attributes
    ----------
    claim : in words
    expected : what it would be if it held
    found : what it was
    holds : whether it does
    """

    claim: str
    expected: str
    found: str
    holds: bool


def claims_table(claims: Iterable[Claim]) -> StudyTable:
    """Return the claims of a study as a table."""
    return StudyTable(
        name="claims",
        head=("claim", "expected", "found", "holds"),
        rows=[(one.claim, one.expected, one.found, one.holds) for one in claims],
    )
