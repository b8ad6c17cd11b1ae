"""Calibration and diagnostics -> one self-contained HTML file.

page.py is the design, the same for every kind of calibration; imu.py says what an IMU calibration puts on it,
camera_imu.py what a camera-IMU calibration does, cameras.py what one of cameras alone does, triads.py what a
calibration from known magnitudes does.
"""

from pathlib import Path

from ..diagnostics import CameraImuDiagnostics, CamerasDiagnostics, JoinedDiagnostics, Result
from ..output import write_whole
from ..triad_diagnostics import TriadDiagnostics


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
    from .page import render

    calibration, diagnostics = result.calibration, result.diagnostics
    if isinstance(diagnostics, CameraImuDiagnostics):
        from .camera_imu import camera_imu_page

        page = camera_imu_page(calibration, diagnostics)
    elif isinstance(diagnostics, CamerasDiagnostics):
        from .cameras import cameras_page

        page = cameras_page(calibration, diagnostics)
    elif isinstance(diagnostics, TriadDiagnostics):
        from .triads import triad_page

        page = triad_page(calibration, diagnostics)
    elif isinstance(diagnostics, JoinedDiagnostics):
        from .joined import joined_page

        page = joined_page(calibration, diagnostics)
    else:
        from .imu import imu_page

        page = imu_page(calibration, diagnostics)
    write_whole(path, render(page))
