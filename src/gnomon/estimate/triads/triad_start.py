"""Where the fit of a triad starts: closed forms from the poses alone, tried in order of their accuracy.

Starts that several bad poses do not reach: ellipsoids through few poses, judged by how well most of all agree.
"""

from collections.abc import Callable, Iterator

import numpy as np

from ...errors import InitialisationError
from ...frozen import value_class
from ...geometry.rotations import invert_matrix, nearest_rotation
from ...recording import Floats
from ...results.result import Booleans
from .triad_problem import B_, G_, PARAMETERS, S_, TriadPrior, TriadProblem, known_magnitudes, noise_at, true_vectors
from .triad_solve import Minimum, TriadScaling, equation_counts, irls, minimise_from, not_wild, with_weak_prior

_LEVEL_STEPS = 20
_LARGEST_RATIO = 30.0  # between the axes of an ellipsoid in scaled units; beyond, the fit has followed the noise
_SUBSETS = 150  # with every fourth pose bad, some ten of them have none
_POSES = 10  # in a subset
_KEPT = 3
_CONCENTRATIONS = 10
_FEWEST_SHARE = 0.6


@value_class
class Ellipsoid:
    """Measured vectors of magnitude w lie where |C (m - b)| = w; C is lower triangular, (3, 3)."""

    correction: Floats
    bias: Floats


def general_ellipsoid(m: Floats, w: Floats) -> Ellipsoid | None:
    """Return the quadric of least squares (Angrisano, Eq. 10, without a start); None if it is no ellipsoid.

    |C (m - b)|^2 = w^2 is linear in C'C and C'C b but for the level b'C'C b, which a few repetitions find.
    """
    if len(m) < 9:
        return None
    x, y, z = m.T
    design = np.stack([x * x, y * y, z * z, 2 * x * y, 2 * x * z, 2 * y * z, 2 * x, 2 * y, 2 * z], axis=1)
    ones, _, rank, _ = np.linalg.lstsq(design, np.ones(len(m)), rcond=1e-12)
    if rank < 9:
        return None
    squares = np.linalg.lstsq(design, w**2, rcond=1e-12)[0]
    level, quadric, offset = 0.0, np.eye(3), np.zeros(3)
    same = np.ptp(w) <= 1e-9 * w.max()
    for _ in range(_LEVEL_STEPS):
        a = ones if same else squares - level * ones
        quadric = np.array([[a[0], a[3], a[4]], [a[3], a[1], a[5]], [a[4], a[5], a[2]]])
        if np.linalg.eigvalsh(quadric).min() <= 0:
            return None
        offset = -invert_matrix(quadric) @ a[6:]
        old, level = level, float(offset @ quadric @ offset)
        if same or abs(level - old) < 1e-9 * w.max() ** 2:
            break
    if same:
        quadric = quadric * (w.max() ** 2 / (1 + level))
    return from_quadric(quadric, offset)


def constrained_ellipsoid(m: Floats, w: Floats) -> Ellipsoid | None:
    """Return the quadric of least squares among those that are ellipsoids for certain (Li and Griffiths 2004)."""
    size = np.median(w)
    x, y, z = (m * (size / w)[:, None]).T if np.ptp(w) else m.T
    one = np.ones(len(m))
    design = np.stack([x * x, y * y, z * z, 2 * y * z, 2 * x * z, 2 * x * y, 2 * x, 2 * y, 2 * z, one], axis=1)
    scatter = design.T @ design
    constraint = np.zeros((6, 6))
    constraint[:3, :3] = 1.0 - 2.0 * np.eye(3)
    constraint[3:, 3:] = -4.0 * np.eye(3)
    s11, s12, s22 = scatter[:6, :6], scatter[:6, 6:], scatter[6:, 6:]
    back = np.linalg.pinv(s22, hermitian=True) @ s12.T
    values, vectors = np.linalg.eig(np.linalg.solve(constraint, s11 - s12 @ back))
    v = np.real(vectors[:, int(np.argmax(np.real(values)))])
    v = np.concatenate([v, -back @ v])
    quadric = np.array([[v[0], v[5], v[4]], [v[5], v[1], v[3]], [v[4], v[3], v[2]]])
    quadric, linear, level = (quadric, v[6:9], v[9]) if np.trace(quadric) > 0 else (-quadric, -v[6:9], -v[9])
    if np.linalg.eigvalsh(quadric).min() <= 0:
        return None
    offset = -invert_matrix(quadric) @ linear
    radius = float(offset @ quadric @ offset) - level
    return None if radius <= 0 else from_quadric(quadric * (size**2 / radius), offset)


def fit_sphere(m: Floats, w: Floats) -> Ellipsoid | None:
    """Return the sphere through the points: all scales alike, no misalignment."""
    design = np.column_stack([2 * m, w**2])  # |m|^2 = 2 m.b - |b|^2 + w^2 s^2; one magnitude leaves |b|^2 in the last
    same = np.ptp(w) <= 1e-9 * w.max()
    if not same:
        design = np.column_stack([design, np.ones(len(m))])
    solution = np.linalg.lstsq(design, np.sum(m * m, axis=1), rcond=1e-12)[0]
    bias, square = solution[:3], solution[3]
    if same:
        square = square + bias @ bias / w.max() ** 2
    return None if square <= 0 else Ellipsoid(correction=np.eye(3) / np.sqrt(square), bias=bias)


def from_quadric(quadric: Floats, bias: Floats, largest_ratio: float = _LARGEST_RATIO) -> Ellipsoid | None:
    """Return the ellipsoid (m - bias)' quadric (m - bias) = w^2; None if it is none, or longer than it can be."""
    values = np.linalg.eigvalsh(quadric)
    if not values.min() > 0 or values.max() > largest_ratio**2 * values.min():
        return None
    upper = np.linalg.cholesky(quadric[::-1, ::-1]).T.astype(np.float64)
    return Ellipsoid(correction=upper[::-1, ::-1], bias=bias)  # quadric = C'C with lower triangular C


def near_ellipsoid(m: Floats, w: Floats, sensitivity: Floats, bias: Floats) -> Ellipsoid | None:
    """Return the ellipsoid of a sensor that is known, in the size of measurements (n, 3) of magnitudes w (n,).

    None where they do not lie near it.
    """
    correction = invert_matrix(sensitivity)
    found = from_quadric(correction.T @ correction, bias)
    if found is None:
        return None
    length = np.linalg.norm((m - bias) @ correction.T, axis=1) / w
    size = float(np.median(length))
    if not float(np.median(np.abs(length - size))) < _GOOD * size:
        return None
    return Ellipsoid(correction=found.correction / size, bias=bias)


def start_at(shape: Ellipsoid, scaling: TriadScaling, size: int) -> Floats:
    """Return the scaled parameters (21 + p,) of an ellipsoid, in the triad's own frame."""
    theta, parameters = np.zeros(size), np.zeros(PARAMETERS)
    parameters[S_], parameters[B_] = invert_matrix(shape.correction).ravel(), shape.bias
    theta[:PARAMETERS] = (parameters - scaling.shift) / scaling.turn
    return theta


def most_errors(problem: TriadProblem, theta: Floats) -> float:
    """Return the mean of | |x| - w | over the better part of the poses, in which bad ones should not be.

    It is in the unit of the measurements: an ellipsoid so large that all poses are on one patch fits well in its own.
    """
    error = _errors(problem, theta)
    size = float(np.abs(np.linalg.det(theta[S_].reshape(3, 3)))) ** (1 / 3)
    return size * float(np.mean(error[_better_part(problem, error)]))


def concentrate_fit(problem: TriadProblem, theta: Floats, extra: float) -> Minimum:
    """Return a fit to the better part of the poses, which are chosen again until they stay the same."""
    kept = _better_part(problem, _errors(problem, theta))
    point = minimise_from(problem, theta, noise_at(problem, theta, extra), kept.astype(np.float64), rough=True)
    for _ in range(_CONCENTRATIONS):
        old, kept = kept, _better_part(problem, _errors(problem, point.theta))
        if np.array_equal(kept, old):
            break
        point = minimise_from(problem, point.theta, point.noise, kept.astype(np.float64), rough=True)
    return point


def _errors(problem: TriadProblem, theta: Floats) -> Floats:
    return np.abs(np.linalg.norm(true_vectors(problem, theta), axis=1) - known_magnitudes(problem, theta))


def _better_part(problem: TriadProblem, error: Floats) -> Booleans:
    half = (len(error) + int(problem.free[:PARAMETERS].sum()) + 1) // 2
    count = min(max(half, int(_FEWEST_SHARE * len(error))), len(error))
    return error <= np.partition(error, count - 1)[count - 1]


def subset_starts(problem: TriadProblem, theta: Floats) -> Iterator[Floats]:
    """Yield the best of many starts through few poses (least trimmed squares, Rousseeuw and Van Driessen 1999).

    Parameters
    ----------
    problem : in scaled units
    theta : (21 + p,) a start by all poses, which gives what a few poses cannot: body frame, g-sensitivity
    """
    moving = np.flatnonzero(problem.magnitude > 0)
    if len(moving) < _POSES + 2:
        return
    rng = np.random.default_rng(0)
    found: list[tuple[float, Floats]] = []
    unbiased = problem.measured - problem.force @ theta[PARAMETERS - 9 : PARAMETERS].reshape(3, 3).T
    for _ in range(_SUBSETS):
        some = rng.choice(moving, _POSES, replace=False)
        centre = unbiased[some].mean(axis=0)
        ellipsoid = general_ellipsoid(unbiased[some] - centre, problem.magnitude[some])
        if ellipsoid is not None:
            trial = theta.copy()
            trial[B_] = ellipsoid.bias + centre
            trial[S_] = _turned(invert_matrix(ellipsoid.correction), theta[S_].reshape(3, 3)).ravel()
            found.append((most_errors(problem, trial), trial))
    found.sort(key=lambda pair: pair[0])
    yield from (trial for _, trial in found[:_KEPT])


def _turned(sensitivity: Floats, like: Floats) -> Floats:
    """Return a sensitivity in the body frame in which another one is."""
    left, _, right = np.linalg.svd(sensitivity.T @ like)
    turned = np.asarray(sensitivity @ left @ right, dtype=np.float64)
    return np.tril(turned) if np.array_equal(like, np.tril(like)) else turned


START_VARIANCE = 1e-4
"""Of a component, scaled: a start is good to one percent or so."""

ENOUGH = 2000
"""Poses for a start."""

_GOOD = 0.03  # of the magnitude that a good start leaves
_EXPLAINED = 3.0  # times the noise at rest; a start that leaves more may have followed bad poses
_NOTHING_BUT_NOISE = 5.0
_FLAT = 0.02
_DIAGONAL = [0, 4, 8]


def check_determined(problem: TriadProblem, prior: TriadPrior | None) -> None:
    """Refuse poses that determine no triad whatever their values, and say what is missing.

    Raises
    ------
    InitialisationError
        If all magnitudes are zero, equations are fewer than unknowns, or all measurements are in a plane or a point.
    """
    if prior is not None and np.any(prior.precision):
        return
    moving = problem.magnitude > 0
    if not moving.any():
        raise InitialisationError(
            "the magnitude is zero in every pose, which shows the bias and no scale. Add poses at a known rate."
        )
    unknowns = int(problem.free[:PARAMETERS].sum())
    if equation_counts(problem).sum() < unknowns:
        raise InitialisationError(
            f"{len(moving)} poses give {equation_counts(problem).sum()} equations for {unknowns} unknowns. "
            f"Record at least {unknowns} well spread attitudes, better 18."
        )
    m = problem.measured[moving]
    m = m[not_wild(m, np.ones(len(m)))]
    away = m - (m.mean(axis=0) if moving.all() else np.median(problem.measured[~moving], axis=0))
    values, vectors = np.linalg.eigh(away.T @ away / len(away))
    noise = float(np.sqrt(np.median(problem.variance[moving].max(axis=1))))
    axis = "xyz"[int(np.argmax(np.abs(vectors[:, 0])))]
    if np.sqrt(values[-1]) <= _NOTHING_BUT_NOISE * noise:
        raise InitialisationError(
            "all poses show the same measurement within its noise: one orientation only. Turn the sensor between "
            "recordings, so that every axis points up once and down once, and some directions between."
        )
    if np.sqrt(values[0]) <= max(_FLAT * np.sqrt(values[-1]), noise):
        raise InitialisationError(
            f"the measurements of all poses lie in one plane; the direction missing is mostly axis {axis}. "
            f"Add poses in which axis {axis} points along what is measured, and against it."
        )


def first_fit(
    problem: TriadProblem, scaling: TriadScaling, prior: TriadPrior | None, start: Floats | None, *, robust: bool
) -> Minimum:
    """Return a fit good to a few percent, by a sample of the poses where there are many.

    Raises
    ------
    InitialisationError
        If no start leads anywhere.
    """
    kept = not_wild(problem.measured, problem.magnitude) if robust else np.ones(len(problem.measured), dtype=bool)
    kept &= np.cumsum(kept) % max(1, kept.sum() // ENOUGH) == 0
    sample = problem.of(kept)
    tried: list[tuple[float, Minimum]] = []
    for theta in _all_starts(sample, scaling, prior, start):
        tried += _tried(sample, theta)
        if tried and tried[-1][1].converged and tried[-1][0] < _GOOD and start is None:
            break
    if not tried:
        raise InitialisationError(
            "the poses do not surround an ellipsoid: they are too much alike, or the sensor moved in them. "
            "Turn the sensor so that every axis points up once and down once, and some directions between."
        )
    size, best = min(tried, key=_size)
    if robust and size > _EXPLAINED * _noise_size(sample, best.theta):
        for theta in subset_starts(sample, best.theta):
            tried += _tried(sample, np.where(sample.free, theta, best.theta), concentrate_fit)
    return min(tried, key=_size)[1]


def _size(tried: tuple[float, Minimum]) -> float:
    return tried[0]


def _all_starts(
    problem: TriadProblem, scaling: TriadScaling, prior: TriadPrior | None, start: Floats | None
) -> Iterator[Floats]:
    """Yield the stated start and the closed forms, with the held parameters at their values."""
    if start is not None:
        yield _stated(start, scaling, len(problem.free))
    common_axes = scaling.spread / scaling.spread.max()
    if prior is None:
        yield from starting_points(problem, common_axes, None)
        return
    known = (prior.mean - scaling.shift) / scaling.turn
    able = bool(np.all((np.diag(prior.precision) > 0)[_DIAGONAL] | prior.fixed[_DIAGONAL]))
    for theta in starting_points(problem, common_axes, known if able else None):
        theta[:PARAMETERS] = np.where(prior.fixed, known, theta[:PARAMETERS])
        yield theta


def _tried(
    problem: TriadProblem, theta: Floats, method: Callable[[TriadProblem, Floats, float], Minimum] = irls
) -> list[tuple[float, Minimum]]:
    """Return a fit from a start with the mean of most poses' errors, by which to compare; nothing if it breaks down."""
    try:
        point = method(with_weak_prior(problem, theta), theta, START_VARIANCE)
        size = most_errors(problem, point.theta)
    except np.linalg.LinAlgError:
        return []
    return [(size, point)] if np.isfinite(size) else []


def _noise_size(problem: TriadProblem, theta: Floats) -> float:
    """Return the mean error by noise at rest, in the unit of the measurements."""
    size = float(np.abs(np.linalg.det(theta[S_].reshape(3, 3)))) ** (1 / 3)
    return float(np.mean(np.sqrt(np.mean(problem.variance, axis=1) + (size * problem.magnitude_sigma) ** 2)))


def _stated(start: Floats, scaling: TriadScaling, size: int) -> Floats:
    """Return the scaled parameters of Angrisano's nine (Eq. 3), with positive scales, in the triad's own frame."""
    x, y, z = start[:3]
    correction = np.array([[1, z, y], [0, 1, x], [0, 0, 1]]) * start[6:]
    found = from_quadric(correction.T @ correction, start[3:6], np.inf)
    if found is None:
        raise InitialisationError("a start needs scales other than zero.")
    return start_at(found, scaling, size)


def starting_points(problem: TriadProblem, common_axes: Floats, prior: Floats | None) -> Iterator[Floats]:
    """Yield starting points (21 + p,), the most accurate first.

    Parameters
    ----------
    problem : in scaled units
    common_axes : (3,) multiplies scaled measurements so that all axes have one unit again
    prior : (21,) parameters from elsewhere that can serve as a start
    """
    linear = _by_directions(problem)
    if linear is not None:
        yield linear
    moving = problem.magnitude > 0
    if not moving.any():
        if prior is not None:
            yield np.concatenate([prior, np.zeros(problem.level.shape[1])])
        return
    m, w = problem.measured[moving], problem.magnitude[moving]
    rest = problem.measured[~moving]
    centre = rest.mean(axis=0) if len(rest) else 0.5 * (m.max(axis=0) + m.min(axis=0))
    for found in (
        general_ellipsoid(m - centre, w),
        _in_common_axes(constrained_ellipsoid, m - centre, w, common_axes),
        _in_common_axes(fit_sphere, m - centre, w, common_axes),
    ):
        if found is not None:
            shifted = Ellipsoid(correction=found.correction, bias=found.bias + centre)
            yield _oriented(problem, shifted, prior)
    if prior is not None:
        yield np.concatenate([prior, np.zeros(problem.level.shape[1])])


def _in_common_axes(method: object, m: Floats, w: Floats, axes: Floats) -> Ellipsoid | None:
    found = method(m * axes, w)  # type: ignore[operator]
    if found is None:
        return None
    return Ellipsoid(correction=found.correction * axes, bias=found.bias / axes)


def _oriented(problem: TriadProblem, found: Ellipsoid, prior: Floats | None) -> Floats:
    """Return the parameters of an ellipsoid in the body frame that directions or a prior mean, else in its own."""
    theta = np.zeros(len(problem.free))
    theta[S_], theta[B_] = invert_matrix(found.correction).ravel(), found.bias
    if not problem.free[[1, 2, 5]].any():
        theta[[1, 2, 5]] = 0.0
        return theta
    known = (problem.magnitude > 0) & np.isfinite(problem.direction_sigma)
    own = (problem.measured - found.bias) @ found.correction.T
    if known.any():
        turn = nearest_rotation(problem.direction[known].T @ own[known])
    elif prior is not None:
        turn = nearest_rotation(prior[S_].reshape(3, 3).T @ found.correction.T)
    else:
        turn = np.eye(3)
    theta[S_] = (invert_matrix(found.correction) @ turn.T).ravel()
    return theta


def _by_directions(problem: TriadProblem) -> Floats | None:
    """Return the linear least-squares solution by poses of known direction (Angrisano, Eqs. 4-7); None if too few."""
    usable = (problem.magnitude == 0) | np.isfinite(problem.direction_sigma)
    x = problem.magnitude[usable, None] * problem.direction[usable]
    design = np.column_stack([x, np.ones(len(x)), problem.force[usable]])
    if not problem.free[G_].any():
        design = design[:, :4]
    if len(x) < 4 or np.linalg.svd(design[:, :4], compute_uv=False)[-1] < 0.02 * np.sqrt(len(x)):
        return None
    found = np.linalg.lstsq(design, problem.measured[usable], rcond=1e-9)[0].T
    theta = np.zeros(len(problem.free))
    theta[S_], theta[B_] = found[:, :3].ravel(), found[:, 3]
    if found.shape[1] > 4:
        theta[G_] = found[:, 4:].ravel()
    return theta if abs(np.linalg.det(found[:, :3])) > 1e-6 and len(theta) >= PARAMETERS else None
