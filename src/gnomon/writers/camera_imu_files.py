"""The files that Kalibr writes after a camera-IMU calibration, and the trajectory, from gnomon's result."""

from collections.abc import Iterator
from math import isfinite
from os import PathLike
from pathlib import Path

import numpy as np

from ..formats.foreign import Residuals, Statistics
from ..formats.kalibr.camchain import CAMCHAIN_FILE, camchain_text
from ..formats.kalibr.imu import IMU_FILE, imu_text
from ..formats.kalibr.results import RESULTS_FILE, KalibrResults
from ..formats.shared.entries import ignored_values
from ..formats.shared.losses import Context, StatedImu, file_remarks, loss_sentences, origin_remarks
from ..models.noise import CONSUMER_MEMS, ImuNoise
from ..models.target import Target
from ..output import write_together
from ..recording import Floats, ImuSamples, Recording
from ..results.calibration import Calibration
from ..results.camera_diagnostics import CameraImuDiagnostics, NoiseLevel
from ..results.result import Result
from ..results.sensors import calibration_parameters, parameter_unit
from .pose_files import TRAJECTORY_FILE, trajectory_text

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
    return {name: Residuals(normalised=Statistics.of(errors / sigma), plain=Statistics.of(errors))}


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
    return getattr(CONSUMER_MEMS, key) if level is None else level.used


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
