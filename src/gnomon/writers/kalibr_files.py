"""The files that Kalibr writes after a calibration of cameras, or of cameras and an IMU, from gnomon's result."""

from collections.abc import Iterator, Mapping
from itertools import pairwise
from math import isfinite
from os import PathLike
from pathlib import Path

import numpy as np

from ..errors import OptionError
from ..formats.foreign import Residuals, Statistics
from ..formats.kalibr.camchain import CAMCHAIN_FILE, LENS_FILE, camchain_text, camera_baseline, lens_chain_text
from ..formats.kalibr.imu import IMU_FILE, KalibrModel, imu_text, kalibr_model, pose_in_kalibr
from ..formats.kalibr.results import LENS_NAMES, RESULTS_FILE
from ..formats.kalibr.target import board_lines
from ..formats.shared.entries import baseline_of
from ..formats.shared.losses import (
    Context,
    StatedImu,
    file_remarks,
    ignored_values,
    loss_sentences,
    origin_remarks,
    without_k3,
)
from ..frozen import value_class
from ..geometry.rotations import inverse_pose, quaternion_from_rotation
from ..models.camera import Camera
from ..models.target import Target
from ..output import write_together
from ..recording import Floats, ImuSamples, Integers, Recording
from ..recording.samples import ImuNoise, consumer_mems
from ..results.calibration import Calibration, CameraCalibration
from ..results.camera_diagnostics import CameraImuDiagnostics, CamerasDiagnostics, NoiseLevel, TrajectoryTrack
from ..results.result import Result
from ..results.sensors import calibration_parameters, parameter_unit

TRAJECTORY_FILE = "trajectory.txt"
_HEADER = """\
# Pose of imu0 in the target's frame at the timestamps of the IMU, made by gnomon: p_target = R(q) p_imu + t.
# timestamp [s] tx ty tz [m] qx qy qz qw (Hamilton)
"""
_S_NS = 1_000_000_000
_UNITS = {"accelerometer": "m/s^2", "gyroscope": "rad/s"}
CAMERA_IMU_FILES = (CAMCHAIN_FILE, IMU_FILE, RESULTS_FILE, TRAJECTORY_FILE)


def save_camera_imu_files(
    result: Result, recording: Recording, target: Target, directory: str | PathLike[str]
) -> tuple[Path, ...]:
    """Write what Kalibr writes, and the trajectory, into a folder that is there, and return the files.

    The files are `camchain-imucam.yaml`, `imu.yaml`, `results-imucam.txt` and `trajectory.txt`.

    Parameters
    ----------
    result : of `gnomon.calibrate_camera_imu`
    recording, target : that it was made from

    Raises
    ------
    OutputError
        If a file cannot be written.
    """
    folder = Path(directory)
    texts = camera_imu_texts(result, recording, target)
    write_together(folder, texts)
    return tuple(folder / name for name in texts)


def camera_imu_texts(result: Result, recording: Recording, target: Target) -> dict[str, str]:
    """Return the texts of the files by name."""
    diagnostics = result.diagnostics
    assert isinstance(diagnostics, CameraImuDiagnostics)
    calibration = (
        result.calibration if result.calibration.frame == "accel-x" else result.calibration.in_frame("accel-x")
    )
    imus = {name: stated_imu(name, recording.imus[name], diagnostics) for name in calibration.imus}
    results = KalibrResults(
        calibration=calibration,
        target=target,
        residuals=residual_statistics(diagnostics),
        gravity_target=diagnostics.gravity_target,
        imus=imus,
        notes=tuple(_notes(calibration, diagnostics)),
    )
    said = Context(
        remarks=(
            *origin_remarks(calibration),
            *file_remarks(calibration),
            *loss_sentences(ignored_values(calibration, "kalibr")),
        )
    ).comment()
    return {
        CAMCHAIN_FILE: camchain_text(calibration, said),
        IMU_FILE: imu_text(calibration, imus, said),
        RESULTS_FILE: results.text(),
        TRAJECTORY_FILE: trajectory_text(diagnostics.trajectory),
    }


def residual_statistics(diagnostics: CameraImuDiagnostics) -> dict[str, Residuals]:
    """Return statistics of the residuals of what was used: "cam0", "imu0.gyroscope", ... -> Residuals."""
    found: dict[str, Residuals] = {}
    for name, fit in diagnostics.corners.items():
        errors = np.linalg.norm(fit.residual, axis=1)
        found |= _statistics(name, errors[fit.frame_used[fit.frame] & np.isfinite(errors)], fit.sigma_px)
    for name, fit in diagnostics.signals.items():
        errors = np.linalg.norm(fit.predicted - fit.measured, axis=1)
        found |= _statistics(name, errors[fit.used & np.isfinite(errors)], fit.sigma)
    return found


def _statistics(name: str, errors: Floats, sigma: float) -> dict[str, Residuals]:
    if not len(errors):
        return {}
    normalised, plain = (
        Statistics(mean=float(np.mean(lengths)), median=float(np.median(lengths)), std=float(np.std(lengths)))
        for lengths in (errors / sigma, errors)
    )
    return {name: Residuals(normalised=normalised, plain=plain)}


def stated_imu(name: str, samples: ImuSamples, diagnostics: CameraImuDiagnostics) -> StatedImu:
    """Return noise, rate and topic of an IMU as they were stated; noise that was not, as it was used."""
    levels = {level.name: level for level in diagnostics.noise}
    used = {
        f"{triad}_noise_density": _used(levels.get(f"{name}.{triad}"), f"{triad}_noise_density")
        for triad in ("accelerometer", "gyroscope")
    } | {
        f"{triad}_random_walk": diagnostics.biases[f"{name}.{triad}"].random_walk
        for triad in ("accelerometer", "gyroscope")
    }
    noise = samples.noise or ImuNoise(**used)
    comments = ["the noise is the stated one" if samples.noise else "no noise was stated; this is what was used"]
    for triad in ("accelerometer", "gyroscope"):
        level = levels.get(f"{name}.{triad}")
        if level is not None and isfinite(level.estimated):
            comments.append(f"{triad}_noise_density found in the residuals: {level.estimated:.4g} {level.unit}")
    return StatedImu(
        noise=noise,
        update_rate_hz=round(samples.gyroscope.rate_hz, 4),
        topic=samples.topic,
        comments=tuple(comments),
    )


def _used(level: NoiseLevel | None, key: str) -> float:
    return getattr(consumer_mems(), key) if level is None else level.used


def _notes(calibration: Calibration, diagnostics: CameraImuDiagnostics) -> Iterator[str]:
    """Yield the blocks that Kalibr does not have."""
    yield from ("", "", "Added by gnomon", "===============", "")
    yield f"Verdict: {calibration.verdict}; model {calibration.assessment.model}; reasons are in calibration.yaml"
    yield "Normalized residuals are in units of the noise that was used"
    yield from Context(remarks=file_remarks(calibration)).lines()
    yield from ("", "Noise: stated beforehand, found in the residuals, used", "----------------------------")
    for level in diagnostics.noise:
        stated = f"{level.nominal:.6g}" if isfinite(level.nominal) else "not stated"
        yield f"  {level.name} [{level.unit}]: {stated}, {level.estimated:.6g}, {level.used:.6g}"
    yield from ("", "Standard deviations (zero: fixed)", "----------------------------")
    yield f"  gravity in the target's frame [m/s^2]: {_numbers(diagnostics.gravity_sigma)}"
    paths = [f"{name}.{key}" for name in calibration.cameras for key in _CAMERA_PATHS]
    paths += [f"{imu}.{path}" for imu in calibration.imus for path in _IMU_PATHS]
    known = dict(calibration_parameters(calibration.imus))
    paths += [path for imu in calibration.imus for path in (f"{imu}.{rest}" for rest in _RIG_PATHS) if path in known]
    for path in paths:
        sigma = calibration.sigma(path)
        if sigma.size:
            unit = parameter_unit(calibration, path)
            yield f"  {path} [{unit}]: {'; '.join(_numbers(row) for row in np.atleast_2d(sigma))}"


_CAMERA_PATHS = (
    "T_cam_imu.rotation",
    "T_cam_imu.translation",
    "time_shift_cam_imu",
    "line_delay",
    "intrinsics",
    "distortion_coeffs",
)
_RIG_PATHS = (
    "accelerometer.lever_arms_m",
    "T_imu_body.rotation",
    "T_imu_body.translation",
    "time_shift_imu",
    "accelerometer.time_shift",
)
"""Those that not every IMU has."""
_IMU_PATHS = ("accelerometer.sensitivity", "gyroscope.sensitivity", "gyroscope.g_sensitivity")


def _numbers(values: Floats) -> str:
    return " ".join(f"{value:.3g}" for value in np.atleast_1d(values).tolist())


@value_class
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
            pose = camera_baseline(before, camera)
            yield from (f"Baseline ({first} to {second}): ", *_matrix(pose))
            yield from (f"baseline norm:  {float(np.linalg.norm(pose[:3, 3]))} [m]", "")
        yield from ("", "Gravity vector in target coords: [m/s^2]", *_matrix(self.gravity_target), "", "")
        yield from ("Calibration configuration", "=========================", "")
        for name, camera in cameras.items():
            yield from (name, "-----", *_lens(camera.camera), *board_lines(self.target), "")
        yield from ("", "", "IMU configuration", "=================", "")
        for name, imu in self.calibration.imus.items():
            yield from (f"{name.upper()}:", " ----------------------------")
            yield from _noise_lines(name, self.imus[name], kalibr_model(imu))
            yield from (*_placed(name, pose_in_kalibr(self.calibration, name)), *_model(kalibr_model(imu)), "")

    def _residual_lines(self, title: str, *, normalised: bool) -> Iterator[str]:
        yield from (title, "----------------------------")
        sources = [("Reprojection", name, name, "px") for name in self.calibration.cameras]
        for triad in ("gyroscope", "accelerometer"):
            sources += [(triad.capitalize(), imu, f"{imu}.{triad}", _UNITS[triad]) for imu in self.calibration.imus]
        for what, name, key, unit in sources:
            label = f"{what} error ({name}){'' if normalised else f' [{unit}]'}:".ljust(31 if normalised else 36)
            found = self.residuals.get(key)
            if found is None:
                yield label + ("no corners" if unit == "px" else "no samples")
            else:
                shown = found.normalised if normalised else found.plain
                yield f"{label}mean {shown.mean}, median {shown.median}, std: {shown.std}"


def _matrix(values: Floats, indent: str = "") -> list[str]:
    """Return the lines of an array as NumPy prints it with eight digits and no exponents."""
    text = np.array2string(values + 0.0, max_line_width=200, precision=8, suppress_small=True)
    return [indent + line for line in text.splitlines()]


def _transformation(name: str, camera: CameraCalibration) -> Iterator[str]:
    yield from ("", f"Transformation ({name}):", "-----------------------")
    yield from (f"T_ci:  (imu0 to {name}): ", *_matrix(camera.T_cam_imu), "")
    yield from (f"T_ic:  ({name} to imu0): ", *_matrix(inverse_pose(camera.T_cam_imu)), "")
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


def _noise_lines(name: str, stated: StatedImu, model: KalibrModel) -> Iterator[str]:
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


def trajectory_text(track: TrajectoryTrack) -> str:
    """Return the text of a trajectory; timestamps are exact to 1 ns, positions to 1 nm, quaternions to 1e-12."""
    q_xyzw = np.asarray(track.q_target_imu_wxyz)[:, [1, 2, 3, 0]]
    numbers = np.column_stack([track.p_target_imu, q_xyzw]).tolist()
    form = " ".join(["%s", *["%.9f"] * 3, *["%.12f"] * 4, ""]).rstrip() + "\n"
    stamps = seconds_texts(track.t_ns)
    return _HEADER + "".join(form % (stamp, *row) for stamp, row in zip(stamps, numbers, strict=True))


def seconds_texts(t_ns: Integers) -> list[str]:
    """Return timestamps (n,) [ns] as seconds with nine decimals, without a detour over floats.

    Examples
    --------
    >>> seconds_texts(np.array([1600000000005000001, -1, 0]))
    ['1600000000.005000001', '-0.000000001', '0.000000000']
    """
    seconds, rest = np.divmod(np.abs(t_ns), _S_NS)
    signs = ["-" if negative else "" for negative in (np.asarray(t_ns) < 0).tolist()]
    parts = zip(signs, seconds.tolist(), rest.tolist(), strict=True)
    return [f"{sign}{whole}.{fraction:09d}" for sign, whole, fraction in parts]


CAMERA_RESULTS_FILE = "results-cam.txt"


def save_camera_files(result: Result, target: Target, directory: str | PathLike[str]) -> tuple[Path, ...]:
    """Write what Kalibr writes, `camchain.yaml` and `results-cam.txt`, into a folder that is there; return the files.

    Parameters
    ----------
    result : of `gnomon.calibrate_cameras`
    target : the board that was seen

    Raises
    ------
    OutputError
        If a file cannot be written.
    """
    texts = camera_texts(result, target)
    write_together(directory, texts)
    return tuple(Path(directory) / name for name in texts)


def camera_texts(result: Result, target: Target) -> dict[str, str]:
    """Return the texts of the files by name."""
    calibration, diagnostics = result.calibration, result.diagnostics
    assert isinstance(diagnostics, CamerasDiagnostics)
    said = Context(remarks=file_remarks(calibration)).comment()
    chain = lens_chain_text(calibration, said, seen_together(diagnostics))
    return {LENS_FILE: chain, CAMERA_RESULTS_FILE: "\n".join(_results(calibration, diagnostics, target)) + "\n"}


def seen_together(diagnostics: CamerasDiagnostics) -> dict[str, list[int]]:
    """Return the numbers of the cameras that saw the board in the same views as each camera."""
    together: dict[str, set[int]] = {name: set() for name in diagnostics.corners}
    for view in diagnostics.views:
        for name in view.cameras:
            together[name] |= {int(other.removeprefix("cam")) for other in view.cameras if other != name}
    return {name: sorted(others) for name, others in together.items()}


def _results(calibration: Calibration, diagnostics: CamerasDiagnostics, target: Target) -> Iterator[str]:
    """Yield the lines of results-cam.txt; quaternions are x y z w, as Kalibr has them (JPL)."""
    yield from ("Calibration results ", "====================", "Camera-system parameters:")
    for name, calibrated in calibration.cameras.items():
        lens = without_k3(calibrated.camera).camera
        kept = len(lens.distortion_coeffs)  # a k3 is of no model of Kalibr's
        yield from (f"{name} ({lens.topic}):", f"    type: {lens.model}")
        yield _pair("distortion", lens.distortion_coeffs, calibration.sigma(f"{name}.distortion_coeffs")[:kept])
        yield _pair("projection", lens.intrinsics, calibration.sigma(f"{name}.intrinsics"))
        yield from (_errors(name, diagnostics), "")
    numbers = {name: name.removeprefix("cam") for name in calibration.cameras}
    for first, second in pairwise(calibration.cameras):
        found = baseline_of(calibration, first, second)
        w, x, y, z = quaternion_from_rotation(found.T[:3, :3]).tolist()
        sigma = np.sqrt(np.diag(found.covariance))
        yield f"baseline T_{numbers[second]}_{numbers[first]}:"
        yield _pair("q", np.array([-x, -y, -z, w]), sigma[:3])
        yield from (_pair("t", found.T[:3, 3], sigma[3:]), "")
    yield from ("", "", "Target configuration", "====================", "", *board_lines(target))
    yield from ("", "", "Added by gnomon", "===============", "")
    yield f"Verdict: {calibration.verdict}; reasons are in calibration.yaml"
    yield "Standard deviations of a baseline: of a small rotation about the axes of the camera before [rad], of t [m]"
    yield from Context(remarks=file_remarks(calibration)).lines()
    yield from _unseen(calibration)


def _unseen(calibration: Calibration) -> Iterator[str]:
    fit = calibration.assessment.cameras
    holdout: Mapping[str, float] = {} if fit is None else fit.holdout_rms_px
    for name, rms in holdout.items():
        if np.isfinite(rms):
            yield f"Reprojection error ({name}) of views that were not used, rms per axis [px]: {rms:.4g}"


def _pair(name: str, values: Floats, sigmas: Floats) -> str:
    return f"    {name}: {_bracketed(values)} +- {_bracketed(sigmas)}"


def _bracketed(values: Floats) -> str:
    return f"[{' '.join(f'{value:.8g}' for value in values.tolist())}]"


def _errors(name: str, diagnostics: CamerasDiagnostics) -> str:
    """Return mean and standard deviation of the residuals along u and v."""
    fit = diagnostics.corners[name]
    used = fit.residual[fit.frame_used[fit.frame]]
    used = used[np.isfinite(used).all(axis=1)]
    if not len(used):
        return "    reprojection error: no corners"
    (mu, mv), (su, sv) = used.mean(axis=0).tolist(), used.std(axis=0).tolist()
    return f"    reprojection error: [{mu:f}, {mv:f}] +- [{su:f}, {sv:f}]"
