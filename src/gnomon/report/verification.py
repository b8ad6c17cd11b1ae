"""What the report of a verification says: the page of page.py, filled from a Verification."""

from pathlib import Path

from .._version import __version__
from ..assess.comparison.verification import Verification, movement_words
from ..output import write_whole
from .page import KeyNumber, Prose, ReportPage, ReportTable, Section, render_page, typeset_finding


def write_verification_report(verification: Verification, path: str | Path) -> None:
    """Write the report of a verification as one HTML file that needs neither network nor other files.

    Raises
    ------
    OutputError
        If the file cannot be written.
    """
    write_whole(path, render_page(verification_page(verification)))


def verification_page(verification: Verification) -> ReportPage:
    """Return the page of a verification."""
    counts = {state: sum(one.state == state for one in verification.blocks) for state in ("moved", "cannot tell")}
    table = ReportTable(
        "Block by block",
        ("block", "moved by (1 σ)", "needed", "log10 p", ""),
        [movement_words(block) for block in verification.blocks],
        "By how much the recording finds each block elsewhere if all others hold, but those that moved. p: how "
        "probable it is to find it so far off, or farther, if it held.",
    )
    return ReportPage(
        title="Does the calibration still hold?",
        subject=verification.use,
        verdict=verification.verdict,
        headline=verification.headline,
        key_numbers=(
            KeyNumber("Blocks", str(len(verification.blocks))),
            KeyNumber("Moved", str(counts["moved"])),
            KeyNumber("Not told", str(counts["cannot tell"]), "a longer recording may tell"),
        ),
        findings=tuple(typeset_finding(finding) for finding in verification.findings),
        front=(table,),
        sections=(
            Section(
                "method",
                "How this was found",
                blocks=[
                    Prose(
                        (
                            "The same numbers were estimated from the fresh recording, and the difference was held "
                            "against the covariances of both. Each block was freed by itself (score test of Rao, "
                            "1948); the least probable one is taken as moved, and the others are asked again beside it "
                            "until none is certain, at one false alarm in a hundred calibrations that hold.",
                            "Biases are others after each switching-on: they count as moved only beyond what is usual.",
                            *verification.notes,
                        )
                    )
                ],
            ),
        ),
        footer=f"Made by gnomon {__version__}. This file needs no network and no other file.",
    )
