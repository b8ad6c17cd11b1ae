"""What an IMU tells of the motion between instants, whatever the motion before (Forster et al., T-RO 2017).

With R, v, p attitude, velocity and position of the body in the world, and gravity g, over an interval of length h

    R' = R dR,    v' = v + g h + R dv,    p' = p + v h + g h^2 / 2 + R dp.

dR, dv, dp depend on the biases, to first order by Jacobians: dR(b + e) = dR Exp(J e).

Visual-inertial odometry by a multi-state constraint filter with the right-invariant error.

Poses of the last images are kept beside the state of the IMU, and each track of a landmark ties those together that saw
it, once, when it ends; the landmark itself is eliminated (Mourikis and Roumeliotis, ICRA 2007). The error is the
right-invariant one (Barrau and Bonnabel, TAC 2017; Wu et al., IROS 2017):

    R = Exp(r) R^,   v = Exp(r) v^ + s,   p = Exp(r) p^ + q,   biases b = b^ + e

by which neither place nor heading of the whole is ever observed falsely. With increments (see `preintegration`)

    r' = r + R^' n_R                              n = J e + noise
    s' = s + [g]x r h + R^ n_v + [v^']x R^' n_R
    q' = q + s h + [g]x r h^2 / 2 + R^ n_p + [p^']x R^' n_R.

A landmark f is seen at C (f - p - R^ p_imu_cam), C = R_cam_imu R^', which changes by C ([f]x r - q + its own error).
The information of a track, with H by the poses and F by the landmark, is H'(I - F (F'F)^-1 F')H over sigma^2.
"""

from dataclasses import dataclass

import numpy as np

from ..frozen import value_class
from ..geometry.rotations import right_jacobian, rotation_from_rotvec, skew
from ..recording import Floats, Integers


@value_class
class Increments:
    """Motion over k intervals.

    Attributes
    ----------
    length_s : (k,) [s]
    rotation : (k, 3, 3) dR
    velocity, position : (k, 3) dv [m/s], dp [m]
    by_bias : (k, 9, 6) derivatives of rotation (right), velocity and position by the biases of gyroscope and
        accelerometer
    covariance : (k, 9, 9) by the white noise of both, in the same order
    """

    length_s: Floats
    rotation: Floats
    velocity: Floats
    position: Floats
    by_bias: Floats
    covariance: Floats


def preintegrate_imu(
    t_s: Floats, rate: Floats, force: Floats, instants_s: Floats, densities: tuple[float, float]
) -> Increments:
    """Return the motion between neighbouring instants, by the rule of midpoints of linearly interpolated readings.

    Parameters
    ----------
    t_s : (n,) of the readings [s]
    rate, force : (n, 3) angular rate [rad/s] and specific force [m/s^2], body frame, less the biases of the start
    instants_s : (k + 1,) within the readings, rising [s]
    densities : of the white noise of gyroscope [rad/s/sqrt(Hz)] and accelerometer [m/s^2/sqrt(Hz)]
    """
    length_s = np.diff(instants_s)
    steps = max(1, round(float(np.median(length_s)) / float(np.median(np.diff(t_s)))))
    k, h = len(length_s), length_s / steps
    middles = instants_s[:-1, None] + h[:, None] * (np.arange(steps) + 0.5)
    omega, f = (
        np.stack([np.interp(middles, t_s, values[:, axis]) for axis in range(3)], axis=-1) for values in (rate, force)
    )
    rotation, velocity, position = np.tile(np.eye(3), (k, 1, 1)), np.zeros((k, 3)), np.zeros((k, 3))
    by_bias, covariance = np.zeros((k, 9, 6)), np.zeros((k, 9, 9))
    across = h[:, None, None]
    noise = (densities[0] ** 2 * across, densities[1] ** 2 * across)
    for step in range(steps):
        turn = omega[:, step] * h[:, None]
        half = rotation_from_rotvec(turn / 2)
        middle = rotation @ half
        pushed = np.einsum("kij,kj->ki", middle, f[:, step])
        by_turn = -middle @ skew(f[:, step])  # of the force in the interval's first frame, by a turn at its middle
        step_by, by_rate = np.swapaxes(half @ half, 1, 2), right_jacobian(turn) * across
        whole = np.tile(np.eye(9), (k, 1, 1))
        whole[:, :3, :3] = step_by
        whole[:, 3:6, :3] = by_turn @ np.swapaxes(half, 1, 2) * across
        whole[:, 6:, :3] = whole[:, 3:6, :3] * across / 2
        whole[:, 6:, 3:6] = np.eye(3) * across
        own = np.zeros((k, 9, 6))
        own[:, :3, :3] = -by_rate
        own[:, 3:6, :3] = -by_turn * across**2 / 2
        own[:, 3:6, 3:] = -middle * across
        own[:, 6:, :] = own[:, 3:6, :] * across / 2
        by_bias = whole @ by_bias + own
        scattered = own[:, :, :3] @ np.swapaxes(own[:, :, :3], 1, 2) / across**2 * noise[0]
        scattered += own[:, :, 3:] @ np.swapaxes(own[:, :, 3:], 1, 2) / across**2 * noise[1]
        covariance = whole @ covariance @ np.swapaxes(whole, 1, 2) + scattered
        position = position + velocity * h[:, None] + pushed * h[:, None] ** 2 / 2
        velocity = velocity + pushed * h[:, None]
        rotation = middle @ half
    return Increments(
        length_s=length_s,
        rotation=rotation,
        velocity=velocity,
        position=position,
        by_bias=by_bias,
        covariance=covariance,
    )


_IMU = 15
_ROUNDS = 4
_FARTHEST_M = 100.0
_NEAREST_M = 0.2
_FIRST_M = 3.0
_OFF = 0.03  # of a track whose rays do not meet, rms in the plane z = 1
_UP = np.array([0.0, 0.0, 1.0])


@value_class
class Sightings:
    """Tracks of landmarks, each seen in a row of images.

    Attributes
    ----------
    last : (m,) image in which each is seen last
    count : (m,) in how many
    rays : (m, w, 2) x / z and y / z in the camera's frame, the last image at the end, zero before the first
    sigma : standard deviation of those
    """

    last: Integers
    count: Integers
    rays: Floats
    sigma: float


@value_class
class Beginning:
    """Where the filter starts.

    Attributes
    ----------
    rotation, velocity, position : (3, 3) R_world_imu, (3,) [m/s], (3,) [m]
    sigma : (15,) of turn [rad], velocity, position, biases of gyroscope [rad/s] and accelerometer [m/s^2]; the biases
        begin with zero
    walks : random walks of the biases of gyroscope [rad/s/sqrt(s)] and accelerometer [m/s^2/sqrt(s)]
    gravity : (3,) in the world [m/s^2]
    """

    rotation: Floats
    velocity: Floats
    position: Floats
    sigma: Floats
    walks: tuple[float, float]
    gravity: Floats


@dataclass(slots=True, kw_only=True, eq=False)
class _State:
    R: Floats
    v: Floats
    p: Floats
    bias: Floats
    Rs: Floats  # (w, 3, 3), (w, 3) of the last images, the newest at the end
    ps: Floats
    P: Floats


def estimate_path(
    increments: Increments, sightings: Sightings, T_cam_imu: Floats, beginning: Beginning
) -> tuple[Floats, Floats]:
    """Return R_world_imu (k + 1, 3, 3) and the position of the IMU (k + 1, 3) [m] at the images.

    Each is what the filter knows at that image, and what later images tell is not carried back.

    Parameters
    ----------
    increments : between neighbouring images, k of them
    sightings : in the images, 0 to k
    T_cam_imu : (4, 4)
    beginning : at the first image
    """
    images, window = len(increments.length_s) + 1, sightings.rays.shape[1]
    state = _State(
        R=beginning.rotation.copy(),
        v=beginning.velocity.copy(),
        p=beginning.position.copy(),
        bias=np.zeros(6),
        Rs=np.tile(beginning.rotation, (window, 1, 1)),
        ps=np.tile(beginning.position, (window, 1)),
        P=np.zeros((_IMU + 6 * window,) * 2),
    )
    J = _to_invariant(state)
    state.P[:_IMU, :_IMU] = J @ np.diag(beginning.sigma**2) @ J.T
    ended = np.split(
        np.argsort(sightings.last, kind="stable"), np.cumsum(np.bincount(sightings.last, minlength=images))
    )
    R, p = np.empty((images, 3, 3)), np.empty((images, 3))
    for image in range(images):
        if image:
            _propagate(state, increments, image - 1, beginning)
        _keep_pose(state)
        if len(ended[image]):
            _update(state, sightings, ended[image], T_cam_imu)
        R[image], p[image] = state.R, state.p
    return R, p


def _to_invariant(state: _State) -> Floats:
    """Return what makes the invariant error of one in turn, velocity, position and biases."""
    J = np.eye(_IMU)
    J[3:6, :3], J[6:9, :3] = skew(state.v), skew(state.p)
    return J


def _propagate(state: _State, increments: Increments, k: int, beginning: Beginning) -> None:
    h, g = increments.length_s[k], beginning.gravity
    change = increments.by_bias[k] @ state.bias
    R = state.R
    state.R = R @ increments.rotation[k] @ rotation_from_rotvec(change[:3])
    state.p = state.p + state.v * h + g * (h * h / 2) + R @ (increments.position[k] + change[6:])
    state.v = state.v + g * h + R @ (increments.velocity[k] + change[3:6])
    noise = np.zeros((9, 9))
    noise[:3, :3] = state.R
    noise[3:6, :3], noise[6:, :3] = skew(state.v) @ state.R, skew(state.p) @ state.R
    noise[3:6, 3:6] = noise[6:, 6:] = R
    step = np.eye(_IMU)
    step[3:6, :3] = skew(g) * h
    step[6:9, :3] = skew(g) * (h * h / 2)
    step[6:9, 3:6] = np.eye(3) * h
    step[:9, 9:] = noise @ increments.by_bias[k]
    P = state.P
    P[:_IMU, _IMU:] = step @ P[:_IMU, _IMU:]
    P[_IMU:, :_IMU] = P[:_IMU, _IMU:].T
    P[:_IMU, :_IMU] = step @ P[:_IMU, :_IMU] @ step.T
    P[:9, :9] += noise @ increments.covariance[k] @ noise.T
    walk = np.repeat(np.square(beginning.walks), 3) * h
    P[range(9, _IMU), range(9, _IMU)] += walk


def _keep_pose(state: _State) -> None:
    """Drop the oldest pose, and keep the present one."""
    own = np.array([0, 1, 2, 6, 7, 8])
    order = np.concatenate([np.arange(_IMU), np.arange(_IMU + 6, len(state.P)), own])
    state.P = state.P[np.ix_(order, order)]
    state.Rs, state.ps = (
        np.concatenate([state.Rs[1:], state.R[None]]),
        np.concatenate([state.ps[1:], state.p[None]]),
    )


def _update(state: _State, sightings: Sightings, rows: Integers, T_cam_imu: Floats) -> None:
    found = _information(state, sightings, rows, T_cam_imu)
    if found is None:
        return
    A, b = found
    # (P^-1 + A)^-1 = P - P_c (I + A P_cc)^-1 A P_c', with the columns P_c of the poses, and the same times b
    columns = state.P[:, _IMU:]
    gain = np.linalg.solve(np.eye(len(A)) + columns[_IMU:] @ A, columns.T).T
    state.P = state.P - gain @ A @ columns.T
    state.P = (state.P + state.P.T) / 2
    change = gain @ b
    turn = rotation_from_rotvec(change[:3])
    state.R, state.v, state.p = turn @ state.R, turn @ state.v + change[3:6], turn @ state.p + change[6:9]
    state.bias = state.bias + change[9:_IMU]
    poses = change[_IMU:].reshape(-1, 6)
    turns = rotation_from_rotvec(poses[:, :3])
    state.Rs = turns @ state.Rs
    state.ps = np.einsum("wij,wj->wi", turns, state.ps) + poses[:, 3:]


def _information(
    state: _State, sightings: Sightings, rows: Integers, T_cam_imu: Floats
) -> tuple[Floats, Floats] | None:
    """Return the information of tracks on the kept poses, (6 w, 6 w), and its right-hand side (6 w,)."""
    rays, window = sightings.rays[rows], sightings.rays.shape[1]
    seen = np.arange(window) >= window - sightings.count[rows][:, None]
    C = T_cam_imu[:3, :3] @ np.swapaxes(state.Rs, 1, 2)
    centre = state.ps - np.einsum("wji,j->wi", C, T_cam_imu[:3, 3])
    to_each, arm = C @ C[-1].T, np.einsum("wij,wj->wi", C, centre[-1] - centre)
    guess = np.concatenate([rays[:, -1], np.full((len(rows), 1), 1 / _FIRST_M)], axis=1)
    for _ in range(_ROUNDS):
        residual, by_guess, _, _ = _residuals(guess, rays, seen, to_each, arm)
        square = np.einsum("mwai,mwaj->mij", by_guess, by_guess)
        square[:, range(3), range(3)] += 1e-9 * np.trace(square, axis1=1, axis2=2)[:, None]
        step = np.linalg.solve(square, np.einsum("mwai,mwa->mi", by_guess, residual)[..., None])[..., 0]
        guess = guess + np.where(np.isfinite(step), step, 0.0)
        guess[:, 2] = np.clip(guess[:, 2], 1 / _FARTHEST_M, 1 / _NEAREST_M)
    residual, by_guess, place, by_place = _residuals(guess, rays, seen, to_each, arm)
    square = np.einsum("mwai,mwaj->mij", by_guess, by_guess)
    off = np.sqrt(np.sum(residual**2, axis=(1, 2)) / (2 * sightings.count[rows]))
    told = np.linalg.inv(square)[:, 2, 2] * sightings.sigma**2 < 0.25 * guess[:, 2] ** 2
    kept = told & (off < _OFF) & (place[..., 2].min(axis=1, where=seen, initial=np.inf) > 0)
    if not kept.any():
        return None
    residual, by_guess, by_place = residual[kept], by_guess[kept], by_place[kept]
    inverse = np.linalg.inv(square[kept])
    point = centre[-1] + (np.concatenate([guess[kept, :2], np.ones((kept.sum(), 1))], axis=1) @ C[-1]) / guess[kept, 2:]
    by_point = by_place @ C  # (m, w, 2, 3)
    H = np.concatenate([by_point @ skew(point)[:, None], -by_point], axis=-1)
    G = np.einsum("mwai,mwaj->mwij", H, by_guess).reshape(len(H), -1, 3)
    weighed = G @ inverse
    A = -np.einsum("mik,mjk->ij", weighed, G)
    own = np.einsum("mwai,mwaj->wij", H, H)
    for k in range(window):
        A[6 * k : 6 * k + 6, 6 * k : 6 * k + 6] += own[k]
    b = np.einsum("mwai,mwa->wi", H, residual).ravel()
    b -= np.einsum("mik,mk->i", weighed, np.einsum("mwai,mwa->mi", by_guess, residual))
    return A / sightings.sigma**2, b / sightings.sigma**2


def _residuals(
    guess: Floats, rays: Floats, seen: np.ndarray, to_each: Floats, arm: Floats
) -> tuple[Floats, Floats, Floats, Floats]:
    """Return residuals of landmarks by x / z, y / z and 1 / z in the last camera, and what follows from them.

    Returns
    -------
    residual : (m, w, 2) seen less predicted, zero where nothing was seen
    by_guess : (m, w, 2, 3)
    place : (m, w, 3) of the landmark in each camera, over its depth in the last one
    by_place : (m, w, 2, 3) of the prediction, by the place in metres
    """
    direction = guess * np.array([1.0, 1.0, 0.0]) + _UP
    place = np.einsum("wij,mj->mwi", to_each, direction) + guess[:, 2, None, None] * arm
    depth = np.where(np.abs(place[..., 2]) > 1e-6, place[..., 2], 1e-6)
    xy = place[..., :2] / depth[..., None]
    weight = seen / depth
    by_place = np.zeros((*xy.shape, 3))
    by_place[..., 0, 0] = by_place[..., 1, 1] = weight
    by_place[..., 2] = -xy * weight[..., None]
    by_guess = np.empty_like(by_place)
    by_guess[..., :2] = by_place @ to_each[:, :, :2]
    by_guess[..., 2] = np.einsum("mwai,wi->mwa", by_place, arm)
    residual = np.where(seen[..., None], rays - xy, 0.0)
    return residual, by_guess, place, by_place * guess[:, 2, None, None, None]
