"""What static intervals hold: the sensor's noise, what its converter's steps do to their means, and disturbance.

A sensor reads x + noise, rounded to steps; here the step is 1 and x lies about half a step from a code at most. White
noise of more than half a step carries the mean over all parts of a step, and rounding errors cancel. A quieter sensor
shows one code for anything within a step, or flips between two of them: a share p of the upper one says
x = 1/2 + s inv(Phi)(p), where the noise s is known. It is known where a third code is seen, too, and otherwise anything
below where one would be: the mean p is off by 1/2 - p where there is hardly any noise, and by nothing at the most noise
there may be. A tremor, which is regular, dwells at its ends, and leaves an error also where it is larger than a step.
"""

from functools import cache

import numpy as np

from ...estimate.multiposition.bias_changes import BiasChanges, accelerometer_changes, functions_of_time
from ...estimate.multiposition.problem import TriadStream, rest_means
from ...frozen import value_class
from ...recording import Floats, Integers, TriadSamples, smallest_steps
from ...recording.samples import median_of
from ...results.result import Booleans, StaticIntervals
from .rests import FEWEST_INTERVALS, ThresholdTrial

_PIECE_S = 0.05
_PIECES = 5
"""The rule: blocks of five pieces, a quarter of a second."""
_LONGER, _SHORTER = (10, 20, 40), (2, 1)
_FEWEST_DIFFERENCES = 20
_OUTLIER_SIGMA = 6.0
_SUSPICIOUS_SIGMA = 2.5
_REWEIGHTINGS = 6
_NO_WEIGHT = 1e-6

_COARSE = 0.3  # variance from sample to sample, in squared steps; that of white noise of 0.46 of a step
_REGULAR = 2.7  # fourth moment over squared variance: 3 for white noise, 1.5 for a tremor
_WIDE = 4.0  # variance of a tremor that leaves no error to speak of
_STRAY = 0.003  # share of samples that something else than noise put beside their code
_BESIDE = 4  # codes on each side that are looked at
_MOST = 100.0  # samples of an interval that count; more would need a finer table
_TOLD = 2000.0  # samples of all intervals that tell one kind of noise from another
_PART = 100  # intervals

_NOISE = np.linspace(0.0, 1.0, 401)  # in steps
_WAVE, _OF = np.nonzero(np.arange(1, 400)[:, None] * _NOISE < 1.0)  # beyond, a wave adds less than 1e-17
_TERMS = np.exp(-4 * (np.pi * (_WAVE + 1) * _NOISE[_OF]) ** 2) / (2 * (np.pi * (_WAVE + 1)) ** 2)
_OF_MEANS = np.bincount(_OF, _TERMS, len(_NOISE))
_SCATTER = _NOISE**2 + 1 / 12 - _OF_MEANS
"""Of rounded samples about their mean: what noise and rounding do together, less what the mean has of it."""


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
    if not stand_out(size, float(median_of(size)), _SUSPICIOUS_SIGMA).any():
        return nothing
    for _ in range(_REWEIGHTINGS):
        size = left_out(1 / np.sqrt(np.maximum(size, white)))
    agree = ~stand_out(size, 2 * float(median_of(size)), _OUTLIER_SIGMA)
    size = left_out(np.where(agree, weight, _NO_WEIGHT))
    out = stand_out(size, float(median_of(size[agree])), _OUTLIER_SIGMA)
    keeps_enough = (~out).sum() >= max(FEWEST_INTERVALS + 1, 0.6 * len(out))
    return out if keeps_enough else nothing


def rounding_variance(values: Floats, intervals: StaticIntervals, step: Floats | None = None) -> Floats:
    """Return the variance of each mean at rest that rounding makes, (n, 3) [unit^2], however long the rest is.

    It is D^2 / 12 for steps D where all samples of all rests read one code.

    Parameters
    ----------
    values : (m, 3) [unit]
    intervals : n static intervals
    step : (3,) of the values, 0 where they never change; found where it is not given
    """
    step = np.nan_to_num(smallest_steps(values)) if step is None else step
    inside = np.zeros(len(values), dtype=bool)
    for start, stop in zip(intervals.start, intervals.stop, strict=True):
        inside[start + 1 : stop] = True  # the difference to the sample before is one of this rest
    squares, count = np.square(np.diff(values, axis=0)), int(inside[1:].sum())
    scatter = 0.5 * (inside[1:].astype(np.float64) @ squares) / max(count, 1)
    with np.errstate(divide="ignore", invalid="ignore"):
        seen = np.where(step > 0, scatter / step**2, np.inf)
    variance = np.tile(step**2 * np.interp(seen, _SCATTER, _OF_MEANS), (len(intervals), 1))
    for axis in np.flatnonzero((seen < _WIDE) & (count > 0)):
        codes = np.rint((values[:, axis] - values[0, axis]) / step[axis])
        counts, spread, peak = _beside_their_mean(codes, intervals)
        if seen[axis] < _COARSE or (spread < _WIDE and peak < _REGULAR * spread**2):
            # Samples that follow each other say less than independent ones.
            counts *= min(seen[axis] / spread, 1.0) if spread > 0 else 1.0
            counts *= np.minimum(_MOST / np.maximum(counts.sum(axis=1, keepdims=True), 1.0), 1.0)
            variance[:, axis] = step[axis] ** 2 * _squared_error(counts)
    return np.asarray(variance, dtype=np.float64)


def _beside_their_mean(codes: Floats, intervals: StaticIntervals) -> tuple[Floats, float, float]:
    """Return how many samples of each interval read which code about their mean, (n, 9), and how all of them spread.

    The spread is the second and the fourth moment about each interval's mean.
    """
    counts = np.zeros((len(intervals), 2 * _BESIDE + 1))
    squares = fourths = samples = 0.0
    for k, (start, stop) in enumerate(zip(intervals.start, intervals.stop, strict=True)):
        own = codes[start:stop]
        mean = float(own.mean())
        near = (own - np.rint(mean)).astype(np.int64) + _BESIDE
        counts[k] = np.bincount(near[(near >= 0) & (near <= 2 * _BESIDE)], minlength=2 * _BESIDE + 1)
        off = np.square(own - mean)
        squares, fourths, samples = squares + float(off.sum()), fourths + float(off @ off), samples + len(own)
    return counts, squares / max(samples, 1.0), fourths / max(samples, 1.0)


@value_class
class _Codes:
    """What is seen with each kind of noise and each x.

    Attributes
    ----------
    logarithm : (9, kinds, x) of the share of the codes from -4 to 4
    squares : (kinds, x) of the error of a mean
    beforehand : (kinds,) logarithm of how likely a kind is; as often without a tremor as with one
    """

    logarithm: Floats
    squares: Floats
    beforehand: Floats


@cache
def _codes() -> _Codes:
    """Return the table for white noise of some sizes, each with a tremor (a sine) of some sizes."""
    from scipy.special import ndtr

    white = np.concatenate([np.geomspace(2e-3, 0.08, 8), np.linspace(0.1, 0.6, 21)])
    tremor = np.array([0.0, 0.3, 0.5, 0.7, 0.85, 1.0, 1.2, 1.5, 1.9, 2.4, 3.0])
    fine, most = 30, _BESIDE + 1.2  # points in a step
    y = np.arange(-round(most * fine), round(most * fine) + 1) / fine
    ends = np.append(y - 0.5 / fine, y[-1] + 0.5 / fine)
    of_sine = np.where(tremor[1:] > 0, 0.5 + np.arcsin(np.clip(ends[:, None] / tremor[1:], -1, 1)) / np.pi, 0.0)
    mass = np.column_stack([y == 0, np.diff(of_sine, axis=0)])  # (y, tremor)
    apart = np.arange(-2 * len(y), 2 * len(y) + 1) / fine
    index = np.subtract.outer(np.arange(len(y)), np.arange(len(y))) + 2 * len(y)
    below = np.stack([ndtr(apart / s)[index] @ mass for s in white]).transpose(1, 0, 2).reshape(len(y), -1)
    x = np.arange(-round(0.6 * fine), round(0.6 * fine) + 1)
    edges = (np.arange(-_BESIDE - 1, _BESIDE + 1) + 0.5) * fine
    at = np.rint(edges[:, None] - x + len(y) // 2).astype(np.int64)
    share = np.diff(below[at], axis=0).transpose(0, 2, 1)  # (code, kind, x)
    share /= share.sum(axis=0)
    mean = np.tensordot(np.arange(-_BESIDE, _BESIDE + 1), share, 1)
    return _Codes(
        logarithm=np.log((1 - _STRAY) * share + _STRAY / len(share)),
        squares=np.square(mean - x / fine),
        beforehand=np.tile(np.log(np.where(tremor > 0, 0.5 / (len(tremor) - 1), 0.5)), len(white)),
    )


def _squared_error(counts: Floats) -> Floats:
    """Return the expected square of each mean's error, (n,) [step^2], whatever the size of the noise and x may be.

    Parameters
    ----------
    counts : (n, 9) of codes; the noise is the same in all intervals, x may be another in each
    """
    codes = _codes()
    best, mean, squares = (np.empty((len(counts), len(codes.squares))) for _ in range(3))
    for first in range(0, len(counts), _PART):
        part = slice(first, first + _PART)
        exponent = np.tensordot(counts[part], codes.logarithm, 1)
        best[part] = exponent.max(axis=2)
        weight = np.exp(exponent - best[part][..., None])
        mean[part] = best[part] + np.log(weight.mean(axis=2))
        squares[part] = np.sum(weight * codes.squares, axis=2) / weight.sum(axis=2)

    # Noise is of none of these kinds exactly, and many samples shall not choose one as if it were.
    trusted = min(_TOLD / max(float(counts.sum()), 1.0), 1.0)

    def averaged(likelihood: Floats) -> Floats:
        of_kind = trusted * likelihood.sum(axis=0) + codes.beforehand
        of_kind = np.exp(of_kind - of_kind.max())
        return squares @ of_kind / of_kind.sum()

    # Where x is the same in all intervals, as a bias is, that all flip is no coincidence; where it is not, it is one.
    return np.maximum(averaged(best), averaged(mean))
