"""Tables of plain numbers, read by the parser of a JSON library: about twice as fast as NumPy's reader of text."""

from collections.abc import Sequence

import numpy as np
import orjson

from ...recording import Floats, Integers

_NUMBERS = b"0123456789+-.eE,\n\r "
_BLOCK = 1 << 20
"""Bytes that are parsed at a time; bounds the memory of Python's numbers."""
_COMMA, _NEWLINE = b",\n"


def parse_number_table(
    data: bytes, offset: int, delimiter: str | None, kinds: Sequence[str]
) -> list[Floats | Integers] | None:
    """Return the columns of a table that is numbers throughout; None where it is anything else, or not quite regular.

    Numbers are rounded as by NumPy and Python, to the nearest double.

    Parameters
    ----------
    data : text, of which the table begins at byte `offset`
    delimiter : between the columns
    kinds : "f8" or "i8", one for each column
    """
    if delimiter not in {",", ";", "\t"} or not set(kinds) <= {"f8", "i8"}:
        return None
    table = data[offset:]
    if delimiter != ",":
        if b"," in table:
            return None
        table = table.replace(delimiter.encode(), b",")
    table = table.replace(b"\r\n", b"\n").rstrip(b"\n")
    if not table or table.translate(None, _NUMBERS):
        return None
    parts: list[list[Floats | Integers]] = []
    begin = 0
    while begin < len(table):
        end = table.rfind(b"\n", begin, begin + _BLOCK) if len(table) - begin > _BLOCK else len(table)
        columns = _block(table[begin:end], kinds) if end > begin else None
        if columns is None:
            return None
        parts.append(columns)
        begin = end + 1
    return [np.concatenate(column) for column in zip(*parts, strict=True)]


def _block(lines: bytes, kinds: Sequence[str]) -> list[Floats | Integers] | None:
    count = len(kinds)
    if not _is_regular(lines, count):
        return None
    try:
        numbers = orjson.loads(b"[" + lines.replace(b"\n", b",") + b"]")
    except orjson.JSONDecodeError:  # +1, .5 and 007 are no numbers there
        return None
    values = np.array(numbers, dtype=np.float64).reshape(-1, count)
    columns: list[Floats | Integers] = []
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
