"""imucal: one JSON file for each IMU, type Ferraris, format 2.0.0; m = K_a R_a f + b_a, y = K_g R_g w + K_ga f + b_g.

imucal's rates are in deg/s, so that K_g is in unit per deg/s. The body frame may be any. Read by
`readers.projects.imucal_json`.
"""

import json
from math import pi
from typing import Any

import numpy as np

from ..calibration import Calibration, ImuCalibration
from ..models.project_forms import ImucalAccelerometer, ImucalGyroscope
from .calibration_file import FRAMES
from .context import Context
from .export import Export, magnetometer_losses, require_triads, rig_losses, uncertainty_loss
from .sensor_losses import accelerometer_losses

_COMMENT = "Made by gnomon. acc = K_a R_a f + b_a; gyr = K_g R_g w + K_ga f + b_g, f in m/s^2, w in deg/s."


def export(calibration: Calibration, context: Context) -> Export:
    """Return `imu0.json` for each IMU.

    Raises
    ------
    OptionError
        If an IMU lacks the accelerometer or the gyroscope; imucal needs both.
    """
    require_triads(calibration, "imucal", "accelerometer", "gyroscope", otherwise="imu_tk, c-header or csv")
    files = {
        f"{name}.json": json.dumps(_document(imu, calibration.frame, context.remarks), indent=4) + "\n"
        for name, imu in calibration.imus.items()
    }
    losses = (
        *rig_losses(calibration, "imucal"),
        *accelerometer_losses(calibration, "imucal"),
        *magnetometer_losses(calibration, "imucal"),
    )
    return Export(files=files, losses=(*losses, uncertainty_loss("imucal")))


def _document(imu: ImuCalibration, frame: str, remarks: tuple[str, ...]) -> dict[str, Any]:
    accelerometer = imu.required_accelerometer
    assert imu.gyroscope is not None
    acc = ImucalAccelerometer.from_sensor(accelerometer.sensitivity, accelerometer.bias)
    per_degree = imu.gyroscope.sensitivity * (pi / 180)
    gyr = ImucalGyroscope.from_sensor(per_degree, imu.gyroscope.bias, imu.gyroscope.g_sensitivity)
    return {
        "cal_type": "Ferraris",
        "_format_version": "2.0.0",
        "acc_unit": "m/s^2",
        "gyr_unit": "deg/s",
        "from_acc_unit": _unit(accelerometer.unit),
        "from_gyr_unit": _unit(imu.gyroscope.unit),
        "comment": " ".join((_COMMENT, f"Body frame {frame}: {FRAMES.get(frame, FRAMES['user'])}.", *remarks)),
        "K_a": np.diag(acc.K).tolist(),
        "R_a": acc.R.tolist(),
        "b_a": acc.b.tolist(),
        "K_g": np.diag(gyr.K).tolist(),
        "R_g": gyr.R.tolist(),
        "K_ga": gyr.K_ga.tolist(),
        "b_g": gyr.b.tolist(),
    }


def _unit(unit: str) -> str:
    return "a.u." if unit == "count" else unit
