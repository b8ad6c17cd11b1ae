"""Kalibr: `camchain-imucam.yaml`, the cameras with their poses and time shifts against the IMU, and `camchain.yaml`."""

from collections.abc import Mapping
from itertools import pairwise
from typing import Any

import numpy as np

from ..calibration import Calibration, CameraCalibration
from ..models.camera import Camera
from ..recording import Floats
from .kalibr_text import kalibr_yaml
from .lens_fit import cameras_without_k3, k3_losses

CAMCHAIN_FILE, LENS_FILE = "camchain-imucam.yaml", "camchain.yaml"

_HEADER = """\
# Cameras and their poses in Kalibr's layout, made by gnomon; sigmas are in calibration.yaml.
# p_cam = T_cam_imu p_imu [m], t_imu = t_cam + timeshift_cam_imu [s], p_cn = T_cn_cnm1 p_cnm1.
"""


_HEADER_ALONE = """\
# Cameras in Kalibr's layout, made by gnomon; sigmas are in calibration.yaml. p_cn = T_cn_cnm1 p_cnm1 [m].
"""


def camchain_text(calibration: Calibration, remarks: str = "") -> str:
    """Return the text of `camchain-imucam.yaml` for a calibration with cameras, in Kalibr's body frame accel-x.

    Parameters
    ----------
    remarks : lines of comment
    """
    lost = "".join(f"# {loss}\n" for loss in k3_losses(calibration, "Kalibr"))
    return _HEADER + remarks + lost + kalibr_yaml(camera_chain(calibration.cameras))


def lens_chain_text(
    calibration: Calibration, remarks: str = "", overlaps: Mapping[str, list[int]] | None = None
) -> str:
    """Return the text of `camchain.yaml`: lenses and baselines, without an IMU.

    Parameters
    ----------
    remarks : lines of comment
    overlaps : "cam0", ... -> numbers of the cameras that see the same; those next to it where not given
    """
    lost = "".join(f"# {loss}\n" for loss in k3_losses(calibration, "Kalibr"))
    return _HEADER_ALONE + remarks + lost + kalibr_yaml(lens_chain(calibration.cameras, overlaps))


def lens_chain(
    cameras: Mapping[str, CameraCalibration], overlaps: Mapping[str, list[int]] | None = None
) -> dict[str, Any]:
    """Return cameras without an IMU by Kalibr's keys."""
    document = {name: _lens(camera.camera) for name, camera in cameras_without_k3(cameras).items()}
    numbers = {name: int(name.removeprefix("cam")) for name in cameras}
    together: dict[str, list[int]] = {name: [] for name in cameras}
    for (first, before), (second, camera) in pairwise(cameras.items()):
        document[second]["T_cn_cnm1"] = baseline(before, camera)
        together[first].append(numbers[second])
        together[second].append(numbers[first])
    for name, entry in document.items():
        entry["cam_overlaps"] = np.array(sorted((overlaps or together)[name]), dtype=np.int64)
    return document


def camera_chain(cameras: Mapping[str, CameraCalibration]) -> dict[str, Any]:
    """Return cameras by Kalibr's keys."""
    document = {name: _camera(camera) for name, camera in cameras_without_k3(cameras).items()}
    for (_, before), (name, camera) in pairwise(cameras.items()):
        document[name]["T_cn_cnm1"] = baseline(before, camera)
    return document


def baseline(before: CameraCalibration, camera: CameraCalibration) -> Floats:
    """Return T_camera_before (4, 4) [m]."""
    rotation = camera.T_cam_body[:3, :3] @ before.T_cam_body[:3, :3].T
    pose = np.eye(4)
    pose[:3, :3] = rotation
    pose[:3, 3] = camera.T_cam_body[:3, 3] - rotation @ before.T_cam_body[:3, 3]
    return pose


def _camera(calibrated: CameraCalibration) -> dict[str, Any]:
    return {
        "T_cam_imu": calibrated.T_cam_imu,
        "cam_overlaps": [],
        "timeshift_cam_imu": float(calibrated.time_shift_cam_imu),
        **_lens(calibrated.camera),
    }


def _lens(camera: Camera) -> dict[str, Any]:
    entry: dict[str, Any] = {
        "camera_model": camera.projection,
        "distortion_coeffs": camera.distortion_coeffs,
        "distortion_model": camera.distortion,
        "intrinsics": camera.intrinsics,
        "resolution": np.array(camera.resolution),
    }
    if camera.line_delay_s:  # no key of Kalibr's, which passes over it; gnomon reads it back
        entry["line_delay"] = float(camera.line_delay_s)
    if camera.topic:
        entry["rostopic"] = camera.topic
    return entry
