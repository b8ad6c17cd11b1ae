"""JSON: the whole of calibration.yaml, key by key, with what the numbers mean in words; read by `gnomon.load`.

Numbers read back bit by bit. Those that are not finite, which JSON does not know, are the texts "nan" and "inf".
"""

import json
import math
from typing import Any

import yaml

from ...results.calibration import Calibration
from ..shared.losses import Context, Export
from .calibration_text import FRAMES, calibration_text

FILE = "calibration.json"

_LENSES_ALONE = {
    "T_cam_cam0": "p_cam = T_cam_cam0 p_cam0 [m], 4x4 row by row: from the frame of cam0 (x right, y down, z forward) "
    "to that of the camera.",
    "sigma": "every *_sigma is one standard deviation; T_cam_cam0_rotation_sigma is that of a small rotation about the "
    "axes of cam0 [rad].",
}
_DEFINITIONS = {
    "imus": "measured = sensitivity * true + bias, of the gyroscope + g_sensitivity * f, in the unit of each sensor; f "
    "specific force [m/s^2], true rate [rad/s], in the body frame; rows are sensor axes, columns body axes.",
    "T_cam_imu": "p_cam = T_cam_imu p_imu [m], 4x4 row by row: from the body frame of imu0 to the camera's (x right, "
    "y down, z forward).",
    "time_shift_cam_imu": "t_imu = t_cam + time_shift_cam_imu [s]; row v of an image is line_delay * v later [s].",
    "T_imu_body": "p_imu = T_imu_body p_body [m], 4x4 row by row: from the body frame, imu0's, to that of another IMU.",
    "time_shift_imu": "t_imu0 = t_imu + time_shift_imu [s], of the timestamps of the gyroscopes; of an accelerometer "
    "t_gyroscope = t_accelerometer + time_shift [s].",
    "sigma": "every *_sigma is one standard deviation; T_cam_imu_rotation_sigma is that of a small rotation about the "
    "body's axes [rad].",
    "covariance": "lower_triangle[i][j] is the covariance of names[i] and names[j]; 0 where a scalar was held fixed.",
}


def export(calibration: Calibration, context: Context) -> Export:
    """Return `calibration.json`; nothing is lost."""
    loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
    document = _plain(yaml.load(calibration_text(calibration), Loader=loader))
    frame = f"{calibration.frame}: {FRAMES.get(calibration.frame, FRAMES['user'])}"
    words = _DEFINITIONS if calibration.imus else _LENSES_ALONE | {"covariance": _DEFINITIONS["covariance"]}
    comment = {"made by": "gnomon", **words, "body_frame": frame, "remarks": list(context.remarks)}
    text = json.dumps(
        {"schema": document["schema"], "comment": comment, **document}, indent=2, ensure_ascii=False, allow_nan=False
    )
    return Export(files={FILE: text + "\n"})


def _plain(value: Any) -> Any:
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    return [_plain(item) for item in value] if isinstance(value, list) else value
