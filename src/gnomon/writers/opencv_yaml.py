"""YAML as OpenCV reads it: %YAML:1.0 first, matrices by rows, cols and data, every real number with a point."""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from ..recording import Floats
from .yaml_text import in_quotes, scalar

FIRST_LINE = "%YAML:1.0\n---\n"


def opencv_lines(document: Mapping[str, Any], indent: str = "") -> Iterator[str]:
    """Yield the lines of keys and values: texts, numbers, vectors, matrices, mappings and lists of mappings."""
    for key, value in document.items():
        head = f"{indent}{key}:"
        if isinstance(value, Mapping):
            yield head
            yield from opencv_lines(value, indent + "   ")
        elif isinstance(value, list):
            yield head
            for item in value:
                first, *others = opencv_lines(item)
                yield f"{indent}   - {first}"
                yield from (f"{indent}     {line}" for line in others)
        elif isinstance(value, np.ndarray):
            yield f"{head} {flow(value)}"
        elif isinstance(value, str):
            yield f"{head} {in_quotes(value)}"
        else:
            yield f"{head} {scalar(value)}"


def opencv_matrix(key: str, matrix: Floats, kind: str) -> Iterator[str]:
    """Yield the lines of one of OpenCV's matrices.

    Parameters
    ----------
    matrix : (r, c)
    kind : "d" for double, "f" for float
    """
    rows, cols = matrix.shape
    yield f"{key}: !!opencv-matrix"
    yield from (f"   rows: {rows}", f"   cols: {cols}", f"   dt: {kind}")
    for i, row in enumerate(matrix.tolist()):
        numbers = ", ".join(map(scalar, row))
        yield f"   {'data: [' if i == 0 else '       '}{numbers}{']' if i == rows - 1 else ','}"


def flow(values: Floats) -> str:
    """Return numbers (n,) or (r, c), row by row, between brackets."""
    return f"[{', '.join(map(scalar, values.ravel().tolist()))}]"
