"""Ellipsoids through measurements of known magnitude, in closed form."""

import numpy as np

from ...frozen import value_class
from ...geometry.rotation_vector import invert_matrix
from ...recording import Floats

_LEVEL_STEPS = 20
_LARGEST_RATIO = 30.0  # between the axes of an ellipsoid in scaled units; beyond, the fit has followed the noise


@value_class
class Ellipsoid:
    """Measured vectors of magnitude w lie where |C (m - b)| = w; C is lower triangular, (3, 3)."""

    correction: Floats
    bias: Floats


def general_ellipsoid(m: Floats, w: Floats) -> Ellipsoid | None:
    """Return the quadric of least squares (Angrisano, Eq. 10, without a start); None if it is no ellipsoid.

    |C (m - b)|^2 = w^2 is linear in C'C and C'C b but for the level b'C'C b, which a few repetitions find.
    """
    if len(m) < 9:
        return None
    x, y, z = m.T
    design = np.stack([x * x, y * y, z * z, 2 * x * y, 2 * x * z, 2 * y * z, 2 * x, 2 * y, 2 * z], axis=1)
    ones, _, rank, _ = np.linalg.lstsq(design, np.ones(len(m)), rcond=1e-12)
    if rank < 9:
        return None
    squares = np.linalg.lstsq(design, w**2, rcond=1e-12)[0]
    level, quadric, offset = 0.0, np.eye(3), np.zeros(3)
    same = np.ptp(w) <= 1e-9 * w.max()
    for _ in range(_LEVEL_STEPS):
        a = ones if same else squares - level * ones
        quadric = np.array([[a[0], a[3], a[4]], [a[3], a[1], a[5]], [a[4], a[5], a[2]]])
        if np.linalg.eigvalsh(quadric).min() <= 0:
            return None
        offset = -invert_matrix(quadric) @ a[6:]
        old, level = level, float(offset @ quadric @ offset)
        if same or abs(level - old) < 1e-9 * w.max() ** 2:
            break
    if same:
        quadric = quadric * (w.max() ** 2 / (1 + level))
    return from_quadric(quadric, offset)


def constrained_ellipsoid(m: Floats, w: Floats) -> Ellipsoid | None:
    """Return the quadric of least squares among those that are ellipsoids for certain (Li and Griffiths 2004)."""
    size = np.median(w)
    x, y, z = (m * (size / w)[:, None]).T if np.ptp(w) else m.T
    one = np.ones(len(m))
    design = np.stack([x * x, y * y, z * z, 2 * y * z, 2 * x * z, 2 * x * y, 2 * x, 2 * y, 2 * z, one], axis=1)
    scatter = design.T @ design
    constraint = np.zeros((6, 6))
    constraint[:3, :3] = 1.0 - 2.0 * np.eye(3)
    constraint[3:, 3:] = -4.0 * np.eye(3)
    s11, s12, s22 = scatter[:6, :6], scatter[:6, 6:], scatter[6:, 6:]
    back = np.linalg.pinv(s22, hermitian=True) @ s12.T
    values, vectors = np.linalg.eig(np.linalg.solve(constraint, s11 - s12 @ back))
    v = np.real(vectors[:, int(np.argmax(np.real(values)))])
    v = np.concatenate([v, -back @ v])
    quadric = np.array([[v[0], v[5], v[4]], [v[5], v[1], v[3]], [v[4], v[3], v[2]]])
    quadric, linear, level = (quadric, v[6:9], v[9]) if np.trace(quadric) > 0 else (-quadric, -v[6:9], -v[9])
    if np.linalg.eigvalsh(quadric).min() <= 0:
        return None
    offset = -invert_matrix(quadric) @ linear
    radius = float(offset @ quadric @ offset) - level
    return None if radius <= 0 else from_quadric(quadric * (size**2 / radius), offset)


def fit_sphere(m: Floats, w: Floats) -> Ellipsoid | None:
    """Return the sphere through the points: all scales alike, no misalignment."""
    design = np.column_stack([2 * m, w**2])  # |m|^2 = 2 m.b - |b|^2 + w^2 s^2; one magnitude leaves |b|^2 in the last
    same = np.ptp(w) <= 1e-9 * w.max()
    if not same:
        design = np.column_stack([design, np.ones(len(m))])
    solution = np.linalg.lstsq(design, np.sum(m * m, axis=1), rcond=1e-12)[0]
    bias, square = solution[:3], solution[3]
    if same:
        square = square + bias @ bias / w.max() ** 2
    return None if square <= 0 else Ellipsoid(correction=np.eye(3) / np.sqrt(square), bias=bias)


def from_quadric(quadric: Floats, bias: Floats, largest_ratio: float = _LARGEST_RATIO) -> Ellipsoid | None:
    """Return the ellipsoid (m - bias)' quadric (m - bias) = w^2; None if it is none, or longer than it can be."""
    values = np.linalg.eigvalsh(quadric)
    if not values.min() > 0 or values.max() > largest_ratio**2 * values.min():
        return None
    upper = np.linalg.cholesky(quadric[::-1, ::-1]).T.astype(np.float64)
    return Ellipsoid(correction=upper[::-1, ::-1], bias=bias)  # quadric = C'C with lower triangular C
