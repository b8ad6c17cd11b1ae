"""The columns of the board's corners in the normal equations.

A corner of an exposure touches its own three columns, the pose and the parameters of its camera, and nothing else. So
the products of its columns B = G R_cam_target scale with those of the exposure are kept corner by corner: with the
twist, mapped to the pose, for the coupling to the trajectory, which is made super-block by super-block (the wide part
of `BorderedBand`); with everything else summed up over the exposures.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...recording import Floats, Integers
from ...solve.bordered_band import BorderedBand
from .trajectory import BIAS, POSE

_TWIST = 6
_AXES = 3
_FEW = 30  # exposures of a super-block up to which all corners of the board are gone through


class CornerProducts:
    """Products of the columns of each corner's offset with those of its exposure, as `corner_sums` makes them.

    Attributes
    ----------
    by_twist : (m, 6, 3) of each corner, with the twist
    rest : (w, k, 3) with the columns behind the twist, summed up over all exposures of each of the k corners
    squares : (k, 3, 3) with each other
    """

    def __init__(self, point: Integers, counted: np.ndarray, points: int, width: int) -> None:
        """Start with nothing.

        Parameters
        ----------
        point : (m,) number of each corner on the board
        counted : (m,) bool, whether its exposure takes part
        points : corners of the board
        width : columns behind the twist
        """
        self._point, self._counted = point, counted
        self.by_twist = np.zeros((len(point), _TWIST, _AXES))
        self.rest = np.zeros((width, points, _AXES))
        self.squares = np.zeros((points, _AXES, _AXES))

    def add(self, corners: slice, rows: Floats, own: Floats) -> None:
        """Add some corners.

        Parameters
        ----------
        corners : which of all
        rows : (6 + w, m, 2) whitened columns of the exposure
        own : (3, m, 2) whitened columns of the offset
        """
        own = own * self._counted[corners][:, None]
        point, points = self._point[corners], len(self.squares)
        (own_u, own_v), (u, v) = own.transpose(2, 0, 1).copy(), rows.transpose(2, 0, 1).copy()
        twist = self.by_twist[corners]
        for j in range(_AXES):
            products = u * own_u[j]
            products += v * own_v[j]
            twist[:, :, j] = products[:_TWIST].T
            for w, product in enumerate(products[_TWIST:]):
                self.rest[w, :, j] += np.bincount(point, product, points)
            for i in range(j + 1):
                product = np.bincount(point, own_u[i] * own_u[j] + own_v[i] * own_v[j], points)
                self.squares[:, i, j] += product
                if i != j:
                    self.squares[:, j, i] += product


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Coupling:
    """What the corners of one camera's used exposures have in common with everything else.

    Attributes
    ----------
    first : (m,) first control point of the span of each corner, ascending
    exposure : (m,) its exposure
    value : (e, k) basis functions of all exposures
    point : (m,) its number on the board
    by_pose : (m, 6, 3) products of its offset with the pose
    border : (b, 3 k) products of the offsets with the border's other columns
    sides : (3 k, q) right-hand sides
    squares : (k, 3, 3) products of the offsets with each other
    """

    first: Integers
    exposure: Integers
    value: Floats
    point: Integers
    by_pose: Floats
    border: Floats
    sides: Floats
    squares: Floats


def corners_of(exposures: Integers, start: Integers) -> tuple[Integers, Integers]:
    """Return the corners of some exposures in their order, and the place of each one's exposure, (m,) both."""
    lengths = start[exposures + 1] - start[exposures]
    place = np.repeat(np.arange(len(exposures)), lengths)
    within = np.arange(len(place)) - np.repeat(np.cumsum(lengths) - lengths, lengths)
    return start[exposures][place] + within, place


class BoardBorder:
    """The wide part of the border: three columns for each corner of the board."""

    def __init__(self, points: int, controls: int, order: int, imus: int) -> None:
        """Start with nothing.

        Parameters
        ----------
        points : corners of the board
        controls, order, imus : of the trajectory
        """
        self._points, self._controls, self._order = points, controls, order
        self._width = POSE + BIAS * imus
        self._cameras: list[Coupling] = []

    @property
    def size(self) -> int:
        """Number of columns."""
        return _AXES * self._points

    def fill(self, system: BorderedBand, cameras: Sequence[Coupling]) -> None:
        """Take what the cameras saw, and add what does not concern the trajectory to the normal equations."""
        self._cameras = list(cameras)
        p = len(system.corner) - self.size
        blocks = system.corner[p:, p:].reshape(self._points, _AXES, self._points, _AXES)
        every = np.arange(self._points)
        for camera in cameras:
            system.corner[:p, p:] += camera.border
            system.corner[p:, :p] += camera.border.T
            blocks[every, :, every, :] += camera.squares
            system.corner_rhs[p:] += camera.sides

    def coupling(self, first: int, count: int) -> Floats:
        """Return the blocks of all offsets and some control points, (size, count, d)."""
        found = np.zeros((count, self._points * POSE * _AXES))
        for camera in self._cameras:
            some = slice(*np.searchsorted(camera.first, [first - self._order + 1, first + count]).tolist())
            if some.start == some.stop:
                continue
            begins = np.flatnonzero(np.diff(camera.exposure[some], prepend=-1))  # of exposures
            basis = first + np.arange(count)[:, None] - camera.first[some][begins]
            near = (basis >= 0) & (basis < self._order)
            weight = camera.value[camera.exposure[some][begins], np.where(near, basis, 0)] * near  # (count, e)
            products = camera.by_pose[some].reshape(-1, POSE * _AXES)
            if len(begins) <= _FEW:
                dense = np.zeros((len(begins), self._points, POSE * _AXES))
                lengths = np.diff(begins, append=len(products))
                dense[np.repeat(np.arange(len(begins)), lengths), camera.point[some]] = products
                found += weight @ dense.reshape(len(begins), -1)
            else:  # rolling shutter: each corner has an exposure of its own
                place = (camera.point[some, None] * (POSE * _AXES) + np.arange(POSE * _AXES)).ravel()
                of_corner = np.repeat(weight, np.diff(begins, append=len(products)), axis=1)
                for control, each in enumerate(of_corner):
                    found[control] += np.bincount(place, (each[:, None] * products).ravel(), found.shape[1])
        blocks = np.zeros((self._points, _AXES, count, self._width))
        blocks[..., :POSE] = found.reshape(count, self._points, POSE, _AXES).transpose(1, 3, 0, 2)
        return blocks.reshape(self.size, count, self._width)

    def times(self, parameters: Floats) -> Floats:
        """Return the product (n, d, k) of all blocks with offsets (size, k)."""
        offsets = parameters.reshape(self._points, _AXES, -1)
        found = np.zeros((self._controls, self._width, offsets.shape[2]))
        for camera in self._cameras:
            begins, exposure = camera.exposures
            pull = np.zeros((len(begins), POSE, offsets.shape[2]))
            for corners in _chunks(begins, len(camera.point)):
                pulls = np.matmul(camera.by_pose[corners], offsets[camera.point[corners]])
