"""What the data of a fit say beyond it: of sigmas, of each part left out, of smaller models, of changes not seen.

**Stretches of time**, for covariances by clusters: a static interval with the rotation that follows it. The directions
of gravity are eliminated as in the factor of the solution: with Z = inv(N_uu) N_up, a stretch whose normal equations
are H and whose gradient is g has the information T' H T and the pull -T' g, T = [-Z; I]. Over all stretches and the
prior the information adds up to the Schur complement, and the pulls to zero.

**Left out**, each interval and each rotation is predicted from all the others: the fit without it is one Gauss-Newton
step away from the fit with it, and the covariance that the step needs is at hand; nothing is fitted again.

**Models** of an IMU one by one: biases, scales, misalignments, g-sensitivity, a bias that wanders.

**Changes not seen**: a step or a warm-up near the limit of what a search finds is left out of the model, or one is
taken for another. Each model m with one more such change, or another in place of one that was taken, has odds against
the model that was taken: the gain of likelihood, at the best of a few levels of the scatter between static intervals,
over the price of `bias_changes.py` without its margin. From the minimum it moves the parameters by d_m. The average
over the models (Hoeting et al., 1999) differs from the model taken by the second moment

    sum w_m d_m d_m' / (1 + sum w_m),    w_m the odds,

which is added to the covariance. Where nothing changed the odds are next to nothing, and so is this.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ...frozen import value_class
from ...geometry.rotations import invert_matrix, tangent_basis
from ...recording import Floats, Integers
from ...recording.samples import distinct_values
from ...results.result import Booleans
from ...results.trust import BlockChange, ModelStep
from ...solve.least_squares import ArrowSolution, reduced_normal_equations, solve_arrow
from ..trust.clusters import CandidateBlock, CandidateStep, ClusterSums, model_steps
from .bias_changes import DECAYS, shares_before
from .bias_functions import decay_functions, step_functions
from .fit import MultiPositionFit, sum_of_squares
from .model import (
    B_,
    BG_,
    CG_,
    G_,
    LOWER,
    PARAMETERS,
    S_,
    BiasFunctions,
    MultiPositionData,
    MultiPositionLinearization,
    MultiPositionState,
    linearize_model,
    normal_equations,
)
from .noise_levels import interval_rows, rotation_rows, rotation_variance, whitened_rest

_RUNS = (5, 4), (3, 3)  # rotations that follow each other, and how many of them

_SCALES = np.array([S_.start, S_.start + 2, S_.start + 5, CG_.start, CG_.start + 4, CG_.start + 8])
_ANGLES = np.array([column for column in np.r_[S_, CG_] if column not in _SCALES])
_OFFSETS = np.r_[B_, BG_]

_MOST_PLACES = 40
_BESIDE = (0.7, 0.84, 1.19, 1.41)  # times the time constant that was taken
_SCATTER = (1.0, 0.3, 0.0)  # of the extra variance that was taken
_RARE = 4.6  # logarithm of how many recordings there are to one in which a bias changed unseen: a hundred


def segment_sums(fit: MultiPositionFit, rotations: Booleans | None = None) -> ClusterSums:
    """Return the sums of each static interval with the rotation behind it, over the free parameters of a fit.

    Parameters
    ----------
    rotations : (n - 1,) which of them count; those that the fit used where not given
    """
    lines, whitening, free = fit.lines, fit.whitening, fit.free
    cross = np.swapaxes(fit.arrow.cross_covariance, 1, 2)
    follow = np.swapaxes(np.linalg.solve(fit.arrow.corner_covariance, cross), 1, 2)  # -Z, (n, 2, p)
    n, _, p = follow.shape
    pull, information = np.zeros((n, p)), np.zeros((n, p, p))
    for name in ("accelerometer", "gyroscope"):
        root = getattr(whitening, name)
        rows = root @ (getattr(lines, f"{name}_theta")[..., free] + getattr(lines, f"{name}_u") @ follow)
        _add(pull, information, rows, np.einsum("kij,kj->ki", root, getattr(lines, name)))
    rows = lines.rotation_theta[..., free] + lines.rotation_u @ follow[:-1] + follow[1:]
    weight = whitening.rotation[:, None]
    if rotations is not None:
        spread = np.sqrt(rotation_variance(fit.data, fit.state) + fit.extra.rotation)
        weight = (rotations / spread)[:, None]
    _add(pull[:-1], information[:-1], weight[..., None] * rows, weight * lines.rotation)
    prior = whitening.prior[np.ix_(free, free)]
    return ClusterSums(
        t_s=fit.data.interval_s,
        pull=pull,
        information=information,
        prior_pull=-(whitening.prior @ fit.from_prior)[free],
        prior_information=prior,
    )


def with_runs(fit: MultiPositionFit) -> Booleans:
    """Return the rotations (n - 1,) that a fit used, and those left out as outliers many of which follow each other.

    Outliers come one by one. Where they are most of a stretch of the recording, it is the stretch that differs.
    """
    linked = np.flatnonzero(fit.data.linked)
    out = ~fit.rotation_used[linked]
    used = fit.rotation_used.copy()
    for length, most in _RUNS:
        many = np.convolve(out, np.ones(length), mode="full")  # number left out of the last few, up to each
        for end in np.flatnonzero(many[: len(out)] >= most):
            used[linked[max(0, end - length + 1) : end + 1]] = True
    return used


def free_jacobian(fit: MultiPositionFit, jacobian: Floats) -> Floats:
    """Return derivatives (m, 30) by theta as those (m, p) by the free parameters of the sums."""
    return np.pad(jacobian, ((0, 0), (0, len(fit.free) - jacobian.shape[1])))[:, fit.free]


def _add(pull: Floats, information: Floats, rows: Floats, residual: Floats) -> None:
    pull -= np.einsum("kip,ki->kp", rows, residual)
    information += np.swapaxes(rows, 1, 2) @ rows


@value_class
class LeaveOneOutErrors:
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


def leave_one_out(fit: MultiPositionFit, *, g_sensitivity: bool = True) -> LeaveOneOutErrors:
    """Predict each interval and each rotation from all the others.

    Parameters
    ----------
    fit : the solution of the problem
    g_sensitivity : False judges the model without it, from the same linearisation
    """
    data, lines, arrow, free, theta = fit.data, fit.lines, fit.arrow, fit.free, fit.state.theta
    if not g_sensitivity and free[G_].any():
        lines, arrow, free, theta = _without_g_sensitivity(fit)
    rows, gain = interval_rows("accelerometer", lines, arrow, fit.whitening, free)
    residual = np.einsum("kij,kj->ki", fit.whitening.accelerometer, lines.accelerometer)
    thetas = theta + _change_without(rows, gain, residual, free)
    forces = _forces(data, theta[None])
    norms = np.linalg.norm(forces, axis=1)
    measured = forces / norms[:, None]
    basis = tangent_basis(fit.state.u)
    offset = np.einsum("kij,ki->kj", basis, measured - fit.state.u)
    direct = lines.rotation + offset[1:] + np.einsum("kij,kj->ki", lines.rotation_u, offset[:-1])
    rows, gain = rotation_rows(lines, arrow, fit.whitening, free)
    change = _change_without(rows, gain, fit.whitening.rotation[:, None] * lines.rotation, free)
    return LeaveOneOutErrors(
        magnitude=np.linalg.norm(_forces(data, thetas), axis=1) - 1,
        magnitude_fit=norms - 1,
        rotation=direct + np.einsum("kij,kj->ki", lines.rotation_theta, change),
        rotation_fit=direct,
        measured=measured,
    )


def _change_without(rows: Floats, gain: Floats, residual: Floats, free: Booleans) -> Floats:
    """Return the change of theta (k, p) when rows A with residual r are left out: P A' inv(I - A P A') r."""
    kept = np.eye(rows.shape[1]) - rows @ gain
    step = (gain @ np.linalg.solve(kept, residual[..., None]))[..., 0]
    change = np.zeros((len(rows), len(free)))
    change[:, free] = step[:, -int(free.sum()) :]
    return change


def _without_g_sensitivity(fit: MultiPositionFit) -> tuple[MultiPositionLinearization, ArrowSolution, Booleans, Floats]:
    """Return the linearised solution with G = 0."""
    free = fit.free.copy()
    free[G_] = False
    to_zero = np.zeros(len(free))
    to_zero[G_] = -fit.state.theta[G_]
    lines = fit.lines.extrapolated(to_zero, np.zeros((len(fit.state.u), 2)))
    arrow = solve_arrow(normal_equations(lines, fit.whitening, np.zeros(len(free)), free))
    step = np.zeros(len(free))
    step[free] = arrow.corner
    return lines.extrapolated(step, arrow.states), arrow, free, fit.state.theta + to_zero + step


def _forces(data: MultiPositionData, thetas: Floats) -> Floats:
    """Return the specific force (n, 3) [g] of interval k by the parameters thetas[k], or by the only ones."""
    s = np.zeros((len(thetas), 3, 3))
    s[:, LOWER[0], LOWER[1]] = thetas[:, S_]
    drifting = thetas[:, thetas.shape[1] - 3 * data.trend.shape[1] :].reshape(len(thetas), -1, 3)
    drift = np.einsum("kq,kqi->ki", data.trend, np.broadcast_to(drifting, (len(data.trend), *drifting.shape[1:])))
    return (invert_matrix(s) @ (data.accelerometer - thetas[:, B_] - drift)[..., None])[..., 0]


def imu_models(
    sums: ClusterSums,
    state: MultiPositionState,
    scales: Floats | None,
    *,
    g_sensitivity: bool | None,
    functions: tuple[BiasFunctions, BiasFunctions],
) -> tuple[CandidateStep, ...]:
    """Return what each step of the model brings, by predicting clusters of time that were left out.

    Scales and misalignments are estimated whatever they bring: they are what is calibrated. Whether biases drift is
    found out before, by tests of their own.

    Parameters
    ----------
    sums : of clusters, over all parameters of `state`
    state : where the full model stands
    scales : (6,) scaled parameters of a sensor with nominal scales, accelerometer first; None where a count means
        nothing without a calibration
    g_sensitivity : whether it is in the model; None where the recording decides
    functions : of time that the gyroscope's and the accelerometer's bias follow, whose coefficients come last
    """
    theta = state.theta
    steps = [
        CandidateBlock(name="misalignment", columns=_ANGLES, away=-theta[_ANGLES], forced=True),
        CandidateBlock(name="g-sensitivity", columns=np.r_[G_], away=-theta[G_], forced=g_sensitivity),
    ]
    always = _OFFSETS
    if scales is None:
        always = np.sort(np.r_[_OFFSETS, _SCALES])
    else:
        steps.insert(0, CandidateBlock(name="scale", columns=_SCALES, away=scales - theta[_SCALES], forced=True))
    first = PARAMETERS
    for function, triad in zip(functions, ("", "accelerometer "), strict=True):
        columns = np.arange(first, first + 3 * len(function.kind))
        first += len(columns)
        stepping = np.repeat(function.of_kind("step", "single"), 3)
        warm = np.repeat(function.of_kind("temperature", "warming", "curve"), 3)
        kinds = {"drift": columns[~(stepping | warm)], "temperature": columns[warm], "bias steps": columns[stepping]}
        for name, own in kinds.items():
            if len(own):
                steps.append(CandidateBlock(name=triad + name, columns=own, away=-theta[own], forced=True))
    return model_steps(sums, always, steps)


def as_table(
    steps: Sequence[CandidateStep], jacobian: Floats, blocks: Sequence[tuple[str, Floats, str]], *, forced: bool
) -> tuple[ModelStep, ...]:
    """Return the steps with what each moved.

    Parameters
    ----------
    jacobian : (m, p) of the scalars by the parameters
    blocks : path, factor (m,) by which its scalars are shown and 0 for others, and unit
    forced : whether a person chose the g-sensitivity
    """
    return tuple(
        ModelStep(
            name=step.candidate.name,
            parameters=len(step.candidate.columns),
            gain=step.gain,
            gain_sigma=step.gain_sigma,
            needed=step.needed if step.candidate.name == "g-sensitivity" else 0.0,
            used=step.used,
            forced=forced and step.candidate.name == "g-sensitivity",
            changes=_changes(step, jacobian, blocks),
        )
        for step in steps
    )


def _changes(
    step: CandidateStep, jacobian: Floats, blocks: Sequence[tuple[str, Floats, str]]
) -> tuple[BlockChange, ...]:
    moved = jacobian @ step.change
    sigma = np.nan_to_num(step.sigma)
    found: list[BlockChange] = []
    for path, factor, unit in blocks:
        columns = np.any(jacobian[factor != 0] != 0, axis=0) & (sigma > 0)
        if not columns.any() or not np.any(step.change[columns]):
            continue
        found.append(
            BlockChange(
                block=path,
                change=float(np.abs(factor * moved).max()),
                unit=unit,
                sigmas=float(np.max(np.abs(step.change[columns]) / sigma[columns])),
            )
        )
    return tuple(sorted(found, key=lambda change: -change.sigmas))


@value_class
class _Level:
    """The reduced normal equations at one level of scatter, and the log-likelihood at the minimum of the fit."""

    matrix: Floats
    right: Floats
    likelihood: float


def unseen_changes(fit: MultiPositionFit) -> Floats:
    """Return the covariance (30, 30) of theta, scaled units, that changes which cannot be excluded add."""
    added = np.zeros((PARAMETERS, PARAMETERS))
    if fit.data.rests is None:
        return added
    lines = linearize_model(fit.data, fit.state)
    for triad in ("gyroscope", "accelerometer"):
        moves, odds = alternative_models(fit, triad, lines)
        weight = np.exp(odds - max(odds.max(), 0.0))
        weight /= weight.sum() + np.exp(-max(odds.max(), 0.0))
        added += (moves * weight[:, None]).T @ moves
    return added


def alternative_models(fit: MultiPositionFit, triad: str, lines: MultiPositionLinearization) -> tuple[Floats, Floats]:
    """Return how far each other model moves theta, (m, 30), and the logarithm of its odds, (m,); `lines` of the fit."""
    gyroscope = triad == "gyroscope"
    present = fit.data.of_gyroscope if gyroscope else fit.data.of_accelerometer
    candidates, price = _candidates(fit, triad)
    first = PARAMETERS + 3 * len(fit.data.of_gyroscope.kind)
    new = len(fit.free) + np.arange(3 * len(candidates.kind)).reshape(3, -1).T
    own = (PARAMETERS if gyroscope else first) + np.arange(3 * len(present.kind)).reshape(-1, 3)
    levels = _levels(fit, triad, _beside(lines, candidates, triad), candidates.sigma)
    estimated, theta = np.flatnonzero(fit.free), np.append(fit.state.theta, np.zeros(new.size))
    taken = own[present.of_kind("step", "warm-up", "temperature")]
    found = [_solved(level, estimated, new, np.zeros(len(theta))) for level in levels]
    none = max(without for _, _, without in found)
    moves, odds = list[Floats](), list[Floats]()
    for out in (None, *taken):
        start, cost = np.zeros(len(theta)), price
        if out is not None:
            start[out], cost = -theta[out], np.zeros(len(price))
            found = [_solved(level, estimated[~np.isin(estimated, out)], new, start) for level in levels]
        likelihood = np.array([of_level for _, of_level, _ in found])
        best = np.argmax(likelihood, axis=0), np.arange(len(new))
        moves.append(np.array([x for x, _, _ in found])[best])
        odds.append(likelihood[best] - none - cost)
    return np.concatenate(moves), np.concatenate(odds)


def _candidates(fit: MultiPositionFit, triad: str) -> tuple[BiasFunctions, Floats]:
    """Return steps and decays that may have been, and the price of each.

    Their means over what the published bias is the mean of are zero, so that it is the bias in every model.
    """
    data, n = fit.data, len(fit.data.interval_s)
    changes = fit.changes[triad == "accelerometer"]
    at = distinct_values(np.linspace(1, n - 1, min(n - 1, _MOST_PLACES)).round())
    at = at[~np.isin(at, changes.steps)]
    tau = np.append(
        np.array(DECAYS) * (data.span_s[1] - data.span_s[0]),
        np.array(_BESIDE) * changes.warm_up_s if changes.warm_up_s else [],
    )
    segments = step_functions(at, n, triad)
    found = replace(  # one step each
        segments, at_rest=np.cumsum(segments.at_rest, axis=1), in_motion=np.cumsum(segments.in_motion, axis=1)
    )
    for one in tau:
        found = found.beside(decay_functions(data, float(one), triad))
    mean = _published(fit, triad) @ found.at_rest
    found = replace(found, at_rest=found.at_rest - mean, in_motion=found.in_motion - mean)
    price = _RARE + np.repeat(np.log([len(at), len(tau)]), [len(at), len(tau)]) + 1.5 * np.log(n)
    return found, price


def _beside(lines: MultiPositionLinearization, candidates: BiasFunctions, triad: str) -> MultiPositionLinearization:
    """Return a linearisation with the columns of all candidates, whose coefficients are zero, behind the others.

    Those of the first axis come first.
    """
    count, n = 3 * len(candidates.kind), len(candidates.at_rest)
    at_rest = -np.einsum("ij,kc->kijc", np.eye(3), candidates.at_rest).reshape(n, 3, count)
    rotation = np.zeros((n - 1, 2, count))
    if triad == "gyroscope":
        by_bias = lines.rotation_theta[..., BG_]
        rotation = np.einsum("kc,kij->kijc", candidates.in_motion, by_bias).reshape(n - 1, 2, count)
    columns = {"accelerometer": np.zeros((n, 3, count)), "gyroscope": np.zeros((n, 3, count)), triad: at_rest}
    columns["rotation"] = rotation
    return replace(
        lines,
        **{f"{of}_theta": np.concatenate([getattr(lines, f"{of}_theta"), new], axis=2) for of, new in columns.items()},
    )


def _levels(fit: MultiPositionFit, triad: str, lines: MultiPositionLinearization, sigma: Floats) -> list[_Level]:
    """Return the normal equations with all candidates at a few levels of scatter of a triad's static intervals.

    Parameters
    ----------
    lines : with the columns of all candidates, whose coefficients are known to `sigma` (c, 3) beforehand
    """
    from_prior = np.append(fit.from_prior, np.zeros(sigma.size))
    prior = np.pad(fit.whitening.prior, (0, sigma.size))
    np.fill_diagonal(prior[len(fit.free) :, len(fit.free) :], 1 / sigma.T.ravel() ** 2)
    free = np.ones(len(from_prior), dtype=bool)
    scatter = getattr(fit.extra, triad)
    found: list[_Level] = []
    for share in _SCATTER if scatter else _SCATTER[:1]:
        extra = replace(fit.extra, **{triad: share * scatter})
        accelerometer, gyroscope = (
            root * fit.interval_used[:, None, None] for root in whitened_rest(fit.data, fit.state, extra)
        )
        whitening = replace(fit.whitening, accelerometer=accelerometer, gyroscope=gyroscope, prior=prior)
        used = (accelerometer if triad == "accelerometer" else gyroscope)[fit.interval_used]
        system = normal_equations(lines, whitening, from_prior, free, sigma.size)
        matrix, right, lowered = reduced_normal_equations(system, sigma.size)
        level = float(np.sum(np.linalg.slogdet(used)[1])) - 0.5 * (
            sum_of_squares(lines, whitening, from_prior) - lowered
        )
        found.append(_Level(matrix=matrix, right=right, likelihood=level))
    return found


def _solved(level: _Level, kept: Integers, new: Integers, start: Floats) -> tuple[Floats, Floats, float]:
    """Solve with one candidate after the other.

    Parameters
    ----------
    kept : parameters that are free
    new : (m, 3) coefficients of each candidate
    start : (p,) steps of those that are not

    Returns
    -------
    (m, 30) steps of theta, (m,) log-likelihoods, and the one without a candidate
    """
    matrix, right = level.matrix, level.right - level.matrix @ start
    columns = np.ascontiguousarray(matrix[np.ix_(kept, new.ravel())])
    solved = np.linalg.solve(matrix[np.ix_(kept, kept)], np.column_stack([right[kept], columns]))
    alone, by_new = solved[:, 0], solved[:, 1:].reshape(len(kept), -1, 3)
    own = matrix[new[:, :, None], new[:, None, :]] - np.einsum("kmi,kmj->mij", columns.reshape(by_new.shape), by_new)
    score = right[new] - (columns.T @ alone).reshape(-1, 3)
    size = np.linalg.solve(own, score[:, :, None])[:, :, 0]
    step = np.tile(start, (len(new), 1))
    step[:, kept] = alone - np.einsum("kmi,mi->mk", by_new, size)
    without = level.likelihood + 0.5 * float((level.right + right) @ start + right[kept] @ alone)
    return step[:, :PARAMETERS], without + 0.5 * np.sum(score * size, axis=1), without


def _published(fit: MultiPositionFit, triad: str) -> Floats:
    """Return the weight (n,) of each static interval in the mean that the published bias is."""
    data, changes = fit.data, fit.changes[triad == "accelerometer"]
    assert data.half_s is not None
    functions = data.of_accelerometer if triad == "accelerometer" else data.of_gyroscope
    n = len(data.interval_s)
    share = 1 - shares_before(changes.steps[-1], n) if changes.steps else np.ones(n)
    if functions.of_kind("walk", "line", "warm-up", "temperature").any():
        weight = np.gradient(data.interval_s) * share
    else:
        weight = data.half_s * share * fit.interval_used
        if not weight.any():  # no rest of the last part was used
            weight = data.half_s * share
    return weight / weight.sum()
