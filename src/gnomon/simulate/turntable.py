"""The simulation of a sensor on a turntable: rests, spin-up, steady turning, handling, and the truth."""

from dataclasses import replace

import numpy as np

from ..frozen import value_class
from ..geometry.rotations import frame_rotation, rotation_from_rotvec, rotvec_from_rotation
from ..models.gravity import EARTH_RATE_RAD_S
from ..recording import Floats, ImuSamples, Recording, TriadSamples
from ..results.calibration import Assessment, Calibration, ImuCalibration
from ..results.moved import rotate_imu
from .imu import rest_directions
from .scenarios.recorded import PoseScenario, Scenario
from .scenarios.turntable import TurntableScenario
from .sensor import drawn_imu, sensor_converters, true_calibration

RPM = 2 * np.pi / 60
_SETTLED = 12.0  # time constants of the spin-up until the speed is kept
_TREMOR = (0.3, 0.05)  # of a hand [m/s^2], [rad/s]

_Piece = tuple[Floats, Floats, Floats]
"""Time (n,) [s], specific force (n, 3) and angular rate (n, 3)."""


@value_class
class SteadyTruth:
    """One part of the recording in which the platter kept its speed.

    Attributes
    ----------
    recording : index of the recording it is in
    start_s, stop_s : [s from the start of that recording]
    pose : index of the attitude
    rate : true mean rate of the platter, without sign [rad/s]; 0 at rest
    """

    recording: int
    start_s: float
    stop_s: float
    pose: int
    rate: float


@value_class
class TurntableSimulation:
    """What was recorded on a turntable, and what is true of it.

    Attributes
    ----------
    scenario : what was asked for
    recordings : one, or one an attitude
    truth : in body frame "accel-x", or "gyro-x" without accelerometer
    rates : the true speeds [rad/s], in the order of `scenario.rpm`
    parts : true steady parts
    """

    scenario: TurntableScenario
    recordings: tuple[Recording, ...]
    truth: Calibration
    rates: tuple[float, ...]
    parts: tuple[SteadyTruth, ...]


@value_class
class _Course:
    """What happens over time: rate of the platter (n,), its derivative, handled (n,), and when it is steady."""

    omega: Floats
    handled: np.ndarray
    steady: tuple[tuple[int, int, float], ...]


def simulate_turntable(scenario: TurntableScenario | None = None, seed: int = 0) -> TurntableSimulation:
    """Make recordings of a sensor on a turntable, and what is true of them.

    Parameters
    ----------
    scenario : what to simulate; the default scenario where None: Angrisano's gyroscope on a record player at 16 rpm
    seed : every random number follows from it; the same scenario and seed give the same recordings

    Returns
    -------
    simulation : recordings, speeds, steady parts, and the truth in body frame "accel-x", "gyro-x" of a gyroscope alone

    Examples
    --------
    >>> simulation = simulate_turntable(TurntableScenario(poses=2, steady_s=8.0), seed=1)
    >>> len(simulation.recordings), simulation.truth.frame
    (1, 'accel-x')
    """
    scenario = scenario or TurntableScenario()
    for_sensor, for_pose, for_noise, for_speed = np.random.default_rng(seed).spawn(4)
    if scenario.sensor_seed is not None:
        for_sensor = np.random.default_rng(scenario.sensor_seed)
    truth = _truth(scenario, seed, _sensor(scenario, for_sensor))
    attitudes = _attitudes(scenario, for_pose)
    rates = [(1 + scenario.rate_error) * RPM * rpm for rpm in scenario.rpm]
    pieces, parts, origin_s = list[_Piece](), list[SteadyTruth](), 0.0
    for k in range(len(attitudes)):
        following = attitudes[k + 1] if scenario.files == "one" and k + 1 < len(attitudes) else None
        course = _course(scenario, rates, following is not None, for_speed)
        t_s = origin_s + np.arange(len(course.omega)) / scenario.rate_hz
        pieces.append((t_s, *_motion(scenario, course, attitudes[k], following, for_speed)))
        start_s = 0.0 if scenario.files == "each" else origin_s
        for first, last, rate in course.steady:
            begin, end = start_s + first / scenario.rate_hz, start_s + last / scenario.rate_hz
            index = k if scenario.files == "each" else 0
            parts.append(SteadyTruth(recording=index, start_s=begin, stop_s=end, pose=k, rate=rate))
        origin_s += len(t_s) / scenario.rate_hz
    if scenario.files == "one":
        t_s, force, rate = (np.concatenate(column) for column in zip(*pieces, strict=True))
        pieces = [(t_s, force, rate)]
    recordings = tuple(_recorded(scenario, truth[0], piece, origin_s, for_noise) for piece in pieces)
    return TurntableSimulation(
        scenario=scenario, recordings=recordings, truth=truth[1], rates=tuple(rates), parts=tuple(parts)
    )


def _attitudes(scenario: TurntableScenario, rng: np.random.Generator) -> list[Floats]:
    """Return rotations (3, 3) from the platter, z up, to the sensor."""
    sphere = PoseScenario(attitudes="angrisano18" if scenario.poses == 18 else "sphere", poses=scenario.poses)
    turns = list[Floats]()
    for up in rest_directions(sphere):
        heading = np.cross(up, rng.standard_normal(3))
        heading /= np.linalg.norm(heading)
        exact = np.column_stack([heading, np.cross(up, heading), up])
        turns.append(rotation_from_rotvec(np.radians(scenario.attitude_error_deg) * rng.standard_normal(3)) @ exact)
    return turns


def _course(scenario: TurntableScenario, rates: list[float], handled: bool, rng: np.random.Generator) -> _Course:
    """Return rest, spin-up to each speed in turn, spin-down, rest, and handling."""
    samples, steady = list[Floats](), list[tuple[int, int, float]]()
    rest, hands = round(scenario.rest_s * scenario.rate_hz), round(scenario.handling_s * scenario.rate_hz)
    swing = max(1, round(_SETTLED * scenario.spin_up_s * scenario.rate_hz))
    speed, phase, count = 0.0, rng.uniform(0, 2 * np.pi), 0

    def append(values: Floats, rate: float | None = None) -> None:
        nonlocal count
        if rate is not None and len(values):
            steady.append((count, count + len(values), rate))
        samples.append(values)
        count += len(values)

    append(np.zeros(rest), 0.0)
    for rate in [*rates, 0.0]:
        scattered = rate * (1 + scenario.speed_scatter * rng.standard_normal())
        decay = np.exp(-np.arange(swing) / max(scenario.spin_up_s * scenario.rate_hz, 1e-9))
        append(scattered + (speed - scattered) * decay)
        t = np.arange(round(scenario.steady_s * scenario.rate_hz) if rate else rest) / scenario.rate_hz
        append(scattered * (1 + scenario.wow * np.sin(scattered * t + phase)), scattered)
        speed = scattered
    append(np.zeros(hands if handled else 0))
    marked = np.zeros(count, dtype=bool)
    marked[count - hands if handled else count :] = True
    return _Course(omega=np.concatenate(samples), handled=marked, steady=tuple(steady))


def _motion(
    scenario: TurntableScenario,
    course: _Course,
    attitude: Floats,
    following: Floats | None,
    rng: np.random.Generator,
) -> tuple[Floats, Floats]:
    """Return specific force and angular rate in the body frame, each (n, 3)."""
    omega = course.omega * (1.0 if scenario.counter_clockwise else -1.0)
    phase = rng.uniform(0, 2 * np.pi) + np.cumsum(omega) / scenario.rate_hz
    speeding = np.gradient(omega) * scenario.rate_hz
    speeding[course.handled] = 0.0
    tilt = np.radians(scenario.tilt_deg)
    up = scenario.gravity * np.column_stack(
        [np.sin(tilt) * np.cos(phase), -np.sin(tilt) * np.sin(phase), np.full(len(phase), np.cos(tilt))]
    )
    force = up + scenario.radius * np.column_stack([-(omega**2), speeding, np.zeros(len(phase))])
    rate = np.column_stack([np.zeros(len(phase)), np.zeros(len(phase)), omega])
    if scenario.earth_rate_latitude is not None:
        latitude = np.radians(scenario.earth_rate_latitude)
        level = np.cos(latitude) * np.column_stack([np.cos(phase + 0.7), -np.sin(phase + 0.7), np.zeros(len(phase))])
        rate += EARTH_RATE_RAD_S * (level + np.array([0.0, 0.0, np.sin(latitude)]))
    force, rate = force @ attitude.T, rate @ attitude.T
    if following is not None:
        hands = np.flatnonzero(course.handled)
        share = np.arange(len(hands)) / max(len(hands), 1)
        turn = rotvec_from_rotation(following @ attitude.T)
        angle = share - np.sin(2 * np.pi * share) / (2 * np.pi)
        swing = (1 - np.cos(2 * np.pi * share)) * scenario.rate_hz / max(len(hands), 1)
        force[hands] = np.einsum("nij,nj->ni", rotation_from_rotvec(angle[:, None] * turn), force[hands])
        force[hands] += _TREMOR[0] * rng.standard_normal((len(hands), 3))
        rate[hands] -= swing[:, None] * turn  # vectors of the platter turn by +turn in the body when it turns by -turn
        rate[hands] += _TREMOR[1] * rng.standard_normal((len(hands), 3))
    return force, rate


def _recorded(
    scenario: TurntableScenario, imu: ImuCalibration, piece: _Piece, end_s: float, rng: np.random.Generator
) -> Recording:
    t_s, force, rate = piece
    to_force, to_rate = sensor_converters(scenario)
    accelerometer, gyroscope = imu.accelerometer, imu.gyroscope
    assert accelerometer is not None and gyroscope is not None  # noqa: PT018
    noise = np.sqrt(scenario.rate_hz) * np.array(
        [scenario.accelerometer_noise_density / to_force.unit_si, scenario.gyroscope_noise_density / to_rate.unit_si]
    )
    drift = scenario.gyroscope_drift / to_rate.unit_si * (t_s / end_s - 0.5)
    a = force @ accelerometer.sensitivity.T + accelerometer.bias
    w = rate @ gyroscope.sensitivity.T + gyroscope.bias + force @ gyroscope.g_sensitivity.T + drift[:, None]
    a += noise[0] * rng.standard_normal(a.shape)
    w += noise[1] * rng.standard_normal(w.shape)
    t_ns = np.rint((t_s - (t_s[0] if scenario.files == "each" else 0.0)) * 1e9).astype(np.int64)
    seen = slice(None) if scenario.accelerometer else slice(0)
    samples = ImuSamples(
        accelerometer=TriadSamples(t_ns=t_ns[seen], values=to_force.digitise(a)[seen], unit=to_force.unit),
        gyroscope=TriadSamples(t_ns=t_ns, values=to_rate.digitise(w), unit=to_rate.unit),
    )
    return Recording(imus={"imu0": samples})


def _sensor(scenario: TurntableScenario, rng: np.random.Generator) -> ImuCalibration:
    """Return the sensor in body frame "accel-x"."""
    imu = drawn_imu(Scenario(g_sensitivity=scenario.g_sensitivity), rng, scenario)
    assert imu.accelerometer is not None
    turned = rotate_imu(imu, frame_rotation(imu.accelerometer.sensitivity, "accel-x"))
    assert turned.accelerometer is not None
    exact = replace(turned.accelerometer, sensitivity=np.tril(turned.accelerometer.sensitivity))
    return replace(turned, accelerometer=exact)


def _truth(scenario: TurntableScenario, seed: int, imu: ImuCalibration) -> tuple[ImuCalibration, Calibration]:
    """Return the sensor, and what a calibration of its recording should be."""
    known, frame = imu, "accel-x"
    if not scenario.accelerometer:
        gyroscope = imu.gyroscope
        assert gyroscope is not None
        turned = rotate_imu(ImuCalibration(gyroscope=gyroscope), frame_rotation(gyroscope.sensitivity, "accel-x"))
        assert turned.gyroscope is not None
        lower = replace(turned.gyroscope, sensitivity=np.tril(turned.gyroscope.sensitivity))
        known, frame = ImuCalibration(gyroscope=lower), "gyro-x"
    parts = scenario.poses * (len(scenario.rpm) + 2)
    assessment = Assessment(
        verdict="pass",
        findings=(),
        intervals_found=parts,
        intervals_used=parts,
        model="g-sensitivity" if scenario.g_sensitivity else "basic",
    )
    return imu, true_calibration(
        scenario, seed, imus={"imu0": known}, frame=frame, gravity_m_s2=scenario.gravity, assessment=assessment
    )
