"""Two models of one lens, compared by their images: where each would see the same ray."""

from dataclasses import dataclass

import numpy as np

from ..geometry.rotation_vector import rotation_from_rotvec, rotvec_from_rotation
from ..geometry.so3 import skew
from ..models.camera import Camera
from ..recording import Floats, frozen_array

_COLUMNS, _ROWS = 24, 18
_STEPS = 4
_LEAST_SHARE = 0.2
_SAME_PX = 1e-9


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LensDifference:
    """How far the images of one ray lie apart, over the image that two models share.

    Attributes
    ----------
    camera, first, second : names of the camera and of the calibrations
    models : both models, such as ("pinhole-radtan", "ds-none")
    rms_px, largest_px : distance of the two images [px]
    turned_rms_px : the same after the one camera was turned as fits best: a turn is no error of the lens, since the
        pose takes it up
    turn : (3,) that turn, about the camera's x, y, z [rad]
    share : part of the image that both models see, 0 to 1
    resolutions : [px] of both
    """

    camera: str
    first: str
    second: str
    models: tuple[str, str]
    rms_px: float
    largest_px: float
    turned_rms_px: float
    turn: Floats
    share: float
    resolutions: tuple[tuple[int, int], tuple[int, int]]

    @property
    def same(self) -> bool:
        """Whether both are the same lens."""
        return self.largest_px <= _SAME_PX


def lens_difference(camera: str, first: tuple[str, Camera], second: tuple[str, Camera]) -> LensDifference | None:
    """Return how two models of one camera differ; None where they see hardly anything in common.

    Parameters
    ----------
    camera : its name
    first, second : name of each calibration, and its lens
    """
    one, other = first[1], second[1]
    if one.model == other.model and np.array_equal(one.parameters, other.parameters):
        return _same(camera, first, second)
    width, height = (min(sides) for sides in zip(one.resolution, other.resolution, strict=True))
    x, y = (np.linspace(0, side - 1, count) for side, count in ((width, _COLUMNS), (height, _ROWS)))
    pixels = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    rays, seen = one.unproject(pixels)
    image = other.project(np.where(seen[:, None], rays, [0.0, 0.0, -1.0]))
    both = seen & image.valid
    if np.mean(both) < _LEAST_SHARE:
        return None
    rays, pixels = rays[both], pixels[both]
    apart = np.linalg.norm(image.pixels[both] - pixels, axis=1)
    turn, turned = _best_turn(other, rays, pixels)
    return LensDifference(
        camera=camera,
        first=first[0],
        second=second[0],
        models=(one.model, other.model),
        rms_px=float(np.sqrt(np.mean(apart**2))),
        largest_px=float(apart.max()),
        turned_rms_px=min(turned, float(np.sqrt(np.mean(apart**2)))),
        turn=frozen_array(turn),
        share=float(np.mean(both)),
        resolutions=(one.resolution, other.resolution),
    )


def _same(camera: str, first: tuple[str, Camera], second: tuple[str, Camera]) -> LensDifference:
    """Return what is to be said of one and the same lens."""
    return LensDifference(
        camera=camera,
        first=first[0],
        second=second[0],
        models=(first[1].model, second[1].model),
        rms_px=0.0,
        largest_px=0.0,
        turned_rms_px=0.0,
        turn=frozen_array(np.zeros(3)),
        share=1.0,
        resolutions=(first[1].resolution, second[1].resolution),
    )


def _best_turn(lens: Camera, rays: Floats, pixels: Floats) -> tuple[Floats, float]:
    """Return the rotation vector by which rays (n, 3) are turned so that the lens sees them at pixels, and the rms."""
    turn = np.eye(3)
    rms = np.inf
    for _ in range(_STEPS):
        turned = rays @ turn.T
        image = lens.project(turned)
        good = image.valid
        assert image.by_point is not None
        residual = (pixels - image.pixels)[good]
        rms = float(np.sqrt(np.mean(np.sum(residual**2, axis=1))))
        slopes = -image.by_point[good] @ skew(turned[good])
        step, *_ = np.linalg.lstsq(slopes.reshape(-1, 3), residual.ravel(), rcond=None)
        turn = rotation_from_rotvec(frozen_array(step)) @ turn
    return rotvec_from_rotation(turn), rms
