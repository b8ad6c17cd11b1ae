"""MATLAB's MAT files (versions 5 to 7) as tables: arrays of samples, vectors, matrices, and structs of them.

MAT files of version 5 to 7: arrays of numbers and structs of them, the rest passed over.

After MathWorks, "MAT-File Format" (version 5). SciPy's reader is not used: damaged files end the program in it.
"""

import struct
import zlib
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import orjson
from numpy.typing import NDArray

from ..errors import RecordingError
from ..formats.shared.structured import shorten_text
from .files import TextFile, bomb_error, file_source, first_bytes, largest_unpacked
from .samples.column_names import column_name

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


_SAVE = "Save arrays of numbers, such as save('log.mat', 't', 'acc', 'gyro', '-v7'), with one row a sample."


def read_mat_table(path: Path) -> TextFile:
    """Read a MAT file as a table of text, whose header names the arrays and their columns.

    Raises
    ------
    RecordingError
        If it is damaged, or holds no arrays of one length.
    """
    try:
        loaded = read_mat(path)
    except RecordingError as error:
        raise RecordingError(f"{error} {_SAVE}") from None
    arrays: dict[str, NDArray[Any]] = {}
    _flatten(loaded, "", arrays)
    lengths = Counter(len(array) for array in arrays.values() if array.ndim and len(array) > 1)
    if not lengths:
        listed = ", ".join(key for key in loaded if not key.startswith("__"))[:200] or "nothing"
        raise RecordingError(
            f"{path.name}: no arrays of samples in it (found {listed}); tables and timetables are objects that only "
            f"MATLAB reads. {_SAVE}"
        )
    count = max(lengths, key=lambda length: (lengths[length], length))
    rows = {key: array for key, array in arrays.items() if array.ndim and len(array) == count}
    if any(_is_triad(key) and len(array) != count for key, array in arrays.items() if array.ndim):
        shapes = ", ".join(f"{key} {array.shape}" for key, array in arrays.items())[:300]
        raise RecordingError(f"{path.name}: its arrays have different lengths ({shapes}). {_SAVE}")
    names = [name for key, array in rows.items() for name in _column_names(key, array)]
    matrix = np.column_stack([array.astype(np.float64) for array in rows.values()])
    text = orjson.dumps(np.ascontiguousarray(matrix), option=orjson.OPT_SERIALIZE_NUMPY)
    body = text[2:-2].replace(b"],[", b"\n").replace(b"null", b"nan") + b"\n"
    scalars = "".join(f"{key},{float(array):.17g}\n" for key, array in arrays.items() if not array.ndim)
    named = len(rows) > 1 or _is_triad(next(iter(rows)))
    return TextFile(
        name=path.name,
        data=scalars.encode() + body,  # a rate is among the scalars, such as Fs
        source=file_source(path),
        header=tuple(names) if named else (),
        notes=(f"{path.name}: its columns are {shorten_text(', '.join(names))}.",),
    )


def _flatten(loaded: dict[str, Any], prefix: str, arrays: dict[str, NDArray[Any]]) -> None:
    for key, value in loaded.items():
        if key.startswith("__"):
            continue
        if isinstance(value, dict):
            _flatten(value, f"{prefix}{key}.", arrays)  # pyright: ignore[reportUnknownArgumentType]
            continue
        array = np.asarray(value) if isinstance(value, int | float | np.ndarray | np.generic) else None
        if array is None or array.dtype.kind not in "fiub" or array.ndim > 2 or not array.size:
            continue
        arrays[prefix + key] = (
            array.T if array.ndim == 2 and array.shape[0] in (3, 6, 7) and array.shape[1] > 7 else array
        )


def _is_triad(key: str) -> bool:
    return column_name(_axis_name(key, "x")).axis is not None


def _axis_name(key: str, axis: str) -> str:
    group, _, leaf = key.rpartition(".")
    head, _, tail = leaf.partition("_")
    return f"{group} {head}_{axis}_{tail}".strip()  # "acc_g" is named like its columns, "acc_x_g"


def _column_names(key: str, array: NDArray[Any]) -> list[str]:
    if array.ndim == 1:
        return [key]
    if array.shape[1] == 3:
        return [_axis_name(key, axis) for axis in "xyz"]
    return [f"{key}({i + 1})" for i in range(array.shape[1])]
