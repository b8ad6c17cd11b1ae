"""What was learned from a recording: frozen values, each with its uncertainty.

The one sensor model of gnomon (see docs/theory): with specific force f [m/s^2] and angular rate omega [rad/s] in the
body frame, and measurements in the unit of the recording,

    accelerometer = sensitivity @ f + bias
    gyroscope     = sensitivity @ omega + bias + g_sensitivity @ f

The models of documents A, B and C and of other projects are exact views of it.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any, Literal, Self

import numpy as np
from numpy.typing import NDArray

from .errors import FormatError, OptionError
from .findings import Finding
from .models.frames import fixed_entries, frame_rotation, rotation_jacobian
from .recording import Floats, ImuSamples, Source, TriadSamples, frozen_array

Verdict = Literal["pass", "warn", "fail"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class AccelerometerCalibration:
    """measured = sensitivity @ f + bias.

    Attributes
    ----------
    sensitivity : (3, 3) [unit per m/s^2], body frame to sensor axes
    bias : (3,) [unit], sensor axes
    unit : unit of the measurements
    """

    sensitivity: Floats
    bias: Floats
    unit: str

    def __post_init__(self) -> None:
        object.__setattr__(self, "sensitivity", frozen_array(self.sensitivity))
        object.__setattr__(self, "bias", frozen_array(self.bias))

    def specific_force(self, values: Floats) -> Floats:
        """Return the specific force in the body frame, (n, 3) [m/s^2], of measurements (n, 3) [unit]."""
        return _mapped(np.linalg.inv(self.sensitivity), values - self.bias)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
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


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ImuCalibration:
    """Both triads of one IMU, in one body frame."""

    accelerometer: AccelerometerCalibration
    gyroscope: GyroscopeCalibration | None = None

    def apply(self, samples: ImuSamples) -> ImuSamples:
        """Turn measurements into specific force [m/s^2] and angular rate [rad/s] in the body frame.

        The g-sensitivity of the gyroscope needs the specific force at the stamps of the gyroscope; where the two triads
        have stamps of their own it is interpolated linearly.

        Raises
        ------
        FormatError
            If the samples are not in the unit for which the calibration was made.
        """
        for triad, stream in ((self.accelerometer, samples.accelerometer), (self.gyroscope, samples.gyroscope)):
            if triad is not None and triad.unit != stream.unit:
                raise FormatError(
                    f"the calibration is for measurements in {triad.unit}, the samples are in {stream.unit}. "
                    "Read the recording with the units that it had when it was calibrated (--units)."
                )
        force = self.accelerometer.specific_force(samples.accelerometer.values)
        calibrated = TriadSamples(t_ns=samples.accelerometer.t_ns, values=force, unit="m/s^2")
        if self.gyroscope is None:
            return ImuSamples(accelerometer=calibrated, gyroscope=samples.gyroscope)
        at_gyro = interpolate_triad(calibrated, samples.gyroscope)
        rate = self.gyroscope.angular_rate(samples.gyroscope.values, at_gyro)
        return ImuSamples(
            accelerometer=calibrated,
            gyroscope=TriadSamples(t_ns=samples.gyroscope.t_ns, values=rate, unit="rad/s"),
        )


def interpolate_triad(source: TriadSamples, target: TriadSamples) -> Floats:
    """Return `source` at the stamps of `target`, (len(target), 3), linearly interpolated and held at the ends."""
    if np.array_equal(source.t_ns, target.t_ns):
        return source.values
    if not len(source) or not len(target):
        return np.zeros((len(target), 3))
    origin = min(source.t_ns[0], target.t_ns[0])
    t_source, t_target = (source.t_ns - origin) * 1e-9, (target.t_ns - origin) * 1e-9
    return np.column_stack([np.interp(t_target, t_source, source.values[:, axis]) for axis in range(3)])


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Gravity:
    """Magnitude of gravity that the calibration rests on [m/s^2], its sigma, and where it came from."""

    value: float
    sigma: float
    source: str


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Covariance:
    """Covariance of named scalars.

    Attributes
    ----------
    names : (n,) paths such as "imu0.accelerometer.sensitivity[1,0]"
    matrix : (n, n), in products of the units of the parameters
    """

    names: tuple[str, ...]
    matrix: Floats

    def __post_init__(self) -> None:
        object.__setattr__(self, "matrix", frozen_array(self.matrix))
        if self.matrix.shape != (len(self.names),) * 2:
            raise FormatError(f"covariance of {len(self.names)} names has shape {self.matrix.shape}.")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Holdout:
    """Errors on data that the estimate had not seen.

    Attributes
    ----------
    accelerometer_rms : leave-one-interval-out rms of |f| - g [m/s^2]
    rotation_rms : leave-one-rotation-out rms of |u_a - u_g| [rad], u_a measured and u_g propagated gravity; nan without
        gyroscope
    """

    accelerometer_rms: float
    rotation_rms: float = float("nan")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Assessment:
    """How far the calibration can be trusted.

    Attributes
    ----------
    verdict : "pass", "warn" or "fail"
    findings : reasons and advice, worst first
    holdout : errors on unseen data
    intervals_found, intervals_used, rotations_found, rotations_used : counts
    model : the gyroscope model that was estimated, "basic" or "g-sensitivity"; "none" without a gyroscope
    held_by_prior : names of parameters that the recording does not determine
    """

    verdict: Verdict
    findings: tuple[Finding, ...]
    holdout: Holdout
    intervals_found: int
    intervals_used: int
    rotations_found: int
    rotations_used: int
    model: str
    held_by_prior: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Provenance:
    """Where a calibration comes from; holds no clock time, so that a second run gives the same bytes.

    Attributes
    ----------
    gnomon_version : version that made it
    method : such as "imu" or "simulation"
    inputs : files with their hashes
    options : option name -> value as text, only those that differ from the default
    seed : seed of random numbers, where any were drawn
    """

    gnomon_version: str
    method: str
    inputs: tuple[Source, ...] = ()
    options: Mapping[str, str] = field(default_factory=dict[str, str])
    seed: int | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Calibration:
    """A calibration with its uncertainty, its assessment and its origin.

    Attributes
    ----------
    imus : mapping "imu0" -> ImuCalibration
    cameras : mapping, empty for an IMU alone
    frame : body frame, "accel-x", "accel-z" or "user"
    gravity : what was taken for the magnitude of gravity
    uncertainty : covariance of every scalar of every IMU; zero rows where the frame or the model fixes a scalar
    assessment, provenance : see there
    """

    imus: Mapping[str, ImuCalibration]
    frame: str
    gravity: Gravity
    uncertainty: Covariance
    assessment: Assessment
    provenance: Provenance
    cameras: Mapping[str, object] = field(default_factory=dict[str, object])

    def __post_init__(self) -> None:
        object.__setattr__(self, "imus", MappingProxyType(dict(self.imus)))
        object.__setattr__(self, "cameras", MappingProxyType(dict(self.cameras)))

    @property
    def verdict(self) -> Verdict:
        """The verdict, "pass", "warn" or "fail"."""
        return self.assessment.verdict

    def parameter(self, path: str) -> Floats:
        """Return a parameter by its path in the YAML file, such as "imu0.gyroscope.bias".

        Raises
        ------
        OptionError
            If there is no such parameter.
        """
        for name, value in parameters(self.imus):
            if name == path:
                return value
        known = ", ".join(name for name, _ in parameters(self.imus))
        raise OptionError(f'no parameter "{path}" in this calibration. Known: {known}.')

    def sigma(self, path: str) -> Floats:
        """Return the standard deviation of a parameter, in its shape and unit.

        Raises
        ------
        OptionError
            If there is no such parameter.
        """
        shape = self.parameter(path).shape
        return np.sqrt(np.diag(self.covariance(path))).reshape(shape)

    def covariance(self, *paths: str) -> Floats:
        """Return the joint covariance of whole parameters, elements in row order, one parameter after the other.

        Raises
        ------
        OptionError
            If there is no such parameter.
        """
        index = {name: i for i, name in enumerate(self.uncertainty.names)}
        rows = [index[name] for path in paths for name in element_names(path, self.parameter(path).shape)]
        return self.uncertainty.matrix[np.ix_(rows, rows)]

    def in_frame(self, frame: str) -> Self:
        """Return the same calibration in body frame "accel-x" or "accel-z"; the covariance moves along.

        Raises
        ------
        OptionError
            If `frame` is neither.
        """
        imus: dict[str, ImuCalibration] = {}
        jacobian = np.eye(len(self.uncertainty.names))
        start = 0
        for name, imu in self.imus.items():
            rotation = frame_rotation(imu.accelerometer.sensitivity, frame)
            imus[name] = _with_exact_zeros(rotated(imu, rotation), frame)
            block = rotation_jacobian(_matrices(imu), rotation, frame)
            jacobian[start : start + len(block), start : start + len(block)] = block
            start += len(block)
        moved = jacobian @ self.uncertainty.matrix @ jacobian.T
        return replace(self, imus=imus, frame=frame, uncertainty=Covariance(names=self.uncertainty.names, matrix=moved))

    def _repr_html_(self) -> str:
        rows = "".join(
            f"<tr><td>{name}</td><td>{_cells(value)}</td><td>{_cells(self.sigma(name))}</td></tr>"
            for name, value in parameters(self.imus)
        )
        return (
            f"<b>gnomon calibration: {self.verdict}</b> (body frame {self.frame})"
            f"<table><tr><th>parameter</th><th>estimate</th><th>sigma</th></tr>{rows}</table>"
        )


def _cells(values: Floats) -> str:
    return "<br>".join(" ".join(f"{x:.6g}" for x in row) for row in np.atleast_2d(values))


def _with_exact_zeros(imu: ImuCalibration, frame: str) -> ImuCalibration:
    """Return the IMU without the rounding that a rotation leaves in the elements that the frame makes zero."""
    sensitivity = imu.accelerometer.sensitivity.copy()
    for entry in fixed_entries(frame):
        sensitivity[entry] = 0.0
    return replace(imu, accelerometer=replace(imu.accelerometer, sensitivity=sensitivity))


def rotated(imu: ImuCalibration, rotation: Floats) -> ImuCalibration:
    """Return the IMU with its body frame turned: f_new = rotation @ f_old, (3, 3)."""
    accelerometer = replace(imu.accelerometer, sensitivity=imu.accelerometer.sensitivity @ rotation.T)
    if imu.gyroscope is None:
        return ImuCalibration(accelerometer=accelerometer)
    gyroscope = replace(
        imu.gyroscope,
        sensitivity=imu.gyroscope.sensitivity @ rotation.T,
        g_sensitivity=imu.gyroscope.g_sensitivity @ rotation.T,
    )
    return ImuCalibration(accelerometer=accelerometer, gyroscope=gyroscope)


def parameters(imus: Mapping[str, ImuCalibration]) -> Iterator[tuple[str, Floats]]:
    """Yield (path, value) of every parameter, in the order of the covariance."""
    for name, imu in imus.items():
        yield f"{name}.accelerometer.sensitivity", imu.accelerometer.sensitivity
        yield f"{name}.accelerometer.bias", imu.accelerometer.bias
        if imu.gyroscope is not None:
            yield f"{name}.gyroscope.sensitivity", imu.gyroscope.sensitivity
            yield f"{name}.gyroscope.bias", imu.gyroscope.bias
            yield f"{name}.gyroscope.g_sensitivity", imu.gyroscope.g_sensitivity


def element_names(path: str, shape: tuple[int, ...]) -> list[str]:
    """Return the names of a parameter's scalars in row order, such as "imu0.gyroscope.bias[2]"."""
    return [f"{path}[{','.join(map(str, index))}]" for index in np.ndindex(shape)]


def covariance_names(imus: Mapping[str, ImuCalibration]) -> tuple[str, ...]:
    """Return the names of all scalars of all IMUs, in the order of the covariance."""
    return tuple(name for path, value in parameters(imus) for name in element_names(path, value.shape))


def _matrices(imu: ImuCalibration) -> list[Floats]:
    return [value for _, value in parameters({"": imu})]
