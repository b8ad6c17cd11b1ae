"""What the pages of calibrations of any kind have in common."""

from collections.abc import Iterable

from ..calibration import Calibration
from .page import KeyNumber, Page, Section, typeset
from .wording import HEADLINES


def calibration_page(
    title: str, calibration: Calibration, key_numbers: tuple[KeyNumber, ...], sections: Iterable[Section | None]
) -> Page:
    """Return the page of a calibration; sections that there is nothing to say in are None."""
    made_by = calibration.provenance.gnomon_version
    return Page(
        title=title,
        subject=", ".join(source.name for source in calibration.provenance.inputs) or "recording from memory",
        verdict=calibration.verdict,
        headline=HEADLINES[calibration.verdict],
        key_numbers=key_numbers,
        findings=tuple(typeset(f) for f in calibration.assessment.findings if f.code != "assumed"),
        sections=tuple(section for section in sections if section is not None),
        footer=f"Made by gnomon {made_by}. This file needs no network and no other file.",
    )
