"""Functions of time that a bias follows: segments, the exponential of a sensor that warms up, its temperature, drift.

A segment is a run of static intervals with a bias of its own: before and after a power cycle. The bias of segment j is
b + c_j, and c = 0 in the last one, so that b is its bias.

A bias that wanders, as when a cheap sensor warms up, is its mean plus hat functions of time, whose values at the knots
follow a random walk. Whether it wanders, and how fast, is read from the residuals at rest.

A course of the temperature is told from the rests alone, where a session changes attitudes or places.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from statistics import NormalDist

import numpy as np

from ...frozen import value_class
from ...geometry.rotations import invert_matrix
from ...options.requirements import USUAL_SLOPE
from ...recording import Floats, Integers
from ...results.result import Booleans
from .bias_changes import RestMeans, functions_of_time, gyroscope_changes, shares_before
from .model import PARAMETERS, BiasFunctions, MultiPositionData

_WEAK = {"accelerometer": 0.3, "gyroscope": 1.0}
"""Sigma of a step beforehand, scaled units: as of the biases themselves."""
_WEAK_K, WEAK_LAG_S = 10.0, 100.0
"""Change of the temperature that is as weakly known to move a bias [K], and lag of the thermometer [s]."""
LAG_LEFT_S = 2.0
"""Of a thermometer's lag that was undone, or is too small to be told [s]."""
BENDS_K = 50.0
"""Chips are made for some 125 K, over which their data sheets draw such curves as bend."""

_MOST_KNOTS = 30
_INTERVALS_PER_KNOT = 1.5
_SIGMA = 1.3
_CHANCE = 0.005  # that an accelerometer which stays is said to drift
_FEWEST_FOR_DRIFT = 18
_STEADY = 2.5  # sigmas of a straight line in time that is no chance
_FARTHEST = 60  # intervals between two that are compared
_LEAST_VARIANCE = 1e-14
_NODES = (  # and weights, by Gauss and Legendre, of the quadrature over a static interval
    (-0.9491079123427586, 0.12948496616886973),
    (-0.7415311855993945, 0.27970539148927687),
    (-0.4058451513773972, 0.3818300505051187),
    (0.0, 0.4179591836734693),
    (0.4058451513773972, 0.3818300505051187),
    (0.7415311855993945, 0.27970539148927687),
    (0.9491079123427586, 0.12948496616886973),
)
_DRIFT_SIGMA = 0.1  # of what gravity shows: the accelerometer's bias over the recording
_ZERO_MEAN_WEIGHT = 1e6  # of the walk's own precision: the mean over time belongs to the bias
FEWEST_FOR_COURSE = 16
"""Means that tell a course of the temperature."""


def with_bias_steps(
    data: MultiPositionData, *, gyroscope: Sequence[float] = (), accelerometer: Sequence[float] = ()
) -> MultiPositionData:
    """Return the data with a bias of its own before each step; rotations across a step are unlinked.

    Parameters
    ----------
    data : of n static intervals
    gyroscope, accelerometer : places, ascending, at which each bias stepped; see `BiasChanges.steps`
    """
    linked = data.linked.copy()
    across = [int(place) - 1 for place in (*gyroscope, *accelerometer) if float(place).is_integer()]
    linked[across] = False
    data = replace(data, linked=linked)
    if gyroscope:
        steps = step_functions(np.array(gyroscope), len(data.interval_s), "gyroscope")
        data = replace(data, gyroscope_functions=data.of_gyroscope.beside(steps))
    if accelerometer:
        steps = step_functions(np.array(accelerometer), len(data.interval_s), "accelerometer")
        data = replace(data, accelerometer_functions=data.of_accelerometer.beside(steps))
    return data


def step_functions(places: Floats, n: int, triad: str) -> BiasFunctions:
    """Return one function for each segment but the last, whose bias is that of the model."""
    in_motion = np.arange(1, n)[:, None] < places
    return BiasFunctions(
        at_rest=np.diff(shares_before(places, n), axis=1, prepend=0.0),
        in_motion=np.diff(in_motion.astype(np.float64), axis=1, prepend=0.0),
        kind=("step",) * len(places),
        sigma=np.full((len(places), 3), _WEAK[triad]),
    )


def without_rates(data: MultiPositionData, intervals: Sequence[int]) -> MultiPositionData:
    """Return the data with a free rate in some static intervals: their means say nothing of the gyroscope's bias."""
    if not len(intervals):
        return data
    at_rest = np.eye(len(data.interval_s))[:, list(intervals)]
    free = BiasFunctions(
        at_rest=at_rest,
        in_motion=np.zeros((len(data.rotation_s), len(intervals))),
        kind=("single",) * len(intervals),
        sigma=np.full((len(intervals), 3), _WEAK["gyroscope"]),
    )
    return replace(data, gyroscope_functions=data.of_gyroscope.beside(free))


def with_warm_up(
    data: MultiPositionData, *, gyroscope_s: float = 0.0, accelerometer_s: float = 0.0
) -> MultiPositionData:
    """Return the data with an exponential in time, of mean zero over the recording, in the biases.

    Parameters
    ----------
    gyroscope_s, accelerometer_s : time constants [s]; 0 where a bias does not follow one
    """
    if gyroscope_s:
        function = decay_functions(data, gyroscope_s, "gyroscope")
        data = replace(data, gyroscope_functions=data.of_gyroscope.beside(function))
    if accelerometer_s:
        function = decay_functions(data, accelerometer_s, "accelerometer")
        data = replace(data, accelerometer_functions=data.of_accelerometer.beside(function))
    return data


def decay_functions(data: MultiPositionData, time_constant_s: float, triad: str) -> BiasFunctions:
    """Return an exponential in time, of mean zero over the recording."""
    start, stop = data.span_s
    mean = time_constant_s / (stop - start) * -np.expm1(-(stop - start) / time_constant_s)

    def decay(t_s: Floats) -> Floats:
        return (np.exp(-(t_s - start) / time_constant_s) - mean)[:, None]

    return BiasFunctions(
        at_rest=mean_at_rest(data, decay),
        in_motion=decay(data.rotation_s),
        kind=("warm-up",),
        sigma=np.full((1, 3), _WEAK[triad]),
    )


def with_temperature(
    data: MultiPositionData, sensitivities: tuple[Floats, Floats], *, gyroscope: bool, accelerometer: bool
) -> MultiPositionData:
    """Return the data with biases that follow powers of the temperature T, which the data tell at rest and in motion.

    A thermometer that reads x and follows with a lag has T = x + lag x': the rate x' takes up what the lag leaves. Each
    higher power is expected to be worth as much as a usual slope is where the temperature differs by `BENDS_K`.

    Parameters
    ----------
    sensitivities : (3,) of gyroscope and accelerometer, what one rad/s and one m/s^2 read [scaled units]
    """
    if data.degc is None:
        return data
    at_rest, in_motion = data.degc
    follows = {"gyroscope": gyroscope, "accelerometer": accelerometer}
    for (triad, slope), sensitivity in zip(USUAL_SLOPE.items(), sensitivities, strict=True):
        if follows[triad]:
            kind = ("temperature", "warming", *["curve"] * (at_rest.shape[1] - 2))  # the last: both together
            weak = _WEAK[triad] / _WEAK_K * np.array([[1.0] * 3, [WEAK_LAG_S] * 3])
            curves = [slope * sensitivity / BENDS_K**power for power in range(1, len(kind) - 2)]
            sigma = np.concatenate([weak, np.reshape(curves, (-1, 3)), [2 * LAG_LEFT_S * curves[0]]])
            function = BiasFunctions(at_rest=at_rest, in_motion=in_motion, kind=kind, sigma=sigma)
            data = replace(data, **{f"{triad}_functions": getattr(data, f"of_{triad}").beside(function)})
    return data


def temperature_columns(data: MultiPositionData) -> dict[str, Integers]:
    """Return where the coefficients of the temperature, its rate and its higher powers stand, (k, 3) of each triad."""
    found: dict[str, Integers] = {}
    first = PARAMETERS
    for triad, functions in (("gyroscope", data.of_gyroscope), ("accelerometer", data.of_accelerometer)):
        if len(at := np.flatnonzero(functions.of_kind("temperature", "warming", "curve"))):
            found[triad] = first + 3 * at[:, None] + np.arange(3)
        first += 3 * len(functions.kind)
    return found


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


def with_trend(t_s: Floats, measured: Floats, residual: Floats, u: Floats, used: Booleans) -> Floats:
    """Return residuals (n, 3) with the straight line in time that the g-sensitivity may have taken for itself.

    Where the order of attitudes resembles time, a steady drift looks like g-sensitivity and leaves nothing behind that
    wanders. Axes on which a straight line beside it stands out get back what it explains.

    Parameters
    ----------
    t_s : (n,) middle of the static intervals [s]
    measured, residual : (n, 3) of the gyroscope at rest [unit]
    u : (n, 3) directions of gravity
    used : (n,) bool
    """
    time = (t_s - t_s[used].mean()) / max(float(np.ptp(t_s[used])), 1e-9)
    design = np.column_stack([np.ones(len(u)), u, time])
    if used.sum() < 12:
        return residual
    found, _, rank, _ = np.linalg.lstsq(design[used], measured[used], rcond=None)
    if rank < design.shape[1]:
        return residual
    left = measured - design @ found
    variance = np.sum(left[used] ** 2, axis=0) / (used.sum() - design.shape[1])
    sigma = np.sqrt(variance * np.linalg.inv(design[used].T @ design[used])[-1, -1])
    steady = np.abs(found[-1]) > _STEADY * sigma
    return np.where(steady, left + time[:, None] * found[-1], residual)


def without_functions(data: MultiPositionData, residual: Floats) -> Floats:
    """Return the gyroscope's residuals at rest (n, 3) without what its functions of time explain of them."""
    weight = 1 / np.sqrt(data.gyroscope_variance)
    design = np.column_stack([np.ones(len(residual)), data.drift[0]])
    left = np.empty_like(residual)
    for axis in range(3):
        w = weight[:, axis]
        found = np.linalg.lstsq(design * w[:, None], residual[:, axis] * w, rcond=1e-9)[0]
        left[:, axis] = residual[:, axis] - design @ found
    return left


def accelerometer_drifts(t_s: Floats, measured: Floats, sensitivity: Floats, bias: Floats, used: Booleans) -> bool:
    """Return whether the accelerometer's bias drifts steadily, by the magnitude of gravity in its attitudes.

    An F test must show it, and attitudes that are left out must be predicted better with it.

    Parameters
    ----------
    t_s : (n,) middle of the static intervals [s]
    measured : (n, 3) means [unit]
    sensitivity, bias : (3, 3) [unit/g], (3,) [unit], near the best
    used : (n,) bool
    """
    n = int(used.sum())
    if n < _FEWEST_FOR_DRIFT:
        return False
    correction = invert_matrix(sensitivity)
    force = (measured[used] - bias) @ correction.T
    length = np.linalg.norm(force, axis=1)
    u = force / length[:, None]
    pull = u @ correction
    time = _unit_time(t_s[used])[:, None]
    constant = np.concatenate([(pull[:, :, None] * u[:, None, :])[:, *np.tril_indices(3)], pull], axis=1)
    still, left_out = _remaining(constant, length - 1)
    moving, moving_left_out = _remaining(np.concatenate([constant, time * pull], axis=1), length - 1)
    freedom = n - 12
    ratio = (still - moving) / 3 / max(moving / freedom, np.finfo(float).tiny)
    return _chance_of_ratio(ratio, freedom) < _CHANCE and moving_left_out < left_out


def _chance_of_ratio(ratio: float, freedom: int) -> float:
    """Return how often a ratio F(3, freedom) is larger by chance, by Paulson's approximation of the F distribution."""
    one, two = 2 / (9 * 3), 2 / (9 * freedom)
    root = max(ratio, 0.0) ** (1 / 3)
    return 1 - NormalDist().cdf(((1 - two) * root - (1 - one)) / float(np.sqrt(two * root**2 + one)))


def _remaining(design: Floats, y: Floats) -> tuple[float, float]:
    """Return the sum of squares that least squares leave, and that of the errors where each row is left out."""
    q, _ = np.linalg.qr(design / np.linalg.norm(design, axis=0))
    residual = y - q @ (q.T @ y)
    kept = np.maximum(1 - np.sum(q**2, axis=1), 1e-3)
    return float(residual @ residual), float(np.sum((residual / kept) ** 2))


def _unit_time(t_s: Floats) -> Floats:
    """Return times from -1/2 to 1/2."""
    return (t_s - 0.5 * (t_s[0] + t_s[-1])) / max(float(t_s[-1] - t_s[0]), 1e-9)


def with_accelerometer_drift(data: MultiPositionData) -> MultiPositionData:
    """Return the data with a straight line in time, of mean zero over the recording, in the accelerometer's bias."""
    start, stop = data.span_s
    middle, length = 0.5 * (start + stop), stop - start
    line = BiasFunctions(
        at_rest=((data.interval_s - middle) / length)[:, None],
        in_motion=((data.rotation_s - middle) / length)[:, None],
        kind=("line",),
        sigma=np.full((1, 3), _DRIFT_SIGMA),
    )
    return replace(data, accelerometer_functions=line.beside(data.of_accelerometer))


def with_drift(data: MultiPositionData) -> MultiPositionData:
    """Return the data with hat functions over the time of the recording in the gyroscope's bias."""
    count = int(np.clip(len(data.interval_s) // _INTERVALS_PER_KNOT, 3, _MOST_KNOTS))
    knots = np.linspace(*data.span_s, count)
    spacing = knots[1] - knots[0]

    def hats(t_s: Floats) -> Floats:
        return np.clip(1 - np.abs(t_s[:, None] - knots) / spacing, 0.0, None)

    walk = BiasFunctions(
        at_rest=mean_at_rest(data, hats),
        in_motion=hats(data.rotation_s),
        kind=("walk",) * count,
        sigma=np.full((count, 3), np.nan),
    )
    return replace(data, gyroscope_functions=walk.beside(data.of_gyroscope))


def mean_at_rest(data: MultiPositionData, function: Callable[[Floats], Floats]) -> Floats:
    """Return means of functions of time over the static intervals, (n, j), by Gauss and Legendre."""
    if data.half_s is None:
        return function(data.interval_s)
    values = [0.5 * weight * function(data.interval_s + node * data.half_s) for node, weight in _NODES]
    return np.asarray(np.sum(values, axis=0), dtype=np.float64)


def walk_precision(data: MultiPositionData, density: Floats) -> Floats:
    """Return the precision (3 j, 3 j) of the knots' values: a random walk with a mean of zero over time."""
    count = int(data.of_gyroscope.of_kind("walk").sum())
    spacing = (data.span_s[1] - data.span_s[0]) / (count - 1)
    difference = np.diff(np.eye(count), axis=0)
    mean = np.full(count, 1 / (count - 1))
    mean[[0, -1]] *= 0.5
    walk = difference.T @ difference + _ZERO_MEAN_WEIGHT * np.outer(mean, mean)
    changes = np.maximum(density * spacing, _LEAST_VARIANCE)  # an axis that never changes keeps a finite weight
    return np.asarray(np.kron(walk, np.diag(1 / changes)), dtype=np.float64)


@value_class
class BiasCourse:
    """What a bias does with the temperature.

    Attributes
    ----------
    slopes : (k, 3) coefficients of its powers, from the first on [unit/K^j]
    covariance : (3 k, 3 k)
    at_parts, variance : (n, 3) bias minus that at the reference, and its variance by what is not known of the course
    at_reference : (3,) variance that this gives the bias at the reference
    """

    slopes: Floats
    covariance: Floats
    at_parts: Floats
    variance: Floats
    at_reference: Floats


def bias_course(
    t_s: Floats, degc: Floats | None, residual: Floats, noise: Floats, *, at_rest: Booleans, force: Floats | None = None
) -> BiasCourse | None:
    """Return how the bias follows the temperature, by the rests; None where they do not tell it from drift in time.

    Generalised least squares (Aitken 1936): beside the temperature a decay, where one is likelier than none, what the
    attitude does by the g-sensitivity, and a random walk as what is left shows it.

    Parameters
    ----------
    t_s : (n,) middle of each part [s]
    degc : (n, m) what a bias may follow of the temperature, see `RestMeans`; None where nothing tells it from the time
    residual, noise : (n, 3) measured minus bias, and the variance of each; count at rest alone
    at_rest : (n,) bool
    force : (n, 3) specific force of each part; None where it is not known
    """
    n = int(at_rest.sum())
    if degc is None or n < FEWEST_FOR_COURSE:
        return None
    felt = np.zeros_like(residual) if force is None else force
    rests = RestMeans(
        rest=np.arange(n), t_s=t_s[at_rest], half_s=np.zeros(n), means=residual[at_rest], variance=noise[at_rest],
        degc=degc[at_rest],
    )  # fmt: skip
    changes = gyroscope_changes(rests, felt[at_rest] / max(float(np.abs(felt).max()), 1e-300))
    if not changes.temperature or changes.steps:
        return None
    powers = degc.shape[1]
    course = functions_of_time(changes, t_s, np.zeros_like(t_s), degc)
    course[:, :-powers] -= course[at_rest, :-powers].mean(axis=0)
    design = np.column_stack([course, np.ones(len(t_s)), felt])
    design = design[:, np.any(design != 0, axis=0)]
    kept = course.shape[1] - powers + np.array([0, *range(2, powers - 2)])
    slopes, covariance = np.empty((len(kept), 3)), np.zeros((3 * len(kept), 3 * len(kept)))
    at_parts, variance, at_reference = np.empty_like(residual), np.empty_like(residual), np.empty(3)
    left, x, told = residual.copy(), design[at_rest], np.arange(course.shape[1])
    apart = np.minimum(*np.meshgrid(t_s[at_rest] - t_s[at_rest][0], t_s[at_rest] - t_s[at_rest][0]))
    for axis in range(3):
        left[:, axis] -= design @ np.linalg.lstsq(x, residual[at_rest, axis], rcond=1e-12)[0]
    walks = walk_density(t_s, left, at_rest)
    for axis in range(3):
        errors = np.diag(noise[at_rest, axis]) + (0.0 if walks is None else walks[axis]) * apart
        root = np.linalg.inv(np.linalg.cholesky(errors))
        size = np.linalg.norm(root @ x, axis=0)
        inverse = np.linalg.pinv(root @ x / size) / size[:, None]
        found = inverse @ root @ residual[at_rest, axis]
        off = root @ (residual[at_rest, axis] - x @ found)
        own = inverse @ inverse.T * max(1.0, float(off @ off) / max(n - x.shape[1], 1))
        slopes[:, axis], covariance[axis::3, axis::3] = found[kept], own[np.ix_(kept, kept)]
        at_parts[:, axis] = course @ found[told]
        middle = course[at_rest].mean(axis=0)
        variance[:, axis] = np.einsum("ni,ij,nj->n", course - middle, own[np.ix_(told, told)], course - middle)
        at_reference[axis] = middle @ own[np.ix_(told, told)] @ middle
    return BiasCourse(
        slopes=slopes, covariance=covariance, at_parts=at_parts, variance=variance, at_reference=at_reference
    )
