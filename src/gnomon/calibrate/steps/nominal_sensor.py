"""The sensor whose dependence on temperature is looked for: as it was calibrated, or as its data sheet has it."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ...errors import OptionError
from ...recording import Floats, ImuSamples
from ...results.calibration import (
    UNSTATED_GRAVITY,
    AccelerometerCalibration,
    Assessment,
    Calibration,
    Covariance,
    GyroscopeCalibration,
    ImuCalibration,
    Provenance,
    covariance_names,
)
from ...units import ACCELEROMETER_UNITS_M_S2, GYROSCOPE_UNITS_RAD_S
from .warm_ups import TRIADS

_NOMINAL_SCALE, _NOMINAL_BIAS_M_S2 = 0.03, 1.0
"""Standard deviations of a sensor as its data sheet has it, that nobody calibrated."""


def base_calibration(calibration: Calibration | None, imu: ImuSamples, name: str) -> tuple[Calibration, bool]:
    """Return the calibration whose sensor changes with the temperature, and whether it is the data sheet's.

    Raises
    ------
    OptionError
        If it is of other sensors, or in other units, or there is none for a sensor in counts; or it knows how its
        magnetometer changes, which would hold in another range.
    """
    triads = [triad for triad in TRIADS if len(getattr(imu, triad))]
    if calibration is None:
        return _ideal(imu, triads, name), True
    if len(calibration.imus) != 1:
        raise OptionError(
            f"the calibration holds {len(calibration.imus)} IMUs; a temperature is found of one. Give that of one IMU."
        )
    name_of, sensor = next(iter(calibration.imus.items()))
    if sensor.temperature is not None and sensor.temperature.of("magnetometer"):
        raise OptionError(
            f"the calibration knows what its magnetometer does from {sensor.temperature.low_degc:.0f} to "
            f"{sensor.temperature.high_degc:.0f} degC, which the recordings do not tell anew. Keep it as it is, and "
            "give the result of gnomon imu here."
        )
    for triad in triads:
        known, unit = getattr(sensor, triad), getattr(imu, triad).unit
        if known is not None and known.unit != unit:
            raise OptionError(
                f"the calibration's {triad} is in {known.unit}, that of {name} in {unit}. State the units (--units)."
            )
    return _without_temperature(calibration, name_of), False


def _without_temperature(calibration: Calibration, name: str) -> Calibration:
    """Return a calibration without what it knows of the temperature, which is found anew."""
    kept = [
        i for i, scalar in enumerate(calibration.uncertainty.names) if not scalar.startswith(f"{name}.temperature.")
    ]
    known = calibration.uncertainty
    return replace(
        calibration,
        imus={name: replace(calibration.imus[name], temperature=None)},
        uncertainty=Covariance(names=tuple(known.names[i] for i in kept), matrix=known.matrix[np.ix_(kept, kept)]),
    )


def _ideal(imu: ImuSamples, triads: Sequence[str], name: str) -> Calibration:
    """Return a sensor as its data sheet has it, with standard deviations to match."""
    accelerometer = gyroscope = None
    sigma: list[Floats] = []
    if "accelerometer" in triads:
        unit = imu.accelerometer.unit
        scale = _per_si(unit, ACCELEROMETER_UNITS_M_S2[unit], name)
        accelerometer = AccelerometerCalibration(sensitivity=scale * np.eye(3), bias=np.zeros(3), unit=unit)
        sigma += [_NOMINAL_SCALE * scale * np.tri(3).ravel(), np.full(3, _NOMINAL_BIAS_M_S2 * scale)]
    if "gyroscope" in triads:
        unit = imu.gyroscope.unit
        scale = _per_si(unit, GYROSCOPE_UNITS_RAD_S[unit], name)
        gyroscope = GyroscopeCalibration(
            sensitivity=scale * np.eye(3), bias=np.zeros(3), g_sensitivity=np.zeros((3, 3)), unit=unit
        )
        lower = np.ones((3, 3)) if accelerometer is not None else np.tri(3)
        sigma += [_NOMINAL_SCALE * scale * lower.ravel(), np.zeros(3), np.zeros(9)]
    imus = {"imu0": ImuCalibration(accelerometer=accelerometer, gyroscope=gyroscope)}
    return Calibration(
        imus=imus,
        frame="accel-x" if accelerometer is not None else "gyro-x",
        gravity=UNSTATED_GRAVITY,
        uncertainty=Covariance(names=covariance_names(imus), matrix=np.diag(np.concatenate(sigma) ** 2)),
        assessment=Assessment(verdict="pass", findings=(), model="temperature"),
        provenance=Provenance(method="temperature"),
    )


def _per_si(unit: str, si: float | None, name: str) -> float:
    if si is None:
        raise OptionError(
            f"{name} is in {unit}, and nothing tells what one is. Give a calibration of the sensor (--calibration), or "
            "state the units (--units)."
        )
    return 1 / si
