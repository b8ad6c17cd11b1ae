"""From what was measured to the solution with the options' model."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ...assess.weak_findings import comparison_left_out
from ...errors import OptionError, SolveError
from ...estimate.camera_imu.batch import Measurements, RigState
from ...estimate.camera_imu.choices import estimation_choices, lens_tolerances
from ...estimate.camera_imu.knots import knots_per_s, with_tied_biases
from ...estimate.camera_imu.layout import Status, border_layout
from ...estimate.camera_imu.parameters import ImuParameters, RigParameters
from ...estimate.camera_imu.solution import GATE, Solution, minimise_cost
from ...estimate.camera_imu.start.accelerometer_delay import accelerometer_delay
from ...estimate.camera_imu.start.first_guess import (
    CameraAlignment,
    ImuStream,
    first_parameters,
    first_state,
    per_corner,
)
from ...estimate.camera_imu.start.first_place import first_place
from ...estimate.camera_imu.start.imu_alignment import ImuAlignment, first_imu, with_stated_pose
from ...estimate.camera_imu.start.initial_trajectory import MARGIN_S
from ...estimate.camera_imu.terms.inertial_data import on_trajectory, triad_readings
from ...estimate.camera_imu.terms.visual_terms import VisualData
from ...findings import Finding
from ...frozen import value_class
from ...options import CameraImuOptions
from ...progress import Progress
from ...recording import Recording
from ...results.calibration import Gravity
from .camera_imu_model import candidate_blocks, proven_board
from .camera_imu_preparation import PreparedCameraImu

_HUBER = 2.5
_RESTARTS = 3


@value_class
class RigBeforehand:
    """Cameras and IMUs, as far as they are known before the estimation.

    Attributes
    ----------
    recording, prepared : what was measured
    looks : what every camera saw
    beside : how the IMUs after the first lie to it
    streams : gyroscope and accelerometer of each IMU
    """

    recording: Recording
    prepared: PreparedCameraImu
    looks: tuple[CameraAlignment, ...]
    beside: tuple[ImuAlignment, ...]
    streams: tuple[ImuStream, ...]


def estimate_rig(
    rig: RigBeforehand,
    gravity: Gravity,
    options: CameraImuOptions,
    known: Sequence[ImuParameters | None],
    tell: Progress,
    *,
    added: Sequence[str] = (),
) -> Solution:
    """Return the solution with the options' model; begin anew where a time shift would leave the trajectory's span.

    Parameters
    ----------
    known : of each IMU, its errors as they are known beforehand, or None
    added : names of blocks beyond that model, such as "intrinsics"
    """
    prepared, found = rig.prepared, rig.looks
    parameters = _first_parameters(rig, gravity, options, known)
    pixel_sigma = tuple(options.pixel_sigma or look.poses.sigma_px for look in found)
    noise = prepared.first_noise(pixel_sigma, _HUBER if options.robust else np.inf)
    knots = options.knots_per_s or knots_per_s(*triad_readings(prepared.inertial), rate_hz=_supporting_hz(prepared))
    biases = [one.gyroscope_bias for one in rig.beside]
    solution: Solution | None = None
    start = parameters
    for _ in range(_RESTARTS):
        state = first_state(found, parameters, rig.streams[0], knots, order=options.spline_order, others=biases)
        if options.noise != "coloured" and not options.marginals:  # these ask for biases at every knot
            rates_hz = [imu.rates_hz for imu in prepared.imus]
            state = replace(state, trajectory=with_tied_biases(state.trajectory, noise, rates_hz))
        if solution is None:
            _check_origin(options, estimation_choices(state.parameters, options).status)
            start = parameters = state.parameters
        chosen = estimation_choices(state.parameters, options, added=added)
        origin = _with_gravity(start, state.parameters)
        solution = minimise_cost(
            _measurements(rig, state, options, chosen.status),
            state,
            border_layout(origin, chosen.status, chosen.prior_sigma),
            border_layout(
                origin, chosen.status, lens_tolerances(origin) | chosen.prior_sigma, candidate_blocks(origin)
            ),
            noise,
            estimate_noise=options.noise != "nominal",
            estimate_walks=options.noise == "coloured",
            gate=options.robust,
            max_iterations=options.max_iterations,
            tell=tell,
            proves=lambda found: proven_board(found, options),
        )
        moved = solution.state.parameters
        if _largest_move(moved, state.parameters) < MARGIN_S / 2 or not solution.converged:
            break
        parameters = moved
    assert solution is not None
    return solution


def _first_parameters(
    rig: RigBeforehand, gravity: Gravity, options: CameraImuOptions, known: Sequence[ImuParameters | None]
) -> RigParameters:
    prepared = rig.prepared
    imus: list[ImuParameters] = []
    for i, errors in enumerate(known):
        apart_stamps = sum(data.imu == i for data in prepared.inertial) > 1
        imu = replace(errors or ImuParameters.ideal(), apart=apart_stamps, epoch_s=prepared.epochs_s[i])
        imu = first_imu(rig.beside[i - 1], imu) if i else imu
        imus.append(replace(imu, accelerometer_shift_s=_delay(rig, i) if imu.apart else 0.0))
    places = [
        first_place(look.alignment, look.poses, rig.streams[0], imus[0].accelerometer_shift_s)
        for look in rig.looks
        if look.alignment.score
    ]
    parameters = first_parameters(
        rig.looks, gravity.value, options, imus, places if len(places) == len(rig.looks) else ()
    )
    if len(imus) > 1:
        status = estimation_choices(parameters, options).status
        recorded = rig.recording.imus.values()
        placed = [
            with_stated_pose(imu, f"imu{i}", samples, status) if i else imu
            for i, (imu, samples) in enumerate(zip(parameters.imus, recorded, strict=True))
        ]
        parameters = replace(parameters, imus=tuple(placed))
    return replace(parameters, rig=rig.recording.rig)


def _delay(rig: RigBeforehand, number: int) -> float:
    """Return the first guess of the delay of an accelerometer with timestamps of its own [s]."""
    guide = max(rig.looks, key=lambda look: int(look.alignment.consistent.sum()))
    look, alignment = guide, guide.alignment
    if number:
        look, alignment = rig.beside[number - 1].look, rig.beside[number - 1].alignment
    return accelerometer_delay(alignment, look.poses, rig.streams[number]) if alignment.score else 0.0


def _supporting_hz(prepared: PreparedCameraImu) -> float | None:
    """Return up to which rate both triads are sampled, by the fastest of several IMUs [Hz]; None of one IMU."""
    if len(prepared.imus) == 1:
        return None
    return min(max(imu.rates_hz[kind] for imu in prepared.imus) for kind in (0, 1))


def _largest_move(one: RigParameters, other: RigParameters) -> float:
    """Return the largest difference of two sets of time shifts [s]."""
    moves = [abs(a.time_shift_s - b.time_shift_s) for a, b in zip(one.cameras, other.cameras, strict=True)]
    for a, b in zip(one.imus, other.imus, strict=True):
        moves += [abs(a.shift_s(accelerometer=which) - b.shift_s(accelerometer=which)) for which in (False, True)]
    return max(moves)


def _with_gravity(start: RigParameters, state: RigParameters) -> RigParameters:
    """Return start values with gravity's direction as the trajectory has it."""
    return replace(start, gravity_axes=state.gravity_axes)


def _check_origin(options: CameraImuOptions, status: dict[str, Status]) -> None:
    """Refuse an origin that needs lever arms where none are estimated."""
    if options.origin == "optimal" or any(kind != "fixed" and ".lever_arms" in name for name, kind in status.items()):
        return
    raise OptionError(
        f"--origin {options.origin}: the accelerometers are taken to be at one point here, the only one that "
        "T_cam_imu can be of. Let their lever arms be estimated (--model auto, or --free imu0.lever_arms), or leave "
        "--origin out."
    )


def _measurements(
    rig: RigBeforehand, state: RigState, options: CameraImuOptions, status: dict[str, Status]
) -> Measurements:
    visual: list[VisualData] = []
    used: list[np.ndarray] = []
    parameters, grid = state.parameters, state.trajectory.grid
    for i, look in enumerate(rig.looks):
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
    inertial = [
        readings for data in rig.prepared.inertial for readings in on_trajectory(data, parameters, status, grid)
    ]
    return Measurements(inertial=tuple(inertial), visual=tuple(visual), used=tuple(used))


def basic_model(
    start: RigParameters, solution: Solution, options: CameraImuOptions, tell: Progress
) -> tuple[RigState | None, list[Finding]]:
    """Return the basic model's estimate on the same measurements (Figs. 5.6 and 5.7 of Krebs).

    It is there for comparison alone: where it cannot be made, None and a finding that says so.
    """
    if not options.compare or options.model == "basic":
        return None, []
    chosen = estimation_choices(start, replace(options, fix=(), free=(), prior=()), model="basic")
    parameters = solution.state.parameters
    ideal = replace(parameters, imus=tuple(imu.without_errors() for imu in parameters.imus))
    columns = border_layout(solution.layout.start, chosen.status, chosen.prior_sigma)
    try:
        found = minimise_cost(
            solution.measurements,
            RigState(trajectory=solution.state.trajectory, parameters=ideal),
            columns,
            columns,
            solution.noise,
            estimate_noise=False,
            gate=False,
            max_iterations=options.max_iterations,
            tell=tell,
            stage="estimating the basic model for comparison",
            workspace=solution.spare_workspace(),
        )
    except SolveError as error:
        return None, [comparison_left_out("the basic model", str(error))]
    return found.state, []
