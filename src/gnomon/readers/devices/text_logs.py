"""Tables that say what their rows or numbers are: Gyroflow, Empatica's E4, NovAtel's RAWIMU; sensors in turn.

Gyroflow's .gcsv states a scale for the time and for each sensor (docs.gyroflow.xyz, "gcsv format"). ACC.csv of the E4
begins with a row of the time and one of the rate, and counts 1/64 g (support.empatica.com, "Data export and
formatting"). NovAtel's RAWIMU logs hold z, minus y and x as increments over a sample, behind a CRC (docs.novatel.com,
OEM7, RAWIMU, RAWIMUS, RAWIMUX, RAWIMUSX).

In others each row says which sensor it is of: GNSS Logger of Android names the columns of each kind of row in a comment
(`# UncalAccel,utcTimeMillis,...`), RealSense's rs-convert above each block, long tables
(`timestamp,sensor,x,y,z`) once.
"""

import re
import zlib
from dataclasses import replace
from math import log10
from pathlib import Path

import numpy as np

from ...errors import RecordingError
from ...units import Units
from ..files import TextFile, read_text_file
from ..samples.column_names import column_name
from ..samples.table import Triad, read_table
from ..samples.text_table import is_number
from .device_log import (
    GYROFLOW_SCALE,
    HEAD_BYTES,
    RAWIMU,
    DeviceLog,
    SensorTags,
    StampedTriad,
    sensor_tags,
    stated_kind,
)

_SCALED = {"gyroscope": (b"gscale", "rad/s"), "accelerometer": (b"ascale", "g"), "magnetometer": (b"mscale", "gauss")}
_POWERS = {0: "s", -3: "ms", -6: "us", -9: "ns"}
_E4_PER_G = 64.0
_WEEK_NS = 604_800_000_000_000
_FULL_CRC = 0xFFFFFFFF


def read_stated_log(path: Path) -> DeviceLog:
    """Read what its table holds, in the units that it states.

    Raises
    ------
    RecordingError
        If the table is damaged, or states a scale that is none.
    """
    file = read_text_file(path)
    kind = stated_kind(file.data[:HEAD_BYTES])
    if not kind:
        raise RecordingError(f"{path.name}: its first lines do not say what it holds.")
    return {"gyroflow": _read_gyroflow, "e4": _read_e4, "rawimu": _read_rawimu}[kind](file)


def _read_gyroflow(file: TextFile) -> DeviceLog:
    scales: dict[bytes, float] = {}
    for name, text in GYROFLOW_SCALE.findall(file.data[:HEAD_BYTES]):
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
    for match in RAWIMU.finditer(file.data):
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


def read_tagged_log(path: Path) -> DeviceLog:
    """Read the rows of each sensor as a table of its own.

    Raises
    ------
    RecordingError
        If such a table cannot be read.
    """
    file = read_text_file(path)
    lines = file.data.decode("utf-8", errors="replace").splitlines()
    tags = sensor_tags(lines)
    if tags is None:
        raise RecordingError(f"{path.name}: no column names the sensors.")
    found: dict[str, StampedTriad] = {}
    notes: list[str] = []
    for quantity, word in tags.words.items():
        table = read_table(_rows_of(file, lines, tags, word), None, None, Units())
        found |= {triad.quantity: (table.t_ns, triad) for triad in table.triads if triad.quantity == quantity}
        notes += [f"{path.name}: rows of {word} are the {quantity}.", *table.notes]
    return DeviceLog(
        accelerometer=found.get("accelerometer"),
        gyroscope=found.get("gyroscope"),
        magnetometer=found.get("magnetometer"),
        sources=(file.source,),
        notes=tuple(notes),
    )


def _rows_of(file: TextFile, lines: list[str], tags: SensorTags, word: str) -> TextFile:
    """Return the rows of one sensor under the names of their columns."""
    split = [(line.lstrip("# "), line.lstrip("# ").split(tags.delimiter)) for line in lines]
    mine = [(line, row) for line, row in split if len(row) > tags.column and row[tags.column].strip() == word]
    data = [line for line, row in mine if is_number(row[-1])]
    width = len(data[0].split(tags.delimiter))
    named = [row for _, row in (*mine, *split) if len(row) == width and not any(map(is_number, row))]
    header = [_column(name.strip(), word) for name in named[0]] if named else []
    text = "\n".join(data) + "\n"
    return replace(file, name=f"{file.name} ({word})", data=text.encode(), header=tuple(header))


def _column(name: str, word: str) -> str:
    """Return the name of a column, with the sensor's where it is an axis alone: "3DOF_x" in rows of "Gyro"."""
    known = column_name(name).quantity
    axis = known == "unnamed" or (known == "other" and name[-2:].lower() in {"_x", "_y", "_z"})
    return f"{word} {name[-1]}" if axis else name
