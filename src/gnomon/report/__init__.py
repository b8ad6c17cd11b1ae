"""Calibration and diagnostics -> one self-contained HTML file.

page.py is the design, the same for every kind of calibration; imu.py says what an IMU calibration puts on it.
"""

import os
from contextlib import suppress
from pathlib import Path

from ..diagnostics import Result
from ..errors import OutputError


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

    _replace(Path(path), render(imu_page(result)))


def _replace(path: Path, content: bytes) -> None:
    """Put a whole file in the place of `path`, or leave everything as it is."""
    try:
        target = path.resolve()
        temporary = target.with_name(f".{target.name}.{os.urandom(4).hex()}.part")
        try:
            temporary.write_bytes(content)
            temporary.replace(target)
        except BaseException:
            with suppress(OSError):
                temporary.unlink()
            raise
    except OSError as error:
        raise OutputError(
            f"{path}: the report cannot be written ({error.strerror or error}). Choose another place."
        ) from error
