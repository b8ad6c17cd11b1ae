"""The sensor: drawn parameters, the units of its output, and what its converter does to a reading."""

from typing import Self

import numpy as np

from ..frozen import value_class
from ..recording import Floats
from ..results.calibration import AccelerometerCalibration, GyroscopeCalibration, ImuCalibration
from ..units import ACCELEROMETER_UNITS_M_S2, GYROSCOPE_UNITS_RAD_S, Units
from .scenarios.recorded import RecordedSensor, Scenario

DEFAULT_BITS = 16


@value_class(eq=True)
class Converter:
    """From a reading in SI units to the recorded number: recorded = reading / unit_si + zero, limited and rounded.

    Attributes
    ----------
    unit : name of the unit of the recording
    unit_si : one of it in m/s^2 or rad/s
    zero : recorded number of a reading of zero
    low, high : smallest and largest recorded number
    step : of the recorded numbers; zero where they are not quantised
    """

    unit: str
    unit_si: float
    zero: float
    low: float
    high: float
    step: float

    @classmethod
    def of(cls, unit: str, unit_si: float | None, full_scale_si: float, bits: int | None) -> Self:
        """Make a converter for readings from minus to plus `full_scale_si`; its counts are unsigned (Tedaldi 2014)."""
        codes = 2 ** (bits or DEFAULT_BITS)
        step_si = 2 * full_scale_si / (codes - 1)
        if unit_si is None:
            return cls(unit=unit, unit_si=step_si, zero=codes / 2, low=0, high=codes - 1, step=1)
        if bits is None:
            limit = full_scale_si / unit_si
            return cls(unit=unit, unit_si=unit_si, zero=0, low=-limit, high=limit, step=0)
        step = step_si / unit_si
        return cls(unit=unit, unit_si=unit_si, zero=0, low=-codes / 2 * step, high=(codes / 2 - 1) * step, step=step)

    def digitise(self, values: Floats) -> Floats:
        """Limit and round recorded numbers, in place."""
        if self.step:
            np.rint(values / self.step, out=values)
            values *= self.step
        return np.clip(values, self.low, self.high, out=values)


def sensor_converters(scenario: RecordedSensor) -> tuple[Converter, Converter]:
    """Return the converters of accelerometer and gyroscope."""
    units = Units.parse(scenario.units)
    accelerometer, gyroscope = units.accelerometer or "m/s^2", units.gyroscope or "rad/s"
    return (
        Converter.of(
            accelerometer, ACCELEROMETER_UNITS_M_S2[accelerometer], scenario.accelerometer_range, scenario.bits
        ),
        Converter.of(gyroscope, GYROSCOPE_UNITS_RAD_S[gyroscope], scenario.gyroscope_range, scenario.bits),
    )


def drawn_imu(scenario: Scenario, rng: np.random.Generator, recorded: RecordedSensor | None = None) -> ImuCalibration:
    """Draw a sensor as Tedaldi 2014 does (Tables 4.1 and 4.2): a_O = T K (s + b), in body frame "accel-z".

    Parameters
    ----------
    scenario : how large its errors are
    recorded : how its readings are recorded, if not as the scenario says
    """
    for_accelerometer, for_gyroscope = sensor_converters(recorded or scenario)
    spread = scenario.accelerometer_misalignment
    accelerometer_t = np.eye(3) + np.triu(rng.uniform(-spread, spread, (3, 3)), k=1)
    accelerometer_k = rng.uniform(*scenario.accelerometer_scale, 3)
    accelerometer_bias = rng.uniform(-scenario.accelerometer_bias, scenario.accelerometer_bias, 3)
    spread = scenario.gyroscope_misalignment
    gyroscope_t = rng.uniform(-spread, spread, (3, 3))
    np.fill_diagonal(gyroscope_t, 1.0)
    gyroscope_k = rng.uniform(*scenario.gyroscope_scale, 3)
    gyroscope_bias = rng.uniform(-scenario.gyroscope_bias, scenario.gyroscope_bias, 3)
    g_sensitivity = rng.uniform(-scenario.g_sensitivity, scenario.g_sensitivity, (3, 3))
    return ImuCalibration(
        accelerometer=AccelerometerCalibration(
            sensitivity=_inverse(accelerometer_t * accelerometer_k) / for_accelerometer.unit_si,
            bias=for_accelerometer.zero - accelerometer_bias / for_accelerometer.unit_si,
            unit=for_accelerometer.unit,
        ),
        gyroscope=GyroscopeCalibration(
            sensitivity=_inverse(gyroscope_t * gyroscope_k) / for_gyroscope.unit_si,
            bias=for_gyroscope.zero - gyroscope_bias / for_gyroscope.unit_si,
            g_sensitivity=g_sensitivity / for_gyroscope.unit_si,
            unit=for_gyroscope.unit,
        ),
    )


def _inverse(matrix: Floats) -> Floats:
    return np.asarray(np.linalg.inv(matrix), dtype=np.float64)
