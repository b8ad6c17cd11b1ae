"""A gyroscope's bias that wanders during the recording, as when a cheap sensor warms up.

The bias is its mean plus hat functions of time, whose values at the knots follow a random walk. Whether it wanders, and
how fast, is read from the residuals at rest.
"""

from dataclasses import replace

import numpy as np

from ..intervals import Booleans
from ..recording import Floats
from .multiposition_model import MultiPositionData

_MOST_KNOTS = 30
_INTERVALS_PER_KNOT = 1.5
_SIGMA = 1.3
_FARTHEST = 60  # intervals between two that are compared
_ZERO_MEAN_WEIGHT = 1e6  # of the walk's own precision: the mean over time belongs to the bias


def walk_density(t_s: Floats, residual: Floats, used: Booleans) -> Floats | None:
    """Return the random walk's density of each axis, (3,) [unit^2/s]; None where no axis wanders.

    Von Neumann's ratio of neighbouring to total differences is 2 for independent residuals and falls where they
    follow each other. The density is the slope of mean squared differences over their distance in time, up to a third
    of the recording.

    Parameters
    ----------
    t_s : (n,) middle of the static intervals [s]
    residual : (n, 3) of the gyroscope at rest [unit]
    used : (n,) bool
    """
    t, r = t_s[used], residual[used]
    n = len(t)
    if n < 12:
        return None
    total = np.sum((r - r.mean(axis=0)) ** 2, axis=0)
    ratio = np.sum(np.diff(r, axis=0) ** 2, axis=0) / np.where(total > 0, total, 1.0)
    wanders = (ratio < 2 - _SIGMA * 2 / np.sqrt(n)) & (total > 0)
    if not wanders.any():
        return None
    first = np.arange(n)
    apart = np.arange(1, min(n, _FARTHEST))
    i, j = (pairs.ravel() for pairs in np.broadcast_arrays(first[:, None], first[:, None] + apart))
    i, j = i[j < n], j[j < n]
    near = t[j] - t[i] < (t[-1] - t[0]) / 3
    i, j = i[near], j[near]
    lag = (t[j] - t[i]) - np.mean(t[j] - t[i])
    squares = (r[j] - r[i]) ** 2
    slope = lag @ squares / (lag @ lag)
    least = total / n / (t[-1] - t[0]) * 1e-4  # an axis that stays keeps a walk too small to matter
    return np.where(wanders, np.maximum(slope, least), least)


def with_drift(data: MultiPositionData) -> MultiPositionData:
    """Return the data with hat functions over the time of the recording."""
    count = int(np.clip(len(data.interval_s) // _INTERVALS_PER_KNOT, 3, _MOST_KNOTS))
    knots = np.linspace(*data.span_s, count)
    spacing = knots[1] - knots[0]

    def hats(t_s: Floats) -> Floats:
        return np.clip(1 - np.abs(t_s[:, None] - knots) / spacing, 0.0, None)

    return replace(data, drift_at_rest=hats(data.interval_s), drift_in_motion=hats(data.rotation_s))


def walk_precision(data: MultiPositionData, density: Floats) -> Floats:
    """Return the precision (3 j, 3 j) of the knots' values: a random walk with a mean of zero over time."""
    count = data.drift[0].shape[1]
    spacing = (data.span_s[1] - data.span_s[0]) / (count - 1)
    difference = np.diff(np.eye(count), axis=0)
    mean = np.full(count, 1 / (count - 1))
    mean[[0, -1]] *= 0.5
    walk = difference.T @ difference + _ZERO_MEAN_WEIGHT * np.outer(mean, mean)
    return np.asarray(np.kron(walk, np.diag(1 / (density * spacing))), dtype=np.float64)
