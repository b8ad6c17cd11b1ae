"""Lenses for a program that does not know their model: those of a model that it knows, fitted to see the same rays.

The fit is over the part of the image where the calibration knows the lens, which is where corners told it: its own
covariance says how far each pixel's image may move. Rays stay as they are, so that poses hold as they are, too.

A lens with k3 (radtan5) for programs that know radtan without: the coefficients that come nearest over the image.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ...errors import InitialisationError, OptionError
from ...findings import join_names
from ...frozen import value_class
from ...models.camera import Camera, knows_lens
from ...models.lens_names import models_of, refit_models
from ...recording import Floats
from ...results.calibration import Calibration, Covariance
from ...results.sensors import covariance_names
from .losses import Loss, formats_of

_GRID = 48  # pixels along the longer side of the image
_KNOWN_PX = 1.0  # sigma of the image of a ray up to which the lens counts as known there
_LEAST = 0.1  # share of the image; where less is known, all of it counts
_WORST_RMS_PX = 1.0
_WHOLE = 0.995
_SEEN = 0.9  # share of the pixels whose rays the other model must see; of a fisheye a pinhole misses the widest
_ONE_KIND = ("orb-slam3",)
"""Programs whose two cameras must have lenses of one kind."""
_KINDS = {
    "pinhole-radtan5": ("pinhole-none", "pinhole-radtan", "pinhole-radtan5"),
    "pinhole-equidistant": ("pinhole-equidistant",),
}
"""The fullest model of a kind, and all models of it."""


@value_class
class Refit:
    """A lens of another model, and how far its pixels are from those of the first over where that one is known.

    Attributes
    ----------
    camera : of the other model
    mean_px, rms_px, worst_px : distance of the pixels of one ray [px]
    worst_at : (2,) pixel of the first lens where the distance is largest [px]
    area : share of the image over which it was fitted, 0 to 1
    unseen : share of that area whose rays it has no pixel for, 0 to 1
    """

    camera: Camera
    mean_px: float
    rms_px: float
    worst_px: float
    worst_at: Floats
    area: float
    unseen: float = 0.0


def with_known_lenses(calibration: Calibration, to: str) -> tuple[Calibration, tuple[Loss, ...]]:
    """Return a calibration whose lenses a program knows, and what those cost that had to be fitted anew.

    Parameters
    ----------
    to : one of `models.lens_names.PROGRAMS`

    Raises
    ------
    OptionError
        If no model that the program knows comes within a pixel.
    """
    losses: list[Loss] = []
    for name, calibrated in calibration.cameras.items():
        if not knows_lens(to, calibrated.camera):
            refit = _nearest(calibration, name, to)
            losses.append(_loss(name, calibrated.camera, refit, to))
            calibration = _with_lens(calibration, name, refit)
    if to in _ONE_KIND:
        for name, refit in _of_one_kind(calibration).items():
            losses.append(_loss(name, calibration.cameras[name].camera, refit, to))
            calibration = _with_lens(calibration, name, refit)
    return calibration, tuple(losses)


def _of_one_kind(calibration: Calibration) -> dict[str, Refit]:
    """Return the lenses by which the first two cameras are of one kind, whichever fits best; none where none does."""
    cameras = {name: one.camera for name, one in list(calibration.cameras.items())[:2]}
    found: list[dict[str, Refit]] = []
    for kind, fits in _KINDS.items():
        refits = {
            name: _refit(lens, kind, *_known_area(calibration, name))
            for name, lens in cameras.items()
            if lens.model not in fits
        }
        known = {name: one for name, one in refits.items() if one is not None and one.rms_px < _WORST_RMS_PX}
        if len(known) == len(refits):
            found.append(known)
    return min(found, key=lambda one: max((refit.rms_px for refit in one.values()), default=0.0), default={})


def _nearest(calibration: Calibration, name: str, to: str) -> Refit:
    """Return the lens of the model that comes nearest of those that a program knows."""
    lens = calibration.cameras[name].camera
    pixels, rays, area = _known_area(calibration, name)
    found = [refit for model in refit_models(to) if (refit := _refit(lens, model, pixels, rays, area)) is not None]
    if not found or min(found, key=lambda one: one.rms_px).rms_px > _WORST_RMS_PX:
        best = min(found, key=lambda one: one.rms_px, default=None)
        nearest = "none of them sees all its rays"
        if best is not None:
            nearest = (
                f"the nearest, {best.camera.model}, is {best.rms_px:.2g} px off (rms), {best.worst_px:.2g} px at worst"
            )
        raise OptionError(
            f"{name} is {lens.model}, and {to} knows {join_names(models_of(to), 'or')}: {nearest}. Calibrate the "
            f"camera with gnomon camera --for {to}, or convert to {join_names(formats_of([lens]), 'or')}."
        )
    return min(found, key=lambda one: one.rms_px)


def _refit(lens: Camera, model: str, pixels: Floats, rays: Floats, area: float) -> Refit | None:
    """Return the lens of another model that is nearest, None where it cannot see the rays."""
    from ...estimate.cameras.first_lens import fit_lens_model

    try:
        other = fit_lens_model(lens, model, pixels)
    except InitialisationError:
        return None
    image = other.project(rays, point_jacobian=False)
    if not np.mean(image.valid) >= _SEEN:
        return None
    apart = np.linalg.norm(image.pixels - pixels, axis=1)[image.valid]
    worst = int(np.argmax(apart))
    return Refit(
        camera=other,
        mean_px=float(apart.mean()),
        rms_px=float(np.sqrt(np.mean(apart**2))),
        worst_px=float(apart[worst]),
        worst_at=pixels[image.valid][worst],
        area=area,
        unseen=float(1 - np.mean(image.valid)),
    )


def _known_area(calibration: Calibration, name: str) -> tuple[Floats, Floats, float]:
    """Return pixels (m, 2) of a grid where a lens is known, their rays (m, 3), and which share of the image that is."""
    lens = calibration.cameras[name].camera
    width, height = lens.resolution
    step = max(width, height) / _GRID
    u, v = np.meshgrid(np.arange(step / 2, width, step), np.arange(step / 2, height, step))
    pixels = np.column_stack([u.ravel(), v.ravel()])
    rays, valid = lens.unproject(pixels)
    pixels, rays = pixels[valid], rays[valid]
    known = _sigma_px(calibration, name, rays) < _KNOWN_PX
    if np.sum(known) < _LEAST * len(u.ravel()):
        known = np.ones(len(pixels), dtype=np.bool_)
    return pixels[known], rays[known], float(np.sum(known) / u.size)


def _sigma_px(calibration: Calibration, name: str, rays: Floats) -> Floats:
    """Return the standard deviation of the image of each ray by the covariance of the lens, (m,) [px]; else zeros."""
    columns = _columns(calibration.uncertainty.names, name)
    covariance = calibration.uncertainty.matrix[np.ix_(columns, columns)]
    if not np.isfinite(covariance).all():
        return np.zeros(len(rays))
    image = calibration.cameras[name].camera.project(rays, parameters_jacobian=True, point_jacobian=False)
    assert image.by_parameters is not None
    J = image.by_parameters
    return np.sqrt(np.einsum("mai,ij,maj->m", J, covariance, J))


def _columns(names: Sequence[str], camera: str) -> list[int]:
    """Return where the lens of a camera stands in a covariance."""
    blocks = (f"{camera}.intrinsics", f"{camera}.distortion_coeffs")
    return [i for i, name in enumerate(names) if name.partition("[")[0] in blocks]


def _with_lens(calibration: Calibration, name: str, refit: Refit) -> Calibration:
    """Return the calibration with another lens, whose covariance follows from that of the first by the fit.

    Where q = argmin sum |pi'(q, r) - pi(p, r)|^2, dq = (J' J')^-1 J' J dp with the derivatives J' of pi' and J of pi.
    """
    before = calibration.cameras[name]
    _, rays, _ = _known_area(calibration, name)
    images = [
        lens.project(rays, parameters_jacobian=True, point_jacobian=False) for lens in (before.camera, refit.camera)
    ]
    both = images[0].valid & images[1].valid
    old, new = (image.by_parameters[both] for image in images if image.by_parameters is not None)
    derivative = np.linalg.lstsq(np.vstack(list(new)), np.vstack(list(old)), rcond=None)[0]
    cameras = {**calibration.cameras, name: replace(before, camera=refit.camera)}
    names = covariance_names(calibration.imus, cameras)
    places = {one: i for i, one in enumerate(calibration.uncertainty.names)}
    own = _columns(names, name)
    transfer = np.zeros((len(names), len(places)))
    for i in set(range(len(names))) - set(own):
        transfer[i, places[names[i]]] = 1.0
    transfer[np.ix_(own, _columns(calibration.uncertainty.names, name))] = derivative
    matrix = transfer @ calibration.uncertainty.matrix @ transfer.T
    return replace(calibration, cameras=cameras, uncertainty=Covariance(names=names, matrix=matrix))


def _loss(name: str, lens: Camera, refit: Refit, to: str) -> Loss:
    u, v = refit.worst_at.tolist()
    share = f"{100 * refit.area:.0f} % of the image where it is known"
    where = "image" if refit.area > _WHOLE else share
    missed = f" It has no pixel for {100 * refit.unseen:.1g} % of that area, the widest rays." if refit.unseen else ""
    refused = f"{to} does not know {lens.model}"
    if knows_lens(to, lens):
        refused = f"{to} takes no {lens.model} beside a lens of another kind"
    return Loss(
        what=f"lens of {name}",
        why=f"{refused}; the file has the {refit.camera.model} that is nearest over the {where}."
        f"{missed} Where that is too much, calibrate with gnomon camera --for {to}.",
        size=f"{refit.mean_px:.2g} px off on average, {refit.worst_px:.2g} px at worst, at ({u:.0f}, {v:.0f})",
    )
