"""OKVIS2, and OKVIS but for its names: the part of its configuration that describes the rig.

T_SC maps camera to IMU coordinates; image_delay is taken off the stamps of images, so that it is minus the time shift.
OKVIS takes an ideal IMU with biases a0 and g0 to start from, taken off the samples; its noise is of continuous time.
Read back by `readers.projects.okvis`.
"""

from collections.abc import Iterator
from typing import Any

import numpy as np

from ..calibration import Calibration, CameraCalibration, ImuCalibration
from ..recording import Floats
from .camera_poses import pose_in_body
from .context import Context, StatedImu
from .export import Export, Loss, g_sensitivity_losses, magnetometer_losses, uncertainty_loss
from .lens_formats import unknown_lens
from .opencv_yaml import opencv_lines
from .sensor_losses import (
    accelerometer_losses,
    ideal_losses,
    noise_losses,
    other_imu_losses,
    require_cameras,
    shift_losses,
)
from .si_units import conversions, count_losses

FILE = "okvis.yaml"

_WHOSE = "OKVIS"
_MISSING = "a_max, g_max, sigma_bg, sigma_ba"
_HEAD = """\
%YAML:1.0
# The rig for OKVIS2, made by gnomon; sigmas are in calibration.yaml. It is not the whole of a configuration: take
# timestamp_tolerance, online_calibration, {missing} and the parameters of frontend, estimator and
# output from one of OKVIS' own.
# p_imu = T_SC p_cam [m], T_SC row by row; corrected stamp of an image = stamp - image_delay [s], so that
# t_imu = t_cam - image_delay.
# a0 [m/s^2] and g0 [rad/s] are the biases of samples as they come; set them to zero where samples were corrected
# (gnomon apply), as they have to be for the poses to hold where the IMU is not ideal.
# Noise is of continuous time: sigma_g_c [rad/s/sqrt(Hz)], sigma_a_c [m/s^2/sqrt(Hz)], sigma_gw_c [rad/s^2/sqrt(Hz)],
# sigma_aw_c [m/s^3/sqrt(Hz)]; g [m/s^2]; imu_rate [Hz] is a key of the first OKVIS only.
"""
_NAMES = {
    "radtan": "radialtangential",
    "none": "radialtangential",
    "radtan5": "radialtangential8",
    "equidistant": "equidistant",
}


def export(calibration: Calibration, context: Context) -> Export:
    """Return `okvis.yaml`.

    Raises
    ------
    OptionError
        If there is no camera, or OKVIS does not know the model of one.
    """
    require_cameras(calibration, _WHOSE)
    name, imu = next(iter(calibration.imus.items()))
    stated = context.of(name)
    losses = (
        *count_losses(name, imu, _WHOSE),
        *ideal_losses(name, imu, _WHOSE),
        *g_sensitivity_losses(calibration, _WHOSE),
        *accelerometer_losses(calibration, _WHOSE),
        *noise_losses(stated, _WHOSE, "does not start without sigma_g_c and the others: add them by hand"),
        *other_imu_losses(calibration, _WHOSE),
        *shift_losses(calibration, _WHOSE),
        *_camera_losses(calibration),
        *magnetometer_losses(calibration, _WHOSE),
        Loss(
            what="settings of the program",
            why=f"{_MISSING}, timestamp_tolerance, online_calibration and the parameters of frontend, estimator and "
            "output are not of the rig. Take them from OKVIS' own files.",
        ),
        uncertainty_loss(_WHOSE),
    )
    return Export(files={FILE: _text(calibration, name, imu, stated, context)}, losses=losses)


def _text(calibration: Calibration, name: str, imu: ImuCalibration, stated: StatedImu, context: Context) -> str:
    cameras = calibration.cameras
    shift = next(iter(cameras.values())).time_shift_cam_imu
    document: dict[str, Any] = {
        "cameras": [_camera(key, camera) for key, camera in cameras.items()],
        "camera_parameters": {"image_delay": -float(shift)},
        "imu_parameters": _imu(imu, stated) | {"g": float(calibration.gravity.value), "T_BS": np.eye(4)},
    }
    lines = [line for conversion in conversions(imu) if conversion.unit == "count" for line in conversion.lines()]
    comments = "".join(f"# {name}: {line}\n" for line in (*lines, *stated.comments))
    comments += f"# g: {calibration.gravity.source}\n"
    if stated.noise is None:
        comments += "# OKVIS also needs sigma_g_c, sigma_a_c, sigma_gw_c and sigma_aw_c: add them.\n"
    return (
        _HEAD.format(missing=_MISSING)
        + context.comment()
        + comments
        + "".join(f"{line}\n" for line in opencv_lines(document))
    )


def _camera(name: str, calibrated: CameraCalibration) -> dict[str, Any]:
    camera = calibrated.camera
    if camera.projection != "pinhole" or camera.distortion not in _NAMES:
        raise unknown_lens(name, camera, "OKVIS knows pinhole with radtan, equidistant or no distortion")
    coeffs = camera.distortion_coeffs if camera.distortion != "none" else np.zeros(4)
    coeffs = np.append(coeffs, np.zeros(3)) if camera.distortion == "radtan5" else coeffs  # k4, k5, k6
    return {
        "T_SC": pose_in_body(calibrated),
        "image_dimension": np.array(camera.resolution),
        "distortion_coefficients": coeffs,
        "distortion_type": _NAMES[camera.distortion],
        "focal_length": camera.intrinsics[:2],
        "principal_point": camera.intrinsics[2:],
        "camera_type": "gray",
        "slam_use": "okvis",
    }


def _imu(imu: ImuCalibration, stated: StatedImu) -> dict[str, Any]:
    biases: dict[str, Floats] = {conversion.triad: conversion.bias_si for conversion in conversions(imu)}
    entry: dict[str, Any] = {"use": True}
    if stated.noise is not None:
        entry |= {
            "sigma_g_c": stated.noise.gyroscope_noise_density,
            "sigma_a_c": stated.noise.accelerometer_noise_density,
            "sigma_gw_c": stated.noise.gyroscope_random_walk,
            "sigma_aw_c": stated.noise.accelerometer_random_walk,
        }
    if stated.update_rate_hz is not None:
        entry["imu_rate"] = float(stated.update_rate_hz)
    return entry | {
        "g0": biases.get("gyroscope", np.zeros(3)),
        "a0": biases.get("accelerometer", np.zeros(3)),
    }


def _camera_losses(calibration: Calibration) -> Iterator[Loss]:
    for name, camera in calibration.cameras.items():
        if camera.camera.distortion == "none":
            yield Loss(
                what=f"distortion of {name}",
                why="it has none; the file has radialtangential with zeros, which is the same.",
            )
        if camera.camera.topic:
            yield Loss(what=f"rostopic of {name}", why="OKVIS has no key for it.")
