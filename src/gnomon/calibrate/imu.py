"""An IMU from a hand-held multi-position recording (Tedaldi 2014), the gnomon way.

prepare -> static intervals -> problem -> fit -> choose the model -> hold out -> assess -> Result
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from ..assess.changes import with_changes
from ..assess.imu.imu_tables import ImuFitSummary, describe_imu
from ..assess.imu.imu_verdict import assess_imu
from ..assess.imu.recording_changes import axes_changed_findings
from ..assess.observability import known_of, weak_directions
from ..assess.priors import Prior, Priors, gather_prior, prior_findings, refuse_own_data
from ..assess.verdict import comparison_left_out
from ..detect.samples.rests import FEWEST_INTERVALS, RestDetection, ThresholdTrial
from ..detect.samples.static_intervals import accelerometer_course, disturbed_intervals
from ..errors import DetectionError, SolveError
from ..estimate.multiposition.bias_changes import BiasChanges
from ..estimate.multiposition.evidence import free_jacobian, segment_sums, unseen_changes, with_runs
from ..estimate.multiposition.fit import MultiPositionFit, fit_multiposition
from ..estimate.multiposition.problem import (
    ImuEstimate,
    MultiPositionProblem,
    TriadStream,
    build_problem,
    gyroscope_intervals,
    sensor_scalars,
    to_physical_units,
)
from ..estimate.multiposition.triad_changes import change_by_one_cause
from ..estimate.trust.changes import estimates_are_judged, look_or_postpone
from ..estimate.trust.parts import RobustCovariance, robust_covariance
from ..findings import Finding
from ..frozen import value_class
from ..kernel import one_blas_thread
from ..models.gravity import EARTH_RATE_RAD_S
from ..options import ImuOptions
from ..progress import Progress
from ..recording import Floats, Recording
from ..recording.thermometer import temperature_course
from ..results.calibration import Calibration, Covariance, Gravity, Provenance, covariance_names
from ..results.result import Booleans, Result, interval_means
from ..units import GYROSCOPE_UNITS_RAD_S
from .steps.imu_model import choose_model, is_evidence_stated, refuse_evidence, with_fixed
from .steps.preparation import (
    LEFT_TO_RESTS,
    PreparedImu,
    check_arguments,
    imu_calibration,
    local_gravity,
    prepare_imu,
    recording_gaps,
    stated_options,
    weighted_stream,
)
from .steps.stated_frame import in_stated_frame
from .steps.temperature_while_turned import BiasPolynomials, bias_polynomials, temperature_powers

_LAGS = 3
"""How often the lag of the thermometer is found again."""
_BIASES = ("imu0.accelerometer.bias", "imu0.gyroscope.bias")


def calibrate_imu(
    recording: Recording | Sequence[Recording],
    options: ImuOptions | None = None,
    progress: Progress | None = None,
    prior: Priors = None,
) -> Result:
    """Calibrate an IMU from a recording in which it was turned by hand and held still, some forty times.

    Several recordings of one sensor are calibrated one by one and joined: the parameters are means, and the covariance
    is that of the sensor on another occasion, the scatter between the recordings included.

    Parameters
    ----------
    recording : of one IMU, or several of the same
    options : see ImuOptions
    progress : called with a sentence at each step
    prior : other calibrations of the same sensor, which count as evidence; see `gnomon.assess.priors`

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
    if isinstance(recording, str) or not isinstance(recording, Sequence):
        check_arguments("calibrate_imu", recording)
    if not isinstance(recording, Recording):
        check_arguments("calibrate_imu", *recording)
        if len(recording) != 1:
            from .several_recordings import calibrate_several

            return calibrate_several(recording, options, tell, prior, calibrate_imu)
        (recording,) = recording
    if prior:
        refuse_own_data(prior, recording.sources)
    with one_blas_thread():
        return _calibrated(recording, options, progress, prior)


def _calibrated(recording: Recording, options: ImuOptions, progress: Progress | None, prior: Priors) -> Result:
    tell = progress or (lambda _: None)
    if _is_of_rests_alone(recording, options):
        return _by_rests(recording, options, progress, prior)
    tell("checking the recording")
    tolerated = LEFT_TO_RESTS if options.preset == "gnomon" else frozenset[str]()
    prepared = prepare_imu(recording, options, tolerated=tolerated)
    if tolerated and _is_left_to_rests(prepared):
        return _by_rests(recording, options, progress, prior, prepared)
    if options.preset != "gnomon":
        from .published.tedaldi import calibrate_as_published

        refuse_evidence(options, prior)
        return calibrate_as_published(recording, prepared, options, tell)
    gravity = local_gravity(options)
    tell("finding static intervals")
    detection = _static_intervals(prepared, options)
    readings = _readings(prepared, detection.chosen, options)
    if np.sum(readings.problem.data.linked) < _FEWEST_ROTATIONS:
        return _by_rests(recording, options, progress, prior, prepared)
    known = None
    if is_evidence_stated(options, prior):
        known = gather_prior(prior, options, prepared.units, free=options.free, gravity=gravity)
    tell(f"fitting {len(readings.problem.data.accelerometer)} static intervals and the rotations between them")
    fit = _fit(recording, prepared, detection, readings, known=known, gravity=gravity, options=options)
    for _ in range(_LAGS):  # with a lag that is not undone, a curve in the temperature is none in what is read
        if fit.temperature is None or fit.temperature.lag_s == readings.lag_s:
            break
        readings = _readings(prepared, detection.chosen, options, lag_s=fit.temperature.lag_s)
        fit = _fit(recording, prepared, detection, readings, known=known, gravity=gravity, options=options)
    tell("assessing the result")
    prepared = replace(prepared, findings=(*prepared.findings, *readings.noticed))
    return _assess(recording, prepared, fit, known=known, gravity=gravity, options=options)


def _by_rests(
    recording: Recording,
    options: ImuOptions,
    progress: Progress | None,
    prior: Priors,
    prepared: PreparedImu | None = None,
) -> Result:
    from .poses import calibrate_poses  # loaded where a recording asks for it

    return calibrate_poses(recording, options, progress, prior, prepared)


@value_class
class _Readings:
    """What is fitted: static intervals of both triads, and the rotations between them.

    Attributes
    ----------
    problem, streams : see `build_problem`
    touched : which of the intervals found were disturbed, and are left out
    course : of the accelerometer's bias over the time, see `accelerometer_course`
    reference_degc : mean temperature at rest [degC]; None where it did not both rise and fall
    lag_s : of the thermometer, which is undone in the temperature [s]
    noticed : what all intervals, also those that were disturbed, show of axes that changed
    """

    problem: MultiPositionProblem
    streams: tuple[TriadStream, TriadStream]
    touched: Booleans
    course: BiasChanges
    reference_degc: float | None
    lag_s: float
    noticed: list[Finding]


def _readings(prepared: PreparedImu, chosen: ThresholdTrial, options: ImuOptions, *, lag_s: float = 0.0) -> _Readings:
    at_rest = weighted_stream(
        prepared.accelerometer,
        prepared.accelerometer_time.t_s,
        prepared.accelerometer_saturated,
        chosen.intervals,
    )
    reference = None
    if prepared.temperature is not None and (course := temperature_course(prepared.temperature, lag_s)) is not None:
        degc = course.with_rate(prepared.accelerometer.t_ns)
        resting = interval_means(degc, chosen.intervals)[:, 0]
        reference = float(resting.mean())
        at_rest = replace(at_rest, degc=temperature_powers(degc, resting, course.step_k))
    changes, functions = accelerometer_course(at_rest)
    touched = disturbed_intervals(chosen, prepared.accelerometer, functions, at_rest.density)
    problem, streams = _problem(prepared, at_rest, touched, options)
    whole = _problem(prepared, at_rest, np.zeros_like(touched), options)[0] if touched.any() else problem
    return _Readings(
        problem=problem,
        streams=streams,
        touched=touched,
        course=changes,
        reference_degc=reference,
        lag_s=lag_s,
        noticed=look_or_postpone(lambda: axes_changed_findings(whole)),
    )


def _fit(
    recording: Recording,
    prepared: PreparedImu,
    detection: RestDetection,
    readings: _Readings,
    *,
    known: Prior | None,
    gravity: Gravity,
    options: ImuOptions,
) -> ImuFitSummary:
    """Choose the model, and return its estimate with the covariance from clusters of static intervals."""
    problem = readings.problem
    model = choose_model(
        problem,
        options,
        known,
        units=prepared.units,
        gravity_m_s2=gravity.value,
        walk=_known_walk(recording, problem),
        course=None if readings.touched.any() else readings.course,
    )
    estimate = _in_units(model.fit, problem, gravity, options)
    slopes = None
    if readings.reference_degc is not None:
        slopes = bias_polynomials(model.fit, problem, readings.reference_degc, readings.lag_s)
    imu = imu_calibration(estimate, prepared.units)
    names = covariance_names({"imu0": imu if slopes is None else replace(imu, temperature=slopes.found)})
    trust, unseen_sigma = _trusted(model.fit, problem, estimate, names, slopes, gravity=gravity, options=options)
    weak = weak_directions(known_of({"imu0": imu}, {}, estimate.covariance))
    return ImuFitSummary(
        accelerometer=readings.streams[0],
        gyroscope=readings.streams[1],
        accelerometer_unit=prepared.accelerometer.unit,
        gyroscope_unit=prepared.gyroscope.unit,
        statistic=np.where(detection.motion.marks.turns, np.inf, detection.motion.statistic),
        chosen=detection.chosen,
        trials=detection.trials,
        touched=readings.touched,
        course=readings.course,
        problem=problem,
        fit=model.fit,
        heldout=model.heldout,
        rivals=model.rivals,
        estimate=with_fixed(replace(estimate, covariance=trust.covariance), known),
        trust=replace(trust.trust, models=model.steps, weak=weak),
        instabilities=trust.instabilities,
        unseen_sigma=unseen_sigma,
        gravity_m_s2=gravity.value,
        temperature=None if slopes is None else slopes.found,
    )


def _assess(
    recording: Recording,
    prepared: PreparedImu,
    fit: ImuFitSummary,
    *,
    known: Prior | None,
    gravity: Gravity,
    options: ImuOptions,
) -> Result:
    """Return the calibration with its verdict, and the tables that show how it came about."""
    diagnostics = describe_imu(fit)
    imus = {"imu0": replace(imu_calibration(fit.estimate, prepared.units), temperature=fit.temperature)}
    findings = (*prepared.findings, *_agreement(fit, known, gravity, options))
    calibration = Calibration(
        imus=imus,
        frame="accel-x",
        gravity=gravity,
        uncertainty=Covariance(names=covariance_names(imus), matrix=fit.estimate.covariance),
        assessment=assess_imu(findings, fit, diagnostics, gravity),
        provenance=Provenance(method="imu", inputs=recording.sources, options=stated_options(options, [recording])),
    )
    if fit.trust.changes:
        calibration = with_changes(calibration, fit.trust)
    if options.frame != calibration.frame:
        rests = diagnostics.intervals
        calibration = in_stated_frame(calibration, options.frame, rests.accelerometer, rests.sigma)
    return Result(calibration=calibration, diagnostics=diagnostics)


def _static_intervals(prepared: PreparedImu, options: ImuOptions) -> RestDetection:
    """Return the static intervals (Eq. 3.9) that were found, where they are enough for a calibration."""
    samples, detection = prepared.accelerometer, prepared.rests
    if detection is None:
        raise DetectionError(
            f"the recording of {samples.duration_s:.1f} s is too short for windows of {options.window_s:g} s. "
            "Record at least nine attitudes of 2 to 4 s each."
        )
    if detection.chosen.fit is None:
        most = max(len(trial.intervals) for trial in detection.trials)
        raise DetectionError(
            f"the {most} static intervals found do not determine the accelerometer: their attitudes are too much "
            "alike. Hold the sensor still with every axis up once and down once, and in some directions between."
        )
    return detection


def _problem(
    prepared: PreparedImu, accelerometer: TriadStream, touched: Booleans, options: ImuOptions
) -> tuple[MultiPositionProblem, tuple[TriadStream, TriadStream]]:
    """Gather what the undisturbed intervals and the rotations between them measured."""
    t_s, still = accelerometer.t_s, accelerometer.intervals.where(~touched)
    if touched.any():
        degc = accelerometer.degc
        accelerometer = weighted_stream(prepared.accelerometer, t_s, accelerometer.saturated, still)
        accelerometer = replace(accelerometer, degc=degc)
    rates, t_gyro = prepared.gyroscope, prepared.gyroscope_time.t_s
    at_rest = gyroscope_intervals(t_gyro, t_s[still.start], t_s[still.stop - 1])
    if len(at_rest) == 0 or np.any(at_rest.stop - at_rest.start < 2):
        raise DetectionError(
            "the gyroscope has no samples in some static intervals of the accelerometer. "
            "Both must be recorded together and stamped by one clock."
        )
    gyroscope = weighted_stream(rates, t_gyro, prepared.gyroscope_saturated, at_rest)
    if accelerometer.degc is not None:
        near = np.clip(np.searchsorted(t_s, t_gyro), 0, len(t_s) - 1)
        gyroscope = replace(gyroscope, degc=accelerometer.degc[near])
    # The earth's horizontal rate, of unknown heading, spread over the two level axes; 2/3 is the mean over the sphere.
    cosine_squared = 2 / 3 if options.latitude is None else float(np.cos(np.radians(options.latitude)) ** 2)
    unmodelled = EARTH_RATE_RAD_S**2 * cosine_squared / 2
    return build_problem(accelerometer, gyroscope, unmodelled), (accelerometer, gyroscope)


def _in_units(
    fit: MultiPositionFit, problem: MultiPositionProblem, gravity: Gravity, options: ImuOptions
) -> ImuEstimate:
    return to_physical_units(
        fit,
        problem.accelerometer,
        problem.gyroscope,
        gravity_m_s2=gravity.value,
        gravity_sigma_m_s2=gravity.sigma,
        latitude_deg=options.latitude,
    )


def _trusted(
    fit: MultiPositionFit,
    problem: MultiPositionProblem,
    estimate: ImuEstimate,
    names: tuple[str, ...],
    slopes: BiasPolynomials | None,
    *,
    gravity: Gravity,
    options: ImuOptions,
) -> tuple[RobustCovariance, Floats]:
    """Return the covariance from clusters of static intervals, and how parts of the recording agree.

    Also the sigma (33,) that changes of a bias which cannot be excluded add.
    """
    _, jacobian = sensor_scalars(
        fit.state, problem.accelerometer, problem.gyroscope, gravity_m_s2=gravity.value, latitude_deg=options.latitude
    )
    from_unseen = jacobian @ unseen_changes(fit) @ jacobian.T
    ordinary, jacobian = estimate.covariance + from_unseen, free_jacobian(fit, jacobian)
    if slopes is not None:
        jacobian = np.concatenate([jacobian, slopes.jacobian[:, fit.free]])
        both = jacobian @ fit.arrow.corner_covariance @ jacobian.T
        both[: len(ordinary), : len(ordinary)] = ordinary
        ordinary = both
    kept = with_runs(fit)
    sensitivities = estimate.accelerometer_sensitivity, estimate.gyroscope_sensitivity
    trust = robust_covariance(
        segment_sums(fit),
        jacobian,
        names,
        ordinary,
        biases=_BIASES,
        widened=options.covariance == "robust",
        single=None if np.array_equal(kept, fit.rotation_used) else segment_sums(fit, kept),
        by_cause=partial(change_by_one_cause, fit, sensitivities),
    )
    return trust, np.sqrt(np.diag(from_unseen))


def _agreement(fit: ImuFitSummary, known: Prior | None, gravity: Gravity, options: ImuOptions) -> list[Finding]:
    """Say what was known beforehand, and whether this recording on its own agrees."""
    if not known or not estimates_are_judged():
        return []
    try:
        without = fit_multiposition(fit.problem.data, g_sensitivity=True, changes=fit.fit.changes)
        alone = _in_units(without, fit.problem, gravity, options)
    except SolveError as error:
        return [comparison_left_out("what was known beforehand", str(error))]
    return prior_findings(known, alone.values, alone.covariance)


def _known_walk(recording: Recording, problem: MultiPositionProblem) -> Floats | None:
    """Return the random walk of the gyroscope's bias (3,) in scaled units, where it was stated; None for counts."""
    samples = next(iter(recording.imus.values()))
    factor = GYROSCOPE_UNITS_RAD_S[samples.gyroscope.unit]
    if samples.noise is None or factor is None:
        return None
    return (samples.noise.gyroscope_random_walk / factor / problem.gyroscope.spread) ** 2


_FEWEST_ROTATIONS = 3
"""With fewer rotations that the gyroscope measured whole, it is judged by its rests."""


def _is_of_rests_alone(recording: Recording, options: ImuOptions) -> bool:
    """Tell whether a recording is calibrated from its rests alone: its content or an option says so."""
    if recording.poses is not None or recording.pieces or options.preset == "angrisano" or options.model == "static":
        return True
    return bool(recording.imus) and not len(next(iter(recording.imus.values())).gyroscope)


def _is_left_to_rests(prepared: PreparedImu) -> bool:
    """Tell whether a recording is a static experiment: few rests, or the time between them was cut out.

    Raises
    ------
    DetectionError
        If the gyroscope shows only noise although the rotations were recorded.
    """
    problems = {f.code: f for f in prepared.findings if f.severity == "problem" and f.code in LEFT_TO_RESTS}
    silent = problems.get("gyroscope-silent")
    if silent is not None:
        from ..estimate.triads.gyroscope_at_rests import FEWEST_POSES

        if np.sum(recording_gaps(prepared.accelerometer)) < FEWEST_POSES - 1:
            raise DetectionError(str(silent))
    rests = prepared.rests
    return bool(problems) or (
        rests is not None and max(len(trial.intervals) for trial in rests.trials) <= FEWEST_INTERVALS
    )
