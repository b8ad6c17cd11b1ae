"""Calibration -> the files of other projects."""

from importlib import import_module
from os import PathLike
from pathlib import Path

from ..calibration import Calibration
from ..errors import OptionError, OutputError
from ..output import write_whole
from .export import Export, Loss

FORMATS = {
    "imu_tk": "imu_tk",
    "kalibr": "kalibr",
    "openvins": "openvins",
    "basalt": "basalt",
    "imucal": "imucal",
    "c-header": "c_header",
    "csv": "parameter_csv",
}
"""Name of a format -> the module here that makes it."""


def convert(calibration: Calibration, to: str, directory: str | PathLike[str]) -> tuple[Loss, ...]:
    """Write a calibration in another project's format and return what that format cannot hold.

    Parameters
    ----------
    to : "imu_tk", "kalibr", "openvins", "basalt", "imucal", "c-header" or "csv"
    directory : made if it is not there; only the files of the format are written, each of them whole or not at all

    Raises
    ------
    OptionError
        If there is no such format, or its model cannot represent this sensor.
    OutputError
        If a file cannot be written.
    """
    export = exported(calibration, to)
    folder = Path(directory)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(
            f"{directory}: this folder cannot be made ({error.strerror or error}). Choose another one with -o."
        ) from error
    for name, text in export.files.items():
        write_whole(folder / name, text)
    return export.losses


def exported(calibration: Calibration, to: str) -> Export:
    """Return the texts of the files of another project's format, by name, without writing them.

    Raises
    ------
    OptionError
        If there is no such format, or its model cannot represent this sensor.
    """
    if to not in FORMATS:
        raise OptionError(f'"{to}" is no format to convert to. Choose one of: {", ".join(FORMATS)}.')
    module = import_module(f".{FORMATS[to]}", __package__)
    return module.export(calibration)
