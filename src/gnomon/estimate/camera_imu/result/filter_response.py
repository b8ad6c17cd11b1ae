"""Whether a triad shows fast motion smaller than it is, as behind a low-pass filter.

A filter of first order with the time constant tau does to a motion x, but for a delay, x + q x'' with q = tau^2 / 2, to
the second order of tau times the frequency of the motion. The delay is in the time shifts and in that of the
accelerometer; q is held at zero, and tested by the step that it would take if it were free (a score test, Rao 1948).

So is an axis whose scale is another one for negative readings: x + c |x| (scale factor asymmetry, IEEE 528).
"""

from collections.abc import Callable
from dataclasses import replace
from math import ceil, erfc, exp, pi, sqrt
from typing import NamedTuple

import numpy as np

from ....frozen import value_class
from ....recording import Floats, Integers
from ..batch import RigState, error_terms
from ..solution import Solution
from ..terms.assembly import TRIAD, by_span, taken_together
from ..terms.inertial_data import InertialData, InertialNoise, predicted_readings
from ..trajectory import BIAS, POSE
from .cluster_sums import bias_sides
from .uncertainty import TriadMisfit, Uncertainty

_LEAST_APART_S = 0.01  # between the readings whose second difference is x'': motion up to some 15 Hz counts
_ASKED = 3.0  # sigmas
_SHARE, _USUAL_S2 = 0.2, 32e-6  # of triads that have a filter, and its q: that of 20 Hz
_LEAST_SHARE = 1e-6  # of x'' that the rest must leave
_HELD = {"gravity.magnitude": 0.02, "target.scale": 3e-3}  # m/s^2, 1; what is held may be off by, and feigns a filter
_PROBES = 4  # of a triad: x'', and |x| of each axis
_ASYMMETRY, _LOPSIDED = 0.01, 4.5  # what c may be at all; sigmas that are asked for of one of six
_SHAPES = (("S_g", "M_g", "q_bg"), ("S_a", "M_a"))


def with_misfits(found: Uncertainty, solution: Solution) -> Uncertainty:
    """Return the uncertainty with that by filters, by how likely they are (Schmidt), and with what is proved.

    Only triads whose scales and axes are estimated are looked at: errors of these look like x'', too. So do those of
    gravity and of the board's size, which may move along by what they usually are off.
    """
    step, free, means = solution.step, solution.layout.free_index, bias_sides(solution)
    ratios = np.array([_ratio(found, imu, kind) for imu in range(len(solution.noise.imus)) for kind in (0, 1)])
    if not ratios.any():
        return found
    right, border, own, pull = _products(solution)
    inner, with_sides, sides = step.factor.further_sides(right, border, np.concatenate([[0], means]))
    moves, also = step.covariance @ sides[free], _moving_along(solution)
    along_with = also.covariance @ sides[also.columns]
    pull -= with_sides[0] + step.factor.schur_sides[also.columns, 0] @ along_with
    information = np.diag(own) - inner - sides[also.columns].T @ along_with
    moves = np.concatenate([moves, with_sides[1:] + step.factor.schur_sides[free][:, means].T @ moves])
    score = _Score(information, own, pull, moves, ratios)
    filters, added = _filters(found, score)
    misfits = (*filters, *_asymmetries(found, score))
    return replace(found, covariance=found.covariance + added, ordinary=found.ordinary + added, misfits=misfits)


class _Score(NamedTuple):
    """Of the probes: information (k, k), own one (k,), pull (k,), moves (f + 6 m, k); of the triads `_ratio` (2 m,)."""

    information: Floats
    own: Floats
    pull: Floats
    moves: Floats
    ratios: Floats

    def misfit(self, found: Uncertainty, probe: int, size: float, variance: float) -> TriadMisfit:
        """Return the probe's size [s^2 of x'', 1 of |x|] and variance as what is wrong with its triad."""
        triad, axis = divmod(probe, _PROBES)
        return TriadMisfit(
            imu=triad // 2,
            kind=triad % 2,
            axis=axis - 1 if axis else None,
            size=float(size),
            sigma=float(np.sqrt(variance) * self.ratios[triad]) if variance > 0 else np.inf,  # rounding, of a bad fit
            moved=float(np.max(np.abs(size * self.moves[:, probe]) / np.sqrt(np.diag(found.covariance)))),
        )


def _filters(found: Uncertainty, score: _Score) -> tuple[list[TriadMisfit], Floats]:
    """Return the triads that are proved to be filtered, and what filters add to the covariance."""
    triads, added = _PROBES * np.arange(len(score.ratios)), np.zeros_like(found.covariance)
    told = triads[(np.diag(score.information) > _LEAST_SHARE * score.own)[triads] & (score.ratios > 0)]
    information = score.information[np.ix_(told, told)]
    if not len(told) or np.linalg.det(information) <= _LEAST_SHARE * np.prod(np.diag(information)):
        return [], added  # the trajectory, or one triad the other's, takes up all of it
    covariance = np.linalg.inv(information)
    sizes = covariance @ score.pull[told]
    misfits = [score.misfit(found, *one) for one in zip(told.tolist(), sizes, np.diag(covariance), strict=True)]
    if any(one.size < -_ASKED * one.sigma or one.sigma == np.inf for one in misfits):
        return [], added  # no filter of first order makes fast motion larger: another one, whose noise is not white
    for one, along in zip(misfits, score.moves[:, told].T, strict=True):
        added += np.outer(along, along) * expected_square(one.size, one.sigma)
    return [one for one in misfits if one.size > _ASKED * one.sigma], added


def _asymmetries(found: Uncertainty, score: _Score) -> list[TriadMisfit]:
    """Return the axes that are proved to have another scale for negative readings."""
    chosen = np.flatnonzero((np.arange(len(score.own)) % _PROBES > 0) & (np.repeat(score.ratios, _PROBES) > 0))
    information = score.information[np.ix_(chosen, chosen)] + np.eye(len(chosen)) / _ASYMMETRY**2
    covariance = np.linalg.inv(information)
    sizes = covariance @ score.pull[chosen]
    misfits = [score.misfit(found, *one) for one in zip(chosen.tolist(), sizes, np.diag(covariance), strict=True)]
    return [one for one in misfits if abs(one.size) > _LOPSIDED * one.sigma]


def expected_square(q: float, sigma: float) -> float:
    """Return the expected q^2 [s^4] of a triad that may be filtered or not, after q was found with this sigma [s^2].

    Before, it is filtered with the probability `_SHARE`, by a q that is half-normal, of `_USUAL_S2`; else q is zero
    (Mitchell and Beauchamp 1988). So a filter that is told by two sigmas is in the covariance by half, one that is
    contradicted not at all.
    """
    shrunk = 1 / (1 + (sigma / _USUAL_S2) ** 2)
    y = q / sigma * sqrt(shrunk)
    positive = erfc(-y / sqrt(2)) / 2
    odds = _SHARE / (1 - _SHARE) * 2 * sqrt(1 - shrunk) * exp(min(y**2, 900.0) / 2) * positive
    if_filtered = sigma**2 * shrunk * (1 + y**2 + y * exp(-(y**2) / 2) / (sqrt(2 * pi) * positive))
    return odds / (1 + odds) * if_filtered


@value_class
class _MovingAlong:
    """Columns that are free, or held at what may be off, and their covariance."""

    columns: Integers
    covariance: Floats


def _moving_along(solution: Solution) -> _MovingAlong:
    layout = solution.layout
    held = {
        column: sigma
        for name, sigma in _HELD.items()
        if (block := layout.get(name)) is not None
        for column in range(block.start, block.stop)
        if not layout.free[column]
    }
    columns = np.concatenate([layout.free_index, np.array([*held], dtype=np.int64)])
    known = np.concatenate([np.zeros(len(layout.free_index)), 1 / np.square([*held.values()])])
    information = solution.step.factor.schur[np.ix_(columns, columns)] + np.diag(known)
    scale = 1 / np.sqrt(np.maximum(np.diag(information), 1e-300))
    sizes = np.outer(scale, scale)
    return _MovingAlong(columns=columns, covariance=np.linalg.inv(information * sizes) * sizes)


def _ratio(found: Uncertainty, imu: int, kind: int) -> float:
    """Return how much larger sigmas of a triad's own parameters are than for independent errors; 0 of held ones."""
    own = tuple(f"imu{imu}.{shape}" for shape in _SHAPES[kind])
    at = [k for k, name in enumerate(found.names) if name.partition("[")[0] in own]
    wider, independent = (np.diag(matrix)[at] for matrix in (found.covariance, found.ordinary))
    return float(np.sqrt(np.max(wider / independent, initial=0.0)))


def _products(solution: Solution) -> tuple[Floats, Floats, Floats, Floats]:
    """Return the products of the probes of each triad, as a right-hand side, with the rows of its readings.

    Returns
    -------
    right : (n, d, 8 m) columns of the control points, of gyroscope and accelerometer of each IMU
    border : (p, 8 m) columns of the border, but for the corners of a board
    own, pull : (8 m,) the probe itself, and minus the residuals
    """
    state, grid = _linearised_at(solution), solution.state.trajectory.grid
    count = 2 * _PROBES * len(solution.noise.imus)
    right = np.zeros((grid.controls, solution.step.factor.size, count))
    border, own, pull = np.zeros((solution.layout.dense, count)), np.zeros(count), np.zeros(count)
    measured = replace(solution.measurements, visual=(), used=())
    for term in error_terms(measured, state, solution.layout, solution.noise, probing=False)[0]:
        columns, imu = term.columns, term.data.imu
        biases = slice(POSE + BIAS * imu, POSE + BIAS * (imu + 1))
        probes, shapes = _probes(term.data, state, solution.noise.imus[imu])
        for part in taken_together(term):
            rows = term.rows(part)
            shape = shapes(part, rows[:, :, columns.side])
            spans, gathered = by_span(term.first[part], rows)
            sums = by_span(term.first[part], shape)[1].transpose(0, 2, 1) @ gathered
            for a in range(grid.order):
                right[spans + a, :POSE, probes] += sums[:, :, POSE * a : POSE * (a + 1)].transpose(0, 2, 1)
            for knot in (0, 1):
                right[spans + grid.bias_offset + knot, biases, probes] += sums[:, :, columns.bias(knot)].transpose(
                    0, 2, 1
                )
            for to, at in columns.pieces:
                border[to, probes] += sums[:, :, at].sum(axis=0).T
            pull[probes] += sums[:, :, columns.side].sum(axis=0)
            own[probes] += np.einsum("nrk,nrk->k", shape, shape)
    return right, border, own, pull


def _linearised_at(solution: Solution) -> RigState:
    """Return the state before the last step: rows from elsewhere do not belong to the factor."""
    state, trajectory = solution.state, solution.lin.trajectory
    if state.trajectory is trajectory:
        return state
    return RigState(trajectory=trajectory, parameters=solution.layout.plus(state.parameters, -solution.step.parameters))


def _probes(
    data: InertialData, state: RigState, noise: InertialNoise
) -> tuple[slice, Callable[[slice, Floats], Floats]]:
    """Return which probes those of some readings are, and what tells them in noises of a reading, (n, 3 t, 4 t).

    It is asked for some of the readings, with minus their residuals, (n, 3 t). Of what each of the t triads should have
    read, they are x'', and |x| of each axis. The readings that tell x'' lie whole knots apart: what a spline cannot
    follow repeats with the knots, and is in the residuals, too.
    """
    spacing_s = state.trajectory.grid.spacing_s
    apart_s = spacing_s * ceil(_LEAST_APART_S / spacing_s - 1e-6)
    before, after = (
        predicted_readings(state.trajectory, state.parameters, replace(data, t_s=data.t_s + shift_s))
        for shift_s in (-apart_s, apart_s)
    )
    triads = ((data.gyroscope, noise.gyroscope), (data.accelerometer, noise.accelerometer))
    there = [(kind, triad, triad.used / sigma) for kind, (triad, sigma) in enumerate(triads) if triad is not None]
    first, axes = _PROBES * (2 * data.imu + there[0][0]), np.arange(TRIAD)

    def shapes(part: slice, left: Floats) -> Floats:
        found = np.zeros((*left.shape, _PROBES * len(there)))
        for number, (kind, triad, weight) in enumerate(there):
            own, scale = TRIAD * number + axes, weight[part, None]
            at = triad.values[part] * scale - left[:, own]
            bent = (before[kind][part] + after[kind][part]) * scale - 2 * at
            found[:, own, _PROBES * number] = np.nan_to_num(bent) / apart_s**2
            found[:, own, _PROBES * number + 1 + axes] = np.abs(at)
        return found

    return slice(first, first + _PROBES * len(there)), shapes
