"""Cameras and IMU in Kalibr's form, to compare calibrations with each other and with what is true."""

from dataclasses import dataclass

import numpy as np

from gnomon.geometry.rotations import rotvec_from_rotation
from gnomon.models.forms import KalibrGyroscope

KALIBRS_WEIGHTS = {"noise": "nominal", "pixel_sigma": 1.0, "knots_per_s": 100.0, "robust": False}
"""Options with which both programs minimise the same, beside the model."""


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


def degrees_between(R, other):
    return float(np.degrees(np.linalg.norm(rotvec_from_rotation(np.asarray(R).T @ other))))


@dataclass(frozen=True, kw_only=True)
class Rig:
    """A calibration, or what is true, in Kalibr's form."""

    T_cam_imu: np.ndarray
    time_shift_s: float
    M_acc: np.ndarray
    M_gyr: np.ndarray
    A: np.ndarray
    C_gyro_i: np.ndarray

    @classmethod
    def from_files(cls, camera, imu):
        """Take the nodes of Kalibr's files; its model "calibrated" is that of an ideal IMU."""
        gyroscope = imu.get("gyroscopes", {"M": np.eye(3), "A": np.zeros((3, 3)), "C_gyro_i": np.eye(3)})
        return cls(
            T_cam_imu=np.array(camera["T_cam_imu"]),
            time_shift_s=camera["timeshift_cam_imu"],
            M_acc=np.array(imu.get("accelerometers", {"M": np.eye(3)})["M"]),
            M_gyr=np.array(gyroscope["M"]),
            A=np.array(gyroscope["A"]),
            C_gyro_i=np.array(gyroscope["C_gyro_i"]),
        )

    @classmethod
    def from_result(cls, result):
        camera, imu = result.calibration.cameras["cam0"], result.calibration.imus["imu0"]
        gyroscope = KalibrGyroscope.from_sensor(
            imu.gyroscope.sensitivity, imu.gyroscope.bias, imu.gyroscope.g_sensitivity
        )
        return cls(
            T_cam_imu=camera.T_cam_imu,
            time_shift_s=camera.time_shift_cam_imu,
            M_acc=imu.accelerometer.sensitivity,
            M_gyr=gyroscope.M,
            A=gyroscope.A,
            C_gyro_i=gyroscope.C_gyro_i,
        )

    def distances(self, other):
        """Return how far this one is from another one."""
        R, R_other = self.T_cam_imu[:3, :3], other.T_cam_imu[:3, :3]
        return {
            "rotation deg": degrees_between(R_other, R),
            "translation mm": 1e3 * float(np.linalg.norm(self.T_cam_imu[:3, 3] - other.T_cam_imu[:3, 3])),
            "shift ms": 1e3 * abs(self.time_shift_s - other.time_shift_s),
            "gyro to camera deg": degrees_between(R_other @ other.C_gyro_i.T, R @ self.C_gyro_i.T),
            "M_acc": float(np.abs(self.M_acc - other.M_acc).max()),
            "M_gyr": float(np.abs(self.M_gyr - other.M_gyr).max()),
            "A": float(np.abs(self.A - other.A).max()),
        }
