"""The scalars of a rig as people read them: poses both ways, time shifts and lenses, each with its sigma."""

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

IMU_EQUATION = (
    "p_imu = R p_body + t, rows of R: axes of this IMU, columns: body axes (imu0's); p: the IMU in the body frame; "
    "t_imu0 = t_imu + time_shift_imu"
)
"""The same of an IMU beside imu0."""

Known = tuple[Entry, float]


def camera_equation(calibration: Calibration) -> str:
    """Return what the names of a calibration's cameras mean: of other projects' rigs no IMU's errors need be known."""
    on_body = any(camera.body == "imu0" for camera in calibration.cameras.values())
    return EQUATION if on_body else EQUATION_ALONE


def camera_entries(calibration: Calibration, name: str) -> Iterator[Known]:
    """Yield the scalars of one camera with their standard deviations."""
    calibrated = calibration.cameras[name]
    if name != calibrated.body:
        yield from _pose(calibration, name, calibrated.link, calibrated.T_cam_body)
    if calibrated.body == "imu0":
        yield from _scaled(calibration, name, "time_shift_cam_imu", 1e3, "ms")
        yield from _scaled(calibration, name, "line_delay", 1e6, "us")
    first, pixels, coeffs = _lens_names(calibrated.camera)
    intrinsics, sigma = calibrated.camera.intrinsics, calibration.sigma(f"{name}.intrinsics")
    yield from _block(name, first, intrinsics[:-4], sigma[:-4], "1")
    yield from _block(name, pixels, intrinsics[-4:], sigma[-4:], "px")
    bent = calibration.sigma(f"{name}.distortion_coeffs")
    yield from _block(name, coeffs, calibrated.camera.distortion_coeffs, bent, "1")


def imu_entries(calibration: Calibration, name: str) -> Iterator[Known]:
    """Yield the scalars of the pose and the clock of one IMU beside the body, with their standard deviations."""
    pose = calibration.imus[name].T_imu_body
    if pose is not None:
        yield from _pose(calibration, name, "T_imu_body", pose)
        yield from _scaled(calibration, name, "time_shift_imu", 1e3, "ms")


def _block(name: str, entries: list[str], values: Floats, sigmas: Floats, unit: str) -> Iterator[Known]:
    for entry, value, sigma in zip(entries, values.tolist(), sigmas.tolist(), strict=True):
        yield Entry(triad=name, name=entry, value=value, unit=unit), sigma


def _scaled(calibration: Calibration, name: str, label: str, factor: float, unit: str) -> Iterator[Known]:
    value, sigma = calibration.parameter(f"{name}.{label}"), calibration.sigma(f"{name}.{label}")
    yield from _block(name, [label], np.atleast_1d(value) * factor, np.atleast_1d(sigma) * factor, unit)


def _pose(calibration: Calibration, name: str, link: str, T: Floats) -> Iterator[Known]:
    """Yield R and t of p_sensor = T p_body, and p, the place of the sensor in the body frame."""
    path = f"{name}.{link}"
    R, t = T[:3, :3], T[:3, 3]
    covariance = calibration.covariance(f"{path}.rotation", f"{path}.translation")
    turns = R @ skew(np.eye(3))  # by the small rotation: dR = R [delta]x
    by_turn = turns.reshape(3, 9).T
    names = [f"R_{'xyz'[i]}{'xyz'[j]}" for i, j in np.ndindex(3, 3)]
    yield from _block(name, names, R.ravel(), _sigmas(by_turn, covariance[:3, :3]), "1")
    yield from _block(name, [f"t_{axis}" for axis in "xyz"], t, calibration.sigma(f"{path}.translation"), "m")
    position = -R.T @ t
    by_both = np.hstack([skew(position), -R.T])
    yield from _block(name, [f"p_{axis}" for axis in "xyz"], position, _sigmas(by_both, covariance), "m")


def _sigmas(jacobian: Floats, covariance: Floats) -> Floats:
    variance = np.einsum("ij,jk,ik->i", jacobian, covariance, jacobian)
    return np.sqrt(np.maximum(variance, 0.0))  # rounding may leave less than nothing of a fixed rotation


def _lens_names(camera: Camera) -> tuple[list[str], list[str], list[str]]:
    coeffs = DISTORTIONS[camera.distortion].names
    return list(PROJECTIONS[camera.projection].names), ["fu", "fv", "pu", "pv"], list(coeffs)
