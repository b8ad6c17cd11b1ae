"""Calibrated sensors: an IMU's triads, and the camera that moves with them; their parameters, named and in units.

The one sensor model of gnomon (see docs/theory): with specific force f [m/s^2], angular rate omega [rad/s] and magnetic
field m [uT, or the local field's strength] in the body frame, and measurements in the unit of the recording,

    accelerometer = sensitivity @ f + bias
    gyroscope     = sensitivity @ omega + bias + g_sensitivity @ f
    magnetometer  = sensitivity @ m + bias

at one temperature; how it changes is a `TemperatureDependence`. The models of Tedaldi, Krebs and Angrisano and of other
projects are exact views of it.

The scalars in the order of the covariance: first come those of every IMU, last the lever arms of its accelerometers,
its pose and clock, the time shift of its accelerometer and what the temperature changes, where it has them; then those
of every camera. A matrix is listed row by row. A rotation is named by its rotation vector; its covariance is that of a
small rotation on the right (`CameraCalibration`, `ImuCalibration`).
"""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import lru_cache
from typing import Any, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from ..errors import FormatError, OptionError
from ..frozen import FrozenMapping, value_class
from ..geometry.rotations import rotvec_from_rotation
from ..models.camera import Camera
from ..models.origin import Origin
from ..recording import Floats, ImuSamples, Integers, TemperatureSamples, TriadSamples, frozen_array
from ..recording.thermometer import TemperatureCourse, temperature_course
from .temperature_dependence import TemperatureDependence

TRIADS = ("accelerometer", "gyroscope", "magnetometer")

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


@value_class
class AccelerometerCalibration:
    """measured = sensitivity @ f + bias.

    Where the three accelerometers do not sit at one point, component k of f is that at the place r_k of the k-th one:
    f_k + (alpha x r_k + omega x (omega x r_k))_k, with f that at the body's origin, omega the angular rate and alpha
    the angular acceleration (the size effect, as Kalibr's scale-misalignment-size-effect has it, in frame accel-x).

    Attributes
    ----------
    sensitivity : (3, 3) [unit per m/s^2], body frame to sensor axes
    bias : (3,) [unit], sensor axes
    unit : unit of the measurements
    lever_arms_m : (3, 3) where the x, y and z accelerometers sit, one row each, from the body's origin, body frame; or
        None where they are taken to be at one point, the body's origin
    time_shift_s : t_gyroscope = t_accelerometer + time_shift_s, of the timestamps of one instant [s]; None where both
        have the same clock and delay
    """

    sensitivity: Floats
    bias: Floats
    unit: str
    lever_arms_m: Floats | None = None
    time_shift_s: float | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "sensitivity", frozen_array(self.sensitivity))
        object.__setattr__(self, "bias", frozen_array(self.bias))
        if self.lever_arms_m is not None:
            object.__setattr__(self, "lever_arms_m", frozen_array(self.lever_arms_m))

    def with_gyroscope(self, t_ns: Integers) -> Integers:
        """Return the timestamps (n,) that the gyroscope's readings of the same instants have [ns]."""
        return t_ns + round(1e9 * self.time_shift_s) if self.time_shift_s else t_ns

    def specific_force(self, values: Floats) -> Floats:
        """Return the specific force in the body frame, (n, 3) [m/s^2], of measurements (n, 3) [unit].

        Lever arms are not taken off: component k stays that at the k-th accelerometer. Taking it to the body's origin
        needs the angular acceleration, and a gyroscope's derivative is noisier than what there is to gain.
        """
        return _mapped(np.linalg.inv(self.sensitivity), values - self.bias)


@value_class
class GyroscopeCalibration:
    """measured = sensitivity @ omega + bias + g_sensitivity @ f.

    Attributes
    ----------
    sensitivity : (3, 3) [unit per rad/s], body frame to sensor axes
    bias : (3,) [unit], sensor axes
    g_sensitivity : (3, 3) [unit per m/s^2], body frame to sensor axes
    unit : unit of the measurements
    """

    sensitivity: Floats
    bias: Floats
    g_sensitivity: Floats
    unit: str

    def __post_init__(self) -> None:
        object.__setattr__(self, "sensitivity", frozen_array(self.sensitivity))
        object.__setattr__(self, "bias", frozen_array(self.bias))
        object.__setattr__(self, "g_sensitivity", frozen_array(self.g_sensitivity))

    def angular_rate(self, values: Floats, specific_force: Floats) -> Floats:
        """Return the angular rate in the body frame, (n, 3) [rad/s].

        Parameters
        ----------
        values : (n, 3) [unit]
        specific_force : (n, 3) [m/s^2], body frame, at the same instants
        """
        unbiased = values - self.bias - _mapped(self.g_sensitivity, specific_force)
        return _mapped(np.linalg.inv(self.sensitivity), unbiased)


def _mapped(matrix: NDArray[np.floating[Any]], vectors: Floats) -> Floats:
    """Return matrix @ v of vectors (..., 3), rounded alike however many there are, which BLAS does not promise."""
    x, y, z = np.moveaxis(vectors, -1, 0)
    return np.stack([row[0] * x + row[1] * y + row[2] * z for row in matrix], axis=-1)


@value_class
class MagnetometerCalibration:
    """measured = sensitivity @ m + bias.

    Attributes
    ----------
    sensitivity : (3, 3) [unit per field_unit], body frame to sensor axes; what iron that is magnetised by the field
        ("soft iron") does is part of it
    bias : (3,) [unit], sensor axes; magnetised parts ("hard iron") and the sensor's own offset
    unit : unit of the measurements
    field_unit : unit of the calibrated field: "uT", or "local field" where the strength of the field was not stated and
        is 1
    """

    sensitivity: Floats
    bias: Floats
    unit: str
    field_unit: str = "local field"

    def __post_init__(self) -> None:
        object.__setattr__(self, "sensitivity", frozen_array(self.sensitivity))
        object.__setattr__(self, "bias", frozen_array(self.bias))

    def magnetic_field(self, values: Floats) -> Floats:
        """Return the magnetic field in the body frame, (n, 3) [field_unit], of measurements (n, 3) [unit]."""
        return _mapped(np.linalg.inv(self.sensitivity), values - self.bias)


@value_class
class ImuCalibration:
    """The triads of one IMU, in one body frame; those that were not calibrated are None.

    Of several IMUs the body is the first one, imu0. Every other one has a frame of its own, to which its triads refer,
    and tells how it lies to the body.

    The covariance of a Calibration holds, for an IMU with a pose, "imu1.T_imu_body.rotation[0..2]" (small rotation
    delta on the right, R_imu_body Exp(delta), body frame) [rad], "imu1.T_imu_body.translation[0..2]" (the last column
    of T_imu_body) [m] and "imu1.time_shift_imu" [s]; for an accelerometer with a time shift of its own
    "imu0.accelerometer.time_shift" [s].

    Attributes
    ----------
    accelerometer, gyroscope, magnetometer : None where not calibrated
    T_imu_body : (4, 4) body coordinates to those of this IMU, p_imu = T_imu_body @ p_body [m]; None of the IMU that is
        the body
    time_shift_s : t_body = t_imu + time_shift_s, of the timestamps of both gyroscopes [s]
    origin : which point of the IMU its origin is, to which T_cam_imu, T_imu_body and the lever arms of its
        accelerometers refer; of accelerometers that are taken to be at one point, which one of their true places that
        stands for; None where nobody knows

    Raises
    ------
    FormatError
        If there is no triad at all.
    """

    accelerometer: AccelerometerCalibration | None = None
    gyroscope: GyroscopeCalibration | None = None
    magnetometer: MagnetometerCalibration | None = None
    T_imu_body: Floats | None = None
    time_shift_s: float = 0.0
    origin: Origin | None = None
    temperature: TemperatureDependence | None = None

    def __post_init__(self) -> None:
        if self.T_imu_body is not None:
            object.__setattr__(self, "T_imu_body", frozen_array(self.T_imu_body))
        if self.accelerometer is None and self.gyroscope is None and self.magnetometer is None:
            raise FormatError("a calibrated IMU needs an accelerometer, a gyroscope or a magnetometer.")

    @property
    def required_accelerometer(self) -> AccelerometerCalibration:
        """The accelerometer, for what cannot do without.

        Raises
        ------
        OptionError
            If it was not calibrated.
        """
        if self.accelerometer is None:
            raise OptionError(
                "this calibration holds no accelerometer, which is needed here. Calibrate one with gnomon imu, "
                "and give its calibration.yaml."
            )
        return self.accelerometer

    def apply(self, samples: ImuSamples) -> ImuSamples:
        """Turn measurements into specific force [m/s^2], angular rate [rad/s] and magnetic field in the IMU's frame.

        Of the first IMU, and of the only one, that is the body frame. Timestamps stay those of its own clock, but for
        an accelerometer with a time shift: its timestamps become those of the gyroscope's readings of the same
        instants. A triad that was not calibrated keeps its measurements. Each component of the specific force stays
        that at its own accelerometer: lever arms are not applied. The g-sensitivity of the gyroscope needs the specific
        force at the timestamps of the gyroscope; where the two triads have timestamps of their own it is interpolated
        linearly.

        Where the triads change with the temperature, the samples need their thermometer's readings.

        Raises
        ------
        FormatError
            If the samples are not in the unit for which the calibration was made, or there is no specific force where
            the gyroscope's g-sensitivity needs it, or no temperature where the calibration needs it.
        """
        self._check_units(samples)
        temperature = samples.temperature
        samples = self.at_reference(samples)
        accelerometer, gyroscope, magnetometer = samples.accelerometer, samples.gyroscope, samples.magnetometer
        if self.accelerometer is not None:
            force = self.accelerometer.specific_force(accelerometer.values)
            t_ns = self.accelerometer.with_gyroscope(accelerometer.t_ns)
            accelerometer = TriadSamples(t_ns=t_ns, values=force, unit="m/s^2")
        if self.gyroscope is not None:
            force = interpolate_triad(accelerometer, gyroscope) if self.feels_force else np.zeros((len(gyroscope), 3))
            rate = self.angular_rate(gyroscope, force, self.temperature_course(temperature))
            gyroscope = TriadSamples(t_ns=gyroscope.t_ns, values=rate, unit="rad/s")
        if self.magnetometer is not None and magnetometer is not None:
            field = self.magnetometer.magnetic_field(magnetometer.values)
            magnetometer = TriadSamples(t_ns=magnetometer.t_ns, values=field, unit=self.magnetometer.field_unit)
        return ImuSamples(accelerometer=accelerometer, gyroscope=gyroscope, magnetometer=magnetometer)

    def at_reference(self, samples: ImuSamples) -> ImuSamples:
        """Return the samples as they would be at the reference temperature; as they are where nothing depends on it.

        What the g-sensitivity changes by itself needs the specific force, and is left to `angular_rate`.

        Raises
        ------
        FormatError
            If they need a temperature, and have none that is known.
        """
        course = self.temperature_course(samples.temperature)
        if course is None:
            return samples
        there = {name: stream for name in TRIADS if (stream := getattr(samples, name)) is not None}
        return replace(
            samples, **{name: self.triad_at_reference(name, stream, course) for name, stream in there.items()}
        )

    def temperature_course(self, temperature: TemperatureSamples | None) -> TemperatureCourse | None:
        """Return the temperature of the sensor by its thermometer's readings; None where nothing depends on it.

        Raises
        ------
        FormatError
            If something does, and there are no readings whose unit is known.
        """
        if self.temperature is None or not self.temperature.changes:
            return None
        course = None if temperature is None else temperature_course(temperature, self.temperature.lag_s)
        if course is None:
            raise FormatError(
                "this calibration depends on the temperature, and the recording has no thermometer whose unit is "
                "known: record a column temp_degC, or state the temperature (--temperature-c)."
            )
        return course

    def triad_at_reference(self, name: str, stream: TriadSamples, course: TemperatureCourse) -> TriadSamples:
        """Return samples of a triad, of any kind, as they would be at the reference temperature."""
        triad = getattr(self, name)
        if self.temperature is None or triad is None:
            return stream
        values = self.temperature.to_reference(name, stream.values, course.at(stream.t_ns), triad.bias)
        return replace(stream, values=values)

    @property
    def feels_force(self) -> bool:
        """Whether the gyroscope's readings depend on the specific force, at any temperature."""
        changes = self.temperature is not None and self.temperature.gyroscope_g_sensitivity is not None
        return self.gyroscope is not None and (changes or bool(self.gyroscope.g_sensitivity.any()))

    def angular_rate(self, stream: TriadSamples, force: Floats, course: TemperatureCourse | None) -> Floats:
        """Return the angular rate (n, 3) [rad/s] of readings at the reference, but for what changes the g-sensitivity.

        Parameters
        ----------
        force : (n, 3) specific force, body frame [m/s^2]
        course : of the temperature; None where nothing depends on it
        """
        assert self.gyroscope is not None
        values, found = stream.values, self.temperature
        if course is not None and found is not None and found.gyroscope_g_sensitivity is not None:
            change = found.change("gyroscope_g_sensitivity", course.at(stream.t_ns))
            readings = force @ self.required_accelerometer.sensitivity.T
            values = values - (change @ readings[:, :, None])[:, :, 0]
        return self.gyroscope.angular_rate(values, force)

    def _check_units(self, samples: ImuSamples) -> None:
        pairs = (
            (self.accelerometer, samples.accelerometer),
            (self.gyroscope, samples.gyroscope),
            (self.magnetometer, samples.magnetometer),
        )
        for triad, stream in pairs:
            if triad is not None and stream is not None and len(stream) and triad.unit != stream.unit:
                raise FormatError(
                    f"the calibration is for measurements in {triad.unit}, the samples are in {stream.unit}. "
                    "Read the recording with the units that it had when it was calibrated (--units)."
                )
        if not self.feels_force or not len(samples.gyroscope):
            return
        for missing, whose in ((self.accelerometer is None, "calibration"), (not samples.accelerometer, "recording")):
            if missing:
                raise FormatError(
                    f"the gyroscope's g-sensitivity needs the specific force, and this {whose} holds no accelerometer."
                )


def interpolate_triad(source: TriadSamples, target: TriadSamples) -> Floats:
    """Return `source` at the timestamps of `target`, (len(target), 3), linearly interpolated and held at the ends."""
    if np.array_equal(source.t_ns, target.t_ns):
        return source.values
    if not len(source) or not len(target):
        return np.zeros((len(target), 3))
    origin = min(source.t_ns[0], target.t_ns[0])
    t_source, t_target = (source.t_ns - origin) * 1e-9, (target.t_ns - origin) * 1e-9
    return np.column_stack([np.interp(t_target, t_source, source.values[:, axis]) for axis in range(3)])


@value_class
class CameraCalibration:
    """How one camera sees what imu0 feels; or, of cameras that were calibrated without an IMU, what cam0 sees.

    The covariance of a Calibration holds, for camera "cam0", the scalars "cam0.T_cam_imu.rotation[0..2]" (small
    rotation delta on the right, R_cam_imu Exp(delta), body frame) [rad], "cam0.T_cam_imu.translation[0..2]" (the last
    column of T_cam_imu) [m], "cam0.time_shift_cam_imu" [s], "cam0.line_delay" [s], "cam0.intrinsics[0..]" [px; the
    projection's own parameters without unit] and "cam0.distortion_coeffs[0..]"; zero rows where a scalar was fixed.
    Without an IMU the body is cam0: the pose is then "cam1.T_cam_cam0", cam0 has none, and no camera has a time shift
    or a line delay.

    Attributes
    ----------
    T_cam_body : (4, 4) body coordinates to camera coordinates, p_cam = T_cam_body @ p_body [m]
    time_shift_cam_imu : t_imu = t_cam + time_shift_cam_imu [s]; zero without an IMU
    camera : lens and intrinsics, as used or as estimated
    body : sensor whose frame is the body's, "imu0" or "cam0"
    """

    T_cam_body: Floats
    time_shift_cam_imu: float
    camera: Camera
    body: Literal["imu0", "cam0"] = "imu0"

    def __post_init__(self) -> None:
        object.__setattr__(self, "T_cam_body", frozen_array(self.T_cam_body))

    @property
    def T_cam_imu(self) -> Floats:
        """Coordinates of the IMU to those of the camera, p_cam = T_cam_imu @ p_imu, (4, 4) [m].

        Raises
        ------
        OptionError
            If the cameras were calibrated without an IMU.
        """
        if self.body != "imu0":
            raise OptionError(
                "this calibration is of cameras alone: it does not tell where an IMU is. Calibrate both with gnomon "
                "camera-imu, and give it this calibration with --cam."
            )
        return self.T_cam_body

    @property
    def link(self) -> str:
        """Name of the pose: "T_cam_imu", or "T_cam_cam0" without an IMU."""
        return "T_cam_imu" if self.body == "imu0" else "T_cam_cam0"

    @property
    def middle_row_delay_s(self) -> float:
        """By how much the middle row of an image is later than row 0, to which time shifts refer [s]."""
        return 0.5 * (self.camera.resolution[1] - 1) * self.camera.line_delay_s


_NO_CAMERAS: Mapping[str, CameraCalibration] = FrozenMapping({})


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
