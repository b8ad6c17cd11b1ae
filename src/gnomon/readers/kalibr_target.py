"""Kalibr's target.yaml: AprilGrid, checkerboard or grid of circles."""

from collections.abc import Callable
from os import PathLike
from typing import Any

from ..errors import OptionError
from ..models.target import Target
from .kalibr_yaml import file_hint, file_name, passed_over, required, whole_number
from .structured import Node, read_yaml

_LONGEST_M, _LARGEST_RATIO, _MOST = 10.0, 10.0, 1000
_USUAL_RATIO = (0.1, 1.0)  # gap between tags over their size; boards that people print have 0.2 to 0.5


def read_target(path: str | PathLike[str], notes: list[str] | None = None) -> Target:
    """Read a calibration board from Kalibr's target.yaml.

    Parameters
    ----------
    path : the file
    notes : where sentences on what was passed over, or looks unusual, are appended

    Raises
    ------
    FormatError
        If the file cannot be read, a key is missing, or a value makes no board.
    """
    root = read_yaml(path)
    keys = {node.key: node for node in root.entries()}
    if "target_type" not in keys:
        raise root.fail(f"the key target_type is missing. Expected one of {', '.join(_BOARDS)}.{file_hint(root)}")
    kind = _kind(keys["target_type"])
    make, values = _BOARDS[kind]
    arguments = {name: read(required(keys, key, root, _EXPECTED[read])) for key, (name, read) in values.items()}
    if kind == "circlegrid" and "asymmetricGrid" in keys:
        arguments["asymmetric"] = _flag(keys["asymmetricGrid"])
    try:
        target = make(**arguments)
    except OptionError as error:
        raise root.fail(str(error)) from None
    if notes is not None:
        known = {"target_type", *values, *(["asymmetricGrid"] if kind == "circlegrid" else [])}
        notes += _oddities(keys, kind)
        passed_over((node for key, node in keys.items() if key not in known and not _is_zero_offset(node)), notes)
    return target


def _kind(node: Node) -> str:
    stated = node.text()
    plain = "".join(letter for letter in stated.lower() if letter.isalnum())
    kind = {"chessboard": "checkerboard", "apriltaggrid": "aprilgrid", "circlesgrid": "circlegrid"}.get(plain, plain)
    if kind not in _BOARDS:
        raise node.fail(f'found "{stated}", expected one of {", ".join(_BOARDS)}.')
    return kind


def _count(node: Node) -> int:
    value = whole_number(node)
    if not 1 <= value <= _MOST:
        raise node.fail(f"found {value}, expected a count from 1 to {_MOST}.")
    return value


def _length(node: Node) -> float:
    value = _positive(node)
    if value > _LONGEST_M:
        raise node.fail(f"found {value:g} m, which no board has. The unit is the metre; was it given in millimetres?")
    return value


def _ratio(node: Node) -> float:
    value = _positive(node)
    if value > _LARGEST_RATIO:
        raise node.fail(f"found {value:g}, expected {_EXPECTED[_ratio]}, usually 0.3.")
    return value


def _positive(node: Node) -> float:
    value = node.number()
    if value <= 0:
        raise node.fail(f"found {value:g}, expected a number greater than zero.")
    return value


def _flag(node: Node) -> bool:
    if node.value not in (True, False):  # 0 and 1 are these, too
        raise node.fail(f"found {node.value!r}, expected true or false.")
    return bool(node.value)


_EXPECTED: dict[Callable[[Node], float], str] = {
    _count: "a count",
    _length: "a length in metres",
    _ratio: "the gap between two tags divided by their size",
}
_BOARDS: dict[str, tuple[Callable[..., Target], dict[str, tuple[str, Callable[[Node], Any]]]]] = {
    "aprilgrid": (
        Target.aprilgrid,
        {
            "tagCols": ("tag_cols", _count),
            "tagRows": ("tag_rows", _count),
            "tagSize": ("tag_size_m", _length),
            "tagSpacing": ("tag_spacing", _ratio),
        },
    ),
    "checkerboard": (
        Target.checkerboard,
        {
            "targetCols": ("cols", _count),
            "targetRows": ("rows", _count),
            "rowSpacingMeters": ("row_spacing_m", _length),
            "colSpacingMeters": ("col_spacing_m", _length),
        },
    ),
    "circlegrid": (
        Target.circlegrid,
        {"targetCols": ("cols", _count), "targetRows": ("rows", _count), "spacingMeters": ("spacing_m", _length)},
    ),
}


def _is_zero_offset(node: Node) -> bool:
    return node.key == "codeOffset" and node.value == 0


def _oddities(keys: dict[str, Node], kind: str) -> list[str]:
    if kind != "aprilgrid":
        return []
    spacing = keys["tagSpacing"]
    if _USUAL_RATIO[0] <= spacing.number() <= _USUAL_RATIO[1]:
        return []
    return [
        f"{file_name(spacing)}: tagSpacing {spacing.number():g} is unusual. It is the gap between two tags divided by "
        "the size of a tag, usually 0.3; was it given in metres?"
    ]
