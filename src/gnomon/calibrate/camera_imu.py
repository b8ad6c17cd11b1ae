"""Cameras and an IMU that were waved together in front of a board (Krebs).

prepare -> find the board's poses -> align clocks and axes -> first trajectory -> batch estimation -> assess -> Result
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from threadpoolctl import threadpool_limits

from ..assess.cameras.camera_imu_tables import CameraImuFitSummary, describe_camera_imu
from ..assess.cameras.camera_imu_verdict import assess_camera_imu, camera_imu_weak
from ..assess.cameras.rig_findings import (
    added_findings,
    delays_found,
    judged_again,
    misfits_found,
    out_of_order,
    steps_left_out,
    unmodelled_effects,
)
from ..assess.changes import with_changes
from ..assess.checks.board_views import without_copies
from ..assess.imu.temperature import check_temperature
from ..assess.needs import with_precision
from ..assess.priors import Priors, prior_used, refuse_own_data
from ..assess.verdict import (
    model_incomplete,
    parts_disagree,
    time_shift_varies,
    uncertainty_summary,
    underestimated_blocks,
)
from ..errors import InitialisationError, SolveError
from ..estimate.camera_imu.choices import estimation_choices
from ..estimate.camera_imu.layout import Status
from ..estimate.camera_imu.result.misfits import with_misfits, with_next_term
from ..estimate.camera_imu.result.publish import moved_to_origins, publish_rig, recording_trust, single_place_origins
from ..estimate.camera_imu.result.uncertainty import Uncertainty, solution_uncertainty, with_detector_scale
from ..estimate.camera_imu.solution import Solution
from ..estimate.camera_imu.start.first_guess import align_cameras, imu_stream
from ..estimate.camera_imu.start.imu_alignment import align_imus
from ..estimate.trust.changes import grave_findings, postpone_search
from ..findings import Finding
from ..models.origin import EVEN_WEIGHTS
from ..models.target import Target
from ..options import CameraImuOptions
from ..progress import Progress, Step
from ..recording import Recording
from ..results.calibration import Calibration, Covariance, Provenance, covariance_names
from ..results.result import Result
from ..results.temperature_dependence import TemperatureDependence
from .steps.board_order import number_cameras_alike
from .steps.camera_imu_estimation import (
    BiasesOverTemperature,
    RigBeforehand,
    basic_model,
    biases_over_temperature,
    estimate_rig,
    without_slopes,
)
from .steps.camera_imu_model import (
    LINE_DELAY,
    SelectedModel,
    candidate_blocks,
    proven_lens,
    select_model,
    shutters_estimated,
    with_free_landmarks,
    with_line_delays,
    with_stated_shutters,
)
from .steps.camera_imu_preparation import (
    PreparedCameraImu,
    cameras_moved,
    evidence_of_imu,
    known_imu,
    likely_cause,
    prepare_camera_imu,
    refuse_clock_jumps,
    with_looks,
)
from .steps.preparation import check_arguments, local_gravity, stated_options


def calibrate_camera_imu(
    recording: Recording,
    target: Target,
    options: CameraImuOptions | None = None,
    progress: Progress | None = None,
    prior: Priors = None,
) -> Result:
    """Calibrate cameras and IMUs from a recording in which they were waved together in front of a board.

    Parameters
    ----------
    recording : of one or more IMUs and cameras that saw the board; the first IMU is the body, and with several the
        poses and the clocks of the others to it are estimated jointly
    target : the board
    options : see CameraImuOptions
    progress : called with a sentence at each step
    prior : other calibrations of the same IMUs, which count as evidence; see `gnomon.assess.priors`

    Raises
    ------
    RecordingError
        If the recording cannot be used; DetectionError where the board was seen too rarely.
    OptionError
        If an option does not fit the recording.
    InitialisationError
        If clocks or axes cannot be aligned.
    SolveError
        If the batch estimation finds no minimum.
    """
    check_arguments("calibrate_camera_imu", recording, target)
    options = options or CameraImuOptions()
    tell = progress or (lambda _: None)
    with threadpool_limits(1, user_api="blas"):  # many small products: more threads only get in each other's way
        return _calibrated(recording, target, options, tell, prior)


def _calibrated(  # noqa: PLR0917
    recording: Recording,
    target: Target,
    options: CameraImuOptions,
    tell: Progress,
    prior: Priors,
    told: TemperatureDependence | None = None,
) -> Result:
    """Calibrate; where biases follow the temperature, once more without what they do, which was told before."""
    tell("checking the recording")
    given, stated, options = recording, options, with_free_landmarks(options, target)
    if prior:
        refuse_own_data(prior, recording.sources)
    recording = with_stated_shutters(recording, options)
    recording, copied = without_copies(recording)
    prepared = prepare_camera_imu(recording, target, options)
    if told is not None:
        prepared = without_slopes(prepared, recording, told)
    gravity = local_gravity(options)
    known = [evidence_of_imu(prior, gravity, imu.name, first=not i) for i, imu in enumerate(prepared.imus)]
    used = [finding for one in known if one is not None for finding in prior_used(one)]
    warmth = [
        finding
        for name, imu in recording.imus.items()
        if imu.temperature is not None
        for finding in check_temperature(imu.temperature, f"{name} thermometer")
    ]
    prepared = replace(prepared, findings=(*prepared.findings, *copied, *used, *warmth))
    tell("finding the camera's poses, the time shift and its axes")
    rig = _align(recording, target, prepared)
    prepared = rig.prepared
    estimated, rolling = with_line_delays(options, rig.looks, prepared.findings)
    lens = proven_lens(options, prepared.findings)
    tell(Step("estimating", 0, 100))
    try:
        first = estimate_rig(rig, gravity, estimated, [known_imu(one) for one in known], tell, added=lens)
    except SolveError as error:
        raise SolveError(f"{error}{likely_cause(prepared.findings, prepared.move)}") from error
    detectors = {name: frames.detector_scale_sigma for name, frames in rig.recording.cameras.items()}
    chosen = select_model(first, estimated, tell, lens=lens, own_detector=not any(detectors.values()))
    del first  # its factor is large
    solution, certain = _with_uncertainty(chosen, estimated, detectors)
    slopes = biases_over_temperature(solution, certain, recording, prepared.origin_ns, told)
    if slopes is not None and set(slopes.blocks) != (set() if told is None else {part for part, _ in told.parts()}):
        tell("taking off what the biases do with the temperature")
        return _calibrated(given, target, stated, tell, prior, slopes.known)
    basic, uncompared = basic_model(chosen.solution.layout.start, solution, estimated, tell)
    tell("assessing the result")
    fit = CameraImuFitSummary(
        recording=rig.recording,
        target=target,
        imus=prepared.imus,
        options=estimated,
        looks=rig.looks,
        start=chosen.solution.layout.start,
        solution=solution,
        uncertainty=certain,
        basic=basic,
        gravity=gravity,
        published=publish_rig(certain, solution.state.parameters, gravity_sigma=gravity.sigma),
    )
    return _assess(fit, chosen, prepared, rolling=rolling, uncompared=uncompared, stated=stated, slopes=slopes)


def _align(recording: Recording, target: Target, prepared: PreparedCameraImu) -> RigBeforehand:
    """Return how cameras and IMUs lie to each other, in space and time, from the rotation that all of them felt."""
    streams = [imu_stream(prepared.inertial, i) for i in range(len(prepared.imus))]
    if target.kind in ("checkerboard", "circlegrid"):  # whose ends may look the same
        cameras, ends = number_cameras_alike(recording.cameras, target, prepared.origin_ns, streams[0])
        recording = replace(recording, cameras=cameras)
        prepared = replace(prepared, findings=(*prepared.findings, *ends))
    try:
        found = align_cameras(recording.cameras, target, prepared.origin_ns, streams[0])
        beside = ()
        if len(streams) > 1:
            beside = align_imus(found, streams, list(recording.imus.items()), prepared.epochs_s)
    except InitialisationError as error:
        refuse_clock_jumps(prepared, recording.cameras, target, streams)
        raise InitialisationError(f"{error}{likely_cause(prepared.findings)}") from error
    looked = partial(with_looks, prepared, found, target, streams, beside)
    if not postpone_search(lambda: grave_findings(looked().findings[len(prepared.findings) :])):
        prepared = looked()
    return RigBeforehand(recording=recording, prepared=prepared, looks=found, beside=beside, streams=tuple(streams))


def _with_uncertainty(
    chosen: SelectedModel, options: CameraImuOptions, detectors: Mapping[str, float]
) -> tuple[Solution, Uncertainty]:
    """Return the estimate at its origins, and its covariance: from clusters of time where that is asked for."""
    solution, start = chosen.solution, chosen.solution.layout.start
    sums = chosen.sums if options.covariance == "robust" else None
    certain = solution_uncertainty(solution, candidate_blocks(start), sums)
    certain = with_detector_scale(certain, solution.state.parameters, detectors)
    if sums is not None:
        certain = with_next_term(certain, solution)
    certain = with_misfits(certain, solution)
    return _with_origins(solution, certain, estimation_choices(start, options).status)


def _assess(
    fit: CameraImuFitSummary,
    chosen: SelectedModel,
    prepared: PreparedCameraImu,
    *,
    rolling: bool,
    uncompared: Sequence[Finding],
    stated: CameraImuOptions,
    slopes: BiasesOverTemperature | None,
) -> Result:
    """Return the calibration with its verdict, and the tables that show how it came about."""
    solution, certain, result = fit.solution, fit.uncertainty, fit.published
    described = describe_camera_imu(fit)
    weak = camera_imu_weak(result, certain, described.parameters, solution.state.trajectory.grid.duration_s)
    trust = replace(recording_trust(result, certain), weak=weak, models=chosen.steps)
    diagnostics = replace(described, trust=trust)
    likely = unmodelled_effects(solution, described.signals) if underestimated_blocks(trust) else []
    took_up = added_findings(
        chosen.added,
        fit.start,
        solution.state.parameters,
        board_told=chosen.board_told,
        arms_told=fit.options.model == "auto" and chosen.arms_told,
    )
    doubts = (
        *cameras_moved(solution, certain),
        *took_up,
        *steps_left_out(chosen.failed),
        *uncompared,
        *out_of_order(solution.layout, solution.state.parameters),
        *model_incomplete(trust, likely),
        *parts_disagree(trust.splits),
        *time_shift_varies(trust),
        *misfits_found(certain.misfits),
    )
    uncertain = Covariance(names=covariance_names(result.imus, result.cameras), matrix=result.covariance)
    shutters, state = shutters_estimated(prepared.findings, result.cameras, uncertain), solution.state.parameters
    noticed = judged_again(
        delays_found(shutters, state.imus, _delay_sigmas(certain), decided=fit.options.model == "auto"),
        prepared.move,
        diagnostics,
        converged=solution.converged,
    )
    assessment = assess_camera_imu((*noticed, *doubts), fit, diagnostics)
    added, tries = (*chosen.added, *((LINE_DELAY,) if rolling else ())), chosen.tries + rolling
    calibration = Calibration(
        imus=result.imus,
        cameras=result.cameras,
        frame="accel-x",
        gravity=fit.gravity,
        uncertainty=uncertain,
        assessment=replace(assessment, trust=replace(uncertainty_summary(trust), added=added, tries=tries)),
        provenance=Provenance(
            method="camera-imu",
            inputs=fit.recording.sources,
            options=stated_options(replace(stated, compare=False), [fit.recording]),  # what is drawn changes no number
        ),
    )
    calibration = with_precision(calibration)
    if trust.changes:
        calibration = with_changes(calibration, trust)
    return Result(calibration=slopes.added_to(calibration) if slopes else calibration, diagnostics=diagnostics)


def _with_origins(
    solution: Solution, certain: Uncertainty, status: Mapping[str, Status]
) -> tuple[Solution, Uncertainty]:
    """Return the estimate with the origin of each IMU at p*, unless another one, or a translation, was stated."""
    stated = any(kind != "estimated" for name, kind in status.items() if ".translation[" in name)
    wanted = [
        replace(imu.origin, weights=best.weights)
        if imu.origin.point != "optimal"
        else replace(imu.origin, weights=EVEN_WEIGHTS)
        if stated
        else best
        for imu, best in zip(solution.state.parameters.imus, single_place_origins(solution), strict=True)
    ]
    return moved_to_origins(solution, certain, wanted)


def _delay_sigmas(found: Uncertainty) -> dict[int, float]:
    """Return the standard deviations of the delays of accelerometers that were estimated, by the number of the IMU."""
    sigma = np.sqrt(np.diag(found.covariance))
    delays = {name: k for k, name in enumerate(found.names) if name.endswith(".accelerometer_shift")}
    return {int(name.partition(".")[0].removeprefix("imu")): float(sigma[k]) for name, k in delays.items()}
