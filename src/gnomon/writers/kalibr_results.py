"""Kalibr: `results-imucam.txt`, in Kalibr's layout; what Kalibr does not report stands in blocks of its own at the end.

Layout as in the files that Kalibr wrote (see the samples of the tests). The covariances and the noise that was found
have no place in it, and get one below, in lines that no parser of Kalibr's takes for its own.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from ..calibration import Calibration, CameraCalibration
from ..errors import OptionError
from ..models.camera import Camera
from ..models.target import Target
from ..readers.projects.foreign import Residuals
from ..recording import Floats
from .kalibr import KalibrModel, StatedImu, kalibr_model, pose_in_kalibr
from .kalibr_camchain import baseline
from .lens_fit import without_k3

RESULTS_FILE = "results-imucam.txt"

LENS_NAMES = {"pinhole": (), "omni": ("Omni xi",), "eucm": ("EUCM alpha", "EUCM beta"), "ds": ("DS xi", "DS alpha")}
_UNITS = {"accelerometer": "m/s^2", "gyroscope": "rad/s"}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class KalibrResults:
    """What `results-imucam.txt` is made of.

    Attributes
    ----------
    calibration : with cameras, in body frame accel-x
    target : the board
    residuals : "cam0", "imu0.gyroscope", "imu0.accelerometer", ... -> Residuals; missing where nothing was used
    gravity_target : (3,) gravity in the target's frame, pointing down [m/s^2]
    imus : "imu0", ... -> noise and rate as they were stated
    notes : lines of the blocks that gnomon adds
    """

    calibration: Calibration
    target: Target
    residuals: Mapping[str, Residuals]
    gravity_target: Floats
    imus: Mapping[str, StatedImu]
    notes: tuple[str, ...] = ()

    def text(self) -> str:
        """Return the text of the file."""
        return "\n".join((*self._lines(), *self.notes)) + "\n"

    def _lines(self) -> Iterator[str]:
        cameras = self.calibration.cameras
        yield from ("Calibration results", "===================")
        yield from (*self._residual_lines("Normalized Residuals", normalised=True), "")
        yield from self._residual_lines("Residuals", normalised=False)
        for name, camera in cameras.items():
            yield from _transformation(name, camera)
        if len(cameras) > 1:
            yield from ("Baselines:", "----------")
        for (first, before), (second, camera) in pairwise(cameras.items()):
            pose = baseline(before, camera)
            yield from (f"Baseline ({first} to {second}): ", *_matrix(pose))
            yield from (f"baseline norm:  {float(np.linalg.norm(pose[:3, 3]))} [m]", "")
        yield from ("", "Gravity vector in target coords: [m/s^2]", *_matrix(self.gravity_target), "", "")
        yield from ("Calibration configuration", "=========================", "")
        for name, camera in cameras.items():
            yield from (name, "-----", *_lens(camera.camera), *board_lines(self.target), "")
        yield from ("", "", "IMU configuration", "=================", "")
        for name, imu in self.calibration.imus.items():
            yield from (f"{name.upper()}:", " ----------------------------")
            yield from _noise(name, self.imus[name], kalibr_model(imu))
            yield from (*_placed(name, pose_in_kalibr(self.calibration, name)), *_model(kalibr_model(imu)), "")

    def _residual_lines(self, title: str, *, normalised: bool) -> Iterator[str]:
        yield from (title, "----------------------------")
        sources = [("Reprojection", name, name, "px") for name in self.calibration.cameras]
        for triad in ("gyroscope", "accelerometer"):
            sources += [(triad.capitalize(), imu, f"{imu}.{triad}", _UNITS[triad]) for imu in self.calibration.imus]
        for what, name, key, unit in sources:
            label = f"{what} error ({name}){'' if normalised else f' [{unit}]'}:".ljust(31 if normalised else 36)
            found = self.residuals.get(key)
            nothing = "no corners" if unit == "px" else "no samples"
            yield label + (nothing if found is None else str(found.normalised if normalised else found.plain))


def _matrix(values: Floats, indent: str = "") -> list[str]:
    """Return the lines of an array as NumPy prints it with eight digits and no exponents."""
    text = np.array2string(values + 0.0, max_line_width=200, precision=8, suppress_small=True)
    return [indent + line for line in text.splitlines()]


def _transformation(name: str, camera: CameraCalibration) -> Iterator[str]:
    inverse = np.eye(4)
    inverse[:3, :3] = camera.T_cam_imu[:3, :3].T
    inverse[:3, 3] = -camera.T_cam_imu[:3, :3].T @ camera.T_cam_imu[:3, 3]
    yield from ("", f"Transformation ({name}):", "-----------------------")
    yield from (f"T_ci:  (imu0 to {name}): ", *_matrix(camera.T_cam_imu), "")
    yield from (f"T_ic:  ({name} to imu0): ", *_matrix(inverse), "")
    yield f"timeshift {name} to imu0: [s] (t_imu = t_cam + shift)"
    yield from (str(float(camera.time_shift_cam_imu)), "")


def _lens(lens: Camera) -> Iterator[str]:
    camera = without_k3(lens).camera
    values = camera.intrinsics.tolist()
    yield f"  Camera model: {camera.projection}"
    yield f"  Focal length: {values[-4:-2]}"
    yield f"  Principal point: {values[-2:]}"
    for name, value in zip(LENS_NAMES[camera.projection], values[:-4], strict=True):
        yield f"  {name}: {value}"
    yield f"  Distortion model: {camera.distortion}"
    yield f"  Distortion coefficients: {camera.distortion_coeffs.tolist()}"


def board_lines(target: Target) -> Iterator[str]:
    """Yield the lines on the board."""
    yield f"  Type: {target.kind}"
    if target.kind == "aprilgrid":
        yield from ("  Tags: ", f"    Rows: {target.rows}", f"    Cols: {target.cols}")
        yield f"    Size: {float(target.tag_size_m)} [m]"
        yield f"    Spacing {float(target.tag_size_m * target.tag_spacing)} [m]"
        return
    if target.kind == "charuco":  # of which Kalibr knows nothing
        yield from ("  Squares: ", f"    Rows: {target.rows}", f"    Cols: {target.cols}")
        yield f"    Size: {float(target.square_size_m)} [m]"
        yield from ("  Markers: ", f"    Marker size: {float(target.marker_size_m)} [m]")
        yield from (f"    Dictionary: {target.dictionary}", f"    First: {target.first_tag}")
        yield f"    Legacy: {'yes' if target.legacy else 'no'}"
        return
    checkerboard = target.kind == "checkerboard"
    row, col = (target.row_spacing_m, target.col_spacing_m) if checkerboard else (target.spacing_m,) * 2
    yield from ("  Rows", f"    Count: {target.rows}", f"    Distance: {float(row)} [m]")
    yield from ("  Cols", f"    Count: {target.cols}", f"    Distance: {float(col)} [m]")


def _noise(name: str, stated: StatedImu, model: KalibrModel) -> Iterator[str]:
    noise, rate_hz = stated.noise, stated.update_rate_hz
    if noise is None or rate_hz is None:
        raise OptionError(f"{name}: Kalibr's results hold noise and rate of every IMU, and these are not stated.")
    root = float(np.sqrt(rate_hz))
    yield from (f"  Model: {model.name}", f"  Update rate: {float(rate_hz)}")
    for triad in ("accelerometer", "gyroscope"):
        density = float(getattr(noise, f"{triad}_noise_density"))
        # Kalibr leaves a space behind the density of the accelerometer only.
        yield from (
            f"  {triad.capitalize()}:",
            f"    Noise density: {density}{' ' if triad == 'accelerometer' else ''}",
        )
        yield f"    Noise density (discrete): {density * root} "
        yield f"    Random walk: {float(getattr(noise, f'{triad}_random_walk'))}"


def _placed(name: str, pose: tuple[Floats, float] | None) -> Iterator[str]:
    if pose is not None:
        yield from (f"  T_ib (imu0 to {name})", *_matrix(pose[0], "    "))
        yield f"  time offset with respect to IMU0: {pose[1]} [s]"


def _model(model: KalibrModel) -> Iterator[str]:
    if model.name == "calibrated":
        return
    if model.M_gyro is not None and model.A_gyro is not None and model.C_gyro_i is not None:
        yield from ("  Gyroscope: ", "    M:", *_matrix(model.M_gyro, "      "))
        yield from ("    A [(rad/s)/(m/s^2)]:", *_matrix(model.A_gyro, "      "))
        yield from ("    C_gyro_i:", *_matrix(model.C_gyro_i, "      "))
    yield from ("  Accelerometer: ", "    M:", *_matrix(model.M_accel, "      "))
    for axis, arm in zip("xyz", () if model.lever_arms_m is None else model.lever_arms_m, strict=False):
        yield from (f"    r{axis}_i [m]:", *_matrix(arm, "      "))
