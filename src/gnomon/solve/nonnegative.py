"""Least squares with a few unknowns that are not below zero: SciPy's takes 0.3 s to load."""

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

_LEAST = 1e-13  # of a column's product with the right side that counts as growth


def solve_nonnegative(A: Floats, b: Floats, near: Floats | None = None) -> Floats:
    """Return the x >= 0, (n,), with the least |A x - b|, by the active sets of Lawson and Hanson (1974), chapter 23.

    Parameters
    ----------
    A : (m, n) of full rank
    b : (m,)
    near : (n,) of a problem much like it: what is above zero there is taken to be so first
    """
    x, free = np.zeros(A.shape[1]), np.zeros(A.shape[1], dtype=bool)
    if near is not None and (near > 0).any():
        first = np.linalg.lstsq(A[:, near > 0], b)[0]
        if (first > 0).all():
            free = near > 0
            x[free] = first
    least = _LEAST * np.linalg.norm(A, axis=0) * np.linalg.norm(b)
    for _ in range(10 * len(x)):
        growth = np.where(free, 0.0, A.T @ (b - A @ x) - least)
        if growth.max(initial=0.0) <= 0:
            break
        free[np.argmax(growth)] = True
        while True:
            ahead = np.zeros(len(x))
            ahead[free] = np.linalg.lstsq(A[:, free], b)[0]
            below = free & (ahead <= 0)
            if not below.any():
                break
            share = x[below] / (x[below] - ahead[below])
            x = x + share.min() * (ahead - x)
            free[np.flatnonzero(below)[share <= share.min()]] = False
        x = ahead
    return x
