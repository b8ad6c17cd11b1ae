"""Logs of autopilots: PX4's ULog and ArduPilot's DataFlash, each of which says itself how its messages are built.

ULog after its documentation (docs.px4.io, "ULog File Format", version 1): `sensor_accel` and `sensor_gyro` hold what
the sensors read; `sensor_combined` holds it with PX4's own calibration applied, and is what PX4 logs at the full rate
unless the logging profile asks for more.

DataFlash, binary (.bin) and as text (.log), after ArduPilot's documentation of log messages and `LogStructure.h`: IMU
holds both triads with ArduPilot's own calibration applied; ACC and GYR, logged where INS_RAW_LOG_OPT or LOG_BITMASK ask
for raw samples, hold them at the sensors' rate; MAG is in milligauss. Fields: m/s^2, rad/s.
"""

import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import RecordingError
from ...progress import tell_read
from ...recording import Floats, Integers, TemperatureSamples
from ..files import file_source
from ..samples.table import Triad
from .device_log import DATAFLASH_MAGIC, DeviceLog, StampedTriad

_ULOG_HEADER_BYTES = 16
_DATA = ord("D")
_ULOG_TYPES = {
    "int8_t": "i1", "uint8_t": "u1", "int16_t": "<i2", "uint16_t": "<u2", "int32_t": "<i4", "uint32_t": "<u4",
    "int64_t": "<i8", "uint64_t": "<u8", "float": "<f4", "double": "<f8", "bool": "?", "char": "S1",
}  # fmt: skip
_LEAST_HZ = 20.0
_PX4_CALIBRATED = "with PX4's own calibration applied; set SDLOG_PROFILE to log the raw sensors at their full rate"


@dataclass(slots=True)
class _Topic:
    """One instance of a topic: its format, and where its messages are in the file."""

    name: str
    instance: int
    places: list[int] = field(default_factory=list[int])
    size: int = 0


def read_ulog(path: Path) -> DeviceLog:
    """Read accelerometer, gyroscope and magnetometer of the first IMU.

    Raises
    ------
    RecordingError
        If the log is damaged at its beginning, or holds no accelerometer and no gyroscope.
    """
    log = _Ulog(path)
    notes = [f"{path.name}: the log is cut off or damaged from byte {log.end} on."] if log.damaged else []
    triads: dict[str, StampedTriad] = {}
    for quantity, unit, topics in (
        ("accelerometer", "m/s^2", (("sensor_accel", ("x", "y", "z")), ("sensor_combined", ("accelerometer_m_s2",)))),
        ("gyroscope", "rad/s", (("sensor_gyro", ("x", "y", "z")), ("sensor_combined", ("gyro_rad",)))),
        ("magnetometer", "gauss", (("sensor_mag", ("x", "y", "z")), ("vehicle_magnetometer", ("magnetometer_ga",)))),
    ):
        found = [(name, triad) for name, fields in topics if (triad := log.triad(name, fields)) is not None]
        slow = [item for item in found if quantity != "magnetometer" and _rate_hz(item[1][0]) < _LEAST_HZ]
        best = next((item for item in found if item not in slow), None) or next(iter(found), None)
        if best is None:
            continue
        name, (t_ns, values) = best
        triads[quantity] = (t_ns, Triad(quantity=quantity, values=values, unit=unit))
        applied = f", {_PX4_CALIBRATED}" if name == "sensor_combined" else ""
        notes.append(f"{path.name}: {name} is the {quantity}{applied}.")
    if "accelerometer" not in triads and "gyroscope" not in triads:
        raise RecordingError(
            f"{path.name}: this ULog holds none of sensor_combined, sensor_accel and sensor_gyro; it holds "
            f"{', '.join(sorted({topic.name for topic in log.topics.values()}))[:300] or 'no data'}. Log them "
            "(SDLOG_PROFILE)."
        )
    temperature = log.temperature()
    return DeviceLog(**triads, temperature=temperature, sources=(file_source(path),), notes=tuple(notes))


def _rate_hz(t_ns: Integers) -> float:
    span = float(t_ns[-1] - t_ns[0]) * 1e-9
    return (len(t_ns) - 1) / span if span > 0 else 0.0


class _Ulog:
    """The formats and the places of messages in a ULog."""

    def __init__(self, path: Path) -> None:
        self.name, self.data = path.name, path.read_bytes()
        self.formats: dict[str, list[tuple[str, int, str]]] = {}
        self.topics: dict[int, _Topic] = {}
        self.end, self.damaged = _ULOG_HEADER_BYTES, False
        self._scan()

    def _scan(self) -> None:
        data, total, end = self.data, len(self.data), self.end
        read_header, told = struct.Struct("<HB").unpack_from, 0
        while end + 3 <= total:
            if end >= told:
                tell_read(self.name, end, total)
                told = end + _TELL_BYTES
            size, kind = read_header(data, end)
            begin = end + 3
            if begin + size > total:
                break
            if kind == _DATA and size > 2:
                topic = self.topics.get(data[begin] | data[begin + 1] << 8)
                if topic is not None and (not topic.size or topic.size == size - 2):
                    topic.size = size - 2
                    topic.places.append(begin + 2)
            elif kind == ord("F"):
                self._format(data[begin : begin + size])
            elif kind == ord("A") and size > 3:
                topic = _Topic(name=data[begin + 3 : begin + size].decode("ascii", "replace"), instance=data[begin])
                self.topics[data[begin + 1] | data[begin + 2] << 8] = topic
            end = begin + size
        self.end = end
        self.damaged = self.end != total

    def _format(self, text: bytes) -> None:
        name, _, fields = text.decode("ascii", "replace").partition(":")
        parsed: list[tuple[str, int, str]] = []
        for item in fields.split(";"):
            kind, _, label = item.partition(" ")
            kind, _, count = kind.partition("[")
            if kind and label:
                number = count.rstrip("]")
                parsed.append((kind, int(number) if number.isdigit() else 1, label))
        self.formats[name] = parsed

    def _size(self, kind: str, depth: int = 0) -> int:
        if kind in _ULOG_TYPES:
            return np.dtype(_ULOG_TYPES[kind]).itemsize
        if depth > 8 or kind not in self.formats:
            raise RecordingError(f"{self.name}: the ULog names the type {kind[:40]}, which it does not define.")
        return sum(count * self._size(inner, depth + 1) for inner, count, _ in self.formats[kind])

    def _rows(self, topic: _Topic, wanted: set[str]) -> NDArray[Any] | None:
        """Return the wanted fields of all messages of a topic as a structured array; None where one is not there."""
        names: list[str] = []
        kinds: list[Any] = []
        offsets: list[int] = []
        place = 0
        for kind, count, label in self.formats.get(topic.name, []):
            size = count * self._size(kind)
            if label in wanted - {*names} and kind in _ULOG_TYPES and place + size <= topic.size:
                names.append(label)
                kinds.append((_ULOG_TYPES[kind], (count,)) if count > 1 else _ULOG_TYPES[kind])
                offsets.append(place)
            place += size
        dtype = np.dtype({"names": names, "formats": kinds, "offsets": offsets, "itemsize": topic.size})
        raw = b"".join([self.data[place : place + topic.size] for place in topic.places])
        return np.frombuffer(raw, dtype)

    def temperature(self) -> TemperatureSamples | None:
        """Return what the thermometer of the first accelerometer or gyroscope read; None where it is not logged."""
        for name in ("sensor_accel", "sensor_gyro"):
            topics = [topic for topic in self.topics.values() if topic.name == name and len(topic.places) > 1]
            rows = (
                self._rows(min(topics, key=lambda one: one.instance), {"timestamp", "temperature"}) if topics else None
            )
            if rows is None or set(rows.dtype.names or ()) != {"timestamp", "temperature"}:
                continue
            good = np.isfinite(rows["temperature"])
            t_ns, values = _stamps_ns(rows["timestamp"], 1000, self.name), _floats(rows["temperature"])
            if good.sum() > 1:
                return TemperatureSamples(t_ns=t_ns[good], values=values[good], unit="degC")
        return None

    def triad(self, name: str, fields: tuple[str, ...]) -> tuple[Integers, NDArray[np.float64]] | None:
        """Return timestamps [ns] and values (n, 3) of the first instance of a topic; None where it is not there."""
        topics = [topic for topic in self.topics.values() if topic.name == name and len(topic.places) > 1]
        if not topics:
            return None
        topic = min(topics, key=lambda one: one.instance)
        extra = "accelerometer_timestamp_relative"
        rows = self._rows(topic, {"timestamp", "timestamp_sample", extra, *fields})
        known = () if rows is None else rows.dtype.names or ()
        if rows is None or "timestamp" not in known or any(one not in known for one in fields):
            return None
        t_ns = _stamps_ns(rows["timestamp_sample" if "timestamp_sample" in known else "timestamp"], 1000, self.name)
        if fields == ("accelerometer_m_s2",) and extra in known:
            t_ns = t_ns + _stamps_ns(rows[extra], 1000, self.name)
        values = np.column_stack([_floats(rows[one]) for one in fields])
        good = np.isfinite(values).all(axis=1)
        if fields == ("accelerometer_m_s2",) and extra in known:
            good &= rows[extra] != np.iinfo(np.int32).max  # no accelerometer sample with this one
        return (t_ns[good], np.ascontiguousarray(values[good])) if good.sum() > 1 else None


def _floats(values: NDArray[Any]) -> Floats:
    with np.errstate(invalid="ignore"):  # damaged bytes may be a NaN that signals
        return values.astype(np.float64)


def _stamps_ns(values: NDArray[Any], unit_ns: int, name: str) -> Integers:
    """Return timestamps (n,) in nanoseconds; a RecordingError where a damaged log has something else there."""
    most = np.iinfo(np.int64).max // unit_ns
    if values.ndim != 1 or values.dtype.kind not in "iu" or (values > most).any() or (values < -most).any():
        raise RecordingError(f"{name}: its timestamps are not whole numbers that a clock can show. Is it damaged?")
    return values.astype(np.int64) * unit_ns


_START, _FMT, _FMT_BYTES, _TELL_BYTES = DATAFLASH_MAGIC[:2], 128, 89, 1 << 20
_DATAFLASH_TYPES = {
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
_ARDUPILOT_CALIBRATED = (
    "with ArduPilot's own calibration (INS_...) applied; log raw IMU samples (LOG_BITMASK) for the sensor's"
)


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
        kinds = [_DATAFLASH_TYPES[letter] for letter in self.formats]
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


def read_dataflash(path: Path) -> DeviceLog:
    """Read accelerometer, gyroscope and magnetometer of the first IMU.

    Raises
    ------
    RecordingError
        If the log holds no accelerometer and no gyroscope.
    """
    data, notes = path.read_bytes(), list[str]()
    messages, skipped = _binary(data, path.name) if data.startswith(DATAFLASH_MAGIC) else (_text(data), 0)
    if skipped:
        notes.append(f"{path.name}: {skipped} bytes are damaged and were left out.")
    triads: dict[str, StampedTriad] = {}
    tables = {name: kept.table() for name, kept in messages.items() if kept.raw or kept.rows}
    for quantity, (unit, names, axes) in _SENSORS.items():
        best = next(
            ((name, found) for name in names if (found := _triad(tables.get(name), axes, path.name)) is not None), None
        )
        if best is None:
            continue
        name, (t_ns, values) = best
        triads[quantity] = (t_ns, Triad(quantity=quantity, values=values, unit=unit))
        notes.append(f"{path.name}: {name} is the {quantity}{', ' + _ARDUPILOT_CALIBRATED if name == 'IMU' else ''}.")
    if "accelerometer" not in triads and "gyroscope" not in triads:
        raise RecordingError(
            f"{path.name}: this log of ArduPilot holds no messages IMU, ACC and GYR. Let LOG_BITMASK include IMU."
        )
    temperature = _temperature(tables.get("IMU"), path.name)
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
            names = columns.split(",")
            whole = _size(formats) == body[1] - 3 and len(names) == len(formats)
            if label in _WANTED and body[0] not in wanted and whole:
                wanted[body[0]] = found[label] = _Messages(names, formats)
        elif (kept := wanted.get(kind)) is not None:
            kept.raw.append(data[place + 3 : place + size])
        place += size
    return found, skipped


def _size(formats: str) -> int:
    """Return the bytes of a message's fields; 0 where a type is not known."""
    kinds = [_DATAFLASH_TYPES.get(letter) for letter in formats]
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


def _triad(table: dict[str, NDArray[Any]] | None, axes: tuple[str, ...], log: str) -> tuple[Integers, Floats] | None:
    """Return timestamps [ns] and values (n, 3) of the first instance; None where there are none."""
    if table is None or any(axis not in table for axis in axes):
        return None
    stamps = next((name for name in ("SampleUS", "TimeUS", "TimeMS") if name in table), None)
    if stamps is None:
        return None
    values = np.column_stack([_floats(table[axis]) for axis in axes])
    first = table["I"] == 0 if "I" in table else np.ones(len(values), bool)
    good = first & np.isfinite(values).all(axis=1)
    t_ns = _stamps_ns(table[stamps], 1_000_000 if stamps == "TimeMS" else 1000, log)
    return (t_ns[good], np.ascontiguousarray(values[good])) if good.sum() > 1 else None


def _temperature(table: dict[str, NDArray[Any]] | None, log: str) -> TemperatureSamples | None:
    """Return what the thermometer of the first IMU read [degC]; None where it is not logged."""
    if table is None or not {"T", "TimeUS"} <= table.keys():
        return None
    values = _floats(table["T"])
    good = np.isfinite(values) & (table["I"] == 0 if "I" in table else True)
    t_ns = _stamps_ns(table["TimeUS"], 1000, log)
    return TemperatureSamples(t_ns=t_ns[good], values=values[good], unit="degC") if good.sum() > 1 else None
