"""Warm-ups of an IMU at rest whose biases follow the temperature, read by a thermometer with steps, noise and a lag."""

import numpy as np

from ..frozen import value_class
from ..recording import Floats, ImuSamples, Recording, TemperatureSamples, TriadSamples
from ..results.sensors import TemperatureDependence
from .noise import noise_blocks
from .scenarios import NoiseScenario
from .temperature_scenario import TemperatureScenario

_MARGIN_K = 5.0
_SIZES = {"gyroscope": (5e-4, 1e-5, 3e-7), "accelerometer": (5e-3, 1e-4, 3e-6)}
"""Usual sizes of the coefficients [rad/s/K^j], [m/s^2/K^j], as of low-cost chips."""


@value_class
class TemperatureSimulation:
    """Recordings of one sensor, each from one switching-on, and how it truly depends on the temperature.

    Attributes
    ----------
    recordings : with the readings of its thermometer
    degc : of each recording, the temperature of the chip at each sample of the gyroscope [degC]
    truth : reference and polynomials
    """

    recordings: tuple[Recording, ...]
    degc: tuple[Floats, ...]
    truth: TemperatureDependence


def simulate_temperature(scenario: TemperatureScenario, seed: int = 0) -> TemperatureSimulation:
    """Simulate warm-ups of one sensor.

    Parameters
    ----------
    seed : every random number follows from it
    """
    rng = np.random.default_rng([seed, 24])
    low, high = sorted((scenario.start_degc, scenario.end_degc))
    reference = (low + high) / 2
    parts = {
        f"{triad}_bias": np.array([rng.normal(0.0, size, 3) for size in sizes[: scenario.order]])
        for triad, sizes in _SIZES.items()
        if scenario.order
    }
    truth = TemperatureDependence(
        reference_degc=reference, low_degc=low - _MARGIN_K, high_degc=high + _MARGIN_K, lag_s=scenario.lag_s, **parts
    )
    seeds = rng.integers(0, 2**31, scenario.recordings).tolist()
    recordings, degc = zip(*(_recording(scenario, truth, one, rng) for one in seeds), strict=True)
    return TemperatureSimulation(recordings=recordings, degc=degc, truth=truth)


def _recording(
    scenario: TemperatureScenario, truth: TemperatureDependence, seed: int, rng: np.random.Generator
) -> tuple[Recording, Floats]:
    n = round(scenario.duration_s * scenario.rate_hz)
    t_s = np.arange(n) / scenario.rate_hz
    t_ns = np.round(1e9 * t_s).astype(np.int64)
    degc = _course(scenario, t_s, rng)
    noise = NoiseScenario(duration_s=scenario.duration_s, rate_hz=scenario.rate_hz)
    turn_on = {"gyroscope": scenario.gyroscope_turn_on, "accelerometer": scenario.accelerometer_turn_on}

    def triad(name: str, unit: str) -> TriadSamples:
        values = np.concatenate(list(noise_blocks(noise, name, seed)))
        values = values + truth.change(f"{name}_bias", degc) + turn_on[name] * rng.standard_normal(3)
        if scenario.branches and name == "gyroscope":
            values = values + scenario.branches / 2 * np.sign(np.gradient(degc))[:, None]
        return TriadSamples(t_ns=t_ns, values=values, unit=unit)

    read = _read(scenario, t_s, degc, rng)
    every = slice(None, None, max(1, round(scenario.rate_hz / scenario.thermometer_rate_hz)))
    temperature = TemperatureSamples(t_ns=t_ns[every], values=read[every], unit="degC")
    imu = ImuSamples(
        accelerometer=triad("accelerometer", "m/s^2"), gyroscope=triad("gyroscope", "rad/s"), temperature=temperature
    )
    return Recording(imus={"imu0": imu}), degc


def _course(scenario: TemperatureScenario, t_s: Floats, rng: np.random.Generator) -> Floats:
    """Return the temperature of the chip: up exponentially, and down again in the second half where that is wanted."""
    start, end = scenario.start_degc + rng.normal(0.0, 1.0), scenario.end_degc + rng.normal(0.0, 1.0)
    tau = scenario.time_constant_s
    course = end - (end - start) * np.exp(-t_s / tau)
    if scenario.back:
        half = t_s[-1] / 2
        top = end - (end - start) * np.exp(-half / tau)
        course = np.where(t_s < half, course, start + (top - start) * np.exp(-(t_s - half) / tau))
    return course


def _read(scenario: TemperatureScenario, t_s: Floats, degc: Floats, rng: np.random.Generator) -> Floats:
    """Return what the thermometer reads, (n,) [degC]."""
    from scipy.signal import lfilter

    read = degc
    if scenario.lag_s > 0:
        share = 1 - np.exp(-(t_s[1] - t_s[0]) / scenario.lag_s)
        read = np.asarray(lfilter([share], [1.0, share - 1.0], degc - degc[0])) + degc[0]
    read = read + scenario.thermometer_noise * rng.standard_normal(len(read))
    return np.round(read / scenario.step_k) * scenario.step_k if scenario.step_k > 0 else read
