"""The pose of the board in the camera, frame by frame: where the batch estimation starts from.

A homography from the board's plane to the viewing rays gives the pose of all frames at once, and a few Gauss-Newton
steps refine it.

The acceleration that a camera's positions tell, and an IMU's readings averaged as it is.

A second difference of positions is the acceleration averaged with a triangular window of two steps.
"""

from contextlib import suppress
from dataclasses import replace
from itertools import pairwise

import numpy as np

from ....frozen import value_class
from ....geometry.rotations import rotation_from_rotvec
from ....models.camera import Camera
from ....models.target import Target
from ....recording import CameraFrames, Floats, Integers
from ..terms.visual_terms import TWIST, CornerNoise, Exposures, corner_sums, frame_scatter

FEWEST_CORNERS = 6
"""A frame with fewer corners is not used: its pose is too uncertain to tell a wrong detection from a right one."""

ENOUGH_CORNERS = 48

_REFINEMENTS = 6
_AT_REST = 1e-4  # rad and m
_HUBER = 2.0

SMALLEST_PX = 1e-3
"""No detector is better than this."""
STEP_S = 0.1
"""Step of the second differences."""

OFFSETS_S = np.linspace(-1, 1, 21)[1:-1] * STEP_S
"""Instants (k,) about a frame at which readings are taken [s]."""

TRIANGLE = (1 - np.abs(OFFSETS_S) / STEP_S) / (1 - np.abs(OFFSETS_S) / STEP_S).sum()
"""Their weights (k,)."""

DIFFERENCE = np.sign(OFFSETS_S) / (9 * STEP_S)
"""Weights (k,) for the derivative: the means of both sides, which are a step apart [1/s]."""


@value_class
class BoardPoses:
    """Poses of the target in the camera's frame, of the frames that determine one.

    Attributes
    ----------
    exposures : one a frame, in the order of time
    t_s : (n,) timestamps of the frames [s]
    R_cam_target : (n, 3, 3)
    p_cam_target : (n, 3) origin of the target in the camera's frame [m]
    rotation_covariance : (n, 3, 3) of R_cam_target, turned on the left, about the camera's axes [rad^2]
    scatter_px : (n,) scatter of the frame's corners about its pose, per axis, wrong corners apart
    sigma_px : robust scatter of the corners about the poses, per axis
    """

    exposures: Exposures
    t_s: Floats
    R_cam_target: Floats
    p_cam_target: Floats
    rotation_covariance: Floats
    scatter_px: Floats
    sigma_px: float

    def __len__(self) -> int:
        return len(self.t_s)

    def where(self, kept: np.ndarray) -> "BoardPoses":
        """Return the poses of some frames, (n,) bool; the exposures stay those of all."""
        return replace(
            self,
            t_s=self.t_s[kept],
            R_cam_target=self.R_cam_target[kept],
            p_cam_target=self.p_cam_target[kept],
            rotation_covariance=self.rotation_covariance[kept],
            scatter_px=self.scatter_px[kept],
        )


def gather_exposures(frames: CameraFrames, target: Target, fewest: int = FEWEST_CORNERS) -> Exposures:
    """Return the corners of the frames that have enough of them to be used, not all on one line."""
    counts = np.bincount(frames.frame, minlength=len(frames.t_ns))
    points = target.points[frames.point]
    kept = np.flatnonzero((counts >= fewest) & _spread_out(points, frames.frame, counts))
    chosen = np.isin(frames.frame, kept)
    return Exposures(
        frame=kept,
        start=np.concatenate([[0], np.cumsum(counts[kept])]),
        points=points[chosen],
        pixels=frames.pixels[chosen],
        delay_rows=np.zeros(len(kept)),
        point=frames.point[chosen],
    )


def thin_exposures(exposures: Exposures) -> Exposures:
    """Return the exposures with some fifty of their corners each: enough for a first pose."""
    lengths = np.diff(exposures.start)
    stride = np.maximum(lengths // ENOUGH_CORNERS, 1)
    rank = np.arange(len(exposures.points)) - np.repeat(exposures.start[:-1], lengths)
    kept = rank % np.repeat(stride, lengths) == 0
    counts = -(-lengths // stride)
    return Exposures(
        frame=exposures.frame,
        start=np.concatenate([[0], np.cumsum(counts)]),
        points=exposures.points[kept],
        pixels=exposures.pixels[kept],
        delay_rows=exposures.delay_rows,
        point=None if exposures.point is None else exposures.point[kept],
    )


def _spread_out(points: Floats, frame: Integers, counts: Integers) -> np.ndarray:
    """Tell which frames have corners that span the plane, (f,)."""
    size = len(counts)
    n = np.maximum(counts, 1)
    x, y = points[:, 0], points[:, 1]
    mx, my = np.bincount(frame, x, size) / n, np.bincount(frame, y, size) / n
    xx = np.bincount(frame, x * x, size) / n - mx * mx
    yy = np.bincount(frame, y * y, size) / n - my * my
    xy = np.bincount(frame, x * y, size) / n - mx * my
    trace, determinant = xx + yy, xx * yy - xy * xy
    return determinant > 1e-4 * np.maximum(trace, 1e-30) ** 2


def board_poses(frames: CameraFrames, target: Target, t_s: Floats) -> BoardPoses:
    """Return the pose of the target in every frame that determines it.

    Parameters
    ----------
    frames : of one camera
    target : the board, planar
    t_s : (n,) timestamps of all frames [s]
    """
    exposures = thin_exposures(every := gather_exposures(frames, target))
    if not len(exposures):
        return BoardPoses(
            exposures=every,
            t_s=np.empty(0),
            R_cam_target=np.empty((0, 3, 3)),
            p_cam_target=np.empty((0, 3)),
            rotation_covariance=np.empty((0, 3, 3)),
            scatter_px=np.empty(0),
            sigma_px=float("nan"),
        )
    first_poses = resection_poses if target.kind == "landmarks" else homography_poses
    rotation, p = first_poses(exposures, frames.camera)
    noise = CornerNoise(sigma_px=1.0, huber=np.inf)
    for step in range(_REFINEMENTS):
        sums = corner_sums(exposures, frames.camera, rotation, p, noise)
        gram, gradient = sums.gram[:, :TWIST, :TWIST], sums.gram[:, :TWIST, TWIST]
        damped = gram + 1e-9 * np.einsum("nii->ni", gram)[:, :, None] * np.eye(TWIST) + 1e-12 * np.eye(TWIST)
        twist = -np.linalg.solve(damped, gradient[:, :, None])[:, :, 0]
        turn = rotation_from_rotvec(_limited(twist[:, :3]))
        rotation = turn @ rotation
        p = np.einsum("nij,nj->ni", turn, p) + twist[:, 3:]
        if step >= 1:  # from here on wrong corners count less
            noise = CornerNoise(sigma_px=max(_scatter(sums.residual), 1e-6), huber=_HUBER)
        if step >= 1 and np.quantile(np.abs(twist), 0.99) < _AT_REST:
            break
    sums = corner_sums(exposures, frames.camera, rotation, p, noise)
    sigma_px = max(
        _scatter(sums.residual) * np.sqrt(2 * sums.valid.sum() / float(np.maximum(2 * sums.valid - TWIST, 1).sum())),
        SMALLEST_PX,
    )
    scatter = frame_scatter(exposures, sums, sums.valid > 0)[exposures.frame]
    return BoardPoses(
        exposures=replace(every, spread=_spread(frames, every, sigma_px)),
        t_s=t_s[exposures.frame],
        R_cam_target=rotation,
        p_cam_target=p,
        rotation_covariance=_rotation_covariance(sums.gram[:, :TWIST, :TWIST] * (noise.sigma_px / sigma_px) ** 2),
        scatter_px=np.maximum(np.sqrt(np.nan_to_num(scatter, nan=np.inf)), SMALLEST_PX),  # infinite: no pose at all
        sigma_px=sigma_px,
    )


def _spread(frames: CameraFrames, every: Exposures, sigma_px: float) -> Floats | None:
    """Return the standard deviation of each corner over that of a usual one.

    What the detector knows of each corner adds up with what is common to all, such as the errors of the board and of
    the lens, of which it knows nothing.
    """
    if frames.sigma_px is None:
        return None
    own = np.square(frames.sigma_px[np.isin(frames.frame, every.frame)])
    variance = own + max(sigma_px**2 - float(np.median(own)), 0.0)
    return np.sqrt(variance / np.median(variance))


def _rotation_covariance(information: Floats) -> Floats:
    """Return the covariance (n, 3, 3) of rotations, by the information (n, 6, 6) on rotation and translation."""
    size = 1 / np.sqrt(np.maximum(np.einsum("nii->ni", information), 1e-12))
    scaled = information * size[:, :, None] * size[:, None, :] + 1e-9 * np.eye(TWIST)
    return (np.linalg.inv(scaled) * size[:, :, None] * size[:, None, :])[:, :3, :3]


def _scatter(residual: Floats) -> float:
    """Return the standard deviation per axis by the median distance, sqrt(2 ln 2) sigma for a normal distribution."""
    distance = np.sqrt(np.einsum("ij,ij->i", residual, residual))
    return float(np.nanmedian(distance)) / np.sqrt(2 * np.log(2))


def _limited(vectors: Floats) -> Floats:
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return vectors * np.minimum(1.0, 0.3 / np.maximum(length, 1e-300))


def homography_poses(exposures: Exposures, camera: Camera) -> tuple[Floats, Floats]:
    """Return poses from the homography H with H (x, y, 1) along the viewing ray of each corner.

    |ray x H p|^2 is least where the eigenvector of sum (I - ray ray') (x) p p' with the smallest eigenvalue is taken.

    Parameters
    ----------
    exposures : e of them, each with four corners at least, not three on one line
    camera : whose rays are taken; corners at pixels without a ray do not count

    Returns
    -------
    R_cam_target : (e, 3, 3)
    p_cam_target : (e, 3) [m]
    """
    rays, valid = camera.unproject(exposures.pixels)
    rays = np.where(valid[:, None], rays, 0.0)
    xy = exposures.points[:, :2]
    centre = 0.5 * (xy.min(axis=0) + xy.max(axis=0))
    size = float(np.ptp(xy, axis=0).max()) / 2
    x, y = ((xy - centre) / size).T
    weight = valid.astype(np.float64)
    plane = (weight * x * x, weight * x * y, weight * x, weight * y * y, weight * y, weight)
    across = {(i, j): float(i == j) - rays[:, i] * rays[:, j] for i in range(3) for j in range(i, 3)}
    starts = exposures.start[:-1]
    normal = np.empty((len(exposures), 3, 3, 3, 3))  # ray axis, plane axis, ray axis, plane axis
    symmetric = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
    for (i, j), outer in across.items():
        for (a, b), product in zip(symmetric, plane, strict=True):
            total = np.add.reduceat(outer * product, starts)
            for row, column in ((i, j), (j, i)):
                normal[:, row, a, column, b] = normal[:, row, b, column, a] = total
    _, vectors = np.linalg.eigh(normal.reshape(-1, 9, 9))
    homography = vectors[:, :, 0].reshape(-1, 3, 3)
    seen = np.einsum("nij,nj->ni", homography, _mean_plane_point(x, y, weight, starts))
    toward = np.stack([np.add.reduceat(rays[:, i], starts) for i in range(3)], axis=1)
    homography *= np.where(np.einsum("ni,ni->n", seen, toward) < 0, -1.0, 1.0)[:, None, None]
    lengths = np.linalg.norm(homography[:, :, :2], axis=1)
    homography /= np.maximum(np.sqrt(lengths.prod(axis=1)), 1e-300)[:, None, None]
    first, second = homography[:, :, 0], homography[:, :, 1]
    axes = np.stack([first, second, np.cross(first, second)], axis=2)
    left, _, right = np.linalg.svd(axes)
    rotation = left @ right
    rotation *= np.where(np.linalg.det(rotation) < 0, -1.0, 1.0)[:, None, None]
    origin = np.array([*centre, 0.0])
    return rotation, homography[:, :, 2] * size - rotation @ origin


def resection_poses(exposures: Exposures, camera: Camera) -> tuple[Floats, Floats]:
    """Return poses from points that lie anywhere, exposure by exposure; see `homography_poses`."""
    import cv2

    rays, valid = camera.unproject(exposures.pixels)
    ahead = valid & (rays[:, 2] > 0.1)
    R, p = np.tile(np.eye(3), (len(exposures), 1, 1)), np.zeros((len(exposures), 3))
    for k, corners in enumerate(pairwise(exposures.start.tolist())):
        rows = np.arange(*corners)[ahead[slice(*corners)]]
        if len(rows) < FEWEST_CORNERS:
            continue
        plane = rays[rows, :2] / rays[rows, 2:]
        with suppress(cv2.error):  # of points that lie together: the camera hardly moved, and its scene has no size
            found, turn, place = cv2.solvePnP(exposures.points[rows], plane, np.eye(3), None, flags=cv2.SOLVEPNP_SQPNP)
            if found:
                R[k], p[k] = rotation_from_rotvec(np.asarray(turn, np.float64).ravel()), place.ravel()
    return R, p


def _mean_plane_point(x: Floats, y: Floats, weight: Floats, starts: Integers) -> Floats:
    total = np.maximum(np.add.reduceat(weight, starts), 1e-300)
    means = [np.add.reduceat(weight * value, starts) / total for value in (x, y)]
    return np.stack([*means, np.ones(len(starts))], axis=1)


def camera_accelerations(poses: BoardPoses, time_shift_s: float) -> tuple[Integers, Floats, Floats]:
    """Return frames that have neighbours at about a step before and after, and the camera's acceleration there.

    The step is STEP_S, or from frame to frame where these are rarer.

    Parameters
    ----------
    poses : of the board
    time_shift_s : t_imu = t_cam + time_shift_s

    Returns
    -------
    frame : (m,) indices into the poses
    acceleration : (m, 3) in the frame of the board [m/s^2]
    at_s : (m, k) instants of the IMU over which `averaged_readings` goes [s]
    """
    t_s = poses.t_s + time_shift_s
    step_s = max(STEP_S, float(np.median(np.diff(t_s)))) if len(t_s) > 1 else STEP_S
    position = -np.einsum("nji,nj->ni", poses.R_cam_target, poses.p_cam_target)
    before, after = _nearest(t_s, t_s - step_s), _nearest(t_s, t_s + step_s)
    back, ahead = t_s - t_s[before], t_s[after] - t_s
    usable = (np.abs(back - step_s) < 0.5 * step_s) & (np.abs(ahead - step_s) < 0.5 * step_s)
    frame = np.flatnonzero(usable)
    before, after, back, ahead = before[frame], after[frame], back[frame][:, None], ahead[frame][:, None]
    slope_after = (position[after] - position[frame]) / ahead
    slope_before = (position[frame] - position[before]) / back
    at_s = t_s[frame][:, None] + OFFSETS_S * (step_s / STEP_S)
    return frame, 2 * (slope_after - slope_before) / (back + ahead), at_s


def _nearest(t_s: Floats, at_s: Floats) -> Integers:
    """Return which of instants (n,), ascending, is nearest to others (m,)."""
    if len(t_s) < 2:
        return np.zeros(len(at_s), dtype=np.int64)
    after = np.clip(np.searchsorted(t_s, at_s), 1, len(t_s) - 1)
    return after - (at_s - t_s[after - 1] < t_s[after] - at_s)


def averaged_readings(at_s: Floats, t_s: Floats, values: Floats, weights: Floats = TRIANGLE) -> Floats:
    """Return readings (n, 3) with timestamps (n,) [s] at instants (m, k) [s], summed with weights (k,), (m, 3)."""
    return np.stack([np.interp(at_s, t_s, values[:, i]) @ weights for i in range(3)], axis=1)


def averaged_derivative(at_s: Floats, t_s: Floats, values: Floats) -> Floats:
    """Return the derivative of readings as `averaged_readings` takes them, (m, 3)."""
    longer = (at_s[:, -1] - at_s[:, 0]) / (OFFSETS_S[-1] - OFFSETS_S[0])
    return averaged_readings(at_s, t_s, values, DIFFERENCE) / longer[:, None]
