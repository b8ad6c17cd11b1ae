"""Logs of phones: which app wrote them, told by their tables and headers.

Sensor Logger (Kelvin Choi) and phyphox (RWTH Aachen) write a table for each sensor, into a folder or a zip. Apps that
write all sensors into one table need no reader of their own: its header names them.
"""

from dataclasses import replace
from pathlib import Path

from ...errors import RecordingError
from ..samples.recognise import HELP
from ..samples.table import read_temperature_table
from .device_log import DeviceLog
from .phone_files import LogFiles, log_files, zipfile_at
from .phone_phyphox import is_phyphox, read_phyphox
from .phone_sensor_logger import is_sensor_logger, read_sensor_logger


def is_phone_log(path: Path) -> bool:
    """Tell whether a folder, a zip or a table is what one of the apps wrote; every zip of tables is taken for one."""
    try:
        files = log_files(path)
    except RecordingError:  # opening it says what is wrong
        return path.suffix.lower() != ".npz"
    except OSError:
        return False
    if files is None:
        return False
    return zipfile_at(path) or is_sensor_logger(files) or is_phyphox(files)


def _with_temperature(log: DeviceLog, files: LogFiles) -> DeviceLog:
    """Return the log with the readings of a thermometer in a table of its own, such as that of the battery."""
    for name in files.names:
        if "temp" not in files.head(name).partition("\n")[0].lower():
            continue
        label = name.rsplit("/", 1)[-1]
        try:
            read = read_temperature_table(files.text(name))
        except RecordingError as error:
            return replace(log, notes=(*log.notes, f"{label}: its temperatures are left out ({error})."))
        if read is not None:
            note = f"{label}: temperatures of the phone, whose IMU follows with a lag of its own."
            sources = tuple(dict.fromkeys((*log.sources, *files.sources([name]))))
            return replace(log, temperature=read, sources=sources, notes=(*log.notes, note))
    return log


def read_phone_log(path: Path) -> DeviceLog:
    """Read the log of a phone.

    Raises
    ------
    RecordingError
        If it is damaged, comes from no app that is known, or holds nothing to calibrate.
    """
    files = log_files(path)
    if files is None:
        raise RecordingError(f"{path.name}: there are no tables in it.")
    if is_sensor_logger(files):
        return _with_temperature(read_sensor_logger(files), files)
    if is_phyphox(files):
        return _with_temperature(read_phyphox(files), files)
    listed = ", ".join(files.names[:6]) + (", ..." if len(files.names) > 6 else "")
    raise RecordingError(
        f"{path.name}: the tables in this zip ({listed}) are neither those of Sensor Logger nor of phyphox. Unpack it "
        f"and give the table, or those of accelerometer and gyroscope. {HELP}"
    )
