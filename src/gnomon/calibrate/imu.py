"""An IMU from a hand-held multi-position recording (document A), the gnomon way.

prepare -> static intervals -> problem -> fit -> choose the model -> hold out -> assess -> Result
"""

from collections.abc import Callable

import numpy as np

from .._version import __version__
from ..assess.imu_tables import ImuEvidence, describe
from ..assess.imu_verdict import assess
from ..assess.threshold import FEWEST_INTERVALS, MULTIPLIERS, Motion, ThresholdTrial, choose_threshold, disturbed
from ..calibration import (
    Calibration,
    Covariance,
    Provenance,
    covariance_names,
)
from ..detect.static import static_statistic, turning, window_samples
from ..diagnostics import Result
from ..errors import DetectionError
from ..estimate.leave_one_out import HeldOut, leave_one_out
from ..estimate.multiposition import MultiPositionFit, fit_multiposition
from ..estimate.problem import MultiPositionProblem, TriadStream, build_problem, gyroscope_intervals
from ..estimate.scaling import unscaled
from ..intervals import Booleans
from ..models.gravity import EARTH_RATE_RAD_S
from ..options import ImuOptions
from ..recording import Floats, Recording
from .preparation import PreparedImu, imu_calibration, local_gravity, prepare, stated_options, stream
from .published import calibrate_as_published
from .user_frame import in_stated_frame

Progress = Callable[[str], None]

_SURELY_STILL = 10.0  # times the resting level of s^2


def calibrate_imu(recording: Recording, options: ImuOptions | None = None, progress: Progress | None = None) -> Result:
    """Calibrate an IMU from a recording in which it was turned by hand and held still, some forty times.

    Parameters
    ----------
    recording : of one IMU
    options : see ImuOptions
    progress : called with a sentence at each step

    Raises
    ------
    RecordingError
        If the recording cannot be used; DetectionError where it does not follow the protocol.
    OptionError
        If an option does not fit the recording.
    InitialisationError, SolveError
        If its attitudes and rotations determine no calibration.
    """
    options = options or ImuOptions()
    tell = progress or (lambda _: None)
    tell("checking the recording")
    prepared = prepare(recording, options)
    if options.preset != "gnomon":
        return calibrate_as_published(recording, prepared, options, tell)
    gravity = local_gravity(options)
    tell("finding static intervals")
    chosen, trials, statistic = _static_intervals(prepared, options, gravity.value)
    touched = disturbed(chosen, prepared.accelerometer)
    problem, streams = _problem(prepared, chosen, touched, options)
    tell(f"fitting {len(problem.data.accelerometer)} static intervals and the rotations between them")
    fit, heldout, rivals = _choose_model(problem, options)
    estimate = unscaled(
        fit,
        problem.accelerometer,
        problem.gyroscope,
        gravity_m_s2=gravity.value,
        gravity_sigma_m_s2=gravity.sigma,
        latitude_deg=options.latitude,
    )
    tell("assessing the result")
    evidence = ImuEvidence(
        accelerometer=streams[0],
        gyroscope=streams[1],
        accelerometer_unit=prepared.accelerometer.unit,
        gyroscope_unit=prepared.gyroscope.unit,
        statistic=statistic,
        chosen=chosen,
        trials=trials,
        touched=touched,
        problem=problem,
        fit=fit,
        heldout=heldout,
        rivals=rivals,
        estimate=estimate,
        gravity_m_s2=gravity.value,
    )
    diagnostics = describe(evidence)
    imus = {"imu0": imu_calibration(estimate, prepared)}
    calibration = Calibration(
        imus=imus,
        frame="accel-x",
        gravity=gravity,
        uncertainty=Covariance(names=covariance_names(imus), matrix=estimate.covariance),
        assessment=assess(prepared.findings, evidence, diagnostics, gravity, options),
        provenance=Provenance(
            gnomon_version=__version__, method="imu", inputs=recording.sources, options=stated_options(options)
        ),
    )
    return Result(calibration=in_stated_frame(calibration, options.frame, diagnostics), diagnostics=diagnostics)


def _static_intervals(
    prepared: PreparedImu, options: ImuOptions, gravity_m_s2: float
) -> tuple[ThresholdTrial, tuple[ThresholdTrial, ...], Floats]:
    """Detect static intervals (Eq. 3.9) at the threshold that serves the calibration best."""
    samples = prepared.accelerometer
    window = window_samples(samples, options.window_s)
    if len(samples) < 2 * window:
        raise DetectionError(
            f"the recording of {samples.duration_s:.1f} s is too short for windows of {options.window_s:g} s. "
            "Record at least nine attitudes of 2 to 4 s each."
        )
    statistic = static_statistic(samples.values, window)
    turns, stirs = _turns_at_rest(prepared, statistic)
    statistic[turns] = np.inf
    motion = Motion(samples=samples, statistic=statistic, stirs=stirs, saturated=prepared.accelerometer_saturated)
    multipliers = MULTIPLIERS if options.multiplier is None else (options.multiplier,)
    chosen, trials = choose_threshold(motion, gravity_m_s2, multipliers)
    if chosen.fit is None:
        most = max(len(trial.intervals) for trial in trials)
        if most > FEWEST_INTERVALS:
            raise DetectionError(
                f"the {most} static intervals found do not determine the accelerometer: their attitudes are too much "
                "alike. Hold the sensor still with every axis up once and down once, and in some directions between."
            )
        raise DetectionError(
            f"{most} static intervals found, at least {FEWEST_INTERVALS + 1} in different attitudes are needed "
            "(36 to 50 are best). "
            "Hold the sensor still for 2 to 4 s in each attitude, better lying on something than in the hand."
        )
    return chosen, trials, statistic


def _turns_at_rest(prepared: PreparedImu, statistic: Floats) -> tuple[Booleans, Booleans]:
    """Mark the accelerometer samples (n,) that rest while the gyroscope turns, as about the vertical, or stirs."""
    t_accel, t_gyro = prepared.accelerometer_time.t_s, prepared.gyroscope_time.t_s
    still = statistic < _SURELY_STILL
    if t_accel is t_gyro:
        return turning(prepared.gyroscope, still)
    nearest = np.clip(np.searchsorted(t_accel, t_gyro), 0, len(t_accel) - 1)
    turns, stirs = turning(prepared.gyroscope, still[nearest])
    at_accel = np.clip(np.searchsorted(t_gyro, t_accel), 0, len(t_gyro) - 1)
    return turns[at_accel], stirs[at_accel]


def _problem(
    prepared: PreparedImu, chosen: ThresholdTrial, touched: Booleans, options: ImuOptions
) -> tuple[MultiPositionProblem, tuple[TriadStream, TriadStream]]:
    """Gather what the undisturbed intervals and the rotations between them measured."""
    still = chosen.intervals.where(~touched)
    samples, t_s = prepared.accelerometer, prepared.accelerometer_time.t_s
    accelerometer = stream(samples, t_s, prepared.accelerometer_saturated, still)
    rates, t_gyro = prepared.gyroscope, prepared.gyroscope_time.t_s
    at_rest = gyroscope_intervals(t_gyro, t_s[still.start], t_s[still.stop - 1])
    if len(at_rest) == 0 or np.any(at_rest.stop - at_rest.start < 2):
        raise DetectionError(
            "the gyroscope has no samples in some static intervals of the accelerometer. "
            "Both must be recorded together and stamped by one clock."
        )
    gyroscope = stream(rates, t_gyro, prepared.gyroscope_saturated, at_rest)
    # The earth's horizontal rate, of unknown heading, spread over the two level axes; 2/3 is the mean over the sphere.
    cosine_squared = 2 / 3 if options.latitude is None else float(np.cos(np.radians(options.latitude)) ** 2)
    unmodelled = EARTH_RATE_RAD_S**2 * cosine_squared / 2
    return build_problem(accelerometer, gyroscope, unmodelled), (accelerometer, gyroscope)


def _choose_model(
    problem: MultiPositionProblem, options: ImuOptions
) -> tuple[MultiPositionFit, HeldOut, dict[str, HeldOut]]:
    """Fit with g-sensitivity, and keep it unless rotations that were left out are predicted better without."""
    if options.model == "basic":
        fit = fit_multiposition(problem.data, g_sensitivity=False)
        heldout = leave_one_out(problem.data, fit)
        return fit, heldout, {"basic": heldout}
    fit = fit_multiposition(problem.data, g_sensitivity=True)
    rivals = {
        "basic": leave_one_out(problem.data, fit, g_sensitivity=False),
        "g-sensitivity": leave_one_out(problem.data, fit),
    }
    errors = {name: float(np.sum(trial.rotation[fit.rotation_used] ** 2)) for name, trial in rivals.items()}
    if options.model == "auto" and errors["basic"] < errors["g-sensitivity"]:
        fit = fit_multiposition(problem.data, g_sensitivity=False)
        rivals["basic"] = leave_one_out(problem.data, fit)
        return fit, rivals["basic"], rivals
    return fit, rivals["g-sensitivity"], rivals
