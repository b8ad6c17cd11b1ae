"""Text tables block by block: cut at line ends, each block parsed as a small file of its own."""

import gzip
import io
import zlib
from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Generator, Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Protocol

import numpy as np

from ...errors import RecordingError
from ...frozen import value_class
from ...progress import tell_read
from ...recording import Integers, Source, TriadSamples
from ...units import Units
from ..files import TextFile, bomb_error, first_bytes, largest_unpacked, refuse_binary
from ..recordings import inertial_streams, without_magnetometer
from .column_names import Roles, column_roles
from .printed_lines import LineRewriter, printed_form
from .stream import TRIADS, Blocks, SampleStream, UnitChoice, shared_blocks
from .table import (
    Triad,
    Unwrapper,
    guess_time_unit,
    named_unit,
    parse_stamped,
    preamble_rate,
    read_table,
    to_ns,
    uniform_stamps,
)
from .text_table import HEAD_BYTES, Column, TextLayout, is_number, sniff_layout, split_line

_RECOGNISED_BYTES = 8 << 20
_LONGEST_LINE = 1 << 20
_NO_SOURCE = Source(name="", sha256="")


class _Bytes(Protocol):
    """What can be read from."""

    def read(self, size: int, /) -> bytes: ...


@value_class(eq=True)
class _Plan:
    """How a file is to be read.

    Attributes
    ----------
    triads : for each of `TRIADS` its index among the triads of the table; None where it is not there or not wanted
    units : of each of `TRIADS`
    time_unit : of a single column of timestamps
    rate_hz : where there are no timestamps
    """

    path: Path
    layout: TextLayout
    used: Roles
    triads: list[int | None]
    units: tuple[str, str, str]
    time_unit: str | None
    rate_hz: float | None


def open_text(
    files: list[Path],
    choice: UnitChoice,
    columns: str | None,
    rate_hz: float | None,
    *,
    triads: Collection[str],
    block_bytes: int,
) -> SampleStream:
    """Open a table, or two tables that hold different triads; `triads` are those that are wanted.

    Raises
    ------
    RecordingError
        If a file is no table, or nothing tells what its columns are.
    OptionError
        If an option does not fit.
    """
    heads = [_head(path) for path in files]
    tables = [read_table(head, columns, rate_hz, choice.stated) for head in heads]
    others, names, magnetometer = without_magnetometer(tables, files)
    found = (*inertial_streams(others, names, [], alone=False), magnetometer)
    there = [
        None if stream is None or name not in triads else stream[1] for name, stream in zip(TRIADS, found, strict=True)
    ]
    units = _units(choice, there)
    streams: dict[str, Blocks] = {}
    for path, head, table in zip(files, heads, tables, strict=True):
        index = [next((i for i, triad in enumerate(table.triads) if triad is one), None) for one in there]
        plan = _plan(path, head, columns, rate_hz=rate_hz, time_unit=choice.stated.time, triads=index, units=units)
        held = [which for which, place in enumerate(index) if place is not None]
        sides = shared_blocks(_blocks(plan, block_bytes, held), len(held))
        streams |= {TRIADS[which]: side for which, side in zip(held, sides, strict=True)}
    return SampleStream(**streams, thermometer=any(table.temperature is not None for table in tables))


def _units(choice: UnitChoice, triads: list[Triad | None]) -> tuple[str, str, str]:
    accelerometer, gyroscope, magnetometer = triads
    return (
        "" if accelerometer is None else choice.accelerometer(accelerometer.unit, accelerometer.values),
        "" if gyroscope is None else choice.gyroscope(gyroscope.unit),
        "" if magnetometer is None else choice.magnetometer(magnetometer.unit),
    )


def _head(path: Path) -> TextFile:
    """Return the beginning of a file, cut at a line end."""
    with _opened(path) as (stream, header, _):
        data = stream.read(_RECOGNISED_BYTES)
        if len(data) == _RECOGNISED_BYTES and b"\n" in data:
            data = data[: data.rfind(b"\n") + 1]
    if not data.strip():
        raise RecordingError(f"{path}: the file holds no text. Was the recording copied completely?")
    refuse_binary(data, path)
    return TextFile(name=path.name, data=data, source=_NO_SOURCE, header=header)


def _plan(
    path: Path,
    head: TextFile,
    columns: str | None,
    *,
    rate_hz: float | None,
    time_unit: str | None,
    triads: list[int | None],
    units: tuple[str, str, str],
) -> _Plan:
    layout = sniff_layout(head)
    used = column_roles(layout, columns, head.name)
    unit = None
    if not used.time:
        rate_hz = rate_hz if rate_hz is not None else preamble_rate(layout.preamble)
    elif len(used.time) == 1:
        column, named = used.time[0]
        unit = time_unit or named
        if unit in {None, "100us"}:
            stamps = Unwrapper()(parse_stamped(head, layout, [column], [])[0][column])
            unit = named_unit(unit, stamps) or guess_time_unit(stamps)[0]
    return _Plan(path=path, layout=layout, used=used, triads=triads, units=units, time_unit=unit, rate_hz=rate_hz)


def _blocks(plan: _Plan, block_bytes: int, held: list[int]) -> Iterator[list[TriadSamples]]:
    """Yield the triads of every block, those of `plan.triads` that are counted in `held`."""
    count, unwrapper = 0, Unwrapper()
    for line, text in _lines(plan, block_bytes):
        file = TextFile(name=plan.path.name, data=text, source=_NO_SOURCE)
        triads = _triads(plan, file, held, line=line, count=count, unwrapper=unwrapper)
        yield triads
        count += len(triads[0])


def _triads(
    plan: _Plan, file: TextFile, held: list[int], *, line: int, count: int, unwrapper: Unwrapper
) -> list[TriadSamples]:
    """Return the triads in whole lines that begin with number `line`, after `count` rows."""
    stamps = [i for i, _ in plan.used.time]
    places = [plan.used.triads[index].columns for which in held if (index := plan.triads[which]) is not None]
    values = [i for columns in places for i in columns]
    data, _ = parse_stamped(file, replace(plan.layout, offset=0, first_line=line), stamps, values)
    t_ns = _stamps(plan, data, count, unwrapper)
    return [
        TriadSamples(t_ns=t_ns, values=np.column_stack([data[i] for i in columns]), unit=plan.units[which])
        for which, columns in zip(held, places, strict=True)
    ]


class ArrivingTable:
    """A table whose lines arrive one after the other, understood by the first of them as `read` understands the file.

    Parameters
    ----------
    name : of the file that they make, for messages
    head : its first lines, whole ones
    stated : units, as far as they are
    columns, rate_hz : as for `read`

    Raises
    ------
    RecordingError
        If so few lines are no table yet, or do not tell which triad is which.
    """

    def __init__(
        self, name: str, head: bytes, stated: Units, columns: str | None = None, rate_hz: float | None = None
    ) -> None:
        form = printed_form(head)
        self._rewriter = None if form is None else LineRewriter(form)
        file = TextFile(name=name, data=self._rewritten(head), source=_NO_SOURCE, header=form.header if form else ())
        table = read_table(file, columns, rate_hz, stated)
        others, names, magnetometer = without_magnetometer([table], [Path(name)])
        found = (*inertial_streams(others, names, [], alone=False), magnetometer)
        index = [
            None if one is None else next(i for i, triad in enumerate(table.triads) if triad is one[1]) for one in found
        ]
        self.units = {which: one[1].unit for which, one in zip(TRIADS, found, strict=True) if one is not None}
        """Names of the triads that it holds -> unit as the lines name it, or None."""
        plain = ("", "", "")
        self._plan = _plan(Path(name), file, columns, rate_hz=rate_hz, time_unit=stated.time, triads=index, units=plain)
        self._held = [which for which, place in enumerate(index) if place is not None]
        self._unwrapper, self._count = Unwrapper(), 0
        self.free_form = form is not None and bool(form.lines)
        """Whether lines that are no samples may stand between the others."""
        self.first = self._samples_of(replace(file, data=file.data[self._plan.layout.offset :]))
        """The samples in the head, by the names of the triads; their unit is not stated."""

    def _rewritten(self, text: bytes) -> bytes:
        return text if self._rewriter is None else b"".join(self._rewriter.rows(io.BytesIO(text)))

    def samples_in(self, text: bytes) -> dict[str, TriadSamples]:
        """Return the samples in the next lines, whole ones, by the names of the triads.

        Raises
        ------
        RecordingError
            If one of the lines is no row of the table.
        """
        return self._samples_of(TextFile(name=self._plan.path.name, data=self._rewritten(text), source=_NO_SOURCE))

    def is_row(self, line: bytes) -> bool:
        """Return whether a line may stand in the file, from which it could not be read otherwise."""
        if self.free_form:
            return True
        row = split_line(line.decode("latin-1").strip(), self._plan.layout.delimiter)
        comma = self._plan.layout.decimal_comma
        return len(row) == self._plan.layout.columns and all(
            is_number(token, comma) or not is_number(known, comma)
            for token, known in zip(row, self._plan.layout.sample[-1], strict=True)
        )

    def _samples_of(self, file: TextFile) -> dict[str, TriadSamples]:
        if not file.data.strip():
            return {}
        blocks = _triads(self._plan, file, self._held, line=1, count=self._count, unwrapper=self._unwrapper)
        self._count += len(blocks[0])
        return {TRIADS[which]: block for which, block in zip(self._held, blocks, strict=True)}


def _stamps(plan: _Plan, data: list[Column], count: int, unwrapper: Unwrapper) -> Integers:
    """Return the timestamps of a block that begins after `count` rows [ns]."""
    name = plan.path.name
    if not plan.used.time:
        return uniform_stamps(len(data[0]), 0.0 if plan.rate_hz is None else plan.rate_hz, count)
    if len(plan.used.time) == 2:
        seconds, rest = (to_ns(data[i], unit or "ns", name) for i, unit in plan.used.time)
        return seconds + rest
    return to_ns(unwrapper(data[plan.used.time[0][0]]), plan.time_unit or "s", name)


def _lines(plan: _Plan, block_bytes: int) -> Iterator[tuple[int, bytes]]:
    """Yield (number of the first line, whole lines) from the first row of data on."""
    line, carry, count = plan.layout.first_line, b"", 0
    size = plan.path.stat().st_size
    with _opened(plan.path) as (stream, _, place):
        _skip(stream, plan.layout.offset)
        block = stream.read(block_bytes)
        while block:
            ahead = stream.read(block_bytes)
            count += len(ahead)
            if count > max(largest_unpacked(size), 2 * size):  # UTF-16 becomes half as long again at most
                raise bomb_error(str(plan.path), size)
            if len(carry) > max(_LONGEST_LINE, 4 * block_bytes):
                raise RecordingError(f"{plan.path.name}, line {line}: it is longer than {_LONGEST_LINE} bytes.")
            if ahead and len(ahead) < block_bytes:  # a short rest goes along, so that a cut last line is not alone
                block, ahead = block + ahead, b""
            text = carry + block
            end = text.rfind(b"\n") + 1 if ahead else len(text)
            text, carry = text[:end], text[end:]
            tell_read(plan.path.name, place(), size)
            if text.strip():
                yield line, text
            line += text.count(b"\n")
            block = ahead


def _skip(stream: _Bytes, count: int) -> None:
    while count > 0:
        count -= len(stream.read(min(count, 1 << 20))) or count


@contextmanager
def _opened(path: Path) -> Generator[tuple[_Bytes, tuple[str, ...], Callable[[], int]]]:
    """Open a table as UTF-8 bytes without byte order mark, unpacked if it is gzipped, printed lines made rows.

    Yields
    ------
    stream, header, place : the bytes, the names of columns that printed lines tell, and how far the file is read

    Raises
    ------
    RecordingError
        If it cannot be read, or its gzip stream is cut off or damaged.
    """
    try:
        with _text_stream(path) as (stream, _):
            form = printed_form(stream.read(HEAD_BYTES))
        with _text_stream(path) as (stream, place):
            rows = stream if form is None else _Rewritten(stream, LineRewriter(form))
            yield rows, form.header if form else (), place
    except EOFError:
        raise RecordingError(f"{path}: the gzip stream ends too early; the file is cut off. Copy it again.") from None
    except (gzip.BadGzipFile, zlib.error) as error:
        raise RecordingError(f"{path}: the gzip stream is damaged ({error}). Copy it again.") from None


@contextmanager
def _text_stream(path: Path) -> Generator[tuple[_Bytes, Callable[[], int]]]:
    packed = first_bytes(path).startswith(b"\x1f\x8b")
    with path.open("rb") as raw, gzip.open(raw) if packed else nullcontext(raw) as stream:
        mark = stream.read(3)
        stream.seek(3 if mark == b"\xef\xbb\xbf" else 0)
        if mark[:2] in {b"\xff\xfe", b"\xfe\xff"}:
            stream.seek(0)
            yield _Recoded(io.TextIOWrapper(stream, "utf-16", errors="replace", newline="")), raw.tell
        else:
            yield stream, raw.tell


class _Pieces(ABC):
    """Bytes that come in pieces of any length, read in any other."""

    def __init__(self) -> None:
        self._left = b""

    @abstractmethod
    def _piece(self, size: int) -> bytes:
        """Return some bytes more, made of about so many, none at the end."""

    def read(self, size: int, /) -> bytes:
        while len(self._left) < size and (piece := self._piece(size)):
            self._left += piece
        data, self._left = self._left[:size], self._left[size:]
        return data


class _Recoded(_Pieces):
    """UTF-16 text as UTF-8 bytes."""

    def __init__(self, text: io.TextIOWrapper) -> None:
        super().__init__()
        self._text = text

    def _piece(self, size: int) -> bytes:
        return self._text.read(size).encode()


class _Rewritten(_Pieces):
    """Printed lines as rows of a table."""

    def __init__(self, stream: _Bytes, rewriter: LineRewriter) -> None:
        super().__init__()
        self._stream, self._rewriter, self._carry = stream, rewriter, b""

    def _piece(self, size: int) -> bytes:
        block = self._stream.read(size)
        text = self._carry + block
        end = text.rfind(b"\n") + 1 if block else len(text)
        self._carry = text[end:]
        rows = b"".join(self._rewriter.rows(io.BytesIO(text[:end])))
        return rows or (self._piece(size) if block else b"")
