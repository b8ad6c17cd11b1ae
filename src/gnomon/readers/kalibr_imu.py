"""Kalibr's imu.yaml with the models calibrated and scale-misalignment; samples in m/s^2 and rad/s."""

from os import PathLike

import numpy as np

from ..calibration import AccelerometerCalibration, GyroscopeCalibration, ImuCalibration
from ..models.project_forms import KalibrAccelerometer, KalibrGyroscope
from .foreign import ForeignCalibration, recognised_frame
from .structured import Node, read_yaml


def read_kalibr(path: str | PathLike[str]) -> ForeignCalibration:
    """Read the IMUs of Kalibr's imu.yaml; keys that do not concern the sensor model are passed over, and named.

    Raises
    ------
    FormatError
        If the file cannot be read, or is not in Kalibr's layout.
    """
    root = read_yaml(path)
    imus = {node.key: node for node in root.entries() if node.key.startswith("imu")}
    if not imus:
        raise root.fail("no imu0 in it. Expected Kalibr's imu.yaml with the key imu0 at the top.")
    notes = ["Kalibr's file holds no bias; taken: zero."]
    notes += [f"{node.path} was passed over." for imu in imus.values() for node in imu.entries() if _is_foreign(node)]
    sensors = {name: _imu(node) for name, node in imus.items()}
    return ForeignCalibration(imus=sensors, frame=recognised_frame(sensors), notes=tuple(notes))


def _is_foreign(node: Node) -> bool:
    return node.key not in {"model", "accelerometers", "gyroscopes"}


def _imu(node: Node) -> ImuCalibration:
    keys = {child.key: child for child in node.entries()}
    model = keys["model"].text(("calibrated", "scale-misalignment")) if "model" in keys else "calibrated"
    if model == "calibrated":
        eye, zero = np.eye(3), np.zeros((3, 3))
        return ImuCalibration(
            accelerometer=AccelerometerCalibration(sensitivity=eye, bias=np.zeros(3), unit="m/s^2"),
            gyroscope=GyroscopeCalibration(sensitivity=eye, bias=np.zeros(3), g_sensitivity=zero, unit="rad/s"),
        )
    if "accelerometers" not in keys:
        raise node.fail("the key accelerometers is missing.")
    M = keys["accelerometers"].mapping(("M",))["M"].floats(3, 3)
    force_sensitivity, bias = KalibrAccelerometer(M=M, b=np.zeros(3)).to_sensor()
    accelerometer = AccelerometerCalibration(sensitivity=force_sensitivity, bias=bias, unit="m/s^2")
    if "gyroscopes" not in keys:
        return ImuCalibration(accelerometer=accelerometer)
    parts = {name: part.floats(3, 3) for name, part in keys["gyroscopes"].mapping(("M", "A", "C_gyro_i")).items()}
    if not np.allclose(parts["C_gyro_i"] @ parts["C_gyro_i"].T, np.eye(3), atol=1e-6):
        raise keys["gyroscopes"].child("C_gyro_i").fail("this is no rotation matrix.")
    sensitivity, bias, g_sensitivity = KalibrGyroscope(**parts, b=np.zeros(3)).to_sensor()
    gyroscope = GyroscopeCalibration(sensitivity=sensitivity, bias=bias, g_sensitivity=g_sensitivity, unit="rad/s")
    return ImuCalibration(accelerometer=accelerometer, gyroscope=gyroscope)
