"""gnomon's own calibration file, schema "gnomon/1", with cameras "gnomon/1.1"; `readers.calibration_file` reads it.

Matrices stand row by row, numbers read back bit by bit, and the same calibration gives the same bytes.
"""

import math
from os import PathLike
from typing import Any

import numpy as np

from ..calibration import Assessment, Calibration, CameraCalibration, CameraImuFit, Covariance, parameters
from ..errors import OutputError
from ..output import write_whole
from ..readers.calibration_file import SCHEMA_MAJOR, SCHEMA_MINOR
from .yaml_text import yaml_lines

FRAMES = {
    "accel-x": "x along the sensitivity axis of the x accelerometer, the axis of the y accelerometer in the x-y plane",
    "accel-z": "z along the sensitivity axis of the z accelerometer, the axis of the y accelerometer in the y-z plane",
    "user": "the axes that its owner named",
}
"""Body frames in words."""

_HEADER = """\
# Calibration of an inertial sensor, made by gnomon.
#
# With specific force f [m/s^2] and angular rate w [rad/s] in the body frame, the sensor reads, in its `unit`,
#
#     accelerometer = sensitivity * f + bias
#     gyroscope     = sensitivity * w + bias + g_sensitivity * f
#
# so that f = sensitivity^-1 (accelerometer - bias), and w = sensitivity^-1 (gyroscope - bias - g_sensitivity * f).
# Units: sensitivity in unit per m/s^2 (accelerometer) or unit per rad/s (gyroscope), bias in unit, g_sensitivity in
# unit per m/s^2. Matrices have a row for each sensor axis and a column for each body axis.
# Body frame: {frame}.
"""

_CAMERAS = """\
#
# Cameras: p_cam = T_cam_imu p_imu takes a point from the body frame of imu0 to that of the camera (x right, y down, z
# forward), in m. An image stamped t_cam was taken at t_imu = t_cam + time_shift_cam_imu, and its row v line_delay * v
# later, in s. Pixel (0, 0) is the centre of the top-left pixel. Lenses are Kalibr's: intrinsics of pinhole [fu, fv, pu,
# pv], omni [xi, ...], eucm [alpha, beta, ...], ds [xi, alpha, ...]; distortion_coeffs of radtan [k1, k2, p1, p2],
# equidistant [k1, k2, k3, k4], fov [w]. T_cam_imu_rotation_sigma is that of a small rotation about the body's axes in
# rad, T_cam_imu_translation_sigma that of the last column of T_cam_imu in m.
#
"""

_SIGMAS = """\
# Every *_sigma is one standard deviation, and the square root of the covariance's diagonal at the end of this file.
"""


def save(calibration: Calibration, path: str | PathLike[str]) -> None:
    """Write a calibration to gnomon's own YAML file; a second run writes the same bytes.

    Raises
    ------
    OutputError
        If the file cannot be written, or a parameter is not a finite number.
    """
    write_whole(path, calibration_text(calibration))


def calibration_text(calibration: Calibration) -> str:
    """Return the text of the calibration file.

    Raises
    ------
    OutputError
        If a parameter is not a finite number.
    """
    for name, value in parameters(calibration.imus, calibration.cameras):
        if not np.isfinite(value).all():
            raise OutputError(f"{name} is not a finite number: this calibration is of no use and was not written.")
    header = _HEADER.format(frame=f"{calibration.frame}, {FRAMES.get(calibration.frame, FRAMES['user'])}")
    header += (_CAMERAS if calibration.cameras else "") + _SIGMAS
    return header + "\n" + "\n".join(yaml_lines(_document(calibration))) + "\n"


def _document(calibration: Calibration) -> dict[str, Any]:
    # Without cameras nothing is newer than the first schema, so that older versions can read the file.
    with_cameras = calibration.cameras or calibration.assessment.camera_imu
    minor = f".{SCHEMA_MINOR}" if with_cameras else ""
    gravity, provenance = calibration.gravity, calibration.provenance
    origin: dict[str, Any] = {
        "gnomon_version": provenance.gnomon_version,
        "method": provenance.method,
        "inputs": [{"name": source.name, "sha256": source.sha256} for source in provenance.inputs],
        "options": dict(provenance.options),
    }
    if provenance.seed is not None:
        origin["seed"] = provenance.seed
    return {
        "schema": f"gnomon/{SCHEMA_MAJOR}{minor}",
        "verdict": calibration.verdict,
        "body_frame": calibration.frame,
        "gravity": {"value": gravity.value, "sigma": gravity.sigma, "source": gravity.source},
        "imus": _imus(calibration),
        "cameras": {name: _camera(calibration, name, camera) for name, camera in calibration.cameras.items()},
        "assessment": _assessment(calibration.assessment),
        "provenance": origin,
        "covariance": _covariance(calibration.uncertainty),
    }


def _imus(calibration: Calibration) -> dict[str, Any]:
    result: dict[str, Any] = {}
    for name, imu in calibration.imus.items():
        result[name] = {"accelerometer": {"unit": imu.accelerometer.unit}}
        if imu.gyroscope is not None:
            result[name]["gyroscope"] = {"unit": imu.gyroscope.unit}
    for path, value in parameters(calibration.imus):
        imu, triad, parameter = path.split(".")
        result[imu][triad][parameter] = value
        result[imu][triad][f"{parameter}_sigma"] = calibration.sigma(path)
    return result


def _camera(calibration: Calibration, name: str, calibrated: CameraCalibration) -> dict[str, Any]:
    camera = calibrated.camera

    def sigma(parameter: str) -> Any:
        value = calibration.sigma(f"{name}.{parameter}")
        return value if value.ndim else float(value)

    return {
        "T_cam_imu": calibrated.T_cam_imu,
        "T_cam_imu_rotation_sigma": sigma("T_cam_imu.rotation"),
        "T_cam_imu_translation_sigma": sigma("T_cam_imu.translation"),
        "time_shift_cam_imu": float(calibrated.time_shift_cam_imu),
        "time_shift_cam_imu_sigma": sigma("time_shift_cam_imu"),
        "camera_model": camera.projection,
        "intrinsics": camera.intrinsics,
        "intrinsics_sigma": sigma("intrinsics"),
        "distortion_model": camera.distortion,
        "distortion_coeffs": camera.distortion_coeffs,
        "distortion_coeffs_sigma": sigma("distortion_coeffs"),
        "resolution": np.array(camera.resolution),
        "line_delay": float(camera.line_delay_s),
        "line_delay_sigma": sigma("line_delay"),
        "rostopic": camera.topic,
    }


def _assessment(assessment: Assessment) -> dict[str, Any]:
    fit = assessment.camera_imu
    return {
        "verdict": assessment.verdict,
        "model": assessment.model,
        **(_multi_position(assessment) if fit is None else {"camera_imu": _camera_imu(fit)}),
        "held_by_prior": list(assessment.held_by_prior),
        "findings": [
            {
                key: getattr(finding, key)
                for key in ("severity", "code", "message", "consequence", "cure")
                if getattr(finding, key) or key in ("severity", "code", "message")
            }
            for finding in assessment.findings
        ],
    }


def _multi_position(assessment: Assessment) -> dict[str, Any]:
    holdout = assessment.holdout
    return {
        "holdout": {
            "accelerometer_rms": _known(holdout.accelerometer_rms),
            "rotation_rms": _known(holdout.rotation_rms),
        },
        "intervals_found": assessment.intervals_found,
        "intervals_used": assessment.intervals_used,
        "rotations_found": assessment.rotations_found,
        "rotations_used": assessment.rotations_used,
    }


def _camera_imu(fit: CameraImuFit) -> dict[str, Any]:
    cameras = {
        name: {
            "frames_found": fit.frames_found[name],
            "frames_used": fit.frames_used[name],
            "corners_used": fit.corners_used[name],
            "reprojection_rms_px": _known(fit.reprojection_rms_px[name]),
        }
        for name in fit.frames_found
    }
    return {"duration_s": float(fit.duration_s), "converged": bool(fit.converged), "cameras": cameras}


def _known(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def _covariance(covariance: Covariance) -> dict[str, Any]:
    rows = [covariance.matrix[i, : i + 1] for i in range(len(covariance.names))]
    return {"names": list(covariance.names), "lower_triangle": rows}
