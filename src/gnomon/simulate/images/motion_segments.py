"""Where points of a board are in an image while it is taken: board and camera may move, and rows expose in turn.

The path of each point in the image over the exposure is a polynomial of low order through some instants, as many as it
needs; with a rolling shutter a point is seen at the instant at which the row where it then is exposes.
"""

from collections.abc import Callable, Iterator
from typing import Protocol

import numpy as np

from ...frozen import value_class
from ...models.camera import Camera
from ...recording import Floats

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
