"""What a study found, as tables of numbers that any program reads."""

import csv
from collections.abc import Iterable, Sequence
from io import StringIO

from ..frozen import value_class
from ..recording import Floats
from .runs import scatter_bounds

Cell = str | int | float | bool


@value_class(eq=True)
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


@value_class(eq=True)
class Claim:
    """Something that a document says or that gnomon promises, and what the study found.

    Attributes
    ----------
    claim : in words
    expected : what it would be if it held
    found : what it was
    holds : whether it does; None where there are too few runs to tell
    """

    claim: str
    expected: str
    found: str
    holds: bool | None


_TELLING = 2.0
"""Bounds tell something while a number that is wrong by this factor would lie outside."""


def ratio_agrees(inside: bool, least: float, most: float) -> bool | None:
    """Return whether a ratio whose right value is 1 agrees with its bounds, as `Claim.holds`.

    Few runs need wide bounds because of chance. What lies inside of bounds that half or twice of the right value
    would satisfy as well says nothing; what lies outside is wrong however wide they are.

    Examples
    --------
    >>> ratio_agrees(True, 0.85, 1.15), ratio_agrees(True, 0.38, 24.0), ratio_agrees(False, 0.38, 24.0)
    (True, None, False)
    """
    return None if inside and (least <= 1 / _TELLING or most >= _TELLING) else inside


def sigmas_claim(claim: str, ratios: Floats, runs: int, where: str = "") -> Claim:
    """Return the claim that stated sigmas are those of the scatter of so many runs, to 15 % as far as they tell.

    Parameters
    ----------
    ratios : stated sigma over scatter, of every parameter
    where : of which parameters, in words
    """
    least, most = scatter_bounds(runs, 0.15)
    return Claim(
        claim=claim,
        expected=f"sigma over scatter {least:.2f} to {most:.2f}{where}",
        found=f"{ratios.min():.3f} to {ratios.max():.3f}",
        holds=ratio_agrees(bool(ratios.min() > least and ratios.max() < most), least, most),
    )


def claims_table(claims: Iterable[Claim]) -> StudyTable:
    """Return the claims of a study as a table."""
    return StudyTable(
        name="claims",
        head=("claim", "expected", "found", "holds"),
        rows=[(one.claim, one.expected, one.found, "" if one.holds is None else one.holds) for one in claims],
    )
