"""What each sensor says of being still: the accelerometer by its variance, the gyroscope by its rate.

Eq. (3.9) of Tedaldi 2014, section 3.4.1: the square of the variance magnitude of the accelerometer, s^2(t) = sum over
the axes of var(a)^2 in a window of t_w seconds centred in t, is compared with a multiple of its level at rest. Each
axis is measured by its own level at rest first, so that neither the unit nor an axis with more noise than the others
matters.

Turning about the vertical leaves gravity where it is. The gyroscope's means over an eighth of a second that are far
from the rate at rest give it away. The rate at rest is that of the same rest, a few seconds to either side: a bias may
step, wander, or warm up from one rest to the next, and a rest in the hand has a tremor of its own.
"""

from dataclasses import fields

import numpy as np

from ...frozen import value_class
from ...recording import Floats, Integers, TriadSamples
from ...recording.samples import distinct_values, median_of, quantile_of
from ...results.result import Booleans

_CHUNK = 262_144  # samples; bounds the memory of long recordings and the error of the running sums

_BLOCK_S = 0.125
_TURNING = 3.0  # times the ninetieth percentile at rest: five sigma of white noise, and room for a hand's tremor
_STIRRING = 5.4  # times the median at rest: eight sigma of white noise
_PERCENTILE = 2.44  # the ninetieth percentile of white noise over its median
_TREMOR = 6.0  # times the usual, at most, that a rest's own tremor may be
_AROUND = 24  # blocks, three seconds, to either side
_FEWEST = 4  # blocks of a rest that tells its rate
_LONG = 64  # blocks; who turns as evenly as noise for eight seconds rests
_ALIKE = 6.0  # times how much neighbouring rests differ as a rule
_FAST = 0.25  # of the fastest motion: no bias is as large
_SPREAD = 10.0  # times the usual distance of rests from their middle
_MOTION = 20.0  # times what is turning at rest: motion between the rests was recorded
_JUMP_SIGMA, _JUMP = 8.0, 8  # sigma of a step within a rest; blocks to either side that show it
_KEPT = 0.6  # of the step that the whole rest must show, too


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
    quiet = quantile_of(variances[window // 2 :: window], 0.1, axis=0)
    return np.maximum(np.maximum(quiet, quantisation_step(values) ** 2 / 12), np.finfo(float).tiny)


def quantisation_step(values: Floats) -> Floats:
    """Return the smallest step of each axis between different neighbours, (3,) [unit]; 0 if it never changes."""
    smallest = np.zeros(3)
    for axis in range(3):
        steps = np.abs(np.diff(values[:_CHUNK, axis]))
        moving = steps[steps > 0]
        smallest[axis] = moving.min() if moving.size else 0.0
    return smallest


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


@value_class
class RateMarks:
    """What a gyroscope says of the samples of an accelerometer, (n,) each.

    Attributes
    ----------
    turns : it turns; such a sample is not static
    stirs : it stirs; no static interval begins or ends with such a sample
    turns_beyond_tremor, stirs_beyond_tremor : the same by the tremor of its own rest, where that is more than usual
    apart : its rate keeps still, but far from that of the rests around
    jumps : its bias steps here, in the middle of a rest
    """

    turns: Booleans
    stirs: Booleans
    turns_beyond_tremor: Booleans
    stirs_beyond_tremor: Booleans
    apart: Booleans
    jumps: Booleans

    @classmethod
    def none(cls, n: int) -> "RateMarks":
        """Return no marks, as without a gyroscope."""
        nothing = np.zeros(n, dtype=bool)
        return cls(**dict.fromkeys((f.name for f in fields(cls)), nothing))

    def at(self, index: Integers) -> "RateMarks":
        """Return the marks of other samples."""
        return RateMarks(**{f.name: getattr(self, f.name)[index] for f in fields(self)})


def mark_rates(gyroscope: TriadSamples, still: Booleans) -> RateMarks:
    """Mark samples at which the gyroscope turns although the accelerometer rests.

    Two marks make a hysteresis: samples that turn, with the eighths of a second beside them, cannot be static, and a
    static interval cannot begin or end with samples that stir. Between them a hand's tremor may stay.

    Parameters
    ----------
    gyroscope : samples [unit]
    still : (n,) samples at which the accelerometer rests
    """
    length = max(1, round(_BLOCK_S * gyroscope.rate_hz))
    n, blocks = len(gyroscope), len(gyroscope) // length
    if blocks < 3:
        return RateMarks.none(n)
    means = gyroscope.values[: blocks * length].reshape(blocks, -1) @ np.tile(np.eye(3) / length, (length, 1))
    resting = np.ones(blocks, dtype=bool)
    resting[np.flatnonzero(~still[: blocks * length]) // length] = False
    if resting.sum() < 3:
        return RateMarks.none(n)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], resting, [False]])))
    jumps, first, last = _jumps(means, edges[::2], edges[1::2])
    level = _levels(means, first, last)
    away = np.abs(means - level)
    usual, middle = quantile_of(away[resting], [0.9, 0.5], axis=0)
    tremor = _of_nearest(_medians(away, first, last), first, last, blocks)
    fastest = float(quantile_of(away[~resting].max(axis=1), 0.98)) if not resting.all() else 0.0
    apart = _apart(means, first, last, _TURNING * usual, fastest)
    turns, stirs = _beyond(away, usual, middle, apart | jumps)
    own = np.clip(_PERCENTILE * tremor, usual, _TREMOR * usual), np.clip(tremor, middle, _TREMOR * middle)
    turns_own, stirs_own = _beyond(away, *own, apart | jumps)
    found = RateMarks(
        turns=turns,
        stirs=stirs,
        turns_beyond_tremor=turns_own,
        stirs_beyond_tremor=stirs_own,
        apart=apart,
        jumps=jumps,
    )
    return found.at(np.minimum(np.arange(n) // length, blocks - 1))


def _beyond(away: Floats, usual: Floats, middle: Floats, surely: Booleans) -> tuple[Booleans, Booleans]:
    """Mark blocks (k,) that turn, with those beside them, and blocks that stir.

    Parameters
    ----------
    away : (k, 3) distance from the rate at rest
    usual, middle : (3,) or (k, 3) ninetieth percentile and median of that at rest
    surely : (k,) blocks that turn anyway
    """
    turns = np.any(away > _TURNING * usual, axis=1)
    wide = turns | surely
    wide[1:] |= turns[:-1]
    wide[:-1] |= turns[1:]
    return wide, wide | np.any(away > _STIRRING * middle, axis=1)


def _inside(first: Integers, last: Integers) -> Integers:
    """Return the numbers in some stretches, one behind the other."""
    length = last - first
    return np.arange(length.sum()) + np.repeat(first - np.cumsum(length) + length, length)


def _medians(values: Floats, first: Integers, last: Integers) -> Floats:
    """Return the medians of some stretches of values (n, 3), in order and apart, (m, 3)."""
    return np.array([median_of(values[a:b], axis=0) for a, b in zip(first, last, strict=True)]).reshape(-1, 3)


def _levels(means: Floats, first: Integers, last: Integers) -> Floats:
    """Return the rate at rest around each block, (k, 3): a running median within its rest, or that of the nearest."""
    level = np.empty_like(means)
    window = 2 * _AROUND + 1
    resting = _inside(first, last)
    level[resting] = np.repeat(_medians(means, first, last), last - first, axis=0)
    for a, b in zip(first, last, strict=True):
        if b - a <= window:
            continue
        running = np.sort(np.lib.stride_tricks.sliding_window_view(means[a:b], window, axis=0), axis=2)[..., _AROUND]
        at = np.arange(b - a) - _AROUND
        inside = np.clip(at, 0, b - a - window)
        reach = min(_AROUND, b - a - window)
        slope = np.zeros((2, 3))
        if reach >= _FEWEST:  # of a sensor that warms up, carried on to both ends
            slope = np.array([running[reach] - running[0], running[-1] - running[-1 - reach]]) / reach
        level[a:b] = running[inside] + (at - inside)[:, None] * np.where((at < 0)[:, None], slope[0], slope[1])
    everywhere = np.arange(len(means))
    right = np.clip(np.searchsorted(resting, everywhere), 0, len(resting) - 1)
    left = np.maximum(right - 1, 0)
    nearer = np.abs(resting[left] - everywhere) < np.abs(resting[right] - everywhere)
    return level[resting[np.where(nearer, left, right)]]


def _of_nearest(values: Floats, first: Integers, last: Integers, count: int) -> Floats:
    """Return of each block the value of the rest that it is in, or of the nearest one, (count, 3)."""
    middle = 0.5 * (last[:-1] + first[1:])
    return values[np.searchsorted(middle, np.arange(count), side="right")]


def _apart(means: Floats, first: Integers, last: Integers, limit: Floats, fastest: float) -> Booleans:
    """Mark blocks of rests whose rate is far from that of both neighbours on either side: they turn steadily.

    A bias that stepped is that of the rests before, or of those after. What is as fast as a motion is no bias.
    """
    marked = np.zeros(len(means), dtype=bool)
    told = np.flatnonzero(last - first >= _FEWEST)
    if len(told) < 4:
        return marked
    levels = _medians(means, first[told], last[told])
    changes = np.abs(np.diff(levels, axis=0))
    scale = np.maximum(limit, _ALIKE * 1.4826 * median_of(changes, axis=0))
    scale = np.where(scale > 0, scale, max(np.finfo(float).eps * float(np.abs(levels).max()), 1e-100))
    middle = median_of(levels, axis=0)
    off = np.abs(levels - middle).max(axis=1)
    most = max(_FAST * fastest, _SPREAD * float(median_of(off))) if fastest > _MOTION * limit.max() else np.inf
    nearest = np.full(len(told), np.inf)
    for apart in (1, 2):
        away = np.max(np.abs(levels[apart:] - levels[:-apart]) / scale, axis=1)
        nearest[apart:] = np.minimum(nearest[apart:], away)
        nearest[:-apart] = np.minimum(nearest[:-apart], away)
    out = ((nearest > 1) & (last[told] - first[told] < _LONG)) | (off > most)
    if 2 * out.sum() > len(told):  # rates that scatter that much are no turns
        return marked
    for k in told[out]:
        marked[first[k] : last[k]] = True
    return marked


def _jumps(means: Floats, first: Integers, last: Integers) -> tuple[Booleans, Integers, Integers]:
    """Mark the two blocks of a rest between which the rate steps for good, and part the rest there.

    Returns
    -------
    marks of blocks, and first and last blocks of what are rests then
    """
    marked = np.zeros(len(means), dtype=bool)
    cuts: list[int] = []
    long = last - first >= 2 * _FEWEST
    places = _inside(first[long] + _FEWEST, last[long] - _FEWEST + 1)
    start, stop = (np.repeat(ends[long], (last - first)[long] - 2 * _FEWEST + 1) for ends in (first, last))
    sums = np.zeros((len(means) + 1, 3))
    at_rest = _inside(first, last)
    sums[at_rest + 1] = means[at_rest] - np.repeat(means[first], last - first, axis=0)
    np.cumsum(sums, axis=0, out=sums)
    low, high = np.maximum(places - _JUMP, start), np.minimum(places + _JUMP, stop)
    before, after = (places - low)[:, None], (high - places)[:, None]
    step = (sums[high] - sums[places]) / after - (sums[places] - sums[low]) / before
    noise = np.zeros_like(means)
    noise[first[long]] = 1.4826 * _medians(np.abs(np.diff(means, axis=0)), first[long], last[long] - 1) / np.sqrt(2)
    sigma = noise[start] * np.sqrt(1 / before + 1 / after)
    size = np.abs(step) / np.where(sigma > 0, sigma, np.inf)
    for a in distinct_values(start[size.max(axis=1) > _JUMP_SIGMA]):
        own = np.flatnonzero(start == a)
        k, axis = np.unravel_index(np.argmax(size[own]), (len(own), 3))
        at, end = int(places[own[k]]), int(stop[own[k]])
        whole = median_of(means[at:end, axis]) - median_of(means[a:at, axis])
        if whole / step[own[k], axis] > _KEPT:
            cuts.append(at)
            marked[at - 1 : at + 1] = True
    cut = np.array(cuts, dtype=np.int64)
    return marked, np.sort(np.concatenate([first, cut])), np.sort(np.concatenate([last, cut]))
