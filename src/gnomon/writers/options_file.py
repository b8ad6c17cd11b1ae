"""Options -> YAML text; `readers.own.options_file` reads it."""

from dataclasses import fields
from typing import Any, cast

import numpy as np

from .yaml_text import yaml_lines


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
