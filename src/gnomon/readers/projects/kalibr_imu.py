"""Kalibr's imu.yaml with the models calibrated, scale-misalignment and -size-effect, and OpenVINS' variant of it.

Samples are in m/s^2 and rad/s.
"""

from os import PathLike

import numpy as np

from ...calibration import AccelerometerCalibration, GyroscopeCalibration, ImuCalibration
from ...models.noise import ImuNoise
from ...models.project_forms import KalibrAccelerometer, KalibrGyroscope
from ...recording import Floats
from ..rig.kalibr_yaml import file_name, passed_over, required, sensors
from ..structured import Node
from .foreign import ForeignCalibration, ForeignImu, recognised_frame
from .foreign_yaml import matrix, read_foreign_yaml, rigid, rotation
from .openvins_imu import OPENVINS_KEYS, openvins_imu

_NOISE = tuple(ImuNoise.__slots__)
_RATES = ("update_rate", "rate_hz")
_OTHERS = ("rostopic", "T_i_b", "time_offset", *_NOISE, *_RATES)
_MODELS = ("calibrated", "scale-misalignment", "scale-misalignment-size-effect")
_LEVER_ARMS = ("rx_i", "ry_i", "rz_i")


def read_kalibr(path: str | PathLike[str]) -> ForeignCalibration:
    """Read the IMUs of Kalibr's imu.yaml, or OpenVINS' kalibr_imu_chain.yaml; keys that mean nothing are named.

    Raises
    ------
    FormatError
        If the file cannot be read, or is not in Kalibr's layout.
    """
    notes: list[str] = []
    return imus_of(read_foreign_yaml(path, notes), notes)


def imus_of(root: Node, notes: list[str]) -> ForeignCalibration:
    """Return the IMUs of a file that was parsed; see `read_kalibr`.

    Parameters
    ----------
    notes : sentences on the file so far; those of the result begin with them

    Raises
    ------
    FormatError
        If it is not in Kalibr's layout.
    """
    nodes = sensors(root, "imu", _NOISE[0], "Kalibr's imu.yaml")
    imus: dict[str, ImuCalibration] = {}
    data: dict[str, ForeignImu] = {}
    foreign = "Kalibr"
    for name, node in nodes.items():
        keys = {child.key: child for child in node.entries()}
        passed_over((child for key, child in keys.items() if key not in _known(keys)), notes)
        model = _model(node, keys, notes)
        data[name] = _data(node, keys, notes)
        if model is not None:
            imus[name] = data[name].placed(model) if imus else model
        if any(key in keys for key in OPENVINS_KEYS):
            foreign = "OpenVINS"
    if imus:
        notes.append(f"{foreign}'s file holds no bias; taken: zero.")
    return ForeignCalibration(
        imus=imus, frame=recognised_frame(imus), imu_data=data, notes=tuple(notes), format=f"{foreign}, IMU"
    )


def _known(keys: dict[str, Node]) -> tuple[str, ...]:
    own = OPENVINS_KEYS if any(key in keys for key in OPENVINS_KEYS) else ("accelerometers", "gyroscopes")
    return ("model", *own, *_OTHERS)


def _model(node: Node, keys: dict[str, Node], notes: list[str]) -> ImuCalibration | None:
    """Return the sensors; None where the file is silent about them, as Kalibr's input is."""
    if any(key in keys for key in OPENVINS_KEYS):
        return openvins_imu(node, keys, notes)
    stated = "model" in keys
    if not stated and "accelerometers" not in keys:
        return None
    if stated:
        word = keys["model"].text().lower().replace("_", "-")
        if word not in _MODELS:
            keys["model"].text(_MODELS)
        if word == "calibrated":
            return ideal_imu()
    M = _lower(required(_parts(node, keys, "accelerometers"), "M", node, "a matrix 3x3"), notes)
    force_sensitivity, bias = KalibrAccelerometer(M=M, b=np.zeros(3)).to_sensor()
    accelerometer = AccelerometerCalibration(
        sensitivity=force_sensitivity, bias=bias, unit="m/s^2", lever_arms_m=_lever_arms(keys, notes)
    )
    if "gyroscopes" not in keys:
        return ImuCalibration(accelerometer=accelerometer)
    parts = _parts(node, keys, "gyroscopes")
    passed_over((part for key, part in parts.items() if key not in {"M", "A", "C_gyro_i"}), notes)
    form = KalibrGyroscope(
        M=_lower(required(parts, "M", keys["gyroscopes"], "a matrix 3x3"), notes),
        A=matrix(required(parts, "A", keys["gyroscopes"], "a matrix 3x3"), 3, 3),
        C_gyro_i=rotation(required(parts, "C_gyro_i", keys["gyroscopes"], "a rotation matrix")),
        b=np.zeros(3),
    )
    sensitivity, bias, g_sensitivity = form.to_sensor()
    gyroscope = GyroscopeCalibration(sensitivity=sensitivity, bias=bias, g_sensitivity=g_sensitivity, unit="rad/s")
    return ImuCalibration(accelerometer=accelerometer, gyroscope=gyroscope)


def ideal_imu() -> ImuCalibration:
    """Return an IMU that measures specific force and angular rate as they are."""
    eye, zero = np.eye(3), np.zeros((3, 3))
    return ImuCalibration(
        accelerometer=AccelerometerCalibration(sensitivity=eye, bias=np.zeros(3), unit="m/s^2"),
        gyroscope=GyroscopeCalibration(sensitivity=eye, bias=np.zeros(3), g_sensitivity=zero, unit="rad/s"),
    )


def _parts(node: Node, keys: dict[str, Node], name: str) -> dict[str, Node]:
    return {part.key: part for part in required(keys, name, node, "M of it").entries()}


def _lower(node: Node, notes: list[str]) -> Floats:
    """Return Kalibr's M, which is lower triangular."""
    M = matrix(node, 3, 3)
    size = np.abs(M).max()
    if np.linalg.matrix_rank(M) < 3:
        raise node.fail("this matrix is singular: the three axes do not measure three directions.")
    if np.abs(np.triu(M, 1)).max() > 1e-9 * size:
        if np.abs(np.tril(M, -1)).max() <= 1e-9 * size:
            raise node.fail("Kalibr's M is lower triangular, this is upper triangular. It seems to be transposed.")
        notes.append(f"{file_name(node)}: {node.path} is not lower triangular as Kalibr's are; taken as it is.")
    return M


def _data(node: Node, keys: dict[str, Node], notes: list[str]) -> ForeignImu:
    rate = next((keys[name].number() for name in _RATES if name in keys), None)
    return ForeignImu(
        noise=_noise(node, keys, notes),
        update_rate_hz=rate,
        topic=str(keys["rostopic"].value or "") if "rostopic" in keys else "",
        T_imu_body=rigid(keys["T_i_b"]) if "T_i_b" in keys else None,
        time_offset_s=keys["time_offset"].number() if "time_offset" in keys else None,
        lever_arms_m=_lever_arms(keys, []),
    )


def _noise(node: Node, keys: dict[str, Node], notes: list[str]) -> ImuNoise | None:
    found = {name: keys[name].number() for name in _NOISE if name in keys}
    if len(found) == len(_NOISE) and min(found.values()) > 0:
        return ImuNoise(**found)
    if found:
        notes.append(f"{file_name(node)}: the noise of {node.path or 'imu0'} is incomplete or zero; it was left out.")
    return None


def _lever_arms(keys: dict[str, Node], notes: list[str]) -> Floats | None:
    if "accelerometers" not in keys or not isinstance(keys["accelerometers"].value, dict):
        return None
    parts = {part.key: part for part in keys["accelerometers"].entries()}
    passed_over((part for key, part in parts.items() if key not in {"M", *_LEVER_ARMS}), notes)
    if not any(name in parts for name in _LEVER_ARMS):
        return None
    return np.vstack([matrix(parts[name], 1, 3) if name in parts else np.zeros((1, 3)) for name in _LEVER_ARMS])
