"""MATLAB's MAT files (versions 5 to 7) as tables: arrays of samples, vectors, matrices, and structs of them."""

from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import orjson
from numpy.typing import NDArray

from ..errors import RecordingError
from ..formats.shared.structured import shorten_text
from .files import TextFile, file_source
from .mat5 import read_mat
from .samples.column_names import column_name

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
