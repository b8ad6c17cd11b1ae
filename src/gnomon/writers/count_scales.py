"""Counts of a converter into the g and deg/s that a driver makes of them: by the full scale of the data sheet."""

from collections.abc import Mapping
from dataclasses import replace
from math import degrees

import numpy as np

from ..calibration import AccelerometerCalibration, Calibration, Covariance, GyroscopeCalibration
from ..errors import OptionError
from ..units import STANDARD_GRAVITY_M_S2

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


def with_full_scale(
    calibration: Calibration, lsb_per_g: float | None = None, lsb_per_deg_s: float | None = None
) -> Calibration:
    """Return a calibration of counts for samples that a driver has made g and deg/s of: sample = count / LSB.

    Raises
    ------
    OptionError
        If a full scale is not above zero, or there are no such counts.
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
            imus[name] = replace(imus[name], **{triad: _divided(found, lsb, _UNITS[triad])})
            blocks = tuple(f"{name}.{triad}.{block}" for block in ("sensitivity", "bias", "g_sensitivity"))
            factors[[path.partition("[")[0] in blocks for path in calibration.uncertainty.names]] = 1 / lsb
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


def _found(triad: str, found: AccelerometerCalibration | GyroscopeCalibration) -> str:
    """Say how many counts make a unit, and which full scales of data sheets that may be."""
    nominal = abs(np.linalg.det(found.sensitivity)) ** (1 / 3)
    counts = nominal * STANDARD_GRAVITY_M_S2 if triad == "accelerometer" else nominal / degrees(1)
    near = sorted((abs(counts / lsb - 1), lsb) for lsb in _KNOWN[triad] if abs(counts / lsb - 1) < _NEAR)
    unit = "g" if triad == "accelerometer" else "deg/s"
    if not near:
        return f"{counts:.5g} counts per {unit}, no usual full scale ({_OPTIONS[triad]} LSB)"
    away, lsb = near[0]
    return f"{counts:.5g} counts per {unit}, {100 * away:.1f} % from {lsb:g}: likely {_OPTIONS[triad]} {lsb:g}"
