"""The sensor: drawn parameters, the units of its output, and what its converter does to a reading.

Noise of known coefficients, made block by block, for recordings of any length.

White noise, quantisation (differences of white noise), random walk and ramp follow from their definitions. Noise with a
spectrum of 1/f is the sum of first-order Gauss-Markov processes of equal variance, whose time constants are a factor of
five apart, from a fifth of a sample to ten recordings: their spectra add up to 1/f within 1 % in between.

The calibration that is exactly true of a simulated recording.
"""

from collections.abc import Iterator, Mapping
from dataclasses import fields
from math import log, pi, sqrt
from typing import TYPE_CHECKING, Self

import numpy as np

from ..frozen import value_class
from ..recording import Floats
from ..results.calibration import (
    TRUTH_METHOD,
    AccelerometerCalibration,
    Assessment,
    Calibration,
    CameraCalibration,
    Covariance,
    Gravity,
    GyroscopeCalibration,
    ImuCalibration,
    Provenance,
    covariance_names,
)
from ..units import ACCELEROMETER_UNITS_M_S2, GYROSCOPE_UNITS_RAD_S, STANDARD_GRAVITY_M_S2, Units
from .scenarios.recorded import NoiseScenario, RecordedSensor, Scenario

_RATIO = 5.0
_REACH = 10.0  # recordings
_BLOCK = 1 << 18
_REST = {"accelerometer": (0.0, 0.0, STANDARD_GRAVITY_M_S2), "gyroscope": (0.0, 0.0, 0.0)}


def noise_blocks(scenario: NoiseScenario, sensor: str, seed: int = 0, block: int = _BLOCK) -> Iterator[Floats]:
    """Yield the samples of one sensor at rest, (n, 3) [m/s^2 or rad/s], z up.

    Parameters
    ----------
    sensor : "accelerometer" or "gyroscope"
    seed : every random number follows from it, and from the sensor
    block : samples in a block
    """
    rng = np.random.default_rng([seed, sensor == "gyroscope"])
    found, rate = scenario.of(sensor), scenario.rate_hz
    flicker = _Flicker(found["bias_instability"], scenario.samples, rng)
    walk = np.zeros(3)
    rounding = rng.standard_normal((1, 3))
    for start in range(0, scenario.samples, block):
        count = min(block, scenario.samples - start)
        values = np.tile(np.array(_REST[sensor]), (count, 1))
        values += found["white_noise"] * sqrt(rate) * rng.standard_normal((count, 3))
        values += flicker.block(count)
        if found["random_walk"]:
            steps = np.cumsum(found["random_walk"] / sqrt(rate) * rng.standard_normal((count, 3)), axis=0) + walk
            values += steps
            walk = steps[-1]
        if found["quantisation"]:
            rounded = np.concatenate([rounding, rng.standard_normal((count, 3))])
            values += found["quantisation"] * rate * np.diff(rounded, axis=0)
            rounding = rounded[-1:]
        values += found["rate_ramp"] / rate * np.arange(start, start + count)[:, None]
        yield values


class _Flicker:
    """1/f noise of bias instability B, in consecutive blocks."""

    def __init__(self, instability: float, samples: int, rng: np.random.Generator) -> None:
        count = int(log(_REACH * samples * _RATIO) / log(_RATIO)) + 2
        times = _RATIO ** np.arange(-1.0, count - 1)  # in samples
        self._rng = rng
        self._decay = np.exp(-1 / times) if instability else np.empty(0)
        self._sigma = instability * sqrt(log(_RATIO) / pi)
        self._state = self._sigma * rng.standard_normal((len(self._decay), 3))

    def block(self, count: int) -> Floats:
        """Return the next values (count, 3) of the bias instability, which go on from the last ones."""
        from scipy.signal import lfilter

        values = np.zeros((count, 3))
        for i, decay in enumerate(self._decay.tolist()):
            drive = self._sigma * sqrt(1 - decay**2) * self._rng.standard_normal((count, 3))
            made, _ = lfilter([1.0], [1.0, -decay], drive, axis=0, zi=decay * self._state[i : i + 1])
            self._state[i] = made[-1]
            values += made
        return values


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


if TYPE_CHECKING:
    from _typeshed import DataclassInstance


def true_calibration(
    scenario: "DataclassInstance",
    seed: int,
    *,
    imus: Mapping[str, ImuCalibration] | None = None,
    cameras: Mapping[str, CameraCalibration] | None = None,
    frame: str,
    gravity_m_s2: float,
    assessment: Assessment,
    also: Mapping[str, str] | None = None,
) -> Calibration:
    """Return what is true of simulated sensors, with zero covariance.

    Parameters
    ----------
    scenario : what was simulated; its options that differ from their default go into the provenance
    also : options that go there besides
    """
    names = covariance_names(imus or {}, cameras or {})
    return Calibration(
        imus=imus or {},
        cameras=cameras or {},
        frame=frame,
        gravity=Gravity(value=gravity_m_s2, sigma=0.0, source=TRUTH_METHOD),
        uncertainty=Covariance(names=names, matrix=np.zeros((len(names), len(names)))),
        assessment=assessment,
        provenance=Provenance(method=TRUTH_METHOD, options={**(also or {}), **changed_options(scenario)}, seed=seed),
    )


def changed_options(scenario: "DataclassInstance") -> dict[str, str]:
    """Return the options of a scenario that differ from their default, as text."""
    defaults = type(scenario)()
    return {
        option.name: str(getattr(scenario, option.name))
        for option in fields(scenario)
        if getattr(scenario, option.name) != getattr(defaults, option.name)
    }
