"""From what was measured to the solution with the options' model."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from ...assess.imu.recording_changes import slope_finding
from ...assess.verdict import comparison_left_out
from ...errors import OptionError, SolveError
from ...estimate.camera_imu.batch import Measurements, RigState, with_tied_biases
from ...estimate.camera_imu.choices import estimation_choices, lens_tolerances
from ...estimate.camera_imu.layout import Status, border_layout
from ...estimate.camera_imu.parameters import CameraParameters, ImuParameters, RigParameters
from ...estimate.camera_imu.result.bias_temperature import biases_along, control_times
from ...estimate.camera_imu.result.uncertainty import Uncertainty
from ...estimate.camera_imu.solution import GATE, Solution, minimise_cost
from ...estimate.camera_imu.start.first_guess import (
    CameraAlignment,
    ImuStream,
    first_parameters,
    first_place,
    first_state,
    per_corner,
)
from ...estimate.camera_imu.start.imu_alignment import ImuAlignment, accelerometer_delay, first_imu, with_stated_pose
from ...estimate.camera_imu.terms.inertial_terms import (
    InertialData,
    TriadData,
    knots_per_s,
    on_trajectory,
    triad_readings,
)
from ...estimate.camera_imu.terms.visual_terms import VisualData
from ...estimate.camera_imu.trajectory import BIAS, MARGIN_S
from ...estimate.multiposition.bias_changes import DECAYS
from ...estimate.multiposition.bias_functions import BENDS_K, WEAK_LAG_S
from ...estimate.trust.changes import chi_square_tail, start_of_estimates
from ...findings import Finding
from ...frozen import value_class
from ...geometry.rotations import rotvec_from_rotation
from ...options import CameraImuOptions
from ...options.requirements import USUAL_SLOPE
from ...progress import Progress
from ...recording import Floats, Recording
from ...recording.thermometer import TemperatureCourse, temperature_course
from ...results.calibration import Calibration, CameraCalibration, Gravity
from ...results.temperature_dependence import TemperatureDependence
from .camera_imu_model import candidate_blocks, proven_board
from .camera_imu_preparation import PreparedCameraImu, evidence_of_imu, imu_of
from .temperature_while_turned import rose_and_fell, temperature_powers

_HUBER = 2.5
_RESTARTS = 3
_SAME_SHIFT_S, _SAME_TURN_RAD = 0.01, 0.05  # from the alignment, of a start by another calibration
_LIKELY = 1e-5
"""Probability by chance below which a bias follows the temperature."""


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
    parameters, stream = _first_parameters(rig, gravity, options, known), rig.streams[0]
    if (near := start_of_estimates()) is not None and len(rig.streams) == 1:
        parameters, stream = _nearer(parameters, stream, near, gravity)
    pixel_sigma = tuple(options.pixel_sigma or look.poses.sigma_px for look in found)
    noise = prepared.first_noise(pixel_sigma, _HUBER if options.robust else np.inf)
    knots = options.knots_per_s or knots_per_s(*triad_readings(prepared.inertial), rate_hz=_supporting_hz(prepared))
    biases = [one.gyroscope_bias for one in rig.beside]
    solution: Solution | None = None
    start = parameters
    for _ in range(_RESTARTS):
        state = first_state(found, parameters, stream, knots, order=options.spline_order, others=biases)
        if options.noise != "coloured" and not options.marginals:  # these ask for biases at every knot
            rates_hz = [imu.rates_hz for imu in prepared.imus]
            state = replace(state, trajectory=with_tied_biases(state.trajectory, noise, rates_hz))
        if solution is None:
            _check_origin(options, estimation_choices(state.parameters, options).status)
            start = parameters = state.parameters
        chosen = estimation_choices(state.parameters, options, added=added)
        origin = replace(start, gravity_axes=state.parameters.gravity_axes)
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
            near=near is not None,
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


def _nearer(
    parameters: RigParameters, stream: ImuStream, known: Calibration, gravity: Gravity
) -> tuple[RigParameters, ImuStream]:
    """Return the first parameters, or those of a calibration where they agree, and forces without its bias."""
    cameras = [_nearer_camera(entry, known.cameras.get(entry.name)) for entry in parameters.cameras]
    parameters = replace(parameters, cameras=tuple(cameras))
    found = evidence_of_imu(known, gravity, "imu0", first=True)
    assert found is not None
    imu = imu_of(found)
    errors = {name: getattr(imu, name) for name in ("S_a", "M_a", "S_g", "M_g", "C_bg", "B_g")}
    parameters = replace(parameters, imus=(replace(parameters.imus[0], **errors),))
    return parameters, replace(stream, force=stream.force - found.value[9:12])


def _nearer_camera(entry: CameraParameters, known: CameraCalibration | None) -> CameraParameters:
    if known is None or abs(known.time_shift_cam_imu - entry.time_shift_s) > _SAME_SHIFT_S:
        return entry
    R, p = known.T_cam_body[:3, :3], known.T_cam_body[:3, 3]
    if np.linalg.norm(rotvec_from_rotation(R.T @ entry.R_cam_imu)) > _SAME_TURN_RAD:
        return entry
    return replace(entry, R_cam_imu=R, p_cam_imu=p, time_shift_s=known.time_shift_cam_imu)


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


@value_class
class BiasesOverTemperature:
    """Slopes of the first IMU's biases: the dependence, and the covariance of each of its parts."""

    known: TemperatureDependence
    blocks: Mapping[str, Floats]

    def added_to(self, calibration: Calibration) -> Calibration:
        """Return the calibration with them, and what says how large they are."""
        if not self.blocks:
            return calibration
        findings = [
            slope_finding(part, getattr(self.known, part), own, self.known) for part, own in self.blocks.items()
        ]
        calibration = calibration.with_temperature(next(iter(calibration.imus)), self.known, self.blocks)
        assessed = calibration.assessment
        return replace(calibration, assessment=replace(assessed, findings=(*assessed.findings, *findings)))


def without_slopes(
    prepared: PreparedCameraImu, recording: Recording, known: TemperatureDependence
) -> PreparedCameraImu:
    """Return the readings without what the biases of the first IMU do with the temperature."""
    course = _course(recording)
    assert course is not None

    def without(data: InertialData, name: str) -> TriadData | None:
        triad: TriadData | None = getattr(data, name)
        degc = course.at(prepared.origin_ns + np.round(1e9 * data.t_s).astype(np.int64))
        return None if triad is None else replace(triad, values=triad.values - known.change(f"{name}_bias", degc))

    inertial = tuple(
        replace(data, **{name: without(data, name) for name in ("gyroscope", "accelerometer")})
        if not data.imu
        else data
        for data in prepared.inertial
    )
    return replace(prepared, inertial=inertial)


def biases_over_temperature(
    solution: Solution, certain: Uncertainty, recording: Recording, origin_ns: int, before: TemperatureDependence | None
) -> BiasesOverTemperature | None:
    """Return the slopes of the first IMU's biases where they are told.

    The biases stay means over the recording, which hold at its mean temperature. What they do with the temperature has
    to show beside their random walk and an exponential decay in time, whatever its time constant. Before it is taken
    off the readings it is among their errors and widens all sigmas: it has to show beside ordinary ones then, and once
    it is taken off beside those of clusters of time and of the walk that is left.

    Parameters
    ----------
    origin_ns : where the seconds of the trajectory start [ns]
    before : slopes that are taken off the readings already, to which what is found is added: no others are told
    """
    if (course := _course(recording)) is None:
        return None
    grid = solution.state.trajectory.grid
    t_ns = origin_ns + np.round(1e9 * control_times(grid)).astype(np.int64)
    degc = course.with_rate(t_ns)
    resting = degc[grid.knot_times()[0], 0]
    powers = temperature_powers(degc, resting, course.step_k)[:, :-1]  # sigmas are too large for that one to count
    since = (t_ns - t_ns[0]) / np.ptp(t_ns)
    decays = [np.exp(-since / tau)[:, None] for tau in DECAYS]
    each = [biases_along(solution, np.hstack([powers, decay]), _expected(powers.shape[1])) for decay in decays]
    kept = [0, *range(2, powers.shape[1] - 1)]  # not the rate, nor the highest power: they are there for what they hide
    known = TemperatureDependence(
        reference_degc=float(resting.mean()), low_degc=float(resting.min()), high_degc=float(resting.max())
    )
    blocks: dict[str, Floats] = {}
    for triad, scalars in (("accelerometer", range(3, 6)), ("gyroscope", range(3))):  # as the covariance lists them
        at = np.array([power * BIAS + scalar for power in kept for scalar in scalars])
        if before is not None and getattr(before, f"{triad}_bias") is None:
            continue
        taken = 0.0 if before is None else getattr(before, f"{triad}_bias").ravel()
        widened = 1.0 if before is None else _widened(solution, certain, scalars)
        told = [(found.ravel()[at] + taken, covariance[np.ix_(at, at)] * widened) for found, covariance in each]
        values, own = min(told, key=lambda one: one[0][:3] @ np.linalg.solve(one[1][:3, :3], one[0][:3]))
        if chi_square_tail(float(values[:3] @ np.linalg.solve(own[:3, :3], values[:3])), 3) < _LIKELY:
            known = replace(known, **{f"{triad}_bias": values.reshape(-1, 3)})
            blocks[f"{triad}_bias"] = own
    return BiasesOverTemperature(known=known, blocks=blocks)


def _course(recording: Recording) -> TemperatureCourse | None:
    """Return the temperature of the first IMU where it rose and fell."""
    samples = next(iter(recording.imus.values())).temperature
    return temperature_course(samples) if samples is not None and rose_and_fell(samples) else None


def _expected(count: int) -> Floats:
    """Return what is expected of the coefficients of slope, rate, higher powers and a decay, (count + 1, 6) [SI]."""
    usual = np.repeat([USUAL_SLOPE["gyroscope"], USUAL_SLOPE["accelerometer"]], 3)
    curves = [usual / BENDS_K**power for power in range(1, count - 1)]
    return np.array([30 * usual, 30 * WEAK_LAG_S * usual, *curves, 3000 * usual])


def _widened(solution: Solution, certain: Uncertainty, scalars: range) -> float:
    """Return by how much the variance is larger than levels of noise say: by clusters of time, and by the walk shown.

    A walk that is r times as strong as the prior Q makes the variance of p at most r^2 times as large.
    """
    at = len(certain.names) + np.array(scalars)
    clusters = float(np.mean(np.diag(certain.covariance)[at] / np.diag(certain.ordinary)[at]))
    triad = scalars.start // len(scalars)
    walk = solution.noise_found.walks[0][triad] / solution.noise.walks[0][triad]
    return max(clusters, walk**2, 1.0)
