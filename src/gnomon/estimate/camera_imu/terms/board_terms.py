"""The columns of the shifts of a board's corners in the normal equations.

A corner of an exposure touches its own three columns, the pose and the parameters of its camera, and nothing else. So
the products of its columns B = G R_cam_target scale with those of the exposure are kept corner by corner: with the
twist, mapped to the pose, for the coupling to the trajectory, which is made super-block by super-block (the wide part
of `BorderedBand`); with everything else summed up over the exposures.
"""

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, cast

import numpy as np

from ....frozen import value_class
from ....recording import Floats, Integers
from ..trajectory import BIAS, POSE

if TYPE_CHECKING:
    from scipy.sparse import csr_array

    from ....solve.bordered_band import BorderedBand

_TWIST = 6
_AXES = 3
_TOGETHER, _CORNERS = 60, 8192  # exposures, and corners, that are multiplied at once
_DENSE = 0.1  # share of the board's corners in an exposure, from which on zeros for all others cost less


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

    def taking(self) -> tuple[Integers, np.ndarray, Floats, Floats, Floats]:
        """Return number and `counted` of all corners, and where their products are to be added."""
        return self._point, self._counted, self.by_twist, self.rest, self.squares

    def taken(self, corners: Integers) -> Floats:
        """Return `by_twist` of some corners: where they are ascending it is packed in place, since it is large."""
        if not len(corners) or (np.diff(corners) <= 0).any():
            return self.by_twist[corners]
        for begin in range(0, len(corners), _CORNERS):
            some = corners[begin : begin + _CORNERS]
            self.by_twist[begin : begin + len(some)] = self.by_twist[some]
        return self.by_twist[: len(corners)]

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


@value_class
class PoseProducts:
    """Products of the poses of exposures and the offsets of corners, of which most exposures see a part.

    Attributes
    ----------
    place, point : (m,) exposure, ascending, and number of each corner
    by_twist : (m, 6, 3) products of each corner
    shape : number of exposures and of the board's corners
    """

    place: Integers
    point: Integers
    by_twist: Floats
    shape: tuple[int, int]

    @property
    def _dense(self) -> bool:
        return len(self.place) > _DENSE * self.shape[0] * self.shape[1]

    def turned(self, blocks: Floats) -> "PoseProducts":
        """Return the products, with those of each exposure multiplied from the left by a block (e, 6, 6) in place."""
        for begin in range(0, len(self.place), _CORNERS):
            some = slice(begin, begin + _CORNERS)
            self.by_twist[some] = blocks[self.place[some]] @ self.by_twist[some]
        return self

    def rows(self, exposures: slice) -> "Floats | csr_array":
        """Return those of some exposures, (6 e, 3 k): sparse where an exposure sees few of the corners."""
        begin, end, points = exposures.start, exposures.stop, self.shape[1]
        some = slice(*np.searchsorted(self.place, [begin, end]).tolist())
        if self._dense:
            dense = np.zeros((end - begin, POSE, points, _AXES))
            dense[self.place[some] - begin, :, self.point[some]] = self.by_twist[some]
            return dense.reshape(-1, points * _AXES)
        from scipy.sparse import bsr_array  # loaded where it is needed: `gnomon camera` never needs it

        # Rolling shutter: each corner has an exposure of its own.
        starts = np.searchsorted(self.place[some], np.arange(begin, end + 1))
        shape = POSE * (end - begin), _AXES * points
        return bsr_array((self.by_twist[some], self.point[some], starts), shape=shape).tocsr()

    def times(self, offsets: Floats) -> Floats:
        """Return the products with offsets (3 k, q), (e, 6, q)."""
        found = np.empty((self.shape[0], POSE, offsets.shape[1]))
        for some in self._runs(0, self.shape[0]):
            found[some] = (self.rows(some) @ offsets).reshape(-1, POSE, offsets.shape[1])
        return found

    def pull(self, poses: Floats, begin: int, end: int) -> Floats:
        """Return those of some exposures, transposed, with values (e, 6, q) of the poses, (3 k, q)."""
        found = np.zeros((_AXES * self.shape[1], poses.shape[2]))
        for some in self._runs(begin, end):
            found += self.rows(some).T @ poses[some].reshape(-1, poses.shape[2])
        return found

    def _runs(self, begin: int, end: int) -> Iterator[slice]:
        """Yield runs of exposures whose rows are few, or not dense."""
        step = _TOGETHER if self._dense else max(end - begin, 1)
        return (slice(low, min(low + step, end)) for low in range(begin, end, step))


@value_class
class Coupling:
    """What the corners of one camera's used exposures have in common with everything else.

    Attributes
    ----------
    first : (e,) first control point of the span of each exposure, ascending
    value : (e, k) its basis functions
    by_pose : products (6 e, 3 k) of the poses and the offsets
    border : columns of the border that the camera touches, and the products (r, b, 3 k) of the offsets with them,
        summed up over each of r parts
    sides : (r, 3 k, q) right-hand sides
    squares : (r, k, 3, 3) products of the offsets with each other
    """

    first: Integers
    value: Floats
    by_pose: PoseProducts
    border: list[tuple[slice, Floats]]
    sides: Floats
    squares: Floats

    def moved(self, controls: Floats) -> Floats:
        """Return how the poses follow where control points (n, d, q) do, (e, 6, q)."""
        found = np.zeros((len(self.first), POSE, controls.shape[2]))
        for k, value in enumerate(self.value.T):
            found += value[:, None, None] * controls[self.first + k, :POSE]
        return found

    def blocks(self, first: int, count: int) -> Floats:
        """Return the products (count, 6, 3 k) of the poses of control points from `first` on with the offsets."""
        order = self.value.shape[1]
        some = slice(*np.searchsorted(self.first, [first - order + 1, first + count]).tolist())
        at = self.first[some] - first + order - 1
        weight = np.zeros((len(at), count + 2 * (order - 1)))
        weight[np.arange(len(at))[:, None], at[:, None] + np.arange(order)] = self.value[some]
        weight = weight[:, order - 1 : order - 1 + count].T
        products = self.by_pose.rows(some)
        if isinstance(products, np.ndarray):
            found = weight @ products.reshape(len(at), POSE * products.shape[1])
        else:
            from scipy.sparse import csr_array, eye_array, kron

            spread = csr_array(kron(csr_array(weight), eye_array(POSE)))
            found = cast(csr_array, spread @ products).toarray()
        return found.reshape(count, POSE, -1)


def exposure_corners(exposures: Integers, start: Integers) -> tuple[Integers, Integers]:
    """Return the corners of some exposures in their order, and the place of each one's exposure, (m,) both."""
    lengths = start[exposures + 1] - start[exposures]
    place = np.repeat(np.arange(len(exposures)), lengths)
    within = np.arange(len(place)) - np.repeat(np.cumsum(lengths) - lengths, lengths)
    return start[exposures][place] + within, place


class BoardBorder:
    """The wide part of the border: three columns for each corner of the board."""

    def __init__(self, points: int, controls: int, imus: int) -> None:
        """Start with nothing.

        Parameters
        ----------
        points : corners of the board
        controls, imus : of the trajectory
        """
        self._points, self._controls, self._width = points, controls, POSE + BIAS * imus
        self._cameras: list[Coupling] = []

    @property
    def size(self) -> int:
        """Number of columns."""
        return _AXES * self._points

    def release(self) -> None:
        """Let go of what the cameras saw."""
        self._cameras = []

    def fill(self, system: "BorderedBand", cameras: Sequence[Coupling]) -> None:
        """Take what the cameras saw, and add what does not concern the trajectory to the normal equations."""
        self._cameras = list(cameras)
        p = len(system.corner) - self.size
        blocks = system.corner[p:, p:].reshape(self._points, _AXES, self._points, _AXES)
        every = np.arange(self._points)
        for camera in cameras:
            for at, border in camera.border:
                system.corner[at, p:] += border.sum(axis=0)
                system.corner[p:, at] += border.sum(axis=0).T
            blocks[every, :, every, :] += camera.squares.sum(axis=0)
            system.corner_rhs[p:] += camera.sides.sum(axis=0)

    def times(self, parameters: Floats) -> Floats:
        """Return the product (n, d, k) of all blocks with offsets (size, k)."""
        found = np.zeros((self._controls, self._width, parameters.shape[1]))
        for camera in self._cameras:
            if not len(camera.first):
                continue
            pull = camera.by_pose.times(parameters)
            begins = np.flatnonzero(np.diff(camera.first, prepend=-1))  # exposures of one span
            for k, value in enumerate(camera.value.T):
                found[camera.first[begins] + k, :POSE] += np.add.reduceat(value[:, None, None] * pull, begins)
        return found

    def blocks(self, first: int, count: int) -> Floats:
        """Return the blocks (count, 6, size) of the poses of control points from `first` on."""
        found = np.zeros((count, POSE, self.size))
        for camera in self._cameras:
            if len(camera.first):
                found += camera.blocks(first, count)
        return found
