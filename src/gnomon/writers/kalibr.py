"""Kalibr: `imu.yaml` with model scale-misalignment, as Kalibr itself writes its results.

Kalibr's samples are in m/s^2 and rad/s. Samples in g or deg/s get there by their unit. Counts have none: for them a
nominal conversion is chosen, (count - offset) / scale, with the estimated bias as offset and the mean sensitivity as
scale; M then holds what differs from it, and the file states the conversion. Read back by `readers.kalibr_imu`.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..calibration import AccelerometerCalibration, Calibration, GyroscopeCalibration, ImuCalibration
from ..models.project_forms import KalibrAccelerometer, KalibrGyroscope
from ..recording import Floats
from ..units import ACCELEROMETER_UNITS_M_S2, GYROSCOPE_UNITS_RAD_S
from .export import Export, Loss, into_frame, numbers_text, uncertainty_loss
from .yaml_text import yaml_lines

_HEADER = """\
# IMU intrinsics in Kalibr's layout (model scale-misalignment), made by gnomon.
# With specific force f [m/s^2] and angular rate w [rad/s] in the IMU's frame (x along the sensitivity axis of the x
# accelerometer, the axis of the y accelerometer in the x-y plane), and C = C_gyro_i:
#   accelerometer [m/s^2] = M f + bias                gyroscope [rad/s] = M C w + A C f + bias
"""

_NOISE = (
    "accelerometer_noise_density",
    "accelerometer_random_walk",
    "gyroscope_noise_density",
    "gyroscope_random_walk",
)


def export(calibration: Calibration) -> Export:
    """Return `imu.yaml`.

    Raises
    ------
    OptionError
        If the calibration cannot be brought into Kalibr's frame.
    """
    moved, losses = into_frame(calibration, KalibrAccelerometer.frame, "Kalibr's")
    header, document, found = _HEADER, dict[str, Any](), list(losses)
    for name, imu in moved.imus.items():
        conversions = [_conversion(triad) for triad in (imu.accelerometer, imu.gyroscope) if triad is not None]
        header += "".join(f"# {name}: {line}\n" for conversion in conversions for line in conversion.lines())
        document[name] = _imu(name, imu, conversions)
        found.extend(_losses(name, conversions))
    missing = ", ".join((*_NOISE, "update_rate", "rostopic"))
    header += f"# Kalibr also needs {missing}: add them before you use this file as its input.\n"
    found.append(
        Loss(what="noise, rate and topic", why=f"a gnomon calibration does not hold {missing}; add them by hand.")
    )
    text = header + "\n".join(yaml_lines(document)) + "\n"
    return Export(files={"imu.yaml": text}, losses=(*found, uncertainty_loss("kalibr")))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Conversion:
    """SI = (sample - offset) * factor."""

    triad: str
    unit: str
    si: str
    factor: float
    offset: Floats
    bias: Floats

    def lines(self) -> Iterator[str]:
        """Say it in words, with numbers that read back bit by bit."""
        if self.unit == "count":
            yield f"{self.triad} [{self.si}] = (count - ({numbers_text(self.offset, ', ')})) * {self.factor!r}"
        elif self.unit != self.si:
            yield f"{self.triad} [{self.si}] = {self.unit} * {self.factor!r}"
        yield f"{self.triad} bias [{self.si}] = ({numbers_text((self.bias - self.offset) * self.factor, ', ')})"


def _conversion(triad: AccelerometerCalibration | GyroscopeCalibration) -> _Conversion:
    is_gyroscope = isinstance(triad, GyroscopeCalibration)
    units = GYROSCOPE_UNITS_RAD_S if is_gyroscope else ACCELEROMETER_UNITS_M_S2
    factor = units[triad.unit]
    nominal = float(f"{abs(np.linalg.det(triad.sensitivity)) ** (1 / 3):.6g}")
    return _Conversion(
        triad="gyroscope" if is_gyroscope else "accelerometer",
        unit=triad.unit,
        si="rad/s" if is_gyroscope else "m/s^2",
        factor=1 / nominal if factor is None else factor,
        offset=triad.bias if factor is None else np.zeros(3),
        bias=triad.bias,
    )


def _imu(name: str, imu: ImuCalibration, conversions: list[_Conversion]) -> dict[str, Any]:
    entry: dict[str, Any] = {"model": "scale-misalignment"}
    if name == "imu0":
        entry |= {"T_i_b": np.eye(4), "time_offset": 0.0}
    accelerometer = KalibrAccelerometer.from_sensor(imu.accelerometer.sensitivity, imu.accelerometer.bias)
    entry["accelerometers"] = {"M": accelerometer.M * conversions[0].factor}
    if imu.gyroscope is not None:
        gyroscope = KalibrGyroscope.from_sensor(
            imu.gyroscope.sensitivity, imu.gyroscope.bias, imu.gyroscope.g_sensitivity
        )
        factor = conversions[1].factor
        entry["gyroscopes"] = {"M": gyroscope.M * factor, "A": gyroscope.A * factor, "C_gyro_i": gyroscope.C_gyro_i}
    return entry


def _losses(name: str, conversions: list[_Conversion]) -> Iterator[Loss]:
    for conversion in conversions:
        lines = list(conversion.lines())
        size = numbers_text(np.round((conversion.bias - conversion.offset) * conversion.factor, 6), ", ")
        if conversion.unit == "count":
            yield Loss(
                what=f"{conversion.triad} counts of {name}",
                why=f"Kalibr takes {conversion.si}. The file holds for {lines[0]}; convert so first.",
            )
        else:
            yield Loss(
                what=f"{conversion.triad} bias of {name}",
                why="Kalibr estimates the bias over time and has no key for it; it is in the file's comments.",
                size=f"{size} {conversion.si}",
            )
    if name != "imu0":
        yield Loss(what=f"pose of {name}", why="how the IMUs lie to each other was not measured: T_i_b is left out.")
