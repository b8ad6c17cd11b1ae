"""ArduPilot's DataFlash logs, binary (.bin) and as text (.log); each says itself how its messages are built (FMT).

Read from ArduPilot's documentation of log messages and `LogStructure.h`: IMU holds both triads with ArduPilot's own
calibration applied; ACC and GYR, logged where INS_RAW_LOG_OPT or LOG_BITMASK ask for raw samples, hold them at the
sensors' rate; MAG is in milligauss. Fields: m/s^2, rad/s.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import RecordingError
from ...progress import tell_read
from ...recording import Floats, Integers, TemperatureSamples
from ..files import file_source, first_bytes
from ..samples.table import Triad
from .device_log import DeviceLog, StampedTriad

_START = b"\xa3\x95"
_FMT, _FMT_BYTES, _TELL_BYTES = 128, 89, 1 << 20
_TYPES = {
    "a": ("<i2", 32), "b": ("i1", 1), "B": ("u1", 1), "h": ("<i2", 1), "H": ("<u2", 1), "i": ("<i4", 1),
    "I": ("<u4", 1), "f": ("<f4", 1), "g": ("<f2", 1), "d": ("<f8", 1), "n": ("S4", 1), "N": ("S16", 1),
    "Z": ("S64", 1), "c": ("<i2", 1), "C": ("<u2", 1), "e": ("<i4", 1), "E": ("<u4", 1), "L": ("<i4", 1),
    "M": ("u1", 1), "q": ("<i8", 1), "Q": ("<u8", 1),
}  # fmt: skip
_SENSORS = {
    "accelerometer": ("m/s^2", ("ACC", "IMU"), ("AccX", "AccY", "AccZ")),
    "gyroscope": ("rad/s", ("GYR", "IMU"), ("GyrX", "GyrY", "GyrZ")),
    "magnetometer": ("mgauss", ("MAG",), ("MagX", "MagY", "MagZ")),
}
_WANTED = {"ACC", "GYR", "IMU", "MAG", "ACC1", "GYR1"}
_CALIBRATED = "with ArduPilot's own calibration (INS_...) applied; log raw IMU samples (LOG_BITMASK) for the sensor's"


@dataclass(slots=True)
class _Messages:
    """Messages of one name: their columns, dtype, and what is kept of them."""

    columns: list[str]
    formats: str
    raw: list[bytes] = field(default_factory=list[bytes])
    rows: list[list[str]] = field(default_factory=list[list[str]])

    def table(self) -> dict[str, NDArray[Any]]:
        """Return the columns of numbers."""
        if self.rows:
            width = len(self.columns)
            rows = [row for row in self.rows if len(row) == width]
            columns = zip(*rows, strict=True)
            return {name: _numbers(column) for name, column in zip(self.columns, columns, strict=True)}
        kinds = [_TYPES[letter] for letter in self.formats]
        fields = [(f"f{i}", kind, (count,)) if count > 1 else (f"f{i}", kind) for i, (kind, count) in enumerate(kinds)]
        dtype = np.dtype(fields)
        rows = np.frombuffer(b"".join(self.raw), dtype)
        return {name: rows[f"f{i}"] for i, name in enumerate(self.columns)}


def _numbers(column: tuple[str, ...]) -> NDArray[Any]:
    try:
        return np.array([int(token) for token in column], dtype=np.int64)
    except (ValueError, OverflowError):
        pass
    try:
        return np.array(column, dtype=np.float64)
    except ValueError:
        return np.full(len(column), np.nan)


def is_dataflash(path: Path) -> bool:
    """Tell whether a file is a DataFlash log, binary or text."""
    if not path.is_file() or not path.stat().st_size:
        return False
    head = first_bytes(path, 128)
    return (head.startswith(_START) and head[2] == _FMT) or head.lstrip().startswith((b"FMT, 128,", b"FMT,128,"))


def read_dataflash(path: Path) -> DeviceLog:
    """Read accelerometer, gyroscope and magnetometer of the first IMU.

    Raises
    ------
    RecordingError
        If the log holds no accelerometer and no gyroscope.
    """
    data, notes = path.read_bytes(), list[str]()
    messages, skipped = _binary(data, path.name) if data.startswith(_START) else (_text(data), 0)
    if skipped:
        notes.append(f"{path.name}: {skipped} bytes are damaged and were left out.")
    triads: dict[str, StampedTriad] = {}
    tables = {name: kept.table() for name, kept in messages.items() if kept.raw or kept.rows}
    for quantity, (unit, names, axes) in _SENSORS.items():
        best = next(((name, found) for name in names if (found := _triad(tables.get(name), axes)) is not None), None)
        if best is None:
            continue
        name, (t_ns, values) = best
        triads[quantity] = (t_ns, Triad(quantity=quantity, values=values, unit=unit))
        notes.append(f"{path.name}: {name} is the {quantity}{', ' + _CALIBRATED if name == 'IMU' else ''}.")
    if "accelerometer" not in triads and "gyroscope" not in triads:
        raise RecordingError(
            f"{path.name}: this log of ArduPilot holds no messages IMU, ACC and GYR. Let LOG_BITMASK include IMU."
        )
    temperature = _temperature(tables.get("IMU"))
    return DeviceLog(**triads, temperature=temperature, sources=(file_source(path),), notes=tuple(notes))


def _binary(data: bytes, name: str) -> tuple[dict[str, _Messages], int]:
    """Return the messages that are wanted, by name, and how many bytes were no message."""
    sizes: dict[int, int] = {_FMT: _FMT_BYTES}
    wanted: dict[int, _Messages] = {}
    found: dict[str, _Messages] = {}
    place, skipped, told, total = 0, 0, 0, len(data)
    while place + 3 <= total:
        if place >= told:
            tell_read(name, place, total)
            told = place + _TELL_BYTES
        size = sizes.get(data[place + 2], 0) if data[place : place + 2] == _START else 0
        if not size or place + size > total:
            following = data.find(_START, place + 1)
            following = total if following < 0 else following
            skipped += following - place
            place = following
            continue
        kind = data[place + 2]
        if kind == _FMT:
            body = data[place + 3 : place + size]
            label, formats, columns = (
                part.split(b"\0")[0].decode("ascii", "replace") for part in (body[2:6], body[6:22], body[22:86])
            )
            sizes[body[0]] = body[1]
            if label in _WANTED and body[0] not in wanted and _size(formats) == body[1] - 3:
                wanted[body[0]] = found[label] = _Messages(columns.split(","), formats)
        elif (kept := wanted.get(kind)) is not None:
            kept.raw.append(data[place + 3 : place + size])
        place += size
    return found, skipped


def _size(formats: str) -> int:
    """Return the bytes of a message's fields; 0 where a type is not known."""
    kinds = [_TYPES.get(letter) for letter in formats]
    return 0 if None in kinds else sum(np.dtype(kind[0]).itemsize * kind[1] for kind in kinds if kind is not None)


def _text(data: bytes) -> dict[str, _Messages]:
    found: dict[str, _Messages] = {}
    for row in _rows(data):
        if row[0] == "FMT" and len(row) > 5 and row[3] in _WANTED:
            found[row[3]] = _Messages(row[5:], row[4])
        elif (kept := found.get(row[0])) is not None:
            kept.rows.append(row[1:])
    return found


def _rows(data: bytes) -> Iterator[list[str]]:
    for line in data.splitlines():
        if line[:3] in {b"FMT", b"IMU", b"ACC", b"GYR", b"MAG"}:
            yield [token.strip() for token in line.decode("ascii", "replace").split(",")]


def _triad(table: dict[str, NDArray[Any]] | None, axes: tuple[str, ...]) -> tuple[Integers, Floats] | None:
    """Return timestamps [ns] and values (n, 3) of the first instance; None where there are none."""
    if table is None or any(axis not in table for axis in axes):
        return None
    stamps = next((name for name in ("SampleUS", "TimeUS", "TimeMS") if name in table), None)
    if stamps is None:
        return None
    values = np.column_stack([table[axis].astype(np.float64) for axis in axes])
    first = table["I"] == 0 if "I" in table else np.ones(len(values), bool)
    good = first & np.isfinite(values).all(axis=1)
    t_ns = table[stamps].astype(np.int64) * (1_000_000 if stamps == "TimeMS" else 1000)
    return (t_ns[good], np.ascontiguousarray(values[good])) if good.sum() > 1 else None


def _temperature(table: dict[str, NDArray[Any]] | None) -> TemperatureSamples | None:
    """Return what the thermometer of the first IMU read [degC]; None where it is not logged."""
    if table is None or not {"T", "TimeUS"} <= table.keys():
        return None
    values = table["T"].astype(np.float64)
    good = np.isfinite(values) & (table["I"] == 0 if "I" in table else True)
    t_ns = 1000 * table["TimeUS"].astype(np.int64)
    return TemperatureSamples(t_ns=t_ns[good], values=values[good], unit="degC") if good.sum() > 1 else None
