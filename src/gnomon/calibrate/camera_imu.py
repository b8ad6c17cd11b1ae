"""Cameras and an IMU that were waved together in front of a board (document B).

prepare -> find the board's poses -> align clocks and axes -> first trajectory -> batch estimation -> assess -> Result
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from threadpoolctl import threadpool_limits

from .._version import __version__
from ..assess.added_findings import added_findings
from ..assess.camera_imu_tables import CameraImuEvidence, describe
from ..assess.camera_imu_verdict import assess
from ..assess.likely_missing import likely_missing
from ..assess.prior_findings import prior_used
from ..assess.trust_findings import incomplete, model_incomplete, parts_disagree, trust_note
from ..assess.weak_findings import camera_imu_weak
from ..calibration import Calibration, Covariance, Gravity, Provenance, covariance_names
from ..diagnostics import Result
from ..estimate.camera_imu.batch import Measurements, State
from ..estimate.camera_imu.choices import choices, lens_prior
from ..estimate.camera_imu.first_guess import Look, first_parameters, first_state, imu_stream, looks, per_corner
from ..estimate.camera_imu.inertial_terms import triads
from ..estimate.camera_imu.initial_trajectory import MARGIN_S
from ..estimate.camera_imu.knots import knots_per_s
from ..estimate.camera_imu.parameters import ImuParameters, Parameters, layout
from ..estimate.camera_imu.publish import published
from ..estimate.camera_imu.recording_trust import recording_trust
from ..estimate.camera_imu.solution import GATE, Solution, solved
from ..estimate.camera_imu.uncertainty import uncertainty
from ..estimate.camera_imu.visual_terms import VisualData
from ..evidence import Priors
from ..models.target import Target
from ..options import CameraImuOptions
from ..recording import KnownRig, Recording
from .board_order import numbered_alike
from .camera_imu_model import chosen_model, considered
from .camera_imu_preparation import PreparedCameraImu, prepare_camera_imu, with_looks
from .camera_imu_prior import cameras_moved, evidence_of_imu, known_imu
from .camera_imu_shutter import LINE_DELAY, shutters_estimated, with_line_delays
from .preparation import local_gravity, stated_options

Progress = Callable[[str], None]

_HUBER = 2.5
_RESTARTS = 3


def calibrate_camera_imu(
    recording: Recording,
    target: Target,
    options: CameraImuOptions | None = None,
    progress: Progress | None = None,
    prior: Priors = None,
) -> Result:
    """Calibrate cameras and an IMU from a recording in which they were waved together in front of a board.

    Parameters
    ----------
    recording : of one IMU and one or more cameras that saw the board
    target : the board
    options : see CameraImuOptions
    progress : called with a sentence at each step
    prior : other calibrations of the same IMU, which count as evidence; see `gnomon.evidence`

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
    options = options or CameraImuOptions()
    tell = progress or (lambda _: None)
    with threadpool_limits(1, user_api="blas"):  # many small products: more threads only get in each other's way
        return _calibrated(recording, target, options, tell, prior)


def _calibrated(
    recording: Recording, target: Target, options: CameraImuOptions, tell: Progress, prior: Priors
) -> Result:
    tell("checking the recording")
    prepared = prepare_camera_imu(recording, target, options)
    gravity = local_gravity(options)
    known = evidence_of_imu(prior, gravity)
    tell("finding the board's poses, the time shift and the camera's axes")
    stream = imu_stream(prepared.inertial)
    cameras, ends = numbered_alike(recording.cameras, target, prepared.origin_ns, stream)
    recording = replace(recording, cameras=cameras)
    prepared = replace(prepared, findings=(*prepared.findings, *prior_used(known), *ends))
    found = looks(recording.cameras, target, prepared.origin_ns, stream)
    prepared = with_looks(prepared, found, target, stream, imu=next(iter(recording.imus)))
    stated = options
    options, rolling = with_line_delays(options, found, prepared.findings)
    tell("estimating")
    chosen = chosen_model(
        _estimated(prepared, found, gravity, options, tell, known=known_imu(known), rig=recording.rig), options, tell
    )
    solution, start = chosen.solution, chosen.solution.layout.start
    certain = uncertainty(solution, considered(start), chosen.sums if options.covariance == "robust" else None)
    basic = _basic(start, solution, options, tell) if options.compare and options.model != "basic" else None
    tell("assessing the result")
    result = published(certain, solution.state.parameters, gravity_sigma=gravity.sigma)
    evidence = CameraImuEvidence(
        recording=recording,
        target=target,
        prepared_rates_hz=prepared.rates_hz,
        origin_ns=prepared.origin_ns,
        nominal=prepared.nominal,
        noise_stated=prepared.stated,
        options=options,
        looks=found,
        start=start,
        solution=solution,
        uncertainty=certain,
        basic=basic,
        gravity=gravity,
        published=result,
    )
    described = describe(evidence)
    weak = camera_imu_weak(result, certain, described.parameters, solution.state.trajectory.grid.duration_s)
    trust = replace(recording_trust(result, certain), weak=weak, models=chosen.steps)
    diagnostics = replace(described, trust=trust)
    likely = likely_missing(solution, described.signals) if incomplete(trust) else []
    took_up = added_findings(chosen.added, start, solution.state.parameters)
    doubts = (
        *cameras_moved(solution, certain),
        *took_up,
        *model_incomplete(trust, likely),
        *parts_disagree(trust.splits),
    )
    uncertain = Covariance(names=covariance_names(result.imus, result.cameras), matrix=result.covariance)
    noticed = shutters_estimated(prepared.findings, result.cameras, uncertain)
    assessment = assess((*noticed, *doubts), evidence, diagnostics)
    added, tries = (*chosen.added, *((LINE_DELAY,) if rolling else ())), chosen.tries + rolling
    calibration = Calibration(
        imus=result.imus,
        cameras=result.cameras,
        frame="accel-x",
        gravity=gravity,
        uncertainty=uncertain,
        assessment=replace(assessment, trust=replace(trust_note(trust), added=added, tries=tries)),
        provenance=Provenance(
            gnomon_version=__version__,
            method="camera-imu",
            inputs=recording.sources,
            options=stated_options(replace(stated, compare=False)),  # what is drawn changes no number
        ),
    )
    return Result(calibration=calibration, diagnostics=diagnostics)


def _estimated(
    prepared: PreparedCameraImu,
    found: tuple[Look, ...],
    gravity: Gravity,
    options: CameraImuOptions,
    tell: Progress,
    *,
    known: ImuParameters | None,
    rig: KnownRig | None,
) -> Solution:
    """Return the solution with the options' model; begin anew where a time shift would leave the trajectory's span."""
    stream = imu_stream(prepared.inertial)
    parameters = _with_line_delay(first_parameters(found, gravity.value, options), options)
    parameters = replace(parameters, rig=rig)
    if known is not None:
        parameters = replace(parameters, imus=(replace(known, origin=parameters.imus[0].origin),))
    pixel_sigma = tuple(options.pixel_sigma or look.poses.sigma_px for look in found)
    noise = prepared.first_noise(pixel_sigma, _HUBER if options.robust else np.inf)
    knots = options.knots_per_s or knots_per_s(*triads(prepared.inertial))
    solution: Solution | None = None
    start = parameters
    for _ in range(_RESTARTS):
        state = first_state(found, parameters, stream, knots, options.spline_order)
        if solution is None:
            start = state.parameters
        chosen = choices(state.parameters, options)
        origin = _with_gravity(start, state.parameters)
        solution = solved(
            _measurements(prepared, found, parameters, options),
            state,
            layout(origin, chosen.status, chosen.prior_sigma),
            layout(origin, chosen.status, lens_prior(origin) | chosen.prior_sigma, considered(origin)),
            noise,
            estimate_noise=options.noise != "nominal",
            estimate_walks=options.noise == "coloured",
            gate=options.robust,
            max_iterations=options.max_iterations,
            tell=tell,
        )
        moved = solution.state.parameters
        shifts = [
            abs(new.time_shift_s - old.time_shift_s)
            for new, old in zip(moved.cameras, state.parameters.cameras, strict=True)
        ]
        if max(shifts) < MARGIN_S / 2 or not solution.converged:
            break
        parameters = moved
    assert solution is not None
    return solution


def _with_gravity(start: Parameters, state: Parameters) -> Parameters:
    """Return start values with gravity's direction as the trajectory has it."""
    return replace(start, gravity_axes=state.gravity_axes)


def _with_line_delay(parameters: Parameters, options: CameraImuOptions) -> Parameters:
    if options.line_delay is None:
        return parameters
    cameras = tuple(
        replace(entry, camera=replace(entry.camera, line_delay_s=options.line_delay)) for entry in parameters.cameras
    )
    return replace(parameters, cameras=cameras)


def _measurements(
    prepared: PreparedCameraImu, found: tuple[Look, ...], parameters: Parameters, options: CameraImuOptions
) -> Measurements:
    visual: list[VisualData] = []
    used: list[np.ndarray] = []
    status = choices(parameters, options).status
    for i, look in enumerate(found):
        exposures = look.poses.exposures
        consistent = look.alignment.consistent & (
            look.poses.scatter_px**2 < GATE * np.median(look.poses.scatter_px) ** 2
        )
        if parameters.cameras[i].camera.line_delay_s or status[f"{look.name}.line_delay"] != "fixed":
            which = exposures.of_corner
            exposures, consistent = per_corner(exposures), consistent[which]
            visual.append(VisualData(camera=i, exposures=exposures, t_s=look.poses.t_s[which]))
        else:
            visual.append(VisualData(camera=i, exposures=exposures, t_s=look.poses.t_s))
        used.append(consistent if options.robust else np.ones(len(exposures), dtype=bool))
    return Measurements(inertial=prepared.inertial, visual=tuple(visual), used=tuple(used))


def _basic(start: Parameters, solution: Solution, options: CameraImuOptions, tell: Progress) -> Solution:
    """Return the basic model's solution on the same measurements (Figs. 5.6 and 5.7 of document B)."""
    tell("estimating the basic model for comparison")
    chosen = choices(start, replace(options, fix=(), free=(), prior=()), model="basic")
    ideal = replace(solution.state.parameters, imus=(ImuParameters.ideal(),) * len(start.imus))
    columns = layout(solution.layout.start, chosen.status, chosen.prior_sigma)
    return solved(
        solution.measurements,
        State(trajectory=solution.state.trajectory, parameters=ideal),
        columns,
        columns,
        solution.noise,
        estimate_noise=False,
        gate=False,
        max_iterations=options.max_iterations,
    )
