"""The rotation group: rotation vectors, skew matrices, tangent planes of the unit sphere."""

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def skew(v: Floats) -> Floats:
    """Return [v]x, (..., 3, 3), with skew(v) @ w = v x w, of vectors (..., 3)."""
    matrix = np.zeros((*v.shape[:-1], 3, 3))
    matrix[..., 0, 1], matrix[..., 0, 2] = -v[..., 2], v[..., 1]
    matrix[..., 1, 0], matrix[..., 1, 2] = v[..., 2], -v[..., 0]
    matrix[..., 2, 0], matrix[..., 2, 1] = -v[..., 1], v[..., 0]
    return matrix


def tangent_basis(u: Floats) -> Floats:
    """Return two orthonormal vectors perpendicular to each unit vector, as columns: (..., 3) -> (..., 3, 2)."""
    helper = np.zeros_like(u)
    np.put_along_axis(helper, np.abs(u).argmin(axis=-1)[..., None], 1.0, axis=-1)
    first = np.asarray(np.cross(u, helper), dtype=np.float64)
    first /= np.linalg.norm(first, axis=-1, keepdims=True)
    return np.stack([first, np.asarray(np.cross(u, first), dtype=np.float64)], axis=-1)


def invert_matrix(matrix: Floats) -> Floats:
    """Return the inverse of matrices (..., 3, 3)."""
    return np.linalg.inv(matrix).astype(np.float64, copy=False)


def nearest_rotation(matrix: Floats) -> Floats:
    """Return the rotations (..., 3, 3), det +1, nearest to matrices in the Frobenius norm (Kabsch)."""
    left, _, right = np.linalg.svd(matrix)
    left[..., 2] *= np.sign(np.linalg.det(left @ right))[..., None]
    return np.asarray(left @ right, dtype=np.float64)
