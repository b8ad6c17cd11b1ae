"""Calibration and diagnostics -> one self-contained HTML file.

page.py is the design, the same for every kind of calibration; imu.py says what an IMU calibration puts on it.
"""

from pathlib import Path

from ..diagnostics import Result
from ..output import write_whole


def write_report(result: Result, path: str | Path) -> None:
    """Write the report of a calibration as one HTML file that needs neither network nor other files.

    The same result gives the same bytes. The file appears whole or not at all.

    Parameters
    ----------
    result : a calibration and how it came about
    path : file to write; an existing one is replaced

    Raises
    ------
    OutputError
        If the file cannot be written.
    """
    from .imu import imu_page
    from .page import render

    write_whole(path, render(imu_page(result)))
