"""The outlines of what is printed on a board, which need not be flat or true, and how much of each pixel they enclose.

The areas are exact, without rays, for outlines made of straight pieces: a piece inside one pixel that runs down by dy
adds an area of dy (1 - x) to this pixel, x being its mean distance from the pixel's left edge, and dy to every pixel to
the right of it; one that runs up takes as much away. So each piece concerns two pixels, and the sum along the row does
the rest.
"""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from ...frozen import value_class
from ...models.board_pattern import BoardPattern
from ...models.target import Target
from ...recording import Floats, Integers

Singles = NDArray[np.float32]

_FAR = 1e7  # cells
_BLOCK = 2048  # pieces at a time: the intermediate arrays of a block stay in the cache
_TILES = 48  # along a side of the board, where it is not in the image as a whole
_STRAIGHT_M = 1e-9


@value_class
class TrueBoard:
    """Where the points of a board truly are: larger, bent, or each off its place by itself.

    What is between the points follows them: by a polynomial of second order as far as it goes, which is exact for a
    scale along each axis and a bow, and by linear interpolation of what is left.

    Attributes
    ----------
    stated : (k, 3) points in the board's frame as its owner describes it [m]
    true : (k, 3) where they are [m]
    """

    stated: Floats
    true: Floats

    @classmethod
    def of(cls, target: Target, true: Floats) -> "TrueBoard | None":
        """Return the board, or None where its points are where they are said to be."""
        return None if np.abs(true - target.points).max() < _STRAIGHT_M else cls(stated=target.points, true=true)

    def places(self, points: Floats) -> Floats:
        """Return where points (n, 3) of the stated board truly are, (n, 3) [m]."""
        from scipy.interpolate import LinearNDInterpolator, NearestNDInterpolator

        terms = _terms(self.stated)
        shape = np.linalg.lstsq(terms, self.true, rcond=None)[0]
        found, left = _terms(points) @ shape, self.true - terms @ shape
        if np.abs(left).max() > _STRAIGHT_M:
            inside = LinearNDInterpolator(self.stated[:, :2], left)(points[:, :2])
            outside = np.isnan(inside[:, 0])
            inside[outside] = NearestNDInterpolator(self.stated[:, :2], left)(points[outside, :2])
            found += inside
        return found


def _terms(points: Floats) -> Floats:
    x, y = points[:, 0], points[:, 1]
    return np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=1)


@value_class
class Outline:
    """Closed outlines, cut into short pieces.

    Attributes
    ----------
    points : (v, 3) in the board's frame [m]
    start : (n,) points at which the pieces start; each ends at the point after it
    area : (v,) number of the closed outline that a point belongs to
    """

    points: Floats
    start: Integers
    area: Integers


@lru_cache(maxsize=16)
def outline_of(pattern: BoardPattern, what: str, level: int, board: TrueBoard | None = None) -> Outline:
    """Return the outlines of the sheet, of its tiles, or of all black, in pieces of 2^(level/2) m at most.

    Parameters
    ----------
    pattern : what is printed, in the frame of the stated board
    what : "sheet", "tiles" or "black"
    level : of detail
    board : where the points truly are, if not where they are said to be
    """
    if what == "black":
        edges, area = pattern.edges, pattern.area
    else:
        edges, area = _tiles(pattern.sheet, 1 if what == "sheet" else _TILES)
    length = np.linalg.norm(edges[:, 2:] - edges[:, :2], axis=1)
    pieces = np.ceil(length / 2 ** (level / 2)).astype(np.int64).clip(1)
    edge = np.repeat(np.arange(len(edges)), pieces + 1)
    first = np.cumsum(pieces + 1) - (pieces + 1)
    step = np.arange(len(edge)) - first[edge]
    part = (step / pieces[edge])[:, None]
    points = np.zeros((len(edge), 3))
    points[:, :2] = edges[edge, :2] * (1 - part) + edges[edge, 2:] * part
    points = points if board is None else board.places(points)
    return Outline(points=points, start=np.flatnonzero(step < pieces[edge]), area=area[edge])


def _tiles(sheet: Floats, count: int) -> tuple[Floats, Integers]:
    """Return the outlines of so many tiles along a side that the sheet is made of, and the tile of each edge."""
    x, y = (np.linspace(sheet[axis], sheet[axis + 2], count + 1) for axis in (0, 1))
    i, j = (index.ravel() for index in np.indices((count, count)))
    corners = np.stack([x[i], y[j], x[i + 1], y[j], x[i + 1], y[j + 1], x[i], y[j + 1], x[i], y[j]], axis=1)
    edges = np.stack([corners[:, 2 * k : 2 * k + 4] for k in range(4)], axis=1).reshape(-1, 4)
    return edges, np.repeat(np.arange(count * count), 4)


def pixel_coverage(start: Floats, end: Floats, shape: tuple[int, int]) -> Singles:
    """Return the area of each pixel (rows, cols) that is inside closed outlines, times how often it is.

    Parameters
    ----------
    start, end : (n, 2) directed pieces of the outlines, x and y; pixel [0, 0] reaches from 0 to 1. What is to the right
        of a piece that runs down counts as inside
    shape : rows and columns
    """
    rows, cols = shape
    flat = np.zeros(rows * (cols + 1))
    pieces = _near(start, end, shape)
    for first in range(0, pieces.shape[1], _BLOCK):
        _add(flat, pieces[:, first : first + _BLOCK], shape)
    change = flat.reshape(rows, cols + 1)[:, :-1].astype(np.float32)
    return np.cumsum(change, axis=1, out=change)


def _add(flat: Floats, pieces: Floats, shape: tuple[int, int]) -> None:
    """Add what pieces (4, n), x0 y0 x1 y1, contribute to the differences between neighbours in a row."""
    rows, cols = shape
    x0, y0, x1, y1 = pieces
    low, high = np.minimum(y0, y1), np.maximum(y0, y1)
    first, number = _cells(low, high, rows)
    row = _counted(first, number)
    low, high = (np.repeat(value, number) for value in (low, high))
    top, bottom = np.maximum(low, row, out=low), np.minimum(high, row + 1, out=high)
    slope = (x1 - x0) / (y1 - y0)
    from_y, from_x, slope, way = (np.repeat(value, number) for value in (y0, x0, slope, np.sign(y1 - y0)))
    left, right = (top - from_y) * slope, (bottom - from_y) * slope
    left += from_x
    right += from_x
    down = (bottom - top) * way
    _add_across(flat, row, (np.minimum(left, right), np.maximum(left, right)), down, cols)


def _add_across(flat: Floats, row: NDArray[np.intp], x: tuple[Floats, Floats], down: Floats, cols: int) -> None:
    """Add what pieces contribute that run down by `down` (n,) between two x, left and right, each within one row."""
    left, right = x
    at = row * (cols + 1)  # the row's first pixel
    width = right - left
    upright = width < 1e-9
    width[upright] = 1.0
    left = np.where(upright, right, left)  # in one column
    per_col = 1 / width
    first, number = _cells(left, right, cols)
    col = _counted(first, number)
    outside = left < 0
    if outside.any():  # to the left of the image: to the right of it are all pixels of the row
        share = (np.minimum(right[outside], 0.0) - left[outside]) * per_col[outside]
        share[upright[outside]] = 1.0
        np.add.at(flat, at[outside], down[outside] * share)
    left, right, down, per_col = (np.repeat(value, number) for value in (left, right, down, per_col))
    at, upright = np.repeat(at, number), np.repeat(upright, number)
    np.maximum(left, col, out=left)
    np.minimum(right, col + 1, out=right)
    share = (right - left) * per_col
    share[upright] = 1.0
    down *= share
    beyond = down * ((left + right) / 2 - col)
    at += col
    np.add.at(flat, at, down - beyond)
    np.add.at(flat, at + 1, beyond)


def _near(start: Floats, end: Floats, shape: tuple[int, int]) -> Floats:
    """Return the pieces that matter, x0 y0 x1 y1 (4, n): also those to the left of the image."""
    x0, y0, x1, y1 = start[:, 0], start[:, 1], end[:, 0], end[:, 1]
    matters = (np.maximum(y0, y1) > 0) & (np.minimum(y0, y1) < shape[0]) & (np.minimum(x0, x1) < shape[1]) & (y0 != y1)
    pieces = np.array([value[matters] for value in (x0, y0, x1, y1)])
    return np.clip(pieces, -_FAR, _FAR, out=pieces)  # a lens may throw points beyond what can be counted


def _cells(low: Floats, high: Floats, count: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the first cell that an interval meets, and how many: cell k reaches from k to k + 1, of `count`."""
    first = np.floor(low).astype(np.intp)
    last = np.maximum(np.ceil(high).astype(np.intp), first + 1)
    np.maximum(first, 0, out=first)
    np.minimum(last, count, out=last)
    return first, np.maximum(last - first, 0)


def _counted(first: NDArray[np.intp], number: NDArray[np.intp]) -> NDArray[np.intp]:
    """Return first, first + 1, ... of every interval, one after the other."""
    ends = np.cumsum(number)
    return np.arange(ends[-1] if len(ends) else 0) + np.repeat(first - ends + number, number)
