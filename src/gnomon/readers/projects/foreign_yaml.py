"""YAML files of other programs, read leniently: what people and programs write that is almost YAML.

OpenCV begins a file with %YAML:1.0, with or without --- behind it, and writes matrices as mappings with a tag of its
own (!!opencv-matrix). People indent with tabs and leave a comma behind a row. Our own files are read strictly, by
`structured.read_yaml`.
"""

import re
from collections.abc import Iterator
from dataclasses import replace
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import FormatError
from ...recording import Floats, frozen_array
from ..structured import Node, parse_yaml, read_text

_ROW_WITH_COMMA = re.compile(r"^(\s*(?:-\s|[\w.]+\s*:).*[\]}])\s*,\s*(#.*)?$")
_TAB_WIDTHS = (2, 4, 8)

_NO_ROTATION = 0.02  # numbers typed by hand have few digits
_EXACT = 1e-14  # numbers with all their digits are left as they are
_FARTHEST_M = 100.0


def read_foreign_yaml(path: str | PathLike[str], notes: list[str] | None = None) -> Node:
    """Parse a YAML file of another program.

    Parameters
    ----------
    path : the file
    notes : where sentences on what was mended are appended

    Raises
    ------
    FormatError
        If the file cannot be read, is no YAML even so, or holds a key twice.
    """
    text = re.sub(r"(?m)^%", "#", read_text(path))
    try:
        return Node(file=str(path), path="", value=parse_yaml(text, path, any_tag=True))
    except FormatError as error:
        for value, said in _mended(text, path):
            if notes is not None:
                notes.append(f"{Path(path).name}: {said}")
            return Node(file=str(path), path="", value=value)
        raise error from None


def _mended(text: str, path: str | PathLike[str]) -> Iterator[tuple[Any, str]]:
    """Yield what the file holds without its usual mistakes, and a sentence on them; nothing where they are others."""
    lines = text.splitlines()
    without = [_without_comma(line) for line in lines]
    said = ["commas at the ends of rows"] if without != lines else []
    if "\t" not in text:
        values = _parsed(["\n".join(without)], path) if said else []
    else:
        # A file may mix tabs and spaces: then the width of a tab decides what belongs to what, which nobody knows.
        values = _parsed(["\n".join(without).expandtabs(width) for width in _TAB_WIDTHS], path)
        said.append("tabs")
    if values and all(value == values[0] for value in values):
        yield values[0], f"{' and '.join(said)}, which YAML does not allow, were passed over."


def _parsed(texts: list[str], path: str | PathLike[str]) -> list[Any]:
    """Return what those texts hold that are YAML."""
    values: list[Any] = []
    for text in texts:
        try:
            values.append(parse_yaml(text, path, any_tag=True))
        except FormatError:
            continue
    return values


def _without_comma(line: str) -> str:
    found = _ROW_WITH_COMMA.match(line)
    if found is None or any(found[1].count(a) != found[1].count(b) for a, b in ("[]", "{}")):
        return line
    return f"{found[1]} {found[2] or ''}"


def unwrapped(node: Node) -> Node:
    """Return the rows of a matrix that is written as OpenCV does (rows, cols, dt, data); anything else as it is.

    Raises
    ------
    FormatError
        If rows and cols do not fit the data.
    """
    if not (isinstance(node.value, dict) and "data" in node.value):
        return node
    values = [item.value for item in node.child("data").items()]
    rows, cols = (
        int(node.child(key).number()) if key in node.value else fallback
        for key, fallback in (("rows", 1), ("cols", len(values)))
    )
    if rows < 1 or cols < 1 or rows * cols != len(values):
        raise node.fail(f"rows {rows} and cols {cols} do not fit its {len(values)} numbers.")
    table = [values[i * cols : (i + 1) * cols] for i in range(rows)]
    return replace(node, value=table if min(rows, cols) > 1 else values)


def matrix(node: Node, rows: int, cols: int) -> Floats:
    """Return a matrix: a list of rows, of all numbers row by row, or a matrix of OpenCV's.

    Raises
    ------
    FormatError
        If it is another thing.
    """
    plain = unwrapped(node)
    if isinstance(plain.value, list) and len(plain.value) == rows * cols:
        return plain.floats(rows * cols).reshape(rows, cols)
    return plain.floats(rows, cols)


def rigid(node: Node) -> Floats:
    """Return a rigid transformation (4, 4); its rotation is made exact, since numbers in files are rounded.

    Raises
    ------
    FormatError
        If it is none.
    """
    T = matrix(node, 4, 4)
    if np.abs(T[3] - [0, 0, 0, 1]).max() > 1e-6:
        turned = " It seems to be transposed." if np.abs(T[:, 3] - [0, 0, 0, 1]).max() <= 1e-6 else ""
        raise node.fail(f"the last row of the matrix is {T[3].tolist()}, expected [0, 0, 0, 1].{turned}")
    exact = np.eye(4)
    exact[:3, :3] = _nearest_rotation(T[:3, :3], node, "its left upper 3x3 part")
    if np.abs(T[:3, 3]).max() > _FARTHEST_M:
        raise node.fail(f"found the translation {T[:3, 3].tolist()} m. The unit is the metre; was it in millimetres?")
    exact[:3, 3] = T[:3, 3]
    return frozen_array(exact)


def rotation(node: Node) -> Floats:
    """Return a rotation matrix (3, 3), made exact.

    Raises
    ------
    FormatError
        If it is none.
    """
    return frozen_array(_nearest_rotation(matrix(node, 3, 3), node, "this"))


def _nearest_rotation(R: Floats, node: Node, what: str) -> Floats:
    error = float(np.abs(R @ R.T - np.eye(3)).max()) if np.abs(R).max() < 2 else float(np.abs(R).max())
    if error > _NO_ROTATION:
        raise node.fail(
            f"{what} is no rotation matrix: its rows should be of length 1 and at right angles, and miss that by "
            f"{error:.2g}."
        )
    if np.linalg.det(R) < 0:
        raise node.fail(f"{what} is mirrored (determinant -1), which no rotation is. Is the sign of an axis wrong?")
    if error < _EXACT:
        return R
    u, _, v = np.linalg.svd(R)
    return u @ v
