"""Static intervals by the variance magnitude of the accelerometer (Tedaldi 2014, section 3.4.1).

Eq. (3.9): the square of the variance magnitude, s^2(t) = sum over the axes of var(a)^2 in a window of t_w seconds
centred in t, is compared with a multiple of its level at rest. Each axis is measured by its own level at rest first, so
that neither the unit nor an axis with more noise than the others matters.
"""

import numpy as np

from ...recording import Floats, TriadSamples
from ...results.result import Booleans, StaticIntervals

_CHUNK = 262_144  # samples; bounds the memory of long recordings and the error of the running sums


def window_samples(samples: TriadSamples, window_s: float) -> int:
    """Return the odd number of samples in a window of `window_s` seconds, at least three."""
    return 2 * max(1, round(0.5 * window_s * samples.rate_hz)) + 1


def window_variances(values: Floats, window: int) -> Floats:
    """Return the variance of each axis in a centred window, var of Eq. (3.9), for every sample, (n, 3), in linear time.

    Samples closer to an end than half a window take the value of the nearest full window.

    Parameters
    ----------
    values : (n, 3) [unit]
    window : odd number of samples in the centred window, at most n
    """
    n, half = len(values), window // 2
    variances = np.empty((n, 3))
    for first in range(half, n - half, _CHUNK):
        last = min(first + _CHUNK, n - half)
        part = np.array(values[first - half : last + half].T)
        part -= part.mean(axis=1, keepdims=True)  # small numbers keep the running sums exact
        sums = _window_sums(part, window)
        part *= part
        spread = _window_sums(part, window)
        spread -= sums * sums / window
        spread /= window - 1
        variances[first:last] = spread.T
    variances[:half] = variances[half]
    variances[n - half :] = variances[n - half - 1]
    return variances


def _window_sums(rows: Floats, window: int) -> Floats:
    """Return the sums of `window` neighbours along rows, (k, n) -> (k, n - window + 1)."""
    running = np.cumsum(rows, axis=1)
    sums = running[:, window - 1 :].copy()
    sums[:, 1:] -= running[:, :-window]
    return sums


def variance_magnitude_squared(variances: Floats, level: Floats | float = 1.0) -> Floats:
    """Return s^2 of Eq. (3.9), (n,): the sum over the axes of (variance / level)^2.

    Parameters
    ----------
    variances : (n, 3), from `window_variances`
    level : (3,) variance of each axis at rest, or 1 for s^2 in the sensor's unit as printed
    """
    weight = np.square(np.broadcast_to(np.minimum(1 / np.asarray(level), 1e150), 3))  # a silent axis stays finite
    return np.einsum("ij,ij,j->i", variances, variances, weight)


def resting_variances(variances: Floats, values: Floats, window: int) -> Floats:
    """Return the variance of each axis at rest, (3,), without being told when the sensor rested.

    Noise at rest is the quietest that a sensor shows, so the level is taken from the quietest windows: the tenth
    percentile over windows that do not overlap. It is never below the variance of rounding to the sensor's steps, since
    a coarse sensor may show none at all.

    Parameters
    ----------
    variances : (n, 3), from `window_variances`
    values : (n, 3) [unit]
    window : samples in a window
    """
    quiet = np.quantile(variances[window // 2 :: window], 0.1, axis=0)
    return np.maximum(np.maximum(quiet, quantisation_step(values) ** 2 / 12), np.finfo(float).tiny)


def quantisation_step(values: Floats) -> Floats:
    """Return the smallest step of each axis between different neighbours, (3,) [unit]; 0 if it never changes."""
    smallest = np.zeros(3)
    for axis in range(3):
        steps = np.abs(np.diff(values[:_CHUNK, axis]))
        moving = steps[steps > 0]
        smallest[axis] = moving.min() if moving.size else 0.0
    return smallest


def runs_below(statistic: Floats, threshold: float, shortest: int, margin: int = 0) -> StaticIntervals:
    """Return the runs of samples with s^2 below the threshold that are long enough.

    Parameters
    ----------
    statistic : (n,)
    threshold : compared with `statistic`
    shortest : least number of samples in a run, after the margin is taken off
    margin : samples taken off both ends of a run
    """
    still = np.concatenate([[False], statistic < threshold, [False]])
    edges = np.flatnonzero(still[1:] != still[:-1])
    start, stop = edges[::2] + margin, edges[1::2] - margin
    long_enough = stop - start >= shortest
    return StaticIntervals(start=start[long_enough], stop=stop[long_enough])


def static_statistic(values: Floats, window: int) -> Floats:
    """Return s^2 relative to its level at rest, (n,): about 1 where the sensor rests.

    Parameters
    ----------
    values : (n, 3) [unit]
    window : odd number of samples, at most n
    """
    variances = window_variances(values, window)
    level = resting_variances(variances, values, window)
    return variance_magnitude_squared(variances, level) / 3


def trim_intervals(intervals: StaticIntervals, stirs: Booleans, shortest: int) -> StaticIntervals:
    """Return the intervals without the samples at their ends that stir, where enough is left.

    Parameters
    ----------
    stirs : (n,) from `turning.mark_rates`
    shortest : least number of samples
    """
    quiet = np.flatnonzero(~stirs)
    if not len(quiet) or not len(intervals):
        return intervals.where(np.zeros(len(intervals), dtype=bool))
    first = np.searchsorted(quiet, intervals.start)
    last = np.searchsorted(quiet, intervals.stop) - 1
    start, stop = quiet[np.minimum(first, len(quiet) - 1)], quiet[np.maximum(last, 0)] + 1
    keep = (last >= first) & (stop - start >= shortest)
    return StaticIntervals(start=start[keep], stop=stop[keep])
