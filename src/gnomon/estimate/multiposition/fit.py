"""Maximum likelihood for the multi-position problem, with noise levels from its own residuals.

Gauss-Newton on the chain of directions and the border of 30 parameters. Intervals and rotations that lie far outside
what the others show are gated, and what the noise at rest does not explain becomes an extra variance (noise_levels.py).
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ...errors import InitialisationError, SolveError
from ...frozen import value_class
from ...geometry.rotations import frame_rotation, invert_matrix
from ...recording import Floats
from ...recording.samples import median_of
from ...results.result import Booleans
from ...solve.least_squares import ArrowSolution, solve_arrow
from ...units import STANDARD_GRAVITY_M_S2
from .bias_changes import BiasChanges, accelerometer_changes, gyroscope_changes
from .bias_functions import (
    accelerometer_drifts,
    walk_density,
    walk_precision,
    with_accelerometer_drift,
    with_bias_steps,
    with_drift,
    with_temperature,
    with_trend,
    with_warm_up,
    without_functions,
    without_rates,
)
from .measurements import fit_magnitude, linear_start
from .model import (
    B_,
    BG_,
    CG_,
    G_,
    LOWER,
    PARAMETERS,
    S_,
    MultiPositionData,
    MultiPositionLinearization,
    MultiPositionState,
    Whitening,
    linearize_model,
    normal_equations,
)
from .noise_levels import ExtraVariance, estimate_extra_variance, rotation_variance, whitened_rest, with_sampling_error

_MOST_ITERATIONS = 30
_NEGLIGIBLE_STEP = 1e-4  # of a sigma; Gauss-Newton's next step would be a thousand times smaller
_ROUGH_STEP = 0.5  # of a sigma; enough to judge residuals
GATE_SIGMA = 5.0
_REWEIGHTINGS = 8
_SUSPICIOUS = 3.5  # times the median size; the largest of forty is 2.3 times as large
_MOSTLY_AHEAD = 0.9  # share of rotations that lead to the right half of all directions from a good start
_FEWEST_INTERVALS = 9
_HELD = 0.3  # posterior sigma over prior sigma beyond which a parameter is the prior's


Knowledge = Callable[[MultiPositionState], tuple[Floats, Floats]]
"""What is known beforehand: at a state, precision (30, 30) and information vector (30,) of theta, linearised there."""


@value_class
class FitProblem:
    """What stays the same during a fit.

    Attributes
    ----------
    data : scaled means and segments
    start : where the weak prior is centred
    free : (30 + 3 j,) bool, parameters that are estimated
    known : what is known beforehand, or None
    prior_mean : (30 + 3 j,)
    prior_sigma : (30,) of the weak prior
    prior_precision : (30 + 3 j,) * 2, with the drift's random walk
    """

    data: MultiPositionData
    start: MultiPositionState
    free: Booleans
    known: Knowledge | None
    prior_mean: Floats
    prior_sigma: Floats
    prior_precision: Floats


@value_class
class Iterate:
    """Where a fit stands: the state, its linearisation, and the step and covariance that follow from it."""

    state: MultiPositionState
    lines: MultiPositionLinearization
    whitening: Whitening
    arrow: ArrowSolution
    iterations: int
    converged: bool


@value_class
class MultiPositionFit:
    """The minimum, in the scaled units of its data.

    Attributes
    ----------
    data : the problem, with the functions of time in biases that drift
    state : parameters and directions
    covariance : (30, 30) of theta; zero where a parameter was held fixed
    held_by_prior : (30,) bool, posterior sigma above 0.3 of the weak prior's
    lines, whitening, arrow, free : the last linearisation, for leave-one-out
    from_prior : (30 + 3 j,) theta minus the mean of what was known beforehand
    extra : variances beyond the noise at rest
    drift, accelerometer_drift : (n, 3) bias of gyroscope and accelerometer in each interval minus the one of the
        state, scaled units; zero where it was constant
    changes : evidence for steps and a warm-up of the gyroscope's and of the accelerometer's bias
    iterations : Gauss-Newton steps
    converged : whether the last step was negligible
    interval_used, rotation_used : (n,), (n - 1,) bool, not gated as outliers
    """

    data: MultiPositionData
    state: MultiPositionState
    covariance: Floats
    held_by_prior: Booleans
    lines: MultiPositionLinearization
    whitening: Whitening
    arrow: ArrowSolution
    free: Booleans
    from_prior: Floats
    extra: ExtraVariance
    drift: Floats
    accelerometer_drift: Floats
    changes: tuple[BiasChanges, BiasChanges]
    iterations: int
    converged: bool
    interval_used: Booleans
    rotation_used: Booleans


def fit_multiposition(
    data: MultiPositionData,
    *,
    g_sensitivity: bool,
    known: Knowledge | None = None,
    walk: Floats | None = None,
    changes: tuple[BiasChanges | None, BiasChanges | None] = (None, None),
) -> MultiPositionFit:
    """Fit the multi-position model.

    Robust noise levels show outliers; noise levels without them weigh the rest. Where the gyroscope's residuals at rest
    then wander in time, a drift joins the model.

    Parameters
    ----------
    data : scaled means and segments
    g_sensitivity : whether the gyroscope's bias may depend on the specific force
    known : what is known beforehand
    walk : (3,) random walk of the gyroscope's bias, where it is known [unit^2/s]; otherwise the residuals tell
    changes : steps and warm-up of the gyroscope's and the accelerometer's bias, where they are known already

    Raises
    ------
    InitialisationError
        If no start can be found.
    SolveError
        If the normal equations are not positive definite even with the weak prior.
    """
    start = start_state(data)
    task = _fit_problem(data, start, None, known, g_sensitivity=g_sensitivity)
    state = _with_zeros(start, task)
    ahead = np.einsum("ki,ki->k", state.u[1:], linearize_model(data, state).propagated) > 0
    data = replace(data, linked=data.linked & (ahead | (np.mean(ahead) < _MOSTLY_AHEAD)))  # behind, none shows
    task = replace(task, data=data)
    used = everything = (np.ones(len(start.u), dtype=bool), data.linked)
    whitening = _whitening(task, start, ExtraVariance(), used)
    point = _gauss_newton(task, state, linearize_model(data, state), whitening, _ROUGH_STEP)
    data = with_sampling_error(data, point.state)
    task = replace(task, data=data)
    data, found = _with_changes(data, point.state, changes)
    if walk is None:
        at_rest = point.lines.gyroscope
        if data.drifting:
            at_rest = without_functions(data, at_rest)
        if g_sensitivity:
            at_rest = with_trend(data.interval_s, data.gyroscope, at_rest, point.state.u, used[0])
        walk = walk_density(data.interval_s, at_rest, used[0])
    s, b, *_ = point.state.matrices
    if not found[1] and accelerometer_drifts(data.interval_s, data.accelerometer, s, b, used[0]):
        data = with_accelerometer_drift(data)
    if walk is not None:
        data = with_drift(data)
    used = everything = (used[0], data.linked)
    if data.drifting:
        task = _fit_problem(data, start, walk, known, g_sensitivity=g_sensitivity)
        state = _with_zeros(point.state, task)
        whitening = _whitening(task, state, ExtraVariance(), used)
        point = _gauss_newton(task, state, linearize_model(data, state), whitening, _ROUGH_STEP)
    task = _with_prior(task, point.state)
    lines = _irls(task, point)
    robust = estimate_extra_variance(
        data, point.state, lines, point.arrow, point.whitening, free=task.free, robust=True
    )
    used = _gate_outliers(task, replace(point, lines=lines), robust, used)
    extra = _estimate_extra_variance(task, point, used, robust)
    whitening = _whitening(task, point.state, extra, used)
    second = _gauss_newton(task, point.state, point.lines, whitening, _ROUGH_STEP)
    task = _with_prior(task, second.state)
    still_used = _gate_outliers(task, second, extra, everything)  # what the settled levels explain comes back
    if not all(np.array_equal(a, b) for a, b in zip(used, still_used, strict=True)):
        used, extra = still_used, _estimate_extra_variance(task, second, still_used, extra)
    whitening = _whitening(task, second.state, extra, used)
    last = _gauss_newton(task, second.state, second.lines, whitening, _NEGLIGIBLE_STEP)
    iterations = point.iterations + second.iterations + last.iterations
    return _finished(task, replace(last, iterations=iterations), extra, used, found)


def _with_zeros(state: MultiPositionState, task: FitProblem) -> MultiPositionState:
    """Return the state with zeros for the functions of time in the biases."""
    zeros = np.zeros(len(task.free) - PARAMETERS)
    return MultiPositionState(theta=np.append(state.theta[:PARAMETERS], zeros), u=state.u)


def _with_changes(
    data: MultiPositionData, state: MultiPositionState, known: tuple[BiasChanges | None, BiasChanges | None]
) -> tuple[MultiPositionData, tuple[BiasChanges, BiasChanges]]:
    """Return the data with the steps, warm-up and temperature of the biases for which the rests speak.

    Where segments were given, the biases of other instants are not looked for.
    """
    if data.drifting or data.rests is None:
        return data, (BiasChanges(), BiasChanges())
    accelerometer, gyroscope = data.rests
    sensitivity, _, correction, *_ = state.matrices
    per_rad_s = 1 / np.linalg.norm(correction, axis=0)
    per_m_s2 = np.linalg.norm(sensitivity, axis=1) / STANDARD_GRAVITY_M_S2  # directions have length 1
    floor = data.earth_rate_variance * per_rad_s**2
    of_gyroscope, of_accelerometer = known
    if of_gyroscope is None:
        of_gyroscope = gyroscope_changes(replace(gyroscope, variance=gyroscope.variance + floor), state.u)
    if of_accelerometer is None:
        of_accelerometer = accelerometer_changes(accelerometer)
    data = with_bias_steps(data, gyroscope=of_gyroscope.steps, accelerometer=of_accelerometer.steps)
    data = without_rates(data, of_gyroscope.outlying)
    data = with_warm_up(data, gyroscope_s=of_gyroscope.warm_up_s, accelerometer_s=of_accelerometer.warm_up_s)
    data = with_temperature(
        data, (per_rad_s, per_m_s2), gyroscope=of_gyroscope.temperature, accelerometer=of_accelerometer.temperature
    )
    return data, (of_gyroscope, of_accelerometer)


def _fit_problem(
    data: MultiPositionData,
    start: MultiPositionState,
    walk: Floats | None,
    known: Knowledge | None,
    *,
    g_sensitivity: bool,
) -> FitProblem:
    sigma = weak_prior_sigma(start)
    knots = data.drifting
    free = np.ones(PARAMETERS + 3 * knots, dtype=bool)
    free[G_] = g_sensitivity
    functions = (data.of_gyroscope, data.of_accelerometer)
    beforehand = np.concatenate([sigma, *(one.sigma.ravel() for one in functions)])
    precision = np.diag(np.where(np.isnan(beforehand), 0.0, 1 / beforehand**2))
    if walk is not None:
        tail = slice(PARAMETERS, PARAMETERS + 3 * int(data.of_gyroscope.of_kind("walk").sum()))
        precision[tail, tail] = walk_precision(data, walk)
    task = FitProblem(
        data=data,
        start=start,
        free=free,
        known=known,
        prior_mean=np.append(start.theta, np.zeros(3 * knots)),
        prior_sigma=sigma,
        prior_precision=precision,
    )
    return _with_prior(task, start)


def _with_prior(task: FitProblem, state: MultiPositionState) -> FitProblem:
    """Return the task with what is known beforehand linearised about a state, on top of the weak prior."""
    if task.known is None:
        return task
    theta = slice(0, PARAMETERS)
    precision, information = task.known(state)
    weak = 1 / task.prior_sigma**2
    total = np.diag(weak) + precision
    mean, joint = task.prior_mean.copy(), task.prior_precision.copy()
    mean[theta] = np.linalg.solve(total, weak * task.start.theta + information)
    joint[theta, theta] = total
    return replace(task, prior_mean=mean, prior_precision=joint)


def _finished(
    task: FitProblem,
    point: Iterate,
    extra: ExtraVariance,
    used: tuple[Booleans, Booleans],
    changes: tuple[BiasChanges, BiasChanges],
) -> MultiPositionFit:
    hats, _ = task.data.drift
    covariance = np.zeros((len(task.free),) * 2)
    covariance[np.ix_(task.free, task.free)] = point.arrow.corner_covariance
    covariance = covariance[:PARAMETERS, :PARAMETERS]
    return MultiPositionFit(
        data=task.data,
        state=point.state,
        covariance=covariance,
        held_by_prior=np.sqrt(np.diag(covariance)) > _HELD * task.prior_sigma,
        lines=point.lines,
        whitening=point.whitening,
        arrow=point.arrow,
        free=task.free,
        from_prior=point.state.theta - task.prior_mean,
        extra=extra,
        drift=hats @ point.state.knots[: hats.shape[1]],
        accelerometer_drift=task.data.trend @ point.state.knots[hats.shape[1] :],
        changes=changes,
        iterations=point.iterations,
        converged=point.converged,
        interval_used=used[0],
        rotation_used=used[1],
    )


def start_state(data: MultiPositionData) -> MultiPositionState:
    """Return a starting point in closed form: ellipsoid, medians at rest, linear rotations.

    Raises
    ------
    InitialisationError
        If the attitudes determine no accelerometer calibration, or the gyroscope shows no turn.
    """
    fit = fit_magnitude(data.accelerometer, 1.0)
    sensitivity = invert_matrix(fit.correction)
    sensitivity = sensitivity @ frame_rotation(sensitivity, "accel-x").T
    correction = invert_matrix(sensitivity)
    u = (data.accelerometer - fit.bias) @ correction.T
    still = median_of(data.gyroscope, axis=0)
    force = (data.segments.accelerometer - fit.bias) @ correction.T
    norm = np.linalg.norm(force, axis=1, keepdims=True)
    moving = replace(data.segments, gyroscope=data.segments.gyroscope - still)
    rates, _ = linear_start(moving, force / np.where(norm > 0, norm, 1.0))
    if np.linalg.matrix_rank(rates) < 3:
        raise InitialisationError(
            "the gyroscope shows nothing of the turns between most static intervals, about one axis at least. Check "
            "that it is on, and its columns and unit."
        )
    theta = np.zeros(PARAMETERS)
    theta[S_], theta[B_] = sensitivity[LOWER], fit.bias
    theta[CG_], theta[BG_] = rates.ravel(), still
    return MultiPositionState(theta=theta, u=u / np.linalg.norm(u, axis=1, keepdims=True))


def weak_prior_sigma(state: MultiPositionState) -> Floats:
    """Weak priors in scaled units: 30 % of a scale, 0.1 rad/s per g; they hold what a recording leaves open."""
    size = np.sqrt(3 * np.mean(state.theta[CG_] ** 2)) or 1.0
    sigma = np.empty(PARAMETERS)
    sigma[S_], sigma[B_], sigma[CG_], sigma[BG_], sigma[G_] = 0.3, 0.3, 0.3 * size, 1.0, 0.1 / size
    return sigma


def _whitening(
    task: FitProblem, state: MultiPositionState, extra: ExtraVariance, used: tuple[Booleans, Booleans]
) -> Whitening:
    accelerometer, gyroscope = whitened_rest(task.data, state, extra)
    kept, linked = used
    return Whitening(
        accelerometer=accelerometer * kept[:, None, None],
        gyroscope=gyroscope * kept[:, None, None],
        rotation=linked / np.sqrt(rotation_variance(task.data, state) + extra.rotation),
        prior=task.prior_precision,
    )


def sum_of_squares(lines: MultiPositionLinearization, whitening: Whitening, from_prior: Floats) -> float:
    """Return the sum of squares of all residuals, whitened."""
    parts = (
        np.einsum("kij,kj->ki", whitening.accelerometer, lines.accelerometer),
        np.einsum("kij,kj->ki", whitening.gyroscope, lines.gyroscope),
        whitening.rotation[:, None] * lines.rotation,
    )
    return float(sum(np.sum(part**2) for part in parts) + from_prior @ whitening.prior @ from_prior)


def _solve(
    task: FitProblem, state: MultiPositionState, lines: MultiPositionLinearization, whitening: Whitening
) -> ArrowSolution:
    try:
        return solve_arrow(normal_equations(lines, whitening, state.theta - task.prior_mean, task.free))
    except np.linalg.LinAlgError as error:
        raise SolveError(
            "the calibration cannot be computed from these static intervals and rotations: the normal equations "
            "are singular. Record more attitudes, and rotations about different axes."
        ) from error


def _parameter_step(task: FitProblem, arrow: ArrowSolution) -> Floats:
    step = np.zeros(len(task.free))
    step[task.free] = arrow.corner
    return step


def _gauss_newton(
    task: FitProblem,
    state: MultiPositionState,
    lines: MultiPositionLinearization,
    whitening: Whitening,
    tolerance: float,
) -> Iterate:
    """Iterate until no parameter moves by more than `tolerance` sigma; that last step is taken without integrating."""
    cost = sum_of_squares(lines, whitening, state.theta - task.prior_mean)
    for iteration in range(1, _MOST_ITERATIONS + 1):
        arrow = _solve(task, state, lines, whitening)
        step = _parameter_step(task, arrow)
        if np.max(np.abs(arrow.corner) / np.sqrt(np.diag(arrow.corner_covariance))) < tolerance:
            return Iterate(
                state=state.moved(step, arrow.states),
                lines=lines.extrapolated(step, arrow.states),
                whitening=whitening,
                arrow=arrow,
                iterations=iteration,
                converged=True,
            )
        length = 1.0
        while True:
            trial = state.moved(length * step, length * arrow.states)
            trial_lines = linearize_model(task.data, trial)
            trial_cost = sum_of_squares(trial_lines, whitening, trial.theta - task.prior_mean)
            if trial_cost <= cost * (1 + 1e-9) + 1e-9 or length < 1e-3:
                break
            length *= 0.3
        state, lines, cost = trial, trial_lines, trial_cost
    return Iterate(
        state=state,
        lines=lines,
        whitening=whitening,
        arrow=_solve(task, state, lines, whitening),
        iterations=_MOST_ITERATIONS,
        converged=False,
    )


def _irls(task: FitProblem, point: Iterate) -> MultiPositionLinearization:
    """Return the residuals of a fit in which rotations that stand out count by their size, not by its square.

    Several bad rotations bend an ordinary fit until none of them stands out; they cannot bend this one as far.
    """
    lines, given = point.lines, point.whitening.rotation
    for _ in range(_REWEIGHTINGS):
        size = given * np.linalg.norm(lines.rotation, axis=1)
        usual = float(median_of(size[given > 0])) if (given > 0).any() else 0.0
        if size.max(initial=0.0) <= _SUSPICIOUS * usual:
            break
        weight = given / np.sqrt(np.maximum(size / max(usual, 1e-9), 1.0))
        whitening = replace(point.whitening, rotation=weight)
        arrow = _solve(task, point.state, point.lines, whitening)
        lines = point.lines.extrapolated(_parameter_step(task, arrow), arrow.states)
    return lines


def _estimate_extra_variance(
    task: FitProblem, point: Iterate, used: tuple[Booleans, Booleans], extra: ExtraVariance
) -> ExtraVariance:
    """Iterate solution and extra variances on one linearisation until they agree to 5 %."""
    for _ in range(8):
        whitening = _whitening(task, point.state, extra, used)
        arrow = _solve(task, point.state, point.lines, whitening)
        solved = point.lines.extrapolated(_parameter_step(task, arrow), arrow.states)
        old = extra
        extra = estimate_extra_variance(task.data, point.state, solved, arrow, whitening, free=task.free, robust=False)
        if old.agrees_with(extra):
            break
    return extra


def _gate_outliers(
    task: FitProblem, point: Iterate, extra: ExtraVariance, used: tuple[Booleans, Booleans]
) -> tuple[Booleans, Booleans]:
    """Return which intervals and rotations stay: those whose residuals are within five sigma.

    Where too much would have to go it is not outliers: the model does not hold, and the residuals shall show it.
    """
    whitening = _whitening(task, point.state, extra, used)
    lines = point.lines
    still = np.maximum(
        np.sum(np.einsum("kij,kj->ki", whitening.accelerometer, lines.accelerometer) ** 2, axis=1),
        np.sum(np.einsum("kij,kj->ki", whitening.gyroscope, lines.gyroscope) ** 2, axis=1) / 3,
    )
    turn = np.sum((whitening.rotation[:, None] * lines.rotation) ** 2, axis=1) / 2
    kept = used[0] & (still < GATE_SIGMA**2)
    linked = used[1] & (turn < GATE_SIGMA**2) & kept[1:] & kept[:-1]
    if kept.sum() < _FEWEST_INTERVALS or kept.sum() < 0.6 * used[0].sum() or linked.sum() < 0.6 * used[1].sum():
        return used
    return kept, linked
