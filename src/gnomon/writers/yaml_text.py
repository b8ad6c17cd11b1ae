"""YAML text, made by hand: matrices row by row, numbers that read back bit by bit, always the same bytes."""

import math
import re
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from ..recording import Floats

_PLAIN = re.compile(r"[A-Za-z/][\w/.^-]*", re.ASCII)
_WORDS_OF_YAML = {"true", "false", "yes", "no", "on", "off", "null", "y", "n"}


def yaml_lines(node: Mapping[str, Any], indent: str = "", *, flush: bool = False) -> Iterator[str]:
    """Yield the lines of a mapping of mappings, lists, arrays and scalars; `flush` sets lists right below their key."""
    for key, value in node.items():
        yield from _entry(f"{indent}{quoted(key)}:", value, indent, flush=flush)


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
                yield f"{place}- {_flow(item) if isinstance(item, np.ndarray) else scalar(item)}"
    else:
        yield f"{head} {scalar(value)}"


def _flow(values: Floats) -> str:
    return f"[{', '.join(map(scalar, values.tolist()))}]"


def scalar(value: Any) -> str:
    """Return the YAML text of a scalar, or of an empty mapping or list; numbers read back bit by bit."""
    if isinstance(value, float):
        if not math.isfinite(value):
            return ".nan" if math.isnan(value) else (".inf" if value > 0 else "-.inf")
        text = repr(float(value))
        # YAML 1.1 takes a number for text where the dot is missing before the exponent.
        return text if "e" not in text or "." in text else text.replace("e", ".0e")
    if isinstance(value, str):
        return quoted(value)
    if value is None:
        return "null"
    if isinstance(value, bool):
        return "true" if value else "false"
    return str(value)


def quoted(text: str) -> str:
    """Return a text for YAML: as it is where that is plain, else between double quotes with escapes."""
    if _PLAIN.fullmatch(text) and text.lower() not in _WORDS_OF_YAML:
        return text
    return in_quotes(text)


def in_quotes(text: str) -> str:
    """Return a text between double quotes, with escapes for what would end it or the line."""
    return '"' + "".join(_escaped(c) for c in text) + '"'


def _escaped(c: str) -> str:
    if c in '"\\':
        return f"\\{c}"
    if c.isprintable():
        return c
    code = ord(c)
    if 0xD800 <= code <= 0xDFFF:  # an undecodable byte of a file name, which no text file can hold
        return "\N{REPLACEMENT CHARACTER}"
    return f"\\x{code:02x}" if code < 0x100 else f"\\u{code:04x}" if code < 0x10000 else f"\\U{code:08x}"
