"""The rests of a recording at a threshold chosen by what the calibration gains from it (Tedaldi 2014, Algorithm 1).

The summed residual of Algorithm 1 favours thresholds that find few data. Here each threshold is judged by the
uncertainty that the accelerometer's parameters would have with its intervals, at the noise that leaving each interval
out reveals: more data lower it, intervals that hold motion raise it.
"""

from dataclasses import replace

import numpy as np

from ...errors import InitialisationError
from ...estimate.multiposition.bias_changes import BiasChanges, accelerometer_changes, functions_of_time
from ...estimate.multiposition.measurements import MagnitudeFit, fit_magnitude
from ...estimate.multiposition.problem import TriadStream, rest_means
from ...estimate.trust.changes import estimates_are_judged
from ...frozen import value_class
from ...progress import tell_parts
from ...recording import Floats, Integers, TriadSamples
from ...results.result import Booleans, StaticIntervals, interval_means
from ...units import ACCELEROMETER_UNITS_M_S2
from .range_change import RangeChange, find_range_change
from .rests import Rests, RestStatistics, find_rests, static_statistic, window_samples

_PIECE_S = 0.05
_PIECES = 5
"""The rule: blocks of five pieces, a quarter of a second."""
_LONGER, _SHORTER = (10, 20, 40), (2, 1)
_FEWEST_DIFFERENCES = 20
MULTIPLIERS = (3.0, 10.0, 30.0, 100.0, 300.0)
_FEW = (10.0, 300.0)  # where an estimate alone is wanted: the usual one, and one for a hand that trembles
SHORTEST_S = 0.5
_USUAL = 10.0  # multiplier where nothing tells which serves best
_SHAKES = "it shakes more than the rests that are used"
_RANGE = "the accelerometer reads gravity as another number there"
_LOUD, _LOUDEST = 1e6, 1e12  # multipliers at which a rest that shakes 30 and 1000 times as much is still seen
FEWEST_INTERVALS = 9
_OUTLIER_SIGMA = 6.0
_SUSPICIOUS_SIGMA = 2.5
_REWEIGHTINGS = 6
_NO_WEIGHT = 1e-6


def resting_noise(values: Floats, intervals: StaticIntervals, rate_hz: float) -> tuple[Floats, Floats]:
    """Return two noise densities of each axis at rest, (3,) [unit^2 s].

    From half the mean squared difference of neighbouring block means (Allan's variance), which slow drift and the
    attitude itself leave alone. Blocks of a quarter of a second are the rule: they are long enough for a filtered
    sensor and many enough for a precise level. Other lengths replace them where they differ significantly.

    Parameters
    ----------
    values : (n, 3) [unit]
    intervals : static intervals
    rate_hz : sample rate [Hz]

    Returns
    -------
    of_means : a mean over T seconds has variance of_means / T; longer blocks count, since means are taken over seconds
    of_increments : an integral over T seconds has variance of_increments * T; shorter blocks count where they show
        less, since a hand's tremor is motion that a gyroscope measures rightly
    """
    length = max(1, round(_PIECE_S * rate_hz))
    sums, counts = _piece_sums(values, intervals, length)
    per_difference = 1 / (2 * length * rate_hz)

    def level(pieces: int) -> tuple[Floats, int]:
        squares, count = _block_differences(sums, counts, pieces)
        return squares / max(count, 1) * per_difference / pieces, count

    of_means = of_increments = level(_PIECES)[0]
    for pieces in _LONGER:
        found, count = level(pieces)
        if count < _FEWEST_DIFFERENCES:
            break
        of_means = np.where(_differ(found, of_means, count), found, of_means)
    for pieces in _SHORTER:
        found, count = level(pieces)
        lower = (found < of_increments) & _differ(found, of_increments, count)
        of_increments = np.where(lower, found, of_increments)
    return of_means, of_increments


def _piece_sums(values: Floats, intervals: StaticIntervals, length: int) -> tuple[Floats, Integers]:
    """Return running sums (pieces + 1, 3) over whole pieces of all intervals, and each interval's number of pieces."""
    counts = (intervals.stop - intervals.start) // length
    edges = np.repeat(intervals.start - length * (np.cumsum(counts) - counts), counts)
    edges += length * np.arange(len(edges))
    sums = np.zeros((len(edges) + 1, 3))
    if len(edges):
        pieces = values[edges].copy()
        for k in range(1, length):
            pieces += values[edges + k]
        np.cumsum(pieces - pieces[len(pieces) // 2], axis=0, out=sums[1:])
    return sums, counts


def _differ(level: Floats, density: Floats, count: int) -> Booleans:
    """Return whether two levels differ by more than three sigma of the one from `count` differences."""
    return np.abs(level - density) > 3 * np.sqrt(3 / max(count, 1)) * np.maximum(density, level)


def _block_differences(sums: Floats, counts: Integers, pieces: int) -> tuple[Floats, int]:
    """Return the summed squares (3,) and the number of differences of neighbouring block sums within intervals."""
    blocks = counts // pieces
    first = np.cumsum(counts) - counts
    edges = np.repeat(first - pieces * (np.cumsum(blocks + 1) - blocks - 1), blocks + 1)
    edges += pieces * np.arange(len(edges))
    within = np.ones(max(len(edges) - 1, 0), dtype=bool)
    within[np.cumsum(blocks + 1)[:-1] - 1] = False  # from the last edge of an interval to the first of the next
    both = within[1:] & within[:-1]
    differences = np.diff(np.diff(sums[edges], axis=0), axis=0)[both]
    return np.einsum("ij,ij->j", differences, differences), int(both.sum())


def allan_deviation(values: Floats, rate_hz: float, tau_s: Floats) -> Floats:
    """Return the Allan deviation of each axis by Eq. (3.17), (len(tau_s), 3) [unit]; nan where under two averages fit.

    Parameters
    ----------
    values : (n, 3) samples at rest [unit]
    rate_hz : sample rate [Hz]
    tau_s : averaging times [s]
    """
    deviation = np.full((len(tau_s), 3), np.nan)
    sums = np.zeros((3, len(values) + 1))
    sums[:, 1:] = values.T
    sums[:, 1:] -= sums[:, 1:].mean(axis=1, keepdims=True)  # small numbers keep the running sums exact
    np.cumsum(sums, axis=1, out=sums)
    for row, tau in enumerate(tau_s):
        length = max(1, round(tau * rate_hz))
        if len(values) // length >= 2:
            steps = np.diff(sums[:, ::length], 2, axis=1) / length
            deviation[row] = np.sqrt(0.5 * np.mean(steps**2, axis=1))
    return deviation


def averaging_time(tau_s: Floats, deviation: Floats) -> float:
    """Return T_init, the averaging time at which the curves of all axes have flattened [s]; nan where they still fall.

    Flat is where twice the averaging time would lower the deviation by less than 15 % (white noise: 29 %).

    Parameters
    ----------
    tau_s : (k,) rising by factors
    deviation : (k, 3)
    """
    seen = np.maximum(deviation, np.finfo(float).tiny)  # none where the converter is coarser than the noise
    slope = np.gradient(np.log(seen), np.log(tau_s), axis=0) if len(tau_s) > 2 else np.full(deviation.shape, -1.0)
    flat = np.all(slope > np.log(0.85) / np.log(2), axis=1)
    return float(tau_s[np.argmax(flat)]) if flat.any() else float("nan")


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


def _shortest(samples: TriadSamples) -> int:
    return max(2, round(SHORTEST_S * samples.rate_hz))


def _with_unused(rests: Rests, loudest: Rests, change: RangeChange | None) -> Rests:
    """Return the rests with those that were found at the highest threshold only, as not used.

    Short ones are left away, since any motion is slow for a moment, and those in which the gyroscope turns.
    """
    if not len(rests):
        return rests
    inside = change.kept if change is not None else (0, np.inf)
    other = (loudest.kept.start < inside[0]) | (loudest.kept.stop > inside[1])
    length = np.median(rests.found.stop - rests.found.start)
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


def accelerometer_course(accelerometer: TriadStream) -> tuple[BiasChanges, Floats]:
    """Return how the accelerometer's bias changed, by its rests, and the functions of time (n, j) that it follows."""
    changes = accelerometer_changes(rest_means(accelerometer))
    start, stop = (accelerometer.t_s[at] for at in (accelerometer.intervals.start, accelerometer.intervals.stop - 1))
    return changes, functions_of_time(changes, 0.5 * (start + stop), 0.5 * (stop - start), accelerometer.degc_at_rest)


def disturbed_intervals(
    trial: ThresholdTrial, samples: TriadSamples, course: Floats | None = None, noise: Floats | None = None
) -> Booleans:
    """Return which intervals do not show gravity like the others, (n,): touched, or not at rest.

    Where a residual stands out, the sum of absolute residuals is minimised first, by reweighting, so that several
    disturbed intervals cannot hide by bending the fit; then each interval is judged by its residual when left out of a
    fit to those that agree. Residuals of a few per cent of gravity are linear enough to be refitted as they stand.

    Parameters
    ----------
    course : (n, j) functions of time that the bias follows, from `accelerometer_course`
    noise : (3,) density of means at rest, where it is known; see `resting_noise`
    """
    assert trial.fit is not None
    duration = (trial.intervals.stop - trial.intervals.start) / samples.rate_hz
    weight = np.sqrt(duration / duration.mean())
    noise = resting_noise(samples.values, trial.intervals, samples.rate_hz)[0] if noise is None else noise
    white = np.sqrt(np.mean(noise) / duration) * np.abs(np.linalg.det(trial.fit.correction)) ** (1 / 3)
    residual, jacobian = trial.fit.residual / weight, trial.fit.jacobian / weight[:, None]
    if course is not None:
        moving = course[:, :, None] * jacobian[:, None, 6:]
        jacobian = np.concatenate([jacobian, moving.reshape(len(jacobian), -1)], axis=1)

    def left_out(given: Floats) -> Floats:
        """Return the size of each residual in a weighted fit from which it was left out."""
        q, r = np.linalg.qr(jacobian * given[:, None])
        step = -np.linalg.lstsq(r, q.T @ (residual * given), rcond=1e-12)[0]
        leverage = np.einsum("ij,ij->i", q, q)
        return np.abs(residual + jacobian @ step) / np.maximum(1 - leverage, 1e-6)

    def stand_out(size: Floats, usual: float, sigmas: float) -> Booleans:
        return size > sigmas * np.maximum(1.4826 * usual, white)

    nothing = np.zeros(len(weight), dtype=bool)
    size = left_out(weight)
    if not stand_out(size, float(np.median(size)), _SUSPICIOUS_SIGMA).any():
        return nothing
    for _ in range(_REWEIGHTINGS):
        size = left_out(1 / np.sqrt(np.maximum(size, white)))
    agree = ~stand_out(size, 2 * float(np.median(size)), _OUTLIER_SIGMA)
    size = left_out(np.where(agree, weight, _NO_WEIGHT))
    out = stand_out(size, float(np.median(size[agree])), _OUTLIER_SIGMA)
    keeps_enough = (~out).sum() >= max(FEWEST_INTERVALS + 1, 0.6 * len(out))
    return out if keeps_enough else nothing
