"""An accelerometer whose bias drifts while poses are recorded, as of a sensor that warms up.

A straight line in time with a mean of zero over the poses is estimated jointly: measured = S g u + b + d tau. Where the
order of the attitudes resembles time, gravity's magnitude hardly tells it from scales and angles; there it is held to
what such sensors do, and counts in the sigmas of all other parameters. A bias that drifted need not have done so
evenly: beside the line it is taken to have walked at random, about as far (a Brownian bridge), and sigmas count that.

A step of an accelerometer's bias between two poses, as a rival of the poses that were left out.

A sensor that was switched off and on, knocked or exchanged reads differently from then on. Of few poses the robust fit
then finds some that do not fit, leaves them out, and the others agree: a wrong answer that looks right. So where poses
were left out, or scatter beyond their noise, a step is tried between all poses. What explains every pose is as likely
as what was found, and the distance between both is counted in the sigmas: the between-model part of the variance of
Bayesian model averaging (Hoeting et al. 1999, Eq. 3).
"""

from dataclasses import replace

import numpy as np

from ...frozen import value_class
from ...recording import Floats
from .triad import TriadFit, fit_triad
from .triad_poses import B_, G_, PARAMETERS, S_, TriadPoses, TriadPrior

SIGNIFICANT = 4.0  # sigmas, for a drift to count as one
_USUAL_M_S2 = 0.015  # 1.5 mg from the first pose to the last: some kelvin of a consumer's sensor
_LARGE, _WIDER, _ROUNDS = 2.0, 2.0, 3  # usual drifts; what is found, that the next round allows
_BY_TIME = np.arange(PARAMETERS)[G_][::3]  # the first column of the g-sensitivity, whose force is time here


@value_class
class PoseDrift:
    """How far the bias moved from the first pose to the last.

    Attributes
    ----------
    change, sigma : (3,) with what is usual taken into account [m/s^2]
    open : (3,) how much of what is usual the poses leave open, 0 to 1
    """

    change: Floats
    sigma: Floats
    open: Floats


def fit_with_drift(
    poses: TriadPoses, t_s: Floats | None, prior: TriadPrior | None
) -> tuple[TriadFit, PoseDrift | None]:
    """Fit a triad whose bias moves steadily; bias and covariance are of the mean of the poses.

    Parameters
    ----------
    poses : in the order in which they were recorded
    t_s : (n,) when [s]; None where only the order is known
    prior : what is known of the triad from elsewhere

    Raises
    ------
    InitialisationError
        If the poses determine no triad.
    """
    still = fit_triad(poses, prior=prior)
    time = np.arange(len(poses), dtype=np.float64) if t_s is None else t_s
    span = float(np.ptp(time))
    if not span > 0:
        return still, None
    tau = (time - time.mean()) / span
    timed = replace(poses, force=np.column_stack([tau, np.zeros((len(tau), 2))]))
    scale = np.linalg.norm(still.sensitivity, axis=1)
    usual = np.full(3, _USUAL_M_S2)
    fit, change = still, np.zeros(3)
    for _ in range(_ROUNDS):
        fit = fit_triad(timed, g_sensitivity=True, prior=prior_along_time(prior, scale * usual))
        change = fit.g_sensitivity[:, 0] / scale
        if not (np.abs(change) > _LARGE * usual).any():
            break
        usual = np.maximum(usual, _WIDER * float(np.abs(change).max()))
    sigma = fit.sigma[_BY_TIME] / scale
    if (np.abs(change) > SIGNIFICANT * sigma).any():
        fit = _with_wander(fit, tau, scale * float(np.sqrt(np.mean(change**2))))
    return fit, PoseDrift(change=change, sigma=sigma, open=sigma / usual)


def prior_along_time(prior: TriadPrior | None, sigma: Floats) -> TriadPrior:
    """Return the prior with changes of zero, give or take (3,) [unit], in place of the g-sensitivity."""
    mean = np.zeros(PARAMETERS) if prior is None else prior.mean.copy()
    precision = np.zeros((PARAMETERS, PARAMETERS)) if prior is None else prior.precision.copy()
    fixed = np.zeros(PARAMETERS, dtype=bool) if prior is None else prior.fixed.copy()
    mean[G_], precision[G_], fixed[G_] = 0.0, 0.0, True
    precision[:, G_] = 0.0
    fixed[_BY_TIME] = False
    precision[_BY_TIME, _BY_TIME] = 1 / sigma**2
    return TriadPrior(mean=mean, precision=precision, fixed=fixed)


def _with_wander(fit: TriadFit, tau: Floats, size: Floats) -> TriadFit:
    """Return the fit with sigmas that count a wander beside the line, of a line's size (3,) [unit]."""
    lines, n = fit.lines, len(tau)
    since, until = tau - tau.min(), tau.max() - tau
    about_mean = np.eye(n) - 1 / n
    bridge = about_mean @ np.where(since[:, None] <= since, since[:, None] * until, since * until[:, None]) @ about_mean
    column = [int(np.flatnonzero(lines.unscaled[row])[0]) for row in range(B_.start, B_.stop)]
    by_bias = lines.jacobian[:, column] * size / np.diag(lines.unscaled[B_][:, column])
    pull = np.zeros((n, lines.jacobian.shape[1], 3))
    np.add.at(pull, lines.pose, lines.jacobian[:, :, None] * by_bias[:, None, :])
    normal = lines.jacobian.T @ lines.jacobian + lines.prior_information
    moves = lines.unscaled @ np.linalg.solve(normal, pull)  # (n, 21, 3)
    return replace(fit, covariance=fit.covariance + np.einsum("kl,kpi,lqi->pq", bridge, moves, moves, optimize=True))


_LARGEST_M_S2 = 0.3  # 30 mg: more than the turn-on bias and a knock do
_FEWEST = 2  # poses on each side: a step beside a single pose is that this pose is off
_MOST_TRIED = 48
_WORSE = 1.2  # times the scatter of the fit, that a step may leave where poses were left out
_FEWEST_REDUNDANT = 2.0
_SAID = slice(S_.start, B_.stop)


@value_class
class PoseStep:
    """The likeliest step of those that explain all poses.

    Attributes
    ----------
    after : number of the last pose before it
    shorter : poses on the side that has fewer
    change : (3,) [m/s^2]
    """

    after: int
    shorter: int
    change: Floats


def count_rival_step(poses: TriadPoses, fit: TriadFit, prior: TriadPrior | None) -> tuple[TriadFit, PoseStep | None]:
    """Return the fit with sigmas that count a step which explains all poses, and that step; None where there is none.

    Parameters
    ----------
    poses : in the order in which they were recorded
    fit : of the same poses; its bias, and that of the rivals, is of the mean of the poses
    prior : what is known of the triad from elsewhere
    """
    if fit.used.all() and fit.extra_sigma == 0:
        return fit, None
    scale = np.linalg.norm(fit.sensitivity, axis=1)
    order, rivals = np.arange(len(poses)), list[tuple[int, TriadFit]]()
    splits = order[_FEWEST : len(order) - _FEWEST + 1]
    for first in splits[:: len(splits) // _MOST_TRIED + 1]:
        after = (order >= first).astype(np.float64)
        stepped = replace(poses, force=np.column_stack([after - after.mean(), np.zeros((len(order), 2))]))
        rival = fit_triad(
            stepped, g_sensitivity=True, prior=prior_along_time(prior, scale * _LARGEST_M_S2), robust=False
        )
        if _explains(rival, fit):
            rivals.append((int(first), rival))
    if not rivals:
        return fit, None
    cost = np.array([rival.cost for _, rival in rivals])
    weight = np.exp(cost.min() - cost)
    covariance = fit.covariance.copy()
    for share, (_, rival) in zip(weight / weight.sum(), rivals, strict=True):
        apart = np.concatenate([(rival.sensitivity - fit.sensitivity).ravel(), rival.bias - fit.bias])
        covariance[_SAID, _SAID] += share * np.outer(apart, apart)
    first, best = rivals[int(np.argmin(cost))]
    step = PoseStep(after=first - 1, shorter=min(first, len(order) - first), change=best.g_sensitivity[:, 0] / scale)
    return replace(fit, covariance=covariance), step


def _explains(rival: TriadFit, fit: TriadFit) -> bool:
    """Tell whether a step leaves all poses within their noise, or as well explained as those that were not left out."""
    if rival.degrees_of_freedom < _FEWEST_REDUNDANT:
        return False
    left, found = (float(np.median(one.magnitude_sigma[fit.used])) for one in (rival, fit))
    return rival.extra_sigma == 0 or (not fit.used.all() and left < _WORSE * found)
