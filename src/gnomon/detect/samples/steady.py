"""Steady parts of a gyroscope's recording on a turntable: rests and turns at a speed that is kept.

Every axis must keep its value apart from noise and the platter's wow. Neither zero nor scale need be known, so that
counts with an offset of 32768 serve as well as rad/s.
"""

from collections.abc import Sequence

import numpy as np

from ...frozen import value_class
from ...recording import Floats, Integers, TriadSamples
from ...results.result import Booleans, StaticIntervals

BLOCK_S = 0.25
_WINDOW = 8  # blocks, two seconds, over which the value is kept
_SECOND = 4  # blocks
_RANGE_SIGMA = 9.0  # of eight block means of white noise: never
_WOW = 0.03  # of the largest rate: more than that within a window is a change of speed
_FROM_CENTRE, _FAR = 4.0, 7.0  # robust sigmas of the means over a second
_SETTLING, _MOST_SETTLING = 0.5, 0.4  # of the time that the change before it took; share of the part
_STOPPING_S = 0.5
_SHORTEST_S = 1.5
_GAP_PERIODS = 3.5
_CLIPPED = 0.01  # share of a block's samples


@value_class
class SteadyParts:
    """Steady parts of one recording.

    Attributes
    ----------
    intervals : samples of the gyroscope, without spin-up and spin-down
    clipped : (n,) bool, parts in which an axis stands at the end of its range
    """

    intervals: StaticIntervals
    clipped: Booleans


def block_samples(samples: TriadSamples) -> int:
    """Return how many samples a block of a quarter of a second holds."""
    return max(1, round(BLOCK_S * samples.rate_hz))


def block_means(values: Floats, length: int) -> Floats:
    """Return the means of consecutive blocks, (n // length, k), of values (n, k)."""
    count = len(values) // length
    return values[: count * length].reshape(count, length, values.shape[1]).mean(axis=1)


def largest_rate(streams: Sequence[TriadSamples]) -> float:
    """Return about how far the fastest turning moves an axis from the middle of its values [unit], over recordings."""
    means = np.concatenate([block_means(stream.values, block_samples(stream)) for stream in streams])
    if not len(means):
        return 0.0
    low, high = np.quantile(means, [0.02, 0.98], axis=0)
    return float(0.5 * np.max(high - low))


def find_steady(samples: TriadSamples, saturated: Booleans, rate_size: float) -> SteadyParts:
    """Return the steady parts of a gyroscope's samples.

    Parameters
    ----------
    samples : of a gyroscope
    saturated : (n,) clipped samples
    rate_size : about how far turning moves an axis [unit], from `largest_rate` of all recordings
    """
    length = block_samples(samples)
    means = block_means(samples.values, length)
    if len(means) < _WINDOW:
        nothing = np.empty(0, np.int64)
        return SteadyParts(intervals=StaticIntervals(start=nothing, stop=nothing), clipped=np.empty(0, bool))
    noise = _noise(samples.values, means, length)
    broken = _broken(samples.t_ns, length, len(means))
    kept = _kept(means, np.maximum(_RANGE_SIGMA * noise, _WOW * rate_size), broken)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], kept, [False]]).astype(np.int8)))
    start, stop, before = list[int](), list[int](), 0
    for first, last in zip(edges[::2], edges[1::2], strict=True):
        for begin, end in _kept_runs(means[first:last], 0.5 * noise):
            # a speed that is approached exponentially is near before it is there
            settling = min(_SETTLING * (first + begin - before), _MOST_SETTLING * (end - begin))
            before = first + end
            if (end - begin - round(settling)) * length >= _SHORTEST_S * samples.rate_hz:
                start.append((first + begin + round(settling)) * length)
                stop.append((first + end) * length)
    intervals = StaticIntervals(start=np.array(start, np.int64), stop=np.array(stop, np.int64))
    share = np.concatenate([[0], np.cumsum(saturated)])
    count = share[intervals.stop] - share[intervals.start]
    return SteadyParts(intervals=intervals, clipped=count > _CLIPPED * (intervals.stop - intervals.start))


def _noise(values: Floats, means: Floats, length: int) -> Floats:
    """Return the noise of a block's mean, (3,), by its own samples and by what neighbouring blocks differ by.

    Much of a recording may be motion: the tenth percentile of both is noise. An axis that stands at the end of its
    range shows none, and tells nothing.
    """
    steps = np.abs(np.diff(means, axis=0))
    between = _low_quantile(steps) / (0.1257 * np.sqrt(2))  # tenth percentile of |N(0, 1)|
    if length < _SECOND:
        return between
    parts = values[: len(means) * length].reshape(len(means), length, 3)
    return np.maximum(between, np.sqrt(_low_quantile(parts.var(axis=1, ddof=1)) / length))


def _low_quantile(values: Floats) -> Floats:
    """Return the tenth percentile of what is not zero, axis by axis, (3,)."""
    moving = [column[column > 0] for column in values.T]
    return np.array([np.quantile(column, 0.1) if len(column) else 0.0 for column in moving])


def _broken(t_ns: Integers, length: int, count: int) -> Booleans:
    """Mark blocks in which the recording has a hole, (count,)."""
    steps = np.diff(t_ns)
    holes = np.flatnonzero(steps > max(_GAP_PERIODS * float(np.median(steps)), 0.5e9)) // length
    marked = np.zeros(count, dtype=bool)
    marked[holes[holes < count]] = True
    return marked


def _kept(means: Floats, tolerance: Floats, broken: Booleans) -> Booleans:
    """Mark blocks that lie in any window throughout which every axis keeps its value, (n,)."""
    windows = np.lib.stride_tricks.sliding_window_view(means, _WINDOW, axis=0)
    quiet = np.all(np.ptp(windows, axis=2) < tolerance, axis=1)
    quiet &= ~np.lib.stride_tricks.sliding_window_view(broken, _WINDOW).any(axis=1)
    covers = np.convolve(quiet, np.ones(_WINDOW))
    return np.asarray(covers > 0.5, dtype=np.bool_)


def _kept_runs(means: Floats, noise: Floats) -> list[tuple[int, int]]:
    """Return first block and end of what is left of a run without its ends, where the speed still changes.

    A gentle hand between two rests is taken out as well.

    Parameters
    ----------
    means : (k, 3)
    noise : (3,) of a mean over a second
    """
    k = len(means)
    if k < 2 * _SECOND:
        return []
    running = np.cumsum(np.concatenate([np.zeros((1, 3)), means - means[k // 2]]), axis=0)
    seconds = (running[_SECOND:] - running[:-_SECOND]) / _SECOND
    centre = np.median(seconds, axis=0)
    spread = np.maximum(1.4826 * np.median(np.abs(seconds - centre), axis=0), noise)
    away = np.max(np.abs(seconds - centre) / spread, axis=1)
    off = np.flatnonzero(np.diff(np.concatenate([[False], away >= _FROM_CENTRE, [False]]).astype(np.int8)))
    runs, begin = list[tuple[int, int]](), 0
    for first, last in zip(off[::2], off[1::2], strict=True):
        at_an_end = first == 0 or last == len(away)
        if not at_an_end and last - first < _SECOND and away[first:last].max() < _FAR:
            continue  # as noise does now and then
        runs.append((begin, int(first) + _SECOND - 1 - round(_STOPPING_S / BLOCK_S)))
        begin = int(last)
    runs.append((begin, k))
    return [(begin, end) for begin, end in runs if end - begin >= _SECOND]
