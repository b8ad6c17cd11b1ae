"""What was learned from a recording: frozen values, each with its uncertainty.

The sensors themselves are described in `sensors`, the names of their scalars in `calibration_parameters`.
"""

from collections.abc import Iterator, Mapping
from dataclasses import field, replace
from typing import Any, Self

import numpy as np

from .._version import __version__
from ..errors import FormatError, OptionError
from ..findings import Finding
from ..frozen import FrozenMapping, value_class
from ..models.gravity import WORLD_GRAVITY_SIGMA_M_S2
from ..models.origin import Origin
from ..recording import Floats, Source, frozen_array
from ..recording.dataframes import make_dataframe
from ..units import STANDARD_GRAVITY_M_S2
from .moved import imus_at_temperature, moved_into_frame, moved_to_origin, rotate_imu
from .sensors import (
    AccelerometerCalibration,
    CameraCalibration,
    GyroscopeCalibration,
    ImuCalibration,
    MagnetometerCalibration,
    calibration_parameters,
    covariance_names,
    element_names,
    element_units,
    interpolate_triad,
)
from .temperature_dependence import TemperatureDependence
from .trust import UncertaintySummary, Verdict

__all__ = [
    "UNSTATED_GRAVITY",
    "AccelerometerCalibration",
    "Assessment",
    "Calibration",
    "CameraCalibration",
    "CameraImuFit",
    "CamerasFit",
    "Covariance",
    "Gravity",
    "GyroscopeCalibration",
    "Holdout",
    "ImuCalibration",
    "MagnetometerCalibration",
    "Provenance",
    "UncertaintySummary",
    "Verdict",
    "calibration_parameters",
    "covariance_names",
    "element_names",
    "interpolate_triad",
    "rotate_imu",
]


@value_class
class CameraImuFit:
    """What a camera-IMU calibration rests on.

    Attributes
    ----------
    frames_found, frames_used : "cam0" -> frames in which the board was detected, and that were used
    corners_used : "cam0" -> corners
    reprojection_rms_px : "cam0" -> rms of the residuals of the corners used, per axis [px]
    duration_s : time spanned by the trajectory [s]
    converged : whether the solver came to rest
    """

    frames_found: Mapping[str, int]
    frames_used: Mapping[str, int]
    corners_used: Mapping[str, int]
    reprojection_rms_px: Mapping[str, float]
    duration_s: float
    converged: bool


@value_class
class CamerasFit:
    """What a calibration of cameras alone rests on.

    Attributes
    ----------
    views_found : "cam0" -> frames in which the board was detected
    views_used : "cam0" -> frames that were used, chosen by their information
    corners_used : "cam0" -> corners
    reprojection_rms_px : "cam0" -> rms of the residuals of the corners used, per axis [px]
    holdout_rms_px : "cam0" -> the same of views that the estimate had not seen, each with a pose of its own [px]
    coverage : "cam0" -> share of the image in which corners were used, 0 to 1
    models : "cam0" -> lens models that were tried, the one that was taken first
    board_added : what of the board was estimated since the views prove it, such as "target.aspect" or "target.bow"
    aspect, aspect_sigma : the board's scale along y over that along x, minus 1; both zero where it was not estimated
    bow_m, bow_sigma_m : how far the middle of the board bulges towards the viewer [m]; the same
    print_scale, print_scale_sigma : true over stated size of the board, where a known baseline tells it; else nan
    converged : whether the solver came to rest
    """

    views_found: Mapping[str, int]
    views_used: Mapping[str, int]
    corners_used: Mapping[str, int]
    reprojection_rms_px: Mapping[str, float]
    holdout_rms_px: Mapping[str, float]
    coverage: Mapping[str, float]
    models: Mapping[str, tuple[str, ...]]
    board_added: tuple[str, ...] = ()
    aspect: float = 0.0
    aspect_sigma: float = 0.0
    bow_m: float = 0.0
    bow_sigma_m: float = 0.0
    print_scale: float = float("nan")
    print_scale_sigma: float = float("nan")
    converged: bool = True


@value_class
class Gravity:
    """Magnitude of gravity that the calibration rests on [m/s^2], its sigma, and where it came from."""

    value: float
    sigma: float
    source: str


UNSTATED_GRAVITY = Gravity(
    value=STANDARD_GRAVITY_M_S2, sigma=WORLD_GRAVITY_SIGMA_M_S2, source="standard gravity, as no place was stated"
)
"""What gravity is taken for where nothing tells it."""


@value_class
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


@value_class
class Holdout:
    """Errors on data that the estimate had not seen.

    Attributes
    ----------
    accelerometer_rms : leave-one-interval-out rms of |f| - g [m/s^2]
    rotation_rms : leave-one-rotation-out rms of |u_a - u_g| [rad], u_a measured and u_g propagated gravity; nan without
        gyroscope
    rate_rms : leave-one-part-out rms of |omega| minus the rate of the turntable [rad/s]; nan without one
    field_rms : leave-out rms of |m| - 1, in units of the local magnetic field; nan without magnetometer
    """

    accelerometer_rms: float = float("nan")
    rotation_rms: float = float("nan")
    rate_rms: float = float("nan")
    field_rms: float = float("nan")


@value_class
class Assessment:
    """How far the calibration can be trusted.

    Attributes
    ----------
    verdict : "pass", "warn" or "fail"
    findings : reasons and advice, worst first
    model : the model that was estimated; of the gyroscope for an IMU alone, "basic" or "g-sensitivity", "none" without
        one; of the IMU with cameras, "basic", "scale-misalignment" or "full"; of cameras alone, their lenses
    holdout : errors on hold-out data, nan where nothing was held out
    intervals_found, intervals_used, rotations_found, rotations_used : counts, of a multi-position recording
    held_by_prior : names of parameters that the recording does not determine
    camera_imu : what a camera-IMU calibration rests on; else None
    cameras : what a calibration of cameras alone rests on; else None
    trust : where the uncertainty comes from, how parts of the recording agree, and what a use needs
    """

    verdict: Verdict = "pass"
    findings: tuple[Finding, ...] = ()
    model: str
    holdout: Holdout = field(default_factory=Holdout)
    intervals_found: int = 0
    intervals_used: int = 0
    rotations_found: int = 0
    rotations_used: int = 0
    held_by_prior: tuple[str, ...] = ()
    camera_imu: CameraImuFit | None = None
    cameras: CamerasFit | None = None
    trust: UncertaintySummary = field(default_factory=UncertaintySummary)


TRUTH_METHOD = "simulation"
"""By which a calibration is known to be the truth."""


@value_class
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

    gnomon_version: str = __version__
    method: str
    inputs: tuple[Source, ...] = ()
    options: Mapping[str, str] = field(default_factory=dict[str, str])
    seed: int | None = None


@value_class
class Calibration:
    """A calibration with its uncertainty, its assessment and its origin.

    Attributes
    ----------
    imus : mapping "imu0" -> ImuCalibration; empty for cameras alone
    cameras : mapping "cam0" -> CameraCalibration; empty for an IMU alone
    frame : body frame, "accel-x", "accel-z" or "user"; without accelerometer "gyro-x" (x along the sensitivity axis of
        the x gyroscope, that of the y gyroscope in the x-y plane) or "mag-x" (the same of a magnetometer); of cameras
        alone "cam0"
    gravity : what was taken for the magnitude of gravity; of no meaning for cameras alone
    uncertainty : covariance of every scalar of every IMU, then of every camera; zero rows where the frame or the model
        fixes a scalar
    assessment, provenance : see there
    """

    imus: Mapping[str, ImuCalibration]
    frame: str
    gravity: Gravity
    uncertainty: Covariance
    assessment: Assessment
    provenance: Provenance
    cameras: Mapping[str, CameraCalibration] = field(default_factory=dict[str, CameraCalibration])

    def __post_init__(self) -> None:
        object.__setattr__(self, "imus", FrozenMapping(self.imus))
        object.__setattr__(self, "cameras", FrozenMapping(self.cameras))

    @property
    def verdict(self) -> Verdict:
        """The verdict, "pass", "warn" or "fail"."""
        return self.assessment.verdict

    def parameter(self, path: str) -> Floats:
        """Return a parameter by its path, such as "imu0.gyroscope.bias" or "cam0.time_shift_cam_imu".

        The path is that in the YAML file; the pose of a camera has two, "cam0.T_cam_imu.rotation" (rotation vector of
        R_cam_imu [rad]) and "cam0.T_cam_imu.translation" [m].

        Raises
        ------
        OptionError
            If there is no such parameter.
        """
        known = dict(calibration_parameters(self.imus, self.cameras))
        if path in known:
            return known[path]
        raise OptionError(f'no parameter "{path}" in this calibration. Known: {", ".join(known)}.')

    def sigma(self, path: str) -> Floats:
        """Return the standard deviation of a parameter, in its shape and unit.

        Of a camera's rotation it is that of a small rotation about the body's axes [rad]; see `CameraCalibration`.

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
        """Return the same calibration in body frame "accel-x" or "accel-z"; cameras and covariance move along.

        Raises
        ------
        OptionError
            If `frame` is neither.
        """
        moved = moved_into_frame(self.imus, self.cameras, frame)
        matrix = moved.jacobian @ self.uncertainty.matrix @ moved.jacobian.T
        uncertainty = Covariance(names=self.uncertainty.names, matrix=matrix)
        return replace(self, imus=moved.imus, cameras=moved.cameras, frame=frame, uncertainty=uncertainty)

    def with_temperature(self, imu: str, found: TemperatureDependence, covariances: Mapping[str, Floats]) -> Self:
        """Return the calibration with a dependence of an IMU on the temperature.

        Parameters
        ----------
        found : what it was before included
        covariances : of its new parts, which are independent of all others
        """
        imus = {**self.imus, imu: replace(self.imus[imu], temperature=found)}
        names = covariance_names(imus, self.cameras)
        at = {name: i for i, name in enumerate(names)}
        matrix = np.zeros((len(names), len(names)))
        new = tuple(f"{imu}.temperature.{part}[" for part in covariances)
        known = [i for i, name in enumerate(self.uncertainty.names) if name in at and not name.startswith(new)]
        rows = [at[self.uncertainty.names[i]] for i in known]
        matrix[np.ix_(rows, rows)] = self.uncertainty.matrix[np.ix_(known, known)]
        for part, covariance in covariances.items():
            own = [i for name, i in at.items() if name.startswith(f"{imu}.temperature.{part}[")]
            matrix[np.ix_(own, own)] = covariance
        return replace(self, imus=imus, uncertainty=Covariance(names=names, matrix=matrix))

    def at_temperature(self, degc: float) -> Self:
        """Return the calibration as it is at a temperature of the chip, on which it then depends no longer.

        One that knows no temperature stays as it is.

        Parameters
        ----------
        degc : of all its IMUs [degC]

        Raises
        ------
        OptionError
            If it is beyond the range in which the calibration knows it.
        """
        if all(imu.temperature is None for imu in self.imus.values()):
            return self
        moved = imus_at_temperature(self.imus, self.cameras, degc)
        matrix = moved.jacobian @ self.uncertainty.matrix @ moved.jacobian.T
        uncertainty = Covariance(names=covariance_names(moved.imus, self.cameras), matrix=matrix)
        return replace(self, imus=moved.imus, uncertainty=uncertainty)

    def with_origin(self, origin: str | Origin) -> Self:
        """Return the same calibration with the origin of each IMU at another point, its covariance too.

        Only a calibration with lever arms changes. It is exact but for the gyroscope's g-sensitivity, which acts on the
        specific force at the body's origin: two places a centimetre apart differ by 1e-5 rad/s there. The weights of
        the accelerometers in p* are stated numbers, which the covariance takes for exact.

        Parameters
        ----------
        origin : "optimal", the point whose place is known best (p*); the accelerometer "x", "y" or "z"; a place from
            the x accelerometer in the IMU's axes, such as "0.010,0,-0.005" [m]; or the `origin` of an IMU of another
            calibration, whose weights of the accelerometers then count. Without it those of this calibration do, where
            they are known; else p* is that of a motion alike about all axes

        Raises
        ------
        OptionError
            If `origin` is none of these.
        """
        stated = Origin.stated(origin) if isinstance(origin, str) else origin
        origins = {
            name: replace(stated, weights=imu.origin.weights)
            if stated.weights is None and imu.origin is not None
            else stated
            for name, imu in self.imus.items()
        }
        moved = moved_to_origin(self.imus, self.cameras, origins)
        matrix = moved.jacobian @ self.uncertainty.matrix @ moved.jacobian.T
        uncertainty = Covariance(names=self.uncertainty.names, matrix=matrix)
        return replace(self, imus=moved.imus, cameras=moved.cameras, uncertainty=uncertainty)

    def to_dataframe(self) -> Any:
        """Return the parameters as a DataFrame of pandas or polars: name, value, sigma and unit of each scalar.

        Raises
        ------
        OptionError
            If neither is installed.
        """
        rows = [row for path, value in self._parameters() for row in self._scalars(path, value)]
        return make_dataframe(dict(zip(("name", "value", "sigma", "unit"), zip(*rows, strict=True), strict=True)))

    def _parameters(self) -> Iterator[tuple[str, Floats]]:
        return calibration_parameters(self.imus, self.cameras)

    def _scalars(self, path: str, value: Floats) -> Iterator[tuple[str, float, float, str]]:
        names, units = element_names(path, np.shape(value)), element_units(self, path)
        yield from zip(names, np.ravel(value).tolist(), self.sigma(path).ravel().tolist(), units, strict=True)

    def __repr__(self) -> str:
        """Return it on one line; the numbers are in its table, its fields, and `gnomon show`."""
        of = ", ".join([*self.imus, *self.cameras])
        return f"Calibration({self.verdict}, {of}, frame {self.frame}, {len(self.uncertainty.names)} parameters)"

    def _repr_html_(self) -> str:
        known = ((path, value) for path, value in self._parameters() if np.size(value))
        cells = ((path, _cells(value, self.sigma(path)), element_units(self, path)[-1]) for path, value in known)
        rows = "".join(f"<tr><td>{'</td><td>'.join(row)}</td></tr>" for row in cells)
        return (
            f"<b>gnomon calibration: {self.verdict}</b> (body frame {self.frame})"
            f"<table><tr><th>parameter</th><th>estimate ± standard deviation</th><th>unit</th></tr>{rows}</table>"
        )


def _cells(values: Floats, sigmas: Floats) -> str:
    """Return numbers with as many digits as their standard deviations give them."""
    pairs = zip(np.atleast_2d(values), np.atleast_2d(sigmas), strict=True)
    return "<br>".join("&emsp;".join(_with_sigma(*pair) for pair in zip(*row, strict=True)) for row in pairs)


def _with_sigma(value: float, sigma: float) -> str:
    if not sigma > 0:
        return f"{value:.6g}"
    decimals = max(1 - int(np.floor(np.log10(sigma))), 0)
    return f"{value:.{decimals}f} ± {sigma:.{decimals}f}"
