"""OpenVINS' kalibr_imu_chain.yaml: what its keys Tw, Ta, Tg, R_IMUtoGYRO and R_IMUtoACC say of an IMU.

OpenVINS inverts Tw and Ta and keeps a triangle of each: the lower one with the model "kalibr", also called
"calibrated", and the upper one with "rpng". Tg acts on the specific force in the IMU's frame.
"""

import numpy as np

from ...calibration import AccelerometerCalibration, GyroscopeCalibration, ImuCalibration
from ...models.estimator_forms import OpenVinsAccelerometer, OpenVinsGyroscope
from ...models.forms import inverse
from ...recording import Floats
from ..rig.kalibr_yaml import file_name
from ..structured import Node
from .foreign_yaml import matrix, rotation

OPENVINS_KEYS = ("Tw", "Ta", "Tg", "R_IMUtoGYRO", "R_IMUtoACC")
_MODELS = ("kalibr", "calibrated", "rpng")


def openvins_imu(node: Node, keys: dict[str, Node], notes: list[str]) -> ImuCalibration:
    """Return an IMU, without bias.

    Parameters
    ----------
    node : the IMU's entry
    keys : its values
    notes : where sentences on what was passed over, or is missing, are appended

    Raises
    ------
    FormatError
        If a value is not as expected.
    """
    model = keys["model"].text().lower() if "model" in keys else "kalibr"
    if model not in _MODELS:
        keys["model"].text(_MODELS)
    missing = [key for key in OPENVINS_KEYS if key not in keys]
    if missing:
        notes.append(
            f"{file_name(node)}: {', '.join(missing)} of {node.path} {'is' if len(missing) == 1 else 'are'} missing; "
            "taken: the identity, zero for Tg."
        )
    turns = {key: rotation(keys[key]) if key in keys else np.eye(3) for key in ("R_IMUtoACC", "R_IMUtoGYRO")}
    zero = np.zeros(3)
    S_a, b_a = OpenVinsAccelerometer(T=_used(keys, "Ta", model, notes), R=turns["R_IMUtoACC"], b=zero).to_sensor()
    Tg = matrix(keys["Tg"], 3, 3) if "Tg" in keys else np.zeros((3, 3))
    gyroscope = OpenVinsGyroscope(T=_used(keys, "Tw", model, notes), R=turns["R_IMUtoGYRO"], b=zero, Tg=Tg)
    S_g, b_g, G = gyroscope.to_sensor()
    return ImuCalibration(
        accelerometer=AccelerometerCalibration(sensitivity=S_a, bias=b_a, unit="m/s^2"),
        gyroscope=GyroscopeCalibration(sensitivity=S_g, bias=b_g, g_sensitivity=G, unit="rad/s"),
    )


def _used(keys: dict[str, Node], name: str, model: str, notes: list[str]) -> Floats:
    """Return Tw or Ta as OpenVINS uses it: with a triangular inverse."""
    if name not in keys:
        return np.eye(3)
    node, upper = keys[name], model == "rpng"
    T = matrix(node, 3, 3)
    if np.linalg.matrix_rank(T) < 3:
        raise node.fail("this matrix is singular: the three axes do not measure three directions.")
    triangle = np.triu if upper else np.tril
    if np.abs(T - triangle(T)).max() <= 1e-12 * np.abs(T).max():
        return triangle(T)
    place = "below" if upper else "above"
    notes.append(
        f'{file_name(node)}: with the model "{model}" OpenVINS passes over what stands {place} the diagonal of the '
        f"inverse of {node.path}; so it was done here."
    )
    return inverse(triangle(inverse(T)))
