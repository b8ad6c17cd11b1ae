"""A lens with k3 (radtan5) for programs that know radtan without: the coefficients that come nearest over the image."""

from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np

from ...frozen import value_class
from ...models.camera import Camera
from ...models.projections import PROJECTIONS
from ...results.calibration import Calibration, CameraCalibration
from .losses import Loss

_GRID = 40  # pixels of the grid along each side of the image


@value_class
class NearestLens:
    """A lens of a simpler model, and how far its pixels are from those of the first [px]."""

    camera: Camera
    rms_px: float = 0.0
    largest_px: float = 0.0


def without_k3(camera: Camera) -> NearestLens:
    """Return the radtan lens that is nearest to a radtan5 one, focal lengths and principal point kept; others as is."""
    if camera.distortion != "radtan5":
        return NearestLens(camera=camera)
    width, height = camera.resolution
    u, v = np.meshgrid(np.linspace(0, width - 1, _GRID), np.linspace(0, height - 1, _GRID))
    pixels = np.column_stack([u.ravel(), v.ravel()])
    rays, valid = camera.unproject(pixels)
    rays, pixels = rays[valid], pixels[valid]
    shape = tuple(camera.intrinsics[:-4].tolist())
    x, y, z = rays[:, 0], rays[:, 1], rays[:, 2]
    divisor = PROJECTIONS[camera.projection].divide(shape, x, y, z, False).value
    mx, my = x / divisor, y / divisor
    s, cross = mx * mx + my * my, 2 * mx * my
    fu, fv, pu, pv = camera.intrinsics[-4:].tolist()
    rows_u = fu * np.column_stack([s * mx, s * s * mx, cross, s + 2 * mx * mx])
    rows_v = fv * np.column_stack([s * my, s * s * my, s + 2 * my * my, cross])
    wanted = pixels - np.column_stack([fu * mx + pu, fv * my + pv])
    coeffs = np.linalg.lstsq(np.vstack([rows_u, rows_v]), wanted.T.ravel(), rcond=None)[0]
    nearest = replace(camera, distortion="radtan", distortion_coeffs=coeffs)
    off = np.linalg.norm(wanted - np.column_stack([rows_u @ coeffs, rows_v @ coeffs]), axis=1)
    return NearestLens(camera=nearest, rms_px=float(np.sqrt(np.mean(off**2))), largest_px=float(off.max()))


def cameras_without_k3(cameras: Mapping[str, CameraCalibration]) -> dict[str, CameraCalibration]:
    """Return the cameras with such lenses."""
    return {name: replace(camera, camera=without_k3(camera.camera).camera) for name, camera in cameras.items()}


def k3_losses(calibration: Calibration, whose: str) -> Iterator[Loss]:
    """Say what leaving out k3 costs."""
    for name, camera in calibration.cameras.items():
        if camera.camera.distortion == "radtan5":
            nearest = without_k3(camera.camera)
            yield Loss(
                what=f"k3 of {name}",
                why=f"{whose} knows k1, k2, p1 and p2 only; they were chosen anew to be nearest over the image.",
                size=f"{nearest.rms_px:.2g} px rms, up to {nearest.largest_px:.2g} px",
            )
