"""Bundle adjustment: poses of key frames and points of a scene that explain where the points were seen best.

Points are eliminated from the normal equations one by one (Schur complement). What shifts, turns or scales the whole
is held by the damping alone; a camera and an IMU tell it afterwards.
"""

from typing import Any

import numpy as np
from scipy.sparse import csr_array  # pyright: ignore[reportUnknownVariableType]

from ...frozen import value_class
from ...geometry.rotation_vector import rotation_from_rotvec, skew
from ...models.camera import Camera
from ...recording import Floats, Integers

_ROUNDS = 25
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
    for _ in range(_ROUNDS):
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
