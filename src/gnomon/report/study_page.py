"""The page of a study: what it claims, and whether the runs agree; sections of figures and tables after that."""

from collections.abc import Sequence

from .._version import __version__
from ..study.tables import Claim
from .page import KeyNumber, Page, Section, Table


def study_page(
    title: str,
    subject: str,
    claims: Sequence[Claim],
    key_numbers: tuple[KeyNumber, ...],
    sections: Sequence[Section],
) -> Page:
    """Return the page of a study; its verdict says whether all claims hold."""
    kept = sum(claim.holds for claim in claims)
    whole = kept == len(claims)
    table = Table(
        title="Expected and found",
        head=("Holds", "Claim", "Expected", "Found"),
        rows=tuple(("yes" if c.holds else "no", *map(_fine, (c.claim, c.expected, c.found))) for c in claims),
        prose=True,
    )
    return Page(
        title=title,
        subject=subject,
        verdict="pass" if whole else "warn",
        headline=f"{'All' if whole else kept} {len(claims) if whole else f'of {len(claims)}'} claims hold.",
        key_numbers=key_numbers,
        findings=(),
        sections=(Section(anchor="claims", title="Claims", blocks=(table,)), *sections),
        footer=f"Made by gnomon {__version__}. This file needs no network and no other file.",
    )


def _fine(text: str) -> str:
    return text.replace("m/s^2", "m/s²")
