"""What other projects' calibration files tell: the sensors, and what else they hold."""

from collections.abc import Mapping
from dataclasses import field, replace

import numpy as np

from ..errors import FormatError
from ..frozen import FrozenMapping, value_class
from ..models.camera import Camera
from ..models.target import Target
from ..recording import Floats, frozen_array
from ..recording.samples import ImuNoise
from ..results.calibration import (
    AccelerometerCalibration,
    Assessment,
    Calibration,
    CameraCalibration,
    Covariance,
    Gravity,
    GyroscopeCalibration,
    ImuCalibration,
    MagnetometerCalibration,
    Provenance,
    calibration_parameters,
    covariance_names,
)
from ..results.sensors import element_names
from ..units import STANDARD_GRAVITY_M_S2

FOREIGN_METHOD = "foreign"
"""`Provenance.method` of a calibration that another project made."""


@value_class(eq=True)
class Statistics:
    """Mean, median and standard deviation of the lengths of residual vectors."""

    mean: float
    median: float
    std: float


@value_class(eq=True)
class Residuals:
    """Residuals of one camera or triad in units of its noise, and in px, rad/s or m/s^2."""

    normalised: Statistics
    plain: Statistics


@value_class
class ForeignImu:
    """What a file says of an IMU besides its sensor model.

    Attributes
    ----------
    noise : noise densities and random walks, or None where they are not stated
    update_rate_hz : sample rate [Hz], or None
    topic : ROS topic, or ""
    T_imu_body : (4, 4) Kalibr's T_i_b, p_imu = T_imu_body @ p_body [m], body is imu0; or None
    time_offset_s : t_imu0 = t_imu + time_offset_s [s], or None
    lever_arms_m : (3, 3) one row each for the x, y and z accelerometer: where it lies in the IMU's frame (Kalibr's
        scale-misalignment-size-effect) [m]; or None
    """

    noise: ImuNoise | None = None
    update_rate_hz: float | None = None
    topic: str = ""
    T_imu_body: Floats | None = None
    time_offset_s: float | None = None
    lever_arms_m: Floats | None = None

    def __post_init__(self) -> None:
        for name in ("T_imu_body", "lever_arms_m"):
            if getattr(self, name) is not None:
                object.__setattr__(self, name, frozen_array(getattr(self, name)))

    def placed(self, imu: ImuCalibration) -> ImuCalibration:
        """Return the model of an IMU beside imu0 with its pose and its clock, where they are stated."""
        if self.T_imu_body is None:
            return imu
        return replace(imu, T_imu_body=self.T_imu_body, time_shift_s=self.time_offset_s or 0.0)


@value_class
class ForeignCalibration:
    """What was read from another project's files.

    Attributes
    ----------
    imus : mapping from "imu0", "imu1", ... to ImuCalibration; empty where no sensor model is stated
    frame : body frame, "accel-x", "accel-z" or "user"
    sigmas : parameter path -> standard deviations in the parameter's shape; empty where the format has none
    notes : sentences on what the file does not say and what was taken instead
    cameras : mapping from "cam0", "cam1", ... to CameraCalibration, of cameras whose place is stated
    lenses : mapping from "cam0", "cam1", ... to Camera, of cameras whose place is not stated
    imu_data : mapping from "imu0", "imu1", ... to what is said of an IMU besides its sensor model
    gravity_target : (3,) gravity in the board's frame, pointing down [m/s^2]; or None
    residuals : "cam0", "imu0.gyroscope", "imu0.accelerometer", ... -> Residuals
    target : the board, or None
    format : name of the format, such as "Kalibr"
    guessed_sizes : cameras whose size of the image the file does not state: it was guessed
    """

    imus: Mapping[str, ImuCalibration]
    frame: str
    sigmas: Mapping[str, Floats] = field(default_factory=dict[str, Floats])
    notes: tuple[str, ...] = ()
    cameras: Mapping[str, CameraCalibration] = field(default_factory=dict[str, CameraCalibration])
    lenses: Mapping[str, Camera] = field(default_factory=dict[str, Camera])
    imu_data: Mapping[str, ForeignImu] = field(default_factory=dict[str, ForeignImu])
    gravity_target: Floats | None = None
    residuals: Mapping[str, Residuals] = field(default_factory=dict[str, Residuals])
    target: Target | None = None
    format: str = ""
    guessed_sizes: frozenset[str] = frozenset()

    def __post_init__(self) -> None:
        for name in ("imus", "sigmas", "cameras", "lenses", "imu_data", "residuals"):
            object.__setattr__(self, name, FrozenMapping(getattr(self, name)))
        if self.gravity_target is not None:
            object.__setattr__(self, "gravity_target", frozen_array(self.gravity_target))


def recognised_frame(imus: Mapping[str, ImuCalibration]) -> str:
    """Return the frame in which the first triad of every IMU is triangular as that frame asks, else "user"."""
    sensors = [imu.accelerometer or imu.gyroscope or imu.magnetometer for imu in imus.values()]
    kinds = {type(sensor) for sensor in sensors}
    matrices = [sensor.sensitivity for sensor in sensors if sensor is not None]
    for frame, kind, strict, off in (
        ("accel-x", AccelerometerCalibration, np.triu, 1),
        ("accel-z", AccelerometerCalibration, np.tril, -1),
        ("gyro-x", GyroscopeCalibration, np.triu, 1),
        ("mag-x", MagnetometerCalibration, np.triu, 1),
    ):
        if kinds <= {kind} and all(np.abs(strict(S, off)).max() <= 1e-9 * np.abs(S).max() for S in matrices):
            return frame
    return "user"


def imu_in_si(
    force: tuple[Floats, Floats] | None, rate: tuple[Floats, Floats] | None, g_sensitivity: Floats | None = None
) -> ImuCalibration:
    """Return an IMU of samples in SI units by sensitivity (3, 3) and bias (3,) of each triad; None for no triad."""
    turned = np.zeros((3, 3)) if g_sensitivity is None else g_sensitivity
    return ImuCalibration(
        accelerometer=None
        if force is None
        else AccelerometerCalibration(sensitivity=force[0], bias=force[1], unit="m/s^2"),
        gyroscope=None
        if rate is None
        else GyroscopeCalibration(sensitivity=rate[0], bias=rate[1], g_sensitivity=turned, unit="rad/s"),
    )


def ideal_imu() -> ImuCalibration:
    """Return an IMU that measures specific force and angular rate as they are."""
    return imu_in_si((np.eye(3), np.zeros(3)), (np.eye(3), np.zeros(3)))


def as_calibration(foreign: ForeignCalibration) -> Calibration:
    """Return what other projects' files tell as a calibration; standard deviations that they do not state are nan.

    An IMU of which they hold no sensor model is ideal, as the programs take it that have no place for one.

    Raises
    ------
    FormatError
        If there is neither an IMU nor a camera with its pose.
    """
    if not foreign.imus and not foreign.cameras:
        found = "lenses without their poses" if foreign.lenses else "no sensor"
        raise FormatError(
            f"{foreign.format}: found {found}. Give the file with the poses (T_cam_imu), or that of the IMU's model."
        )
    if not foreign.imus and all(camera.body == "cam0" for camera in foreign.cameras.values()):
        return stated_calibration(foreign, unknown=float("nan"))
    return stated_calibration(replace(foreign, imus=dict(foreign.imus) or {"imu0": ideal_imu()}), unknown=float("nan"))


def stated_calibration(foreign: ForeignCalibration, unknown: float) -> Calibration:
    """Return nothing but what the files tell as a calibration.

    Parameters
    ----------
    unknown : taken for the variance of numbers without a standard deviation
    """
    imus = foreign.imus
    names = covariance_names(imus, foreign.cameras)
    variance = dict.fromkeys(names, unknown)
    for path, value in calibration_parameters(imus, foreign.cameras):
        if path in foreign.sigmas:
            squares = np.square(foreign.sigmas[path]).ravel().tolist()
            variance |= dict(zip(element_names(path, value.shape), squares, strict=True))
    return Calibration(
        imus=imus,
        cameras=foreign.cameras,
        frame=foreign.frame,
        gravity=Gravity(value=STANDARD_GRAVITY_M_S2, sigma=float("nan"), source="not stated"),
        uncertainty=Covariance(names=names, matrix=_diagonal([variance[name] for name in names])),
        assessment=Assessment(verdict="warn", findings=(), model="foreign"),
        provenance=Provenance(method=FOREIGN_METHOD, options={"format": foreign.format or "another project"}),
    )


def _diagonal(variances: list[float]) -> Floats:
    """Return a covariance without correlations; unknown ones are nan where a variance is."""
    matrix = np.diag(variances)
    unknown = np.isnan(variances)
    matrix[unknown] = matrix[:, unknown] = np.nan
    return matrix
