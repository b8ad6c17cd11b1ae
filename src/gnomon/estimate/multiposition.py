"""Maximum likelihood for the multi-position problem, with noise levels from its own residuals.

Gauss-Newton on the chain of directions and the border of 30 parameters. Three extra variances, of the accelerometer and
the gyroscope between static intervals and of the rotations, take up what the noise at rest does not explain; each is
zero unless the residuals prove otherwise.
"""

from dataclasses import dataclass, replace

import numpy as np

from ..errors import SolveError
from ..geometry.so3 import tangent_basis
from ..models.frames import frame_rotation
from ..recording import Floats
from ..solve.arrow import ArrowSolution, solve_arrow
from .magnitude import fit_magnitude
from .multiposition_model import (
    B_,
    BG_,
    CG_,
    G_,
    LOWER,
    PARAMETERS,
    S_,
    Linearisation,
    MultiPositionData,
    State,
    Whitening,
    linearise,
    normal_equations,
)
from .rotations import linear_start

Booleans = np.ndarray

_MOST_ITERATIONS = 30
_NEGLIGIBLE_STEP = 1e-4  # of a sigma; Gauss-Newton's next step would be a thousand times smaller
_ROUGH_STEP = 0.3  # of a sigma; enough to judge residuals
_GATE_SIGMA = 5.0
_GROUPS = ("accelerometer", "gyroscope", "rotation")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
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


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MultiPositionFit:
    """The minimum, in the scaled units of its data.

    Attributes
    ----------
    state : parameters and directions
    covariance : (30, 30) of theta; zero where a parameter was held fixed
    held_by_prior : (30,) bool, posterior sigma above 0.3 of the weak prior's
    lines, whitening, arrow, free : the last linearisation, for leave-one-out
    extra : variances beyond the noise at rest
    iterations : Gauss-Newton steps
    converged : whether the last step was negligible
    interval_used, rotation_used : (n,), (n - 1,) bool, not gated as outliers
    """

    state: State
    covariance: Floats
    held_by_prior: Booleans
    lines: Linearisation
    whitening: Whitening
    arrow: ArrowSolution
    free: Booleans
    extra: ExtraVariance
    iterations: int
    converged: bool
    interval_used: Booleans
    rotation_used: Booleans


def free_parameters(*, gyroscope: bool, g_sensitivity: bool) -> Booleans:
    """Return which of the 30 parameters a model estimates, (30,) bool."""
    free = np.ones(PARAMETERS, dtype=bool)
    free[G_] = gyroscope and g_sensitivity
    free[CG_] = free[BG_] = gyroscope
    return free


def start_state(data: MultiPositionData, *, gyroscope: bool) -> State:
    """Return a starting point in closed form: ellipsoid, means at rest, linear rotations.

    Raises
    ------
    InitialisationError
        If the attitudes determine no accelerometer calibration.
    """
    fit = fit_magnitude(data.accelerometer, 1.0)
    sensitivity = np.linalg.inv(fit.correction)
    sensitivity = sensitivity @ frame_rotation(sensitivity, "accel-x").T
    u = (data.accelerometer - fit.bias) @ np.linalg.inv(sensitivity).T
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    theta = np.zeros(PARAMETERS)
    theta[S_], theta[B_] = sensitivity[LOWER], fit.bias
    if gyroscope and data.segments is not None:
        theta[CG_], theta[BG_] = _gyroscope_start(data, sensitivity, fit.bias)
    return State(theta=theta, u=u)


def _gyroscope_start(data: MultiPositionData, sensitivity: Floats, bias: Floats) -> tuple[Floats, Floats]:
    assert data.segments is not None
    still = np.median(data.gyroscope, axis=0)
    force = (data.segments.accelerometer - bias) @ np.linalg.inv(sensitivity).T
    norm = np.linalg.norm(force, axis=1, keepdims=True)
    moving = replace(data.segments, gyroscope=data.segments.gyroscope - still)
    correction, _ = linear_start(moving, force / np.where(norm > 0, norm, 1.0))
    return correction.ravel(), still


def fit_multiposition(data: MultiPositionData, *, gyroscope: bool, g_sensitivity: bool) -> MultiPositionFit:
    """Fit the multi-position model.

    Parameters
    ----------
    data : scaled means and segments
    gyroscope : whether there is a gyroscope to calibrate
    g_sensitivity : whether its bias may depend on the specific force

    Raises
    ------
    InitialisationError
        If no start can be found.
    SolveError
        If the normal equations are not positive definite even with the weak prior.
    """
    state = start_state(data, gyroscope=gyroscope)
    free = free_parameters(gyroscope=gyroscope, g_sensitivity=g_sensitivity)
    prior = State(theta=state.theta, u=state.u)
    sigmas = _prior_sigmas(state)
    used = (np.ones(len(state.u), dtype=bool), data.linked.copy())
    extra, total = ExtraVariance(), 0
    for round_ in range(3):
        whitening = _whitening(data, state, extra, used, sigmas, gyroscope=gyroscope)
        tolerance = _NEGLIGIBLE_STEP if round_ == 2 else _ROUGH_STEP
        state, lines, arrow, iterations, converged = _gauss_newton(data, state, prior, whitening, free, tolerance)
        total += iterations
        if round_ == 0:  # robust levels first, so that outliers show
            extra = _extra_variances(data, state, lines, arrow, whitening, free, robust=True)
        if round_ < 2:
            used = _gate(data, state, lines, extra, used, gyroscope=gyroscope)
            extra = _settled_variances(data, state, lines, prior, used, sigmas, free, gyroscope=gyroscope)
    covariance = np.zeros((PARAMETERS, PARAMETERS))
    covariance[np.ix_(free, free)] = arrow.corner_covariance
    return MultiPositionFit(
        state=state,
        covariance=covariance,
        held_by_prior=np.sqrt(np.diag(covariance)) > 0.3 * sigmas,
        lines=lines,
        whitening=whitening,
        arrow=arrow,
        free=free,
        extra=extra,
        iterations=total,
        converged=converged,
        interval_used=used[0],
        rotation_used=used[1],
    )


def _prior_sigmas(state: State) -> Floats:
    """Weak priors in scaled units: 30 % of a scale, 0.1 rad/s per g; they hold what a recording leaves open."""
    _, _, c_g, _, _ = state.matrices
    size = np.sqrt(np.mean(c_g**2) * 3) or 1.0
    sigmas = np.empty(PARAMETERS)
    sigmas[S_], sigmas[B_], sigmas[CG_], sigmas[BG_], sigmas[G_] = 0.3, 0.3, 0.3 * size, 1.0, 0.1 / size
    return sigmas


def _whitening(
    data: MultiPositionData,
    state: State,
    extra: ExtraVariance,
    used: tuple[Booleans, Booleans],
    sigmas: Floats,
    *,
    gyroscope: bool,
) -> Whitening:
    s, _, c_g, _, _ = state.matrices
    kept, linked = used
    accelerometer = _inverse_root(data.accelerometer_variance, extra.accelerometer * s @ s.T) * kept[:, None, None]
    if not gyroscope:
        return Whitening(
            accelerometer=accelerometer,
            gyroscope=np.zeros_like(accelerometer),
            rotation=np.zeros(len(kept) - 1),
            prior=1 / sigmas,
        )
    s_g = np.linalg.inv(c_g)
    still = _inverse_root(
        data.gyroscope_variance, (extra.gyroscope + data.earth_rate_variance) * s_g @ s_g.T
    ) * kept[:, None, None]
    return Whitening(
        accelerometer=accelerometer,
        gyroscope=still,
        rotation=linked / np.sqrt(_rotation_variance(data, c_g) + extra.rotation),
        prior=1 / sigmas,
    )


def _inverse_root(white: Floats, extra: Floats) -> Floats:
    """Return inverse Cholesky factors (n, 3, 3) of diag(white_k) + extra."""
    covariance = extra + white[:, :, None] * np.eye(3)
    return np.linalg.inv(np.linalg.cholesky(covariance))


def _rotation_variance(data: MultiPositionData, c_g: Floats) -> Floats:
    """Variance of each rotation by noise and earth rate, per axis [rad^2]; attitudes mix the axes evenly."""
    noise = data.rotation_variance @ (c_g**2).sum(axis=0) / 3
    return noise if data.segments is None else noise + data.earth_rate_variance * data.segments.duration_s**2


def _cost(lines: Linearisation, whitening: Whitening, from_prior: Floats) -> float:
    return (
        float(np.sum(np.einsum("kij,kj->ki", whitening.accelerometer, lines.accelerometer) ** 2))
        + float(np.sum(np.einsum("kij,kj->ki", whitening.gyroscope, lines.gyroscope) ** 2))
        + float(np.sum((whitening.rotation[:, None] * lines.rotation) ** 2))
        + float(np.sum((whitening.prior * from_prior) ** 2))
    )


def _gauss_newton(
    data: MultiPositionData, state: State, prior: State, whitening: Whitening, free: Booleans, tolerance: float
) -> tuple[State, Linearisation, ArrowSolution, int, bool]:
    lines = linearise(data, state)
    cost = _cost(lines, whitening, state.theta - prior.theta)
    for iteration in range(1, _MOST_ITERATIONS + 1):
        try:
            arrow = solve_arrow(normal_equations(lines, whitening, state.theta - prior.theta, free))
        except np.linalg.LinAlgError as error:
            raise SolveError(
                "the calibration cannot be computed from these static intervals and rotations: the normal equations "
                "are singular. Record more attitudes, about different axes."
            ) from error
        d_theta = np.zeros(PARAMETERS)
        d_theta[free] = arrow.corner
        negligible = np.max(np.abs(arrow.corner) / np.sqrt(np.diag(arrow.corner_covariance))) < tolerance
        if negligible:
            final = state.moved(d_theta, arrow.states)
            return final, lines.extrapolated(d_theta, arrow.states), arrow, iteration, True
        state, lines, cost = _step(data, state, prior, whitening, (d_theta, arrow.states), cost)
    arrow = solve_arrow(normal_equations(lines, whitening, state.theta - prior.theta, free))
    return state, lines, arrow, _MOST_ITERATIONS, False


def _step(
    data: MultiPositionData,
    state: State,
    prior: State,
    whitening: Whitening,
    step: tuple[Floats, Floats],
    cost: float,
) -> tuple[State, Linearisation, float]:
    """Take a Gauss-Newton step, shortened while it would make things worse."""
    length = 1.0
    while True:
        trial = state.moved(length * step[0], length * step[1])
        lines = linearise(data, trial)
        new_cost = _cost(lines, whitening, trial.theta - prior.theta)
        if new_cost <= cost * (1 + 1e-9) + 1e-9 or length < 1e-3:
            return trial, lines, new_cost
        length *= 0.3


# ---------------------------------------------------------------------------------------------------------------------
# Noise levels from the residuals


def _extra_variances(
    data: MultiPositionData,
    state: State,
    lines: Linearisation,
    arrow: ArrowSolution,
    whitening: Whitening,
    free: Booleans,
    *,
    robust: bool,
) -> ExtraVariance:
    """Estimate the extra variances: residual squares match their expectation, or nothing if the noise explains them."""
    s, _, c_g, _, _ = state.matrices
    redundancy = _redundancies(lines, arrow, whitening, free)
    s_g = np.linalg.inv(c_g) if np.any(whitening.gyroscope) else np.eye(3)
    turns = np.maximum(_rotation_variance(data, c_g), np.finfo(float).tiny)
    modes = (
        _modes(lines.accelerometer, data.accelerometer_variance, s, 0.0),
        _modes(lines.gyroscope, data.gyroscope_variance, s_g, data.earth_rate_variance),
        (lines.rotation**2 / turns[:, None], 1 / np.stack([turns, turns], axis=1)),
    )
    kept = (whitening.accelerometer[:, 0, 0] > 0, whitening.gyroscope[:, 0, 0] > 0, whitening.rotation > 0)
    found = [
        _matching_variance(squares[k], gains[k], dof[k], robust=robust)
        for (squares, gains), dof, k in zip(modes, redundancy, kept, strict=True)
    ]
    return ExtraVariance(accelerometer=found[0], gyroscope=found[1], rotation=found[2])


def _modes(residual: Floats, white: Floats, root: Floats, floor: float) -> tuple[Floats, Floats]:
    """Return squares and gains (n, 3) with r' inv(V + v root root') r = sum of squares / (1 + v gains).

    V = diag(white) + floor root root' is what is known of the variance.
    """
    whitener = _inverse_root(white, floor * root @ root.T)
    scaled = whitener @ root
    gains, vectors = np.linalg.eigh(scaled @ np.swapaxes(scaled, 1, 2))
    plain = np.einsum("kij,kj->ki", whitener, residual)
    return np.einsum("kij,ki->kj", vectors, plain) ** 2, np.maximum(gains, 0.0)


def _redundancies(
    lines: Linearisation, arrow: ArrowSolution, whitening: Whitening, free: Booleans
) -> tuple[Floats, Floats, Floats]:
    """Return trace(I - H) of each interval's accelerometer and gyroscope residuals and each rotation's."""
    out: list[Floats] = []
    for name in _GROUPS[:2]:
        jacobian, covariance = _interval_rows(name, lines, arrow, whitening, free)
        hat = np.einsum("kij,kjl,kil->k", jacobian, covariance, jacobian)
        out.append(3.0 - hat)
    jacobian, covariance = _rotation_rows(lines, arrow, whitening, free)
    out.append(2.0 - np.einsum("kij,kjl,kil->k", jacobian, covariance, jacobian))
    return out[0], out[1], out[2]


def _interval_rows(
    name: str, lines: Linearisation, arrow: ArrowSolution, whitening: Whitening, free: Booleans
) -> tuple[Floats, Floats]:
    """Return whitened rows (n, 3, 2 + p) of a group at rest, and the covariance (n, 2 + p, 2 + p) of what they touch."""
    whitener = getattr(whitening, name)
    by_u, by_theta = getattr(lines, f"{name}_u"), getattr(lines, f"{name}_theta")[..., free]
    jacobian = whitener @ np.concatenate([by_u, by_theta], axis=2)
    n, p = len(by_u), by_theta.shape[2]
    covariance = np.empty((n, 2 + p, 2 + p))
    covariance[:, :2, :2] = arrow.state_covariance
    covariance[:, :2, 2:] = arrow.cross_covariance
    covariance[:, 2:, :2] = np.swapaxes(arrow.cross_covariance, 1, 2)
    covariance[:, 2:, 2:] = arrow.corner_covariance
    return jacobian, covariance


def _rotation_rows(
    lines: Linearisation, arrow: ArrowSolution, whitening: Whitening, free: Booleans
) -> tuple[Floats, Floats]:
    """Return whitened rows (n - 1, 2, 4 + p) of the rotations, and the covariance of what they touch."""
    m, p = len(lines.rotation), int(free.sum())
    jacobian = np.empty((m, 2, 4 + p))
    jacobian[:, :, :2], jacobian[:, :, 2:4] = lines.rotation_u, np.eye(2)
    jacobian[:, :, 4:] = lines.rotation_theta[..., free]
    jacobian *= whitening.rotation[:, None, None]
    covariance = np.empty((m, 4 + p, 4 + p))
    covariance[:, :2, :2], covariance[:, 2:4, 2:4] = arrow.state_covariance[:-1], arrow.state_covariance[1:]
    covariance[:, :2, 2:4] = arrow.next_covariance
    covariance[:, 2:4, :2] = np.swapaxes(arrow.next_covariance, 1, 2)
    covariance[:, :2, 4:], covariance[:, 2:4, 4:] = arrow.cross_covariance[:-1], arrow.cross_covariance[1:]
    covariance[:, 4:, :4] = np.swapaxes(covariance[:, :4, 4:], 1, 2)
    covariance[:, 4:, 4:] = arrow.corner_covariance
    return jacobian, covariance


def _matching_variance(squares: Floats, gains: Floats, redundancy: Floats, *, robust: bool) -> float:
    """Return the extra variance v at which the sums of squares / (1 + v gains) are what they should be.

    Nothing is added unless the excess over the noise at rest is significant (three sigma of chi-square), so that
    recordings which the noise explains keep its exactly known level. A robust level takes medians for means.
    """
    dof = float(np.sum(redundancy))
    if dof < 1:
        return 0.0
    if robust:  # one number for all gains: the median square against that of chi-square with as many degrees
        degrees = dof / len(squares)
        expected = degrees * (1 - 2 / (9 * degrees)) ** 3
        excess = float(np.median(np.sum(squares, axis=1))) / expected - 1
        return max(excess, 0.0) / float(np.median(gains))
    if np.sum(squares) <= dof + 3 * np.sqrt(2 * dof):
        return 0.0
    variance = 0.0
    for _ in range(50):  # Newton from below; the sum is convex and falling, so that no step goes too far
        shrink = 1 / (1 + variance * gains)
        step = (float(np.sum(squares * shrink)) - dof) / float(np.sum(squares * gains * shrink**2))
        variance += step
        if step < 1e-3 * variance:
            break
    return variance


def _settled_variances(
    data: MultiPositionData,
    state: State,
    lines: Linearisation,
    prior: State,
    used: tuple[Booleans, Booleans],
    sigmas: Floats,
    free: Booleans,
    *,
    gyroscope: bool,
) -> ExtraVariance:
    """Iterate solution and extra variances on one linearisation until they agree."""
    extra = ExtraVariance()
    for _ in range(8):
        whitening = _whitening(data, state, extra, used, sigmas, gyroscope=gyroscope)
        arrow = solve_arrow(normal_equations(lines, whitening, state.theta - prior.theta, free))
        d_theta = np.zeros(PARAMETERS)
        d_theta[free] = arrow.corner
        solved = lines.extrapolated(d_theta, arrow.states)
        old, extra = extra, _extra_variances(data, state, solved, arrow, whitening, free, robust=False)
        pairs = [(getattr(old, name), getattr(extra, name)) for name in _GROUPS]
        if all(abs(a - b) <= 0.01 * max(a, b) for a, b in pairs):
            break
    return extra


def _gate(
    data: MultiPositionData,
    state: State,
    lines: Linearisation,
    extra: ExtraVariance,
    used: tuple[Booleans, Booleans],
    *,
    gyroscope: bool,
) -> tuple[Booleans, Booleans]:
    """Return which intervals and rotations stay: those within five sigma, the worst offender leaving first."""
    sigmas = np.ones(PARAMETERS)
    whitening = _whitening(data, state, extra, (used[0], used[1]), sigmas, gyroscope=gyroscope)
    kept, linked = used[0].copy(), used[1].copy()
    interval = np.maximum(
        np.sum(np.einsum("kij,kj->ki", whitening.accelerometer, lines.accelerometer) ** 2, axis=1),
        np.sum(np.einsum("kij,kj->ki", whitening.gyroscope, lines.gyroscope) ** 2, axis=1) / 3,
    )
    turn = np.sum((whitening.rotation[:, None] * lines.rotation) ** 2, axis=1) / 2
    kept &= interval < _GATE_SIGMA**2
    linked &= turn < _GATE_SIGMA**2
    linked &= kept[1:] & kept[:-1]
    if kept.sum() < 9 or kept.sum() < 0.6 * used[0].sum():  # not outliers: the model itself does not hold
        return used
    return kept, linked


# ---------------------------------------------------------------------------------------------------------------------
# Hold-out


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class HeldOut:
    """Errors of each interval and rotation when it was left out.

    Attributes
    ----------
    magnitude, magnitude_fit : (n,) |f| - 1 left out, and in the fit [g]
    rotation, rotation_fit : (n - 1, 2) u_a - u_g in the tangent plane, left out, and in the fit [rad]
    measured : (n, 3) directions that the accelerometer shows, u_a
    """

    magnitude: Floats
    magnitude_fit: Floats
    rotation: Floats
    rotation_fit: Floats
    measured: Floats


def leave_one_out(data: MultiPositionData, fit: MultiPositionFit, *, g_sensitivity: bool = True) -> HeldOut:
    """Predict each interval and each rotation from all the others.

    The fit without one interval or rotation is one exact Gauss-Newton step from the fit with it (the rows' covariance
    is at hand), so that no refit is needed.

    Parameters
    ----------
    g_sensitivity : False evaluates the model without it, from the same linearisation
    """
    lines, arrow, free, theta = fit.lines, fit.arrow, fit.free, fit.state.theta
    if not g_sensitivity and free[G_].any():
        lines, arrow, free, theta = _without_g_sensitivity(fit)
    jacobian, covariance = _interval_rows("accelerometer", lines, arrow, fit.whitening, free)
    residual = np.einsum("kij,kj->ki", fit.whitening.accelerometer, lines.accelerometer)
    thetas = theta + _leave_out(jacobian, covariance, residual, free, 2)
    magnitude = np.array(
        [_magnitude(data.accelerometer[k], thetas[k]) for k in range(len(thetas))]
    )
    forces = _forces(data.accelerometer, theta)
    norms = np.linalg.norm(forces, axis=1)
    measured = forces / norms[:, None]
    basis = tangent_basis(fit.state.u)
    offset = np.einsum("kij,ki->kj", basis, measured - fit.state.u)
    direct = lines.rotation + offset[1:] + np.einsum("kij,kj->ki", lines.rotation_u, offset[:-1])
    jacobian, covariance = _rotation_rows(lines, arrow, fit.whitening, free)
    residual = fit.whitening.rotation[:, None] * lines.rotation
    change = _leave_out(jacobian, covariance, residual, free, 4)
    return HeldOut(
        magnitude=magnitude,
        magnitude_fit=norms - 1,
        rotation=direct + np.einsum("kij,kj->ki", lines.rotation_theta, change),
        rotation_fit=direct,
        measured=measured,
    )


def _leave_out(jacobian: Floats, covariance: Floats, residual: Floats, free: Booleans, states: int) -> Floats:
    """Return the change of theta, (rows, 30), when each group of rows is left out: P A' inv(I - A P A') r."""
    gain = covariance @ np.swapaxes(jacobian, 1, 2)
    kept = np.eye(jacobian.shape[1]) - jacobian @ gain
    change = np.zeros((len(jacobian), PARAMETERS))
    step = (gain @ np.linalg.solve(kept, residual[..., None]))[..., 0]
    change[:, free] = step[:, states:]
    return change


def _without_g_sensitivity(
    fit: MultiPositionFit,
) -> tuple[Linearisation, ArrowSolution, Booleans, Floats]:
    """Return the linearised solution with G = 0."""
    free = fit.free.copy()
    free[G_] = False
    to_zero = np.zeros(PARAMETERS)
    to_zero[G_] = -fit.state.theta[G_]
    lines = fit.lines.extrapolated(to_zero, np.zeros((len(fit.state.u), 2)))
    arrow = solve_arrow(normal_equations(lines, fit.whitening, np.zeros(PARAMETERS), free))
    d_theta = np.zeros(PARAMETERS)
    d_theta[free] = arrow.corner
    return lines.extrapolated(d_theta, arrow.states), arrow, free, fit.state.theta + to_zero + d_theta


def _forces(accelerometer: Floats, theta: Floats) -> Floats:
    s = np.zeros((3, 3))
    s[LOWER] = theta[S_]
    return (accelerometer - theta[B_]) @ np.linalg.inv(s).T


def _magnitude(accelerometer: Floats, theta: Floats) -> float:
    return float(np.linalg.norm(_forces(accelerometer, theta))) - 1
