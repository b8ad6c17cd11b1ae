"""The top of gnomon's own calibration file, in YAML or in JSON."""

import re
from dataclasses import replace
from os import PathLike
from pathlib import Path

from ..structured import Node, read_json, read_text, read_yaml

COMMENT = "comment"
_SCHEMA = re.compile(r"""(?m)^schema\s*:|"schema"\s*:\s*"gnomon""")


def is_own(path: str | PathLike[str]) -> bool:
    """Return whether a file, or the calibration in the folder of a result, says that it is gnomon's own."""
    return _SCHEMA.search(read_text(calibration_at(path))) is not None


def read_own(path: str | PathLike[str]) -> Node:
    """Parse calibration.yaml, that in the folder of a result, or calibration.json, whose comment is left out.

    Raises
    ------
    FormatError
        If the file cannot be read, or is neither YAML nor JSON.
    """
    path = calibration_at(path)
    if not read_text(path).lstrip().startswith("{"):
        return read_yaml(path)
    root = read_json(path)
    if not isinstance(root.value, dict):
        return root
    return replace(root, value={key: value for key, value in root.value.items() if key != COMMENT})  # pyright: ignore[reportUnknownVariableType, reportUnknownArgumentType]


def calibration_at(path: str | PathLike[str]) -> str | PathLike[str]:
    """Return the calibration in the folder of a result; anything else as it is."""
    inside = Path(path) / "calibration.yaml"
    return inside if Path(path).is_dir() and inside.is_file() else path
