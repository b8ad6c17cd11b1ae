"""Kalibr: `camchain-imucam.yaml`, the cameras with their poses and time shifts against the IMU."""

from collections.abc import Mapping
from itertools import pairwise
from typing import Any

import numpy as np

from ..calibration import Calibration, CameraCalibration
from ..recording import Floats
from .kalibr_text import kalibr_yaml
from .lens_fit import cameras_without_k3, k3_losses

CAMCHAIN_FILE = "camchain-imucam.yaml"

_HEADER = """\
# Cameras and their poses in Kalibr's layout, made by gnomon; sigmas are in calibration.yaml.
# p_cam = T_cam_imu p_imu [m], t_imu = t_cam + timeshift_cam_imu [s], p_cn = T_cn_cnm1 p_cnm1.
"""


def camchain_text(calibration: Calibration, remarks: str = "") -> str:
    """Return the text of `camchain-imucam.yaml` for a calibration with cameras, in Kalibr's body frame accel-x.

    Parameters
    ----------
    remarks : lines of comment
    """
    lost = "".join(f"# {loss}\n" for loss in k3_losses(calibration, "Kalibr"))
    return _HEADER + remarks + lost + kalibr_yaml(camera_chain(calibration.cameras))


def camera_chain(cameras: Mapping[str, CameraCalibration]) -> dict[str, Any]:
    """Return cameras by Kalibr's keys."""
    document = {name: _camera(camera) for name, camera in cameras_without_k3(cameras).items()}
    for (_, before), (name, camera) in pairwise(cameras.items()):
        document[name]["T_cn_cnm1"] = baseline(before, camera)
    return document


def baseline(before: CameraCalibration, camera: CameraCalibration) -> Floats:
    """Return T_camera_before (4, 4) [m]."""
    rotation = camera.T_cam_imu[:3, :3] @ before.T_cam_imu[:3, :3].T
    pose = np.eye(4)
    pose[:3, :3] = rotation
    pose[:3, 3] = camera.T_cam_imu[:3, 3] - rotation @ before.T_cam_imu[:3, 3]
    return pose


def _camera(calibrated: CameraCalibration) -> dict[str, Any]:
    camera = calibrated.camera
    entry: dict[str, Any] = {
        "T_cam_imu": calibrated.T_cam_imu,
        "cam_overlaps": [],
        "camera_model": camera.projection,
        "distortion_coeffs": camera.distortion_coeffs,
        "distortion_model": camera.distortion,
        "intrinsics": camera.intrinsics,
        "resolution": np.array(camera.resolution),
        "timeshift_cam_imu": float(calibrated.time_shift_cam_imu),
    }
    if camera.line_delay_s:  # no key of Kalibr's, which passes over it; gnomon reads it back
        entry["line_delay"] = float(camera.line_delay_s)
    if camera.topic:
        entry["rostopic"] = camera.topic
    return entry
