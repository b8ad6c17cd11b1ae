"""What is printed on a calibration board: outlines of black areas in its plane.

The tags are those of AprilTag's family 36h11, whose codes OpenCV knows: it draws them with a border of 1 bit, turned by
180 degrees against Kalibr's boards.
"""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from ..errors import OptionError
from ..frozen import value_class
from .target import Floats, Integers, Target

Cells = NDArray[np.bool_]

TAG_BITS = 6
"""Bits along a side of a tag's code."""

_MARGIN = 2.0  # white beyond the outermost tags, over the gap of an AprilGrid
_RIM = 0.5  # white beyond the outermost squares or circles, over their distance
_RADIUS = 0.3  # of a disc, over the distance of neighbours
_SIDES = 96  # of the polygon that stands for a disc
_ONE = np.ones((1, 1), dtype=np.bool_)


@value_class
class BoardPattern:
    """Black on white in the plane of a board, in the frame of its points.

    Attributes
    ----------
    edges : (n, 4) directed straight pieces of the outlines of all that is black, x0, y0, x1, y1 [m]; black is to their
        left, where x is to the right and y up
    area : (n,) number of the tag, square or disc whose outline an edge is part of: those of one area are closed
    sheet : (4,) the board itself x0, y0, x1, y1 [m]; white where nothing is printed
    """

    edges: Floats
    area: Integers
    sheet: Floats

    def __post_init__(self) -> None:
        for name, kind in (("edges", np.float64), ("area", np.int64), ("sheet", np.float64)):
            array = np.array(getattr(self, name), dtype=kind)
            array.flags.writeable = False
            object.__setattr__(self, name, array)


def board_pattern(target: Target, *, margin_m: float | None = None, corner_squares: bool | None = None) -> BoardPattern:
    """Return what is printed on a board.

    Parameters
    ----------
    target : the board; of a checkerboard the square before the first point, on the side of lower x and y, is black
    margin_m : width of the white rim beyond the outermost tags, squares or circles [m]; by default two gaps of an
        AprilGrid, half a square of a checkerboard and half the distance of neighbours of a circle grid
    corner_squares : whether an AprilGrid has black squares in the corners between its tags; by default only with a
        border of 2 bits, as Kalibr prints it

    Raises
    ------
    OptionError
        If the family of the tags, or the dictionary of the markers, has not as many of them.
    """
    if target.kind == "aprilgrid":
        areas = _tags(target, corner_squares)
        outer, rim_m = np.zeros(2), _MARGIN * target.tag_spacing * target.tag_size_m
    elif target.kind == "checkerboard":
        outer = np.array([target.row_spacing_m, target.col_spacing_m])  # rows of points run along x
        areas, rim_m = _squares(target, outer), _RIM * float(outer.max())
    elif target.kind == "charuco":
        outer, rim_m = np.full(2, target.square_size_m), _RIM * target.square_size_m
        areas = _charuco(target)
    else:
        apart_m = target.spacing_m * (np.sqrt(2) if target.asymmetric else 1.0)
        outer, rim_m = np.full(2, _RADIUS * apart_m), _RIM * apart_m
        areas = _discs(target.points[:, :2], _RADIUS * apart_m)
    rim = outer + (rim_m if margin_m is None else margin_m)
    low, high = target.points[:, :2].min(axis=0) - rim, target.points[:, :2].max(axis=0) + rim
    return BoardPattern(
        edges=np.concatenate(areas),
        area=np.repeat(np.arange(len(areas)), [len(edges) for edges in areas]),
        sheet=np.concatenate([low, high]),
    )


@lru_cache(maxsize=1)
def tag_codes() -> Cells:
    """Return the codes of the family 36h11, (587, 6, 6): white bits, as OpenCV draws them, top row first."""
    import cv2

    family = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    side = TAG_BITS + 2
    images = [cv2.aruco.generateImageMarker(family, tag, side) for tag in range(len(family.bytesList))]
    return np.array(images)[:, 1:-1, 1:-1] > 0


def tag_cells(tag: int, border_bits: int) -> Cells:
    """Return the cells of a tag as Kalibr prints it, white ones true; top row first, its border included.

    Raises
    ------
    OptionError
        If the family 36h11 has no such tag.
    """
    codes = tag_codes()
    if not 0 <= tag < len(codes):
        raise OptionError(f"there is no tag {tag} in the family 36h11; it has tags 0 to {len(codes) - 1}.")
    return np.pad(np.rot90(codes[tag], 2), border_bits)


def _tags(target: Target, corner_squares: bool | None) -> list[Floats]:
    """Return the outlines of the black of each tag, and of the squares between them."""
    border, first = target.border_bits, target.first_tag
    size, gap = target.tag_size_m, target.tag_spacing * target.tag_size_m
    cell = np.full(2, size / (TAG_BITS + 2 * border))
    areas: list[Floats] = []
    for tag in range(target.tags):
        row, col = divmod(tag, target.cols)
        areas.append(_outline(~tag_cells(first + tag, border)[::-1], np.array([col, row]) * (size + gap), cell))
    if border == 2 if corner_squares is None else corner_squares:
        for row, col in np.ndindex(target.rows + 1, target.cols + 1):
            areas.append(_outline(_ONE, np.array([col, row]) * (size + gap) - gap, np.full(2, gap)))
    return areas


def _squares(target: Target, size: Floats) -> list[Floats]:
    """Return the outlines of the black squares of a checkerboard; the one before the first point is black."""
    return [
        _outline(_ONE, np.array([row - 1, col - 1]) * size, size)
        for row, col in np.ndindex(target.rows + 1, target.cols + 1)
        if (row + col) % 2 == 0
    ]


@lru_cache(maxsize=8)
def marker_cells(dictionary: str, marker: int) -> Cells:
    """Return the cells of an ArUco marker as OpenCV draws it, white ones true; top row first, its border of 1 included.

    Raises
    ------
    OptionError
        If there is no such dictionary, or no such marker in it.
    """
    import cv2

    number = getattr(cv2.aruco, f"DICT_{dictionary}", None)
    if not isinstance(number, int):
        known = sorted(name.removeprefix("DICT_") for name in dir(cv2.aruco) if name.startswith("DICT_"))
        raise OptionError(f"there is no dictionary {dictionary!r} of markers; OpenCV has {', '.join(known)}.")
    family = cv2.aruco.getPredefinedDictionary(number)
    if not 0 <= marker < len(family.bytesList):
        raise OptionError(
            f"there is no marker {marker} in {dictionary}; it has markers 0 to {len(family.bytesList) - 1}."
        )
    return cv2.aruco.generateImageMarker(family, marker, family.markerSize + 2) > 0


def _charuco(target: Target) -> list[Floats]:
    """Return the outlines of the black squares of a ChArUco board, and of the markers in the white ones."""
    square, marker = target.square_size_m, target.marker_size_m
    areas: list[Floats] = []
    number = target.first_tag
    for row, col in np.ndindex(target.rows, target.cols):  # rows from the top; the points' origin is one square inside
        origin = np.array([col - 1, target.rows - 2 - row]) * square
        if black_square(target, row, col):
            areas.append(_outline(_ONE, origin, np.full(2, square)))
            continue
        cells = marker_cells(target.dictionary, number)
        areas.append(_outline(~cells[::-1], origin + (square - marker) / 2, np.full(2, marker / len(cells))))
        number += 1
    return areas


def black_square(target: Target, row: int, col: int) -> bool:
    """Tell whether a square of a ChArUco board is black; rows from the top, columns from the left."""
    return (row + col) % 2 == (1 if target.legacy and target.rows % 2 == 0 else 0)


def _outline(black: Cells, origin: Floats, size: Floats) -> Floats:
    """Return the edges (n, 4) between black cells (rows along y, columns along x) and others, black to their left.

    Cells begin at `origin` and have sides of `size`, both x and y [m].
    """
    padded = np.pad(black, 1).astype(np.int8)
    edges: list[tuple[int, int, int, int]] = []
    for y, x in np.argwhere(np.diff(padded[1:-1], axis=1)):  # upright ones: upwards where black ends
        ends = padded[y + 1, x] == 1
        edges.append((x, y, x, y + 1) if ends else (x, y + 1, x, y))
    for y, x in np.argwhere(np.diff(padded[:, 1:-1], axis=0)):
        ends = padded[y, x + 1] == 1
        edges.append((x + 1, y, x, y) if ends else (x, y, x + 1, y))
    return np.tile(origin, 2) + np.array(edges, dtype=np.float64).reshape(-1, 4) * np.tile(size, 2)


def _discs(centres: Floats, radius: float) -> list[Floats]:
    """Return the outlines of discs: polygons that have the same area and middle."""
    step = 2 * np.pi / _SIDES
    corners = np.arange(_SIDES + 1) * step
    around = radius * np.sqrt(step / np.sin(step)) * np.column_stack([np.cos(corners), np.sin(corners)])
    return [np.hstack([centre + around[:-1], centre + around[1:]]) for centre in centres]
