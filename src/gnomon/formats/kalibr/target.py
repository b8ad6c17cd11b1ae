"""Kalibr's target.yaml: AprilGrid, checkerboard or grid of circles; and ChArUco boards in its manner."""

from collections.abc import Callable, Iterator
from os import PathLike
from typing import Any

from ...errors import OptionError
from ...models.target import Target
from ..shared.foreign_yaml import file_hint, file_name, passed_over, read_foreign_yaml, required_value, whole_number
from ..shared.structured import Node
from ..shared.yaml_text import yaml_lines

DICTIONARIES = (
    *(f"{bits}X{bits}_{count}" for bits in (4, 5, 6, 7) for count in (50, 100, 250, 1000)),
    "ARUCO_ORIGINAL",
    *(f"APRILTAG_{code}" for code in ("16h5", "25h9", "36h10", "36h11")),
    "ARUCO_MIP_36h12",
)
"""OpenCV's names of families of markers, without DICT_."""
_LONGEST_M, _LARGEST_RATIO, _MOST = 10.0, 10.0, 1000
_FIRST_TAG = ("codeOffset", "firstTag")  # of forks of Kalibr, and ours
_BORDER = "tagBorderBits"  # ours: Kalibr prints 2
_FAMILY = ("tagFamily", "tag_family")
_MARKERS = ("firstMarker", "legacyPattern")  # of a ChArUco board, optional
_OPENCV = {
    "squaresX": "squareCols",
    "squaresY": "squareRows",
    "squareLength": "squareSize",
    "markerLength": "markerSize",
}
_USUAL_RATIO = (0.1, 1.0)  # gap between tags over their size; boards that people print have 0.2 to 0.5


def read_target(path: str | PathLike[str], notes: list[str] | None = None) -> Target:
    """Read a calibration board from Kalibr's target.yaml.

    Beyond what Kalibr takes, tagBorderBits: 1 states a grid of plain AprilTags (Kalibr prints a border of 2), and
    codeOffset, or firstTag, the id of the tag at the lower left. A ChArUco board, which Kalibr does not know, has
    squareCols, squareRows (squares, not corners), squareSize, markerSize, dictionary, and where they are not 0 and
    false, firstMarker and legacyPattern; OpenCV's names squaresX, squaresY, squareLength and markerLength are taken,
    too.

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
    if kind == "charuco":
        keys = _with_usual_names(keys)
    make, values = _BOARDS[kind]
    arguments = {name: read(required_value(keys, key, root, _EXPECTED[read])) for key, (name, read) in values.items()}
    optional: tuple[str, ...] = ()
    if kind == "circlegrid":
        optional = ("asymmetricGrid",)
        if "asymmetricGrid" in keys:
            arguments["asymmetric"] = _flag(keys["asymmetricGrid"])
    if kind == "aprilgrid":
        optional = (*_FIRST_TAG, _BORDER, *_FAMILY)
        arguments |= _tags(keys, notes)
    if kind == "charuco":
        optional = _MARKERS
        arguments |= _markers(keys)
    try:
        target = make(**arguments)
    except OptionError as error:
        raise root.fail(str(error)) from None
    notes += _oddities(keys, kind)
    known = {"target_type", *values, *optional}
    passed_over((node for key, node in keys.items() if key not in known), notes)
    return target


_ALSO = {
    "chessboard": "checkerboard",
    "apriltaggrid": "aprilgrid",
    "circlesgrid": "circlegrid",
    "charucoboard": "charuco",
    "charucogrid": "charuco",
}


def _kind(node: Node) -> str:
    stated = node.text()
    plain = "".join(letter for letter in stated.lower() if letter.isalnum())
    kind = _ALSO.get(plain, plain)
    if kind not in _BOARDS:
        raise node.fail(f'found "{stated}", expected one of {", ".join(_BOARDS)}.')
    return kind


def dictionary_name(stated: str) -> str:
    """Return OpenCV's name of a family of markers without DICT_, however it is written.

    Raises
    ------
    OptionError
        If there is no such family.
    """
    known = {each.upper(): each for each in DICTIONARIES}
    name = stated.strip().upper().removeprefix("DICT_")
    if name not in known:
        raise OptionError(f'dictionary "{stated}": expected one of {", ".join(DICTIONARIES)}.')
    return known[name]


def _dictionary(node: Node) -> str:
    try:
        return dictionary_name(node.text())
    except OptionError as error:
        raise node.fail(str(error)) from None


def _count(node: Node) -> int:
    value = whole_number(node)
    if not 1 <= value <= _MOST:
        raise node.fail(f"found {value}, expected a count from 1 to {_MOST}.")
    return value


def _squares(node: Node) -> int:
    return _count(node)


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


_EXPECTED: dict[Callable[[Node], Any], str] = {
    _count: "a count",
    _squares: "a count of squares, which is one more than that of inner corners",
    _length: "a length in metres",
    _ratio: "the gap between two tags divided by their size",
    _dictionary: "the name of OpenCV's dictionary of the markers, such as 4X4_50",
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
    "charuco": (
        Target.charuco,
        {
            "squareCols": ("cols", _squares),
            "squareRows": ("rows", _squares),
            "squareSize": ("square_size_m", _length),
            "markerSize": ("marker_size_m", _length),
            "dictionary": ("dictionary", _dictionary),
        },
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


def _with_usual_names(keys: dict[str, Node]) -> dict[str, Node]:
    """Return the keys of a ChArUco board with those of OpenCV under the names of this file."""
    for other, usual in _OPENCV.items():
        if other in keys and usual in keys and keys[other].value != keys[usual].value:
            raise keys[other].fail(f"{usual} and {other} mean the same and differ.")
    return {_OPENCV.get(key, key): node for key, node in keys.items()}


def _markers(keys: dict[str, Node]) -> dict[str, int]:
    """Return what is stated of the markers beyond their size."""
    found: dict[str, int] = {}
    if "firstMarker" in keys:
        found["first_marker"] = whole_number(keys["firstMarker"])
        if found["first_marker"] < 0:
            raise keys["firstMarker"].fail(f"found {found['first_marker']}, expected an id from 0, at the upper left.")
    if "legacyPattern" in keys:
        found["legacy"] = _flag(keys["legacyPattern"])
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


def target_text(target: Target) -> str:
    """Return the text of target.yaml, with lengths in metres."""
    return "\n".join(target_lines(target)) + "\n"


def target_lines(target: Target) -> tuple[str, ...]:
    """Return the lines of target.yaml; they are the caption of a printed board."""
    return tuple(yaml_lines({"target_type": target.kind} | _board(target)))


def _board(target: Target) -> dict[str, Any]:
    if target.kind == "aprilgrid":
        node = {"tagCols": target.cols, "tagRows": target.rows, "tagSize": target.tag_size_m}
        node |= {"tagSpacing": target.tag_spacing}
        plain = {"tagBorderBits": target.border_bits} if target.border_bits != 2 else {}
        return node | plain | ({"codeOffset": target.first_tag} if target.first_tag else {})
    if target.kind == "charuco":
        node = {"squareCols": target.cols, "squareRows": target.rows, "squareSize": target.square_size_m}
        node |= {"markerSize": target.marker_size_m, "dictionary": target.dictionary}
        first = {"firstMarker": target.first_tag} if target.first_tag else {}
        return node | first | ({"legacyPattern": True} if target.legacy else {})
    node = {"targetCols": target.cols, "targetRows": target.rows}
    if target.kind == "checkerboard":
        return node | {"rowSpacingMeters": target.row_spacing_m, "colSpacingMeters": target.col_spacing_m}
    return node | {"spacingMeters": target.spacing_m, "asymmetricGrid": target.asymmetric}


def board_lines(target: Target) -> Iterator[str]:
    """Yield the lines on the board."""
    yield f"  Type: {target.kind}"
    if target.kind == "aprilgrid":
        yield from ("  Tags: ", f"    Rows: {target.rows}", f"    Cols: {target.cols}")
        yield f"    Size: {float(target.tag_size_m)} [m]"
        yield f"    Spacing {float(target.tag_size_m * target.tag_spacing)} [m]"
        return
    if target.kind == "charuco":  # of which Kalibr knows nothing
        yield from ("  Squares: ", f"    Rows: {target.rows}", f"    Cols: {target.cols}")
        yield f"    Size: {float(target.square_size_m)} [m]"
        yield from ("  Markers: ", f"    Marker size: {float(target.marker_size_m)} [m]")
        yield from (f"    Dictionary: {target.dictionary}", f"    First: {target.first_tag}")
        yield f"    Legacy: {'yes' if target.legacy else 'no'}"
        return
    checkerboard = target.kind == "checkerboard"
    row, col = (target.row_spacing_m, target.col_spacing_m) if checkerboard else (target.spacing_m,) * 2
    yield from ("  Rows", f"    Count: {target.rows}", f"    Distance: {float(row)} [m]")
    yield from ("  Cols", f"    Count: {target.cols}", f"    Distance: {float(col)} [m]")
