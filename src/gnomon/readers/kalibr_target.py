"""Kalibr's target.yaml: AprilGrid, checkerboard or grid of circles."""

from collections.abc import Callable
from os import PathLike
from typing import Any

from ..errors import OptionError
from ..models.target import Target
from .foreign_yaml import read_foreign_yaml
from .kalibr_yaml import file_hint, file_name, passed_over, required, whole_number
from .structured import Node

_LONGEST_M, _LARGEST_RATIO, _MOST = 10.0, 10.0, 1000
_FIRST_TAG = ("codeOffset", "firstTag")  # of forks of Kalibr, and ours
_BORDER = "tagBorderBits"  # ours: Kalibr prints 2
_FAMILY = ("tagFamily", "tag_family")
_USUAL_RATIO = (0.1, 1.0)  # gap between tags over their size; boards that people print have 0.2 to 0.5


def read_target(path: str | PathLike[str], notes: list[str] | None = None) -> Target:
    """Read a calibration board from Kalibr's target.yaml.

    Beyond what Kalibr takes, tagBorderBits: 1 states a grid of plain AprilTags (Kalibr prints a border of 2), and
    codeOffset, or firstTag, the id of the tag at the lower left.

    Parameters
    ----------
    path : the file
    notes : where sentences on what was passed over, or looks unusual, are appended

    Raises
    ------
    FormatError
        If the file cannot be read, a key is missing, or a value makes no board.
    """
    said: list[str] = [] if notes is None else notes
    return target_of(read_foreign_yaml(path, said), said)


def target_of(root: Node, notes: list[str]) -> Target:
    """Return the board of a file that was parsed; see `read_target`.

    Raises
    ------
    FormatError
        If a key is missing, or a value makes no board.
    """
    keys = {node.key: node for node in root.entries()}
    if "target_type" not in keys:
        raise root.fail(f"the key target_type is missing. Expected one of {', '.join(_BOARDS)}.{file_hint(root)}")
    kind = _kind(keys["target_type"])
    make, values = _BOARDS[kind]
    arguments = {name: read(required(keys, key, root, _EXPECTED[read])) for key, (name, read) in values.items()}
    optional: tuple[str, ...] = ()
    if kind == "circlegrid":
        optional = ("asymmetricGrid",)
        if "asymmetricGrid" in keys:
            arguments["asymmetric"] = _flag(keys["asymmetricGrid"])
    if kind == "aprilgrid":
        optional = (*_FIRST_TAG, _BORDER, *_FAMILY)
        arguments |= _tags(keys, notes)
    try:
        target = make(**arguments)
    except OptionError as error:
        raise root.fail(str(error)) from None
    notes += _oddities(keys, kind)
    known = {"target_type", *values, *optional}
    passed_over((node for key, node in keys.items() if key not in known), notes)
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


def _tags(keys: dict[str, Node], notes: list[str]) -> dict[str, int]:
    """Return what is stated of the tags themselves."""
    found: dict[str, int] = {}
    stated = [keys[name] for name in _FIRST_TAG if name in keys]
    if stated:
        found["first_tag"] = whole_number(stated[0])
        if any(whole_number(node) != found["first_tag"] for node in stated) or found["first_tag"] < 0:
            raise stated[-1].fail(f"found {stated[-1].value}, expected one id from 0, of the tag at the lower left.")
    if _BORDER in keys:
        found["border_bits"] = whole_number(keys[_BORDER])
        if found["border_bits"] not in (1, 2):
            raise keys[_BORDER].fail(f"found {found['border_bits']}, expected 1 (plain tags) or 2 (Kalibr's).")
    notes += [
        f"{file_name(node)}: {node.path} is {node.value}; in images, only tags of 36h11 are found."
        for node in (keys[name] for name in _FAMILY if name in keys)
        if "36h11" not in str(node.value)
    ]
    return found


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
