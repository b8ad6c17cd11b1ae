"""The overlapping Allan variance of samples that fit into memory, from products of their running sum.

With the running sum x, z_m(k) = x[k + 2 m] - 2 x[k + m] + x[k], and the sum of z_m^2 over all k consists of products of
x with itself m and 2 m places later. Averaging times double from one to the next, so that each needs one such product
of the whole length, and some at the ends. Where x is so much larger than its differences that their rounding would
show, this is of no use (`rounding`).
"""

from concurrent.futures import ThreadPoolExecutor
from os import cpu_count

import numpy as np

from ...frozen import value_class
from ...kernel import load_kernel
from ...kernel.library import running_sums
from ...recording import Floats

_PIECE = 1 << 17  # of the running sum; it and what is multiplied with it stay in the processor's memory
_EPSILON = float(np.finfo(np.float64).eps)


@value_class
class AxisProducts:
    """Sums over one axis.

    Attributes
    ----------
    means : (k,) mean of z_m^2 for m = 1, 2, 4, ...
    totals : (k,) mean of z_m
    slope : of the straight line through the samples [unit a sample]
    rounding : relative error of `means` that rounding may have made
    """

    means: Floats
    totals: Floats
    slope: float
    rounding: float


def product_sums(values: Floats, levels: int) -> list[AxisProducts]:
    """Return the sums of each axis of samples (n, 3), for so many averaging times; 2^levels samples are the least."""
    with ThreadPoolExecutor(min(3, cpu_count() or 1)) as pool:
        sums = running_sums(values) if load_kernel() is not None else pool.map(_running_sum, values.T)
        return list(pool.map(lambda x: _axis_products(x, _lagged_products(x, levels + 1), _end_sums(x, levels)), sums))


def _running_sum(y: Floats) -> Floats:
    x = np.empty(len(y) + 1)
    x[0] = 0.0
    np.cumsum(y, out=x[1:])
    _without_line(x)
    return x


def _axis_products(x: Floats, lagged: Floats, ends: Floats) -> AxisProducts:
    """Return the sums of an axis from its running sum (n + 1,), its products (k + 1,), and sums at its ends (8, k)."""
    n, levels = len(x) - 1, ends.shape[1]
    square, total = float(np.dot(x, x)), float(x.sum())
    terms = n + 1 - 2.0 ** np.arange(1, levels + 1)
    squares, products, sums = ends[:4], ends[4:6].sum(axis=0), ends[6:]
    middle = 4 * (square - squares[0] - squares[3])
    outer = 2 * square - squares.sum(axis=0)
    means = (outer + middle - 4 * (2 * lagged[:-1] - products) + 2 * lagged[1:]) / terms
    least = float((means * (terms - 1)).min())
    return AxisProducts(
        means=means,
        totals=(sums[0] + sums[1]) / terms,
        slope=-total / (n * (n * n - 1.0) / 12),
        rounding=16 * _EPSILON * square / least if least > _EPSILON * square else np.inf,
    )


def _end_sums(x: Floats, levels: int) -> Floats:
    """Return sums over the first and the last m and 2 m values of x, of m = 1, 2, 4, ..., (8, levels).

    Squares of the first, the second, the last but one and the last m; products of the first with the second, and of the
    last two; the sum of the first without that of the second, and of the last without that of the one before.
    """
    found, n = np.zeros((8, levels)), len(x)
    for rows, last in (([0, 1, 4, 6], False), ([3, 2, 5, 7], True)):
        square, total = float(x[-int(last)] ** 2), float(x[-int(last)])
        for level in range(levels):
            m = 1 << level
            near, far = (x[n - m :], x[n - 2 * m : n - m]) if last else (x[:m], x[m : 2 * m])
            far_square, far_total = float(np.dot(far, far)), float(far.sum())
            found[rows, level] = square, far_square, float(np.dot(near, far)), total - far_total
            square, total = square + far_square, total + far_total
    return found


def _without_line(x: Floats) -> None:
    """Take the straight line from the first to the last value off x, in place: z_m does not see it."""
    slope = float(x[-1]) / (len(x) - 1)
    ramp = slope * np.arange(float(_PIECE))
    for start in range(0, len(x), _PIECE):
        piece = x[start : start + _PIECE]
        piece -= ramp[: len(piece)]
        piece -= slope * start


def _lagged_products(x: Floats, count: int) -> Floats:
    """Return the products of x (n,) with the values 1, 2, 4, ... places later, (count,)."""
    found = np.zeros(count)
    for start in range(0, len(x), _PIECE):
        piece = x[start : start + _PIECE]
        for k in range(count):
            later = x[start + (1 << k) : start + (1 << k) + len(piece)]
            found[k] += np.dot(piece[: len(later)], later)
    return found
