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
from ..assess.observability import known_of, weak_directions
from ..assess.priors import SCALARS, Prior, Priors, gather_prior, prior_findings, refuse_own_data
from ..assess.verdict import comparison_left_out
from ..detect.samples.rests import FEWEST_INTERVALS, RestDetection
from ..errors import DetectionError, SolveError
from ..estimate.multiposition.bias_changes import BiasChanges
from ..estimate.multiposition.evidence import (
    LeaveOneOutErrors,
    as_table,
    free_jacobian,
    imu_models,
    leave_one_out,
    segment_sums,
    unseen_changes,
    with_runs,
)
from ..estimate.multiposition.fit import Knowledge, MultiPositionFit, fit_multiposition
from ..estimate.multiposition.model import MultiPositionState
from ..estimate.multiposition.problem import (
    ImuEstimate,
    MultiPositionProblem,
    blocks_of_scalars,
    sensor_scalars,
    to_physical_units,
)
from ..estimate.multiposition.triad_changes import change_by_one_cause
from ..estimate.trust.changes import estimates_are_judged
from ..estimate.trust.clusters import correlation_time, group_into_clusters, leave_clusters_out
from ..estimate.trust.parts import RobustCovariance, robust_covariance
from ..findings import Finding
from ..frozen import value_class
from ..kernel import one_blas_thread
from ..options import ImuOptions
from ..progress import Progress
from ..recording import Floats, Recording
from ..results.calibration import Calibration, Covariance, Gravity, Provenance, covariance_names
from ..results.result import Result
from ..results.trust import ModelStep
from ..units import ACCELEROMETER_UNITS_M_S2, GYROSCOPE_UNITS_RAD_S
from .steps.preparation import (
    LEFT_TO_RESTS,
    ImuReadings,
    PreparedImu,
    check_arguments,
    found_intervals,
    gather_readings,
    imu_calibration,
    is_evidence_stated,
    local_gravity,
    prepare_imu,
    recording_gaps,
    refuse_evidence,
    stated_options,
)
from .steps.stated_frame import in_stated_frame
from .steps.temperature_while_turned import BiasPolynomials, bias_polynomials

_LAGS = 3
"""How often the lag of the thermometer is found again."""
_BIASES = ("imu0.accelerometer.bias", "imu0.gyroscope.bias")

_FEWEST_ROTATIONS = 3
"""With fewer rotations that the gyroscope measured whole, it is judged by its rests."""

_OF_IMU = slice(0, 33)
_FIXED_SIGMA = 1e-7  # of what the scaled parameters move a scalar by: as good as nothing

_G = slice(24, 33)  # g-sensitivity among what may be known
_G_PATH = "imu0.gyroscope.g_sensitivity"


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
    detection = found_intervals(prepared, options)
    readings = gather_readings(prepared, detection.chosen, options)
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
        readings = gather_readings(prepared, detection.chosen, options, lag_s=fit.temperature.lag_s)
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
    from .poses import calibrate_poses

    return calibrate_poses(recording, options, progress, prior, prepared)


def _fit(
    recording: Recording,
    prepared: PreparedImu,
    detection: RestDetection,
    readings: ImuReadings,
    *,
    known: Prior | None,
    gravity: Gravity,
    options: ImuOptions,
) -> ImuFitSummary:
    """Choose the model, and return its estimate with the covariance from clusters of static intervals."""
    problem = readings.problem
    model = _choose_model(
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
        estimate=_with_fixed(replace(estimate, covariance=trust.covariance), known),
        trust=replace(trust.trust, models=model.steps, weak=weak),
        instabilities=trust.instabilities,
        unseen_sigma=unseen_sigma,
        gravity_m_s2=gravity.value,
        temperature=None if slopes is None else slopes.found,
    )


@value_class
class _ChosenModel:
    """The model taken, its fit, and what speaks for it.

    Attributes
    ----------
    fit, heldout : with the model taken
    rivals : model -> errors of intervals and rotations that were left out
    steps : what each step of the model brings
    """

    fit: MultiPositionFit
    heldout: LeaveOneOutErrors
    rivals: dict[str, LeaveOneOutErrors]
    steps: tuple[ModelStep, ...]


def _choose_model(
    problem: MultiPositionProblem,
    options: ImuOptions,
    known: Prior | None,
    *,
    units: dict[str, str],
    gravity_m_s2: float,
    walk: Floats | None,
    course: BiasChanges | None,
) -> _ChosenModel:
    """Fit with g-sensitivity, and keep it where clusters of time that were left out prove it or somebody says so.

    `course` is how the accelerometer's bias changed, where that is known already.
    """
    beforehand = _scaled_prior(known, problem, gravity_m_s2=gravity_m_s2, latitude_deg=options.latitude)

    def fitted(*, g_sensitivity: bool, before: MultiPositionFit | None = None) -> MultiPositionFit:
        changes = (None, course) if before is None else before.changes
        return fit_multiposition(
            problem.data, g_sensitivity=g_sensitivity, known=beforehand, walk=walk, changes=changes
        )

    if known and known.fixed[_G].all() and not known.value[_G].any():
        fit = fitted(g_sensitivity=False)
        heldout = leave_one_out(fit)
        return _ChosenModel(fit=fit, heldout=heldout, rivals={"basic": heldout}, steps=())
    stated = {"basic": False, "g-sensitivity": True}.get(options.model)
    if (known and known.knows(_G_PATH)) or _G_PATH in options.free:
        stated = stated is not False
    fit = fitted(g_sensitivity=True)
    judged = stated is None or estimates_are_judged()
    steps = _steps(problem, fit, units, gravity_m_s2, stated) if judged else ()
    taken = "g-sensitivity" if stated or any(step.used for step in steps if step.name == "g-sensitivity") else "basic"
    largest = leave_one_out(fit)
    if taken == "basic":
        fit = fitted(g_sensitivity=False, before=fit)
    rivals = {"g-sensitivity": largest}
    if judged or taken == "basic":
        rivals["basic"] = leave_one_out(fit, g_sensitivity=False)
    return _ChosenModel(fit=fit, heldout=rivals[taken], rivals=rivals, steps=steps)


def _steps(
    problem: MultiPositionProblem,
    fit: MultiPositionFit,
    units: dict[str, str],
    gravity_m_s2: float,
    stated: bool | None,
) -> tuple[ModelStep, ...]:
    """Return what each step of the model brings, by clusters of static intervals and rotations."""
    values, jacobian = sensor_scalars(
        fit.state, problem.accelerometer, problem.gyroscope, gravity_m_s2=gravity_m_s2, latitude_deg=None
    )
    jacobian = free_jacobian(fit, jacobian)
    sums = segment_sums(fit)
    moves = leave_clusters_out(sums) @ jacobian.T
    clusters = group_into_clusters(sums, correlation_time(moves, np.repeat(np.arange(5), [9, 3, 9, 3, 9])))[0][0]
    nominal, functions = _nominal(problem, units, gravity_m_s2), (fit.data.of_gyroscope, fit.data.of_accelerometer)
    steps = imu_models(clusters, fit.state, nominal, g_sensitivity=stated, functions=functions)
    return as_table(steps, jacobian, blocks_of_scalars(values), forced=stated is not None)


def _nominal(problem: MultiPositionProblem, units: dict[str, str], gravity_m_s2: float) -> Floats | None:
    """Return the scaled parameters (6,) of nominal scales; None where a triad counts."""
    force, rate = ACCELEROMETER_UNITS_M_S2[units["accelerometer"]], GYROSCOPE_UNITS_RAD_S[units["gyroscope"]]
    if force is None or rate is None:
        return None
    return np.append(gravity_m_s2 / force / problem.accelerometer.spread, rate * problem.gyroscope.spread)


def _scaled_prior(
    found: Prior | None, problem: MultiPositionProblem, *, gravity_m_s2: float, latitude_deg: float | None
) -> Knowledge | None:
    """Return the prior on the scaled parameters, or None where nothing is known."""
    if not found:
        return None

    def at(state: MultiPositionState) -> tuple[Floats, Floats]:
        """Return precision (30, 30) and information (30,) of theta at a state."""
        values, jacobian = sensor_scalars(
            state, problem.accelerometer, problem.gyroscope, gravity_m_s2=gravity_m_s2, latitude_deg=latitude_deg
        )
        precision, information = (part[_OF_IMU] for part in found.quadratic(np.append(values, np.zeros(SCALARS - 33))))
        precision = precision[:, _OF_IMU].copy()
        reach = np.linalg.norm(jacobian, axis=1)
        held = np.flatnonzero(found.fixed[_OF_IMU] & (reach > 0))
        tight = (_FIXED_SIGMA * reach[held]) ** -2
        precision[held, held] += tight
        information = information.copy()
        information[held] += tight * found.value[held]
        theta = state.theta[: jacobian.shape[1]]
        weighted = jacobian.T @ precision
        return weighted @ jacobian, jacobian.T @ information - weighted @ (values - jacobian @ theta)

    return at


def _with_fixed(estimate: ImuEstimate, found: Prior | None) -> ImuEstimate:
    """Return the estimate with what was held fixed exactly where it was held, and certain."""
    if found is None:
        return estimate
    held = np.flatnonzero(found.fixed[_OF_IMU])
    if not len(held):
        return estimate
    values, covariance = estimate.values, estimate.covariance.copy()
    values[held] = found.value[held]
    covariance[held] = covariance[:, held] = 0.0
    sensitivity, bias, gyro_sensitivity, gyro_bias, g_sensitivity = np.split(values, [9, 12, 21, 24])
    return ImuEstimate(
        accelerometer_sensitivity=sensitivity.reshape(3, 3),
        accelerometer_bias=bias,
        gyroscope_sensitivity=gyro_sensitivity.reshape(3, 3),
        gyroscope_bias=gyro_bias,
        g_sensitivity=g_sensitivity.reshape(3, 3),
        covariance=covariance,
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
