"""phyphox of RWTH Aachen: a table for each sensor, "Time (s)" and "Acceleration x (m/s^2)", ..., from one start.

Exports are a table alone, or a zip of them with meta/device.csv and meta/time.csv; separators are commas, semicolons or
tabs, with decimal point or comma. "Linear Acceleration" is without gravity.
"""

import re
from pathlib import PurePosixPath

from ...errors import RecordingError
from ...units import Units
from ..samples.table import read_table
from .device_log import DeviceLog, StampedTriad
from .phone_files import LogFiles, zipfile_at

_TIME = re.compile(r'^"?Time \(s\)"?[,;\t]')
_LINEAR = re.compile(r'^"?Time \(s\)"?[,;\t]"?Linear Acceleration x ', re.IGNORECASE)
_SENSOR = re.compile(r'[,;\t]"?(?:linear acceleration|acceleration|gyroscope|magnetic field) x \(', re.IGNORECASE)
_ACCELERATION = re.compile(r'[,;\t]"?acceleration x \(', re.IGNORECASE)
_RECORD = 'Use the experiment "Acceleration with g", or one of your own that records accelerometer and gyroscope.'


def is_phyphox(files: LogFiles) -> bool:
    """Tell whether tables are those of phyphox: the first column is called Time (s), another names a sensor."""
    tables = _tables(files)
    if not tables or zipfile_at(files.path):
        return bool(tables)
    linear = [name for name in tables if _LINEAR.match(files.head(name))]
    accelerometers = [name for name in tables if name not in linear and _ACCELERATION.search(files.head(name))]
    # A table with gravity needs no reader of its own, and several of them are poses.
    return len(accelerometers) <= 1 and (files.path.is_dir() or len(linear) == 1)


def read_phyphox(files: LogFiles) -> DeviceLog:
    """Read accelerometer, gyroscope and magnetometer of a recording; those that are there.

    Raises
    ------
    RecordingError
        If there is no acceleration with gravity, a sensor stands in several tables, or a table is damaged.
    """
    tables = _tables(files)
    linear = [name for name in tables if _LINEAR.match(files.head(name))]
    found: dict[str, StampedTriad] = {}
    read: list[str] = []
    notes: list[str] = []
    for name in (name for name in tables if name not in linear):
        table = read_table(files.text(name), None, None, Units())
        for triad in table.triads:
            if triad.quantity in found:
                raise RecordingError(
                    f"{files.path.name}: several tables hold the {triad.quantity}, one of them {name}. Leave one there."
                )
            found[triad.quantity] = (table.t_ns, triad)
            notes.append(f"{PurePosixPath(name).name}: it holds the {triad.quantity}.")
        notes += [note for note in table.notes if "time in s" not in note]
        read.append(name)
    if "accelerometer" not in found and (linear or "magnetometer" not in found):
        there = f"{linear[0]} is without gravity, which tells nothing of scale and axes." if linear else ""
        raise RecordingError(
            f"{files.path.name}: found no acceleration with gravity. {there} {_RECORD}".replace("  ", " ")
        )
    if linear:
        notes.append(f"{PurePosixPath(linear[0]).name}: without gravity, and left out.")
    return DeviceLog(
        accelerometer=found.get("accelerometer"),
        gyroscope=found.get("gyroscope"),
        magnetometer=found.get("magnetometer"),
        sources=files.sources(read),
        notes=tuple(notes),
    )


def _tables(files: LogFiles) -> list[str]:
    return [name for name in files.names if _TIME.match(head := files.head(name)) and _SENSOR.search(head)]
