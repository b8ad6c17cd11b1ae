"""Samples in SI units, which the projects for cameras and IMUs take: how those of a calibration get there.

Samples in g or deg/s get there by their unit. Counts have none: for them a nominal conversion is chosen,
(count - offset) / scale, with the estimated bias as offset and the mean sensitivity as scale; what differs from it is
left to the project's model, and its file states the conversion.
"""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from math import degrees

import numpy as np

from ...errors import OptionError
from ...frozen import value_class
from ...recording import Floats
from ...results.calibration import (
    AccelerometerCalibration,
    Calibration,
    Covariance,
    GyroscopeCalibration,
    ImuCalibration,
)
from ...units import ACCELEROMETER_UNITS_M_S2, GYROSCOPE_UNITS_RAD_S, STANDARD_GRAVITY_M_S2
from .losses import Loss, numbers_text


@value_class
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


def si_conversions(imu: ImuCalibration) -> list[Conversion]:
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
    acc, *others = si_conversions(imu)
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
    for conversion in si_conversions(imu):
        if conversion.unit == "count":
            yield Loss(
                what=f"{conversion.triad} counts of {name}",
                why=f"{whose} takes {conversion.si}. The file holds for {next(conversion.lines())}; convert so first.",
            )


_OPTIONS = {"accelerometer": "--accelerometer-lsb-per-g", "gyroscope": "--gyroscope-lsb-per-deg-s"}
_KNOWN: Mapping[str, tuple[float, ...]] = {
    "accelerometer": (16384, 8192, 4096, 2048, 10920, 5460, 2730, 1365),
    "gyroscope": (262.4, 131, 65.5, 32.8, 16.4, 114.3, 57.1, 28.6, 14.3),
}
"""LSB per g and per deg/s of 16 bit sensors: InvenSense's and Bosch's of +-2 to 16 g (BMI08x: 3 to 24 g) and of +-125
to 2000 deg/s, ST's of 8.75 to 70 mdeg/s a count."""

_NEAR = 0.06
"""How far a sensor may be from its data sheet."""

_UNITS = {"accelerometer": "g", "gyroscope": "deg/s"}
_FOREIGN = 1.3
"""Factor from which on a full scale is not that of the sensor: the next one is twice as large."""


def with_full_scale(
    calibration: Calibration, lsb_per_g: float | None = None, lsb_per_deg_s: float | None = None
) -> Calibration:
    """Return a calibration of counts for samples that a driver has made g and deg/s of: sample = count / LSB.

    Raises
    ------
    OptionError
        If a full scale is not above zero or not that of the sensor, or there are no such counts.
    """
    scales = {"accelerometer": lsb_per_g, "gyroscope": lsb_per_deg_s}
    for triad, lsb in scales.items():
        if lsb is None:
            continue
        if not 0 < lsb < float("inf"):
            raise OptionError(f"{_OPTIONS[triad]} {lsb:g} must be above zero.")
        if not any(_counts(getattr(imu, triad)) for imu in calibration.imus.values()):
            raise OptionError(f"{_OPTIONS[triad]}: no {triad} of this calibration is in counts. Leave it out.")
    imus = dict(calibration.imus)
    factors = np.ones(len(calibration.uncertainty.names))
    for name, imu in calibration.imus.items():
        for triad, lsb in scales.items():
            found = getattr(imu, triad)
            if lsb is None or not _counts(found):
                continue
            _check_full_scale(name, triad, found, lsb)
            imus[name] = replace(imus[name], **{triad: _divided(found, lsb, _UNITS[triad])})
            per_lsb = {f"{name}.{triad}.{block}": 1 / lsb for block in ("sensitivity", "bias", "g_sensitivity")}
            of_temperature = {f"{triad}_bias": 1 / lsb, f"{triad}_g_sensitivity": 1 / lsb}
            if triad == "accelerometer":  # by whose readings the gyroscope's is stated
                of_temperature["gyroscope_g_sensitivity"] = lsb
            if (warm := imus[name].temperature) is not None:
                changed = {part: of_temperature[part] * old for part, old in warm.parts() if part in of_temperature}
                imus[name] = replace(imus[name], temperature=replace(warm, **changed))
            per_lsb |= {f"{name}.temperature.{part}": factor for part, factor in of_temperature.items()}
            factors *= [per_lsb.get(path.partition("[")[0], 1.0) for path in calibration.uncertainty.names]
    uncertainty = Covariance(
        names=calibration.uncertainty.names, matrix=calibration.uncertainty.matrix * np.outer(factors, factors)
    )
    return replace(calibration, imus=imus, uncertainty=uncertainty)


def refuse_counts(calibration: Calibration, whose: str) -> None:
    """Refuse a calibration of counts for a program whose drivers convert them by the full scale.

    Raises
    ------
    OptionError
        If there are counts; all that is missing is named, with the likely full scale.
    """
    missing = [
        f"{name}: the {triad} has {_found(triad, found)}"
        for name, imu in calibration.imus.items()
        for triad in _OPTIONS
        if _counts(found := getattr(imu, triad))
    ]
    if missing:
        raise OptionError(
            f"{whose} takes samples as its drivers give them, in m/s^2 and rad/s; this calibration is of counts; the "
            f"full scale is missing. {'; '.join(missing)}. State by what the driver divides, as its data sheet has it."
        )


def _counts(triad: AccelerometerCalibration | GyroscopeCalibration | None) -> bool:
    return triad is not None and triad.unit == "count"


def _divided(
    triad: AccelerometerCalibration | GyroscopeCalibration, lsb: float, unit: str
) -> AccelerometerCalibration | GyroscopeCalibration:
    changed = {"sensitivity": triad.sensitivity / lsb, "bias": triad.bias / lsb, "unit": unit}
    if isinstance(triad, GyroscopeCalibration):
        changed["g_sensitivity"] = triad.g_sensitivity / lsb
    return replace(triad, **changed)


def _check_full_scale(
    name: str, triad: str, found: AccelerometerCalibration | GyroscopeCalibration, lsb: float
) -> None:
    """Refuse a full scale that is not the sensor's."""
    counts, unit = _counts_per_unit(triad, found), _UNITS[triad]
    if not 1 / _FOREIGN < counts / lsb < _FOREIGN:
        raise OptionError(
            f"{_OPTIONS[triad]} {lsb:g}: the {triad} of {name} has {counts:.5g} counts per {unit}. State by what its "
            "driver divides; the full scale may have been another one in the recording."
        )


def _counts_per_unit(triad: str, found: AccelerometerCalibration | GyroscopeCalibration) -> float:
    nominal = abs(np.linalg.det(found.sensitivity)) ** (1 / 3)
    return nominal * STANDARD_GRAVITY_M_S2 if triad == "accelerometer" else nominal / degrees(1)


def _found(triad: str, found: AccelerometerCalibration | GyroscopeCalibration) -> str:
    """Say how many counts make a unit, and which full scales of data sheets that may be."""
    counts = _counts_per_unit(triad, found)
    near = sorted((abs(counts / lsb - 1), lsb) for lsb in _KNOWN[triad] if abs(counts / lsb - 1) < _NEAR)
    unit = _UNITS[triad]
    if not near:
        return f"{counts:.5g} counts per {unit}, no usual full scale ({_OPTIONS[triad]} LSB)"
    away, lsb = near[0]
    return f"{counts:.5g} counts per {unit}, {100 * away:.1f} % from {lsb:g}: likely {_OPTIONS[triad]} {lsb:g}"
