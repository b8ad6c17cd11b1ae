"""Where the outlines of what is printed on a board are in an image, and how much of each pixel they enclose.

The board need not be flat or true.

The areas are exact, without rays, for outlines made of straight pieces: a piece inside one pixel that runs down by dy
adds an area of dy (1 - x) to this pixel, x being its mean distance from the pixel's left edge, and dy to every pixel to
the right of it; one that runs up takes as much away. So each piece concerns two pixels, and the sum along the row does
the rest.

While an image is taken board and camera may move, and rows expose in turn. The path of each point in the image over the
exposure is a polynomial of low order through some instants, as many as it needs; with a rolling shutter a point is seen
at the instant at which the row where it then is exposes.
"""

from collections.abc import Callable, Iterator
from functools import lru_cache
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ...frozen import value_class
from ...models.board_pattern import BoardPattern
from ...models.camera import Camera
from ...models.target import Target
from ...recording import Floats, Integers

Pose = Callable[[Floats], tuple[Floats, Floats]]
"""Instants (n,) [s] from the middle of the exposure of the top row -> R_cam_target (n, 3, 3), p_cam_target (n, 3)."""

_NODES = (3, 5, 7, 9)
_EXACT_PX = 0.002
_MOST_INSTANTS = 48
_NEAR = 1.5  # half widths and heights of the image from its middle
_BEYOND_ROWS = 20.0  # points above and below the image may be coarse
_ROW_SEARCHES = 3
_STEADIEST = 0.2  # of 1: rows that expose as fast as a point moves down would see it for ever


class Movement(Protocol):
    """How the board is seen during an exposure."""

    @property
    def instants(self) -> int:
        """Number of instants whose mean is the image."""
        ...

    def poses(self) -> tuple[Floats, Floats]:
        """Return R_cam_target (m, 3, 3) and p_cam_target (m, 3) [m] at some instants from the first to the last."""
        ...

    def rows(self, instant: int) -> tuple[Floats, Floats]:
        """Return the poses of all rows at an instant, (height, 3, 3) and (height, 3), or of all in one, (1, ...)."""
        ...

    def pixels(self, points: Floats) -> Iterator[Floats]:
        """Yield where points (n, 3) of the board are in the image, (n, 2) [px], at each instant; nan where nowhere."""
        ...


@value_class
class InstantPoses:
    """Poses of their own for each instant: R (k, 3, 3), p (k, 3) [m]; all rows expose at once."""

    camera: Camera
    R: Floats
    p: Floats

    @property
    def instants(self) -> int:
        """Number of instants whose mean is the image."""
        return len(self.R)

    def poses(self) -> tuple[Floats, Floats]:
        """Return poses at some instants; see `Movement`."""
        return self.R, self.p

    def rows(self, instant: int) -> tuple[Floats, Floats]:
        """Return the poses of the rows at an instant; see `Movement`."""
        return self.R[instant : instant + 1], self.p[instant : instant + 1]

    def pixels(self, points: Floats) -> Iterator[Floats]:
        """Yield where points are at each instant; see `Movement`."""
        for R, p in zip(self.R, self.p, strict=True):
            yield self.camera.project(points @ R.T + p, point_jacobian=False).pixels


@value_class
class MotionSegment:
    """A smooth motion during an exposure.

    Attributes
    ----------
    camera : lens and line delay
    pose : of the board
    at_s : (k,) instants whose mean is the image [s from the middle of the exposure of the top row]
    nodes_s : (c,) instants between which the paths are interpolated
    """

    camera: Camera
    pose: Pose
    at_s: Floats
    nodes_s: Floats

    @classmethod
    def during(cls, exposure_s: float, camera: Camera, pose: Pose, points: Floats, step_px: float) -> "MotionSegment":
        """Return the motion during an exposure, with as many instants as `points` (n, 3) [m] of the board ask for.

        Parameters
        ----------
        exposure_s : of each row
        camera, pose : see `MotionSegment`
        points : those at the border and in the middle of the board
        step_px : how far a point may move from instant to instant
        """
        height = camera.resolution[1]
        rows_s = camera.line_delay_s * np.array([-_BEYOND_ROWS, height - 1 + _BEYOND_ROWS])
        low, high = float(rows_s.min()) - exposure_s / 2, float(rows_s.max()) + exposure_s / 2
        moved = _longest(_projected(camera, pose, points, exposure_s * np.array([-0.5, 0.0, 0.5])), camera)
        count = int(np.clip(np.ceil(moved / step_px), 1, _MOST_INSTANTS))
        at_s = exposure_s * ((np.arange(count) + 0.5) / count - 0.5)
        nodes_s = np.array([low])
        for nodes in _NODES if high > low else ():
            nodes_s = (low + high) / 2 - (high - low) / 2 * np.cos(np.pi * np.arange(nodes) / (nodes - 1))
            between_s = (nodes_s[1:] + nodes_s[:-1]) / 2
            known = _projected(camera, pose, points, nodes_s)
            guess = np.tensordot(_weights(nodes_s, between_s), known, axes=1)
            off = np.abs(guess - _projected(camera, pose, points, between_s))
            if not (off > _EXACT_PX).any():
                break
        return cls(camera=camera, pose=pose, at_s=at_s, nodes_s=nodes_s)

    @property
    def instants(self) -> int:
        """Number of instants whose mean is the image."""
        return len(self.at_s)

    def poses(self) -> tuple[Floats, Floats]:
        """Return poses at some instants; see `Movement`."""
        return self.pose(self.nodes_s)

    def rows(self, instant: int) -> tuple[Floats, Floats]:
        """Return the poses of the rows at an instant; see `Movement`."""
        rows = np.arange(self.camera.resolution[1] if self.camera.line_delay_s else 1)
        return self.pose(self.at_s[instant] + self.camera.line_delay_s * rows)

    def pixels(self, points: Floats) -> Iterator[Floats]:
        """Yield where points are at each instant, of a rolling shutter when their rows expose; see `Movement`."""
        known = _projected(self.camera, self.pose, points, self.nodes_s)
        if not self.camera.line_delay_s:
            for weights in _weights(self.nodes_s, self.at_s):
                yield np.asarray(np.tensordot(weights, known, axes=1), dtype=np.float64)
            return
        middle, half = (self.nodes_s[0] + self.nodes_s[-1]) / 2, (self.nodes_s[-1] - self.nodes_s[0]) / 2
        powers = np.vander((self.nodes_s - middle) / half, increasing=True)
        path = np.asarray(
            np.tensordot(np.linalg.inv(powers), known, axes=1), dtype=np.float64
        )  # coefficients of (t - middle) / half
        across, down = (np.ascontiguousarray(path[:, :, axis]) for axis in (0, 1))
        row = down[0]
        for at_s in self.at_s:
            row = self._exposed_row(down, row, (at_s - middle) / half, half)
            s = (at_s - middle + self.camera.line_delay_s * row) / half
            yield np.stack([_polynomial(across, s), _polynomial(down, s)], axis=1)

    def _exposed_row(self, down: Floats, row: Floats, start: float, half: float) -> Floats:
        """Return in which row (n,) points are that move down along polynomials (c, n), when this row is exposed."""
        lowest, highest = -_BEYOND_ROWS, self.camera.resolution[1] - 1 + _BEYOND_ROWS
        per_row = self.camera.line_delay_s / half
        slopes = down[1:] * np.arange(1, len(down))[:, None]
        row = row.clip(lowest, highest)
        for _ in range(_ROW_SEARCHES):
            s = start + per_row * row
            steady = np.maximum(1 - per_row * _polynomial(slopes, s), _STEADIEST)
            row = (row + (_polynomial(down, s) - row) / steady).clip(lowest, highest)
        return row


def _projected(camera: Camera, pose: Pose, points: Floats, t_s: Floats) -> Floats:
    """Return where points (n, 3) are at instants (k,), (k, n, 2) [px]."""
    R, p = pose(t_s)
    found = np.empty((len(t_s), len(points), 2))
    for k in range(len(t_s)):
        found[k] = camera.project(points @ R[k].T + p[k], point_jacobian=False).pixels
    return found


def _longest(pixels: Floats, camera: Camera) -> float:
    """Return the longest path of points (k, n, 2) [px] that come near the image; a lens may throw others anywhere."""
    path = np.linalg.norm(np.diff(pixels, axis=0), axis=2).sum(axis=0)
    middle = (np.array(camera.resolution) - 1) / 2
    known = np.isfinite(path)
    near = known & (np.abs(pixels - middle) < _NEAR * middle).all(axis=2).any(axis=0)
    return float(np.max(path[near if near.any() else known], initial=0.0))


def _weights(nodes: Floats, at: Floats) -> Floats:
    """Return the weights (k, c) by which the polynomial through values at nodes (c,) is had at other instants (k,)."""
    weights = np.ones((len(at), len(nodes)))
    for i, own in enumerate(nodes):
        for other in np.delete(nodes, i):
            weights[:, i] *= (at - other) / (own - other)
    return weights


def _polynomial(coefficients: Floats, s: Floats) -> Floats:
    value = coefficients[-1]
    for coefficient in coefficients[-2::-1]:
        value = value * s + coefficient
    return value


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
