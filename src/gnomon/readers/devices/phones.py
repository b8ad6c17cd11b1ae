"""Logs of phones: a table for each sensor, in a folder or a zip, of Sensor Logger and phyphox.

Apps that write all sensors into one table need no reader of their own: its header names them.

Sensor Logger of Kelvin Choi, for Android and iOS (github.com/tszheichoi/awesome-sensor-logger: README, UNITS,
COORDINATES, CROSSPLATFORM): `time` in nanoseconds, z, y, x. `Accelerometer` is without gravity, in m/s^2; `Gravity` in
m/s^2; `TotalAcceleration`, of Android only, is their sum. `AccelerometerUncalibrated` has gravity, on iOS in g unless
units were standardised. On iOS accelerations have the opposite sign, unless standardised: a phone that lies on its back
reads -1 g along z. Gyroscopes agree, in rad/s.

phyphox of RWTH Aachen: "Time (s)" and "Acceleration x (m/s^2)", ..., from one start. Exports are a table alone, or a
zip of them with meta/device.csv and meta/time.csv; separators are commas, semicolons or tabs, with decimal point or
comma. "Linear Acceleration" is without gravity.
"""

import csv
from dataclasses import replace
from pathlib import Path, PurePosixPath

import numpy as np

from ...errors import RecordingError
from ...recording import Floats, Integers
from ...units import Units
from ..samples.recognise import HELP, rest_magnitude
from ..samples.table import Triad, read_table, read_temperature_table
from .device_log import (
    SENSOR_LOGGER_NAMES,
    DeviceLog,
    LogFiles,
    StampedTriad,
    is_phyphox,
    is_sensor_logger,
    log_files,
    phyphox_tables,
)


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


_LARGEST_G = 3.0  # a rest that reads less is in g
_RECORD_UNCALIBRATED = (
    "Record the uncalibrated accelerometer and gyroscope (settings, logging of uncalibrated data), or on Android the "
    "total acceleration."
)


def read_sensor_logger(files: LogFiles) -> DeviceLog:
    """Read the rawest accelerometer with gravity, gyroscope and magnetometer that there are.

    Axes are those of Android: x to the right of the screen, y to its top, z out of it.

    Raises
    ------
    RecordingError
        If there is no accelerometer with gravity, or a table is damaged.
    """
    log = _SensorLogger(files)
    accelerometer = log.accelerometer()
    gyroscope = log.sensor("gyroscope")
    magnetometer = log.sensor("magnetometer")
    if accelerometer is None and (gyroscope is not None or magnetometer is None):
        raise RecordingError(f"{files.path.name}: found no accelerometer with gravity in it. {_RECORD_UNCALIBRATED}")
    return DeviceLog(
        accelerometer=accelerometer,
        gyroscope=gyroscope,
        magnetometer=magnetometer,
        sources=files.sources(log.read),
        notes=tuple(log.notes),
    )


class _SensorLogger:
    """The tables on the way to samples: what was read, and what is said of it."""

    def __init__(self, files: LogFiles) -> None:
        self.files = files
        self.read: list[str] = []
        self.notes: list[str] = []
        facts = _metadata(files)
        self.platform = facts.get("platform", "").lower()
        self.standard = facts.get("standardisation", "").lower() == "true"

    def sensor(self, quantity: str) -> StampedTriad | None:
        """Return the gyroscope [rad/s] or the magnetometer [uT]."""
        name = self.files.named(*SENSOR_LOGGER_NAMES[quantity])
        if name is None:
            return None
        t_ns, values = self.triad(name)
        self.note(name, f"it is the {quantity}.")
        return t_ns, Triad(quantity=quantity, values=values, unit="rad/s" if quantity == "gyroscope" else "uT")

    def accelerometer(self) -> StampedTriad | None:
        """Return the accelerometer with gravity: raw, as Android gives it, or put together."""
        name = self.files.named(*SENSOR_LOGGER_NAMES["accelerometer"])
        if name is None:
            return self._put_together()
        t_ns, values = self.triad(name)
        in_g = rest_magnitude(values) < _LARGEST_G
        self.note(name, f"it is the accelerometer, with gravity, in {'g' if in_g else 'm/s^2'}.")
        if in_g:
            values = -values
            self.note(name, "turned round: iOS gives accelerations the opposite sign.")
        return t_ns, Triad(quantity="accelerometer", values=values, unit="g" if in_g else "m/s^2")

    def _put_together(self) -> StampedTriad | None:
        without, gravity = self.files.named("accelerometer"), self.files.named("gravity")
        if without is None:
            return None
        if gravity is None:
            raise RecordingError(
                f"{self.files.path.name}: {without} is without gravity, which tells nothing of scale and axes, and "
                f"there is no table Gravity beside it. {_RECORD_UNCALIBRATED}"
            )
        t_ns, values = self.triad(without)
        t_gravity_ns, pull = self.triad(gravity)
        both = (t_ns >= t_gravity_ns[0]) & (t_ns <= t_gravity_ns[-1])
        if both.sum() < 2:
            raise RecordingError(f"{self.files.path.name}: {without} and {gravity} share no time.")
        t_ns, values = t_ns[both], values[both]
        at, known = t_ns - t_ns[0], t_gravity_ns - t_ns[0]
        total = values + np.column_stack([np.interp(at, known, axis) for axis in pull.T])
        turned = "ios" in self.platform and not self.standard
        self.note(
            without,
            f"it is the accelerometer, with what {gravity} says added. The phone has split and filtered both, so this "
            f"calibrates the phone's software along with its sensor. {_RECORD_UNCALIBRATED}",
        )
        if not self.platform:
            self.note(
                without, "no Metadata.csv says whether this is Android, as was assumed; iOS has the opposite sign."
            )
        elif turned:
            self.note(without, "turned round: iOS gives accelerations the opposite sign.")
        return t_ns, Triad(quantity="accelerometer", values=-total if turned else total, unit="m/s^2")

    def triad(self, name: str) -> tuple[Integers, Floats]:
        """Return timestamps and values of a table, without the rows that stand in it twice."""
        table = read_table(self.files.text(name), None, None, Units())
        self.read.append(name)
        if len(table.triads) != 1:
            raise RecordingError(f"{name}: expected the columns time, seconds_elapsed, z, y, x.")
        self.notes += [note for note in table.notes if "time in ns" not in note]
        t_ns, values = table.t_ns, table.triads[0].values
        again = np.flatnonzero((np.diff(t_ns) == 0) & (np.diff(values, axis=0) == 0).all(axis=1)) + 1
        if len(again):
            self.note(name, f"{len(again)} rows stand in it twice and were left out once.")
            t_ns, values = np.delete(t_ns, again), np.delete(values, again, axis=0)
        return t_ns, values

    def note(self, name: str, text: str) -> None:
        self.notes.append(f"{name.rsplit('/', 1)[-1]}: {text}")


def _metadata(files: LogFiles) -> dict[str, str]:
    """Return what Metadata.csv says, a row of names and a row of values."""
    name = files.named("metadata")
    rows = list(csv.reader(files.head(name).splitlines())) if name is not None else []
    return dict(zip(rows[0], rows[1], strict=False)) if len(rows) > 1 else {}


_RECORD_WITH_G = (
    'Use the experiment "Acceleration with g", or one of your own that records accelerometer and gyroscope.'
)


def read_phyphox(files: LogFiles) -> DeviceLog:
    """Read accelerometer, gyroscope and magnetometer of a recording; those that are there.

    Raises
    ------
    RecordingError
        If there is no acceleration with gravity, a sensor stands in several tables, or a table is damaged.
    """
    tables, linear = phyphox_tables(files)
    found: dict[str, StampedTriad] = {}
    read: list[str] = []
    notes: list[str] = []
    for name in tables:
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
            f"{files.path.name}: found no acceleration with gravity. {there} {_RECORD_WITH_G}".replace("  ", " ")
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
