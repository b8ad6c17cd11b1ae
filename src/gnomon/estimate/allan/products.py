"""The overlapping Allan variance of samples that fit into memory, from products of their running sum.

With the running sum x, z_m(k) = x[k + 2 m] - 2 x[k + m] + x[k], and the sum of z_m^2 over all k consists of products of
x with itself m and 2 m places later. Averaging times double from one to the next, so that each needs one such product
of the whole length, and some at the ends. Where x is so much larger than its differences that their rounding would
show, this is of no use (`rounding`).
"""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from os import cpu_count

import numpy as np

from ...recording import Floats

_PIECE = 1 << 16  # of the running sum; it and what is multiplied with it stay in the processor's memory
_EPSILON = float(np.finfo(np.float64).eps)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
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
        return list(pool.map(lambda axis: _axis_sums(axis, levels), values.T))


def _axis_sums(y: Floats, levels: int) -> AxisProducts:
    n = len(y)
    x = np.empty(n + 1)
    x[0] = 0.0
    np.cumsum(y, out=x[1:])
    _without_line(x)
    lagged = _lagged_products(x, levels + 1)
    square, total = float(np.dot(x, x)), float(x.sum())
    means, totals = np.empty(levels), np.empty(levels)
    for level in range(levels):
        m = 1 << level
        first, second, last, before = x[:m], x[m : 2 * m], x[n - m + 1 :], x[n - 2 * m + 1 : n - m + 1]
        ends = _squares(first), _squares(second), _squares(before), _squares(last)
        middle = 4 * (square - ends[0] - ends[3])
        outer = 2 * square - sum(ends)
        next_to = 2 * lagged[level] - float(np.dot(first, second)) - float(np.dot(before, last))
        terms = n - 2 * m + 1
        means[level] = (outer + middle - 4 * next_to + 2 * lagged[level + 1]) / terms
        ends = float(first.sum()), float(second.sum()), float(before.sum()), float(last.sum())
        totals[level] = (ends[0] - ends[1] - ends[2] + ends[3]) / terms
    least = float((means * (n - 2.0 ** np.arange(1, levels + 1))).min())
    return AxisProducts(
        means=means,
        totals=totals,
        slope=-total / (n * (n * n - 1.0) / 12),
        rounding=16 * _EPSILON * square / least if least > _EPSILON * square else np.inf,
    )


def _without_line(x: Floats) -> None:
    """Take the straight line from the first to the last value off x, in place: z_m does not see it."""
    slope = float(x[-1]) / (len(x) - 1)
    ramp = slope * np.arange(float(_PIECE))
    for start in range(0, len(x), _PIECE):
        piece = x[start : start + _PIECE]
        piece -= ramp[: len(piece)]
        piece -= slope * start


def _squares(x: Floats) -> float:
    return float(np.dot(x, x))


def _lagged_products(x: Floats, count: int) -> list[float]:
    """Return the products of x with itself 1, 2, 4, ... places later, `count` of them."""
    products = [0.0] * count
    for start in range(0, len(x), _PIECE):
        piece = x[start : start + _PIECE]
        for k in range(count):
            later = x[start + (1 << k) : start + (1 << k) + len(piece)]
            if not len(later):
                break
            products[k] += float(np.dot(piece[: len(later)], later))
    return products
