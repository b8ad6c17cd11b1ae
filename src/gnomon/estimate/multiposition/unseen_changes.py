"""What changes of a bias that the data cannot exclude would move.

A step or a warm-up near the limit of what a search finds is left out of the model, or one is taken for another. Each
model m with one more such change, or another in place of one that was taken, has odds against the model that was taken:
the gain of likelihood, at the best of a few levels of the scatter between static intervals, over the price of
`bias_changes.py` without its margin. From the minimum it moves the parameters by d_m. The average over the models
(Hoeting et al., 1999) differs from the model taken by the second moment

    sum w_m d_m d_m' / (1 + sum w_m),    w_m the odds,

which is added to the covariance. Where nothing changed the odds are next to nothing, and so is this.
"""

from dataclasses import replace

import numpy as np

from ...frozen import value_class
from ...recording import Floats, Integers
from ...solve.arrow import reduced_normal_equations
from .bias_changes import DECAYS, shares_before
from .bias_segments import decay_functions, step_functions
from .fit import MultiPositionFit, sum_of_squares
from .model import BG_, PARAMETERS, BiasFunctions, MultiPositionLinearization, linearize_model, normal_equations
from .noise_levels import whitened_rest

_MOST_PLACES = 40
_BESIDE = (0.7, 0.84, 1.19, 1.41)  # times the time constant that was taken
_SCATTER = (1.0, 0.3, 0.0)  # of the extra variance that was taken
_RARE = 4.6  # logarithm of how many recordings there are to one in which a bias changed unseen: a hundred


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
            found = [_solved(level, np.setdiff1d(estimated, out), new, start) for level in levels]
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
    at = np.unique(np.linspace(1, n - 1, min(n - 1, _MOST_PLACES)).round())
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
