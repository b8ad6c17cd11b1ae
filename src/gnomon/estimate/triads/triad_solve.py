"""Steps of the fit of a triad: minimum at a given noise, robust reweighting, extra variance, outliers.

Between poses in the units of a sensor and the scaled units in which a triad is fitted.

Every axis is centred and divided by its spread, and magnitudes by the largest, so that offsets of 32768 counts and
scales of any size are the same problem.
"""

from dataclasses import replace

import numpy as np

from ...frozen import value_class
from ...recording import Floats
from ...results.result import Booleans
from ...solve.least_squares import levenberg_marquardt
from .triad_problem import (
    B_,
    G_,
    PARAMETERS,
    S_,
    TriadNoiseLevels,
    TriadPoses,
    TriadPrior,
    TriadProblem,
    TriadResiduals,
    noise_at,
    triad_residuals,
)

_UPPER = [1, 2, 5]
_WILD = 10.0  # times the usual distance
_COMMON_SIGMA = 1.0  # of a factor that all magnitudes share and nobody knows
WEAK = 0.3  # sigma of the weak prior: of a scale, of the largest reading, and of that at one g
_REWEIGHTINGS = 10
_SAME_WEIGHT = 0.02
_SETTLINGS = 8
_SAME_VARIANCE = (0.01, 0.03)  # and roughly
_SUSPICIOUS = 1.5  # times sqrt(2 log n) times the median size, which is where the largest of n should be
_GATE_SIGMA = 5.0
_GATE = {1: _GATE_SIGMA**2, 3: 32.0}  # square sum of one and of three residuals, equally improbable
_FEWEST_SHARE = 0.6  # of the poses; where more would have to go, the model does not hold
_MEDIAN_SQUARE = 0.4549  # of chi-square with one degree of freedom
_ROUGH, _FINE = (1e-6, 30), (1e-11, 100)  # relative length of the last step, and most steps
_FEWEST_REDUNDANT = 2.0


@value_class
class TriadScaling:
    """parameters = turn * scaled parameters + shift.

    Attributes
    ----------
    centre, spread : (3,) of the measurements [unit]
    size : of the magnitudes [SI]
    force : of the specific force [m/s^2]
    """

    centre: Floats
    spread: Floats
    size: float
    force: float

    @classmethod
    def of(cls, poses: TriadPoses) -> "TriadScaling":
        """Return the scaling of poses; a few wild ones do not matter."""
        moving = poses.magnitude > 0
        centre, spread = usual_spread(poses.measured[moving if moving.any() else ~moving])
        force = 0.0 if poses.force is None else float(np.median(np.linalg.norm(poses.force, axis=1)))
        return cls(
            centre=centre,
            spread=spread,
            size=float(poses.magnitude.max()) or 1.0,
            force=force or 1.0,
        )

    @property
    def turn(self) -> Floats:
        """(21,) scaled parameters to parameters, but for the shift of the bias."""
        by_axis = np.repeat(self.spread, 3)
        return np.concatenate([by_axis / self.size, self.spread, by_axis / self.force])

    @property
    def shift(self) -> Floats:
        """(21,) the centre, for the bias."""
        shift = np.zeros(PARAMETERS)
        shift[B_] = self.centre
        return shift


def usual_spread(measured: Floats) -> tuple[Floats, Floats]:
    """Return median and typical distance from it, (3,) each, in which wild measurements do not count."""
    centre = np.median(measured, axis=0)
    away = np.abs(measured - centre)
    distance = np.linalg.norm(away, axis=1)
    half, more = np.quantile(distance, [0.5, 0.75])
    usual = half if half > 0.05 * more else more  # most poses may be one attitude, to which the sensor came back
    away = away[distance <= _WILD * usual]
    three_quarters, most = np.quantile(away, [0.75, 0.9], axis=0)
    spread = np.where(three_quarters > 0.05 * most, three_quarters, most)  # an axis may lie level nearly always
    spread = np.where(spread > 0, spread, away.mean(axis=0))
    return centre, np.where(spread > 0, spread, 1.0)


def not_wild(measured: Floats, magnitude: Floats) -> Booleans:
    """Return which measurements lie within ten times the usual distance, (n,); no sensor in its range goes there.

    Poses of zero magnitude are all in one place and do not tell what is usual.
    """
    moving = magnitude > 0
    centre, usual = usual_spread(measured[moving if moving.any() else ~moving])
    return np.asarray((np.abs(measured - centre) <= _WILD * usual).all(axis=1), dtype=np.bool_)


def scaled_problem(
    poses: TriadPoses,
    scaling: TriadScaling,
    prior: TriadPrior | None,
    *,
    g_sensitivity: bool,
    unknown_scale: bool,
) -> TriadProblem:
    """Return the poses in scaled units, with the stated prior; `with_weak_prior` adds the weak one."""
    groups = len(poses.group_sigma)
    level = np.zeros((len(poses), groups + unknown_scale))
    level[np.arange(len(poses)), poses.group] = 1.0
    level[:, groups:] = 1.0
    sigma = np.append(poses.group_sigma, [_COMMON_SIGMA] * unknown_scale)
    known = np.zeros(len(poses), dtype=bool)
    direction = np.zeros_like(poses.measured)
    if poses.direction is not None:
        known = np.isfinite(poses.direction).all(axis=1)
        direction[known] = poses.direction[known]
    free = np.concatenate([_free(prior, bool(known.any()), g_sensitivity=g_sensitivity), sigma > 0])
    errors = np.diag(1 / np.where(sigma > 0, sigma, 1.0))[sigma > 0]
    root, target = np.zeros((0, PARAMETERS)), np.zeros(0)
    if prior is not None:
        root = _root(prior.precision * np.outer(scaling.turn, scaling.turn))
        target = root @ ((prior.mean - scaling.shift) / scaling.turn)
    sides = ((0, 0), (0, len(sigma))), ((0, 0), (PARAMETERS, 0))
    return TriadProblem(
        measured=(poses.measured - scaling.centre) / scaling.spread,
        variance=poses.variance / scaling.spread**2,
        force=np.zeros_like(poses.measured) if poses.force is None else poses.force / scaling.force,
        magnitude=poses.magnitude / scaling.size,
        magnitude_sigma=poses.magnitude_sigma / scaling.size,
        level=level,
        direction=direction,
        direction_sigma=np.where(known, 0.0 if poses.direction_sigma is None else poses.direction_sigma, np.inf),
        free=free,
        prior_root=np.concatenate([np.pad(root, sides[0]), np.pad(errors, sides[1])]),
        prior_target=np.concatenate([target, np.zeros(len(errors))]),
    )


def _free(prior: TriadPrior | None, directions: bool, *, g_sensitivity: bool) -> Booleans:
    """Return which of the 21 parameters are estimated."""
    free = np.ones(PARAMETERS, dtype=bool)
    free[G_] = g_sensitivity
    oriented = prior is not None and bool(np.all(np.diag(prior.precision)[_UPPER] > 0))
    free[_UPPER] = directions or oriented
    return free if prior is None else free & ~prior.fixed


def _root(precision: Floats) -> Floats:
    """Return rows R with R'R = precision, as many as it has rank."""
    size = np.sqrt(np.maximum(np.diag(precision), 0.0))
    size = np.where(size > 0, size, 1.0)
    values, vectors = np.linalg.eigh(precision / np.outer(size, size))
    kept = values > 1e-12
    return (np.sqrt(values[kept])[:, None] * vectors[:, kept].T) * size


def weak_sigma(theta: Floats) -> Floats:
    """Return the sigma (21,) of the weak prior around a start, in scaled units."""
    rows = np.linalg.norm(theta[S_].reshape(3, 3), axis=1)
    return WEAK * np.concatenate([np.repeat(rows, 3), np.maximum(rows, 1.0), np.repeat(np.maximum(rows, 1.0), 3)])


def with_weak_prior(problem: TriadProblem, theta: Floats) -> TriadProblem:
    """Return the problem with a weak prior around a start, which holds what the poses leave open."""
    precision = np.diag(1 / weak_sigma(theta))
    root = np.pad(precision, ((0, 0), (0, problem.level.shape[1])))
    return replace(
        problem,
        prior_root=np.concatenate([problem.prior_root, root]),
        prior_target=np.concatenate([problem.prior_target, precision @ theta[:PARAMETERS]]),
    )


@value_class
class Minimum:
    """Where a fit stands.

    Attributes
    ----------
    theta : (21 + p,)
    noise : at which it was found
    cost : half the sum of squares, prior included
    iterations : steps
    converged : whether the last step was negligible
    """

    theta: Floats
    noise: TriadNoiseLevels
    cost: float
    iterations: int
    converged: bool


@value_class
class Linear:
    """A fit linearised where it stands.

    Attributes
    ----------
    rows : of all poses, also of those not used
    covariance : (f, f) of the free parameters
    leverage : (r,) variance of each row's prediction in units of its noise; for a row that was used its hat value
    redundancy : residuals used less what the parameters take
    """

    rows: TriadResiduals
    covariance: Floats
    leverage: Floats
    redundancy: float


def minimise_from(
    problem: TriadProblem, theta: Floats, noise: TriadNoiseLevels, weight: Floats, *, rough: bool = False
) -> Minimum:
    """Return the minimum from a point, with poses weighted (n,)."""
    free = problem.free

    def residuals(x: Floats) -> tuple[Floats, Floats]:
        """Return weighted residuals (r,) and their derivatives (r, f) by the free parameters."""
        full = theta.copy()
        full[free] = x
        try:
            lines = triad_residuals(problem, full, noise)
        except np.linalg.LinAlgError:  # a step that makes the sensitivity singular is refused
            bad = np.full(shape[0], np.inf)
            return bad, np.zeros(shape)
        root = np.sqrt(weight)[lines.pose]
        prior = problem.prior_root @ full - problem.prior_target
        return (
            np.concatenate([root * lines.residual, prior]),
            np.concatenate([root[:, None] * lines.jacobian, problem.prior_root[:, free]]),
        )

    three = ~problem.length_only
    shape = (len(three) + 2 * int(three.sum()) + len(problem.prior_target), int(free.sum()))
    solution = levenberg_marquardt(residuals, theta[free], *(_ROUGH if rough else _FINE))
    found = theta.copy()
    found[free] = solution.x
    return Minimum(
        theta=found,
        noise=noise,
        cost=solution.cost,
        iterations=solution.iterations,
        converged=solution.converged,
    )


def covariance_at(problem: TriadProblem, theta: Floats, noise: TriadNoiseLevels, used: Booleans) -> Linear:
    """Return covariance and leverages where a fit stands."""
    lines = triad_residuals(problem, theta, noise)
    free = problem.free
    counted = used[lines.pose]
    stacked = np.concatenate([lines.jacobian[counted], problem.prior_root[:, free]])
    size = np.linalg.norm(stacked, axis=0)
    size = np.where(size > 0, size, 1.0)
    inverse = np.linalg.pinv(np.linalg.qr(stacked / size, mode="r")) / size[:, None]
    share = lines.jacobian @ inverse
    leverage = np.einsum("ij,ij->i", share, share)
    return Linear(
        rows=lines,
        covariance=inverse @ inverse.T,
        leverage=leverage,
        redundancy=float(counted.sum() - leverage[counted].sum()),
    )


def irls(problem: TriadProblem, theta: Floats, extra: float) -> Minimum:
    """Return a fit in which poses that stand out count by their size, not by its square.

    Several bad poses bend an ordinary fit until none of them stands out; they cannot bend this one as far.
    """
    noise = noise_at(problem, theta, extra)
    weight = _weights(problem, theta, noise)
    point = minimise_from(problem, theta, noise, weight, rough=True)
    iterations = point.iterations
    for _ in range(_REWEIGHTINGS):
        old, weight = weight, _weights(problem, point.theta, noise)
        if np.abs(weight - old).max() < _SAME_WEIGHT:
            break
        point = minimise_from(problem, point.theta, noise, weight, rough=True)
        iterations += point.iterations
    return replace(point, iterations=iterations)


def _weights(problem: TriadProblem, theta: Floats, noise: TriadNoiseLevels) -> Floats:
    size = pose_sizes(problem, triad_residuals(problem, theta, noise))
    usual = float(np.median(size))
    if usual <= 0 or size.max() <= _SUSPICIOUS * np.sqrt(2 * np.log(len(size))) * usual:
        return np.ones(len(size))
    return 1 / np.maximum(size / usual, 1.0)


def pose_sizes(problem: TriadProblem, lines: TriadResiduals, shrink: Floats | None = None) -> Floats:
    """Return the root mean square of each pose's residuals (n,), each first divided by the root of `shrink` (r,)."""
    squares = lines.residual**2 if shrink is None else lines.residual**2 / shrink
    total = np.bincount(lines.pose, squares, minlength=len(problem.measured))
    return np.sqrt(total / equation_counts(problem))


def equation_counts(problem: TriadProblem) -> np.ndarray:
    """Return how many residuals each pose has, (n,)."""
    return np.where(problem.length_only, 1, 3)


def extra_variance(problem: TriadProblem, theta: Floats, used: Booleans, given: float, *, robust: bool) -> float:
    """Return the variance per component beyond the noise at rest with which the residuals are as large as they should.

    Parameters
    ----------
    given : extra variance with which theta was found
    robust : take the median for the mean, so that outliers do not count
    """
    linear = covariance_at(problem, theta, noise_at(problem, theta, given), used)
    plain = triad_residuals(problem, theta, noise_at(problem, theta, 0.0))
    counted = used[plain.pose]
    squares, variance = (plain.residual * plain.sigma)[counted] ** 2, plain.sigma[counted] ** 2
    if linear.redundancy < _FEWEST_REDUNDANT:
        return 0.0
    if robust:
        kept = np.maximum(1 - linear.leverage[counted], 0.05)
        excess = float(np.median(squares / variance / kept)) / _MEDIAN_SQUARE - 1
        return max(excess, 0.0) * float(np.median(variance))
    return _matching_variance(squares, variance, linear.redundancy)


def _matching_variance(squares: Floats, variance: Floats, redundancy: float) -> float:
    """Return v with sum of squares / (variance + v) equal to the redundancy.

    Nothing is added unless the excess over the noise at rest is significant (three sigma of chi-square), so that poses
    which the noise explains keep its exactly known level.
    """
    total = float(np.sum(squares / variance))
    if total <= redundancy + 3 * np.sqrt(2 * redundancy):
        return 0.0
    extra = 0.0
    for _ in range(100):  # Newton on the inverse of the sum, which is concave and rising: no step goes too far
        step = (total / redundancy - 1) * total / float(np.sum(squares / (variance + extra) ** 2))
        extra += step
        total = float(np.sum(squares / (variance + extra)))
        if step < 1e-6 * extra:
            break
    return extra


def fit_extra_variance(
    problem: TriadProblem, theta: Floats, used: Booleans, extra: float, *, rough: bool
) -> tuple[Minimum, float]:
    """Return minimum and extra variance that belong together."""
    weight = used.astype(np.float64)
    point = minimise_from(problem, theta, noise_at(problem, theta, extra), weight, rough=True)
    if not rough:
        point = minimise_from(problem, point.theta, noise_at(problem, point.theta, extra), weight)
    iterations = point.iterations
    for _ in range(_SETTLINGS):
        old, extra = extra, extra_variance(problem, point.theta, used, extra, robust=False)
        if abs(extra - old) <= _SAME_VARIANCE[rough] * max(extra, old):
            return replace(point, iterations=iterations), old
        point = minimise_from(problem, point.theta, noise_at(problem, point.theta, extra), weight, rough=rough)
        iterations += point.iterations
    return replace(point, iterations=iterations), extra


def gate_outliers(problem: TriadProblem, theta: Floats, used: Booleans, extra: float, *, known: bool) -> Booleans:
    """Return which poses stay (n,): those that the others predict within five sigma.

    Parameters
    ----------
    used : those of which theta was found
    known : whether the noise is known, not estimated from these residuals (then few of them prove little)
    """
    from scipy.special import ndtr, stdtrit

    linear = covariance_at(problem, theta, noise_at(problem, theta, extra), used)
    counted = used[linear.rows.pose]
    shrink = np.where(counted, np.maximum(1 - linear.leverage, 1e-3), 1 + linear.leverage)
    size = pose_sizes(problem, linear.rows, shrink) ** 2 * equation_counts(problem)
    limit = np.where(problem.length_only, _GATE[1], _GATE[3])
    if not known:
        limit = limit * (stdtrit(max(linear.redundancy, 1.0), ndtr(-_GATE_SIGMA)) / _GATE_SIGMA) ** 2
    kept = size < limit
    enough = equation_counts(problem)[kept].sum() > problem.free.sum()
    return kept if enough and kept.mean() >= _FEWEST_SHARE else np.ones_like(kept)
