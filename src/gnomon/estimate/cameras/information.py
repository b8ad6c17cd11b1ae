"""Which views tell most of the lenses, and how much.

With S the information of the shared parameters, the poses eliminated, a view with S_v adds 1/2 log det(S + S_v) - 1/2
log det S nats to what the others know. Views are taken greedily, the one that adds most first; what a view adds only
falls as others are taken, so that a bound from before tells which need not be looked at again.
"""

import numpy as np

from ...frozen import value_class
from ...recording import Floats, Integers
from ..camera_imu.terms.corner_sums import CornerNoise
from ..trust.clusters import ClusterSums
from .normal import view_sums
from .problem import Problem
from .rig import CameraRig, RigSolution, RigViews

_NEGLIGIBLE = 0.004
"""Nats per parameter: the last of some 125 alike views adds so much."""

_FEWEST = 20
"""Views that are taken, if there are so many, however little they add."""


@value_class
class ChosenViews:
    """Views that were chosen.

    Attributes
    ----------
    index : (k,) which of the views, ascending
    nats : (k,) what each added when it was taken
    """

    index: Integers
    nats: Floats


def chosen_views(views: RigViews, at: RigSolution | CameraRig, most: int | None = None) -> ChosenViews:
    """Return the most informative views for the lenses and the places of the cameras.

    Parameters
    ----------
    views : to choose from
    at : a solution of these views, or a rig with their poses
    most : number of views; until further ones add next to nothing where it is not given
    """
    sums = at.sums if isinstance(at, RigSolution) else sums_at(views, at)
    return _greedy(sums, most)


def sums_at(views: RigViews, rig: CameraRig) -> ClusterSums:
    """Return pull and information of each view at a rig that holds its pose, for usual noise of one size."""
    problem = Problem.of(views, rig, (), True)
    noise = {
        name: CornerNoise(sigma_px=one.sigma_px, huber=one.huber) for name, one in problem.first_noise(rig).items()
    }
    pull, information = view_sums(problem.at(rig, noise))
    return ClusterSums(
        t_s=(views.t_ns - views.t_ns[0]) * 1e-9 if len(views) else np.empty(0),
        pull=pull,
        information=information,
        prior_pull=-problem.prior_gradient(rig),
        prior_information=problem.information,
    )


def _greedy(sums: ClusterSums, most: int | None) -> ChosenViews:
    """Return the greedy choice; gains are looked at again only for views that may still be best."""
    total = sums.total
    scale = 1 / np.sqrt(np.maximum(np.diag(total), 1e-300))
    parts = sums.information * scale[:, None] * scale
    known = _prior(sums, scale)
    size, count = len(known), len(parts)
    bound = np.full(count, np.inf)
    taken: list[int] = []
    nats: list[float] = []
    while len(taken) < min(most if most is not None else count, count):
        best, gain = _best(parts, known, bound)
        if most is None and len(taken) >= _FEWEST and gain < _NEGLIGIBLE * size:
            break
        taken.append(best)
        nats.append(gain)
        bound[best] = -np.inf
        known = known + parts[best]
    order = np.argsort(taken)
    return ChosenViews(index=np.array(taken, dtype=np.int64)[order], nats=np.array(nats)[order])


_TOGETHER = 32  # views whose gain is looked at in one go


def _best(parts: Floats, known: Floats, bound: Floats) -> tuple[int, float]:
    """Return the view that adds most and how much; `bound` takes the gains that were looked at."""
    root = np.linalg.inv(np.linalg.cholesky(known))
    order = np.argsort(-bound, kind="stable")
    best, gain = -1, -np.inf
    step = len(order) if np.isinf(bound[order[0]]) else _TOGETHER
    for first in range(0, len(order), step):
        some = order[first : first + step]
        some = some[bound[some] > gain]
        if not len(some):
            break
        _, logs = np.linalg.slogdet(np.eye(len(known)) + root @ parts[some] @ root.T)
        bound[some] = 0.5 * logs
        k = int(np.argmax(logs))
        if 0.5 * logs[k] > gain:
            best, gain = int(some[k]), float(0.5 * logs[k])
    return best, gain


def _prior(sums: ClusterSums, scale: Floats) -> Floats:
    """Return what is known beforehand, scaled; of parameters without a prior a little of all views together."""
    prior = sums.prior_information * scale[:, None] * scale
    return prior + 1e-9 * np.eye(len(prior))
