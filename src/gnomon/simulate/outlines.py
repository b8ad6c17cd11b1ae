"""The outlines of what is printed on a board, cut into short pieces, on a board that need not be flat or true."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from ..models.board_pattern import Pattern
from ..models.target import Target
from ..recording import Floats, Integers

_TILES = 48  # along a side of the board, where it is not in the image as a whole
_STRAIGHT_M = 1e-9


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
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


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
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
def outline_of(pattern: Pattern, what: str, level: int, board: TrueBoard | None = None) -> Outline:
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
