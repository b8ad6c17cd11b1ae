"""Structured files as dataclasses, both ways: values as type hints say; options such as a scenario; what uses need."""

from collections.abc import Callable, Collection, Mapping
from dataclasses import MISSING, fields, is_dataclass
from functools import partial
from math import nan
from os import PathLike
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Literal, TypeVar, Union, cast, get_args, get_origin, get_type_hints

import numpy as np

from ...errors import OptionError
from ...frozen import FrozenMapping
from ...options.requirements import QUANTITIES, Use, known_use, parse_sigma
from ...recording import Floats
from ..shared.structured import Node, read_yaml
from ..shared.yaml_text import yaml_lines

Options = TypeVar("Options")


def read_options(path: str | PathLike[str], kind: type[Options]) -> Options:
    """Read options from a YAML file, as `options_text` writes them.

    Parameters
    ----------
    path : file with keys and values
    kind : dataclass of the options, such as `gnomon.CameraImuScenario`; its fields are the keys

    Raises
    ------
    FormatError
        If the file cannot be read, a key is unknown, or a value makes no sense; the message names the key.
    """
    root = read_yaml(path)
    types = get_type_hints(kind)
    names = [field.name for field in fields(kind)]  # pyright: ignore[reportArgumentType]
    found = {name: read_typed(node, types[name]) for name, node in root.mapping(optional=names).items()}
    try:
        return kind(**found)
    except OptionError as error:
        raise root.fail(str(error)) from None


def options_text(options: Any) -> str:
    """Return the YAML text of a dataclass of options: every field, also where it has its default.

    Numbers read back bit by bit, and the same options give the same bytes.
    """
    document = {field.name: _node(getattr(options, field.name)) for field in fields(options)}
    return "\n".join(yaml_lines(document)) + "\n"


def _node(value: Any) -> Any:
    """Return a value as `yaml_lines` takes it: numbers in a row as an array, everything else in a row as a list."""
    if not isinstance(value, tuple):
        return value
    items = cast("tuple[Any, ...]", value)
    if items and all(isinstance(item, int | float) for item in items):
        return np.array(items)
    return [_node(item) for item in items]


def read_use(use: str | PathLike[str]) -> Use:
    """Return a built-in use by its name, or read one from a file.

    Raises
    ------
    OptionError
        If there is neither such a use nor such a file.
    FormatError
        If the file cannot be read, or states an unknown quantity or unit; the message names it.
    """
    path = Path(use)
    if not path.exists() and path.suffix not in (".yaml", ".yml"):
        return known_use(str(use))
    root = read_yaml(path)
    keys = root.mapping(optional=("name", "fails_at", *QUANTITIES))
    needs = {name: _read_need(node) for name, node in keys.items() if name in QUANTITIES}
    if not needs:
        raise root.fail(f"no quantity is stated. Known: {', '.join(QUANTITIES)}.")
    fails_at = keys["fails_at"].number() if "fails_at" in keys else 3.0
    if not fails_at > 1:
        raise keys["fails_at"].fail(f"found {fails_at:g}, expected a number above 1.")
    name = keys["name"].text() if "name" in keys else path.stem
    return Use(name=name, words=name, needs=FrozenMapping(needs), fails_at=fails_at)


def _read_need(node: Node) -> float:
    try:
        return parse_sigma(node.key, str(node.value))
    except OptionError as error:
        raise node.fail(str(error).partition(": ")[2]) from None


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
