"""Logs as programs print them for people, made plain tables: labelled values, clocks in front, checksums behind.

Understood are lines such as `ax=0.1 ay=...`, `AcX = 1 | AcY = ...`, `a/g:<tab>12<tab>...`, `Accel X: 0.1, Y: ...` with
the gyroscope on the next line, JSON objects, `$VNIMU,...*6F`, what `ros2 topic echo` prints, and the clock that a
serial monitor puts before each line (`12:34:56.789 -> `) or a logger writes into a column (`2026-11-23 12:34:56.789`).
Each line stays a line, so that messages name the right one; what is no sample becomes an empty one.
"""

import io
import re
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import replace
from datetime import date
from functools import lru_cache
from itertools import pairwise

from ...errors import RecordingError
from ...frozen import value_class
from ...progress import tell_read
from ...recording import Source
from ..files import TextFile
from .column_names import OTHER, column_name, time_columns, unit_of
from .text_table import (
    CLOCK,
    HEAD_BYTES,
    LABEL,
    PARENT_LINE,
    PRINTED_HEAD_LINES,
    column_rises,
    holds_nested_lines,
    is_printed,
    sniff_layout,
)

_LONGEST_LINE, _BLOCK_BYTES = 2000, 1 << 20
_NUMBER = rb"(?:[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?|[-+]?(?:nan|NaN|NAN|inf|INF))(?![\w.]*(?:\][ \t]*)?[:=])"
_TOKEN = re.compile(rb"(?<![\w.^+/-])" + _NUMBER)
_OPENS_NUMBER = re.compile(r"[:=][\s\[({<\"']*$|[\[({<]\s*$")
_TRIADS = ("accelerometer", "gyroscope", "magnetometer")
_FRAME = re.compile(rb"\$([A-Z][A-Z0-9]*),([^*]*)\*([0-9A-Fa-f]{2}|[0-9A-Fa-f]{4})\s*$")
_VALUE = re.compile(rb"[A-Za-z_]\w*: *" + _NUMBER + rb"$")
_DAY_S = 86_400
_PADDING = re.compile(rb"(?<=[:=,;|]) $")
"""Space that a sign may take, as of "% 5.2f"."""
_AXES = frozenset("xyzXYZ")
_USUAL = 0.3  # a kind of line that belongs to every sample is at least so frequent, relative to the most frequent one
_IN_ORDER = 0.8
ARRIVAL = "arrival time [s]"

_MAGNETIC = ("mx [gauss]", "my [gauss]", "mz [gauss]")
_INERTIAL = ("ax [m/s^2]", "ay [m/s^2]", "az [m/s^2]", "gx [rad/s]", "gy [rad/s]", "gz [rad/s]")
_IN_UT = ("mx [uT]", "my [uT]", "mz [uT]")
_FRAMES = {  # of examples/devices, VectorNav (UM001, asynchronous outputs 14 and 19), MotionCal
    b"IMUSI": ("t [us]", *_INERTIAL, "temperature [degC]", *_IN_UT),
    b"VNYMR": ("yaw", "pitch", "roll", *_MAGNETIC, *_INERTIAL),
    b"VNIMU": (*_MAGNETIC, *_INERTIAL, "temperature", "pressure"),
    b"Raw": tuple(f"{sensor}{axis} [count]" for sensor in "agm" for axis in "xyz"),
}

Gaps = tuple[bytes, ...]
"""What stands before, between and behind the numbers of a line, each run of white space one character."""


@value_class(eq=True)
class PrintedForm:
    """How the lines of a log become rows.

    Attributes
    ----------
    lines : what stands around the numbers in each line of a sample; none where only a clock is replaced
    header : names of the columns, or empty
    clock : whether the time of the line is a column of its own, the first one
    in_place : whether the clock stays where it is, in seconds
    nested : whether a line belongs to a name above it, as in YAML
    delimiter : between columns
    """

    lines: tuple[Gaps, ...]
    header: tuple[str, ...]
    clock: bool
    in_place: bool = False
    nested: bool = False
    delimiter: bytes = b","


def lines_as_table(file: TextFile) -> TextFile:
    """Return the table that the lines of a log mean; the file itself where it is a table already."""
    form = printed_form(file.data)
    if form is None:
        return file
    rewriter = LineRewriter(form)
    data = b"".join(rewriter.rows(_lines(file.data, file.name)))
    return replace(file, data=data, header=form.header, notes=rewriter.notes(file.name))


def printed_form(data: bytes) -> PrintedForm | None:
    """Recognise by its first lines a log that is no plain table, (None) where it is one or nothing is understood."""
    if not is_printed(data):
        return None
    head = data[:HEAD_BYTES].splitlines()[:PRINTED_HEAD_LINES]
    nested = holds_nested_lines(head)
    if nested:
        head = [*map(Nesting(), head)]
    bare = [_without_clock(line)[1] for line in head if 0 < len(line) < _LONGEST_LINE]
    timed = sum(CLOCK.search(line) is not None for line in head) > 0.5 * len([line for line in head if line.strip()])
    groups = _cycle([gaps for line in bare if (gaps := _gaps(_unframed(line)[0])) is not None])
    if groups is not None and (header := _header(groups)) is not None:
        own = any(column_name(name).quantity == "time" for name in header)
        clock = timed and not own
        names = (ARRIVAL, *header) if clock and header else header
        return PrintedForm(lines=groups, header=names, clock=clock, nested=nested)
    return _clock_form(head) if timed else None


def _clock_form(head: list[bytes]) -> PrintedForm | None:
    """Return how the clocks in the lines of a table become numbers; None where it has other stamps of its own."""
    prefixed = 2 * sum((match := CLOCK.search(line)) is not None and match[8] is not None for line in head) > len(head)
    bare = [_without_clock(line)[1] for line in head] if prefixed else head
    try:
        layout = sniff_layout(_text(bare))
    except RecordingError:
        layout = None
    own = layout is not None and bool(time_columns([column_name(name) for name in layout.header], layout))
    if not prefixed:
        return None if own else PrintedForm(lines=(), header=(), clock=True, in_place=True)
    if layout is None:
        return None
    own = own or (not layout.header and (column_rises(layout) or column_rises(layout, layout.columns - 1)))
    return PrintedForm(lines=(), header=(), clock=not own, delimiter=(layout.delimiter or " ").encode())


def _text(lines: list[bytes]) -> TextFile:
    return TextFile(name="", data=b"\n".join(lines) + b"\n", source=Source(name="", sha256=""))


def _lines(data: bytes, name: str) -> Iterator[bytes]:
    file = io.BytesIO(data)
    while some := file.readlines(_BLOCK_BYTES):
        yield from some
        tell_read(f"the lines of {name}", file.tell(), len(data))


def _without_clock(line: bytes) -> tuple["re.Match[bytes] | None", bytes]:
    """Return the clock at the beginning of a line, if there is one, and what follows it."""
    match = CLOCK.match(line.lstrip())
    return (None, line) if match is None else (match, match.string[match.end() :])


def _unframed(line: bytes) -> tuple[bytes, bool]:
    """Return a line without the frame of a sentence, "$NAME,...*hh" as "NAME: ...", and whether its checksum agrees."""
    match = _FRAME.search(line) if b"$" in line else None
    if match is None:
        return line, True
    total = 0
    for byte in line[match.start() + 1 : match.end(2)]:
        total ^= byte
    good = len(match[3]) != 2 or total == int(match[3], 16)
    return match[1] + b": " + match[2], good


def _gaps(line: bytes) -> Gaps | None:
    """Return what stands around the numbers of a line; None where there is no number."""
    places = [match.span() for match in _TOKEN.finditer(line)]
    if not places:
        return None
    edges = [0, *(edge for place in places for edge in place), len(line)]
    gaps = [
        re.sub(rb"\s+", lambda run: b"\t" if b"\t" in run[0] else b" ", line[a:b])
        for a, b in zip(edges[::2], edges[1::2], strict=True)
    ]
    gaps = [_PADDING.sub(b"", gap) for gap in gaps]
    return (gaps[0].lstrip(), *gaps[1:-1], gaps[-1].rstrip())


def _cycle(found: list[Gaps]) -> tuple[Gaps, ...] | None:
    """Return the labelled lines that make a sample, in their order; None where lines have no labels or no order."""
    counts = Counter(found)
    if not counts:
        return None
    usual = max(2.0, _USUAL * max(counts.values()))
    kinds = tuple(gaps for gaps, count in counts.items() if count >= usual)
    if not any(LABEL.search(gap) for gaps in kinds for gap in gaps):
        return None
    order = [kinds.index(gaps) for gaps in found if gaps in kinds]
    good = sum((b - a) % len(kinds) == 1 % len(kinds) for a, b in pairwise(order))
    return kinds if good >= _IN_ORDER * (len(order) - 1) else None


def _header(lines: tuple[Gaps, ...]) -> tuple[str, ...] | None:
    """Return the names of the columns, empty where the values must tell; None where they make no sample."""
    if len(lines) == 1 and (tag := lines[0][0].partition(b":")[0]) in _FRAMES:
        known = _FRAMES[tag]
        count = len(lines[0]) - 1
        return (*known, *(f"value {i + 1}" for i in range(len(known), count)))[:count]
    names: list[str] = []
    for gaps in lines:
        names += _line_names([gap.decode("utf-8", errors="replace") for gap in gaps])
    columns = [column_name(name) for name in names]
    triads = [(column.quantity, column.axis) for column in columns if column.axis is not None]
    if not triads and not any(names[1:]):
        return ()
    if len(set(triads)) != len(triads):
        two = triads == 2 * triads[:3] and len(set(triads)) == 3 and len(triads) == len(columns)
        return () if two and columns[0].quantity == "unnamed" else None
    return tuple(name or f"value {i + 1}" for i, name in enumerate(names))


def _line_names(gaps: list[str]) -> list[str]:
    """Return the names of the numbers in a line, each with its unit in brackets where it is known."""
    labels, units = [], []
    for i, gap in enumerate(gaps):
        unit, label = _unit_and_label(gap, first=i == 0)
        units.append(unit)
        labels.append(label)
    names = _spread(labels[:-1])
    columns = [column_name(name) for name in names]
    for i in reversed(range(len(names))):
        spelt = unit_of(units[i + 1], columns[i].quantity)
        if spelt is None and i + 1 < len(names) and columns[i + 1].quantity == columns[i].quantity:
            spelt = columns[i + 1].unit  # "X: 1, Y: 2, Z: 3 m/s^2"
        if spelt is not None and columns[i].unit is None and columns[i] != OTHER:
            names[i] += f" [{spelt}]"
            columns[i] = replace(columns[i], unit=spelt)
    return names


def _unit_and_label(gap: str, *, first: bool) -> tuple[str, str]:
    """Split what stands between two numbers into the unit of the first and the label of the second."""
    parts = [part for part in re.split(r"[,;|\t]|\s{2,}", gap) if re.search(r"[A-Za-z]", part)]
    if not parts:
        return "", ""
    label = parts[-1].rstrip()
    if not _OPENS_NUMBER.search(label) and not first:
        return " ".join(parts[0].split()), ""
    words = label.rstrip(":= [({<\"'").split()
    if len(words) == 1 and words[0] in _AXES and len(parts) > (1 if first else 2):  # "GYRO   X:", "Gyro:<tab>x="
        words = [*parts[-2].rstrip(": ").split(), *words]
    unit = "" if first or len(parts) < 2 else parts[0].strip()
    if not first and len(parts) == 1 and len(words) > 1 and gap[:1] not in ",;|":
        unit, words = (words[0], words[1:]) if _is_unit(words[0]) else ("", words)
    name = " ".join(re.findall(r"[^\s\"'{}:=#]+", " ".join(words)))
    name = name.lstrip(")]>}| ")
    return unit, "time [ms]" if first and re.fullmatch("[IDWEV]", name) else name  # "I (1234) main: " of ESP-IDF


def _is_unit(text: str) -> bool:
    return any(unit_of(text, quantity) for quantity in (*_TRIADS, "time"))


def _spread(labels: list[str]) -> list[str]:
    """Return labels where a sensor that is named once names what follows, too: "Accel X", "Y"; "acc", "", ""; "a/g"."""
    names = list(labels)
    sensor = ""
    for i, label in enumerate(labels):
        bare = column_name(label)
        words = label.split()
        if label and bare.axis is not None:
            if bare.quantity == "unnamed" and sensor:
                names[i] = f"{sensor} {label}"
            elif bare.quantity != "unnamed":
                sensor = " ".join(words[:-1]) if words[-1] in _AXES else ""
            continue
        if words and words[-1] in _AXES:  # "ANGLE X", "Y"
            sensor = " ".join(words[:-1])
            continue
        count = next((k for k, other in enumerate(labels[i + 1 :], 1) if other), len(labels) - i)
        sensors = [name for name in re.split(r"[^A-Za-z]+", label) if column_name(f"{name} x").quantity in _TRIADS]
        if label and count == 3 and column_name(f"{label} x").quantity in _TRIADS:
            sensors = [label]
        if sensors and count == 3 * len(sensors):
            names[i : i + count] = [f"{name} {axis}" for name in sensors for axis in "xyz"]
    return names


class Nesting:
    """Puts the names above a line in front of it, "angular_velocity:", "  x: 0.1" -> "angular_velocity.x: 0.1"."""

    def __init__(self) -> None:
        self._parents: list[tuple[int, bytes]] = []

    def __call__(self, line: bytes) -> bytes:
        """Return the next line with its names; an empty one where it holds no number with a name."""
        text = line.strip()
        indent = len(line) - len(line.lstrip())
        self._parents = [(depth, name) for depth, name in self._parents if depth < indent]
        if PARENT_LINE.match(line):
            self._parents.append((indent, text.rstrip(b":")))
        return b".".join([*(name for _, name in self._parents), text]) if _VALUE.match(text) else b""


def _pattern(gaps: Gaps) -> "re.Pattern[bytes]":
    parts = [rb"\s*".join(re.escape(piece) for piece in re.split(rb"\s+", gap)) for gap in gaps]
    parts = [part + rb"\s*" if gap[-1:] in b":=,;|" else part for gap, part in zip(gaps, parts, strict=True)]
    inner = [part if gap.strip() else rb"\s+" for gap, part in zip(gaps[1:-1], parts[1:-1], strict=True)]
    number = b"(" + _NUMBER + b")"
    body = b"".join(piece + number for piece in (parts[0], *inner)) if len(gaps) > 1 else parts[0]
    return re.compile(rb"\s*" + body + parts[-1] + rb"\s*")


class LineRewriter:
    """Makes rows of lines, and counts what is no sample; what it saw goes on from one call to the next."""

    def __init__(self, form: PrintedForm) -> None:
        self.form = form
        self._patterns = [_pattern(gaps) for gaps in form.lines]
        self._nesting = Nesting()
        self._row: list[bytes] = []
        self._stage = 0
        self._day_s, self._last_s = 0, 0
        self._line, self._rows, self._damaged = 0, 0, 0
        self._lost: list[int] = []

    def rows(self, lines: Iterable[bytes]) -> Iterator[bytes]:
        """Yield a line for each line: a row, an empty line, or with a clock alone the line with its seconds."""
        for line in lines:
            self._line += 1
            line = self._nesting(line) if self.form.nested else line  # noqa: PLW2901
            yield self._sample(line.strip()) if self.form.lines else self._timed(line)

    def _sample(self, line: bytes) -> bytes:
        clock, text = _without_clock(line)
        text, good = _unframed(text)
        stage = self._stage
        match = self._patterns[stage].fullmatch(text) if good and len(text) < _LONGEST_LINE else None
        if match is None and stage and good:  # the rest of a sample is missing; another begins
            stage, match = 0, self._patterns[0].fullmatch(text)
        if match is None:
            if text.strip():
                self._damaged += not good
                self._stage = 0
                if self._rows and good:
                    self._lost.append(self._line)
            return b"\n"
        if stage == 0:
            self._row = [b"" if clock is None else self._seconds(clock)] if self.form.clock else []
        self._row += match.groups()
        self._stage = (stage + 1) % len(self._patterns)
        if self._stage:
            return b"\n"
        self._rows += 1
        return b",".join(self._row) + b"\n"

    def _timed(self, line: bytes) -> bytes:
        if self.form.in_place:
            match = CLOCK.search(line)
            return line if match is None else line[: match.start()] + self._seconds(match) + line[match.end() :]
        clock, text = _without_clock(line)
        if not self.form.clock:
            return text
        front = self._seconds(clock) if clock is not None and _TOKEN.match(text.lstrip()) else b"arrival_time_s"
        return front + self.form.delimiter + text.lstrip() if text.strip() else text

    def _seconds(self, clock: "re.Match[bytes]") -> bytes:
        """Return a clock as seconds since 1970, or since midnight of the first day."""
        year, month, day, hour, minute, second, fraction = clock.groups()[:7]
        whole = 3600 * int(hour) + 60 * int(minute) + int(second)
        if year is not None:
            self._day_s = _day_s(year, month, day)
        elif whole < self._last_s - _DAY_S // 2:
            self._day_s += _DAY_S
        self._last_s = whole
        return b"%d.%s" % (self._day_s + whole, fraction or b"0")

    def notes(self, name: str) -> tuple[str, ...]:
        """Return what is to be said of the lines."""
        form, notes = self.form, list[str]()
        if form.header:
            notes.append(f"{name}: its lines are read as the columns {', '.join(form.header)}.")
        if form.clock and not form.in_place:
            notes.append(f"{name}: timestamps are when lines arrived; micros() in the program's lines is far better.")
        if self._damaged:
            notes.append(f"{name}: {self._damaged} lines with a wrong checksum were left out.")
        if self._lost:
            count = len(self._lost)
            notes.append(f"{name}: {count} lines between samples are none and were left out (first: {self._lost[0]}).")
        return tuple(notes)


@lru_cache(maxsize=8)
def _day_s(year: bytes, month: bytes, day: bytes) -> int:
    try:
        return (date(int(year), int(month), int(day)) - date(1970, 1, 1)).days * _DAY_S
    except ValueError:
        return 0
