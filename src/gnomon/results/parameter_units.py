"""Units of the parameters of a calibration."""

from collections.abc import Mapping
from typing import Protocol

import numpy as np

from .parameters import calibration_parameters
from .sensors import CameraCalibration, ImuCalibration


class Calibrated(Protocol):
    """What has parameters."""

    @property
    def imus(self) -> Mapping[str, ImuCalibration]:
        """IMUs by their names."""
        ...

    @property
    def cameras(self) -> Mapping[str, CameraCalibration]:
        """Cameras by their names."""
        ...


_SI = {"accelerometer": "m/s^2", "gyroscope": "rad/s"}
_IMU = {
    "T_imu_body.rotation": "rad",
    "T_imu_body.translation": "m",
    "time_shift_imu": "s",
    "accelerometer.time_shift": "s",
}
_CAMERA = {
    "T_cam_imu.rotation": "rad",
    "T_cam_imu.translation": "m",
    "T_cam_cam0.rotation": "rad",
    "T_cam_cam0.translation": "m",
    "time_shift_cam_imu": "s",
    "line_delay": "s",
    "intrinsics": "px",
    "distortion_coeffs": "1",
}


def parameter_unit(calibration: Calibrated, path: str) -> str:
    """Return the unit of a parameter by its path, such as "count/(m/s^2)" for "imu0.accelerometer.sensitivity".

    Of a camera's intrinsics it is that of the focal lengths and the principal point; see `element_units`.
    """
    name, _, rest = path.partition(".")
    if name in calibration.cameras:
        return _CAMERA[rest]
    if rest in _IMU:
        return _IMU[rest]
    triad, parameter = rest.split(".")
    imu = calibration.imus[name]
    if triad == "temperature":
        triad, parameter = parameter.split("_", 1)
    if parameter == "lever_arms_m":
        return "m"
    sensor = getattr(imu, triad)
    if parameter == "bias":
        return sensor.unit
    if ".temperature." in path:
        return "1" if parameter == "sensitivity" else unit_ratio(sensor.unit, imu.required_accelerometer.unit)
    physical = sensor.field_unit if triad == "magnetometer" else _SI[triad]
    return unit_ratio(sensor.unit, "m/s^2" if parameter == "g_sensitivity" else physical)


def element_units(calibration: Calibrated, path: str) -> list[str]:
    """Return the units of a parameter's scalars; the first intrinsics of some lenses are pure numbers."""
    count = np.size(dict(calibration_parameters(calibration.imus, calibration.cameras))[path])
    units = [parameter_unit(calibration, path)] * count
    if ".temperature." in path:
        each = count // len(dict(calibration_parameters(calibration.imus, calibration.cameras))[path])
        return [unit_ratio(unit, f"K^{i // each + 1}" if i >= each else "K") for i, unit in enumerate(units)]
    return ["1"] * (count - 4) + units[-4:] if path.endswith(".intrinsics") else units


def unit_ratio(unit: str, other: str) -> str:
    """Return `unit` divided by `other`.

    Examples
    --------
    >>> unit_ratio("count", "m/s^2"), unit_ratio("rad/s", "rad/s"), unit_ratio("m/s^2", "count")
    ('count/(m/s^2)', '1', '(m/s^2)/count')
    """
    if unit == other:
        return "1"
    return "/".join(f"({part})" if "/" in part else part for part in (unit, other))
