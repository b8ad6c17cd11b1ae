"""YAML text, made by hand, always the same bytes: gnomon's own layout, Kalibr's, and OpenCV's.

Matrices stand row by row, and numbers read back bit by bit. Kalibr's keys are in alphabetical order, with matrices as
lists of rows right below their key. OpenCV wants %YAML:1.0 first, matrices by rows, cols and data, and a point in every
real number.
"""

import math
import re
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from ...recording import Floats

_PLAIN = re.compile(r"[A-Za-z/][\w/.^-]*", re.ASCII)
_WORDS_OF_YAML = {"true", "false", "yes", "no", "on", "off", "null", "y", "n"}


def yaml_lines(node: Mapping[str, Any], indent: str = "", *, flush: bool = False) -> Iterator[str]:
    """Yield the lines of a mapping of mappings, lists, arrays and scalars; `flush` sets lists right below their key."""
    for key, value in node.items():
        yield from _entry(f"{indent}{yaml_quoted(key)}:", value, indent, flush=flush)


def _entry(head: str, value: Any, indent: str, *, flush: bool) -> Iterator[str]:
    deeper = indent + "  "
    if isinstance(value, Mapping) and value:
        yield head
        yield from yaml_lines(value, deeper, flush=flush)
    elif isinstance(value, np.ndarray) and value.ndim == 1:
        yield f"{head} {_flow(value)}"
    elif isinstance(value, list | np.ndarray) and len(value):
        yield head
        place = indent if flush else deeper
        for item in value:
            if isinstance(item, dict):
                first, *others = yaml_lines(item)
                yield f"{place}- {first}"
                yield from (f"{place}  {line}" for line in others)
            else:
                yield f"{place}- {_flow(item) if isinstance(item, np.ndarray) else yaml_scalar(item)}"
    else:
        yield f"{head} {yaml_scalar(value)}"


def _flow(values: Floats) -> str:
    return f"[{', '.join(map(yaml_scalar, values.tolist()))}]"


def yaml_scalar(value: Any) -> str:
    """Return the YAML text of a scalar, or of an empty mapping or list; numbers read back bit by bit."""
    if isinstance(value, float):
        if not math.isfinite(value):
            return ".nan" if math.isnan(value) else (".inf" if value > 0 else "-.inf")
        text = repr(float(value))
        # YAML 1.1 takes a number for text where the dot is missing before the exponent.
        return text if "e" not in text or "." in text else text.replace("e", ".0e")
    if isinstance(value, str):
        return yaml_quoted(value)
    if value is None:
        return "null"
    if isinstance(value, bool):
        return "true" if value else "false"
    return str(value)


def yaml_quoted(text: str) -> str:
    """Return a text for YAML: as it is where that is plain, else between double quotes with escapes."""
    if _PLAIN.fullmatch(text) and text.lower() not in _WORDS_OF_YAML:
        return text
    return in_quotes(text)


def in_quotes(text: str) -> str:
    """Return a text between double quotes, with escapes for what would end it or the line."""
    plain = text.isprintable() and '"' not in text and "\\" not in text
    return f'"{text if plain else "".join(map(_escaped, text))}"'


def _escaped(c: str) -> str:
    if c in '"\\':
        return f"\\{c}"
    if c.isprintable():
        return c
    code = ord(c)
    if 0xD800 <= code <= 0xDFFF:  # an undecodable byte of a file name, which no text file can hold
        return "\N{REPLACEMENT CHARACTER}"
    return f"\\x{code:02x}" if code < 0x100 else f"\\u{code:04x}" if code < 0x10000 else f"\\U{code:08x}"


def kalibr_yaml(document: Mapping[str, Any], *, flush: bool = True) -> str:
    """Return a document as Kalibr writes it; without `flush` its lists are indented, as OpenCV demands it."""
    return "\n".join(yaml_lines(_sorted(document), flush=flush)) + "\n"


def _sorted(node: Mapping[str, Any]) -> dict[str, Any]:
    return {key: _sorted(value) if isinstance(value, Mapping) else value for key, value in sorted(node.items())}


FIRST_LINE = "%YAML:1.0\n---\n"


def opencv_text(document: Mapping[str, Any]) -> str:
    """Return keys and values: texts, numbers, vectors, matrices, mappings and lists of mappings."""
    return "".join(f"{line}\n" for line in _opencv_lines(document))


def _opencv_lines(document: Mapping[str, Any], indent: str = "") -> Iterator[str]:
    for key, value in document.items():
        head = f"{indent}{key}:"
        if isinstance(value, Mapping):
            yield head
            yield from _opencv_lines(value, indent + "   ")
        elif isinstance(value, list):
            yield head
            for item in value:
                first, *others = _opencv_lines(item)
                yield f"{indent}   - {first}"
                yield from (f"{indent}     {line}" for line in others)
        elif isinstance(value, np.ndarray):
            yield f"{head} {yaml_flow(value)}"
        elif isinstance(value, str):
            yield f"{head} {in_quotes(value)}"
        else:
            yield f"{head} {yaml_scalar(value)}"


def opencv_matrix(key: str, matrix: Floats, kind: str) -> str:
    """Return one of OpenCV's matrices.

    Parameters
    ----------
    matrix : (r, c)
    kind : "d" for double, "f" for float
    """
    rows, cols = matrix.shape
    numbers = ",\n          ".join(", ".join(map(yaml_scalar, row)) for row in matrix.tolist())
    return f"{key}: !!opencv-matrix\n   rows: {rows}\n   cols: {cols}\n   dt: {kind}\n   data: [{numbers}]\n"


def yaml_flow(values: Floats) -> str:
    """Return numbers (n,) or (r, c), row by row, between brackets."""
    return f"[{', '.join(map(yaml_scalar, values.ravel().tolist()))}]"
