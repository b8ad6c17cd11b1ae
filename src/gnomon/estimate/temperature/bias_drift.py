"""A bias over temperature, from warm-ups at rest: polynomials, the thermometer's lag, and what differs each time.

Of one axis in warm-up w, with means y over bins,

    y_w(t) = b + c_w + sum_j p_j (T_w(t) - T_ref)^j + k_w(t) + e_w(t),

c_w the bias of that switching-on (variance tau^2), k_w a random walk from its start (K^2 per second) and e_w white
noise of the bins (variance q / samples). The variances are those of largest restricted likelihood (REML; Patterson and
Thompson, Biometrika 1971), coefficients and covariance follow by generalised least squares.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from math import comb
from typing import Self

import numpy as np
from scipy.optimize import minimize

from ...frozen import value_class
from ...recording import Floats
from ...solve.factorisation import dpotrf, dpotrs
from ..trust.between_recordings import scaled_inverse

_LIKELY = 1e-5
"""Probability by chance below which an order is taken up."""
_SHORTEST_LAG_S, _LONGEST_LAG_S = 2.0, 180.0
"""Of lags that are looked for: a bin is 5 s or longer, and a warm-up some minutes."""
_FLOOR = 1e-9
"""Least variance of the noise, of that of the values: readings that were smoothed may have none."""
_LEAST, _MOST = np.array([-3.0, -14.0, -10.0, -10.0]), np.array([3.0, 14.0, 3.0, 20.0])
"""How far variances are looked for from their first guesses [log]."""
_MOST_ROUNDS, _LAG_ROUNDS = 250, 8
"""Evaluations of the likelihood of variances, and narrowings of a lag; most end sooner, by their tolerances."""
_SCALE_K = 10.0
"""Unit in which powers of the temperature are of one size, for the sake of the arithmetic [K]."""
_LAG_SETTLED, _LAG_SHAPE = 0.3, 0.1
"""Sigmas within which a lag has come to rest, and how far thermometers are from lags of first order, of the lag."""
_DIFFERENCES = 3
"""Of values, in which what follows the temperature is as good as gone."""
_START = np.array([0.0, -2.0, -2.0, 3.0])
"""Where the search for variances begins, from the first guesses [log]: the noise as seen, little walk and rounding,
and switchings-on that differ by more than the noise of a bin."""
_STEADY_K = 1e-3
"""Changes of the temperature that are none [K]."""
_BRANCH = 0.1
"""Share of the time that the temperature rises, and falls, at least, for both branches to be compared."""


@value_class
class WarmUp:
    """Means over bins of one recording at rest.

    Attributes
    ----------
    t_s : (n,) middles of the bins, from the start [s]
    degc : (n,) temperature [degC]
    step_k : of the thermometer's readings [K]
    samples : (n,) in each bin
    values : (n, m) of each axis [unit]
    """

    t_s: Floats
    degc: Floats
    step_k: float
    samples: Floats
    values: Floats


@value_class
class DriftProblem:
    """Warm-ups of one sensor.

    Attributes
    ----------
    warm_ups : with the temperatures that the lag of the thermometer leaves
    reference_degc : where the polynomials are zero [degC]
    nearby : the same with a lag that is one standard deviation longer; None where there is no lag
    """

    warm_ups: Sequence[WarmUp]
    reference_degc: float
    nearby: Sequence[WarmUp] | None = None

    def without(self, left_out: int) -> Self:
        """Return the problem without one of the warm-ups."""
        others = [one for i, one in enumerate(self.warm_ups) if i != left_out]
        return replace(self, warm_ups=others, nearby=None)


@value_class
class DriftVariances:
    """What differs from bin to bin, in time, and from one switching-on to the next, of one axis.

    Attributes
    ----------
    white : of one sample [unit^2]
    walk : of the random walk [unit^2/s]
    turn_on : of the bias of a switching-on [unit^2]
    reading : of what the thermometer's steps hide, alike within a step [unit^2]
    """

    white: float
    walk: float
    turn_on: float
    reading: float


@value_class
class AxisDrift:
    """The polynomial of one axis.

    Attributes
    ----------
    coefficients : (1 + order,) value at the reference, then p_1, p_2, ... [unit per K^j]
    covariance : (1 + order, 1 + order) of these
    by_lag : (1 + order,) what one standard deviation of the lag changes, the same lag for all axes; in the covariance
    """

    coefficients: Floats
    covariance: Floats
    by_lag: Floats


@value_class
class _Piece:
    """One axis of one warm-up: powers of the temperature, values, and what correlates its errors (n, n)."""

    X: Floats
    y: Floats
    walk: Floats
    reading: Floats
    samples: Floats

    def covariance(self, variances: DriftVariances) -> Floats:
        found = variances.walk * self.walk + variances.reading * self.reading + variances.turn_on
        found.flat[:: len(found) + 1] += variances.white / self.samples
        return found


def fit_variances(
    problem: DriftProblem,
    axis: int,
    order: int,
) -> DriftVariances:
    """Return the variances of an axis of largest restricted likelihood.

    Parameters
    ----------
    order : of the polynomial that is taken out, the highest that may be needed

    Notes
    -----
    A random walk that hides in the white noise is not taken for zero: its standard deviation has the boundary-avoiding
    prior of Chung et al. (Psychometrika 2013).
    """
    warm_ups = problem.warm_ups
    total = np.concatenate([one.values[:, axis] - one.values[:, axis].mean() for one in warm_ups])
    samples = float(np.median(np.concatenate([one.samples for one in warm_ups])))
    rough = np.concatenate([np.diff(one.values[:, axis], _DIFFERENCES) for one in warm_ups])
    bin_white = max(
        (1.4826 * float(np.median(np.abs(rough)))) ** 2 / comb(2 * _DIFFERENCES, _DIFFERENCES),
        _FLOOR * float(total.var()),
        1e-300,
    )
    length = max(float(one.t_s[-1] - one.t_s[0]) for one in warm_ups)
    degc = np.concatenate([one.degc - one.degc.mean() for one in warm_ups])
    hidden = float(total @ degc / max(degc @ degc, 1e-12)) ** 2 * max(one.step_k for one in warm_ups) ** 2 / 12
    scale = np.array([bin_white * samples, bin_white / length, max(hidden, 1e-3 * bin_white), bin_white])
    parts, pieces = 4 if len(warm_ups) > 1 else 3, _with_branches(problem, _pieces(problem, axis, order))

    def variances(logs: Floats) -> DriftVariances:
        white, walk, reading, *turn_on = (scale[:parts] * np.exp(np.clip(logs, _LEAST[:parts], _MOST[:parts]))).tolist()
        return DriftVariances(white=white, walk=walk, reading=reading, turn_on=turn_on[0] if turn_on else 0.0)

    def cost(logs: Floats) -> float:
        penalty = 1e-6 * float(logs @ logs) - float(np.clip(logs[1], _LEAST[1], _MOST[1]))
        return _likelihood(pieces, variances(logs)) + penalty

    found = minimize(
        cost, _START[:parts], method="Nelder-Mead", options={"maxfev": _MOST_ROUNDS, "xatol": 1e-2, "fatol": 1e-3}
    )
    return variances(found.x)


def fit_drift(problem: DriftProblem, axis: int, order: int, variances: DriftVariances) -> AxisDrift:
    """Return the polynomial of an axis by generalised least squares; what the lag leaves open is in its covariance."""
    found, covariance = _least_squares(_pieces(problem, axis, order), variances)
    by_lag = np.zeros_like(found)
    if problem.nearby is not None:
        with_longer_lag = replace(problem, warm_ups=problem.nearby, nearby=None)
        by_lag = fit_drift(with_longer_lag, axis, order, variances).coefficients - found
    return AxisDrift(coefficients=found, covariance=covariance + np.outer(by_lag, by_lag), by_lag=by_lag)


def choose_order(problem: DriftProblem, axes: Sequence[int], most: int, variances: Sequence[DriftVariances]) -> int:
    """Return the order of a triad's polynomials that the recordings prove.

    An order is taken up where its coefficients of all axes together are no chance, and, where there are several
    warm-ups, those left out are foretold better with it. A wrong lag of the one thermometer bends all axes at once: a
    curve of one axis is not put down to a lag that would bend the others, too.

    Parameters
    ----------
    axes : of the triad
    most : the highest order that the range supports
    variances : of each of the axes
    """
    from scipy.special import chdtrc

    pairs = list(zip(axes, variances, strict=True))
    order = 0
    for higher in range(1, most + 1):
        drifts = [fit_drift(problem, axis, higher, one) for axis, one in pairs]
        last = np.array([drift.coefficients[-1] for drift in drifts])
        by_lag = np.array([drift.by_lag[-1] for drift in drifts])
        covariance = np.outer(by_lag, by_lag)
        np.fill_diagonal(covariance, [drift.covariance[-1, -1] for drift in drifts])
        if chdtrc(len(axes), float(last @ scaled_inverse(covariance) @ last)) > _LIKELY:
            continue
        if len(problem.warm_ups) > 1:
            before, after = (
                sum(_left_out_score(problem, axis, tried, one) for axis, one in pairs) for tried in (order, higher)
            )
            if after >= before:
                continue
        order = higher
    return order


def _left_out_score(problem: DriftProblem, axis: int, order: int, variances: DriftVariances) -> float:
    """Return minus twice the log density of each warm-up by what the others foretell, summed; smaller is better."""
    total = 0.0
    for left_out in range(len(problem.warm_ups)):
        off, _, factor = _foretold(problem, left_out, axis, order, variances)
        total += 2 * float(np.log(np.diag(factor)).sum()) + float(off @ _solved(factor, off))
    return total


def _foretold(
    problem: DriftProblem, left_out: int, axis: int, order: int, variances: DriftVariances
) -> tuple[Floats, WarmUp, Floats]:
    """Return what a warm-up differs by from what the others foretell (n,), it, and the factor of the covariance."""
    one = problem.warm_ups[left_out]
    drift = fit_drift(problem.without(left_out), axis, order, variances)
    piece = _piece(problem, one, axis, order)
    factor = _factor(piece.covariance(variances) + piece.X @ drift.covariance @ piece.X.T)
    return piece.y - piece.X @ drift.coefficients, one, factor


def fit_lag(
    at_lag: Callable[[float], DriftProblem], axes: Sequence[int], orders: Sequence[int]
) -> tuple[float, float, float]:
    """Return the lag of the thermometer, its standard deviation [s], and how much likelier it is than none.

    Parameters
    ----------
    at_lag : the problem with temperatures for a lag [s]
    axes : by which it is found
    orders : of their polynomials
    """

    def costs_at(lags_s: Floats, variances: Sequence[DriftVariances]) -> Floats:
        triples = list(zip(axes, orders, variances, strict=True))
        problems = [at_lag(lag_s) for lag_s in lags_s.tolist()]
        return np.array([
            [_likelihood(_pieces(problem, axis, order), one, restricted=False) for axis, order, one in triples]
            for problem in problems
        ])  # fmt: skip

    def variances_at(lag_s: float) -> list[DriftVariances]:
        problem = at_lag(lag_s)
        return [fit_variances(problem, axis, order) for axis, order in zip(axes, orders, strict=True)]

    lags = np.concatenate([[0.0], np.geomspace(_SHORTEST_LAG_S, _LONGEST_LAG_S, 9)])
    costs = costs_at(lags, variances_at(0.0)).sum(axis=1)
    best = int(np.argmin(costs))
    if not best:
        return 0.0, 0.0, 0.0
    low, lag, high = lags[best - 1], float(lags[best]), lags[min(best + 1, len(lags) - 1)]
    sigma, gain = float("inf"), 0.0
    # What a wrong lag leaves looks like noise: with less of it the lag gets sharper. Its sigma is the larger of what
    # the likelihood says and of what leaving out one axis after the other does (jackknife), whatever the noise is.
    for _ in range(_LAG_ROUNDS):
        before, variances = lag, variances_at(lag)
        lags = np.concatenate([[0.0], np.linspace(low, high, 7)])
        each = costs_at(lags, variances)
        costs = each.sum(axis=1)
        lag, bend = _lowest(lags[1:], costs[1:])
        without = np.array([_lowest(lags[1:], costs[1:] - one)[0] for one in each[1:].T])
        scatter = float(np.sqrt(np.sum((without - lag) ** 2) * (len(without) - 1) / len(without)))
        sigma = max(1 / float(np.sqrt(bend)), scatter) if bend > 0 else float("inf")
        gain = float(costs[0] - costs[1:].min())
        if abs(lag - before) < _LAG_SETTLED * sigma:
            break
        reach = max(4 * sigma, (high - low) / 6) if np.isfinite(sigma) else high - low
        low, high = max(lag - reach, 0.0), lag + reach
    return lag, float(np.hypot(sigma, _LAG_SHAPE * lag)), gain


def _lowest(lags_s: Floats, costs: Floats) -> tuple[float, float]:
    """Return where costs (k,) of ascending lags are lowest, by a parabola through three, and how they bend."""
    middle = min(max(int(np.argmin(costs)), 1), len(lags_s) - 2)
    near = slice(middle - 1, middle + 2)
    bend, slope, _ = np.polyfit(lags_s[near] - lags_s[middle], costs[near], 2)
    lag = lags_s[middle] - slope / (2 * bend) if bend > 0 else lags_s[np.argmin(costs)]
    return float(np.clip(lag, lags_s[0], lags_s[-1])), float(bend)


def left_out_deviations(problem: DriftProblem, axis: int, order: int, variances: DriftVariances) -> Floats:
    """Return how far the mean and the trend of each warm-up lie off what the others foretell (w,), in sigmas."""
    z = np.full(len(problem.warm_ups), np.nan)
    for left_out in range(len(z)):
        off, one, factor = _foretold(problem, left_out, axis, order, variances)
        trend = np.stack([np.ones(len(off)), one.degc - one.degc.mean()], axis=1)
        trend = trend[:, np.abs(trend).max(axis=0) > _STEADY_K]  # a temperature that never changes has none
        information = trend.T @ _solved(factor, trend)
        found = np.linalg.solve(information, trend.T @ _solved(factor, off))
        z[left_out] = float(np.sqrt(found @ information @ found / len(found)))
    return z


def branch_difference(
    problem: DriftProblem, axis: int, order: int, variances: DriftVariances
) -> tuple[float, float] | None:
    """Return by how much an axis reads more while the temperature rises than while it falls, and its sigma [unit]."""
    pieces = _with_branches(problem, _pieces(problem, axis, order))
    if pieces[0].X.shape[1] == order + 1:
        return None
    found, covariance = _least_squares(pieces, variances)
    return float(found[-1]), float(np.sqrt(covariance[-1, -1]))


def _with_branches(problem: DriftProblem, pieces: Sequence[_Piece]) -> list[_Piece]:
    """Return the pieces with one regressor more where it both rises and falls: +-1/2 by which of them it does."""
    slopes = [np.gradient(one.degc, one.t_s) for one in problem.warm_ups]
    rising = np.concatenate(slopes) > 0
    if min(rising.mean(), 1 - rising.mean()) < _BRANCH:
        return list(pieces)
    usual = max(float(np.median(np.abs(np.concatenate(slopes)))), 1e-12)
    return [
        replace(one, X=np.column_stack([one.X, np.tanh(slope / usual) / 2]))
        for one, slope in zip(pieces, slopes, strict=True)
    ]


def _least_squares(pieces: Sequence[_Piece], variances: DriftVariances) -> tuple[Floats, Floats]:
    """Return coefficients and covariance by generalised least squares."""
    count = pieces[0].X.shape[1]
    normal, right = np.zeros((count, count)), np.zeros(count)
    for one in pieces:
        weighted = _solved(_factor(one.covariance(variances)), np.column_stack([one.X, one.y]))
        normal += one.X.T @ weighted[:, :-1]
        right += one.X.T @ weighted[:, -1]
    covariance = scaled_inverse(normal)
    return covariance @ right, covariance


def _piece(problem: DriftProblem, one: WarmUp, axis: int, order: int) -> _Piece:
    apart = np.abs(np.subtract.outer(one.degc, one.degc))
    return _Piece(
        X=np.vander(one.degc - problem.reference_degc, order + 1, increasing=True),
        y=one.values[:, axis],
        walk=np.minimum.outer(one.t_s, one.t_s),
        reading=np.maximum(1 - apart / max(one.step_k, 1e-9), 0.0),
        samples=one.samples,
    )


def _pieces(problem: DriftProblem, axis: int, order: int) -> list[_Piece]:
    return [_piece(problem, one, axis, order) for one in problem.warm_ups]


def _factor(covariance: Floats) -> Floats:
    """Return the factor (n, n) of a covariance, which it overwrites; what is above the diagonal is meaningless."""
    factor, failed = dpotrf(covariance.T, lower=1, clean=0, overwrite_a=1)  # .T: in the order that LAPACK takes
    if failed:
        raise np.linalg.LinAlgError(f"the covariance of {len(covariance)} bins is not positive definite")
    return factor


def _solved(factor: Floats, right: Floats) -> Floats:
    """Return what the covariance of a factor takes to right (n,) or (n, q)."""
    return dpotrs(factor, right, lower=1)[0]


def _likelihood(pieces: Sequence[_Piece], variances: DriftVariances, *, restricted: bool = True) -> float:
    """Return minus twice the log likelihood, but for a constant.

    The restricted one does not compare different temperatures, by which the polynomials themselves differ.
    """
    count = pieces[0].X.shape[1]
    normal, right, total = np.zeros((count, count)), np.zeros(count), 0.0
    for one in pieces:
        X = one.X / _SCALE_K ** np.arange(count)
        factor = _factor(one.covariance(variances))
        weighted = _solved(factor, np.column_stack([X, one.y]))
        normal += X.T @ weighted[:, :-1]
        right += X.T @ weighted[:, -1]
        total += 2 * float(np.log(np.diagonal(factor)).sum()) + float(one.y @ weighted[:, -1])
    sign, determinant = np.linalg.slogdet(normal)
    if sign <= 0:
        return float("inf")
    return total + restricted * float(determinant) - float(right @ np.linalg.solve(normal, right))
