"""MAT files of version 5 to 7: arrays of numbers and structs of them, the rest passed over.

After MathWorks, "MAT-File Format" (version 5). SciPy's reader is not used: damaged files end the program in it.
"""

import struct
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import RecordingError
from .files import bomb_error, first_bytes, largest_unpacked

_HEADER = 128
_NUMBERS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
_MATRIX, _COMPRESSED = 14, 15
_STRUCT, _NUMERIC = 2, range(6, 16)
_COMPLEX = 0x0800
_DEEPEST = 16

Element = tuple[int, memoryview]
"""What kind of data, and the data."""


def read_mat(path: Path) -> dict[str, Any]:
    """Return the variables of a MAT file: arrays of numbers, (n,) or (n, m) where they are, and structs as mappings.

    Raises
    ------
    RecordingError
        If it is damaged, or of another version.
    """
    first_bytes(path)  # it is there, and can be read
    data = path.read_bytes()
    order = {b"IM": "<", b"MI": ">"}.get(data[126:128])
    if order is None or data[124:126] not in (b"\x00\x01", b"\x01\x00"):
        raise RecordingError(f"{path.name}: this is no MAT file of version 5 to 7.")
    try:
        variables: dict[str, Any] = {}
        for kind, content in _elements(memoryview(data)[_HEADER:], order):
            for inner, matrix in _unpacked(path, kind, content, order):
                if inner == _MATRIX:
                    name, value = _matrix(matrix, order, 0)
                    if value is not None:
                        variables[name] = value
    except (ValueError, struct.error, StopIteration, zlib.error) as error:
        raise RecordingError(f"{path.name}: the MAT file is damaged ({error}).") from None
    return variables


def _elements(data: memoryview, order: str) -> Iterator[Element]:
    """Yield the data elements that stand behind each other."""
    at = 0
    while at + 8 <= len(data):
        kind, size = struct.unpack_from(f"{order}II", data, at)
        if kind >> 16:  # a small element: size and kind in four bytes, the data in the next four
            kind, size, start, end = kind & 0xFFFF, kind >> 16, at + 4, at + 8
        else:
            start = at + 8
            end = start + size + (-size % 8 if kind != _COMPRESSED else 0)
        if start + size > len(data):
            raise ValueError("it ends early")
        yield kind, data[start : start + size]
        at = end


def _unpacked(path: Path, kind: int, content: memoryview, order: str) -> Iterator[Element]:
    if kind != _COMPRESSED:
        yield kind, content
        return
    most = largest_unpacked(len(content))
    stream = zlib.decompressobj()
    plain = stream.decompress(content, most)
    if stream.unconsumed_tail:
        raise bomb_error(path.name, len(content))
    yield from _elements(memoryview(plain), order)


def _matrix(data: memoryview, order: str, depth: int) -> tuple[str, Any]:
    """Return the name of a variable, and its value: an array, a mapping, or None for what is neither."""
    parts = _elements(data, order)
    (flags, *_) = _numbers(next(parts), order).tolist()
    shape = tuple(_numbers(next(parts), order).tolist())
    name = bytes(next(parts)[1]).decode("ascii", "replace")
    kind = int(flags) & 0xFF
    if kind == _STRUCT and depth < _DEEPEST and np.prod(shape, dtype=np.float64) == 1:
        width = int(_numbers(next(parts), order)[0])
        text = bytes(next(parts)[1])
        if not 0 < width <= len(text):
            raise ValueError("a struct without names")
        fields = [text[i : i + width].split(b"\0")[0].decode("ascii", "replace") for i in range(0, len(text), width)]
        values = {field: _matrix(next(parts)[1], order, depth + 1)[1] for field in fields}
        return name, {field: value for field, value in values.items() if value is not None}
    if kind not in _NUMERIC or int(flags) & _COMPLEX or any(side < 0 for side in shape):
        return name, None
    values = _numbers(next(parts), order)
    if values.size != np.prod(shape, dtype=np.float64):
        raise ValueError(f"{name} has {values.size} values, and is said to be {shape}")
    array = values.reshape(shape, order="F")
    return name, array.squeeze() if array.ndim == 2 and 1 in shape else array


def _numbers(element: Element, order: str) -> NDArray[Any]:
    kind, data = element
    if kind not in _NUMBERS:
        raise ValueError(f"numbers of kind {kind}")
    return np.frombuffer(data, f"{order}{_NUMBERS[kind]}")
