"""PX4's ULog, as its documentation describes it (docs.px4.io, "ULog File Format", version 1).

`sensor_accel` and `sensor_gyro` hold what the sensors read; `sensor_combined` holds it with PX4's own calibration
applied, and is what PX4 logs at the full rate unless the logging profile asks for more.
"""

import struct
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import RecordingError
from ...progress import tell_read
from ...recording import Integers, TemperatureSamples
from ..files import file_source, first_bytes
from ..samples.table import Triad
from .device_log import DeviceLog, StampedTriad

MAGIC = b"ULog\x01\x12\x35"
_HEADER_BYTES, _TELL_BYTES = 16, 1 << 20
_DATA = ord("D")
_TYPES = {
    "int8_t": "i1", "uint8_t": "u1", "int16_t": "<i2", "uint16_t": "<u2", "int32_t": "<i4", "uint32_t": "<u4",
    "int64_t": "<i8", "uint64_t": "<u8", "float": "<f4", "double": "<f8", "bool": "?", "char": "S1",
}  # fmt: skip
_LEAST_HZ = 20.0
_CALIBRATED = "with PX4's own calibration applied; set SDLOG_PROFILE to log the raw sensors at their full rate"


@dataclass(slots=True)
class _Topic:
    """One instance of a topic: its format, and where its messages are in the file."""

    name: str
    instance: int
    places: list[int] = field(default_factory=list[int])
    size: int = 0


def is_ulog(path: Path) -> bool:
    """Tell whether a file is a ULog."""
    return path.is_file() and path.stat().st_size > 0 and first_bytes(path, 8).startswith(MAGIC)


def read_ulog(path: Path) -> DeviceLog:
    """Read accelerometer, gyroscope and magnetometer of the first IMU.

    Raises
    ------
    RecordingError
        If the log is damaged at its beginning, or holds no accelerometer and no gyroscope.
    """
    log = _Log(path)
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
        applied = f", {_CALIBRATED}" if name == "sensor_combined" else ""
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


class _Log:
    """The formats and the places of messages in a ULog."""

    def __init__(self, path: Path) -> None:
        self.name, self.data = path.name, path.read_bytes()
        self.formats: dict[str, list[tuple[str, int, str]]] = {}
        self.topics: dict[int, _Topic] = {}
        self.end, self.damaged = _HEADER_BYTES, False
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
        if kind in _TYPES:
            return np.dtype(_TYPES[kind]).itemsize
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
            if label in wanted and kind in _TYPES and place + size <= topic.size:
                names.append(label)
                kinds.append((_TYPES[kind], (count,)) if count > 1 else _TYPES[kind])
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
            t_ns, values = 1000 * rows["timestamp"].astype(np.int64), rows["temperature"].astype(np.float64)
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
        t_us = rows["timestamp_sample" if "timestamp_sample" in known else "timestamp"].astype(np.int64)
        if fields == ("accelerometer_m_s2",) and extra in known:
            t_us = t_us + rows[extra].astype(np.int64)
        values = np.column_stack([rows[one].astype(np.float64) for one in fields])
        good = np.isfinite(values).all(axis=1)
        if fields == ("accelerometer_m_s2",) and extra in known:
            good &= rows[extra] != np.iinfo(np.int32).max  # no accelerometer sample with this one
        return (1000 * t_us[good], np.ascontiguousarray(values[good])) if good.sum() > 1 else None
