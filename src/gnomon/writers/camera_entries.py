"""The scalars of a camera as people read them: its pose both ways, its time shift and its lens, each with its sigma."""

from collections.abc import Iterator

import numpy as np

from ..calibration import Calibration
from ..geometry.so3 import skew
from ..models.camera import Camera
from ..models.distortions import DISTORTIONS
from ..models.projections import PROJECTIONS
from ..recording import Floats
from .form_entries import Entry

EQUATION = (
    "p_cam = R p_imu + t, rows of R: camera axes, columns: body axes; p: the camera in the body frame; "
    "t_imu = t_cam + time_shift_cam_imu"
)

EQUATION_ALONE = (
    "p_cam = R p_cam0 + t, rows of R: camera axes, columns: axes of cam0; p: the camera in the frame of cam0"
)
"""The same of cameras without an IMU."""

Known = tuple[Entry, float]


def camera_equation(calibration: Calibration) -> str:
    """Return what the names of a calibration's cameras mean."""
    return EQUATION if calibration.imus else EQUATION_ALONE


def camera_entries(calibration: Calibration, name: str) -> Iterator[Known]:
    """Yield the scalars of one camera with their standard deviations."""
    calibrated = calibration.cameras[name]

    def block(names: list[str], values: Floats, sigmas: Floats, unit: str) -> Iterator[Known]:
        for entry, value, sigma in zip(names, values.tolist(), sigmas.tolist(), strict=True):
            yield Entry(triad=name, name=entry, value=value, unit=unit), sigma

    def scaled(path: str, label: str, factor: float, unit: str) -> Iterator[Known]:
        value, sigma = calibration.parameter(f"{name}.{path}"), calibration.sigma(f"{name}.{path}")
        yield from block([label], np.atleast_1d(value) * factor, np.atleast_1d(sigma) * factor, unit)

    if name != calibrated.body:
        for names, values, sigmas, unit in _pose(calibration, name):
            yield from block(names, values, sigmas, unit)
    if calibrated.body == "imu0":
        yield from scaled("time_shift_cam_imu", "time_shift_cam_imu", 1e3, "ms")
        yield from scaled("line_delay", "line_delay", 1e6, "us")
    first, pixels, coeffs = _lens_names(calibrated.camera)
    intrinsics, sigma = calibrated.camera.intrinsics, calibration.sigma(f"{name}.intrinsics")
    yield from block(first, intrinsics[:-4], sigma[:-4], "1")
    yield from block(pixels, intrinsics[-4:], sigma[-4:], "px")
    yield from block(coeffs, calibrated.camera.distortion_coeffs, calibration.sigma(f"{name}.distortion_coeffs"), "1")


def _pose(calibration: Calibration, name: str) -> Iterator[tuple[list[str], Floats, Floats, str]]:
    """Yield names, values, standard deviations and unit of R, t and p."""
    calibrated = calibration.cameras[name]
    path = f"{name}.{calibrated.link}"
    R, t = calibrated.T_cam_body[:3, :3], calibrated.T_cam_body[:3, 3]
    covariance = calibration.covariance(f"{path}.rotation", f"{path}.translation")
    turns = R @ skew(np.eye(3))  # by the small rotation: dR = R [delta]x
    by_turn = turns.reshape(3, 9).T
    names = [f"R_{'xyz'[i]}{'xyz'[j]}" for i, j in np.ndindex(3, 3)]
    yield names, R.ravel(), _sigmas(by_turn, covariance[:3, :3]), "1"
    yield [f"t_{axis}" for axis in "xyz"], t, calibration.sigma(f"{path}.translation"), "m"
    position = -R.T @ t
    by_both = np.hstack([skew(position), -R.T])
    yield [f"p_{axis}" for axis in "xyz"], position, _sigmas(by_both, covariance), "m"


def _sigmas(jacobian: Floats, covariance: Floats) -> Floats:
    variance = np.einsum("ij,jk,ik->i", jacobian, covariance, jacobian)
    return np.sqrt(np.maximum(variance, 0.0))  # rounding may leave less than nothing of a fixed rotation


def _lens_names(camera: Camera) -> tuple[list[str], list[str], list[str]]:
    coeffs = DISTORTIONS[camera.distortion].names
    return list(PROJECTIONS[camera.projection].names), ["fu", "fv", "pu", "pv"], list(coeffs)
