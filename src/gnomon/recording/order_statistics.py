"""Medians, quantiles and distinct values of few numbers: NumPy's own take ten times as long, and load masked arrays."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray


def median_of(values: ArrayLike, axis: int | None = None) -> Any:
    """Return the median of all values, or along an axis; nan where one of them is.

    Examples
    --------
    >>> float(median_of([3.0, 1.0, 2.0, 10.0]))
    2.5
    """
    ordered = np.sort(values, axis)  # nan comes last
    axis = axis or 0
    count = ordered.shape[axis]
    middle = 0.5 * (ordered.take((count - 1) // 2, axis) + ordered.take(count // 2, axis))
    last = ordered.take(-1, axis)
    unknown = np.isnan(last)
    return np.where(unknown, last, middle) if np.ndim(last) else last if unknown else middle


def quantile_of(values: ArrayLike, levels: float | Sequence[float] | NDArray[Any], axis: int | None = None) -> Any:
    """Return quantiles of all values, or along the first axis, on the line between the two values beside them.

    Examples
    --------
    >>> quantile_of([3.0, 1.0, 2.0], [0.5, 0.75]).tolist()
    [2.0, 2.5]
    """
    assert axis in (None, 0)
    ordered = np.sort(values, axis)
    at = np.asarray(levels, dtype=np.float64) * (len(ordered) - 1)
    low = at.astype(np.int64)
    below, above = ordered[low], ordered[np.minimum(low + 1, len(ordered) - 1)]
    share = (at - low).reshape(at.shape + (1,) * (ordered.ndim - 1))
    step = above - below
    found = np.where(share < 0.5, below + step * share, above - step * (1 - share))  # as exact from either side
    return np.where(np.isnan(ordered[-1]), np.nan, found)


def distinct_values(values: ArrayLike) -> NDArray[Any]:
    """Return the different ones among some values, in order.

    Examples
    --------
    >>> distinct_values([2, 1, 2]).tolist()
    [1, 2]
    """
    ordered = np.sort(values, None)
    new = np.ones(len(ordered), dtype=bool)
    new[1:] = ordered[1:] != ordered[:-1]
    return ordered[new]
