"""Calibrated sensors: an IMU's triads, and the camera that moves with them.

The one sensor model of gnomon (see docs/theory): with specific force f [m/s^2], angular rate omega [rad/s] and magnetic
field m [uT, or the local field's strength] in the body frame, and measurements in the unit of the recording,

    accelerometer = sensitivity @ f + bias
    gyroscope     = sensitivity @ omega + bias + g_sensitivity @ f
    magnetometer  = sensitivity @ m + bias

at one temperature; how it changes is a `TemperatureDependence`. The models of Tedaldi, Krebs and Angrisano and of other
projects are exact views of it.
"""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from ..errors import FormatError, OptionError
from ..frozen import FrozenMapping, value_class
from ..models.camera import Camera
from ..models.frames import Origin
from ..recording import Floats, ImuSamples, Integers, TemperatureSamples, TriadSamples, frozen_array
from ..recording.thermometer import TemperatureCourse, temperature_course


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
    have
        the same clock and delay
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
class TemperatureDependence:
    """How the triads of an IMU change with the temperature of its chip.

    With d = T - reference_degc, and in sensor axes, a triad that reads y at the reference reads

        y(T) = bias + sum_j bias_j d^j + (1 + sum_j sensitivity_j d^j) (y - bias),    j = 1 to the order:

    the sensitivities are relative changes, which also the g-sensitivity of a gyroscope takes part in. Where that
    changes by itself, y of the gyroscope has sum_j g_sensitivity_j d^j (a - bias of a) in addition, with the reading a
    that the accelerometer would have at the reference. A part that does not change is None. Of the six numbers by which
    an accelerometer alone tells its sensitivity those of body frame accel-x change, at each temperature, and the
    gyroscope's are against that frame.

    Attributes
    ----------
    reference_degc : temperature at which the sensitivities and biases beside this hold [degC]
    low_degc, high_degc : range in which the polynomials hold [degC]; beyond it they are taken at the nearer end
    lag_s : by which the thermometer follows the sensor, x' = (T - x) / lag_s of its reading x [s]
    accelerometer_bias, gyroscope_bias : (order, 3) [unit/K^j]
    accelerometer_sensitivity, gyroscope_sensitivity : (order, 3, 3) [1/K^j]
    gyroscope_g_sensitivity : (order, 3, 3) [unit of the gyroscope per unit of the accelerometer and K^j]
    magnetometer_bias, magnetometer_sensitivity : (order, 3) [unit/K^j] and (order, 3, 3) [1/K^j]
    """

    reference_degc: float
    low_degc: float
    high_degc: float
    lag_s: float = 0.0
    accelerometer_bias: Floats | None = None
    gyroscope_bias: Floats | None = None
    accelerometer_sensitivity: Floats | None = None
    gyroscope_sensitivity: Floats | None = None
    gyroscope_g_sensitivity: Floats | None = None
    magnetometer_bias: Floats | None = None
    magnetometer_sensitivity: Floats | None = None

    def __post_init__(self) -> None:
        for name in TEMPERATURE_PARTS:
            value = getattr(self, name)
            if value is not None:
                object.__setattr__(self, name, frozen_array(value))

    def parts(self) -> Iterator[tuple[str, Floats]]:
        """Yield the names and coefficients of what changes."""
        for name in TEMPERATURE_PARTS:
            if (value := getattr(self, name)) is not None:
                yield name, value

    def of(self, triad: str) -> bool:
        """Return whether anything of a triad changes."""
        return any(part.startswith(triad) for part, _ in self.parts())

    @property
    def changes(self) -> bool:
        """Whether anything changes at all."""
        return any(True for _ in self.parts())

    def change(self, part: str, degc: Floats) -> Floats:
        """Return by how much a part differs from that at the reference at temperatures (k,).

        Beyond the range it is that at the nearer end: polynomials run away there.

        Returns
        -------
        (k, 3) of a bias [its unit], (k, 3, 3) of a sensitivity, relative to it, or of the g-sensitivity
        """
        coefficients: Floats | None = getattr(self, part)
        if coefficients is None:
            return np.zeros((len(degc), *TEMPERATURE_PARTS[part]))
        known = np.clip(degc, self.low_degc, self.high_degc)
        powers = np.vander(known - self.reference_degc, len(coefficients) + 1, increasing=True)[:, 1:]
        return np.tensordot(powers, coefficients, axes=1)

    def to_reference(self, name: str, values: Floats, degc: Floats, bias: Floats) -> Floats:
        """Return what samples (n, 3) of a triad with such a bias (3,) would be at the reference temperature."""
        values = values - self.change(f"{name}_bias", degc)
        if getattr(self, f"{name}_sensitivity") is None:
            return values
        larger = np.eye(3) + self.change(f"{name}_sensitivity", degc)
        return bias + np.linalg.solve(larger, (values - bias)[:, :, None])[:, :, 0]

    def from_reference(self, name: str, values: Floats, degc: Floats, bias: Floats) -> Floats:
        """Return what samples (n, 3) that are right at the reference temperature would be at others (n,)."""
        relative = self.change(f"{name}_sensitivity", degc)
        more = np.einsum("nij,nj->ni", relative, values - bias)
        return values + more + self.change(f"{name}_bias", degc)


TRIADS = ("accelerometer", "gyroscope", "magnetometer")

HIGHEST_ORDER = 3
"""Of polynomials of the temperature."""

TEMPERATURE_PARTS = FrozenMapping(
    {
        "accelerometer_bias": (3,),
        "gyroscope_bias": (3,),
        "accelerometer_sensitivity": (3, 3),
        "gyroscope_sensitivity": (3, 3),
        "gyroscope_g_sensitivity": (3, 3),
        "magnetometer_bias": (3,),
        "magnetometer_sensitivity": (3, 3),
    }
)
"""What a temperature may change, in the order of the covariance, and the shape of one coefficient."""


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
