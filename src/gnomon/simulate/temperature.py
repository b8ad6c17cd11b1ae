"""Recordings of an IMU that follows its temperature, read by a thermometer with steps, noise and a lag.

Warm-ups at rest, or multi-position recordings at several temperatures.
"""

import numpy as np

from ..frozen import value_class
from ..recording import Floats, ImuSamples, Integers, Recording, TemperatureSamples, TriadSamples
from ..results.sensors import ImuCalibration
from ..results.temperature_dependence import TemperatureDependence
from .imu import simulate_imu
from .scenarios.recorded import NoiseScenario, Scenario, TemperatureScenario
from .sensor import noise_blocks

_MARGIN_K = 5.0
_SIZES = {"gyroscope": (5e-4, 1e-5, 3e-7), "accelerometer": (5e-3, 1e-4, 3e-6)}
"""Usual sizes of the coefficients [rad/s/K^j], [m/s^2/K^j], as of low-cost chips."""
_SMALLER, _ACROSS = 50.0, 0.3
"""Of a sensitivity's coefficients: each one from the one before [K], and axes from scales; these scatter alike."""


@value_class
class TemperatureSimulation:
    """Recordings of one sensor, each from one switching-on, and how it truly depends on the temperature.

    Attributes
    ----------
    recordings : with the readings of its thermometer
    degc : of each recording, the temperature of the chip at each sample of the gyroscope [degC]
    truth : reference and polynomials
    sensor : at the reference, of recordings in which it is turned; else None, an ideal one
    """

    recordings: tuple[Recording, ...]
    degc: tuple[Floats, ...]
    truth: TemperatureDependence
    sensor: ImuCalibration | None = None


def simulate_temperature(scenario: TemperatureScenario, seed: int = 0) -> TemperatureSimulation:
    """Simulate recordings of one sensor over its temperature.

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
    if scenario.turned and scenario.sensitivity_order:
        parts |= {
            f"{triad}_sensitivity": np.array(
                [_change(triad, scenario.sensitivity / _SMALLER**j, rng) for j in range(scenario.sensitivity_order)]
            )
            for triad in _SIZES
        }
    if scenario.turned and scenario.g_sensitivity:
        parts["gyroscope_g_sensitivity"] = scenario.g_sensitivity * rng.standard_normal((1, 3, 3))
    truth = TemperatureDependence(
        reference_degc=reference,
        low_degc=low - _MARGIN_K,
        high_degc=high + scenario.turned * scenario.self_heating_k + _MARGIN_K,
        lag_s=scenario.lag_s,
        **parts,
    )
    seeds = rng.integers(0, 2**31, scenario.recordings).tolist()
    if scenario.turned:
        return _turned(scenario, truth, seeds, rng)
    recordings, degc = zip(*(_recording(scenario, truth, one, rng) for one in seeds), strict=True)
    return TemperatureSimulation(recordings=recordings, degc=degc, truth=truth)


def _change(triad: str, size: float, rng: np.random.Generator, across: float = _ACROSS) -> Floats:
    """Return a relative change of a sensitivity, (3, 3), of the accelerometer's in frame accel-x."""
    change = size * rng.standard_normal((3, 3)) * np.where(np.eye(3), 1.0, across)
    return np.tril(change) if triad == "accelerometer" else change


def _turned(
    scenario: TemperatureScenario, truth: TemperatureDependence, seeds: list[int], rng: np.random.Generator
) -> TemperatureSimulation:
    """Return multi-position recordings at temperatures from start to end."""
    recordings: list[Recording] = []
    degc: list[Floats] = []
    sensor = None
    for seed, at in zip(seeds, np.linspace(scenario.start_degc, scenario.end_degc, len(seeds)), strict=True):
        plain = Scenario(
            intervals=scenario.intervals, t_init_s=20.0, rate_hz=scenario.rate_hz, sensor_seed=seeds[0],
            g_sensitivity=300 * scenario.g_sensitivity,
        )  # fmt: skip
        made, known = simulate_imu(plain, seed)
        samples, sensor = made.imus["imu0"], known.imus["imu0"]
        t_s = samples.gyroscope.t_s
        course = at + rng.normal(0.0, 1.0) + scenario.self_heating_k * warm_up_share(scenario, t_s)
        degc.append(course)
        turn_on = {"gyroscope": scenario.gyroscope_turn_on, "accelerometer": scenario.accelerometer_turn_on}
        triads: dict[str, TriadSamples] = {}
        assert sensor.accelerometer is not None
        felt = truth.change("gyroscope_g_sensitivity", course)
        felt = felt @ (samples.accelerometer.values - sensor.accelerometer.bias)[:, :, None]
        for name in ("accelerometer", "gyroscope"):
            triad, bias = getattr(samples, name), getattr(sensor, name).bias
            values = triad.values + (triad.values - bias) @ _change(name, scenario.sensitivity_scatter, rng, 1.0).T
            values = values + (felt[:, :, 0] if name == "gyroscope" else 0.0)
            values = truth.from_reference(name, values, course, bias) + turn_on[name] * rng.standard_normal(3)
            triads[name] = TriadSamples(t_ns=triad.t_ns, values=values, unit=triad.unit)
        read = thermometer_readings(scenario, samples.gyroscope.t_ns, course, rng)
        imu = ImuSamples(accelerometer=triads["accelerometer"], gyroscope=triads["gyroscope"], temperature=read)
        recordings.append(Recording(imus={"imu0": imu}))
    return TemperatureSimulation(recordings=tuple(recordings), degc=tuple(degc), truth=truth, sensor=sensor)


def thermometer_readings(
    scenario: TemperatureScenario, t_ns: Integers, degc: Floats, rng: np.random.Generator
) -> TemperatureSamples:
    """Return what the thermometer reads of the temperature (n,) at timestamps (n,) of the sensor."""
    read = _read(scenario, np.asarray(t_ns * 1e-9, dtype=np.float64), degc, rng)
    every = slice(None, None, max(1, round(scenario.rate_hz / scenario.thermometer_rate_hz)))
    return TemperatureSamples(t_ns=t_ns[every], values=read[every], unit="degC")


def _recording(
    scenario: TemperatureScenario, truth: TemperatureDependence, seed: int, rng: np.random.Generator
) -> tuple[Recording, Floats]:
    n = round(scenario.duration_s * scenario.rate_hz)
    t_s = np.arange(n) / scenario.rate_hz
    t_ns = np.round(1e9 * t_s).astype(np.int64)
    degc = _course(scenario, t_s, rng)
    noise = NoiseScenario(
        duration_s=scenario.duration_s,
        rate_hz=scenario.rate_hz,
        gyroscope_white_noise=scenario.gyroscope_white_noise,
        accelerometer_white_noise=scenario.accelerometer_white_noise,
        gyroscope_bias_instability=scenario.gyroscope_bias_instability,
    )
    turn_on = {"gyroscope": scenario.gyroscope_turn_on, "accelerometer": scenario.accelerometer_turn_on}

    def triad(name: str, unit: str) -> TriadSamples:
        values = np.concatenate(list(noise_blocks(noise, name, seed)))
        values = values + truth.change(f"{name}_bias", degc) + turn_on[name] * rng.standard_normal(3)
        if scenario.branches and name == "gyroscope":
            values = values + scenario.branches / 2 * np.sign(np.gradient(degc))[:, None]
        return TriadSamples(t_ns=t_ns, values=values, unit=unit)

    temperature = thermometer_readings(scenario, t_ns, degc, rng)
    imu = ImuSamples(
        accelerometer=triad("accelerometer", "m/s^2"), gyroscope=triad("gyroscope", "rad/s"), temperature=temperature
    )
    return Recording(imus={"imu0": imu}), degc


def _course(scenario: TemperatureScenario, t_s: Floats, rng: np.random.Generator) -> Floats:
    """Return the temperature of the chip: up exponentially, and down again in the second half where that is wanted."""
    start, end = scenario.start_degc + rng.normal(0.0, 1.0), scenario.end_degc + rng.normal(0.0, 1.0)
    return start + (end - start) * warm_up_share(scenario, t_s)


def warm_up_share(scenario: TemperatureScenario, t_s: Floats) -> Floats:
    """Return how far the temperature is on its way to the end, (n,) from 0 to 1."""
    tau, half = scenario.time_constant_s, float(t_s[-1]) / 2
    there = 1 - np.exp(-t_s / tau)
    if not scenario.back:
        return there
    return np.where(t_s < half, there, (1 - np.exp(-half / tau)) * np.exp(-(t_s - half) / tau))


def _read(scenario: TemperatureScenario, t_s: Floats, degc: Floats, rng: np.random.Generator) -> Floats:
    """Return what the thermometer reads, (n,) [degC]."""
    from scipy.signal import lfilter

    read = degc
    if scenario.lag_s > 0:
        share = 1 - np.exp(-(t_s[1] - t_s[0]) / scenario.lag_s)
        read = np.asarray(lfilter([share], [1.0, share - 1.0], degc - degc[0])) + degc[0]
    read = read + scenario.thermometer_noise * rng.standard_normal(len(read))
    return np.round(read / scenario.step_k) * scenario.step_k if scenario.step_k > 0 else read
