"""How a camera turned from image to image, by the rays to points that it followed.

Of two images the rotation R and the direction t of the way between them make each pair of rays and t lie in a plane,
t . (R b1 x b2) = 0: the essential matrix, found so that most pairs of rays agree.

Where a rig was and what it saw, by one linear problem: rotations are known, by the gyroscope.

Of key frames at t_k the IMU is at p_k, the camera at C_k = p_k + R_k c; a point X is seen along a ray b, and what of
X - C_k lies across b is small. The accelerometer gives the scale: with alpha, beta the double and single integral of
the specific force in the world's axes from key frame to key frame, A and B those of the rotation, T the time,

    (p_k+1 - p_k) / T_k - (p_k - p_k-1) / T_k-1
        = g (T_k + T_k-1) / 2 + alpha_k / T_k - alpha_k-1 / T_k-1 + beta_k-1 - (A_k / T_k - A_k-1 / T_k-1 + B_k-1) bias.

Points are eliminated one by one; what is left is as large as the path. Robust weights follow from the angles.
"""

import cv2
import numpy as np
from scipy.sparse import bsr_array, csr_array

from ...frozen import value_class
from ...geometry.quaternion import rk4n_steps, rotation_from_quaternion, running_products
from ...geometry.rotation_vector import rotation_from_rotvec, rotvec_from_rotation
from ...processes import results_ahead
from ...progress import tell_parts
from ...recording import Floats, Integers
from ..camera_imu.start.alignment import gyroscope_integral
from ..camera_imu.start.board_poses import BoardPoses
from ..camera_imu.start.first_guess import ImuStream
from ..camera_imu.terms.visual_terms import Exposures

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
    correction = np.zeros((3, 7))
    for _ in range(_TURN_ROUNDS):
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
        correction += np.linalg.solve(H, np.einsum("pai,pa->i", weighted, off) - usual * correction.ravel()).reshape(
            3, 7
        )
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
    for _ in tell_parts("finding where the camera went", range(_ROUNDS), _ROUNDS):
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
        toward = places[point] - C[frame]
        depth = np.clip(np.einsum("mi,mi->m", toward, ray), *_DEPTHS_M)
        angle = np.linalg.norm(np.einsum("mij,mj->mi", across, toward), axis=1) / depth
        weight = np.minimum(1.0, _RAY_RAD / 5 / np.maximum(angle, 1e-12))
    return ScenePath(
        position=np.asarray(y[: 3 * keys].reshape(keys, 3), np.float64),
        arm=np.asarray(y[3 * keys : width], np.float64),
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
