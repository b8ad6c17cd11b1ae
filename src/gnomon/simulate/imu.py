"""The simulation of an IMU, from the drawing of its parameters to the recorded numbers."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ..frozen import value_class
from ..models.gravity import EARTH_RATE_RAD_S
from ..recording import Floats, ImuSamples, Integers, Recording, TriadSamples
from ..results.calibration import Assessment, Calibration, ImuCalibration
from ..results.result import Booleans
from .scenarios.recorded import Scenario
from .sensor import Converter, drawn_imu, sensor_converters, true_calibration
from .trajectory import TOLERANCE_S, Motions, ThesisMotions, hand_motions, thesis_motions

BLOCK = 65536
"""Samples that are made at a time; bounds the memory of a long recording."""


@value_class
class _World:
    """What acts on the sensor."""

    motions: Motions | ThesisMotions
    gravity: float
    earth_rate: Floats

    def at(self, t_s: Floats) -> tuple[Floats, Floats]:
        return self.motions.evaluate(t_s, self.gravity, self.earth_rate)


@value_class
class _Clock:
    """When a triad is sampled (n,), what its timestamps say (n,), and which samples are not lost (n,)."""

    t_s: Floats
    stamps_ns: Integers
    kept: np.ndarray


def simulate_imu(scenario: Scenario, seed: int, *, digitised: bool = True) -> tuple[Recording, Calibration]:
    """Make a recording and its truth; see `gnomon.simulate`.

    Without `digitised` it holds what the converters are given, neither rounded nor limited.
    """
    # One stream a purpose: an option for one leaves the others as they are.
    for_sensor, for_motion, for_force, for_rate, for_walk, for_clock = np.random.default_rng(seed).spawn(6)
    if scenario.sensor_seed is not None:
        for_sensor = np.random.default_rng(scenario.sensor_seed)
    truth = _truth(scenario, seed, drawn_imu(scenario, for_sensor))
    world, end_s = _drawn_world(scenario, for_motion)
    rate_hz = scenario.gyroscope_rate_hz or scenario.rate_hz
    clock = _clock(scenario, end_s, scenario.rate_hz, for_clock)
    # Triads of one rate come in one packet: the same timestamps, the same losses.
    gyroscope_clock = clock if rate_hz == scenario.rate_hz else _clock(scenario, end_s, rate_hz, for_clock)
    to_force, to_rate = sensor_converters(scenario)
    if not digitised:
        to_force, to_rate = (replace(one, step=0.0, low=-np.inf, high=np.inf) for one in (to_force, to_rate))
    accelerometer, gyroscope = _models(truth.imus["imu0"])
    noise = scenario.accelerometer_noise_density * np.sqrt(scenario.rate_hz) / to_force.unit_si
    force = _readings(world, clock, accelerometer, noise, for_force)
    noise = scenario.gyroscope_noise_density * np.sqrt(rate_hz) / to_rate.unit_si
    rate = _readings(world, gyroscope_clock, gyroscope, noise, for_rate)
    if scenario.gyroscope_bias_walk:
        rate += _walk(scenario.gyroscope_bias_walk / to_rate.unit_si / np.sqrt(rate_hz), len(rate), for_walk)
    samples = ImuSamples(
        accelerometer=_recorded(force, clock, to_force), gyroscope=_recorded(rate, gyroscope_clock, to_rate)
    )
    return Recording(imus={"imu0": samples}), truth


@value_class
class TrueSignals:
    """What acts on the sensor at the instants at which its accelerometer is sampled, in body frame "accel-x".

    Attributes
    ----------
    t_s : (n,) [s]
    force, rate : (n, 3) [m/s^2] [rad/s]
    moving : (n,) whether a motion is under way, its ends included
    """

    t_s: Floats
    force: Floats
    rate: Floats
    moving: Booleans


def true_signals(scenario: Scenario, seed: int) -> TrueSignals:
    """Return the ideal, noise-free signals of the recording that the same scenario and seed make."""
    for_motion = np.random.default_rng(seed).spawn(2)[1]
    world, end_s = _drawn_world(scenario, for_motion)
    t_s = _instants(end_s, scenario.rate_hz)
    force, rate = world.at(t_s)
    motions = world.motions
    latest = np.searchsorted(motions.start_s, t_s + TOLERANCE_S, side="right") - 1
    ends_s = (motions.start_s + motions.duration_s)[latest] + TOLERANCE_S
    return TrueSignals(t_s=t_s, force=force, rate=rate, moving=(latest >= 0) & (t_s <= ends_s))


def _drawn_world(scenario: Scenario, rng: np.random.Generator) -> tuple[_World, float]:
    """Return what acts on the sensor, and the recording's end [s]."""
    motions, end_s = (hand_motions if scenario.style == "hand" else thesis_motions)(scenario, rng)
    return _World(motions=motions, gravity=scenario.gravity, earth_rate=_earth_rate(scenario)), end_s


def _instants(end_s: float, rate_hz: float) -> Floats:
    return np.arange(int(end_s * rate_hz + 1e-6) + 1) / rate_hz


def _models(imu: ImuCalibration) -> tuple[Callable[[Floats, Floats], Floats], Callable[[Floats, Floats], Floats]]:
    """Return the noise-free output of accelerometer and gyroscope as functions of specific force and angular rate."""
    accelerometer, gyroscope = imu.required_accelerometer, imu.gyroscope
    assert gyroscope is not None

    def force_reading(force: Floats, _rate: Floats) -> Floats:
        return force @ accelerometer.sensitivity.T + accelerometer.bias

    def rate_reading(force: Floats, rate: Floats) -> Floats:
        return rate @ gyroscope.sensitivity.T + gyroscope.bias + force @ gyroscope.g_sensitivity.T

    return force_reading, rate_reading


def _readings(
    world: _World,
    clock: _Clock,
    model: Callable[[Floats, Floats], Floats],
    noise: float,
    rng: np.random.Generator,
) -> Floats:
    """Return noisy readings (n, 3) in the unit of the recording, before the converter."""
    values = np.empty((len(clock.t_s), 3))
    for first in range(0, len(values), BLOCK):
        rows = slice(first, first + BLOCK)
        values[rows] = model(*world.at(clock.t_s[rows]))
        values[rows] += noise * rng.standard_normal(values[rows].shape)
    return values


def _walk(step: float, count: int, rng: np.random.Generator) -> Floats:
    """Return random walks (count, 3) without their mean."""
    walk = np.cumsum(step * rng.standard_normal((count, 3)), axis=0)
    return walk - walk.mean(axis=0)


def _clock(scenario: Scenario, end_s: float, rate_hz: float, rng: np.random.Generator) -> _Clock:
    t_s = _instants(end_s, rate_hz)
    stamps_ns = t_s * 1e9
    if scenario.stamp_jitter_s:
        stamps_ns += rng.normal(0.0, scenario.stamp_jitter_s * 1e9, len(t_s))
    if scenario.stamp_resolution_s:
        resolution_ns = scenario.stamp_resolution_s * 1e9
        stamps_ns = np.rint(stamps_ns / resolution_ns) * resolution_ns
    kept = rng.random(len(t_s)) >= scenario.dropped if scenario.dropped else np.ones(len(t_s), dtype=bool)
    return _Clock(t_s=t_s, stamps_ns=np.rint(stamps_ns).astype(np.int64), kept=kept)


def _recorded(values: Floats, clock: _Clock, converter: Converter) -> TriadSamples:
    """Digitise readings (in place) and leave out what is lost."""
    values, stamps_ns = converter.digitise(values), clock.stamps_ns
    if not clock.kept.all():
        values, stamps_ns = values[clock.kept], stamps_ns[clock.kept]
    values.flags.writeable = False  # handed over, not copied
    stamps_ns.flags.writeable = False
    return TriadSamples(t_ns=stamps_ns, values=values, unit=converter.unit)


def _earth_rate(scenario: Scenario) -> Floats:
    """Return the Earth's rate in the world, x north and z up, (3,) [rad/s]."""
    if scenario.earth_rate_latitude is None:
        return np.zeros(3)
    latitude = np.radians(scenario.earth_rate_latitude)
    return EARTH_RATE_RAD_S * np.array([np.cos(latitude), 0.0, np.sin(latitude)])


def _truth(scenario: Scenario, seed: int, imu: ImuCalibration) -> Calibration:
    assessment = Assessment(
        verdict="pass",
        findings=(),
        intervals_found=scenario.intervals,
        intervals_used=scenario.intervals,
        rotations_found=scenario.intervals - 1,
        rotations_used=scenario.intervals - 1,
        model="g-sensitivity" if scenario.g_sensitivity else "basic",
    )
    return true_calibration(
        scenario, seed, imus={"imu0": imu}, frame="accel-z", gravity_m_s2=scenario.gravity, assessment=assessment
    ).in_frame("accel-x")
