"""The pages of the studies, and what all of them have."""

from collections.abc import Sequence

from ..._version import __version__
from ...study.runs import Claim
from ..page import KeyNumber, ReportPage, ReportTable, Section

_WORDS = {True: "yes", False: "no", None: "too few runs"}


def study_page(
    title: str, subject: str, claims: Sequence[Claim], key_numbers: tuple[KeyNumber, ...], sections: Sequence[Section]
) -> ReportPage:
    """Return the page of a study; its verdict says whether all claims hold."""
    whole = all(claim.holds for claim in claims)
    table = ReportTable(
        "Expected and found",
        ("Holds", "Claim", "Expected", "Found"),
        tuple((_WORDS[c.holds], *map(_fine, (c.claim, c.expected, c.found))) for c in claims),
        prose=True,
        stacked=True,
    )
    return ReportPage(
        title=title,
        subject=subject,
        verdict="pass" if whole else "warn",
        headline=_headline([claim.holds for claim in claims]),
        key_numbers=key_numbers,
        findings=(),
        sections=(Section("claims", "Claims", blocks=(table,)), *sections),
        footer=f"Made by gnomon {__version__}. This file needs no network and no other file.",
    )


def _headline(held: Sequence[bool | None]) -> str:
    if all(held):
        return f"All {len(held)} claims hold."
    open_ones = f"; {count} cannot be told from so few runs" if (count := held.count(None)) else ""
    return f"{held.count(True)} of {len(held)} claims hold{open_ones}."


def _fine(text: str) -> str:
    return text.replace("m/s^2", "m/s²")
