"""What any lens is like: a prior far wider than that, which only holds what the views leave open.

The cost of views as a function of a rig: corners, columns, weights and priors in one place.
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from ...frozen import value_class
from ...models.camera import Camera
from ...recording import Floats
from ..camera_imu.terms.corner_sums import CornerNoise
from .board_shape import ASPECT_SIGMA, bow_sigma, offsets_information
from .layout import SharedLayout, lens_bounds
from .noise import HUBER, bounded_sigma, relative_corner_sigmas, usual_sigma
from .normal import ViewNormalEquations, accumulate_normal_equations
from .rig import CameraRig, RigViews
from .views import CameraCorners, camera_corners

_ORDER = {"k1": 2, "k2": 4, "k3": 6, "k4": 8, "p1": 1, "p2": 1}  # power of the radius beside the radius itself
_SHAPE_SIGMA = 1.0  # of xi, alpha, beta and w
_MIDDLE_SIGMA = 0.5  # of the principal point, over the width of the image


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
