"""Noise levels of the multi-position problem: at rest, by rounding, by motion between samples, and what remains.

What the noise at rest does not explain is put into three extra variances: of the accelerometer and of the gyroscope
between static intervals, and of the rotations. Each is zero unless the residuals prove otherwise.

Motion between samples: integrated with every second one, a rotation ends elsewhere: by the noise of the samples that
are left out, whose variance is that of the whole rotation, and by what the motion did between those that are kept. The
integration is of second order, so that all samples leave a third of the latter.

Rounding: a sensor reads x + noise, rounded to steps; here the step is 1 and x lies about half a step from a code at
most. White noise of more than half a step carries the mean over all parts of a step, and rounding errors cancel. A
quieter sensor shows one code for anything within a step, or flips between two of them: a share p of the upper one says
x = 1/2 + s inv(Phi)(p), where the noise s is known. It is known where a third code is seen, too, and otherwise anything
below where one would be: the mean p is off by 1/2 - p where there is hardly any noise, and by nothing at the most noise
there may be. A tremor, which is regular, dwells at its ends, and leaves an error also where it is larger than a step.
"""

from dataclasses import fields, replace
from functools import cache

import numpy as np

from ...frozen import value_class
from ...geometry.rotations import invert_matrix
from ...recording import Floats, Integers, smallest_steps
from ...recording.samples import median_of
from ...results.result import Booleans, StaticIntervals
from ...solve.least_squares import ArrowSolution
from .measurements import MotionSegments, integrate_rates
from .model import MultiPositionData, MultiPositionLinearization, MultiPositionState, Whitening

_ORDER = 3.0  # error with every second sample over that with all, less one
_SURE = 4.0  # sigmas of chi-square


def with_sampling_error(data: MultiPositionData, state: MultiPositionState) -> MultiPositionData:
    """Return the data with the variance of rotations by motion between samples, where it stands out from the noise.

    Parameters
    ----------
    data : the problem
    state : near the best
    """
    s, b, c_g, b_g, g = state.matrices
    linked = data.linked
    if not linked.any():
        return data
    segments = data.segments
    force = (segments.accelerometer - b) @ invert_matrix(s).T
    omega = (segments.gyroscope - b_g - force @ g.T) @ c_g.T
    halved, kept = _every_second(segments)
    difference = np.einsum(
        "kji,kjl->kil",
        integrate_rates(segments, omega).rotation[linked],
        integrate_rates(halved, omega[kept]).rotation[linked],
    )
    skew = 0.5 * (difference - np.swapaxes(difference, 1, 2))
    squares = 0.5 * np.einsum("kij,kij->k", skew, skew)  # of the sine of the angle between both
    noise = 3 * rotation_variance(data, state)[linked]
    excess = float(np.sum(squares - noise))
    if excess <= _SURE * float(np.sqrt(2 / 3 * np.sum(noise**2))):
        return data
    return replace(data, sampling_variance=excess / (3 * len(noise)) / _ORDER**2)


def _every_second(segments: MotionSegments) -> tuple[MotionSegments, Booleans]:
    """Return the rotations with every second sample and the last, and which samples these are."""
    kept = np.zeros(len(segments.dt_s), dtype=bool)
    for first, length in zip(segments.first, segments.lengths, strict=True):
        kept[first : first + length : 2] = True
    kept[segments.first + segments.lengths - 1] = True
    lengths = segments.lengths // 2 + 1
    instants = np.cumsum(segments.dt_s) - segments.dt_s  # dt is 0 at the last sample of each
    dt_s = np.append(np.diff(instants[kept]), 0.0)
    dt_s[np.cumsum(lengths) - 1] = 0.0
    halved = MotionSegments(
        gyroscope=segments.gyroscope[kept], accelerometer=segments.accelerometer[kept], dt_s=dt_s, lengths=lengths
    )
    return halved, kept


@value_class
class ExtraVariance:
    """Variances beyond the noise at rest.

    Attributes
    ----------
    accelerometer : of an interval's mean specific force, per axis [g^2]
    gyroscope : of an interval's mean rate, per axis [(rad/s)^2]
    rotation : of a rotation, per axis [rad^2]
    """

    accelerometer: float = 0.0
    gyroscope: float = 0.0
    rotation: float = 0.0

    def agrees_with(self, other: "ExtraVariance") -> bool:
        """Return whether all three agree to 5 %."""
        pairs = [(getattr(self, f.name), getattr(other, f.name)) for f in fields(self)]
        return all(abs(a - b) <= 0.05 * max(a, b) for a, b in pairs)


def whitened_rest(data: MultiPositionData, state: MultiPositionState, extra: ExtraVariance) -> tuple[Floats, Floats]:
    """Return inverse roots (n, 3, 3) of the covariances of the accelerometer's and the gyroscope's means at rest."""
    s, _, c_g, _, _ = state.matrices
    s_g = invert_matrix(c_g)
    gyroscope = extra.gyroscope + data.earth_rate_variance
    return (
        _inverse_root(data.accelerometer_variance, extra.accelerometer * s @ s.T),
        _inverse_root(data.gyroscope_variance, gyroscope * s_g @ s_g.T),
    )


def rotation_variance(data: MultiPositionData, state: MultiPositionState) -> Floats:
    """Return the variance of each rotation by noise, earth rate and sampling, (n - 1,), per axis [rad^2].

    Attitudes change during a rotation, so that the gyroscope's axes share their noise evenly.
    """
    c_g = state.matrices[2]
    noise = data.rotation_variance @ (c_g**2).sum(axis=0) / 3
    noise += data.earth_rate_variance * data.segments.duration_s**2 + data.sampling_variance
    return np.maximum(noise, np.finfo(float).tiny)


def estimate_extra_variance(
    data: MultiPositionData,
    state: MultiPositionState,
    lines: MultiPositionLinearization,
    arrow: ArrowSolution,
    whitening: Whitening,
    *,
    free: Booleans,
    robust: bool,
) -> ExtraVariance:
    """Return the extra variances at which the residuals' squares are what they should be.

    Parameters
    ----------
    data, state : the problem and where it stands
    lines : residuals at the solution
    arrow, whitening, free : the solution's covariance, and the weights and parameters it was found with
    robust : take medians for means, so that outliers do not count
    """
    s, _, c_g, _, _ = state.matrices
    turns = rotation_variance(data, state)
    modes = (
        _modes(lines.accelerometer, data.accelerometer_variance, s, 0.0),
        _modes(lines.gyroscope, data.gyroscope_variance, invert_matrix(c_g), data.earth_rate_variance),
        (lines.rotation**2 / turns[:, None], 1 / np.stack([turns, turns], axis=1)),
    )
    redundancy = residual_freedom(lines, arrow, whitening, free)
    kept = (whitening.accelerometer[:, 0, 0] > 0, whitening.gyroscope[:, 0, 0] > 0, whitening.rotation > 0)
    matching = _robust_variance if robust else _matching_variance
    found = [
        matching(squares[k], gains[k], float(np.sum(dof[k])))
        for (squares, gains), dof, k in zip(modes, redundancy, kept, strict=True)
    ]
    return ExtraVariance(accelerometer=found[0], gyroscope=found[1], rotation=found[2])


def _inverse_root(white: Floats, extra: Floats) -> Floats:
    """Return inverse Cholesky factors (n, 3, 3) of diag(white_k) + extra."""
    covariance = extra + white[:, :, None] * np.eye(3)
    return invert_matrix(np.linalg.cholesky(covariance).astype(np.float64))


def _modes(residual: Floats, white: Floats, root: Floats, floor: float) -> tuple[Floats, Floats]:
    """Return squares and gains (n, 3) with r' inv(V + v root root') r = sum of squares / (1 + v gains).

    V = diag(white) + floor root root' is what is known of the variance.
    """
    whitener = _inverse_root(white, floor * root @ root.T)
    scaled = whitener @ root
    gains, vectors = np.linalg.eigh(scaled @ np.swapaxes(scaled, 1, 2))
    plain = np.einsum("kij,kj->ki", whitener, residual)
    return np.einsum("kij,ki->kj", vectors, plain) ** 2, np.maximum(gains, 0.0)


def interval_rows(
    name: str, lines: MultiPositionLinearization, arrow: ArrowSolution, whitening: Whitening, free: Booleans
) -> tuple[Floats, Floats]:
    """Return the whitened rows A of a group at rest, and their gain P A' with the covariance P of what they touch.

    Parameters
    ----------
    name : "accelerometer" or "gyroscope"

    Returns
    -------
    (n, 3, 2 + p) rows by the interval's direction and the p free parameters, and (n, 2 + p, 3) gain
    """
    whitener = getattr(whitening, name)
    by_u, by_theta = whitener @ getattr(lines, f"{name}_u"), whitener @ getattr(lines, f"{name}_theta")[..., free]
    u, theta = np.swapaxes(by_u, 1, 2), np.swapaxes(by_theta, 1, 2)
    cross = arrow.cross_covariance
    gain = np.concatenate(
        [
            arrow.state_covariance @ u + cross @ theta,
            np.swapaxes(cross, 1, 2) @ u + np.swapaxes(by_theta @ arrow.corner_covariance, 1, 2),
        ],
        axis=1,
    )
    return np.concatenate([by_u, by_theta], axis=2), gain


def rotation_rows(
    lines: MultiPositionLinearization, arrow: ArrowSolution, whitening: Whitening, free: Booleans
) -> tuple[Floats, Floats]:
    """Return the whitened rows A of the rotations, (n - 1, 2, 4 + p), and their gain P A', (n - 1, 4 + p, 2)."""
    weight = whitening.rotation[:, None, None]
    first, theta_rows = weight * lines.rotation_u, weight * lines.rotation_theta[..., free]
    second = weight * np.eye(2)
    u, v, theta = (np.swapaxes(rows, 1, 2) for rows in (first, second, theta_rows))
    own, following, cross = arrow.state_covariance, arrow.next_covariance, arrow.cross_covariance
    gain = np.concatenate(
        [
            own[:-1] @ u + following @ v + cross[:-1] @ theta,
            np.swapaxes(following, 1, 2) @ u + own[1:] @ v + cross[1:] @ theta,
            np.swapaxes(cross[:-1], 1, 2) @ u
            + np.swapaxes(cross[1:], 1, 2) @ v
            + np.swapaxes(theta_rows @ arrow.corner_covariance, 1, 2),
        ],
        axis=1,
    )
    return np.concatenate([first, second, theta_rows], axis=2), gain


def residual_freedom(
    lines: MultiPositionLinearization, arrow: ArrowSolution, whitening: Whitening, free: Booleans
) -> tuple[Floats, Floats, Floats]:
    """Return trace(I - H) of each interval's accelerometer and gyroscope residuals and of each rotation's."""
    groups = (
        interval_rows("accelerometer", lines, arrow, whitening, free),
        interval_rows("gyroscope", lines, arrow, whitening, free),
        rotation_rows(lines, arrow, whitening, free),
    )
    traces = [np.einsum("kij,kji->k", rows, gain) for rows, gain in groups]
    return 3.0 - traces[0], 3.0 - traces[1], 2.0 - traces[2]


def _robust_variance(squares: Floats, gains: Floats, dof: float) -> float:
    """Return one extra variance from the median square, against the median of chi-square with as many degrees."""
    if dof < 1:
        return 0.0
    degrees = dof / len(squares)
    expected = degrees * max(1 - 2 / (9 * degrees), 0.1) ** 3  # Wilson and Hilferty
    excess = float(median_of(np.sum(squares, axis=1))) / expected - 1
    return max(excess, 0.0) / float(median_of(gains))


def _matching_variance(squares: Floats, gains: Floats, dof: float) -> float:
    """Return the extra variance v at which the sum of squares / (1 + v gains) is its expectation, dof.

    Nothing is added unless the excess over the noise at rest is significant (three sigma of chi-square), so that
    recordings which the noise explains keep its exactly known level.
    """
    if dof < 1 or np.sum(squares) <= dof + 3 * np.sqrt(2 * dof):
        return 0.0
    variance = 0.0
    for _ in range(50):  # Newton from below; the sum is convex and falling, so that no step goes too far
        shrink = 1 / (1 + variance * gains)
        step = (float(np.sum(squares * shrink)) - dof) / float(np.sum(squares * gains * shrink**2))
        variance += step
        if step < 1e-3 * variance:
            break
    return variance


# ---- at rest ----

_PIECE_S = 0.05
_PIECES = 5
"""The rule: blocks of five pieces, a quarter of a second."""
_LONGER, _SHORTER = (10, 20, 40), (2, 1)
_FEWEST_DIFFERENCES = 20


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


# ---- of rounding ----

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
