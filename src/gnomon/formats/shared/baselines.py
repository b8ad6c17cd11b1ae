"""Poses of cameras to each other and in the body frame."""

import numpy as np

from ...frozen import value_class
from ...geometry.rotation_vector import skew
from ...recording import Floats
from ...results.calibration import Calibration


def inverse_pose(T: Floats) -> Floats:
    """Return the inverse of a rigid transformation (4, 4) [m], of T_cam_imu such as T_imu_cam."""
    R = T[:3, :3].T
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = R, -R @ T[:3, 3]
    return pose


@value_class
class Baseline:
    """One camera as another one sees it.

    Attributes
    ----------
    T : (4, 4) p_second = T @ p_first [m]
    covariance : (6, 6) of a small rotation on the right of R_second_first [rad], and of the last column [m]
    """

    T: Floats
    covariance: Floats

    @property
    def distance(self) -> float:
        """How far apart they are [m]."""
        return float(np.linalg.norm(self.T[:3, 3]))

    @property
    def distance_sigma(self) -> float:
        """Standard deviation of the distance [m]."""
        along = self.T[:3, 3] / self.distance if self.distance else np.zeros(3)
        return float(np.sqrt(max(along @ self.covariance[3:, 3:] @ along, 0.0)))


def baseline_of(calibration: Calibration, first: str, second: str) -> Baseline:
    """Return the pose of the second camera to the first one.

    With R_a Exp(d) and t of each camera a against the body, R = R_2 R_1' and t = t_2 - R t_1:

        rotation on the right of R:  R_1 (d_2 - d_1);    t:  dt_2 - R dt_1 + R [t_1]x R_1 (d_2 - d_1)

    Parameters
    ----------
    first, second : such as "cam0", "cam1"
    """
    one, other = calibration.cameras[first], calibration.cameras[second]
    R1, t1 = one.T_cam_body[:3, :3], one.T_cam_body[:3, 3]
    R = other.T_cam_body[:3, :3] @ R1.T
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R, other.T_cam_body[:3, 3] - R @ t1
    turn = np.vstack([R1, R @ skew(t1) @ R1])
    slopes = {
        first: np.hstack([-turn, np.vstack([np.zeros((3, 3)), -R])]),
        second: np.hstack([turn, np.vstack([np.zeros((3, 3)), np.eye(3)])]),
    }
    known = [name for name in (first, second) if name != calibration.cameras[name].body]
    paths = [
        f"{name}.{calibration.cameras[name].link}.{part}" for name in known for part in ("rotation", "translation")
    ]
    jacobian = np.hstack([slopes[name] for name in known])
    return Baseline(T=T, covariance=jacobian @ calibration.covariance(*paths) @ jacobian.T)
