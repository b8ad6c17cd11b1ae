"""What the report of a verification says: the page of page.py, filled from a Verification."""

from pathlib import Path

from .._version import __version__
from ..assess.comparison.verification import Verification
from ..output import write_whole
from .certificate.tables import certificate_tables
from .page import KeyNumber, Prose, ReportPage, Section, render_page, typeset_finding


def write_verification_report(verification: Verification, path: str | Path, subject: str = "") -> None:
    """Write the report of a verification as one HTML file that needs neither network nor other files.

    Parameters
    ----------
    subject : what was verified, and by which recording

    Raises
    ------
    OutputError
        If the file cannot be written.
    """
    write_whole(path, render_page(verification_page(verification, subject)))


def verification_page(verification: Verification, subject: str = "") -> ReportPage:
    """Return the page of a verification; see `write_verification_report`."""
    untold = sum(one.state == "cannot tell" for one in verification.blocks)
    return ReportPage(
        title="Does the calibration still hold?",
        subject=subject or verification.use,
        verdict=verification.verdict,
        headline=verification.headline[:1].upper() + verification.headline[1:],
        key_numbers=(
            KeyNumber("Blocks", str(len(verification.blocks))),
            KeyNumber("Moved", str(len(verification.moved))),
            KeyNumber("Not told", str(untold), "a longer recording may tell" if untold else ""),
        ),
        findings=tuple(typeset_finding(finding) for finding in verification.findings),
        front=certificate_tables(verification),
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
                            *verification.notes,
                        )
                    )
                ],
            ),
        ),
        footer=f"Made by gnomon {__version__}. This file needs no network and no other file.",
    )
