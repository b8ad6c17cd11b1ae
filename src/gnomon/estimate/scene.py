"""Where landmarks of a scene are, and how a camera and an IMU moved among them.

How the camera turned from image to image, by the rays to points that it followed: of two images the rotation R and the
direction t of the way between them make each pair of rays and t lie in a plane, t . (R b1 x b2) = 0: the essential
matrix, found so that most pairs of rays agree.

Where the rig was and what it saw, by one linear problem, rotations being known by the gyroscope: of key frames at t_k
the IMU is at p_k, the camera at C_k = p_k + R_k c; a point X is seen along a ray b, and what of X - C_k lies across b
is small. The accelerometer gives the scale: with alpha, beta the double and single integral of the specific force in
the world's axes from key frame to key frame, A and B those of the rotation, T the time,

    (p_k+1 - p_k) / T_k - (p_k - p_k-1) / T_k-1
        = g (T_k + T_k-1) / 2 + alpha_k / T_k - alpha_k-1 / T_k-1 + beta_k-1 - (A_k / T_k - A_k-1 / T_k-1 + B_k-1) bias.

Points are eliminated one by one; what is left is as large as the path. Robust weights follow from the angles.

Bundle adjustment: the poses of key frames and points that explain best where the points were seen. Points are
eliminated from the normal equations one by one (Schur complement). What shifts, turns or scales the whole is held by
the damping alone; a camera and an IMU tell it afterwards.
"""

from typing import Any

import cv2
import numpy as np
from scipy.sparse import bsr_array, csr_array

from ..frozen import value_class
from ..geometry.rotations import (
    rk4n_steps,
    rotation_from_quaternion,
    rotation_from_rotvec,
    rotvec_from_rotation,
    running_products,
    skew,
)
from ..models.camera import Camera
from ..processes import results_ahead
from ..progress import tell_parts
from ..recording import Floats, Integers
from .camera_imu.start.alignment import gyroscope_integral
from .camera_imu.start.board_poses import BoardPoses
from .camera_imu.start.first_guess import ImuStream
from .camera_imu.terms.visual_terms import Exposures

FEWEST_SHARED = 15
"""Points that two images must share."""

_TRUSTED = 0.999
_TURN_ROUNDS, _ROBUST = 4, 2.0
_SENSITIVITY, _BIAS_RAD_S, _G_SENSITIVITY = 0.02, 0.2, 2e-3


def turns_between(
    rays: Floats, pairs: list[tuple[Integers, Integers]], tolerance: float
) -> tuple[Floats, Floats, np.ndarray]:
    """Return rotations from the earlier camera frame to the later one, of pairs of images.

    Parameters
    ----------
    rays : (m, 3) towards all sightings
    pairs : for each pair of images, the sightings (k,) of the points in both
    tolerance : how far a ray may be off [rad]

    Returns
    -------
    R : (p, 3, 3) identity where it cannot be told
    moved : (p,) median angle between the rays, as they are [rad]
    known : (p,) whether it can be told
    """
    found = list(results_ahead(lambda pair: _turn_between(rays[pair[0]], rays[pair[1]], tolerance), pairs))
    R, moved, known = (np.array(part) for part in zip(*found, strict=True))
    return R.reshape(-1, 3, 3), moved, known


def _turn_between(first: Floats, second: Floats, tolerance: float) -> tuple[Floats, float, bool]:
    """Return what `turns_between` does, of the rays (k, 3) that two images share."""
    ahead = (first[:, 2] > 0.1) & (second[:, 2] > 0.1)
    a, b = first[ahead], second[ahead]
    if len(a) < FEWEST_SHARED:
        return np.eye(3), 0.0, False
    moved = float(np.median(np.linalg.norm(a - b, axis=1)))
    before, after = (np.ascontiguousarray(side[:, :2] / side[:, 2:]) for side in (a, b))
    matrix, inside = cv2.findEssentialMat(
        before, after, np.eye(3), method=cv2.USAC_MAGSAC, prob=_TRUSTED, threshold=tolerance
    )
    if np.shape(matrix) != (3, 3):
        return np.eye(3), moved, False
    count, R, _, _ = cv2.recoverPose(matrix, before, after, np.eye(3), mask=inside)
    return np.asarray(R, np.float64), moved, count >= FEWEST_SHARED


def turning_poses(t_s: Floats, R: Floats) -> BoardPoses:
    """Return the attitudes of a camera, from the first image on, as the alignment with a gyroscope takes them.

    Parameters
    ----------
    t_s : (n,) timestamps [s]
    R : (n - 1, 3, 3) rotation from each camera frame to the next; where it is not known the camera seems to stand
        still, for which the alignment is robust
    """
    attitudes = np.empty((len(t_s), 3, 3))
    attitudes[0] = np.eye(3)
    for k, turn in enumerate(R):
        attitudes[k + 1] = turn @ attitudes[k]
    count = len(t_s)
    empty = np.empty((0, 3))
    return BoardPoses(
        exposures=Exposures(
            frame=np.arange(count),
            start=np.zeros(count + 1, np.int64),
            points=empty,
            pixels=empty[:, :2],
            delay_rows=np.zeros(count),
        ),
        t_s=t_s,
        R_cam_target=attitudes,
        p_cam_target=np.zeros((count, 3)),
        rotation_covariance=np.tile(np.eye(3), (count, 1, 1)),
        scatter_px=np.ones(count),
        sigma_px=1.0,
    )


@value_class
class SeenTurns:
    """Rotations R (p, 3, 3) of the IMU from instants to later ones, v_earlier = R v_later, as a camera saw them.

    `start_s` and `stop_s` (p,) are on the IMU's clock.
    """

    start_s: Floats
    stop_s: Floats
    R: Floats


def attitudes_of(rate: Floats, t_s: Floats, at_s: Floats) -> Floats:
    """Return the attitudes (k, 3, 3) at instants (k,) by angular rates (n, 3) at t_s, relative to that at the first."""
    steps = rk4n_steps(rate[:-1], rate[1:], np.diff(t_s))
    products = running_products(steps, np.array([len(steps)]))
    R = rotation_from_quaternion(np.concatenate([[[1.0, 0, 0, 0]], products]))
    before = np.clip(np.searchsorted(t_s, at_s, side="right") - 1, 0, len(t_s) - 1)
    return R[before] @ rotation_from_rotvec(rate[before] * (at_s - t_s[before])[:, None])


def rates_by_camera(turns: SeenTurns, stream: ImuStream) -> Floats:
    """Return angular rates (n, 3) [rad/s] at the readings: the gyroscope's, corrected by what the camera saw.

    Sensitivity, bias and g-sensitivity would turn the path by degrees within a minute; 21 numbers mend most of it.
    """
    columns = np.concatenate([stream.rate, np.ones((len(stream.rate), 1)), stream.force], axis=1)
    usual = np.tile(np.concatenate([np.full(3, _SENSITIVITY), [_BIAS_RAD_S], np.full(3, _G_SENSITIVITY)]) ** -2.0, 3)

    def change(correction: Floats) -> Floats:
        rate = stream.rate + columns @ correction.T
        R = attitudes_of(rate, stream.t_s, stream.t_s)
        # a correction of the rate turns the world axes by the integral of R times it
        by_world = (R[:, :, :, None] * columns[:, None, None, :]).reshape(len(R), 3, 21)
        integral = gyroscope_integral(stream.t_s, by_world.reshape(len(R), 63))
        ends = [attitudes_of(rate, stream.t_s, at) for at in (turns.start_s, turns.stop_s)]
        off = rotvec_from_rotation(ends[0] @ turns.R @ np.swapaxes(ends[1], 1, 2))
        J = (integral(turns.stop_s) - integral(turns.start_s)).reshape(-1, 3, 21)
        length = np.linalg.norm(off, axis=1)
        sigma = float(np.median(length)) / 1.54
        weight = np.minimum(1.0, _ROBUST * sigma / np.maximum(length, 1e-12)) ** 2 / sigma**2
        weighted = J * weight[:, None, None]
        H = np.einsum("pai,paj->ij", weighted, J) + np.diag(usual)
        solved = np.linalg.solve(H, np.einsum("pai,pa->i", weighted, off) - usual * correction.ravel())
        return np.asarray(solved.reshape(3, 7), np.float64)

    correction = np.zeros((3, 7))
    for _ in range(_TURN_ROUNDS):
        correction += change(correction)
    return stream.rate + columns @ correction.T


_RAY_RAD = 0.05  # of a ray, with the error of the gyroscope's rotation
_FORCE_M_S2 = 0.3  # of the specific force in the world's axes, mean from key frame to key frame
_ARM_M, _BIAS_M_S2 = 0.3, 0.5
_ROUNDS = 5
_USUAL_M = 2.0  # depth, before anything is known of it
_DEPTHS_M = 0.2, 20.0


@value_class
class ScenePath:
    """A first guess of path and scene.

    Attributes
    ----------
    position : (k, 3) of the IMU at key frames [m], world axes
    arm : (3,) of the camera in the IMU's frame [m]
    points : (n, 3) [m], world axes
    angle : (m,) by which sightings are off [rad]
    """

    position: Floats
    arm: Floats
    points: Floats
    angle: Floats


def find_scene_path(
    key_t_s: Floats,
    R_world_imu: Floats,
    stream: ImuStream,
    R_stream: Floats,
    sightings: tuple[Integers, Integers, Floats],
) -> ScenePath:
    """Return path and points in metres.

    Parameters
    ----------
    key_t_s : (k,) when the key frames were exposed, on the IMU's clock [s]
    R_world_imu : (k, 3, 3) attitude then
    stream, R_stream : readings of the IMU, and its attitude (n, 3, 3) at them
    sightings : key frame (m,), point (m,) from 0 without gaps, and ray (m, 3) of length 1 in world axes
    """
    frame, point, ray = sightings
    keys, count = len(key_t_s), int(point.max()) + 1
    across = np.eye(3) - ray[:, :, None] * ray[:, None, :]
    H_inertial, rhs_inertial = _inertial_equations(key_t_s, stream, R_stream)
    arms = R_world_imu.reshape(3 * keys, 3)
    y, places = np.zeros(3 * keys + 9), np.zeros((count, 3))
    depth, weight = np.full(len(frame), _USUAL_M), np.ones(len(frame))
    angle = np.zeros(len(frame))
    width = 3 * keys + 3

    def solved(depth: Floats, weight: Floats) -> tuple[Floats, Floats, Floats]:
        """Return the unknowns (3 k + 9,), the camera at key frames (k, 3), and the points (n, 3)."""
        blocks = across * (weight / (depth * _RAY_RAD) ** 2)[:, None, None]
        of_point, of_frame = np.zeros((count, 3, 3)), np.zeros((keys, 3, 3))
        np.add.at(of_point, point, blocks)
        np.add.at(of_frame, frame, blocks)
        inverse = np.linalg.inv(of_point + 1e-3 * np.eye(3))
        W = _block_matrix(blocks, point, frame, (count, keys))
        eliminated = bsr_array((inverse, np.arange(count), np.arange(count + 1)))
        H = (_block_matrix(of_frame, np.arange(keys), np.arange(keys), (keys, keys)) - W.T @ (eliminated @ W)).toarray()
        along = np.concatenate([H, H @ arms], axis=1)
        H_y = H_inertial.copy()
        H_y[:width, :width] += np.concatenate([along, arms.T @ along])
        y = np.linalg.solve(H_y, rhs_inertial)
        C = (y[: 3 * keys] + arms @ y[3 * keys : width]).reshape(keys, 3)
        places = np.einsum("nij,nj->ni", inverse, (W @ C.ravel()).reshape(count, 3))
        return np.asarray(y, np.float64), C, places

    for _ in tell_parts("finding where the camera went", range(_ROUNDS), _ROUNDS):
        y, C, places = solved(depth, weight)
        toward = places[point] - C[frame]
        depth = np.clip(np.einsum("mi,mi->m", toward, ray), *_DEPTHS_M)
        angle = np.linalg.norm(np.einsum("mij,mj->mi", across, toward), axis=1) / depth
        weight = np.minimum(1.0, _RAY_RAD / 5 / np.maximum(angle, 1e-12))
    return ScenePath(
        position=y[: 3 * keys].reshape(keys, 3),
        arm=y[3 * keys : width],
        points=places,
        angle=np.asarray(angle, np.float64),
    )


def _block_matrix(blocks: Floats, rows: Integers, columns: Integers, shape: tuple[int, int]) -> csr_array:
    """Return a matrix of 3 x 3 blocks."""
    order = np.lexsort((columns, rows))
    start = np.searchsorted(rows[order], np.arange(shape[0] + 1))
    return bsr_array((blocks[order], columns[order], start), shape=(3 * shape[0], 3 * shape[1])).tocsr()


def _inertial_equations(key_t_s: Floats, stream: ImuStream, R_stream: Floats) -> tuple[Floats, Floats]:
    """Return the normal equations of the accelerometer and of what is usual, in positions, arm, gravity and bias."""
    keys = len(key_t_s)
    force = np.einsum("nij,nj->ni", R_stream, stream.force)
    once, twice = _integrals(stream.t_s, np.concatenate([force[:, :, None], R_stream], axis=2), key_t_s)
    T = np.diff(key_t_s)
    single = np.diff(once, axis=0)
    double = (np.diff(twice, axis=0) - T[:, None, None] * once[:-1]) / T[:, None, None]
    known = double[1:] - double[:-1] + single[:-1]  # (k - 2, 3, 4): of the force, and of a bias
    rows = np.zeros((keys - 2, 3, 3 * keys + 9))
    for axis in range(3):
        for k in range(keys - 2):
            rows[k, axis, 3 * k + axis] = 1 / T[k]
            rows[k, axis, 3 * (k + 1) + axis] = -1 / T[k] - 1 / T[k + 1]
            rows[k, axis, 3 * (k + 2) + axis] = 1 / T[k + 1]
        rows[:, axis, 3 * keys + 3 + axis] = -(T[1:] + T[:-1]) / 2
    rows[:, :, 3 * keys + 6 :] = known[:, :, 1:]
    scale = 1 / (_FORCE_M_S2 * (T[1:] + T[:-1]) / 2)
    whitened = (rows * scale[:, None, None]).reshape(-1, 3 * keys + 9)
    H = whitened.T @ whitened
    usual = np.concatenate([np.full(3, 1e-3), np.full(3 * keys - 3, np.inf), np.full(3, _ARM_M), np.full(3, 1e3)])
    H[np.diag_indices(len(H))] += np.concatenate([usual, np.full(3, _BIAS_M_S2)]) ** -2.0
    return H, whitened.T @ (known[:, :, 0] * scale[:, None]).ravel()


def _integrals(t_s: Floats, values: Floats, at_s: Floats) -> tuple[Floats, Floats]:
    """Return single and double integral of readings (n, 3, 4) from the start to instants (k,), each (k, 3, 4)."""
    flat = values.reshape(len(values), -1)
    step = np.diff(t_s)[:, None]
    once = np.concatenate([np.zeros((1, flat.shape[1])), np.cumsum(step * (flat[1:] + flat[:-1]) / 2, axis=0)])
    more = step * once[:-1] + step**2 * (2 * flat[:-1] + flat[1:]) / 6
    twice = np.concatenate([np.zeros((1, flat.shape[1])), np.cumsum(more, axis=0)])
    at = np.clip(np.searchsorted(t_s, at_s, side="right") - 1, 0, len(t_s) - 2)
    h = (at_s - t_s[at])[:, None]
    slope = (flat[at + 1] - flat[at]) / step[at]
    first = once[at] + h * flat[at] + h**2 / 2 * slope
    second = twice[at] + h * once[at] + h**2 / 2 * flat[at] + h**3 / 6 * slope
    return first.reshape(-1, *values.shape[1:]), second.reshape(-1, *values.shape[1:])


_BUNDLE_ROUNDS = 25
_DAMPING, _LEAST_DAMPED, _MOST_DAMPED = 1e-4, 1e-8, 1e4
_AT_REST = 1e-3  # relative gain of the cost
_HUBER = 2.0
_TOGETHER = 32  # points that are eliminated at once
_FAR_PX = 100.0  # of a point that has no image


@value_class
class Bundle:
    """Key frames and points.

    Attributes
    ----------
    R_cam_world, p_cam_world : (k, 3, 3) and (k, 3) poses of the world in the camera's frame [m]
    points : (n, 3) [m]
    residual : (m, 2) of the sightings [px]; nan of a point that has no image
    sigma_px : robust scatter, per axis
    """

    R_cam_world: Floats
    p_cam_world: Floats
    points: Floats
    residual: Floats
    sigma_px: float


def adjust_bundle(
    camera: Camera, sightings: tuple[Integers, Integers, Floats], R: Floats, p: Floats, points: Floats
) -> Bundle:
    """Return poses and points that fit best.

    Parameters
    ----------
    camera : the lens
    sightings : key frame (m,), point (m,) and pixel (m, 2)
    R, p, points : where to start, see `Bundle`
    """
    damping, now = _DAMPING, (R, p, points)
    linear = _linearized(camera, sightings, *now)
    sigma = _scatter(linear[0])
    for _ in range(_BUNDLE_ROUNDS):
        sigma = _scatter(linear[0])
        moved = _moved(*now, *_step(sightings, linear, (len(R), len(points)), sigma, damping))
        tried = _linearized(camera, sightings, *moved)
        before, after = (float(_cost(residual, sigma).sum()) for residual in (linear[0], tried[0]))
        if after < before:
            now, linear, damping = moved, tried, max(damping / 10, _LEAST_DAMPED)
            if before - after < _AT_REST * before:
                break
        else:
            damping *= 10
            if damping > _MOST_DAMPED:
                break
    return Bundle(R_cam_world=now[0], p_cam_world=now[1], points=now[2], residual=linear[0], sigma_px=sigma)


def _linearized(
    camera: Camera, sightings: tuple[Integers, Integers, Floats], R: Floats, p: Floats, points: Floats
) -> tuple[Floats, Floats, Floats]:
    """Return residuals (m, 2) and their derivatives by pose (m, 2, 6), turned on the left, and point (m, 2, 3)."""
    frame, point, pixels = sightings
    turned = np.einsum("mij,mj->mi", R[frame], points[point])
    image = camera.project(turned + p[frame])
    G = image.by_point
    assert G is not None
    return image.pixels - pixels, np.concatenate([-G @ skew(turned), G], axis=2), G @ R[frame]


def _scatter(residual: Floats) -> float:
    off = np.linalg.norm(residual, axis=1)
    seen = np.isfinite(off)
    return max(float(np.median(off[seen])) / np.sqrt(2 * np.log(2)), 1e-3) if seen.any() else _FAR_PX


def _cost(residual: Floats, sigma: float) -> Floats:
    off = np.nan_to_num(np.linalg.norm(residual, axis=1), nan=_FAR_PX) / sigma
    return np.where(off < _HUBER, off**2 / 2, _HUBER * (off - _HUBER / 2))


def _step(
    sightings: tuple[Integers, Integers, Floats],
    linear: tuple[Floats, Floats, Floats],
    shape: tuple[int, int],
    sigma: float,
    damping: float,
) -> tuple[Floats, Floats]:
    """Return the steps of poses (k, 6) and points (n, 3)."""
    (K, N), (frame, point, _) = shape, sightings
    off = np.linalg.norm(linear[0], axis=1) / sigma
    with np.errstate(divide="ignore", invalid="ignore"):
        weight = np.sqrt(np.where(np.isfinite(off), np.minimum(1.0, _HUBER / off), 0.0)) / sigma
    e, A, B = (np.nan_to_num(part) * weight.reshape(-1, *[1] * (part.ndim - 1)) for part in linear)
    At, Bt, each = np.swapaxes(A, 1, 2), np.swapaxes(B, 1, 2), e[:, :, None]
    U, V = _summed(At @ A, frame, K), _summed(Bt @ B, point, N)
    u, v = -_summed(At @ each, frame, K), -_summed(Bt @ each, point, N)
    _damp(U, damping)
    _damp(V, damping)
    inverse, coupling = np.linalg.inv(V), At @ B
    eliminated = coupling @ inverse[point]
    rhs = u - _summed(eliminated @ v[point], frame, K)
    poses = np.linalg.solve(_reduced(U, eliminated, coupling, frame, point), rhs.ravel()).reshape(K, 6)
    back = _summed(np.swapaxes(coupling, 1, 2) @ poses[frame, :, None], point, N)
    return np.asarray(poses, np.float64), (inverse @ (v - back))[:, :, 0]


def _reduced(U: Floats, eliminated: Floats, coupling: Floats, frame: Integers, point: Integers) -> Floats:
    """Return the equations of the poses (6 k, 6 k) without the points.

    Points that come into sight one after the other are eliminated together: few key frames see any of them.
    """
    K, N = len(U), int(point.max(initial=-1)) + 1
    reduced = np.zeros((K, 6, K, 6))
    reduced[np.arange(K), :, np.arange(K)] = U
    first = np.full(N, K)
    np.minimum.at(first, point, frame)
    rank = np.argsort(np.argsort(first, kind="stable"), kind="stable")[point]
    order = np.argsort(rank, kind="stable")
    for rows in np.split(order, np.searchsorted(rank[order], np.arange(_TOGETHER, N, _TOGETHER))):
        if not len(rows):
            continue
        low, high, number = frame[rows].min(), frame[rows].max() + 1, rank[rows] % _TOGETHER
        sides = np.zeros((2, high - low, 6, _TOGETHER, 3))
        for side, part in zip(sides, (eliminated, coupling), strict=True):
            side[frame[rows] - low, :, number] = part[rows]
        left, right = sides.reshape(2, 6 * (high - low), -1)
        reduced[low:high, :, low:high] -= (left @ right.T).reshape(high - low, 6, high - low, 6)
    return reduced.reshape(6 * K, 6 * K)


def _summed(parts: Floats, at: Integers, count: int) -> Floats:
    """Return the sums (count, ...) of the parts (m, ...) at each number."""
    member: Any = csr_array((np.ones(len(at)), (at, np.arange(len(at)))), shape=(count, len(at)))
    return (member @ parts.reshape(len(at), -1)).reshape(count, *parts.shape[1:])


def _damp(blocks: Floats, damping: float) -> None:
    """Make the diagonal of symmetric blocks (n, k, k) larger, in place."""
    every = np.arange(blocks.shape[1])
    blocks[:, every, every] += damping * np.trace(blocks, axis1=1, axis2=2)[:, None] + 1e-9


def _moved(R: Floats, p: Floats, points: Floats, poses: Floats, places: Floats) -> tuple[Floats, Floats, Floats]:
    return rotation_from_rotvec(poses[:, :3]) @ R, p + poses[:, 3:], points + places
