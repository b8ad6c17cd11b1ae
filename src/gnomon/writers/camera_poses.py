"""Poses of cameras in the body frame, as most programs want them."""

import numpy as np

from ..calibration import CameraCalibration
from ..recording import Floats


def pose_in_body(camera: CameraCalibration) -> Floats:
    """Return T_body_cam (4, 4), p_body = T_body_cam @ p_cam [m], the inverse of T_cam_imu, or of T_cam_cam0."""
    R_body_cam = camera.T_cam_body[:3, :3].T
    pose = np.eye(4)
    pose[:3, :3] = R_body_cam
    pose[:3, 3] = -R_body_cam @ camera.T_cam_body[:3, 3]
    return pose
