"""The rests of a recording: where the accelerometer is still, which part of each is used, and why others are not.

Static intervals by the variance magnitude of the accelerometer (Tedaldi 2014, section 3.4.1).

Eq. (3.9): the square of the variance magnitude, s^2(t) = sum over the axes of var(a)^2 in a window of t_w seconds
centred in t, is compared with a multiple of its level at rest. Each axis is measured by its own level at rest first, so
that neither the unit nor an axis with more noise than the others matters.
"""

import numpy as np

from ...frozen import value_class
from ...recording import Floats, Integers, TriadSamples
from ...results.result import Booleans, StaticIntervals, interval_means
from .turning import RateMarks, mark_rates

_CHUNK = 262_144  # samples; bounds the memory of long recordings and the error of the running sums
_SURELY_STILL = 10.0  # times the resting level of s^2
_SAME_ATTITUDE = 0.03  # of half the range of all means
_ONE_ATTITUDE = 0.03  # of what is read: where no rest is farther from another, all of them are in one
_MOVED = 1e4  # s^2 between two pieces of a rest: ten times the noise; a touch of the table stays below
_UNSEEN_S = 0.5  # without a sample
_LOOKED_AT = 10_000  # samples, about, that tell the rate at rest
_TURNED = 0.15  # of the fastest motion, between two pieces of a rest


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


@value_class
class Rests:
    """Rests in order of time.

    Attributes
    ----------
    found : (m) rests as the accelerometer shows them, from the first piece of each to the last
    kept : (m) the part of each that can be used; of one that cannot, all of it
    reason : (m,) why a rest cannot be used, or ""
    """

    found: StaticIntervals
    kept: StaticIntervals
    reason: tuple[str, ...]

    @classmethod
    def none(cls) -> "Rests":
        """Return no rests."""
        nothing = StaticIntervals(start=np.empty(0, np.int64), stop=np.empty(0, np.int64))
        return cls(found=nothing, kept=nothing, reason=())

    def __len__(self) -> int:
        return len(self.reason)

    @property
    def used(self) -> Booleans:
        """Which rests can be used, (m,)."""
        return np.array([not why for why in self.reason], dtype=bool)

    @property
    def intervals(self) -> StaticIntervals:
        """What can be used of them."""
        return self.kept.where(self.used)


@value_class
class RestStatistics:
    """What the detectors saw of an accelerometer's samples.

    Attributes
    ----------
    samples : accelerometer
    statistic : (n,) from `static_statistic`
    saturated : (n,) samples that no static interval may hold
    marks : what the gyroscope says
    turned : (n,) gyroscope's distance from its rate at rest, over that of the fastest motion; None without gyroscope
    unseen : (n,) samples about which the gyroscope has none; None where it has all
    """

    samples: TriadSamples
    statistic: Floats
    saturated: Booleans
    marks: RateMarks
    turned: Floats | None = None
    unseen: Booleans | None = None

    @classmethod
    def of(
        cls,
        samples: TriadSamples,
        statistic: Floats,
        saturated: Booleans,
        gyroscope: TriadSamples,
        t_s: tuple[Floats, Floats],
    ) -> "RestStatistics":
        """Return the motion of an IMU.

        Parameters
        ----------
        gyroscope : its samples; none where there is no gyroscope
        t_s : (n,), (m,) instants of the accelerometer's and the gyroscope's samples [s]
        """
        if not len(gyroscope):
            return cls(samples=samples, statistic=statistic, saturated=saturated, marks=RateMarks.none(len(samples)))
        still, (t_accel, t_gyro) = statistic < _SURELY_STILL, t_s
        if not np.array_equal(t_accel, t_gyro):
            still = still[np.clip(np.searchsorted(t_accel, t_gyro), 0, len(t_accel) - 1)]
        marks = mark_rates(gyroscope, still)
        at_rest = np.flatnonzero(still) if still.any() else np.arange(len(gyroscope))
        rest = np.median(gyroscope.values[at_rest[:: max(1, len(at_rest) // _LOOKED_AT)]], axis=0)
        size = np.abs(gyroscope.values.T - rest[:, None], order="C").max(axis=0)  # along columns all is fast
        fastest = float(np.quantile(size, 0.995))
        turned = size / fastest if fastest > 0 else np.zeros(len(size))
        unseen = None
        if not np.array_equal(t_accel, t_gyro):
            at = np.clip(np.searchsorted(t_gyro, t_accel), 0, len(t_gyro) - 1)
            marks, turned = marks.at(at), turned[at]
            unseen = np.minimum(np.abs(t_gyro[at] - t_accel), np.abs(t_gyro[at - (at > 0)] - t_accel)) > _UNSEEN_S
        return cls(samples=samples, statistic=statistic, saturated=saturated, marks=marks, turned=turned, unseen=unseen)


def find_rests(motion: RestStatistics, multiplier: float, shortest: int) -> Rests:
    """Return the rests at one threshold, and what can be used of each.

    A low threshold breaks a rest into pieces that follow each other in one attitude; they are one rest, of which the
    longest piece counts. Pieces between which the sensor was moved, as by a full turn, are several rests.

    Parameters
    ----------
    motion : what the detectors saw
    multiplier : threshold on s^2 in units of the resting level
    shortest : least number of samples in a static interval
    """
    found = runs_below(motion.statistic, multiplier, shortest)
    if not len(found):
        return Rests(found=found, kept=found, reason=())
    marks, rest = motion.marks, _numbered(motion, found)
    begins = np.flatnonzero(np.diff(rest, prepend=-1))
    ends = np.append(begins[1:], len(rest)) - 1
    kept = np.zeros((2, len(begins)), dtype=np.int64)

    def take_longest(parts: StaticIntervals) -> None:
        """Take the longest part of each rest of which none was taken."""
        owner = rest[np.searchsorted(found.start, parts.start, side="right") - 1]
        order = np.lexsort((parts.start - parts.stop, owner))
        owner = owner[order]
        new = (np.diff(owner, prepend=-1) > 0) & (kept[1, owner] == 0)
        kept[:, owner[new]] = parts.start[order[new]], parts.stop[order[new]]

    take_longest(_parts(motion, marks.turns, marks.stirs, multiplier, shortest))
    if not kept[1].all():
        take_longest(_parts(motion, marks.turns_beyond_tremor, marks.stirs_beyond_tremor, multiplier, shortest))
    useless = kept[1] == 0
    take_longest(found)
    start, stop = kept
    return Rests(
        found=StaticIntervals(start=found.start[begins], stop=found.stop[ends]),
        kept=StaticIntervals(start=start, stop=stop),
        reason=tuple(_why(motion, a, b) if none else "" for none, a, b in zip(useless, start, stop, strict=True)),
    )


def _count(marked: Booleans, intervals: StaticIntervals) -> Integers:
    """Return how many samples of each interval are marked."""
    at = np.flatnonzero(marked)
    return np.searchsorted(at, intervals.stop) - np.searchsorted(at, intervals.start)


def _parts(
    motion: RestStatistics, turns: Booleans, stirs: Booleans, multiplier: float, shortest: int
) -> StaticIntervals:
    """Return what can be used of rests, where the gyroscope is told to turn and to stir."""
    steady = runs_below(np.where(turns, np.inf, motion.statistic), multiplier, shortest)
    parts = trim_intervals(steady, stirs, shortest)
    parts = parts.where((_count(motion.saturated, parts) == 0) & (_count(motion.marks.apart, parts) == 0))
    return parts if motion.unseen is None else parts.where(_count(motion.unseen, parts) == 0)


def _numbered(motion: RestStatistics, pieces: StaticIntervals) -> Integers:
    """Return the number of the rest that each piece belongs to, from 0."""
    if len(pieces) < 2:
        return np.zeros(len(pieces), dtype=np.int64)
    means = interval_means(motion.samples.values, pieces)
    half = 0.5 * np.ptp(means, axis=0)
    turned = np.linalg.norm(half) > _ONE_ATTITUDE * np.median(np.linalg.norm(means, axis=1))
    other = turned & np.any(np.abs(np.diff(means, axis=0)) > _SAME_ATTITUDE * half, axis=1)
    if motion.turned is not None:
        for k in np.flatnonzero(~other):
            gap = slice(int(pieces.stop[k]), int(pieces.start[k + 1]))
            other[k] = motion.statistic[gap].max() > _MOVED and motion.turned[gap].max() > _TURNED
    return np.concatenate([[0], np.cumsum(other)])


def _why(motion: RestStatistics, start: int, stop: int) -> str:
    """Return why a rest cannot be used."""
    part, marks = slice(start, stop), motion.marks
    turns, saturated = marks.turns[part].any(), motion.saturated[part].any()
    reasons = (
        (motion.unseen is not None and motion.unseen[part].any(), "the gyroscope has no samples there"),
        (saturated and not turns, "the accelerometer is saturated"),
        (
            marks.apart[part].any(),
            "the gyroscope's rate is far from that of the rests around it: it turned, or its bias was another",
        ),
        (marks.jumps[part].any(), "the gyroscope's bias stepped, and too little is left on either side"),
        (turns, "the gyroscope shows that the sensor turned"),
    )
    return next((words for holds, words in reasons if holds), "too short without its ends, which stir")
