"""Parameters of PX4 and ArduPilot: offsets and scales of accelerometers, offsets of gyroscopes.

PX4 corrects f = (a - OFF) SCALE, ArduPilot f = (a - OFFS) SCAL, and both w = y - OFF, axis by axis, of samples in m/s^2
and rad/s. Files are those of ground stations, of "param set NAME VALUE", and NAME,VALUE or NAME VALUE.
"""

import re
from collections.abc import Mapping
from os import PathLike

import numpy as np

from ...calibration import AccelerometerCalibration, GyroscopeCalibration, ImuCalibration
from ...errors import FormatError
from ...models.diagonal_forms import DiagonalTriad
from ...recording import Floats
from ..structured import read_text
from .foreign import ForeignCalibration, recognised_frame

_PX4 = re.compile(r"CAL_(ACC|GYRO)(\d)_([XYZ])(OFF|SCALE)")
_ARDUPILOT = re.compile(r"INS_(ACC|GYR)(\d?)(OFFS|SCAL)_([XYZ])")
_NUMBER = r"[-+]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][-+]?\d+)?"
_LINE = re.compile(rf"^[ \t]*(?:\d+\s+\d+\s+|param\s+set(?:-default)?\s+)?([A-Z][A-Z0-9_]+)[ \t,=]+({_NUMBER})\b", re.M)

Key = tuple[int, str, str]
"""Index of the IMU from 0, "ACC" or "GYR", "offset" or "scale"."""


def is_flight_parameters(text: str) -> bool:
    """Return whether a text holds calibration parameters of PX4 or ArduPilot."""
    return any(_key(match[1]) is not None for match in _LINE.finditer(text))


def read_flight_parameters(path: str | PathLike[str]) -> ForeignCalibration:
    """Read the calibration among the parameters of PX4 or ArduPilot; axes that were not calibrated are ideal.

    Raises
    ------
    FormatError
        If the file cannot be read, or holds no such parameter, or a scale that is not above zero.
    """
    values: dict[Key, Floats] = {}
    format_name = ""
    for match in _LINE.finditer(read_text(path)):
        found = _key(match[1])
        if found is None:
            continue
        format_name, (index, triad, what), axis = found
        row = values.setdefault((index, triad, what), np.full(3, 1.0 if what == "scale" else 0.0))
        row[axis] = float(match[2])
        if what == "scale" and not row[axis] > 0:
            raise FormatError(f"{path}: {match[1]} is {match[2]}, expected a number above zero.")
    if not values:
        raise FormatError(f"{path}: no parameter such as CAL_ACC0_XOFF or INS_ACCOFFS_X is in it.")
    imus = {f"imu{index}": _imu(values, index) for index in sorted({key[0] for key in values})}
    note = f"{format_name} knows no misalignment, and no scale of gyroscopes; taken: none."
    return ForeignCalibration(imus=imus, frame=recognised_frame(imus), notes=(note,), format=format_name)


def _key(name: str) -> tuple[str, Key, int] | None:
    """Return whose parameter it is, which one, and of which axis."""
    px4, ardupilot = _PX4.fullmatch(name), _ARDUPILOT.fullmatch(name)
    if px4 is not None:
        triad, index, axis, what = px4.groups()
        return "PX4", (int(index), triad[:3], "offset" if what == "OFF" else "scale"), "XYZ".index(axis)
    if ardupilot is not None:
        triad, number, what, axis = ardupilot.groups()
        index = int(number) - 1 if number else 0
        return "ArduPilot", (index, triad, "offset" if what == "OFFS" else "scale"), "XYZ".index(axis)
    return None


def _imu(values: Mapping[Key, Floats], index: int) -> ImuCalibration:
    def triad(name: str) -> DiagonalTriad | None:
        if not any((index, name, what) in values for what in ("offset", "scale")):
            return None
        return DiagonalTriad(
            scale=values.get((index, name, "scale"), np.ones(3)),
            offset=values.get((index, name, "offset"), np.zeros(3)),
        )

    accelerometer, gyroscope = triad("ACC"), triad("GYR")
    return ImuCalibration(
        accelerometer=None if accelerometer is None else _accelerometer(accelerometer),
        gyroscope=None if gyroscope is None else _gyroscope(gyroscope),
    )


def _accelerometer(triad: DiagonalTriad) -> AccelerometerCalibration:
    sensitivity, bias = triad.to_sensor()
    return AccelerometerCalibration(sensitivity=sensitivity, bias=bias, unit="m/s^2")


def _gyroscope(triad: DiagonalTriad) -> GyroscopeCalibration:
    sensitivity, bias = triad.to_sensor()
    return GyroscopeCalibration(sensitivity=sensitivity, bias=bias, g_sensitivity=np.zeros((3, 3)), unit="rad/s")
