"""The scalars of a calibration: their names, their order in the covariance, and how a change of body frame moves them.

First come the scalars of every IMU, last the lever arms of its accelerometers, its pose and clock, the time shift of
its accelerometer and what the temperature changes, where it has them; then those of every camera. A matrix is listed
row by row. A rotation is named by its rotation vector; its covariance is that of a small rotation on the right
(`CameraCalibration`, `ImuCalibration`).

Units of the parameters of a calibration.
"""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import lru_cache
from typing import Protocol

import numpy as np

from ..errors import OptionError
from ..frozen import FrozenMapping, value_class
from ..geometry.rotation_vector import rotvec_from_rotation, skew
from ..models.frames import Origin, fixed_entries, frame_rotation, frame_turn, rotation_jacobian
from ..recording import Floats
from .sensors import CameraCalibration, ImuCalibration, rotate_imu, rotated_camera


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


_NO_CAMERAS: Mapping[str, CameraCalibration] = FrozenMapping({})


def calibration_parameters(
    imus: Mapping[str, ImuCalibration], cameras: Mapping[str, CameraCalibration] = _NO_CAMERAS
) -> Iterator[tuple[str, Floats]]:
    """Yield (path, value) of every parameter, in the order of the covariance."""
    for name, imu in imus.items():
        if imu.accelerometer is not None:
            yield f"{name}.accelerometer.sensitivity", imu.accelerometer.sensitivity
            yield f"{name}.accelerometer.bias", imu.accelerometer.bias
        if imu.gyroscope is not None:
            yield f"{name}.gyroscope.sensitivity", imu.gyroscope.sensitivity
            yield f"{name}.gyroscope.bias", imu.gyroscope.bias
            yield f"{name}.gyroscope.g_sensitivity", imu.gyroscope.g_sensitivity
        if imu.magnetometer is not None:
            yield f"{name}.magnetometer.sensitivity", imu.magnetometer.sensitivity
            yield f"{name}.magnetometer.bias", imu.magnetometer.bias
        if imu.accelerometer is not None and imu.accelerometer.lever_arms_m is not None:
            yield f"{name}.accelerometer.lever_arms_m", imu.accelerometer.lever_arms_m
        if imu.T_imu_body is not None:
            yield f"{name}.T_imu_body.rotation", rotvec_from_rotation(imu.T_imu_body[:3, :3])
            yield f"{name}.T_imu_body.translation", imu.T_imu_body[:3, 3]
            yield f"{name}.time_shift_imu", np.array(imu.time_shift_s)
        if imu.accelerometer is not None and imu.accelerometer.time_shift_s is not None:
            yield f"{name}.accelerometer.time_shift", np.array(imu.accelerometer.time_shift_s)
        if imu.temperature is not None:
            for part, coefficients in imu.temperature.parts():
                yield f"{name}.temperature.{part}", coefficients
    for name, camera in cameras.items():
        if name != camera.body:
            yield f"{name}.{camera.link}.rotation", rotvec_from_rotation(camera.T_cam_body[:3, :3])
            yield f"{name}.{camera.link}.translation", camera.T_cam_body[:3, 3]
        if camera.body == "imu0":
            yield f"{name}.time_shift_cam_imu", np.array(camera.time_shift_cam_imu)
            yield f"{name}.line_delay", np.array(camera.camera.line_delay_s)
        yield f"{name}.intrinsics", camera.camera.intrinsics
        yield f"{name}.distortion_coeffs", camera.camera.distortion_coeffs


@lru_cache(1000)
def element_names(path: str, shape: tuple[int, ...]) -> tuple[str, ...]:
    """Return the names of a parameter's scalars in row order, "imu0.gyroscope.bias[2]"; of a lone scalar its path."""
    return tuple([f"{path}[{','.join(map(str, index))}]" if index else path for index in np.ndindex(shape)])


def covariance_names(
    imus: Mapping[str, ImuCalibration], cameras: Mapping[str, CameraCalibration] = _NO_CAMERAS
) -> tuple[str, ...]:
    """Return the names of all scalars of all IMUs, then of all cameras, in the order of the covariance."""
    return tuple(
        name for path, value in calibration_parameters(imus, cameras) for name in element_names(path, value.shape)
    )


@value_class
class Moved:
    """Sensors in another body frame, or with another origin of it.

    Attributes
    ----------
    imus, cameras : as in a calibration
    jacobian : (n, n) derivative of all scalars by those before
    """

    imus: dict[str, ImuCalibration]
    cameras: dict[str, CameraCalibration]
    jacobian: Floats


def moved_into_frame(imus: Mapping[str, ImuCalibration], cameras: Mapping[str, CameraCalibration], frame: str) -> Moved:
    """Return the sensors in body frame "accel-x" or "accel-z", each IMU in its own, the cameras in that of the first.

    With f_new = Q f_old a camera sees T_new = T_old (Q', 0). Q itself depends on the accelerometer: where its scalars
    are off, the frame is turned by a further delta (`models.frames.frame_turn`). A camera's small rotation d, on the
    right, is therefore d_new = Q d_old + delta. An IMU beside the first has T_new = (Q_i, 0) T_old (Q', 0) with a Q_i
    and a delta_i of its own: d_new = Q d_old + delta - R_new' delta_i, and its translation t moves by
    dt_new = Q_i dt_old + t_new x delta_i.

    Raises
    ------
    OptionError
        If `frame` is neither, an IMU has no accelerometer to define it, or there are cameras alone.
    """
    if not imus:
        raise OptionError(
            f"{frame} is a body frame of an IMU, and this calibration is of cameras alone: its body is cam0."
        )
    moved: dict[str, ImuCalibration] = {}
    jacobian = np.eye(len(covariance_names(imus, cameras)))
    turn, by_sensitivity = np.eye(3), np.zeros((3, 9))
    start, at = 0, _starts(imus, cameras)
    for name, imu in imus.items():
        sensitivity = imu.required_accelerometer.sensitivity
        rotation = frame_rotation(sensitivity, frame)
        moved[name] = _with_exact_zeros(rotate_imu(imu, rotation), frame)
        block = rotation_jacobian(_matrices(imu), rotation, frame)
        own_turn = frame_turn(sensitivity, rotation, frame)
        if start == 0:
            turn, by_sensitivity = rotation, own_turn
        jacobian[start : start + len(block), start : start + len(block)] = block
        if imu.T_imu_body is not None:
            T = imu.T_imu_body.copy()
            T[:3, :3], T[:3, 3] = rotation @ T[:3, :3] @ turn.T, rotation @ T[:3, 3]
            moved[name] = replace(moved[name], T_imu_body=T)
            angle, place = at[f"{name}.T_imu_body.rotation"], at[f"{name}.T_imu_body.translation"]
            jacobian[angle : angle + 3, angle : angle + 3] = turn
            jacobian[angle : angle + 3, :9] += by_sensitivity
            jacobian[angle : angle + 3, start : start + 9] -= T[:3, :3].T @ own_turn
            jacobian[place : place + 3, place : place + 3] = rotation
            jacobian[place : place + 3, start : start + 9] += skew(T[:3, 3]) @ own_turn
        start += len(block)
    for camera in cameras.values():
        jacobian[start : start + 3, start : start + 3] = turn
        jacobian[start : start + 3, :9] = by_sensitivity
        start += len(covariance_names({}, {"": camera}))
    turned = {name: rotated_camera(camera, turn) for name, camera in cameras.items()}
    return Moved(imus=moved, cameras=turned, jacobian=jacobian)


def moved_to_origin(
    imus: Mapping[str, ImuCalibration], cameras: Mapping[str, CameraCalibration], origins: Mapping[str, Origin]
) -> Moved:
    """Return the sensors with the origin of each IMU at another point.

    With C_k and c the combination of the point (`Origin.combination`), which are held for exact, and r_k the places of
    the accelerometers, the origin moves by s = sum_k C_k r_k + c: a camera sees p_new = p_old + R_cam_imu s, and s is
    taken off all lever arms. An IMU without lever arms stays as it is, and the cameras move with the first one. An IMU
    beside the first, whose own origin moves by s_i, has t_new = t_old + R_imu_body s - s_i.

    Parameters
    ----------
    origins : of each IMU that shall move, by name
    """
    starts = _starts(imus, cameras)
    jacobian = np.eye(len(covariance_names(imus, cameras)))
    moved: dict[str, ImuCalibration] = {}
    body = _Shift(by=np.zeros(3))
    for name, imu in imus.items():
        arms = None if imu.accelerometer is None else imu.accelerometer.lever_arms_m
        own, moved[name] = _Shift(by=np.zeros(3)), imu
        if imu.accelerometer is not None and arms is not None and name in origins:
            at, weights = starts[f"{name}.accelerometer.lever_arms_m"], origins[name].combination[0]
            own = _Shift(by=origins[name].of(arms), columns=slice(at, at + 9), by_columns=np.hstack(list(weights)))
            own.subtract_from(jacobian, *range(at, at + 9, 3))
            accelerometer = replace(imu.accelerometer, lever_arms_m=_without_rounding(arms - own.by))
            moved[name] = replace(imu, accelerometer=accelerometer, origin=origins[name])
        if len(moved) == 1:
            body = own
        if imu.T_imu_body is not None:
            T = _with_moved_body(imu.T_imu_body, f"{name}.T_imu_body", body, starts, jacobian)
            T[:3, 3] -= own.by
            own.subtract_from(jacobian, starts[f"{name}.T_imu_body.translation"])
            moved[name] = replace(moved[name], T_imu_body=T)
    placed = {
        name: replace(
            camera, T_cam_body=_with_moved_body(camera.T_cam_imu, f"{name}.T_cam_imu", body, starts, jacobian)
        )
        for name, camera in (cameras.items() if imus else ())
    }
    return Moved(imus=moved, cameras=placed or dict(cameras), jacobian=jacobian)


@value_class
class _Shift:
    """How far an origin moves (3,) [m], IMU's axes, and its derivative (3, 9) by the lever arms in some columns."""

    by: Floats
    columns: slice | None = None
    by_columns: Floats | None = None

    def subtract_from(self, jacobian: Floats, *rows: int) -> None:
        """Fill in that the scalars (3,) from each row on become less by it."""
        if self.columns is not None and self.by_columns is not None:
            for row in rows:
                jacobian[row : row + 3, self.columns] -= self.by_columns


def _without_rounding(places: Floats) -> Floats:
    """Return places (3, 3) [m] with what is below a picometre, the rounding of a move, taken for zero."""
    return np.where(np.abs(places) < 1e-12, 0.0, places)


def _with_moved_body(T: Floats, path: str, by: _Shift, starts: Mapping[str, int], jacobian: Floats) -> Floats:
    """Return the pose of a sensor to the body (4, 4) after its origin moved, and fill in how its scalars follow.

    Parameters
    ----------
    path : of the pose
    by : from the old origin to the new one
    starts, jacobian : of all scalars
    """
    moved = T.copy()
    moved[:3, 3] += T[:3, :3] @ by.by
    rotation, row = starts[f"{path}.rotation"], starts[f"{path}.translation"]
    if by.columns is not None and by.by_columns is not None:
        jacobian[row : row + 3, rotation : rotation + 3] = -T[:3, :3] @ skew(by.by)
        jacobian[row : row + 3, by.columns] = T[:3, :3] @ by.by_columns
    return moved


def _starts(imus: Mapping[str, ImuCalibration], cameras: Mapping[str, CameraCalibration]) -> dict[str, int]:
    """Return where the scalars of each parameter start in the covariance."""
    starts: dict[str, int] = {}
    count = 0
    for path, value in calibration_parameters(imus, cameras):
        starts[path] = count
        count += value.size
    return starts


def _with_exact_zeros(imu: ImuCalibration, frame: str) -> ImuCalibration:
    """Return the IMU without the rounding that a rotation leaves in the elements that the frame makes zero."""
    accelerometer = imu.required_accelerometer
    sensitivity = accelerometer.sensitivity.copy()
    for entry in fixed_entries(frame):
        sensitivity[entry] = 0.0
    return replace(imu, accelerometer=replace(accelerometer, sensitivity=sensitivity))


def _matrices(imu: ImuCalibration) -> list[Floats]:
    """Return the parameters; what the temperature changes, which refers to sensor axes, as scalars in a row."""
    return [value.ravel() if ".temperature." in path else value for path, value in calibration_parameters({"": imu})]
