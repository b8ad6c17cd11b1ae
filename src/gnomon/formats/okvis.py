"""OKVIS2's and OKVIS' configuration: cameras with T_SC, the delay of images, biases and noise of the IMU.

T_SC maps camera to IMU coordinates, T_BS those of the IMU to a body's, from which all else is counted; the corrected
timestamp of an image is its timestamp minus image_delay, so that t_imu - t_cam is minus image_delay.
"""

from dataclasses import replace
from typing import Any

import numpy as np

from ..geometry.rotations import inverse_pose
from ..models.lens_names import DistortionName
from ..recording import Floats
from ..results.calibration import Calibration, CameraCalibration, ImuCalibration
from .foreign import ForeignCalibration, ForeignImu, ideal_imu
from .shared.foreign_yaml import noise_by_key, place_camera, read_lens, read_transform, required_value, stated_noise
from .shared.losses import Context, Export, StatedImu, unknown_lens
from .shared.sensor_losses import Holds, not_representable, require_cameras
from .shared.si_units import si_conversions
from .shared.structured import Node
from .shared.yaml_text import opencv_text

_NOISE = {
    "sigma_g_c": "gyroscope_noise_density",
    "sigma_a_c": "accelerometer_noise_density",
    "sigma_gw_c": "gyroscope_random_walk",
    "sigma_aw_c": "accelerometer_random_walk",
}
_DISTORTIONS: dict[str, DistortionName] = {
    "radialtangential": "radtan",
    "plumb_bob": "radtan",
    "radialtangential8": "radtan",
    "equidistant": "equidistant",
}


def is_okvis(root: Node) -> bool:
    """Return whether a file is laid out as OKVIS' configuration."""
    cameras = root.value.get("cameras") if isinstance(root.value, dict) else None
    return isinstance(cameras, list) and bool(cameras) and isinstance(cameras[0], dict) and "T_SC" in cameras[0]


def okvis_of(root: Node, notes: list[str]) -> ForeignCalibration:
    """Return the rig of OKVIS' configuration.

    Parameters
    ----------
    notes : sentences on the file so far; those of the result begin with them

    Raises
    ------
    FormatError
        If it is not in OKVIS' layout, or its cameras are of a kind that gnomon does not know.
    """
    keys = {node.key: node for node in root.entries()}
    delay = _delay(keys)
    if delay is None:
        notes.append("The delay of images is not stated; taken: zero.")
    cameras = {f"cam{i}": _read_camera(node, -(delay or 0.0)) for i, node in enumerate(keys["cameras"].items())}
    entry = next((keys[name] for name in ("imu_parameters", "imu_params") if name in keys), None)
    imus: dict[str, ImuCalibration] = {}
    data: dict[str, ForeignImu] = {}
    if entry is not None:
        values = {node.key: node for node in entry.entries()}
        imus["imu0"] = _read_imu(values)
        data["imu0"] = _data(values, notes)
        notes.append("OKVIS' file holds no scales and axes of the IMU; taken: ideal but for its bias.")
    return ForeignCalibration(
        imus=imus, frame="accel-x", notes=tuple(notes), cameras=cameras, imu_data=data, format="OKVIS"
    )


def _delay(keys: dict[str, Node]) -> float | None:
    if "imageDelay" in keys:  # the first OKVIS
        return keys["imageDelay"].number()
    for name in ("camera_parameters", "camera_params"):
        if name in keys:
            for node in keys[name].entries():
                if node.key == "image_delay":
                    return node.number()
    return None


def _read_camera(node: Node, shift_s: float) -> CameraCalibration:
    keys = {child.key: child for child in node.entries()}

    def needed(name: str, count: int) -> np.ndarray:
        return required_value(keys, name, node, f"{count} numbers").floats(count)

    kind = required_value(keys, "distortion_type", node, "a distortion").text(tuple(_DISTORTIONS))
    coeffs = required_value(keys, "distortion_coefficients", node, "a list of numbers")
    width, height = needed("image_dimension", 2).tolist()
    camera = read_lens(
        node,
        intrinsics=np.concatenate([needed("focal_length", 2), needed("principal_point", 2)]),
        resolution=(int(width), int(height)),
        coeffs=np.array([item.number() for item in coeffs.items()]),
        distortion=_DISTORTIONS[kind],
    )
    return place_camera(read_transform(required_value(keys, "T_SC", node, "16 numbers")), shift_s, camera)


def _read_imu(values: dict[str, Node]) -> ImuCalibration:
    ideal = ideal_imu()
    assert ideal.accelerometer is not None
    assert ideal.gyroscope is not None
    biases = {name: values[name].floats(3) if name in values else np.zeros(3) for name in ("a0", "g0")}
    return ImuCalibration(
        accelerometer=replace(ideal.accelerometer, bias=biases["a0"]),
        gyroscope=replace(ideal.gyroscope, bias=biases["g0"]),
    )


def _data(values: dict[str, Node], notes: list[str]) -> ForeignImu:
    T = read_transform(values["T_BS"]) if "T_BS" in values else np.eye(4)
    if not np.array_equal(T, np.eye(4)):
        notes.append("T_BS, from the IMU to another body frame, was passed over: poses here are those to the IMU.")
    rate = values["imu_rate"].number() if "imu_rate" in values else None
    return ForeignImu(noise=stated_noise(values, _NOISE, notes), update_rate_hz=rate)


FILE = "okvis.yaml"

_WHOSE = "OKVIS"
_MISSING = "a_max, g_max, sigma_bg, sigma_ba"
_HEAD = """\
%YAML:1.0
# The rig for OKVIS2, made by gnomon; sigmas are in calibration.yaml. It is not the whole of a configuration: take
# timestamp_tolerance, online_calibration, {missing} and the parameters of frontend, estimator and
# output from one of OKVIS' own.
# p_imu = T_SC p_cam [m], T_SC row by row; corrected timestamp of an image = timestamp - image_delay [s], so that
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

HOLDS = Holds(
    program=_WHOSE,
    imus=1,
    sensitivity=False,
    g_sensitivity=False,
    time_shift="one",
    undistorted="radialtangential",
    topics=False,
    without_noise="does not start without sigma_g_c and the others: add them by hand",
    settings=f"{_MISSING}, timestamp_tolerance, online_calibration and the parameters of frontend, estimator "
    "and output",
)


def export(calibration: Calibration, context: Context) -> Export:
    """Return `okvis.yaml`.

    Raises
    ------
    OptionError
        If there is no camera, or OKVIS does not know the model of one.
    """
    require_cameras(calibration, _WHOSE)
    name, imu = next(iter(calibration.imus.items()))
    losses = tuple(not_representable(calibration, HOLDS, context))
    return Export(files={FILE: _text(calibration, name, imu, context.of(name), context)}, losses=losses)


def _text(calibration: Calibration, name: str, imu: ImuCalibration, stated: StatedImu, context: Context) -> str:
    cameras = calibration.cameras
    shift = next(iter(cameras.values())).time_shift_cam_imu
    document: dict[str, Any] = {
        "cameras": [_camera_entry(key, camera) for key, camera in cameras.items()],
        "camera_parameters": {"image_delay": -float(shift)},
        "imu_parameters": _imu_entry(imu, stated) | {"g": float(calibration.gravity.value), "T_BS": np.eye(4)},
    }
    lines = [line for conversion in si_conversions(imu) if conversion.unit == "count" for line in conversion.lines()]
    comments = "".join(f"# {name}: {line}\n" for line in (*lines, *stated.comments))
    comments += f"# g: {calibration.gravity.source}\n"
    if stated.noise is None:
        comments += "# OKVIS also needs sigma_g_c, sigma_a_c, sigma_gw_c and sigma_aw_c: add them.\n"
    return _HEAD.format(missing=_MISSING) + context.comment() + comments + opencv_text(document)


def _camera_entry(name: str, calibrated: CameraCalibration) -> dict[str, Any]:
    camera = calibrated.camera
    if camera.projection != "pinhole" or camera.distortion not in _NAMES:
        raise unknown_lens(name, camera, "OKVIS knows pinhole with radtan, equidistant or no distortion")
    coeffs = camera.distortion_coeffs if camera.distortion != "none" else np.zeros(4)
    coeffs = np.append(coeffs, np.zeros(3)) if camera.distortion == "radtan5" else coeffs  # k4, k5, k6
    return {
        "T_SC": inverse_pose(calibrated.T_cam_body),
        "image_dimension": np.array(camera.resolution),
        "distortion_coefficients": coeffs,
        "distortion_type": _NAMES[camera.distortion],
        "focal_length": camera.intrinsics[:2],
        "principal_point": camera.intrinsics[2:],
        "camera_type": "gray",
        "slam_use": "okvis",
    }


def _imu_entry(imu: ImuCalibration, stated: StatedImu) -> dict[str, Any]:
    biases: dict[str, Floats] = {conversion.triad: conversion.bias_si for conversion in si_conversions(imu)}
    entry: dict[str, Any] = {"use": True}
    if stated.noise is not None:
        entry |= noise_by_key(stated.noise, _NOISE)
    if stated.update_rate_hz is not None:
        entry["imu_rate"] = float(stated.update_rate_hz)
    return entry | {
        "g0": biases.get("gyroscope", np.zeros(3)),
        "a0": biases.get("accelerometer", np.zeros(3)),
    }
