"""Tables that say above them, or by their name, what their numbers mean: Gyroflow, Empatica's E4, NovAtel's RAWIMU.

Gyroflow's .gcsv states a scale for the time and for each sensor (docs.gyroflow.xyz, "gcsv format"). ACC.csv of the E4
begins with a row of the time and one of the rate, and counts 1/64 g (support.empatica.com, "Data export and
formatting"). NovAtel's RAWIMU logs hold z, minus y and x as increments over a sample, behind a CRC (docs.novatel.com,
OEM7, RAWIMU, RAWIMUS, RAWIMUX, RAWIMUSX).
"""

import re
import zlib
from collections.abc import Callable
from dataclasses import replace
from math import log10
from pathlib import Path

import numpy as np

from ...errors import RecordingError
from ...units import Units
from ..files import TextFile, first_bytes, read_text_file
from ..samples.table import Triad, read_table
from .device_log import DeviceLog, StampedTriad

_HEAD_BYTES = 65_536
_GYROFLOW = re.compile(rb"(?:GYROFLOW|CAMERA) IMU LOG\s")
_SCALE = re.compile(rb"^([tgam]scale),([-+.\deE]+)\s*$", re.MULTILINE)
_SCALED = {"gyroscope": (b"gscale", "rad/s"), "accelerometer": (b"ascale", "g"), "magnetometer": (b"mscale", "gauss")}
_POWERS = {0: "s", -3: "ms", -6: "us", -9: "ns"}
_E4 = re.compile(rb"(\d{9,10}(?:\.0*)?), *\1, *\1\s*\n(\d{1,3}(?:\.0*)?), *\2, *\2\s*\n(?:-?\d{1,3}, *){2}-?\d{1,3}\s")
_E4_PER_G = 64.0
_RAWIMU = re.compile(
    rb"[#%](RAWIMUS?X?A,[^;\n]*;(?:[0-9a-fA-F]+,\d+,)?(\d{1,5}),(\d{1,6})\.(\d{1,9}),[0-9a-fA-F]+"
    + rb",(-?\d{1,10})" * 6
    + rb")\*([0-9a-fA-F]{8})"
)
_WEEK_NS = 604_800_000_000_000
_FULL_CRC = 0xFFFFFFFF


def is_stated_log(path: Path) -> bool:
    """Tell whether a file is one of them, by its first lines."""
    return path.is_file() and path.stat().st_size > 0 and _reader(first_bytes(path, _HEAD_BYTES)) is not None


def read_stated_log(path: Path) -> DeviceLog:
    """Read what its table holds, in the units that it states.

    Raises
    ------
    RecordingError
        If the table is damaged, or states a scale that is none.
    """
    file = read_text_file(path)
    reader = _reader(file.data[:_HEAD_BYTES])
    if reader is None:
        raise RecordingError(f"{path.name}: its first lines do not say what it holds.")
    return reader(file)


def _reader(head: bytes) -> Callable[[TextFile], DeviceLog] | None:
    if _GYROFLOW.match(head) and _SCALE.search(head):
        return _read_gyroflow
    if _E4.match(head):
        return _read_e4
    return _read_rawimu if _RAWIMU.search(head) else None


def _read_gyroflow(file: TextFile) -> DeviceLog:
    scales: dict[bytes, float] = {}
    for name, text in _SCALE.findall(file.data[:_HEAD_BYTES]):
        try:
            scales[name] = float(text)
        except ValueError:
            scales[name] = 0.0
        if not 0.0 < scales[name] < 1e9:
            raise RecordingError(f"{file.name}: found {name.decode()} {text.decode()}, expected a positive number.")
    per_s = scales.get(b"tscale", 0.001)
    power = min(_POWERS, key=lambda power: abs(power - log10(per_s)))
    start = re.search(rb"^t,", file.data, re.MULTILINE)
    if start is None:
        raise RecordingError(f"{file.name}: found no line with the names of the columns (t,gx,gy,gz,...).")
    header, _, rows = file.data[start.start() :].partition(b"\n")
    names = (f"t [{_POWERS[power]}]", *header.decode("utf-8", errors="replace").strip().split(",")[1:])
    table = read_table(replace(file, data=rows, header=names), None, None, Units())
    t_ns = np.rint(table.t_ns * (per_s / 10.0**power)).astype(np.int64)
    found: dict[str, StampedTriad] = {}
    for triad in table.triads:
        key, unit = _SCALED.get(triad.quantity, (b"", ""))
        scaled = (
            Triad(quantity=triad.quantity, values=triad.values * scales[key], unit=unit) if key in scales else triad
        )
        found[triad.quantity] = (t_ns, scaled)
    stated = ", ".join(f"{name.decode()} {value:g}" for name, value in scales.items())
    note = f"{file.name}: scaled as it states ({stated}); axes are those of the sensor, whatever `orientation` says."
    return _log(file, found, note)


def _read_e4(file: TextFile) -> DeviceLog:
    began, rate, rows = file.data.split(b"\n", 2)
    names = ("ax [count]", "ay [count]", "az [count]")
    rate_hz = float(rate.split(b",")[0])
    if rate_hz <= 0.0:
        raise RecordingError(f"{file.name}: found a rate of {rate_hz:g} Hz in its second row, expected a positive one.")
    table = read_table(replace(file, data=rows, header=names), None, rate_hz, Units())
    t_ns = table.t_ns + int(float(began.split(b",")[0]) * 1e9)
    triad = Triad(quantity="accelerometer", values=table.triads[0].values / _E4_PER_G, unit="g")
    return _log(file, {"accelerometer": (t_ns, triad)}, f"{file.name}: accelerometer of an E4, {rate_hz:g} Hz, 1/64 g.")


def _read_rawimu(file: TextFile) -> DeviceLog:
    t_ns: list[int] = []
    rows: list[tuple[int, ...]] = []
    damaged = 0
    for match in _RAWIMU.finditer(file.data):
        text, week, second, fraction, *counts, crc = match.groups()
        if zlib.crc32(text, _FULL_CRC) ^ _FULL_CRC != int(crc, 16):
            damaged += 1
            continue
        t_ns.append(int(week) * _WEEK_NS + int(second) * 10**9 + int(fraction.ljust(9, b"0")))
        rows.append(tuple(map(int, counts)))
    if len(rows) < 2:
        raise RecordingError(
            f"{file.name}: found {len(rows)} RAWIMU lines with a right checksum; a recording has many."
        )
    stamps = np.array(t_ns, np.int64)
    values = np.array(rows, float)[:, [2, 1, 0, 5, 4, 3]] * ((1.0, -1.0, 1.0) * 2)
    found: dict[str, StampedTriad] = {
        name: (stamps, Triad(quantity=name, values=values[:, place : place + 3].copy(), unit="count"))
        for name, place in (("accelerometer", 0), ("gyroscope", 3))
    }
    lost = f"; {damaged} lines with a wrong checksum were left out" if damaged else ""
    return _log(file, found, f"{file.name}: increments over a sample, in counts, turned into x, y, z{lost}.")


def _log(file: TextFile, found: dict[str, StampedTriad], note: str) -> DeviceLog:
    return DeviceLog(
        accelerometer=found.get("accelerometer"),
        gyroscope=found.get("gyroscope"),
        magnetometer=found.get("magnetometer"),
        sources=(file.source,),
        notes=(note,),
    )
