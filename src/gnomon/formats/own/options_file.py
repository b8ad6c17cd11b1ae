"""Options as a YAML file: the fields of a frozen dataclass, such as a scenario; what is not in it keeps its default."""

from dataclasses import fields
from os import PathLike
from pathlib import Path
from typing import Any, TypeVar, cast, get_type_hints

import numpy as np

from ...errors import OptionError
from ...frozen import FrozenMapping
from ...options.requirements import QUANTITIES, Use, known_use, parse_sigma
from ..shared.structured import Node, read_yaml
from ..shared.typed_values import read_typed
from ..shared.yaml_text import yaml_lines

Options = TypeVar("Options")


def read_options(path: str | PathLike[str], kind: type[Options]) -> Options:
    """Read options from a YAML file, as `formats.own.options_file` writes them.

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
