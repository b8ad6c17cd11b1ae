"""imucal's JSON files, calibration types Ferraris and Turntable, format 2.0.0."""

from math import pi
from os import PathLike

import numpy as np

from ...calibration import AccelerometerCalibration, GyroscopeCalibration, ImuCalibration
from ...models.project_forms import ImucalAccelerometer, ImucalGyroscope
from ...units import ACCELEROMETER_UNITS_M_S2, GYROSCOPE_UNITS_RAD_S
from ..structured import Node, read_json
from .foreign import ForeignCalibration, recognised_frame

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
    acc_si = _unit(keys, "acc_unit", {**ACCELEROMETER_UNITS_M_S2, "count": None}, "m/s^2")
    gyr_si = _unit(keys, "gyr_unit", {"deg/s": pi / 180, **GYROSCOPE_UNITS_RAD_S, "count": None}, "deg/s")
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


def _unit(keys: dict[str, Node], name: str, known: dict[str, float | None], default: str) -> float:
    """Return what one calibrated unit is in SI; imucal takes `default` where the file says nothing."""
    stated = keys[name].value if name in keys else None
    value = known.get(str(stated or default))
    if value is None:
        raise keys[name].fail(f'found "{stated}", expected {default}.')
    return value


def _raw_unit(keys: dict[str, Node], name: str, known: dict[str, float | None]) -> str:
    stated = keys[name].value if name in keys else None
    return stated if isinstance(stated, str) and stated in known else "count"
