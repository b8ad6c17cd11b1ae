"""Poses of cameras in the body frame, as most programs want them."""

import numpy as np

from ..calibration import CameraCalibration
from ..recording import Floats


def pose_in_body(camera: CameraCalibration) -> Floats:
    """Return T_imu_cam (4, 4), p_imu = T_imu_cam @ p_cam [m], the inverse of T_cam_imu."""
    R_imu_cam = camera.T_cam_imu[:3, :3].T
    pose = np.eye(4)
    pose[:3, :3] = R_imu_cam
    pose[:3, 3] = -R_imu_cam @ camera.T_cam_imu[:3, 3]
    return pose
