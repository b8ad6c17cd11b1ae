"""The rests of a recording: which part of each is used, why others are not, and at which threshold they are found.

The threshold is chosen by what the calibration gains from it (Tedaldi 2014, Algorithm 1). The summed residual of
Algorithm 1 favours thresholds that find few data. Here each threshold is judged by the uncertainty that the
accelerometer's parameters would have with its intervals, at the noise that leaving each interval out reveals: more data
lower it, intervals that hold motion raise it.
"""

from dataclasses import replace

import numpy as np

from ...errors import InitialisationError
from ...estimate.multiposition.measurements import MagnitudeFit, fit_magnitude
from ...estimate.trust.changes import estimates_are_judged
from ...frozen import value_class
from ...progress import tell_parts
from ...recording import Floats, Integers, TriadSamples
from ...recording.samples import median_of, quantile_of
from ...results.result import Booleans, StaticIntervals, interval_means, runs_below
from ...units import ACCELEROMETER_UNITS_M_S2
from .faults import RangeChange, find_range_change
from .stillness import RateMarks, mark_rates, static_statistic, window_samples

MULTIPLIERS = (3.0, 10.0, 30.0, 100.0, 300.0)
_FEW = (10.0, 300.0)  # where an estimate alone is wanted: the usual one, and one for a hand that trembles
SHORTEST_S = 0.5
FEWEST_INTERVALS = 9
_USUAL = 10.0  # multiplier where nothing tells which serves best
_SHAKES = "it shakes more than the rests that are used"
_RANGE = "the accelerometer reads gravity as another number there"
_LOUD, _LOUDEST = 1e6, 1e12  # multipliers at which a rest that shakes 30 and 1000 times as much is still seen

_SURELY_STILL = 10.0  # times the resting level of s^2
_SAME_ATTITUDE = 0.03  # of half the range of all means
_ONE_ATTITUDE = 0.03  # of what is read: where no rest is farther from another, all of them are in one
_MOVED = 1e4  # s^2 between two pieces of a rest: ten times the noise; a touch of the table stays below
_UNSEEN_S = 0.5  # without a sample
_LOOKED_AT = 10_000  # samples, about, that tell the rate at rest
_TURNED = 0.15  # of the fastest motion, between two pieces of a rest


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
        rest = median_of(gyroscope.values[at_rest[:: max(1, len(at_rest) // _LOOKED_AT)]], axis=0)
        size = np.abs(gyroscope.values.T - rest[:, None], order="C").max(axis=0)  # along columns all is fast
        fastest = float(quantile_of(size, 0.995))
        turned = size / fastest if fastest > 0 else np.zeros(len(size))
        unseen = None
        if not np.array_equal(t_accel, t_gyro):
            at = np.clip(np.searchsorted(t_gyro, t_accel), 0, len(t_gyro) - 1)
            marks, turned = marks.at(at), turned[at]
            unseen = np.minimum(np.abs(t_gyro[at] - t_accel), np.abs(t_gyro[at - (at > 0)] - t_accel)) > _UNSEEN_S
        return cls(samples=samples, statistic=statistic, saturated=saturated, marks=marks, turned=turned, unseen=unseen)


@value_class
class ThresholdTrial:
    """One threshold: its rests, the weighted fit to their means, and the criterion (smaller is better)."""

    multiplier: float
    rests: Rests
    means: Floats
    fit: MagnitudeFit | None
    heldout_rms: float
    criterion: float

    @property
    def intervals(self) -> StaticIntervals:
        """What can be used of the rests."""
        return self.rests.intervals


@value_class
class RestDetection:
    """The rests of a recording at the threshold that was taken.

    Attributes
    ----------
    motion : what the detectors saw
    chosen, trials : the threshold taken, and all that were tried; without a fit the one next to 10 is taken. Rests of
        the one taken are with those that only a higher threshold shows, which are not used
    gyroscope : repaired samples
    range_change : where the accelerometer began to read another magnitude; rests of one side are used
    """

    motion: RestStatistics
    chosen: ThresholdTrial
    trials: tuple[ThresholdTrial, ...]
    gyroscope: TriadSamples
    range_change: RangeChange | None = None


def detect_rests(
    accelerometer: TriadSamples,
    gyroscope: TriadSamples,
    saturated: Booleans,
    *,
    t_s: tuple[Floats, Floats],
    window_s: float = 1.0,
    multiplier: float | None = None,
    gravity_m_s2: float = 9.81,
) -> RestDetection | None:
    """Find the rests of a recording, for whoever asks; None where it is shorter than two windows.

    Parameters
    ----------
    accelerometer, gyroscope : repaired samples; a gyroscope may have none
    saturated : (n,) clipped samples of the accelerometer
    t_s : (n,), (m,) instants of both [s]
    window_s, multiplier : as stated; the multiplier that serves best where it is None
    gravity_m_s2 : magnitude of gravity
    """
    window = window_samples(accelerometer, window_s)
    if len(accelerometer) < 2 * window:
        return None
    statistic = static_statistic(accelerometer.values, window)
    motion = RestStatistics.of(accelerometer, statistic, saturated, gyroscope, t_s)
    usual, loudest = (find_rests(motion, m, _shortest(accelerometer)) for m in (_USUAL, _LOUD))
    change = _range_change(accelerometer, (usual, loudest), gravity_m_s2)
    if change is not None:
        first, end = change.kept
        statistic = np.full(len(accelerometer), np.inf)
        statistic[first:end] = static_statistic(accelerometer.values[first:end], min(window, end - first))
        motion = RestStatistics.of(accelerometer, statistic, saturated, gyroscope, t_s)
        usual = None
    several = MULTIPLIERS if estimates_are_judged() else _FEW
    multipliers = several if multiplier is None else (multiplier,)
    chosen, trials = choose_threshold(motion, gravity_m_s2, multipliers, usual=usual)
    if chosen.fit is None:
        chosen = min(trials, key=lambda trial: abs(np.log(trial.multiplier / _USUAL)))
    if len(gyroscope):  # which alone tells a rest that shakes from a slow turn
        if change is None:
            steady = replace(motion, statistic=np.where(motion.marks.turns, np.inf, motion.statistic))
            loudest = find_rests(steady, _LOUDEST, _shortest(accelerometer))
        chosen = replace(chosen, rests=_with_unused(chosen.rests, loudest, change))
    return RestDetection(motion=motion, chosen=chosen, trials=trials, gyroscope=gyroscope, range_change=change)


def choose_threshold(
    motion: RestStatistics,
    gravity_m_s2: float,
    multipliers: tuple[float, ...] = MULTIPLIERS,
    usual: Rests | None = None,
) -> tuple[ThresholdTrial, tuple[ThresholdTrial, ...]]:
    """Return the best threshold and all that were tried; the best has no fit where none could be calibrated.

    `usual` are the rests at a multiplier of 10, where they are known.
    """
    each = tell_parts("finding static intervals", multipliers, len(multipliers))
    trials = tuple(try_threshold(motion, m, gravity_m_s2, usual if m == _USUAL else None) for m in each)
    best = min(trials, key=lambda trial: (trial.criterion, -len(trial.intervals)))
    return best, trials


def try_threshold(
    motion: RestStatistics, multiplier: float, gravity_m_s2: float, rests: Rests | None = None
) -> ThresholdTrial:
    """Find the static intervals at one threshold and judge them.

    Parameters
    ----------
    motion : what the detectors saw
    multiplier : threshold in units of the resting level
    gravity_m_s2 : magnitude of gravity
    rests : at that threshold, where they are known
    """
    samples = motion.samples
    rests = rests or find_rests(motion, multiplier, _shortest(samples))
    intervals = rests.intervals
    means = interval_means(samples.values, intervals)
    nothing = ThresholdTrial(
        multiplier=multiplier, rests=rests, means=means, fit=None, heldout_rms=np.nan, criterion=np.inf
    )
    if len(intervals) < FEWEST_INTERVALS + 1:
        return nothing
    duration = (intervals.stop - intervals.start) / samples.rate_hz
    weight = np.sqrt(duration / duration.mean())
    try:
        fit = fit_magnitude(means, gravity_m_s2, weight, tolerance=1e-6)
    except InitialisationError:
        return nothing
    left_out = fit.residual / np.maximum(1 - fit.leverage, 1e-6)
    variance = float(np.mean(left_out**2))
    scaled = fit.covariance / np.outer(*(2 * [np.sqrt(np.diag(fit.covariance))]))
    logs = np.linalg.slogdet(scaled)[1] + np.sum(np.log(np.diag(fit.covariance)))
    return ThresholdTrial(
        multiplier=multiplier,
        rests=rests,
        means=means,
        fit=fit,
        heldout_rms=float(np.sqrt(np.mean((left_out / weight) ** 2))),
        criterion=0.5 * (float(logs) / 9 + np.log(max(variance, 1e-300))),
    )


def _shortest(samples: TriadSamples) -> int:
    return max(2, round(SHORTEST_S * samples.rate_hz))


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


def _numbered(motion: RestStatistics, pieces: StaticIntervals) -> Integers:
    """Return the number of the rest that each piece belongs to, from 0."""
    if len(pieces) < 2:
        return np.zeros(len(pieces), dtype=np.int64)
    means = interval_means(motion.samples.values, pieces)
    half = 0.5 * np.ptp(means, axis=0)
    turned = np.linalg.norm(half) > _ONE_ATTITUDE * median_of(np.linalg.norm(means, axis=1))
    other = turned & np.any(np.abs(np.diff(means, axis=0)) > _SAME_ATTITUDE * half, axis=1)
    if motion.turned is not None:
        for k in np.flatnonzero(~other):
            gap = slice(int(pieces.stop[k]), int(pieces.start[k + 1]))
            other[k] = motion.statistic[gap].max() > _MOVED and motion.turned[gap].max() > _TURNED
    return np.concatenate([[0], np.cumsum(other)])


def _parts(
    motion: RestStatistics, turns: Booleans, stirs: Booleans, multiplier: float, shortest: int
) -> StaticIntervals:
    """Return what can be used of rests, where the gyroscope is told to turn and to stir."""
    steady = runs_below(np.where(turns, np.inf, motion.statistic), multiplier, shortest)
    parts = trim_intervals(steady, stirs, shortest)
    parts = parts.where((_count(motion.saturated, parts) == 0) & (_count(motion.marks.apart, parts) == 0))
    return parts if motion.unseen is None else parts.where(_count(motion.unseen, parts) == 0)


def trim_intervals(intervals: StaticIntervals, stirs: Booleans, shortest: int) -> StaticIntervals:
    """Return the intervals without the samples at their ends that stir, where enough is left.

    Parameters
    ----------
    stirs : (n,) from `stillness.mark_rates`
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


def _count(marked: Booleans, intervals: StaticIntervals) -> Integers:
    """Return how many samples of each interval are marked."""
    at = np.flatnonzero(marked)
    return np.searchsorted(at, intervals.stop) - np.searchsorted(at, intervals.start)


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


def _with_unused(rests: Rests, loudest: Rests, change: RangeChange | None) -> Rests:
    """Return the rests with those that were found at the highest threshold only, as not used.

    Short ones are left away, since any motion is slow for a moment, and those in which the gyroscope turns.
    """
    if not len(rests):
        return rests
    inside = change.kept if change is not None else (0, np.inf)
    other = (loudest.kept.start < inside[0]) | (loudest.kept.stop > inside[1])
    length = median_of(rests.found.stop - rests.found.start)
    begins = np.searchsorted(rests.found.stop, loudest.kept.start, side="right")
    ends = np.searchsorted(rests.found.start, loudest.kept.stop)
    apart = begins >= ends
    extra = apart & (other | loudest.used) & (loudest.kept.stop - loudest.kept.start > 0.5 * length)
    if not extra.any():
        return rests
    order = np.argsort(np.concatenate([rests.kept.start, loudest.kept.start[extra]]))
    reason = (*rests.reason, *(_RANGE if there else _SHAKES for there in other[extra]))
    return Rests(
        found=_joined(rests.found, loudest.found.where(extra), order),
        kept=_joined(rests.kept, loudest.kept.where(extra), order),
        reason=tuple(reason[k] for k in order),
    )


def _joined(one: StaticIntervals, other: StaticIntervals, order: Integers) -> StaticIntervals:
    return StaticIntervals(
        start=np.concatenate([one.start, other.start])[order], stop=np.concatenate([one.stop, other.stop])[order]
    )


def _range_change(samples: TriadSamples, rests: tuple[Rests, ...], gravity_m_s2: float) -> RangeChange | None:
    """Return the change that one of several sets of rests shows: loud rests are in one, quiet ones apart in another."""
    unit = ACCELEROMETER_UNITS_M_S2[samples.unit]
    gravity = gravity_m_s2 / unit if unit else None
    reads = [np.linalg.norm(interval_means(samples.values, some.found), axis=1) for some in rests]
    changes = (
        find_range_change(read, some.found, len(samples), gravity, FEWEST_INTERVALS + 1)
        for read, some in zip(reads, rests, strict=True)
    )
    return next((change for change in changes if change is not None), None)
