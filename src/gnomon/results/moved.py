"""Sensors in another body frame, with another origin or at one temperature.

Each with the derivative of all scalars by those before, by which the covariance moves along.
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from ..errors import OptionError
from ..frozen import value_class
from ..geometry.rotations import fixed_entries, frame_rotation, frame_turn, rotation_jacobian, skew
from ..models.origin import Origin
from ..recording import Floats
from .sensors import TRIADS, CameraCalibration, ImuCalibration, calibration_parameters, covariance_names
from .temperature_dependence import TemperatureDependence

_NEAR_K = 0.5
"""How far beyond the range a temperature still counts as in it."""


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
    are off, the frame is turned by a further delta (`frame_turn`). A camera's small rotation d, on the
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


def rotate_imu(imu: ImuCalibration, rotation: Floats) -> ImuCalibration:
    """Return the IMU with its body frame turned: f_new = rotation @ f_old, (3, 3)."""
    accelerometer, gyroscope, magnetometer = imu.accelerometer, imu.gyroscope, imu.magnetometer
    if accelerometer is not None:
        arms = accelerometer.lever_arms_m
        accelerometer = replace(
            accelerometer,
            sensitivity=accelerometer.sensitivity @ rotation.T,
            lever_arms_m=None if arms is None else arms @ rotation.T,
        )
    if gyroscope is not None:
        gyroscope = replace(
            gyroscope,
            sensitivity=gyroscope.sensitivity @ rotation.T,
            g_sensitivity=gyroscope.g_sensitivity @ rotation.T,
        )
    if magnetometer is not None:
        magnetometer = replace(magnetometer, sensitivity=magnetometer.sensitivity @ rotation.T)
    origin = None if imu.origin is None else imu.origin.turned(rotation)
    return replace(imu, accelerometer=accelerometer, gyroscope=gyroscope, magnetometer=magnetometer, origin=origin)


def rotated_camera(camera: CameraCalibration, rotation: Floats) -> CameraCalibration:
    """Return the camera with the body frame turned: f_new = rotation @ f_old, (3, 3); the body's origin stays."""
    moved = camera.T_cam_body.copy()
    moved[:3, :3] = camera.T_cam_body[:3, :3] @ rotation.T
    return replace(camera, T_cam_body=moved)


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


def imus_at_temperature(
    imus: Mapping[str, ImuCalibration], cameras: Mapping[str, CameraCalibration], degc: float
) -> Moved:
    """Return the IMUs as they are at a temperature, which then depend on it no longer.

    Parameters
    ----------
    degc : of all that know how they change [degC]

    Returns
    -------
    With a jacobian (m, n) of the scalars that remain by those before.

    Raises
    ------
    OptionError
        If it is beyond the range in which an IMU knows it.
    """
    before = {name: i for i, name in enumerate(covariance_names(imus, cameras))}
    moved = {name: _at(name, imu, degc) for name, imu in imus.items()}
    after = covariance_names(moved, cameras)
    jacobian = np.zeros((len(after), len(before)))
    for row, scalar in enumerate(after):
        jacobian[row, before[scalar]] = 1.0
    places = {scalar: i for i, scalar in enumerate(after)}
    for name, imu in imus.items():
        if imu.temperature is None:
            continue
        for path, value in calibration_parameters({name: replace(imu, temperature=None)}):
            triad, _, kind = path.removeprefix(f"{name}.").partition(".")
            if triad in TRIADS and kind in {"bias", "sensitivity", "g_sensitivity"}:
                rows = [places[f"{path}[{','.join(map(str, index))}]"] for index in np.ndindex(value.shape)]
                changed = value
                if kind == "g_sensitivity":
                    changed = value + _own_change(imu, degc)
                    jacobian[rows] += _more_of_own(before, name, imu, degc)
                jacobian[rows] += _more(before, imu.temperature, (name, triad, kind), changed, degc)
    return Moved(imus=moved, cameras=dict(cameras), jacobian=jacobian)


def _at(name: str, imu: ImuCalibration, degc: float) -> ImuCalibration:
    found = imu.temperature
    if found is None:
        return imu
    if found.changes and not found.low_degc - _NEAR_K <= degc <= found.high_degc + _NEAR_K:
        raise OptionError(
            f"{name} is known from {found.low_degc:.1f} to {found.high_degc:.1f} degC, and not at {degc:.1f} degC."
        )
    changed = {}
    for triad in TRIADS:
        sensor = getattr(imu, triad)
        if sensor is None:
            continue
        larger = np.eye(3) + found.change(f"{triad}_sensitivity", np.array([degc]))[0]
        bias = sensor.bias + found.change(f"{triad}_bias", np.array([degc]))[0]
        changed[triad] = replace(sensor, sensitivity=larger @ sensor.sensitivity, bias=bias)
        if triad == "gyroscope":
            felt = larger @ (sensor.g_sensitivity + _own_change(imu, degc))
            changed[triad] = replace(changed[triad], g_sensitivity=felt)
    return replace(imu, temperature=None, **changed)


def _own_change(imu: ImuCalibration, degc: float) -> Floats:
    """Return by how much the g-sensitivity changes by itself, (3, 3) [unit of the gyroscope per m/s^2]."""
    if imu.temperature is None or imu.temperature.gyroscope_g_sensitivity is None:
        return np.zeros((3, 3))
    change = imu.temperature.change("gyroscope_g_sensitivity", np.array([degc]))[0]
    return change @ imu.required_accelerometer.sensitivity


def _more_of_own(before: Mapping[str, int], name: str, imu: ImuCalibration, degc: float) -> Floats:
    """Return the derivative (9, n) of the g-sensitivity, (1 + D) (G + H S) with S of the accelerometer, by H and S."""
    rows = np.zeros((9, len(before)))
    found = imu.temperature
    if found is None or found.gyroscope_g_sensitivity is None:
        return rows
    larger = np.eye(3) + found.change("gyroscope_sensitivity", np.array([degc]))[0]
    by_sensitivity = larger @ found.change("gyroscope_g_sensitivity", np.array([degc]))[0]
    sensitivity = imu.required_accelerometer.sensitivity
    d = float(np.clip(degc, found.low_degc, found.high_degc)) - found.reference_degc
    path = f"{name}.temperature.gyroscope_g_sensitivity"
    for (r, c), row in zip(np.ndindex(3, 3), rows, strict=True):
        for m in range(3):
            row[before[f"{name}.accelerometer.sensitivity[{m},{c}]"]] = by_sensitivity[r, m]
            for n, j in np.ndindex(3, len(found.gyroscope_g_sensitivity)):
                row[before[f"{path}[{j},{n},{m}]"]] = larger[r, n] * d ** (j + 1) * sensitivity[m, c]
    return rows


def _more(
    before: Mapping[str, int], found: TemperatureDependence, which: tuple[str, str, str], value: Floats, degc: float
) -> Floats:
    """Return what the derivative of a bias or a matrix has beside that by itself at the reference, (k, n)."""
    name, triad, kind = which
    part = f"{triad}_{'bias' if kind == 'bias' else 'sensitivity'}"
    coefficients: Floats | None = getattr(found, part)
    rows = np.zeros((value.size, len(before)))
    if coefficients is None:
        return rows
    d = float(np.clip(degc, found.low_degc, found.high_degc)) - found.reference_degc
    path = f"{name}.temperature.{part}"
    powers = [d ** (j + 1) for j in range(len(coefficients))]
    if kind == "bias":
        for axis, row in enumerate(rows):
            for j, power in enumerate(powers):
                row[before[f"{path}[{j},{axis}]"]] = power
        return rows
    # M(T) = (1 + D) M: its entry (r, c) moves by sum_n (1 + D)_rn dM_nc + sum_n dD_rn M_nc
    relative = found.change(part, np.array([degc]))[0]
    for (r, c), row in zip(np.ndindex(3, 3), rows, strict=True):
        for n in range(3):
            row[before[f"{name}.{triad}.{kind}[{n},{c}]"]] = relative[r, n]
            for j, power in enumerate(powers):
                row[before[f"{path}[{j},{r},{n}]"]] = power * value[n, c]
    return rows
