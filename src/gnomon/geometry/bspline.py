"""Uniform B-splines: basis functions and their derivatives (Krebs, section 4.1.1).

A spline of order k (degree k - 1) has, between knot j and knot j + 1, the value sum_i b_i(u) c_{j+i}, i = 0 .. k - 1,
with u in [0, 1) the place between the two knots. The basis functions are the same between all knots.
"""

from functools import cache
from math import comb, factorial

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


@cache
def basis_matrix(order: int) -> Floats:
    """Return M (k, k) with b(u) = [1, u, ..., u^(k-1)] M: the columns are the pieces of the cardinal B-spline.

    Piece i is the part of the cardinal B-spline N(x) = sum_r (-1)^r C(k, r) (x - r)_+^(k-1) / (k-1)! with x = u +
    k - 1 - i.
    """
    k = order
    matrix = np.zeros((k, k))
    for i in range(k):
        for power in range(k):
            terms = ((-1) ** r * comb(k, r) * (k - 1 - i - r) ** (k - 1 - power) for r in range(k - i))
            matrix[power, i] = comb(k - 1, power) * sum(terms) / factorial(k - 1)
    matrix.flags.writeable = False
    return matrix


@cache
def basis_polynomials(order: int, derivative: int) -> Floats:
    """Return the matrix (k, k) of a derivative of b(u): rows are powers of u, the last ones zero."""
    matrix = basis_matrix(order)
    for _ in range(derivative):
        matrix = np.concatenate([matrix[1:] * np.arange(1, len(matrix))[:, None], np.zeros((1, order))])
    matrix.flags.writeable = False
    return matrix


def bspline_basis(order: int, u: Floats, derivative: int = 0) -> Floats:
    """Return b(u) or a derivative of it by u, (n, k), of places u (n,)."""
    matrix = basis_polynomials(order, derivative)[: max(order - derivative, 1)]
    powers = u[:, None] ** np.arange(len(matrix))
    return powers @ matrix
