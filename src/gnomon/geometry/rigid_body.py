"""What the points of a turning body feel."""

import numpy as np
from numpy.typing import NDArray

from .so3 import skew

Floats = NDArray[np.float64]


def acceleration_by_place(omega: Floats, alpha: Floats) -> Floats:
    """Return A = [alpha]x + [omega]x^2, (n, 3, 3): the point at r is accelerated by A r more than the body's origin.

    Parameters
    ----------
    omega, alpha : (n, 3) angular rate [rad/s] and acceleration [rad/s^2], body frame
    """
    turned = omega[:, :, None] * omega[:, None, :]
    return skew(alpha) + turned - np.trace(turned, axis1=1, axis2=2)[:, None, None] * np.eye(3)


def along_axes(A: Floats, places: Floats) -> Floats:
    """Return e_k' A r_k, (n, 3): what the k-th of three sensors feels more than the body's origin, along axis k.

    Parameters
    ----------
    A : (n, 3, 3), see `acceleration_by_place`
    places : (3, 3) r_k, one row each [m]
    """
    return np.asarray(np.einsum("nkj,kj->nk", A, places), dtype=np.float64)
