"""The top of gnomon's own calibration file, in YAML or in JSON."""

import re
from dataclasses import replace
from os import PathLike

from ..structured import Node, read_json, read_text, read_yaml

COMMENT = "comment"
_SCHEMA = re.compile(r"""(?m)^schema\s*:|"schema"\s*:\s*"gnomon""")


def is_own(path: str | PathLike[str]) -> bool:
    """Return whether a file says that it is gnomon's own."""
    return _SCHEMA.search(read_text(path)) is not None


def read_own(path: str | PathLike[str]) -> Node:
    """Parse calibration.yaml, or calibration.json, whose comment is left out.

    Raises
    ------
    FormatError
        If the file cannot be read, or is neither YAML nor JSON.
    """
    if not read_text(path).lstrip().startswith("{"):
        return read_yaml(path)
    root = read_json(path)
    if not isinstance(root.value, dict):
        return root
    return replace(root, value={key: value for key, value in root.value.items() if key != COMMENT})  # pyright: ignore[reportUnknownVariableType, reportUnknownArgumentType]
