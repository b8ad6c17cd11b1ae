"""The simulation of a sensor at rest in many attitudes: samples of each pose, their means, and the truth."""

from dataclasses import replace
from itertools import product

import numpy as np

from ..frozen import value_class
from ..geometry.rotation_vector import rotation_from_rotvec
from ..models.angrisano import AngrisanoTriad
from ..models.gravity import EARTH_RATE_RAD_S
from ..recording import Floats, ImuSamples, TriadSamples
from ..results.calibration import (
    AccelerometerCalibration,
    Assessment,
    Calibration,
    GyroscopeCalibration,
    ImuCalibration,
)
from .scenarios.recorded import PoseScenario, Scenario
from .sensor import Converter, drawn_imu, sensor_converters, true_calibration

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
        truth=_truth(scenario, seed, ImuCalibration(accelerometer=accelerometer, gyroscope=gyroscope)),
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


def _truth(scenario: PoseScenario, seed: int, imu: ImuCalibration) -> Calibration:
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
