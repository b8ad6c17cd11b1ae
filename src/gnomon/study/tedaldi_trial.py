"""One of Tedaldi's simulations: a recording of its signals, calibrated by gnomon and as published.

A calibration is measured as in section 4.1.1: the signals before and after it against those without errors.
"""

from dataclasses import replace
from typing import Literal

import numpy as np

from ..calibrate.imu import calibrate_imu
from ..errors import GnomonError
from ..estimate.multiposition.measurements import cut_segments, integrate_rates, propagate_directions, segments_between
from ..frozen import field_names, value_class
from ..geometry.rotations import invert_matrix
from ..models.forms import TedaldiAccelerometer, TedaldiGyroscope
from ..options import ImuOptions
from ..recording import Floats, Recording
from ..results.calibration import Calibration, ImuCalibration
from ..results.result import StaticIntervals, interval_means
from ..simulate.imu import TrueSignals, simulate_imu, true_signals
from ..simulate.scenarios.recorded import Scenario

Method = Literal["gnomon", "tedaldi2014-text", "tedaldi2014"]
METHODS: tuple[Method, ...] = ("gnomon", "tedaldi2014-text", "tedaldi2014")
"""gnomon's recipe; Algorithm 1 as printed; the authors' script."""

SCENARIO = Scenario(style="thesis")
"""As Tedaldi 2014 describes its signals, with 40 rests; what it does not state has the defaults of `Scenario`."""

_T_ENTRIES = ((0, 1, -1), (0, 2, 1), (1, 2, -1))
_TG_ENTRIES = ((0, 1, -1), (0, 2, 1), (1, 0, 1), (1, 2, -1), (2, 0, -1), (2, 1, 1))
"""Row, column and sign of the misalignments in T, in the order of Eqs. (3.2) and (3.6)."""


@value_class(eq=True)
class TedaldiTrial:
    """One recording.

    Attributes
    ----------
    scenario : what is simulated, the parameter set by its seed
    seed : of the signals
    """

    scenario: Scenario
    seed: int


@value_class
class SignalErrors:
    """Metrics 2 to 4 of one recording.

    Attributes
    ----------
    force, rate : (3,) mean absolute error along each axis [m/s^2] [rad/s]
    divergence : (2,) mean and largest of | |a| - g | over the samples at rest [m/s^2]
    tilt : (2,) the same as an angle, if all of it were along a level axis [rad]
    rotation, rotation_angle : (2,) mean and largest difference between the acceleration sensed at rest and that which
        the gyroscope carries there from the rest before [m/s^2] [rad]
    drift, drift_angle : (2,) the same, carried on from the first rest through the whole recording
    """

    force: Floats
    rate: Floats
    divergence: Floats
    tilt: Floats
    rotation: Floats
    rotation_angle: Floats
    drift: Floats
    drift_angle: Floats


@value_class
class MethodOutcome:
    """What one method made of the recording; nan where it made nothing.

    Attributes
    ----------
    estimate, sigma : (18,) in the letters of Eqs. (3.2) and (3.6)
    errors : of the signals that it corrects
    problem : why it made nothing, else ""
    """

    estimate: Floats
    sigma: Floats
    errors: SignalErrors
    problem: str = ""


@value_class
class TedaldiOutcome:
    """What became of a recording.

    Attributes
    ----------
    truth : (18,) in the letters of Eqs. (3.2) and (3.6)
    before : errors of the signals as they were recorded
    methods : one for each of METHODS
    """

    truth: Floats
    before: SignalErrors
    methods: tuple[MethodOutcome, ...]


def tedaldi_trial(scenario: Scenario, parameter_set: int, seed: int) -> TedaldiTrial:
    """Return the recording of a parameter set with signals of this seed."""
    return TedaldiTrial(scenario=replace(scenario, sensor_seed=parameter_set), seed=seed)


def run_tedaldi_trial(task: TedaldiTrial) -> TedaldiOutcome:
    """Simulate one recording, calibrate it by every method, and measure the calibrations."""
    recording, truth = simulate_imu(task.scenario, task.seed)
    signals = ideal_signals(task, truth)
    gravity = task.scenario.gravity
    force, rate = recorded_samples(recording)

    def measured(method: Method) -> MethodOutcome:
        """Return what a method makes of the recording; not numbers where it refuses."""
        try:
            calibration = calibrate_imu(
                recording, ImuOptions(preset=method, gravity=gravity, frame="accel-z")
            ).calibration
        except GnomonError as error:
            nothing = SignalErrors(**{name: np.full(size, np.nan) for name, size in _SIZES.items()})
            return MethodOutcome(
                estimate=np.full(18, np.nan), sigma=np.full(18, np.nan), errors=nothing, problem=str(error)
            )
        corrected_signals = correct_samples(calibration.imus["imu0"], force, rate)
        estimate, sigma = as_tedaldi(calibration)
        return MethodOutcome(estimate=estimate, sigma=sigma, errors=signal_errors(signals, *corrected_signals, gravity))

    return TedaldiOutcome(
        truth=as_tedaldi(truth.in_frame("accel-z"))[0],
        before=signal_errors(signals, force, rate, gravity),
        methods=tuple(measured(method) for method in METHODS),
    )


def ideal_signals(task: TedaldiTrial, truth: Calibration) -> TrueSignals:
    """Return the signals without noise and errors, in Tedaldi's body frame."""
    signals = true_signals(task.scenario, task.seed)
    before, after = (
        truth.in_frame(frame).imus["imu0"].required_accelerometer.sensitivity for frame in ("accel-x", "accel-z")
    )
    turn = invert_matrix(after) @ before  # the same measurement: after @ f_z = before @ f_x
    return replace(signals, force=signals.force @ turn.T, rate=signals.rate @ turn.T)


_SIZES = {name: 3 if name in ("force", "rate") else 2 for name in field_names(SignalErrors)}


def recorded_samples(recording: Recording) -> tuple[Floats, Floats]:
    """Return the samples of accelerometer and gyroscope, (n, 3) both, of one rate."""
    samples = recording.imus["imu0"]
    return samples.accelerometer.values, samples.gyroscope.values


def correct_samples(imu: ImuCalibration, force: Floats, rate: Floats) -> tuple[Floats, Floats]:
    """Return specific force [m/s^2] and angular rate [rad/s], (n, 3) both, of what was recorded."""
    accelerometer, gyroscope = imu.required_accelerometer, imu.gyroscope
    assert gyroscope is not None
    force = (force - accelerometer.bias) @ invert_matrix(accelerometer.sensitivity).T
    rate = rate - gyroscope.bias - force @ gyroscope.g_sensitivity.T
    return force, rate @ invert_matrix(gyroscope.sensitivity).T


def as_tedaldi(calibration: Calibration) -> tuple[Floats, Floats]:
    """Return the parameters (18,) of Eqs. (3.2) and (3.6), and their sigmas (18,), of one in body frame accel-z."""
    imu = calibration.imus["imu0"]
    gyro = imu.gyroscope
    assert gyro is not None
    sensitivity = np.triu(imu.required_accelerometer.sensitivity)
    a = TedaldiAccelerometer.from_sensor(sensitivity, imu.required_accelerometer.bias)
    g = TedaldiGyroscope.from_sensor(gyro.sensitivity, gyro.bias, gyro.g_sensitivity)
    estimate = np.concatenate([_angles(a.T, _T_ENTRIES), a.K, a.b, _angles(g.T, _TG_ENTRIES), g.K])
    by_sensor = np.zeros((18, 21))
    by_sensor[:6, :9] = _by_sensitivity(sensitivity, _T_ENTRIES)
    by_sensor[6:9, 9:12] = -np.eye(3)
    by_sensor[9:, 12:] = _by_sensitivity(gyro.sensitivity, _TG_ENTRIES)
    names = ("accelerometer.sensitivity", "accelerometer.bias", "gyroscope.sensitivity")
    uncertainty = calibration.uncertainty
    which = [i for name in names for i, of in enumerate(uncertainty.names) if of.startswith(f"imu0.{name}")]
    covariance = by_sensor @ uncertainty.matrix[np.ix_(which, which)] @ by_sensor.T
    return estimate, np.sqrt(np.maximum(np.diag(covariance), 0.0))


def _angles(T: Floats, entries: tuple[tuple[int, int, int], ...]) -> Floats:
    return np.array([sign * T[i, j] for i, j, sign in entries])


def _by_sensitivity(sensitivity: Floats, entries: tuple[tuple[int, int, int], ...]) -> Floats:
    """Return the derivative of the misalignments, then of K, by the sensitivity (row by row), (n, 9)."""
    C = invert_matrix(sensitivity)
    dC = -np.kron(C, C.T)  # C = T K is the inverse
    rows = [sign * (dC[3 * i + j] - C[i, j] / C[j, j] * dC[4 * j]) / C[j, j] for i, j, sign in entries]
    return np.array([*rows, *dC[::4]])


def signal_errors(truth: TrueSignals, force: Floats, rate: Floats, gravity: float) -> SignalErrors:
    """Compare signals (n, 3), in SI units, with the true ones.

    As in Tedaldi 2014, the gyroscope's mean over the first rest is removed before it carries anything (metric 4).
    """
    rests = _rests(truth)
    away = np.abs(np.linalg.norm(force[~truth.moving], axis=1) - gravity)
    sensed = interval_means(force, rests)
    free = rate - rate[rests.start[0] : rests.stop[0]].mean(axis=0)
    last, following = truth.t_s[rests.stop - 1], truth.t_s[rests.start]
    once = propagate_directions(_turned(truth.t_s, free, last[:-1], following[1:]), sensed[:-1])
    middle = 0.5 * (last + following)
    middle[0] = last[0]
    carried = sensed.copy()
    for k, rotation in enumerate(_turned(truth.t_s, free, middle[:-1], middle[1:])):
        carried[k + 1] = rotation.T @ carried[k]
    return SignalErrors(
        force=np.mean(np.abs(force - truth.force), axis=0),
        rate=np.mean(np.abs(rate - truth.rate), axis=0),
        divergence=_mean_and_most(away),
        tilt=_mean_and_most(np.arcsin(np.minimum(away / gravity, 1.0))),
        rotation=_mean_and_most(np.linalg.norm(sensed[1:] - once, axis=1)),
        rotation_angle=_mean_and_most(_angle(sensed[1:], once)),
        drift=_mean_and_most(np.linalg.norm(sensed[1:] - carried[1:], axis=1)),
        drift_angle=_mean_and_most(_angle(sensed[1:], carried[1:])),
    )


def _rests(truth: TrueSignals) -> StaticIntervals:
    edges = np.flatnonzero(np.diff(np.concatenate([[True], truth.moving, [True]]).astype(np.int8)))
    return StaticIntervals(start=edges[::2], stop=edges[1::2])


def _turned(t_s: Floats, rate: Floats, start_s: Floats, stop_s: Floats) -> Floats:
    """Return R_start_stop (m, 3, 3) of the turns between two instants, by Eqs. (3.10)-(3.16)."""
    first, lengths = segments_between(t_s, start_s, stop_s)
    segments = cut_segments(t_s, rate, rate, first, lengths)
    return integrate_rates(segments, segments.gyroscope).rotation


def _angle(a: Floats, b: Floats) -> Floats:
    return np.arctan2(np.linalg.norm(np.cross(a, b), axis=1), np.einsum("ki,ki->k", a, b))


def _mean_and_most(values: Floats) -> Floats:
    return np.array([values.mean(), values.max()])
