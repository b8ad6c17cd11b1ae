"""Cameras of programs that state where they lie in the IMU's frame: T_imu_cam, the inverse of T_cam_imu."""

from collections.abc import Mapping

import numpy as np

from ...calibration import CameraCalibration
from ...errors import OptionError
from ...models.camera import Camera
from ...models.distortions import DISTORTIONS
from ...models.lens_names import DistortionName, ProjectionName
from ...recording import Floats
from ..rig.kalibr_yaml import required
from ..structured import Node


def seen_from_camera(T_imu_cam: Floats) -> Floats:
    """Return T_cam_imu (4, 4) of T_imu_cam (4, 4) [m]."""
    R = T_imu_cam[:3, :3].T
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R, -R @ T_imu_cam[:3, 3]
    return T


def placed(T_imu_cam: Floats, shift_s: float, camera: Camera) -> CameraCalibration:
    """Return a camera by its place in the IMU's frame, and t_imu - t_cam."""
    return CameraCalibration(T_cam_body=seen_from_camera(T_imu_cam), time_shift_cam_imu=shift_s, camera=camera)


def numbers(node: Node, names: tuple[str, ...], prefix: str = "") -> Floats:
    """Return numbers under keys.

    Raises
    ------
    FormatError
        If one is missing.
    """
    keys = {child.key: child for child in node.entries()}
    return np.array([required(keys, f"{prefix}{name}", node, "a number").number() for name in names])


def lens(
    node: Node,
    *,
    intrinsics: Floats,
    resolution: tuple[int, int],
    coeffs: Floats,
    distortion: DistortionName,
    projection: ProjectionName = "pinhole",
    topic: str = "",
) -> Camera:
    """Return a lens, with zeros for coefficients of radtan that are not stated; with k3 it is radtan5.

    Raises
    ------
    FormatError
        If its numbers are of no lens.
    """
    if distortion == "radtan" and len(coeffs) > len(DISTORTIONS[distortion].names) and coeffs[4] != 0:
        distortion = "radtan5"
    wanted = len(DISTORTIONS[distortion].names)
    if len(coeffs) > wanted and np.any(coeffs[wanted:]):
        raise node.fail(
            f"found {len(coeffs)} coefficients of distortion, and gnomon knows {wanted} of {distortion} only; those "
            "behind are not zero."
        )
    padded = np.zeros(wanted)
    padded[: min(wanted, len(coeffs))] = coeffs[:wanted]
    try:
        return Camera(
            projection=projection,
            intrinsics=intrinsics,
            distortion=distortion,
            distortion_coeffs=padded,
            resolution=resolution,
            topic=topic,
        )
    except OptionError as error:
        raise node.fail(str(error)) from None


def text_of(keys: Mapping[str, Node], name: str) -> str:
    """Return a text under a key, "" where there is none."""
    return str(keys[name].value or "") if name in keys else ""
