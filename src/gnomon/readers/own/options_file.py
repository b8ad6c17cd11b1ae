"""Options as a YAML file: the fields of a frozen dataclass, such as a scenario; what is not in it keeps its default."""

from dataclasses import fields
from os import PathLike
from types import NoneType, UnionType
from typing import Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

from ...errors import OptionError
from ..structured import Node, read_yaml

Options = TypeVar("Options")


def read_options(path: str | PathLike[str], kind: type[Options]) -> Options:
    """Read options from a YAML file, as `writers.options_file` writes them.

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
    found = {name: _value(node, types[name]) for name, node in root.mapping(optional=names).items()}
    try:
        return kind(**found)
    except OptionError as error:
        raise root.fail(str(error)) from None


def _value(node: Node, kind: Any) -> Any:
    """Return the value of a node as a type hint wants it."""
    origin, arguments = get_origin(kind), get_args(kind)
    if origin in {Union, UnionType}:
        (wanted,) = (argument for argument in arguments if argument is not NoneType)
        return None if node.value is None else _value(node, wanted)
    if origin is Literal:
        return _choice(node, arguments)
    if origin is tuple:
        return _tuple(node, arguments)
    if kind is bool:
        if not isinstance(node.value, bool):
            raise node.fail(f"found {node.value!r}, expected true or false.")
        return node.value
    return {float: node.number, int: node.integer, str: node.text}[kind]()


def _choice(node: Node, choices: tuple[Any, ...]) -> Any:
    if all(isinstance(choice, str) for choice in choices):
        return node.text(choices)
    if node.integer() not in choices:
        raise node.fail(f"found {node.value}, expected {' or '.join(map(str, choices))}.")
    return node.value


def _tuple(node: Node, kinds: tuple[Any, ...]) -> tuple[Any, ...]:
    items = list(node.items())
    if len(kinds) == 2 and kinds[1] is Ellipsis:
        return tuple(_value(item, kinds[0]) for item in items)
    if len(items) != len(kinds):
        raise node.fail(f"found {len(items)} values, expected {len(kinds)}.")
    return tuple(_value(item, wanted) for item, wanted in zip(items, kinds, strict=True))
