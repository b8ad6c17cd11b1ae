"""Calibration and diagnostics -> one self-contained HTML file.

page.py is the design, the same for every kind of calibration; static.py says what a calibration of one sensor puts on
it, camera_imu.py what a camera-IMU calibration does, cameras.py what one of cameras alone does.
"""

from pathlib import Path

from ..output import write_whole
from ..results.result import Result


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
    from .page import render_page
    from .plots import result_page

    write_whole(path, render_page(result_page(result)))
