"""What any lens is like: a prior far wider than that, which only holds what the views leave open.

The cost of views as a function of a rig: corners, columns, weights and priors in one place.

Which views tell most of the lenses, and how much.

With S the information of the shared parameters, the poses eliminated, a view with S_v adds 1/2 log det(S + S_v) - 1/2
log det S nats to what the others know. Views are taken greedily, the one that adds most first; what a view adds only
falls as others are taken, so that a bound from before tells which need not be looked at again.
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from ...errors import SolveError
from ...frozen import value_class
from ...models.camera import Camera
from ...recording import Floats, Integers
from ..camera_imu.terms.visual_terms import CornerNoise
from ..trust.clusters import ClusterSums
from .layout import ASPECT_SIGMA, SharedLayout, bow_sigma, lens_bounds, offsets_information
from .normal import (
    HUBER,
    ViewNormalEquations,
    accumulate_normal_equations,
    bounded_sigma,
    relative_corner_sigmas,
    usual_sigma,
    view_sums,
)
from .rig import CameraCorners, CameraRig, RigSolution, RigViews, camera_corners

_ORDER = {"k1": 2, "k2": 4, "k3": 6, "k4": 8, "p1": 1, "p2": 1}  # power of the radius beside the radius itself
_SHAPE_SIGMA = 1.0  # of xi, alpha, beta and w
_MIDDLE_SIGMA = 0.5  # of the principal point, over the width of the image
_NEGLIGIBLE = 0.004
"""Nats per parameter: the last of some 125 alike views adds so much."""

OTHER_BOARD = "Check that the target file describes the board."
_FEWEST = 20
"""Views that are taken, if there are so many, however little they add."""


@value_class
class LensPrior:
    """A normal prior of a lens's parameters.

    Attributes
    ----------
    mean, sigma : (q,) in the order of `Camera.parameters`
    """

    mean: Floats
    sigma: Floats


def image_wide_prior(camera: Camera, pixels: Floats) -> LensPrior:
    """Return a prior as wide as the image itself: a distortion of 100 % at its border, a focal length of 100 %.

    Parameters
    ----------
    camera : about right
    pixels : (m, 2) where corners were seen [px]
    """
    width, height = camera.resolution
    fu, fv = camera.intrinsics[-4:-2]
    middle = np.array([width - 1, height - 1]) / 2
    # The focal length divides by the scale of the shape: the border lies at about one, be the lens narrow or wide.
    reach = float(np.max(np.linalg.norm((pixels - middle) / (fu, fv), axis=1), initial=0.1))
    sigma: list[float] = []
    mean = camera.parameters.copy()
    for k, (symbol, kind) in enumerate(zip(camera.parameter_symbols, camera.parameter_kinds, strict=True)):
        if kind == "focal":
            sigma.append(float(camera.parameters[k]))
        elif kind == "principal":
            mean[k] = middle[int(symbol == "pv")]
            sigma.append(_MIDDLE_SIGMA * width)
        elif symbol in _ORDER:
            mean[k] = 0.0
            sigma.append(reach ** -_ORDER[symbol])
        else:
            sigma.append(_SHAPE_SIGMA)
    return LensPrior(mean=mean, sigma=np.array(sigma))


@value_class
class Problem:
    """What is minimised.

    Attributes
    ----------
    views : of the board
    corners : of every camera, those that take part
    layout : columns
    prior : of each lens
    information : (p, p) of the priors
    huber : distance in sigmas from which on a corner counts less; infinite for least squares
    """

    views: RigViews
    corners: tuple[CameraCorners, ...]
    layout: SharedLayout
    prior: Mapping[str, LensPrior]
    information: Floats
    huber: float

    @classmethod
    def of(cls, views: RigViews, start: CameraRig, board: tuple[str, ...], robust: bool) -> "Problem":
        """Return the problem of all lens parameters, all places but cam0's, and parts of the board's shape."""
        corners = camera_corners(views)
        own = {name: np.arange(len(camera.parameters)) for name, camera in start.cameras.items()}
        prior = {seen.name: image_wide_prior(start.cameras[seen.name], seen.exposures.pixels) for seen in corners}
        layout = SharedLayout.of(start.cameras, own, board, len(views.target))
        return cls(
            views=views,
            corners=corners,
            layout=layout,
            prior=prior,
            information=_prior_information(views, layout, prior),
            huber=HUBER if robust else np.inf,
        )

    @property
    def freedom(self) -> float:
        """Share of the residuals' freedom that the parameters leave."""
        residuals = 2 * sum(len(seen.point) for seen in self.corners)
        taken = 6 * len(np.unique(np.concatenate([seen.view for seen in self.corners]))) + self.layout.size
        return max(residuals - taken, 1) / max(residuals, 1)

    def at(self, rig: CameraRig, noise: Mapping[str, CornerNoise]) -> ViewNormalEquations:
        """Return the sums over the corners at a rig."""
        return accumulate_normal_equations(self.corners, self.views.target, rig, self.layout, noise)

    def prior_gradient(self, rig: CameraRig) -> Floats:
        """Return the gradient of the priors' cost, (p,)."""
        return self.information @ self._apart(rig)

    def cost(self, at: ViewNormalEquations, rig: CameraRig) -> float:
        """Return the robust cost with that of the priors."""
        apart = self._apart(rig)
        return float(at.cost.sum() + 0.5 * apart @ self.information @ apart)

    def _apart(self, rig: CameraRig) -> Floats:
        """Return how far a rig is from the priors' means, (p,)."""
        layout, found = self.layout, np.zeros(self.layout.size)
        for name, camera in rig.cameras.items():
            own = layout.own[name]
            found[layout.lens[name]] = (camera.parameters - self.prior[name].mean)[own]
        if layout.aspect.stop > layout.aspect.start:
            found[layout.aspect] = rig.board.aspect
        if layout.bow.stop > layout.bow.start:
            found[layout.bow] = rig.board.bow_m
        if layout.offsets.stop > layout.offsets.start:
            found[layout.offsets] = rig.board.offsets.ravel()
        return found

    def first_noise(self, rig: CameraRig) -> dict[str, CornerNoise]:
        """Return weights by the scatter of the corners at a rig."""
        plain = {seen.name: CornerNoise(sigma_px=1.0, huber=np.inf) for seen in self.corners}
        at = accumulate_normal_equations(
            self.corners, self.views.target, rig, SharedLayout.poses_only(rig.cameras), plain
        )
        return {
            seen.name: CornerNoise(sigma_px=usual_sigma(sums), huber=self.huber)
            for seen, sums in zip(self.corners, at.sums, strict=True)
        }

    def noise_at(self, at: ViewNormalEquations) -> dict[str, CornerNoise]:
        """Return weights by the residuals of a linearisation."""
        return {
            seen.name: CornerNoise(
                sigma_px=bounded_sigma(sums, np.ones(len(seen.point), dtype=np.bool_), self.huber, self.freedom),
                huber=self.huber,
            )
            for seen, sums in zip(self.corners, at.sums, strict=True)
        }

    def with_spread(self, noise: Mapping[str, CornerNoise]) -> "Problem":
        """Return the problem with the spread of the corners that their detector knows of."""
        corners = tuple(
            replace(
                seen, exposures=replace(seen.exposures, spread=relative_corner_sigmas(seen, noise[seen.name].sigma_px))
            )
            for seen in self.corners
        )
        return replace(self, corners=corners)

    def held(self, rig: CameraRig, gradient: Floats) -> np.ndarray:
        """Return which columns are at a bound of their lens and pull outwards, (p,) bool."""
        found = np.zeros(self.layout.size, dtype=np.bool_)
        for name, camera in rig.cameras.items():
            low, high = (side[self.layout.own[name]] for side in lens_bounds(camera))
            values, pull = camera.parameters[self.layout.own[name]], -gradient[self.layout.lens[name]]
            found[self.layout.lens[name]] = ((values <= low) & (pull < 0)) | ((values >= high) & (pull > 0))
        return found


def _prior_information(views: RigViews, layout: SharedLayout, prior: Mapping[str, LensPrior]) -> Floats:
    found = np.zeros((layout.size, layout.size))
    diagonal = np.zeros(layout.size)
    for name, one in prior.items():
        diagonal[layout.lens[name]] = 1 / one.sigma[layout.own[name]] ** 2
    diagonal[layout.aspect] = 1 / ASPECT_SIGMA**2
    diagonal[layout.bow] = 1 / bow_sigma(views.target) ** 2
    found[np.arange(layout.size), np.arange(layout.size)] = diagonal
    if layout.offsets.stop > layout.offsets.start:
        # The aspect and the bow are parameters of their own only where they are estimated beside the points.
        others = layout.board_moves(views.target)
        found[layout.offsets, layout.offsets] = offsets_information(views.target, others)
    return found


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

    Raises
    ------
    SolveError
        If the rig does not suit the views so badly that they tell nothing.
    """
    sums = at.sums if isinstance(at, RigSolution) else sums_at(views, at)
    try:
        with np.errstate(all="ignore"):
            return _greedy(sums, most)
    except np.linalg.LinAlgError as error:
        raise SolveError(f"no poses of the cameras suit the corners. {OTHER_BOARD}") from error


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
        if best < 0:
            raise np.linalg.LinAlgError("no view tells a finite number")
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
