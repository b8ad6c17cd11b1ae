"""Normal equations of views: a pose of its own for each, and what all of them share.

    [ C_v  B_v ] [ pose of v ]     [ g_v ]
    [ B_v'  A  ] [  shared   ] = - [  a  ],     A, a: sums over the views

Each camera's exposures are summed up in the columns [twist | lens | shape of the board | residual] (`corner_sums`) and
mapped to the pose of the view and the shared parameters by one matrix, the same for all views. The points of the board,
three columns each, touch only the exposures in which they are seen.

Corners are weighed by their scatter, from the residuals, and by what the detector knows of each.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from ...frozen import value_class
from ...models.target import Target
from ...recording import Floats
from ..camera_imu.start.board_poses import SMALLEST_PX
from ..camera_imu.terms.board_terms import CornerProducts
from ..camera_imu.terms.visual_terms import CornerNoise, CornerSums, corner_sums
from .layout import POSE, SharedLayout, board_points
from .rig import CameraCorners, CameraRig

HUBER = 3.0
"""Distance in sigmas from which on a corner counts less; one of ninety does by chance."""


def usual_sigma(sums: CornerSums, freedom: float = 1.0) -> float:
    """Return the standard deviation per axis by the median distance; wrong corners do not count.

    Parameters
    ----------
    sums : of one camera; corners that the lens cannot image are left out
    freedom : share of the residuals' freedom that no parameter took up
    """
    distance = _distances(sums)
    if not len(distance):
        return 1.0
    return max(float(np.median(distance)) / np.sqrt(2 * np.log(2) * freedom), SMALLEST_PX)


def bounded_sigma(sums: CornerSums, counted: np.ndarray, huber: float, freedom: float) -> float:
    """Return the standard deviation per axis by the mean square, distances beyond `huber` usual ones cut off.

    It holds for the weighted sums of the estimate where the residuals have longer tails than a normal distribution.

    Parameters
    ----------
    sums : of one camera
    counted : (m,) corners that take part
    huber : as for the weights; infinite for least squares
    freedom : as for `usual_sigma`
    """
    distance = _distances(sums, counted)
    if not len(distance):
        return usual_sigma(sums, freedom)
    if not np.isfinite(huber):
        return max(float(np.sqrt(np.mean(distance**2) / (2 * freedom))), SMALLEST_PX)
    limit = huber * float(np.median(distance)) / np.sqrt(2 * np.log(2))
    share = 1 - np.exp(-0.5 * huber**2)
    cut = np.minimum(distance, limit)
    return max(float(np.sqrt(np.mean(cut**2) / (2 * freedom * share))), SMALLEST_PX)


def relative_corner_sigmas(seen: CameraCorners, sigma_px: float) -> Floats | None:
    """Return the standard deviation of each corner over that of a usual one.

    What the detector knows of each corner adds up with what is common to all, such as the errors of the board.
    """
    if seen.own_sigma_px is None or not len(seen.own_sigma_px):
        return None
    own = np.square(seen.own_sigma_px)
    variance = own + max(sigma_px**2 - float(np.median(own)), 0.0)
    return np.sqrt(variance / np.median(variance))


def _distances(sums: CornerSums, counted: np.ndarray | None = None) -> Floats:
    comparable = sums.comparable
    some = np.isfinite(comparable[:, 0])
    if counted is not None:
        some &= counted
    return np.linalg.norm(comparable[some], axis=1)


_LOST = 0.25  # of the image's width: how far off a corner counts that the lens cannot image


@value_class
class ViewNormalEquations:
    """The sums over the corners at a rig.

    Attributes
    ----------
    gram : (v, 6 + q + 1, 6 + q + 1) products of the columns [pose | shared, without the points | residual], in sigmas
    by_points : (v, 6 + q + 1, 3 n) products of the same with the points' columns; n = 0 where these are not estimated
    squares : (v, n, 3, 3) of the points' columns with each other
    cost : (v,) robust cost of each view
    sums : of each camera
    """

    gram: Floats
    by_points: Floats
    squares: Floats
    cost: Floats
    sums: tuple[CornerSums, ...]

    @property
    def size(self) -> int:
        """Number of shared columns."""
        return self.gram.shape[1] - POSE - 1 + self.by_points.shape[2]

    @property
    def pose(self) -> Floats:
        """C_v, (v, 6, 6)."""
        return self.gram[:, :POSE, :POSE]

    @property
    def pose_gradient(self) -> Floats:
        """g_v, (v, 6)."""
        return self.gram[:, :POSE, -1]

    @property
    def border(self) -> Floats:
        """B_v, (v, 6, p)."""
        return np.concatenate([self.gram[:, :POSE, POSE:-1], self.by_points[:, :POSE]], axis=2)

    def gradients(self) -> Floats:
        """Return the gradient of each view's cost by the shared parameters, (v, p)."""
        return np.concatenate([self.gram[:, POSE:-1, -1], self.by_points[:, -1]], axis=1)

    def shared(self) -> Floats:
        """Return A, (p, p)."""
        q, n = self.gram.shape[1] - POSE - 1, self.squares.shape[1]
        total = np.zeros((self.size, self.size))
        total[:q, :q] = self.gram[:, POSE:-1, POSE:-1].sum(axis=0)
        total[:q, q:] = self.by_points[:, POSE:-1].sum(axis=0)
        total[q:, :q] = total[:q, q:].T
        if n:
            every = np.arange(n)
            total[q:, q:].reshape(n, 3, n, 3)[every, :, every, :] = self.squares.sum(axis=0)
        return total


def accumulate_normal_equations(
    corners: Sequence[CameraCorners],
    target: Target,
    rig: CameraRig,
    layout: SharedLayout,
    noise: Mapping[str, CornerNoise],
) -> ViewNormalEquations:
    """Sum up the corners of all views at a rig.

    Parameters
    ----------
    corners : of every camera
    target : the board
    rig : where
    layout : columns
    noise : weights, by camera
    """
    views, q = len(rig.p_cam0_target), layout.narrow
    points = (layout.offsets.stop - layout.offsets.start) // 3
    gram = np.zeros((views, POSE + q + 1, POSE + q + 1))
    by_points = np.zeros((POSE + q + 1, views, 3 * points))
    squares, cost = np.zeros((views, points, 3, 3)), np.zeros(views)
    where, moves = board_points(target, rig.board), layout.board_moves(target)
    found: list[CornerSums] = []
    for seen in corners:
        R, p = poses_in_camera(rig, seen)
        products, each = None, np.zeros(0, np.int64)
        if points:
            each = seen.of_corner * points + seen.point  # the offset of each corner of each view by itself
            width = len(layout.own[seen.name]) + len(moves) + 1
            products = CornerProducts(each, np.ones(len(each), bool), views * points, width)
        sums = corner_sums(
            replace(seen.exposures, points=where[seen.point]),
            rig.cameras[seen.name],
            R,
            p,
            noise[seen.name],
            own_parameters=layout.own[seen.name],
            shape=moves[:, seen.point] if len(moves) else None,
            offsets=products,
        )
        mapped = layout.map(rig, seen.name, seen.camera)
        gram[seen.view] += mapped.T @ sums.gram @ mapped
        cost[seen.view] += np.bincount(seen.exposures.of_corner, sums.corner_cost, len(seen))
        cost[seen.view] += (sums.lengths - sums.valid) * _lost_cost(rig, seen, noise[seen.name])
        if products is not None:  # a corner of the board is once in an exposure at most
            rows = np.zeros((POSE + len(products.rest), views * points, 3))
            rows[:POSE, each], rows[POSE:] = products.by_twist.swapaxes(0, 1), products.rest
            by_points += (mapped.T @ rows.reshape(len(rows), -1)).reshape(by_points.shape)
            squares += products.squares.reshape(squares.shape)
        found.append(sums)
    return ViewNormalEquations(
        gram=gram,
        by_points=by_points.swapaxes(0, 1),
        squares=squares,
        cost=cost,
        sums=tuple(found),
    )


def poses_in_camera(rig: CameraRig, seen: CameraCorners) -> tuple[Floats, Floats]:
    """Return the pose of the board in a camera's frame at each of its exposures, (e, 3, 3) and (e, 3)."""
    T = rig.T_cam_cam0[seen.camera]
    return T[:3, :3] @ rig.R_cam0_target[seen.view], rig.p_cam0_target[seen.view] @ T[:3, :3].T + T[:3, 3]


def _lost_cost(rig: CameraRig, seen: CameraCorners, noise: CornerNoise) -> float:
    """Return the cost of a corner that the lens cannot image: that of one far off."""
    distance = _LOST * rig.cameras[seen.name].resolution[0] / noise.sigma_px
    return 0.5 * distance**2 if distance < noise.huber else noise.huber * (distance - 0.5 * noise.huber)


@value_class
class ReducedEquations:
    """Normal equations of the shared parameters, the poses eliminated, and how the poses follow.

    Attributes
    ----------
    information : (p, p), gradient : (p,)
    follow : (v, 6, p) C_v^-1 B_v
    rest : (v, 6) C_v^-1 g_v
    """

    information: Floats
    gradient: Floats
    follow: Floats
    rest: Floats

    def poses(self, shared: Floats) -> Floats:
        """Return the steps (v, 6) of the poses for a step (p,) of the shared parameters."""
        return -self.rest - self.follow @ shared


def eliminate_poses(at: ViewNormalEquations, damping: float = 0.0) -> ReducedEquations:
    """Return the equations of the shared parameters alone."""
    border = at.border
    inverse = inverse_poses(at.pose, damping)
    follow = inverse @ border
    rest = np.einsum("vij,vj->vi", inverse, at.pose_gradient)
    wide = border.reshape(-1, at.size)
    return ReducedEquations(
        information=at.shared() - wide.T @ follow.reshape(-1, at.size),
        gradient=at.gradients().sum(axis=0) - wide.T @ rest.ravel(),
        follow=follow,
        rest=rest,
    )


def inverse_poses(pose: Floats, damping: float | Floats = 0.0) -> Floats:
    """Return the inverses of C_v (v, 6, 6), whose units differ; zero for views without corners that count."""
    diagonal = np.einsum("vii->vi", pose)
    size = 1 / np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
    scaled = pose * size[:, :, None] * size[:, None, :]
    eased = scaled + (1e-12 + np.reshape(damping, (-1, 1, 1))) * np.eye(POSE)
    empty = (diagonal <= 0).any(axis=1)
    eased[empty] = np.eye(POSE)
    found = np.linalg.inv(eased) * size[:, :, None] * size[:, None, :]
    found[empty] = 0.0
    return found


def view_sums(at: ViewNormalEquations) -> tuple[Floats, Floats]:
    """Return pull (v, p) and information (v, p, p) of each view, its pose eliminated."""
    inverse, border = inverse_poses(at.pose), at.border
    follow = inverse @ border
    pull = np.einsum("vip,vi->vp", follow, at.pose_gradient) - at.gradients()
    information = np.swapaxes(border, 1, 2) @ follow
    np.negative(information, out=information)
    q, n = at.gram.shape[1] - POSE - 1, at.squares.shape[1]
    information[:, :q, :q] += at.gram[:, POSE:-1, POSE:-1]
    if n:
        information[:, :q, q:] += at.by_points[:, POSE:-1]
        information[:, q:, :q] += np.swapaxes(at.by_points[:, POSE:-1], 1, 2)
        first = q + 3 * np.arange(n)
        for i, j in np.ndindex(3, 3):
            information[:, first + i, first + j] += at.squares[:, :, i, j]
    return pull, information
