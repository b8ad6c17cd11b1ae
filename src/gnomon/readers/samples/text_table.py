"""Numbers in text: how a table is written (delimiter, header, preamble), what is a log, and columns, parsed fast.

Tables of plain numbers are read by the compiled kernel, or where it is missing, or where numbers have more digits than
it rounds exactly, by the parser of a JSON library: about three times and twice as fast as NumPy's reader of text.
"""

import ctypes
import io
import re
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
import orjson
from numpy.typing import NDArray

from ...errors import RecordingError
from ...frozen import value_class
from ...kernel import array_in, array_out, c_long, load_kernel
from ...progress import tell_read
from ...recording import Floats, Integers, Source, measurable_numbers
from ..files import TextFile

_NUMBERS = b"0123456789+-.eE,\n\r "
_BLOCK = 1 << 20
"""Bytes that are parsed at a time; bounds the memory of Python's numbers."""
_COMMA, _NEWLINE = b",\n"
_Columns = list[Floats | Integers]


def parse_number_table(
    data: bytes, offset: int, delimiter: str | None, kinds: Sequence[str], name: str = ""
) -> _Columns | None:
    """Return the columns of a table that is numbers throughout; None where it is anything else, or not quite regular.

    Numbers are rounded as by NumPy and Python, to the nearest double.

    Parameters
    ----------
    data : text, of which the table begins at byte `offset`
    delimiter : between the columns
    kinds : "f8" or "i8", one for each column
    name : of the file, to tell how far it is read
    """
    if not set(kinds) <= {"f8", "i8"}:
        return None
    table = data[offset:].rstrip(b"\r\n")
    if load_kernel() is not None:
        columns = _in_blocks(
            table, lambda lines: read_plain_numbers(lines, delimiter, [kind == "i8" for kind in kinds]), name
        )
        if columns is not None:
            return columns
    if delimiter not in {",", ";", "\t"}:
        return None
    if delimiter != ",":
        if b"," in table:
            return None
        table = table.replace(delimiter.encode(), b",")
    table = table.replace(b"\r\n", b"\n")
    if table.translate(None, _NUMBERS):
        return None
    return _in_blocks(table, lambda lines: _block(lines, kinds), name)


def _in_blocks(table: bytes, parse: Callable[[bytes], _Columns | None], name: str) -> _Columns | None:
    """Return the columns of a table that is parsed some lines at a time; None where one of the blocks is refused."""
    parts: list[_Columns] = []
    begin = 0
    while begin < len(table):
        end = table.rfind(b"\n", begin, begin + _BLOCK) if len(table) - begin > _BLOCK else len(table)
        columns = parse(table[begin:end]) if end > begin else None
        if columns is None:
            return None
        parts.append(columns)
        begin = end + 1
        tell_read(name, begin, len(table))
    return [np.concatenate(column) for column in zip(*parts, strict=True)] if parts else None


def read_plain_numbers(text: bytes, delimiter: str | None, whole: Sequence[bool]) -> list[NDArray[Any]] | None:
    """Return the columns of a table of plain numbers; None where it is anything else, or needs more digits than 2^53.

    Parameters
    ----------
    delimiter : one character; None is any white space
    whole : of each column, whether its numbers are integers
    """
    library = load_kernel()
    assert library is not None
    if not text or b"\0" in text:
        return None
    values = np.empty((text.count(b"\n") + 1, len(whole)))
    count = library.gnomon_read_table(
        *(ctypes.c_char_p(text), c_long(ord(delimiter or " ")), c_long(len(whole))),
        *(array_in(np.array(whole, dtype=np.uint8)), array_out(values)),
    )
    if count < 1:
        return None
    columns = np.ascontiguousarray(values[:count].T)
    return [column.view(np.int64) if one else column for column, one in zip(columns, whole, strict=True)]


def _block(lines: bytes, kinds: Sequence[str]) -> _Columns | None:
    count = len(kinds)
    if not _is_regular(lines, count):
        return None
    try:
        numbers = orjson.loads(b"[" + lines.replace(b"\n", b",") + b"]")
    except orjson.JSONDecodeError:  # +1, .5 and 007 are no numbers there
        return None
    values = np.array(numbers, dtype=np.float64).reshape(-1, count)
    columns: _Columns = []
    for k, kind in enumerate(kinds):
        if kind == "f8":
            columns.append(values[:, k])
            continue
        whole = numbers[k::count]
        if set(map(type, whole)) != {int} or not -(2**63) <= min(whole) <= max(whole) < 2**63:
            return None
        columns.append(np.array(whole, dtype=np.int64))
    return columns


def _is_regular(lines: bytes, count: int) -> bool:
    """Tell whether each line has as many columns."""
    text = np.frombuffer(lines, dtype=np.uint8)
    ends = np.flatnonzero(text == _NEWLINE)
    commas = np.flatnonzero(text == _COMMA)
    if len(commas) != (count - 1) * (len(ends) + 1):
        return False
    if count == 1 or not len(ends):
        return True
    rows = commas.reshape(-1, count - 1)
    return bool((rows[:-1, -1] < ends).all() and (rows[1:, 0] > ends).all())


HEAD_BYTES = 65_536
_HEAD_LINES = 100
_LONGEST_HEADER = 10_000
_DELIMITERS = (",", ";", "\t", None)  # None is any white space
_COMMENT = ("#", "%", "//")
_NUMBER = re.compile(r"[-+]?(\d+(\.\d*)?|\.\d+)([eE][-+]?\d+)?|[-+]?(nan|inf|infinity)", re.IGNORECASE)
_NAMES = {",": "commas", ";": "semicolons", "\t": "tabs", None: "white space"}

Column = NDArray[Any]


@value_class(eq=True)
class TextLayout:
    """How a table is written.

    Attributes
    ----------
    delimiter : between columns; None is any white space
    decimal_comma : whether 1,5 stands for 1.5
    columns : number of columns
    header : their names, or empty
    preamble : lines above the header
    first_line : number of the first line with data, from 1
    offset : where it starts [bytes]
    sample : first rows, as text
    """

    delimiter: str | None
    decimal_comma: bool
    columns: int
    header: tuple[str, ...]
    preamble: tuple[str, ...]
    first_line: int
    offset: int
    sample: tuple[tuple[str, ...], ...]

    def __str__(self) -> str:
        return f"{self.columns} columns separated by {_NAMES[self.delimiter]}"


def is_number(token: str, decimal_comma: bool = False) -> bool:
    """Tell whether a token reads as a number (NaN and infinity included)."""
    token = token.strip().strip('"')
    return _NUMBER.fullmatch(token.replace(",", ".", 1) if decimal_comma else token) is not None


def split_line(line: str, delimiter: str | None) -> list[str]:
    """Split a line into its tokens."""
    return [token.strip() for token in line.split(delimiter)] if delimiter else line.split()


SAMPLE_ROWS = "time, three accelerations, three angular rates"


def sniff_layout(file: TextFile, expected: str = SAMPLE_ROWS) -> TextLayout:
    """Find out how a table is written, from its first lines.

    Parameters
    ----------
    file : the table
    expected : what is in its rows, for messages

    Raises
    ------
    RecordingError
        If there is no table of numbers in the file.
    """
    raw = file.data[:HEAD_BYTES].splitlines(keepends=True)
    if len(file.data) > HEAD_BYTES:
        raw.pop()  # the last line may be cut by the end of the head
    raw = raw[:_HEAD_LINES]
    lines = [line.decode("utf-8", errors="replace").strip("\r\n") for line in raw]
    if not lines:
        raise RecordingError(f"{file.name}: its first line is longer than {HEAD_BYTES} bytes, as that of no table is.")
    delimiter, comma = _best_delimiter(lines)
    rows = [[] if line.lstrip().startswith(_COMMENT) else split_line(line, delimiter) for line in lines]
    masks = [[is_number(token, comma) for token in row] for row in rows]
    counts = Counter(len(row) for row, mask in zip(rows, masks, strict=True) if sum(mask) >= max(1, len(row) // 2))
    if not counts:
        json = " Of JSON, write one object a line." if lines[0].lstrip()[:1] in {"[", "{"} else ""
        raise RecordingError(
            f"{file.name}: no table of numbers found in its first lines, {len(lines)} looked at (the first one begins "
            f'with "{lines[0][:40]}"). Expected rows such as: {expected}.{json}'
        )
    columns = max(counts, key=lambda n: (counts[n], n))
    first = _first_row(rows, masks, columns)
    header, preamble = _header(lines[:first], delimiter, columns)
    header = file.header if len(file.header) == columns else header
    sample = tuple(tuple(row) for row in rows[first:] if len(row) == columns)
    return TextLayout(
        delimiter=delimiter,
        decimal_comma=comma,
        columns=columns,
        header=header,
        preamble=preamble,
        first_line=first + 1,
        offset=sum(len(line) for line in raw[:first]),
        sample=sample,
    )


PRINTED_HEAD_LINES = 200
"""Lines at the beginning of a log that are looked at."""
CLOCK = re.compile(
    rb"\[?(?<![\w.:-])(?:(?:(\d{4})[-/](\d\d?)[-/](\d\d?)|\d\d?[-/.](?:\d\d?|[A-Z][a-z]{2})[-/.]\d{4})[ T]\s*)?"
    rb"([012]?\d):([0-5]\d):([0-5]\d)(?:[.:](\d{1,9}))?"
    rb"(?:Z|[+-]\d\d:?\d\d)?(?![\w:])\]?([ \t]*-?>[ \t]?)?"
)
"""A clock in a line, with or without its date."""
LABEL = re.compile(rb"^[\[(]|[A-Za-z\])\"'][ \t]*(?:[:=]|[\[(][ \t]*(?:[-+.\d]|$))")
"""What tells that a number has a label."""
PARENT_LINE = re.compile(rb"\s*[A-Za-z_]\w*:\s*$")
"""A name above the lines that belong to it, as in YAML."""
_CHILD_LINE = re.compile(rb"\s+[A-Za-z_]\w*:(\s|$)")


def is_printed(data: bytes) -> bool:
    """Tell by its first lines whether a text is a log as programs print them for people, and no table yet."""
    head = data[:HEAD_BYTES].splitlines()[:PRINTED_HEAD_LINES]
    return holds_nested_lines(head) or any(
        LABEL.search(line) or CLOCK.search(line) or line.startswith(b"$") for line in head
    )


def holds_nested_lines(head: list[bytes]) -> bool:
    """Tell whether lines belong to names above them."""
    return any(PARENT_LINE.match(above) and _CHILD_LINE.match(below) for above, below in pairwise(head))


def has_header(name: str, head: bytes) -> bool:
    """Return whether a table names its columns, by its first bytes.

    Raises
    ------
    RecordingError
        If it is no table.
    """
    return bool(sniff_layout(TextFile(name=name, data=head, source=Source(name=name, sha256=""))).header)


def _best_delimiter(lines: list[str]) -> tuple[str | None, bool]:
    def numbers(delimiter: str | None, comma: bool) -> int:
        return sum(is_number(token, comma) for line in lines for token in split_line(line, delimiter))

    candidates = [(delimiter, False) for delimiter in _DELIMITERS]
    candidates += [(delimiter, True) for delimiter in _DELIMITERS if delimiter != ","]
    return max(candidates, key=lambda candidate: numbers(*candidate))


def _first_row(rows: list[list[str]], masks: list[list[bool]], columns: int) -> int:
    """Return the index of the first row of data: most of what is a number elsewhere in the column is one in it."""
    table = np.array([mask for mask in masks if len(mask) == columns and any(mask)], dtype=bool)
    numeric = table.mean(axis=0) > 0.5
    for i, (row, mask) in enumerate(zip(rows, masks, strict=True)):
        if len(row) == columns and 2 * int((np.array(mask) & numeric).sum()) >= max(1, int(numeric.sum())):
            return i
    return 0


def _header(lines: list[str], delimiter: str | None, columns: int) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the names of the columns, units in brackets, and the lines above them."""
    rows = [(i, _header_tokens(line, delimiter)) for i, line in enumerate(lines) if line.strip()]
    named = [(i, row) for i, row in rows[-2:] if len(row) == columns and not any(is_number(token) for token in row)]
    if not named:
        return (), tuple(lines)
    names = named[0][1]
    if len(named) == 2 and {*map(str.lower, named[1][1])} <= {*"xyz"}:  # a title of as many words above the axes
        names = named[1][1]
    elif len(named) == 2:  # a row of names above a row of units
        names = [f"{name} [{unit}]" if unit else name for name, unit in zip(names, named[1][1], strict=True)]
    return tuple(names), tuple(lines[: named[0][0]])


def _header_tokens(line: str, delimiter: str | None) -> list[str]:
    line = re.sub(r"^\s*(#|%|//)+", "", line)
    if delimiter is None and len(line) < _LONGEST_HEADER:  # "a_x [m s^-2]" is one name
        line = re.sub(r"\s*[\[(][^\])]*[\])]", lambda unit: re.sub(r"\s", "", unit.group()), line)
    return [token.strip('"').strip() for token in split_line(line, delimiter)]


def column_rises(layout: TextLayout, column: int = 0) -> bool:
    """Tell whether a column mostly rises: stamps may stand still or jump back, samples go up and down."""
    tokens = [row[column].strip('"') for row in layout.sample if is_number(row[column], layout.decimal_comma)]
    numbers = np.array([float(token.replace(",", ".")) for token in tokens])
    with np.errstate(invalid="ignore"):  # infinity less infinity
        steps = np.diff(numbers)
    return len(steps) > 0 and float((steps >= 0).mean()) > 0.9 and numbers[-1] > numbers[0]


def parse_columns(
    file: TextFile, layout: TextLayout, kinds: list[str], *, may_be_lost: bool = False
) -> tuple[list[Column], str | None]:
    """Return the columns of a table.

    Parameters
    ----------
    kinds : NumPy dtype of each column, such as "f8", "i8", "S40"; "" for columns that are not wanted
    may_be_lost : whether NaN and infinity are let through, as marks of values that were lost

    Returns
    -------
    columns : one array (n,) per column, of any kind where it is not wanted
    note : a sentence on a last line that was cut off and left out, or None

    Raises
    ------
    RecordingError
        If a row has too few or too many columns, or text where a number belongs, or NaN or infinity that may not be.
    """
    data, note = _without_cut_line(file, layout)
    if layout.decimal_comma:
        data = data.replace(b",", b".")
    columns: list[Column] | None = parse_number_table(
        data, layout.offset, layout.delimiter, [k or "f8" for k in kinds], file.name
    )
    if columns is None:
        columns = _any_columns(file, layout, kinds, data, may_be_lost)
    numbers = [column for column, kind in zip(columns, kinds, strict=True) if kind == "f8" and not may_be_lost]
    if not all(measurable_numbers(column).all() for column in numbers):
        raise _located(file, layout, kinds, data, may_be_lost) or RecordingError(
            f"{file.name}: NaN or infinity in the table."
        )
    return columns, note


def _any_columns(file: TextFile, layout: TextLayout, kinds: list[str], data: bytes, may_be_lost: bool) -> list[Column]:
    """Return the columns of a table with text in it, comments, or numbers in any notation."""
    fields = [(f"c{i}", kind or "S1") for i, kind in enumerate(kinds)]
    stream = io.BytesIO(data)
    stream.seek(layout.offset)
    comments = [mark for mark in _COMMENT if mark[:1].encode() in data and data.find(mark.encode(), layout.offset) >= 0]
    try:
        table = np.loadtxt(
            io.TextIOWrapper(stream, encoding="latin-1"),
            dtype=np.dtype(fields),
            delimiter=layout.delimiter,
            comments=comments[0] if len(comments) == 1 else (comments or None),
            quotechar='"' if data.find(b'"', layout.offset) >= 0 else None,
            ndmin=1,
        )
    except ValueError as error:
        raise _located(file, layout, kinds, data, may_be_lost) or RecordingError(f"{file.name}: {error}") from None
    return [table[name] for name, _ in fields]


def _without_cut_line(file: TextFile, layout: TextLayout) -> tuple[bytes, str | None]:
    data = file.data
    if data.endswith((b"\n", b"\r")):
        return data, None
    begin = max(data.rfind(b"\n"), data.rfind(b"\r")) + 1
    row = split_line(data[begin:].decode("utf-8", errors="replace"), layout.delimiter)
    if begin <= layout.offset or not row or (len(row) == layout.columns and is_number(row[-1], layout.decimal_comma)):
        return data, None
    return data[:begin], f"{file.name}: the last line is cut off and was left out."


def numbered_rows(layout: TextLayout, data: bytes) -> Iterator[tuple[int, list[str]]]:
    """Yield (line number, tokens) of every row of data."""
    stream = io.BytesIO(data)
    stream.seek(layout.offset)
    for number, line in enumerate(io.TextIOWrapper(stream, encoding="latin-1"), start=layout.first_line):
        text = re.split("#|%|//", line, maxsplit=1)[0].rstrip("\r\n")
        row = split_line(text, layout.delimiter)
        if text.strip() if layout.delimiter is None else text:
            yield number, row


def line_number(file: TextFile, layout: TextLayout, row: int) -> int:
    """Return the number of the line, from 1, that holds a row of data, from 0; slow, for messages."""
    return next(number for i, (number, _) in enumerate(numbered_rows(layout, file.data)) if i == row)


def _located(
    file: TextFile, layout: TextLayout, kinds: list[str], data: bytes, may_be_lost: bool
) -> RecordingError | None:
    """Say where a table is not as it should be; slow, and only called once it is known to be wrong."""
    for number, row in numbered_rows(layout, data):
        where = f"{file.name}, line {number}"
        if len(row) != layout.columns:
            return RecordingError(
                f"{where}: found {len(row)} columns, expected {layout.columns} as in the other rows. "
                "Fix or remove this line."
            )
        for i, (token, kind) in enumerate(zip(row, kinds, strict=True)):
            name = f"column {i + 1}" + (f" ({layout.header[i]})" if layout.header else "")
            if kind and not is_number(token):
                found = f'"{token[:40]}"' if token else "nothing"
                return RecordingError(f"{where}, {name}: found {found}, expected a number. Fix or remove this line.")
            if kind and not may_be_lost and not measurable_numbers(np.array(float(token.strip('"')))):
                return RecordingError(
                    f"{where}, {name}: found {token[:40]}, expected a finite number that a sensor can read. "
                    "Remove this line if the sample is lost; gnomon treats the gap as such."
                )
            if kind == "i8" and not re.fullmatch(r"[-+]?\d+", token.strip('"')):
                return None
    return None
