"""The simulation of an IMU, from the drawing of its parameters to the recorded numbers.

It is moved and rests by turns, or is at rest in many attitudes: samples of each pose, their means, and the truth.
"""

from collections.abc import Callable
from dataclasses import replace
from itertools import product

import numpy as np

from ..frozen import value_class
from ..geometry.rotations import rotation_from_rotvec
from ..models.angrisano import AngrisanoTriad
from ..models.gravity import EARTH_RATE_RAD_S
from ..recording import Floats, ImuSamples, Integers, Recording, TriadSamples
from ..results.calibration import (
    AccelerometerCalibration,
    Assessment,
    Calibration,
    GyroscopeCalibration,
    ImuCalibration,
)
from ..results.result import Booleans
from .scenarios.recorded import PoseScenario, Scenario
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


TABLE_1 = AngrisanoTriad(
    angles=np.array([-0.0135, -0.0036, 0.0005]),
    b=np.array([33610.0, 33382.0, 32063.0]),
    K=1 / np.array([547.6, 552.8, 550.6]),
)
"""The accelerometer that Angrisano found from its first set of poses; the angles are radians, see docs/theory."""

TABLE_3 = AngrisanoTriad(
    angles=np.array([-0.0089, -0.0026, 0.0130]),
    b=np.array([28585.0, 36273.0, 34528.0]),
    K=1 / np.array([10835.0, 9592.0, 9575.0]),
)
"""Its gyroscope."""

_FACES = np.concatenate([np.eye(3), -np.eye(3)])
_ORDER_OF_DOCUMENT_B = (5, 4, 2, 1, 0, 3, 5)


@value_class
class PoseSimulation:
    """An experiment with n poses.

    Attributes
    ----------
    scenario : what was asked for
    poses : n recordings at rest, on one clock
    t_s : (n,) middle of each pose [s]
    accelerometer, gyroscope : (n, 3) means of each pose [unit]
    meant : (n, 3) gravity's specific force along the axes of the jig, as the attitudes were meant [m/s^2]
    force : (n, 3) what acted on the sensor, in the body frame "accel-z" [m/s^2]
    truth : in body frame "accel-z"; a drifting bias of the gyroscope at its mean
    """

    scenario: PoseScenario
    poses: tuple[ImuSamples, ...]
    t_s: Floats
    accelerometer: Floats
    gyroscope: Floats
    meant: Floats
    force: Floats
    truth: Calibration


def simulate_poses(scenario: PoseScenario | None = None, seed: int = 0) -> PoseSimulation:
    """Make an experiment in which a sensor lies still in one attitude after another, and what is true of it.

    Parameters
    ----------
    scenario : what to simulate; the default scenario where None: Angrisano's accelerometer in 18 poses
    seed : every random number follows from it; the same scenario and seed give the same experiment

    Returns
    -------
    simulation : samples and means of each pose, the attitudes, and the true calibration in body frame "accel-z"

    Examples
    --------
    >>> simulation = simulate_poses(PoseScenario(attitude_error_deg=10.0), seed=1)
    >>> simulation.accelerometer.shape, simulation.truth.frame
    ((18, 3), 'accel-z')
    """
    scenario = scenario or PoseScenario()
    # One stream a purpose: an option for one leaves the others as they are.
    for_sensor, for_attitude, for_force, for_rate = np.random.default_rng(seed).spawn(4)
    if scenario.sensor_seed is not None:
        for_sensor = np.random.default_rng(scenario.sensor_seed)
    to_force, to_rate = sensor_converters(scenario)
    accelerometer, gyroscope = _sensor(scenario, to_rate, for_sensor)
    meant = scenario.gravity * rest_directions(scenario)
    force, rate = _acting(scenario, meant, for_attitude)
    n, m = len(meant), scenario.samples
    start_s = np.arange(n) * (m / scenario.rate_hz + scenario.wait_s)
    t_s = start_s[:, None] + np.arange(m) / scenario.rate_hz
    per_force, per_rate = _per_si(accelerometer.sensitivity, to_force), _per_si(gyroscope.sensitivity, to_rate)
    noise_a = scenario.accelerometer_noise_density * np.sqrt(scenario.rate_hz) * per_force
    noise_w = scenario.gyroscope_noise_density * np.sqrt(scenario.rate_hz) * per_rate
    drift = (t_s - t_s.mean())[..., None] / max(np.ptp(t_s), 1e-9) * scenario.gyroscope_drift * per_rate
    forces = force @ accelerometer.sensitivity.T + accelerometer.bias
    rates = rate @ gyroscope.sensitivity.T + force @ gyroscope.g_sensitivity.T + gyroscope.bias
    a = to_force.digitise(forces[:, None] + noise_a * for_force.standard_normal((n, m, 3)))
    w = to_rate.digitise(rates[:, None] + drift + noise_w * for_rate.standard_normal((n, m, 3)))
    return PoseSimulation(
        scenario=scenario,
        poses=tuple(_samples(t_s[k], a[k], w[k], to_force.unit, to_rate.unit) for k in range(n)),
        t_s=t_s.mean(axis=1),
        accelerometer=a.mean(axis=1),
        gyroscope=w.mean(axis=1),
        meant=meant,
        force=force,
        truth=_truth_of_poses(scenario, seed, ImuCalibration(accelerometer=accelerometer, gyroscope=gyroscope)),
    )


def rest_directions(scenario: PoseScenario) -> Floats:
    """Return the directions of the specific force at rest that are meant, (n, 3) unit vectors, in the jig's axes."""
    if scenario.attitudes == "six":
        return _FACES.copy()
    if scenario.attitudes == "seven":
        return _FACES[list(_ORDER_OF_DOCUMENT_B)]
    if scenario.attitudes == "angrisano18":
        edges = np.array([v for v in product((-1.0, 0.0, 1.0), repeat=3) if np.count_nonzero(v) == 2])
        return np.concatenate([_FACES, edges / np.sqrt(2)])
    k = np.arange(scenario.poses)  # a Fibonacci lattice: even cover of the sphere
    z, longitude = 1 - (2 * k + 1) / scenario.poses, np.pi * (1 + np.sqrt(5)) * k
    across = np.sqrt(1 - z * z)
    return np.column_stack([across * np.cos(longitude), across * np.sin(longitude), z])


def _acting(scenario: PoseScenario, meant: Floats, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Return specific force and angular rate in the body frame, each (n, 3); the headings are random."""
    n = len(meant)
    tilt = rotation_from_rotvec(np.radians(scenario.attitude_error_deg) * rng.standard_normal((n, 3)))
    body = rotation_from_rotvec(np.radians(np.array(scenario.jig_rotation_deg)))
    force = np.einsum("ij,njk,nk->ni", body, tilt, meant)
    if scenario.earth_rate_latitude is None:
        return force, np.zeros((n, 3))
    latitude = np.radians(scenario.earth_rate_latitude)
    up = force / scenario.gravity
    north = rng.standard_normal((n, 3))
    north -= np.sum(north * up, axis=1, keepdims=True) * up
    north /= np.linalg.norm(north, axis=1, keepdims=True)
    return force, EARTH_RATE_RAD_S * (np.cos(latitude) * north + np.sin(latitude) * up)


def _sensor(
    scenario: PoseScenario, to_rate: Converter, rng: np.random.Generator
) -> tuple[AccelerometerCalibration, GyroscopeCalibration]:
    """Return accelerometer and gyroscope in body frame "accel-z"."""
    if scenario.sensor == "angrisano":
        (S_a, b_a), (S_g, b_g) = TABLE_1.to_sensor(), TABLE_3.to_sensor()
        accelerometer = AccelerometerCalibration(sensitivity=S_a, bias=b_a, unit="count")
        drawn = GyroscopeCalibration(sensitivity=S_g, bias=b_g, g_sensitivity=np.zeros((3, 3)), unit="count")
    else:
        imu = drawn_imu(Scenario(), rng, scenario)
        assert imu.accelerometer is not None and imu.gyroscope is not None  # noqa: PT018
        accelerometer, drawn = imu.accelerometer, imu.gyroscope
    B = np.reshape(scenario.g_sensitivity, (3, 3)) * _per_si(drawn.sensitivity, to_rate)[:, None]
    return accelerometer, replace(drawn, g_sensitivity=B)


def _per_si(sensitivity: Floats, converter: Converter) -> Floats:
    """Return what 1 m/s^2 or rad/s makes in the output of each axis, (3,): by its unit, or its own scale in counts."""
    if converter.unit == "count":
        return np.linalg.norm(sensitivity, axis=1)
    return np.full(3, 1 / converter.unit_si)


def _samples(t_s: Floats, a: Floats, w: Floats, unit_a: str, unit_w: str) -> ImuSamples:
    t_ns = np.rint(t_s * 1e9).astype(np.int64)
    return ImuSamples(
        accelerometer=TriadSamples(t_ns=t_ns, values=a, unit=unit_a),
        gyroscope=TriadSamples(t_ns=t_ns, values=w, unit=unit_w),
    )


def _truth_of_poses(scenario: PoseScenario, seed: int, imu: ImuCalibration) -> Calibration:
    poses = len(rest_directions(scenario))
    assessment = Assessment(
        verdict="pass",
        findings=(),
        intervals_found=poses,
        intervals_used=poses,
        model="g-sensitivity" if any(scenario.g_sensitivity) else "basic",
    )
    return true_calibration(
        scenario, seed, imus={"imu0": imu}, frame="accel-z", gravity_m_s2=scenario.gravity, assessment=assessment
    )
