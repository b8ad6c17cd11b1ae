"""A step of an accelerometer's bias between two poses, as a rival of the poses that were left out.

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
from .pose_drift import prior_along_time
from .triad import TriadFit, fit_triad
from .triad_poses import B_, S_, TriadPoses, TriadPrior

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
