"""Logs of the field, written as their public documentation or code writes them, of one motion that is known."""

import struct
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from phone_logs import G, motion

COUNT, STEP_S = 800, 0.02


@dataclass(frozen=True)
class Samples:
    """Time [s], specific force [m/s^2], angular rate [rad/s] and field [uT] of a sensor that rests and turns."""

    t: np.ndarray
    force: np.ndarray
    rate: np.ndarray
    field: np.ndarray

    @property
    def counts(self):
        """Return accelerometer at 16384 LSB/g and gyroscope at 131 LSB/(deg/s)."""
        return np.rint(self.force / G * 16384).astype(int), np.rint(np.degrees(self.rate) * 131).astype(int)


def samples():
    t, force, rate = motion(COUNT, STEP_S)
    return Samples(t, force, rate, force / G * 48.0 + 3.0)


def clock(seconds, hour=12):
    whole = int(seconds)
    return f"{hour + whole // 3600:02d}:{whole // 60 % 60:02d}:{seconds % 60:06.3f}"


def lines(path: Path, line, *head: str) -> Path:
    """Write a line for each sample, given its index."""
    path.write_text("\n".join([*head, *(line(i) for i in range(COUNT))]) + "\n", encoding="utf-8")
    return path


def numbers(*parts, form="%.6f", separator=","):
    return separator.join(form % x for part in parts for x in np.atleast_1d(part))


def ulog(path: Path, truth: Samples, cut=0) -> Path:
    """Write a ULog of version 1: sensor_combined and sensor_mag, with a message of logging text between."""

    def message(kind, body):
        return struct.pack("<HB", len(body), ord(kind)) + body

    out = b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 0) + message("B", bytes(40))
    out += message(
        "F",
        b"sensor_combined:uint64_t timestamp;float[3] gyro_rad;uint32_t gyro_integral_dt;"
        b"int32_t accelerometer_timestamp_relative;float[3] accelerometer_m_s2;uint8_t[4] _padding0;",
    )
    out += message("F", b"sensor_mag:uint64_t timestamp;uint32_t device_id;float x;float y;float z;float temperature;")
    out += message("A", b"\0" + struct.pack("<H", 7) + b"sensor_combined")
    out += message("A", b"\0" + struct.pack("<H", 8) + b"sensor_mag")
    for i, t in enumerate(truth.t):
        us = round(t * 1e6) + 5_000_000
        gyro, accel = truth.rate[i].tolist(), truth.force[i].tolist()
        out += message("D", struct.pack("<HQ3fIi3f", 7, us, *gyro, 20_000, -1000, *accel))
        out += message("D", struct.pack("<HQI4f", 8, us, 1, *(truth.field[i] / 100).tolist(), 20.0))
        if i == 10:
            out += message("L", b"6" + struct.pack("<Q", us) + b"takeoff")
    path.write_bytes(out[: len(out) - cut])
    return path


_FMT = "BB4s16s64s"
_IMU = (172, "IMU", "QBffffff", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ")
_MAG = (173, "MAG", "QBhhh", "TimeUS,I,MagX,MagY,MagZ")


def dataflash(path: Path, truth: Samples, damage=b"") -> Path:
    """Write a DataFlash log in binary: FMT, IMU of two instances, MAG; `damage` goes between two messages."""

    def message(kind, body):
        return b"\xa3\x95" + bytes([kind]) + body

    sizes = {"Q": 8, "B": 1, "f": 4, "h": 2}
    out = message(128, struct.pack("<" + _FMT, 128, 89, b"FMT", b"BBnNZ", b"Type,Length,Name,Format,Columns"))
    for kind, name, formats, columns in (_IMU, _MAG):
        size = 3 + sum(sizes[letter] for letter in formats)
        out += message(128, struct.pack("<" + _FMT, kind, size, name.encode(), formats.encode(), columns.encode()))
    for i, t in enumerate(truth.t):
        us = round(t * 1e6)
        for instance in (0, 1):
            values = (1 - 2 * instance) * np.r_[truth.rate[i], truth.force[i]]
            out += message(172, struct.pack("<QB6f", us, instance, *values.tolist()))
        out += message(173, struct.pack("<QB3h", us, 0, *np.rint(truth.field[i] * 10).astype(int).tolist()))
        out += damage if i == 5 else b""
    path.write_bytes(out)
    return path


def dataflash_text(path: Path, truth: Samples) -> Path:
    """Write the same log as text, as Mission Planner and mavlogdump convert it."""
    head = ["FMT, 128, 89, FMT, BBnNZ, Type,Length,Name,Format,Columns", f"FMT, 172, 36, IMU, {_IMU[2]}, {_IMU[3]}"]
    rows = [
        f"IMU, {round(t * 1e6)}, 0, {numbers(w, f, form='%.7g', separator=', ')}\nMODE, {round(t * 1e6)}, STABILIZE"
        for t, w, f in zip(truth.t, truth.rate, truth.force, strict=True)
    ]
    path.write_text("\n".join([*head, *rows]) + "\n")
    return path
