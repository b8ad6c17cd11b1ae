"""What a camera-IMU calibration was made of, as the tables of its diagnostics."""

import itertools

import numpy as np

from ...estimate.camera_imu.batch import RigState
from ...estimate.camera_imu.choices import estimation_choices
from ...estimate.camera_imu.layout import block_coordinates, parameter_blocks
from ...estimate.camera_imu.parameters import OFFSETS, RigParameters
from ...estimate.camera_imu.result.publish import PublishedRig, with_uncertain_gravity
from ...estimate.camera_imu.result.uncertainty import Uncertainty
from ...estimate.camera_imu.solution import Solution, frame_mean_square
from ...estimate.camera_imu.start.first_guess import CameraAlignment
from ...estimate.camera_imu.terms.assembly import TRIAD
from ...estimate.camera_imu.terms.inertial_terms import (
    ImuBeforehand,
    InertialData,
    body_clock_times,
    predicted_readings,
)
from ...estimate.camera_imu.terms.visual_terms import exposure_times
from ...estimate.camera_imu.trajectory import BIAS, POSE, Bases, KnotGrid, Places
from ...frozen import value_class
from ...geometry.rotations import quaternion_from_rotation
from ...models.target import Target
from ...options import CameraImuOptions
from ...recording import CameraFrames, Floats, Recording
from ...results.calibration import Gravity
from ...results.camera_diagnostics import (
    BiasTrack,
    CameraImuDiagnostics,
    CornerFit,
    EstimatedParameter,
    NoiseLevel,
    SceneMap,
    SignalFit,
    SolverStep,
    TrajectoryTrack,
)

NO_BOARD, NOTHING = "no board found", "no landmark found"
"""Why a frame could not be used at all."""

MISFIT = "fits badly as a whole"
"""Why a frame that has corners enough and lies on the trajectory was left out."""

_TRIADS = ("gyroscope", "accelerometer")
_UNITS = {"gyroscope": "rad/s", "accelerometer": "m/s^2"}


@value_class
class CameraImuFitSummary:
    """What a camera-IMU calibration was made of.

    Attributes
    ----------
    recording, target, options : as given
    imus : what was known of each IMU beforehand
    looks : what every camera saw
    start : start values of the parameters
    solution, uncertainty : the estimate
    basic : the basic model's estimate on the same measurements, or None
    gravity : what was taken for gravity
    published : what is published
    """

    recording: Recording
    target: Target
    imus: tuple[ImuBeforehand, ...]
    options: CameraImuOptions
    looks: tuple[CameraAlignment, ...]
    start: RigParameters
    solution: Solution
    uncertainty: Uncertainty
    basic: RigState | None
    gravity: Gravity
    published: PublishedRig

    @property
    def origin_ns(self) -> int:
        """Timestamp at which the seconds of the first IMU, and of the cameras, start [ns]."""
        return self.imus[0].origin_ns


def describe_camera_imu(evidence: CameraImuFitSummary) -> CameraImuDiagnostics:
    """Return the tables."""
    solution = evidence.solution
    parameters, grid = solution.state.parameters, solution.state.trajectory.grid
    estimated = _parameters(evidence)
    marginals = _marginals(evidence)
    covariance = _covariance(evidence)
    scale = np.sqrt(np.diag(covariance))
    return CameraImuDiagnostics(
        signals=_signals(evidence),
        biases=_biases(evidence, marginals),
        corners={look.name: _corners(evidence, i, look) for i, look in enumerate(evidence.looks)},
        trajectory=_trajectory(evidence, marginals),
        parameters=estimated,
        correlation=covariance / np.outer(scale, scale),
        noise=_noise(evidence),
        steps=tuple(
            SolverStep(cost=i.cost, largest_step=i.largest_step, damping=i.damping, accepted=i.accepted)
            for i in solution.iterations
        ),
        gravity_target=parameters.gravity,
        gravity_sigma=_gravity_sigma(evidence),
        gravity_plane=parameters.gravity_plane,
        knots_per_s=1 / grid.spacing_s,
        spline_order=grid.order,
        segments=len(grid.segments),
        baselines=_baselines(evidence),
        initial_time_shift_s={look.name: look.alignment.time_shift_s for look in evidence.looks},
        scene=_scene(evidence, estimated),
    )


def _scene(evidence: CameraImuFitSummary, estimated: tuple[EstimatedParameter, ...]) -> SceneMap | None:
    """Return where the landmarks are; None where there was a board."""
    parameters = evidence.solution.state.parameters
    if evidence.target.kind != "landmarks" or parameters.board is None:
        return None
    scale = parameters.target_scale
    sigma = [one.sigma for one in estimated if one.name.startswith(f"{OFFSETS}[")]
    return SceneMap(
        points=scale * (parameters.board.points + parameters.board.offsets),
        sigma=scale * np.reshape(sigma, (-1, 3)),
    )


def _covariance(evidence: CameraImuFitSummary) -> Floats:
    """Return the covariance of the free parameters, the uncertainty of gravity included."""
    count = len(evidence.uncertainty.names)
    return with_uncertain_gravity(evidence.uncertainty, evidence.gravity.sigma)[:count, :count]


def _parameters(evidence: CameraImuFitSummary) -> tuple[EstimatedParameter, ...]:
    solution = evidence.solution
    sigma = dict(zip(evidence.uncertainty.names, np.sqrt(np.diag(_covariance(evidence))), strict=True))
    prior = dict(zip(solution.layout.names, solution.layout.prior_sigma, strict=True))
    columns, origin = solution.layout, solution.layout.start
    status = estimation_choices(evidence.start, evidence.options).status
    for name, free, weak in zip(columns.names, columns.free, columns.weak, strict=True):
        if free and status.get(name, "fixed") == "fixed":  # added by evidence
            status[name] = "estimated" if weak else "prior"
    found: list[EstimatedParameter] = []
    for block in parameter_blocks(origin):
        if block.name == OFFSETS and status.get(f"{OFFSETS}[0]", "fixed") == "fixed":
            continue  # hundreds of zeros
        values = np.atleast_1d(block_coordinates(block.name, solution.state.parameters, origin))
        starts = np.atleast_1d(block_coordinates(block.name, origin, origin))
        for scalar, unit, value, start in zip(block.scalars(), block.units, values, starts, strict=True):
            held = (kind := status.get(scalar, "fixed")) == "fixed"
            carried = evidence.gravity.sigma if held and scalar == "gravity.magnitude" else 0.0
            found.append(
                EstimatedParameter(
                    name=scalar,
                    unit=unit,
                    value=float(value),
                    start=float(start),
                    sigma=carried if held else float(sigma[scalar]),
                    prior_sigma=(carried or float("inf")) if held else float(prior[scalar]),
                    status="considered" if carried else kind,
                )
            )
    return tuple(found)


def _signals(evidence: CameraImuFitSummary) -> dict[str, SignalFit]:
    found: dict[str, SignalFit] = {}
    for data in evidence.solution.measurements.inertial:
        full = _predictions(evidence.solution.state, data)
        basic = None if evidence.basic is None else _predictions(evidence.basic, data)
        noise = evidence.solution.noise.imus[data.imu]
        imu = evidence.solution.state.parameters.imus[data.imu]
        for k, name in enumerate(_TRIADS):
            triad = getattr(data, name)
            if triad is None:
                continue
            found[f"imu{data.imu}.{name}"] = SignalFit(
                t_s=body_clock_times(data, imu)
                + (imu.accelerometer_shift_s if k and data.gyroscope is not None else 0.0),
                measured=triad.values,
                predicted=full[k],
                basic=None if basic is None else basic[k],
                used=triad.used & np.isfinite(full[k][:, 0]),
                sigma=getattr(noise, name),
                unit=_UNITS[name],
            )
    return found


def _predictions(state: RigState, data: InertialData) -> tuple[Floats, Floats]:
    """Return what gyroscope and accelerometer should read, (n, 3) each; nan outside of the trajectory."""
    return predicted_readings(state.trajectory, state.parameters, data)


def _marginals(evidence: CameraImuFitSummary) -> tuple[Floats, Floats] | None:
    """Return the covariances of the control points' super-blocks where the report or the options ask for them."""
    solution = evidence.solution
    if not (evidence.options.compare or evidence.options.marginals):
        return None
    return solution.step.factor.marginals(solution.layout.free_index, solution.step.covariance)


def _biases(evidence: CameraImuFitSummary, marginals: tuple[Floats, Floats] | None) -> dict[str, BiasTrack]:
    """Return the biases at the knots, with their standard deviations; nan without marginals."""
    solution = evidence.solution
    trajectory, factor = solution.state.trajectory, solution.step.factor
    index, t_s = trajectory.grid.knot_times()
    thin = slice(None, None, max(1, len(index) // 2000))
    index, t_s = index[thin], t_s[thin]
    sigma = np.full((len(index), factor.size), np.nan)
    if marginals is not None:
        sigma = np.sqrt(factor.variances(marginals)[index])
    found: dict[str, BiasTrack] = {}
    for imu, walks in enumerate(solution.noise.walks):
        for k, name in enumerate(_TRIADS):
            start = POSE + BIAS * imu + TRIAD * k
            columns = slice(start, start + TRIAD)
            found[f"imu{imu}.{name}"] = BiasTrack(
                t_s=t_s,
                value=trajectory.controls[index, columns],
                sigma=sigma[:, columns],
                random_walk=walks[k],
                unit=_UNITS[name],
            )
    return found


def _corners(evidence: CameraImuFitSummary, camera: int, look: CameraAlignment) -> CornerFit:
    """Return the fit of every corner that was detected, also in frames that were not used."""
    frames, solution = look.frames, evidence.solution
    data, sums = solution.measurements.visual[camera], solution.lin.sums[camera]
    count = len(frames.t_ns)
    corners = np.bincount(frames.frame, minlength=count)
    places = solution.state.trajectory.grid.places(exposure_times(data, solution.state.parameters.cameras[camera]))
    predicted_exposure = places.inside & (sums.valid > 0)
    chosen = np.isin(frames.frame, look.poses.exposures.frame)
    residual, weight = np.full((len(frames.frame), 2), np.nan), np.zeros(len(frames.frame))
    known = np.repeat(predicted_exposure, sums.lengths)
    residual[chosen] = np.where(known[:, None], sums.residual, np.nan)
    used_exposure = solution.measurements.used[camera]
    used_corner = np.repeat(used_exposure & predicted_exposure, sums.lengths)
    weight[chosen] = np.where(used_corner, sums.weight, 0.0)
    rms = np.full(count, np.nan)
    mean_square = frame_mean_square(data.exposures, sums, predicted_exposure)
    rms[: len(mean_square)] = np.sqrt(mean_square)
    inside, used = np.zeros(count, dtype=bool), np.zeros(count, dtype=bool)
    inside[data.exposures.frame[predicted_exposure]] = True
    used[data.exposures.frame[predicted_exposure & used_exposure]] = True
    rms[~inside] = np.nan
    gathered = np.zeros(count, dtype=bool)
    gathered[look.poses.exposures.frame] = True
    entry = solution.state.parameters.cameras[camera]
    return CornerFit(
        frame_t_s=np.asarray((frames.t_ns - evidence.origin_ns) * 1e-9 + entry.time_shift_s, dtype=np.float64),
        frame_corners=corners,
        frame_rms=rms,
        frame_used=used,
        frame_reason=_reasons(
            frames,
            corners,
            gathered,
            inside,
            used,
            nothing=NOTHING if evidence.target.kind == "landmarks" else NO_BOARD,
        ),
        frame=frames.frame,
        point=frames.point,
        pixels=frames.pixels,
        residual=residual,
        weight=weight,
        sigma_px=float(solution.noise.pixel_sigma[camera]),
        resolution=frames.camera.resolution,
        corner_sigma_px=frames.sigma_px,
        quality=frames.quality,
    )


def _reasons(
    frames: CameraFrames,
    corners: np.ndarray,
    gathered: np.ndarray,
    inside: np.ndarray,
    used: np.ndarray,
    *,
    nothing: str,
) -> tuple[str, ...]:
    """Return why each frame was not used; `nothing` is why one without corners was not."""
    reasons = np.full(len(frames.t_ns), "", dtype=object)
    reasons[~used] = MISFIT
    reasons[~inside] = "outside of the trajectory"
    reasons[~gathered] = "too few corners"
    reasons[corners == 0] = nothing
    return tuple(reasons.tolist())


def _trajectory(evidence: CameraImuFitSummary, marginals: tuple[Floats, Floats] | None) -> TrajectoryTrack:
    solution = evidence.solution
    trajectory = solution.state.trajectory
    data = next(d for d in solution.measurements.inertial if d.gyroscope is not None)
    places = trajectory.grid.places(data.t_s)
    inside = places.inside
    places = places.some(inside)
    motion = trajectory.motion(places, Bases.at(places, trajectory.grid))
    sigma: Floats | None = None
    if marginals is not None and evidence.options.marginals:
        sigma = _pose_sigma(trajectory.grid, places, motion.phi_jacobian, marginals, solution.step.factor.size)
    return TrajectoryTrack(
        t_ns=evidence.origin_ns + np.rint(data.t_s[inside] * 1e9).astype(np.int64),
        p_target_imu=motion.position,
        q_target_imu_wxyz=quaternion_from_rotation(motion.R),
        omega_imu=motion.omega,
        f_imu=motion.specific_force(solution.state.parameters.gravity),
        attitude_sigma=None if sigma is None else sigma[:, :3],
        position_sigma=None if sigma is None else sigma[:, 3:],
    )


def _pose_sigma(
    grid: KnotGrid, places: Places, phi_jacobian: Floats, marginals: tuple[Floats, Floats], size: int
) -> Floats:
    """Return standard deviations (n, 6) of attitude (right, body axes) [rad] and position [m] at places.

    The control points of a span lie in one super-block and the next one.
    """
    own, following = marginals
    k, value = grid.order, Bases.at(places, grid).value
    per_block = k - 1
    block, offset = np.divmod(places.first, per_block)
    scalars = (np.arange(k)[:, None] * size + np.arange(POSE)).ravel()  # of the pose, from the first control point
    sigma = np.empty((len(block), POSE))
    for first in np.unique(places.first):
        at = np.flatnonzero(places.first == first)
        b, start = int(block[at[0]]), int(offset[at[0]]) * size
        joint = own[b]
        if b + 1 < len(own):
            joint = np.block([[own[b], following[b]], [following[b].T, own[b + 1]]])
        controls = joint[np.ix_(start + scalars, start + scalars)].reshape(k, POSE, k, POSE)
        pose = np.einsum("ni,iajb,nj->nab", value[at], controls, value[at], optimize=True)
        turn = phi_jacobian[at] @ pose[:, :3, :3] @ np.swapaxes(phi_jacobian[at], 1, 2)
        sigma[at, :3] = np.sqrt(np.einsum("nii->ni", turn))
        sigma[at, 3:] = np.sqrt(np.einsum("nii->ni", pose[:, 3:, 3:]))
    return sigma


def _noise(evidence: CameraImuFitSummary) -> tuple[NoiseLevel, ...]:
    solution = evidence.solution
    levels: list[NoiseLevel] = []
    for i, (used, found) in enumerate(zip(solution.noise.imus, solution.noise_found.imus, strict=True)):
        known = evidence.imus[i]
        for k, name in enumerate(_TRIADS):
            root = float(np.sqrt(known.rates_hz[k]))
            levels.append(
                NoiseLevel(
                    name=f"imu{i}.{name}",
                    unit=f"{_UNITS[name]}/sqrt(Hz)",
                    nominal=getattr(known.nominal, f"{name}_noise_density") if known.stated else float("nan"),
                    estimated=getattr(found, name) / root,
                    used=getattr(used, name) / root,
                )
            )
        for k, name in enumerate(_TRIADS):
            levels.append(
                NoiseLevel(
                    name=f"imu{i}.{name}.walk",
                    unit=f"{_UNITS[name]}/sqrt(s)",
                    nominal=getattr(known.nominal, f"{name}_random_walk") if known.stated else float("nan"),
                    estimated=solution.noise_found.walks[i][k],
                    used=solution.noise.walks[i][k],
                )
            )
    levels += [
        NoiseLevel(
            name=f"{look.name}.corners",
            unit="px",
            nominal=evidence.options.pixel_sigma or float("nan"),
            estimated=float(solution.noise_found.pixel_sigma[i]),
            used=float(solution.noise.pixel_sigma[i]),
        )
        for i, look in enumerate(evidence.looks)
    ]
    return tuple(levels)


def _gravity_sigma(evidence: CameraImuFitSummary) -> Floats:
    """Return the standard deviation of gravity's components in the target's frame, (3,) [m/s^2]."""
    names = evidence.uncertainty.names
    direction = evidence.solution.state.parameters.gravity_direction
    jacobian = evidence.gravity.value * evidence.solution.state.parameters.gravity_plane
    along = np.outer(direction, direction) * evidence.gravity.sigma**2
    index = [names.index(f"gravity.direction[{k}]") for k in range(2) if f"gravity.direction[{k}]" in names]
    if len(index) < 2:
        return np.sqrt(np.diag(along))
    covariance = _covariance(evidence)[np.ix_(index, index)]
    return np.sqrt(np.diag(jacobian @ covariance @ jacobian.T + along))


def _baselines(evidence: CameraImuFitSummary) -> dict[str, Floats]:
    cameras = list(evidence.published.cameras.items())
    return {
        f"{later}_{earlier}": b.T_cam_imu @ np.linalg.inv(a.T_cam_imu)
        for (earlier, a), (later, b) in itertools.pairwise(cameras)
    }
