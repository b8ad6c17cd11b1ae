"""imucal's JSON files, calibration types Ferraris and Turntable, format 2.0.0."""

import json
from math import pi
from os import PathLike
from typing import Any

import numpy as np

from ..models.project_forms import ImucalAccelerometer, ImucalGyroscope
from ..results.calibration import AccelerometerCalibration, Calibration, GyroscopeCalibration, ImuCalibration
from ..units import ACCELEROMETER_UNITS_M_S2, GYROSCOPE_UNITS_RAD_S
from .foreign import ForeignCalibration, recognised_frame
from .own.calibration_text import FRAMES
from .shared.losses import Context, Export, require_triads
from .shared.sensor_losses import Holds, not_representable
from .shared.structured import Node, read_json

_TEXTS = ("acc_unit", "gyr_unit", "from_acc_unit", "from_gyr_unit", "comment")
_PARAMETERS = {"K_a": (3, 3), "R_a": (3, 3), "b_a": (3,), "K_g": (3, 3), "R_g": (3, 3), "K_ga": (3, 3), "b_g": (3,)}


def read_imucal(path: str | PathLike[str]) -> ForeignCalibration:
    """Read an imucal calibration.

    Raises
    ------
    FormatError
        If the file cannot be read, or is not in imucal's layout.
    """
    root = read_json(path)
    keys = root.mapping(("cal_type", *_PARAMETERS), ("_format_version", *_TEXTS))
    keys["cal_type"].text(("Ferraris", "Turntable"))
    p = {name: keys[name].floats(*shape) for name, shape in _PARAMETERS.items()}
    for name in ("K_a", "K_g"):
        if np.count_nonzero(p[name] - np.diag(np.diag(p[name]))):
            raise keys[name].fail("this matrix must be diagonal.")
    acc_si = _calibrated_unit(keys, "acc_unit", {**ACCELEROMETER_UNITS_M_S2, "count": None}, "m/s^2")
    gyr_si = _calibrated_unit(keys, "gyr_unit", {"deg/s": pi / 180, **GYROSCOPE_UNITS_RAD_S, "count": None}, "deg/s")
    S_a, b_a = ImucalAccelerometer(K=np.diag(p["K_a"]), R=p["R_a"], b=p["b_a"]).to_sensor()
    gyroscope = ImucalGyroscope(K=np.diag(p["K_g"]), R=p["R_g"], K_ga=p["K_ga"], b=p["b_g"])
    S_g, b_g, G = gyroscope.to_sensor()
    imu = ImuCalibration(
        accelerometer=AccelerometerCalibration(
            sensitivity=S_a / acc_si, bias=b_a, unit=_raw_unit(keys, "from_acc_unit", ACCELEROMETER_UNITS_M_S2)
        ),
        gyroscope=GyroscopeCalibration(
            sensitivity=S_g / gyr_si,
            bias=b_g,
            g_sensitivity=G / acc_si,
            unit=_raw_unit(keys, "from_gyr_unit", GYROSCOPE_UNITS_RAD_S),
        ),
    )
    return ForeignCalibration(imus={"imu0": imu}, frame=recognised_frame({"imu0": imu}), format="imucal")


def _calibrated_unit(keys: dict[str, Node], name: str, known: dict[str, float | None], default: str) -> float:
    """Return what one calibrated unit is in SI; imucal takes `default` where the file says nothing."""
    stated = keys[name].value if name in keys else None
    value = known.get(str(stated or default))
    if value is None:
        raise keys[name].fail(f'found "{stated}", expected {default}.')
    return value


def _raw_unit(keys: dict[str, Node], name: str, known: dict[str, float | None]) -> str:
    stated = keys[name].value if name in keys else None
    return stated if isinstance(stated, str) and stated in known else "count"


_COMMENT = "Made by gnomon. acc = K_a R_a f + b_a; gyr = K_g R_g w + K_ga f + b_g, f in m/s^2, w in deg/s."

HOLDS = Holds(program="imucal", cameras=0, samples_in_si=False)


def export(calibration: Calibration, context: Context) -> Export:
    """Return `imu0.json` for each IMU.

    Raises
    ------
    OptionError
        If an IMU lacks the accelerometer or the gyroscope; imucal needs both.
    """
    require_triads(calibration, "imucal", "accelerometer", "gyroscope")
    files = {
        f"{name}.json": json.dumps(_document(imu, calibration.frame, context.remarks), indent=4) + "\n"
        for name, imu in calibration.imus.items()
    }
    return Export(files=files, losses=tuple(not_representable(calibration, HOLDS, context)))


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
        "from_acc_unit": _stated_unit(accelerometer.unit),
        "from_gyr_unit": _stated_unit(imu.gyroscope.unit),
        "comment": " ".join((_COMMENT, f"Body frame {frame}: {FRAMES.get(frame, FRAMES['user'])}.", *remarks)),
        "K_a": np.diag(acc.K).tolist(),
        "R_a": acc.R.tolist(),
        "b_a": acc.b.tolist(),
        "K_g": np.diag(gyr.K).tolist(),
        "R_g": gyr.R.tolist(),
        "K_ga": gyr.K_ga.tolist(),
        "b_g": gyr.b.tolist(),
    }


def _stated_unit(unit: str) -> str:
    return "a.u." if unit == "count" else unit
