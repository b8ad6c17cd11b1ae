"""Values of a structured file as type hints say: numbers, texts, choices, tuples, mappings, and classes of such."""

from collections.abc import Callable, Collection, Mapping
from dataclasses import MISSING, fields, is_dataclass
from functools import partial
from math import nan
from types import NoneType, UnionType
from typing import Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np

from ...frozen import FrozenMapping
from ...recording import Floats
from .structured import Node

Class = TypeVar("Class")


def read_class(
    node: Node,
    kind: type[Class],
    *,
    optional: Collection[str] | None = None,
    own: Mapping[str, Callable[[Node], Any]] = FrozenMapping({}),
) -> Class:
    """Return keys and values as a dataclass whose fields are the keys.

    Parameters
    ----------
    optional : fields that need not be stated; those with a default where None
    own : field -> what reads it, where its type hint does not say all; fields that follow from others are left out

    Raises
    ------
    FormatError
        If a key is missing or unknown, or a value is not as its type hint says.
    """
    types = get_type_hints(kind)
    entries = fields(kind)  # pyright: ignore[reportArgumentType]
    derived = {one.name for one in entries if not one.init}
    if optional is None:
        optional = [one.name for one in entries if (one.default, one.default_factory) != (MISSING, MISSING)]
    required = [one.name for one in entries if one.name not in derived.union(optional)]
    found = node.mapping(required, (*optional, *derived))
    keys = {name: item for name, item in found.items() if name not in derived}
    readers = {name: partial(read_typed, kind=types[name]) for name in keys} | dict(own)
    return kind(**{name: readers[name](item) for name, item in keys.items()})


def read_typed(node: Node, kind: Any) -> Any:
    """Return the value of a node as a type hint wants it.

    Raises
    ------
    FormatError
        If it is another thing.
    """
    origin, arguments = get_origin(kind), get_args(kind)
    if origin in {Union, UnionType}:
        (wanted,) = (argument for argument in arguments if argument is not NoneType)
        return None if node.value is None else read_typed(node, wanted)
    if origin is Literal:
        return _choice(node, arguments)
    if origin is tuple:
        return _tuple(node, arguments)
    if origin is Mapping:
        return {item.key: read_typed(item, arguments[1]) for item in node.entries()}
    if is_dataclass(kind):
        return read_class(node, kind)  # pyright: ignore[reportArgumentType]
    plain = {float: Node.number, int: Node.integer, str: Node.text, bool: _truth, np.ndarray: _numbers}
    return plain[origin or kind](node)


def number_or_nan(node: Node) -> float:
    """Return a number; nan where it says null."""
    return nan if node.value is None else node.number()


def _numbers(node: Node) -> Floats:
    return np.array([_numbers(item) if isinstance(item.value, list) else number_or_nan(item) for item in node.items()])


def _truth(node: Node) -> bool:
    if not isinstance(node.value, bool):
        raise node.fail(f"found {node.value!r}, expected true or false.")
    return node.value


def _choice(node: Node, choices: tuple[Any, ...]) -> Any:
    if all(isinstance(choice, str) for choice in choices):
        return node.text(choices)
    if node.integer() not in choices:
        raise node.fail(f"found {node.value}, expected {' or '.join(map(str, choices))}.")
    return node.value


def _tuple(node: Node, kinds: tuple[Any, ...]) -> tuple[Any, ...]:
    items = list(node.items())
    if len(kinds) == 2 and kinds[1] is Ellipsis:
        return tuple(read_typed(item, kinds[0]) for item in items)
    if len(items) != len(kinds):
        raise node.fail(f"found {len(items)} values, expected {len(kinds)}.")
    return tuple(read_typed(item, wanted) for item, wanted in zip(items, kinds, strict=True))
