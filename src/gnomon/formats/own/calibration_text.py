"""gnomon's own calibration file, schema "gnomon/1" and its minors: how it is told, its keys, and its text.

`formats.own.calibration_file` reads it. The minor is the lowest that holds the calibration, so that older versions can
read what holds nothing newer. Matrices stand row by row, numbers read back bit by bit, and the same calibration gives
the same bytes.
"""

import math
import re
from dataclasses import asdict
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import OutputError
from ...findings import Finding
from ...models.origin import AXES, Origin
from ...output import write_whole
from ...recording import Source
from ...results.calibration import (
    Assessment,
    Calibration,
    CameraCalibration,
    CameraImuFit,
    CamerasFit,
    Covariance,
    ImuCalibration,
    Provenance,
    calibration_parameters,
)
from ...results.result import Result, calibration_of
from ...results.trust import Need, QuantityChange, UncertaintySummary
from ..shared.structured import read_structured_text
from ..shared.yaml_text import yaml_lines

_SCHEMA = re.compile(r"""(?m)^schema\s*:|"schema"\s*:\s*"gnomon""")


def is_own(path: str | PathLike[str]) -> bool:
    """Return whether a file, or the calibration in the folder of a result, says that it is gnomon's own."""
    return _SCHEMA.search(read_structured_text(calibration_at(path))) is not None


def is_noise(path: str | PathLike[str]) -> bool:
    """Return whether a file says that it is gnomon's own file of noise."""
    return re.search(r"(?m)^schema\s*:\s*[\"']?gnomon-noise/", read_structured_text(path)) is not None


def calibration_at(path: str | PathLike[str]) -> str | PathLike[str]:
    """Return the calibration, or else the noise, in the folder of a result; anything else as it is."""
    inside = (Path(path) / name for name in ("calibration.yaml", "noise.yaml"))
    return next((file for file in inside if file.is_file()), path)


VIEW_COUNTS = ("views_found", "views_used", "corners_used")
VIEW_NUMBERS = ("reprojection_rms_px", "holdout_rms_px", "coverage")
BOARD_NUMBERS = ("aspect", "aspect_sigma", "bow_m", "bow_sigma_m", "print_scale", "print_scale_sigma")
"""Keys of what a calibration of cameras alone rests on, of each camera and of the board, as in `CamerasFit`."""
SCHEMA_MAJOR = 1
TEMPERATURE_NUMBERS = ("reference_degc", "low_degc", "high_degc", "lag_s")
"""Keys of a dependence on temperature beside its coefficients."""


def imu_keys(path: str) -> tuple[str, tuple[str, ...], str]:
    """Return of a parameter of an IMU its IMU, the keys under which it stands there, and the key of its sigmas."""
    imu, *keys = path.split(".")
    if keys[0] == "T_imu_body":  # one matrix, but two sets of sigmas
        return imu, ("T_imu_body",), f"T_imu_body_{keys[1]}_sigma"
    return imu, tuple(keys), f"{keys[-1]}_sigma"


FRAMES = {
    "accel-x": "x along the sensitivity axis of the x accelerometer, the axis of the y accelerometer in the x-y plane",
    "accel-z": "z along the sensitivity axis of the z accelerometer, the axis of the y accelerometer in the y-z plane",
    "gyro-x": "x along the sensitivity axis of the x gyroscope, the axis of the y gyroscope in the x-y plane",
    "mag-x": "x along the sensitivity axis of the x magnetometer, the axis of the y magnetometer in the x-y plane",
    "user": "the axes that its owner named",
    "cam0": "x right, y down, z forward, as cam0 sees",
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
_MAGNETOMETER = """\
#
# Magnetometer: with the magnetic field m in `field_unit` and in the body frame, the sensor reads sensitivity * m + bias
# in its `unit`, so that m = sensitivity^-1 (magnetometer - bias). Where the strength of the field was not stated,
# field_unit is "local field", and m has length 1 where it was calibrated. What the field magnetises ("soft iron") is
# part of the sensitivity, what is magnetic by itself ("hard iron") is part of the bias: both hold as long as nothing
# of iron is moved, added or taken away near the sensor.
#
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
_CAMERAS_ALONE = """\
# Calibration of cameras, made by gnomon.
#
# p_cam = T_cam_cam0 p_cam0 takes a point from the frame of cam0 (x right, y down, z forward) to that of another camera,
# in m. Pixel (0, 0) is the centre of the top-left pixel. Lenses are Kalibr's: intrinsics of pinhole [fu, fv, pu, pv],
# omni [xi, ...], eucm [alpha, beta, ...], ds [xi, alpha, ...]; distortion_coeffs of radtan [k1, k2, p1, p2], radtan5
# [k1, k2, p1, p2, k3], equidistant [k1, k2, k3, k4], fov [w]. T_cam_cam0_rotation_sigma is that of a small rotation
# about the axes of cam0 in rad, T_cam_cam0_translation_sigma that of the last column of T_cam_cam0 in m. line_delay is
# that of a rolling shutter in s, as it was stated. `gnomon camera-imu --cam` takes this file, and its covariance.
#
"""
_LEVER_ARMS = """\
#
# Lever arms: the three accelerometers do not sit at one point. lever_arms_m has a row for each of them, where it sits
# from the body's origin in the body frame, in m. Component k of the f that the accelerometer feels is that at row k, r:
# (f + a x r + w x (w x r))[k], with a the angular acceleration; the gyroscope's g_sensitivity acts on f at the origin.
#
"""
_ORIGIN = """\
#
# Origin: which point of an IMU T_cam_imu and T_imu_body refer to. point: optimal is p* = W_x r_x + W_y r_y + W_z r_z of
# the places r of its x, y and z accelerometers, with the `weights` of this recording: the point whose place is known
# best, since it does not depend on where they sit, and which a model with one place for all three finds. x, y, z: that
# accelerometer; place: place_m from the x accelerometer, in m. Python's with_origin moves to another point.
#
"""
_SEVERAL_IMUS = """\
#
# Several IMUs: the body is imu0. Every other IMU has a frame of its own, by the same rule, to which its sensitivities
# refer: p_imu = T_imu_body p_body, in m. A sample stamped t_imu was taken at t_body = t_imu + time_shift_imu, in s.
# T_imu_body_rotation_sigma is that of a small rotation about the body's axes in rad, T_imu_body_translation_sigma that
# of the last column of T_imu_body in m.
#
"""
_ACCELEROMETER_SHIFT = """\
#
# Accelerometers with a delay of their own: t_gyroscope = t_accelerometer + time_shift, in s, of the timestamps of one
# instant. The time shifts of IMUs and cameras are between gyroscopes, and to that of imu0.
#
"""
_TEMPERATURE = """\
#
# Temperature: sensitivities and biases hold at reference_degc. With d = T - reference_degc, in sensor axes and row j
# for d^j, gyroscope_bias and accelerometer_bias (unit/K^j) are added to the bias, from low_degc to high_degc; beyond
# at the nearer end. What is beside the bias is multiplied by 1 + the sum of gyroscope_sensitivity and
# accelerometer_sensitivity (1/K^j) in the same way: measured = (1 + D) (sensitivity @ f) + bias.
# gyroscope_g_sensitivity times what the accelerometer reads at the reference, less its bias, is added before that.
# lag_s: the thermometer follows the sensor, x' = (T - x) / lag_s of its reading x, in s.
#
"""
_SIGMAS = """\
# Every *_sigma is one standard deviation, and the square root of the covariance's diagonal at the end of this file.
"""


def save(calibration: Calibration | Result, path: str | PathLike[str]) -> None:
    """Write a calibration, or that of a result, to gnomon's own YAML file; a second run writes the same bytes.

    Raises
    ------
    OutputError
        If the file cannot be written, or a parameter is not a finite number.
    OptionError
        If it is no calibration.
    """
    write_whole(path, calibration_text(calibration_of(calibration)))


def calibration_text(calibration: Calibration) -> str:
    """Return the text of the calibration file.

    Raises
    ------
    OutputError
        If a parameter is not a finite number.
    """
    for name, value in calibration_parameters(calibration.imus, calibration.cameras):
        if not np.isfinite(value).all():
            raise OutputError(f"{name} is not a finite number: this calibration is of no use and was not written.")
    if not calibration.imus:
        return _CAMERAS_ALONE + _SIGMAS + "\n" + "\n".join(yaml_lines(_document(calibration))) + "\n"
    header = _HEADER.format(frame=f"{calibration.frame}, {FRAMES.get(calibration.frame, FRAMES['user'])}")
    if any(imu.magnetometer is not None for imu in calibration.imus.values()):
        header += _MAGNETOMETER
    if _with_lever_arms(calibration):
        header += _LEVER_ARMS
    if _with_origin(calibration):
        header += _ORIGIN
    if any(imu.T_imu_body is not None for imu in calibration.imus.values()):
        header += _SEVERAL_IMUS
    if _with_shifted_accelerometer(calibration):
        header += _ACCELEROMETER_SHIFT
    if _with_temperature(calibration):
        header += _TEMPERATURE
    header += (_CAMERAS if calibration.cameras else "") + _SIGMAS
    return header + "\n" + "\n".join(yaml_lines(_document(calibration))) + "\n"


def _document(calibration: Calibration) -> dict[str, Any]:
    minor = _minor(calibration)
    gravity = calibration.gravity
    of_imus = {
        "gravity": {"value": gravity.value, "sigma": gravity.sigma, "source": gravity.source},
        "imus": _imus(calibration),
    }
    return {
        "schema": f"gnomon/{SCHEMA_MAJOR}" + (f".{minor}" if minor else ""),
        "verdict": calibration.verdict,
        "body_frame": calibration.frame,
        **(of_imus if calibration.imus else {}),
        "cameras": {name: _camera(calibration, name, camera) for name, camera in calibration.cameras.items()},
        "assessment": _assessment(calibration.assessment, minor),
        "provenance": provenance_document(calibration.provenance),
        "covariance": _covariance(calibration.uncertainty),
    }


def _minor(calibration: Calibration) -> int:
    """Return the lowest minor of the schema that holds a calibration; older versions of gnomon read lower ones."""
    imus, holdout = calibration.imus.values(), calibration.assessment.holdout
    trust = calibration.assessment.trust
    asks = {
        9: _with_temperature(calibration, "magnetometer_bias", "magnetometer_sensitivity"),
        8: _with_temperature(calibration, "gyroscope_g_sensitivity"),
        7: _with_temperature(calibration),
        6: _tells_of_occasions(trust) or trust.changes or _with_origin(calibration),
        4: not calibration.imus,
        5: any(imu.T_imu_body is not None for imu in imus) or _with_shifted_accelerometer(calibration),
        3: _with_lever_arms(calibration) or _tells(trust),
        2: any(imu.accelerometer is None or imu.magnetometer is not None for imu in imus)
        or calibration.frame in ("gyro-x", "mag-x")
        or math.isfinite(holdout.rate_rms)
        or math.isfinite(holdout.field_rms),
        1: calibration.cameras or calibration.assessment.camera_imu,
    }
    return next((minor for minor, asked in asks.items() if asked), 0)


def _with_lever_arms(calibration: Calibration) -> bool:
    sensors = [imu.accelerometer for imu in calibration.imus.values()]
    return any(sensor is not None and sensor.lever_arms_m is not None for sensor in sensors)


def _with_origin(calibration: Calibration) -> bool:
    """Tell whether an origin says more than that it is the accelerometer whose lever arm is zero."""
    return any(_says_more(imu) for imu in calibration.imus.values())


def _says_more(imu: ImuCalibration) -> bool:
    origin, arms = imu.origin, None if imu.accelerometer is None else imu.accelerometer.lever_arms_m
    if origin is None or origin.weights is not None:
        return origin is not None
    return arms is not None and (origin.point not in AXES or bool(arms[AXES.index(origin.point)].any()))


def _with_shifted_accelerometer(calibration: Calibration) -> bool:
    sensors = [imu.accelerometer for imu in calibration.imus.values()]
    return any(sensor is not None and sensor.time_shift_s is not None for sensor in sensors)


def _with_temperature(calibration: Calibration, *parts: str) -> bool:
    """Tell whether an IMU knows its temperature, or what that changes of certain parts."""
    warm = [imu.temperature for imu in calibration.imus.values() if imu.temperature is not None]
    return any(getattr(one, part) is not None for one in warm for part in parts) if parts else bool(warm)


def _tells_of_occasions(trust: UncertaintySummary) -> bool:
    """Tell whether a note says how a sensor changes from recording to recording."""
    return trust.recordings > 0 or any(need.floor for need in trust.needs)


def _tells(trust: UncertaintySummary) -> bool:
    """Tell whether a note says more than that the covariance is the one for independent errors."""
    return trust.covariance != "ordinary" or bool(
        trust.clusters
        or trust.sigma_ratio
        or math.isfinite(trust.split_z)
        or trust.added
        or trust.tries
        or trust.use
        or trust.changes
    )


def _imus(calibration: Calibration) -> dict[str, Any]:
    result: dict[str, Any] = {}
    for name, imu in calibration.imus.items():
        triads = {"accelerometer": imu.accelerometer, "gyroscope": imu.gyroscope}
        result[name] = {triad: {"unit": sensor.unit} for triad, sensor in triads.items() if sensor is not None}
        if imu.magnetometer is not None:
            result[name]["magnetometer"] = {"unit": imu.magnetometer.unit, "field_unit": imu.magnetometer.field_unit}
        if imu.T_imu_body is not None:
            result[name]["T_imu_body"] = imu.T_imu_body
        if imu.origin is not None and _says_more(imu):
            result[name]["origin"] = _origin(imu.origin)
        if imu.temperature is not None:
            result[name]["temperature"] = {key: float(getattr(imu.temperature, key)) for key in TEMPERATURE_NUMBERS}
    for path, value in calibration_parameters(calibration.imus):
        imu, key, sigma_key = imu_keys(path)
        entry = result[imu]
        for triad in key[:-1]:
            entry = entry[triad]
        sigma = calibration.sigma(path)
        if key[-1] != "T_imu_body":
            entry[key[-1]] = value if value.ndim else float(value)
        entry[sigma_key] = sigma if sigma.ndim else float(sigma)
    return result


def _origin(origin: Origin) -> dict[str, Any]:
    weights = {} if origin.weights is None else {"weights": dict(zip(AXES, origin.weights, strict=True))}
    return {"point": origin.point, **weights, **({} if origin.place_m is None else {"place_m": origin.place_m})}


def _camera(calibration: Calibration, name: str, calibrated: CameraCalibration) -> dict[str, Any]:
    camera = calibrated.camera

    def sigma(parameter: str) -> Any:
        value = calibration.sigma(f"{name}.{parameter}")
        return value if value.ndim else float(value)

    alone, link = calibrated.body != "imu0", calibrated.link
    pose = (
        {
            link: calibrated.T_cam_body,
            f"{link}_rotation_sigma": sigma(f"{link}.rotation"),
            f"{link}_translation_sigma": sigma(f"{link}.translation"),
        }
        if name != calibrated.body
        else {}
    )
    shift = (
        {
            "time_shift_cam_imu": float(calibrated.time_shift_cam_imu),
            "time_shift_cam_imu_sigma": sigma("time_shift_cam_imu"),
        }
        if not alone
        else {}
    )
    return {
        **pose,
        **shift,
        "camera_model": camera.projection,
        "intrinsics": camera.intrinsics,
        "intrinsics_sigma": sigma("intrinsics"),
        "distortion_model": camera.distortion,
        "distortion_coeffs": camera.distortion_coeffs,
        "distortion_coeffs_sigma": sigma("distortion_coeffs"),
        "resolution": np.array(camera.resolution),
        "line_delay": float(camera.line_delay_s),
        **({} if alone else {"line_delay_sigma": sigma("line_delay")}),
        "rostopic": camera.topic,
    }


def _assessment(assessment: Assessment, minor: int) -> dict[str, Any]:
    return {
        "verdict": assessment.verdict,
        "model": assessment.model,
        **_basis(assessment, minor),
        "held_by_prior": list(assessment.held_by_prior),
        "findings": [finding_document(finding) for finding in assessment.findings],
        **({"trust": _trust(assessment.trust)} if _tells(assessment.trust) else {}),
    }


def _trust(trust: UncertaintySummary) -> dict[str, Any]:
    return {
        "covariance": trust.covariance,
        "clusters": int(trust.clusters),
        "cluster_s": float(trust.cluster_s),
        "sigma_ratio": {block: float(ratio) for block, ratio in trust.sigma_ratio.items()},
        "split_z": _known(trust.split_z),
        "added": list(trust.added),
        "tries": int(trust.tries),
        "use": trust.use,
        "needs": [_need(need) for need in trust.needs],
        **({"recordings": trust.recordings, "between": dict(trust.between)} if trust.recordings else {}),
        **({"changes": [_change(change) for change in trust.changes]} if trust.changes else {}),
    }


def _change(change: QuantityChange) -> dict[str, Any]:
    return {key: value for key, value in asdict(change).items() if value is not None}


def _need(need: Need) -> dict[str, Any]:
    entry = asdict(need) | {"sigma": float(need.sigma), "needed": float(need.needed)}
    return {key: value for key, value in entry.items() if key not in ("cure", "floor") or value}


def finding_document(finding: Finding) -> dict[str, str]:
    """Return a finding by its keys, without consequence and cure where there are none."""
    return {key: text for key, text in asdict(finding).items() if text or key in ("severity", "code", "message")}


def provenance_document(provenance: Provenance) -> dict[str, Any]:
    """Return where a result comes from by its keys."""
    origin: dict[str, Any] = {
        "gnomon_version": provenance.gnomon_version,
        "method": provenance.method,
        "inputs": [_source(source) for source in provenance.inputs],
        "options": dict(provenance.options),
    }
    return origin if provenance.seed is None else origin | {"seed": provenance.seed}


def _source(source: Source) -> dict[str, Any]:
    found: dict[str, Any] = {"name": source.name, "sha256": source.sha256}
    return found | {"samples": list(source.samples)} if source.samples else found


def _multi_position(assessment: Assessment, minor: int) -> dict[str, Any]:
    names = ("accelerometer_rms", "rotation_rms", *(("rate_rms", "field_rms") if minor >= 2 else ()))
    return {
        "holdout": {name: _known(getattr(assessment.holdout, name)) for name in names},
        "intervals_found": assessment.intervals_found,
        "intervals_used": assessment.intervals_used,
        "rotations_found": assessment.rotations_found,
        "rotations_used": assessment.rotations_used,
    }


def _basis(assessment: Assessment, minor: int) -> dict[str, Any]:
    """Return what a calibration rests on, by the kind of it."""
    if assessment.cameras is not None:
        return {"cameras": _cameras(assessment.cameras)}
    if assessment.camera_imu is not None:
        return {"camera_imu": _camera_imu(assessment.camera_imu)}
    return {} if minor == 4 else _multi_position(assessment, minor)  # 4: cameras alone


def _cameras(fit: CamerasFit) -> dict[str, Any]:
    cameras = {
        name: {
            **{count: int(getattr(fit, count)[name]) for count in VIEW_COUNTS},
            **{rms: _known(getattr(fit, rms)[name]) for rms in VIEW_NUMBERS},
            "models": list(fit.models[name]),
        }
        for name in fit.views_found
    }
    board = {number: _known(getattr(fit, number)) for number in BOARD_NUMBERS}
    return {"converged": bool(fit.converged), "board": {"added": list(fit.board_added), **board}, "cameras": cameras}


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
