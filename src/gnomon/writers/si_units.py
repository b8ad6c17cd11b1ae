"""Samples in SI units, which the projects for cameras and IMUs take: how those of a calibration get there.

Samples in g or deg/s get there by their unit. Counts have none: for them a nominal conversion is chosen,
(count - offset) / scale, with the estimated bias as offset and the mean sensitivity as scale; what differs from it is
left to the project's model, and its file states the conversion.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ..calibration import AccelerometerCalibration, GyroscopeCalibration, ImuCalibration
from ..recording import Floats
from ..units import ACCELEROMETER_UNITS_M_S2, GYROSCOPE_UNITS_RAD_S
from .export import Loss, numbers_text


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Conversion:
    """SI = (sample - offset) * factor.

    Attributes
    ----------
    triad : "accelerometer" or "gyroscope"
    unit, si : of the samples, and "m/s^2" or "rad/s"
    factor : [SI per unit]
    offset : (3,) [unit]
    bias : (3,) of the calibration [unit]
    """

    triad: str
    unit: str
    si: str
    factor: float
    offset: Floats
    bias: Floats

    @property
    def bias_si(self) -> Floats:
        """Bias of the converted samples, (3,) [SI]."""
        return (self.bias - self.offset) * self.factor

    def lines(self) -> Iterator[str]:
        """Say it in words, with numbers that read back bit by bit."""
        if self.unit == "count":
            yield f"{self.triad} [{self.si}] = (count - ({numbers_text(self.offset, ', ')})) * {self.factor!r}"
        elif self.unit != self.si:
            yield f"{self.triad} [{self.si}] = {self.unit} * {self.factor!r}"
        yield f"{self.triad} bias [{self.si}] = ({numbers_text(self.bias_si, ', ')})"


def conversions(imu: ImuCalibration) -> list[Conversion]:
    """Return the conversions of accelerometer and gyroscope, as far as there are such, in this order."""
    return [_conversion(triad) for triad in (imu.accelerometer, imu.gyroscope) if triad is not None]


def _conversion(triad: AccelerometerCalibration | GyroscopeCalibration) -> Conversion:
    is_gyroscope = isinstance(triad, GyroscopeCalibration)
    units = GYROSCOPE_UNITS_RAD_S if is_gyroscope else ACCELEROMETER_UNITS_M_S2
    factor = units[triad.unit]
    nominal = float(f"{abs(np.linalg.det(triad.sensitivity)) ** (1 / 3):.6g}")
    return Conversion(
        triad="gyroscope" if is_gyroscope else "accelerometer",
        unit=triad.unit,
        si="rad/s" if is_gyroscope else "m/s^2",
        factor=1 / nominal if factor is None else factor,
        offset=triad.bias if factor is None else np.zeros(3),
        bias=triad.bias,
    )


def si_imu(imu: ImuCalibration) -> ImuCalibration:
    """Return accelerometer and gyroscope for samples that were converted.

    Raises
    ------
    OptionError
        If there is no accelerometer.
    """
    sensor = imu.required_accelerometer
    acc, *others = conversions(imu)
    accelerometer = AccelerometerCalibration(sensitivity=sensor.sensitivity * acc.factor, bias=acc.bias_si, unit=acc.si)
    if imu.gyroscope is None:
        return ImuCalibration(accelerometer=accelerometer)
    gyro = others[0]
    gyroscope = GyroscopeCalibration(
        sensitivity=imu.gyroscope.sensitivity * gyro.factor,
        bias=gyro.bias_si,
        g_sensitivity=imu.gyroscope.g_sensitivity * gyro.factor,
        unit=gyro.si,
    )
    return ImuCalibration(accelerometer=accelerometer, gyroscope=gyroscope)


def count_losses(name: str, imu: ImuCalibration, whose: str) -> Iterator[Loss]:
    """Say which counts a project's file takes."""
    for conversion in conversions(imu):
        if conversion.unit == "count":
            yield Loss(
                what=f"{conversion.triad} counts of {name}",
                why=f"{whose} takes {conversion.si}. The file holds for {next(conversion.lines())}; convert so first.",
            )
