"""Bundle adjustment: poses of key frames and points of a scene that explain where the points were seen best.

Points are eliminated from the normal equations one by one (Schur complement). What shifts, turns or scales the whole
is held by the damping alone; a camera and an IMU tell it afterwards.
"""

from typing import Any

import numpy as np
from scipy.sparse import bsr_array  # pyright: ignore[reportUnknownVariableType]

from ...frozen import value_class
from ...geometry.rotation_vector import rotation_from_rotvec, skew
from ...models.camera import Camera
from ...recording import Floats, Integers

_ROUNDS = 25
_DAMPING, _LEAST_DAMPED, _MOST_DAMPED = 1e-4, 1e-8, 1e4
_AT_REST = 1e-3  # relative gain of the cost
_HUBER = 2.0
_DENSE = 0.05  # share of the points in a key frame, from which on zeros for all others cost less
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
    U, V, u, v = np.zeros((K, 6, 6)), np.zeros((N, 3, 3)), np.zeros((K, 6)), np.zeros((N, 3))
    At, Bt = np.swapaxes(A, 1, 2), np.swapaxes(B, 1, 2)
    np.add.at(U, frame, At @ A)
    np.add.at(V, point, Bt @ B)
    np.add.at(u, frame, -np.einsum("mji,mj->mi", A, e))
    np.add.at(v, point, -np.einsum("mji,mj->mi", B, e))
    _damp(U, damping)
    _damp(V, damping)
    inverse = np.linalg.inv(V)
    order = np.lexsort((point, frame))
    start = np.searchsorted(frame[order], np.arange(K + 1))
    coupling: Any = bsr_array(((At @ B)[order], point[order], start), shape=(6 * K, 3 * N))
    if len(frame) > _DENSE * K * N:
        coupling = coupling.toarray()
    eliminated = (bsr_array((np.swapaxes(inverse, 1, 2), np.arange(N), np.arange(N + 1))) @ coupling.T).T
    product = eliminated @ coupling.T
    reduced = product if isinstance(product, np.ndarray) else product.toarray()
    reduced.reshape(K, 6, K, 6)[np.arange(K), :, np.arange(K)] -= U
    poses = np.linalg.solve(reduced, eliminated @ v.ravel() - u.ravel())
    places = np.einsum("nij,nj->ni", inverse, v - (coupling.T @ poses).reshape(N, 3))
    return poses.reshape(K, 6), places


def _damp(blocks: Floats, damping: float) -> None:
    """Make the diagonal of symmetric blocks (n, k, k) larger, in place."""
    every = np.arange(blocks.shape[1])
    blocks[:, every, every] += damping * np.trace(blocks, axis1=1, axis2=2)[:, None] + 1e-9


def _moved(R: Floats, p: Floats, points: Floats, poses: Floats, places: Floats) -> tuple[Floats, Floats, Floats]:
    return rotation_from_rotvec(poses[:, :3]) @ R, p + poses[:, 3:], points + places
