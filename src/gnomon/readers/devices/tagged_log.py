"""Tables in which each row says which sensor it is of: GNSS Logger of Android, RealSense's rs-convert, long tables.

GNSS Logger names the columns of each kind of row in a comment (`# UncalAccel,utcTimeMillis,...`), rs-convert above each
block, long tables (`timestamp,sensor,x,y,z`) once.
"""

from dataclasses import replace
from pathlib import Path

from ...errors import RecordingError
from ...frozen import value_class
from ...units import Units
from ..files import TextFile, first_bytes, read_text_file
from ..samples.column_names import column_name
from ..samples.table import read_table
from ..samples.text_table import is_number
from .device_log import DeviceLog, StampedTriad

_HEAD_BYTES = 65_536
_DELIMITERS = ",;\t"
_INERTIAL = {"accelerometer", "gyroscope"}
_TRIADS = {*_INERTIAL, "magnetometer"}


@value_class
class _Tags:
    """Which column says the sensor, and of each sensor what stands there."""

    delimiter: str
    column: int
    words: dict[str, str]


def is_tagged_log(path: Path) -> bool:
    """Tell whether a column of a text table names accelerometer and gyroscope in turn."""
    if not path.is_file():
        return False
    ends = first_bytes(path, _HEAD_BYTES)
    if b"\0" in ends:
        return False
    if len(ends) == _HEAD_BYTES:  # rs-convert writes one sensor after the other
        with path.open("rb") as stream:
            stream.seek(max(_HEAD_BYTES, path.stat().st_size - _HEAD_BYTES))
            ends = b"\n".join([ends.rpartition(b"\n")[0], stream.read().partition(b"\n")[2]])
    return _tags(ends.decode("utf-8", errors="replace").splitlines()) is not None


def read_tagged_log(path: Path) -> DeviceLog:
    """Read the rows of each sensor as a table of its own.

    Raises
    ------
    RecordingError
        If such a table cannot be read.
    """
    file = read_text_file(path)
    lines = file.data.decode("utf-8", errors="replace").splitlines()
    tags = _tags(lines)
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


def _tags(lines: list[str]) -> _Tags | None:
    """Return where rows say their sensor; of two kinds of rows of a sensor, the one that is not calibrated."""
    delimiter = max(_DELIMITERS, key=lambda mark: sum(line.count(mark) for line in lines[:200]))
    rows = [line.split(delimiter) for line in lines if line[:1] != "#"]
    rows = [row for row in rows if is_number(row[-1])]
    for column in range(max(map(len, rows), default=0) - 3):
        told = {row[column].strip(): None for row in rows if len(row) > column + 3 and row[column][:1].isalpha()}
        words: dict[str, str] = {}
        for word in told:
            quantity = column_name(f"{word} x").quantity
            if len(word) > 1 and quantity in _TRIADS and (quantity not in words or word.lower().startswith("uncal")):
                words[quantity] = word
        if words.keys() >= _INERTIAL:
            return _Tags(delimiter=delimiter, column=column, words=words)
    return None


def _rows_of(file: TextFile, lines: list[str], tags: _Tags, word: str) -> TextFile:
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
