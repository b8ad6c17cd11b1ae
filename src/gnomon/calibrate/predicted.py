"""What recordings tell before anything is fitted, of an IMU by itself and of cameras with one: one linearisation.

problem, attitudes -> nominal sensor -> normal equations -> covariance -> what one more rest would add
"""

from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np
from threadpoolctl import threadpool_limits

from ..errors import OptionError, SolveError
from ..estimate.camera_imu.batch import Measurements, NoiseLevels, RigState, linearize_batch
from ..estimate.camera_imu.choices import estimation_choices
from ..estimate.camera_imu.gauss_newton import gauss_newton_step
from ..estimate.camera_imu.layout import border_layout
from ..estimate.camera_imu.parameters import CameraParameters, ImuParameters, RigParameters, gravity_axes
from ..estimate.camera_imu.result.publish import publish_rig
from ..estimate.camera_imu.result.uncertainty import solution_uncertainty
from ..estimate.camera_imu.solution import Solution
from ..estimate.camera_imu.start.board_poses import gather_exposures
from ..estimate.camera_imu.start.first_guess import ImuPath, initial_trajectory, per_corner
from ..estimate.camera_imu.terms.inertial_terms import (
    DEFAULT_PER_S,
    KNOTS_PER_PERIOD,
    LARGEST_SHARE,
    InertialData,
    InertialNoise,
    TriadData,
)
from ..estimate.camera_imu.terms.visual_terms import VisualData
from ..estimate.camera_imu.trajectory import Trajectory
from ..estimate.multiposition.bias_functions import walk_precision, with_drift
from ..estimate.multiposition.fit import weak_prior_sigma
from ..estimate.multiposition.measurements import MotionSegments
from ..estimate.multiposition.model import (
    B_,
    BG_,
    CG_,
    G_,
    LOWER,
    PARAMETERS,
    S_,
    BiasFunctions,
    MultiPositionData,
    MultiPositionState,
    Whitening,
    linearize_model,
    normal_equations,
)
from ..estimate.multiposition.noise_levels import ExtraVariance, rotation_variance, whitened_rest
from ..estimate.multiposition.problem import MultiPositionProblem, to_physical_units
from ..frozen import value_class
from ..geometry.rotations import rotation_from_rotvec, skew, tangent_basis
from ..options import CameraImuOptions
from ..recording import CameraFrames, Floats
from ..recording.samples import ImuNoise
from ..results.calibration import (
    Assessment,
    Calibration,
    CameraImuFit,
    Covariance,
    Gravity,
    Provenance,
    covariance_names,
)
from ..results.result import Booleans
from ..simulate.camera_imu_streams import START_NS
from ..simulate.planned import CameraImuPlan, PlannedRecording, PlannedRig, planned_recording
from ..simulate.sensor import changed_options
from ..solve.least_squares import solve_arrow
from .steps.preparation import imu_calibration, local_gravity

_TURN_S, _TURN_STEPS = 1.5, 24


@value_class
class NominalFit:
    """What a fit would say of a sensor near to an ideal one; see `estimate.multiposition.problem.Fitted`.

    Attributes
    ----------
    state : the ideal sensor, and the attitudes
    joint : covariance of all free parameters, those of the bias in time included
    every_free : whether each of them is estimated
    data : what was linearised
    """

    state: MultiPositionState
    joint: Floats
    every_free: Booleans
    data: MultiPositionData

    @property
    def free(self) -> Booleans:
        """Whether each of the sensor's parameters is estimated, (30,)."""
        return self.every_free[:PARAMETERS]

    @property
    def covariance(self) -> Floats:
        """Of the sensor's parameters, (30, 30)."""
        covariance = np.zeros((len(self.every_free), len(self.every_free)))
        covariance[np.ix_(self.every_free, self.every_free)] = self.joint
        return covariance[:PARAMETERS, :PARAMETERS]


def nominal_fit(
    problem: MultiPositionProblem,
    up: Floats,
    walk: Floats,
    *,
    g_sensitivity: bool,
    rate_unit: float = 1.0,
    rate_bias: Floats | float = 0.0,
) -> NominalFit:
    """Linearise the problem of a nearly ideal sensor once.

    Parameters
    ----------
    problem : of the samples
    up : (n, 3) specific force of each rest [unit of the accelerometer]
    walk : (3,) random walk of the gyroscope's bias, scaled, squared [1/s]
    g_sensitivity : whether it is estimated
    rate_unit : of the gyroscope, about [rad/s]
    rate_bias : what the gyroscope reads at rest [its unit]

    Raises
    ------
    SolveError
        If such attitudes determine no calibration.
    """
    data = with_drift(problem.data)
    size = np.linalg.norm(up, axis=1, keepdims=True)
    accelerometer, gyroscope = problem.accelerometer, problem.gyroscope
    theta = np.zeros(PARAMETERS + 3 * data.drift[0].shape[1])
    theta[S_] = np.diag(size.mean() / accelerometer.spread)[LOWER]
    theta[B_] = -accelerometer.centre / accelerometer.spread
    theta[CG_] = np.diag(gyroscope.spread * rate_unit).ravel()
    theta[BG_] = (rate_bias - gyroscope.centre) / gyroscope.spread
    state = MultiPositionState(theta=theta, u=up / size)
    free = np.ones(len(theta), dtype=bool)
    free[G_] = g_sensitivity
    prior = np.zeros((len(theta), len(theta)))
    prior[:PARAMETERS, :PARAMETERS] = np.diag(weak_prior_sigma(state) ** -2.0)
    prior[PARAMETERS:, PARAMETERS:] = walk_precision(data, walk)
    try:
        lines, whitening = linearize_model(data, state), _whitening(data, state, prior)
        arrow = solve_arrow(normal_equations(lines, whitening, np.zeros(len(theta)), free))
    except np.linalg.LinAlgError as error:
        raise SolveError("such attitudes determine no calibration. Plan more of them, about all axes.") from error
    return NominalFit(state=state, joint=arrow.corner_covariance, every_free=free, data=data)


def _whitening(data: MultiPositionData, state: MultiPositionState, prior: Floats) -> Whitening:
    accelerometer, gyroscope = whitened_rest(data, state, ExtraVariance())
    rotation = data.linked / np.sqrt(rotation_variance(data, state))
    return Whitening(accelerometer=accelerometer, gyroscope=gyroscope, rotation=rotation, prior=prior)


def with_one_more_rest(fit: NominalFit, directions: Floats) -> Iterator[NominalFit]:
    """Yield what the fit would be with one more rest in each direction, turned to from the last rest the short way.

    Parameters
    ----------
    directions : (m, 3) unit vectors of the specific force in the sensor's frame
    """
    known = np.linalg.inv(fit.joint)
    free, size = fit.every_free, len(fit.every_free)
    nothing = np.zeros((size, size))
    for direction in directions:
        data, state = _one_turn(fit, direction)
        lines, whitening = linearize_model(data, state), _whitening(data, state, nothing)
        system = normal_equations(lines, whitening, np.zeros(size), free)
        tight = 1e12 * np.trace(system.diagonal[0]) * np.eye(2)  # where the last rest points is known already
        blocks = np.zeros((4, 4))
        blocks[:2, :2], blocks[2:, 2:] = system.diagonal[0] + tight, system.diagonal[1]
        blocks[:2, 2:] = system.coupling[0]
        blocks[2:, :2] = system.coupling[0].T
        border = system.border.reshape(4, -1)
        more = system.corner - border.T @ np.linalg.solve(blocks, border)
        yield replace(fit, joint=np.linalg.inv(known + 0.5 * (more + more.T)))


def _one_turn(fit: NominalFit, direction: Floats) -> tuple[MultiPositionData, MultiPositionState]:
    """Return the last rest, a turn from it, and a rest in another direction, as the nominal sensor reads them."""
    data, (s, b, c_g, b_g, _) = fit.data, fit.state.matrices
    last = fit.state.u[-1]
    axis = skew(direction) @ last
    sine = float(np.linalg.norm(axis))
    angle = float(np.arctan2(sine, last @ direction))
    axis = axis / sine if sine > 1e-6 else tangent_basis(last[None])[0, :, 0]
    share = (np.arange(_TURN_STEPS) + 0.5) / _TURN_STEPS
    force = last @ rotation_from_rotvec(np.outer(share, axis * angle))
    constant: Floats = np.linalg.solve(c_g, axis * angle / _TURN_S) + b_g
    rate = np.tile(constant, (_TURN_STEPS, 1))
    u = np.array([last, direction])
    hats = np.repeat(data.drift[0][-1:], 2, axis=0)
    turn = MultiPositionData(
        accelerometer=u @ s.T + b,
        gyroscope=np.tile(b_g, (2, 1)),
        accelerometer_variance=np.tile(np.median(data.accelerometer_variance, axis=0), (2, 1)),
        gyroscope_variance=np.tile(np.median(data.gyroscope_variance, axis=0), (2, 1)),
        segments=MotionSegments(
            gyroscope=rate,
            accelerometer=force @ s.T + b,
            dt_s=np.full(_TURN_STEPS, _TURN_S / _TURN_STEPS),
            lengths=np.array([_TURN_STEPS]),
        ),
        rotation_variance=np.median(data.rotation_variance, axis=0)[None],
        linked=np.ones(1, dtype=bool),
        interval_s=np.zeros(2),
        rotation_s=np.zeros(1),
        span_s=(0.0, 1.0),
        earth_rate_variance=data.earth_rate_variance,
        sampling_variance=data.sampling_variance,
        gyroscope_functions=BiasFunctions(
            at_rest=hats, in_motion=hats[:1], kind=data.of_gyroscope.kind, sigma=data.of_gyroscope.sigma
        ),
    )
    return turn, MultiPositionState(theta=fit.state.theta, u=u)


def predicted_calibration(
    fit: NominalFit,
    problem: MultiPositionProblem,
    gravity: Gravity,
    *,
    units: Mapping[str, str],
    latitude: float | None = None,
    found: int = 0,
    provenance: Provenance,
) -> Calibration:
    """Return the calibration that a fit would publish, with its covariance.

    Parameters
    ----------
    units : of "accelerometer" and "gyroscope"
    latitude : [deg], where it is known
    found : rests, of which some may not be used
    """
    estimate = to_physical_units(
        fit,
        problem.accelerometer,
        problem.gyroscope,
        gravity_m_s2=gravity.value,
        gravity_sigma_m_s2=gravity.sigma,
        latitude_deg=latitude,
    )
    imus = {"imu0": imu_calibration(replace(estimate, g_sensitivity=np.zeros((3, 3))), units)}
    used = len(fit.state.u)
    return Calibration(
        imus=imus,
        frame="accel-x",
        gravity=gravity,
        uncertainty=Covariance(names=covariance_names(imus), matrix=estimate.covariance),
        assessment=Assessment(
            verdict="pass",
            findings=(),
            model="g-sensitivity" if fit.free[G_].all() else "basic",
            intervals_found=found,
            intervals_used=used,
            rotations_found=max(found - 1, 0),
            rotations_used=int(problem.data.linked.sum()),
        ),
        provenance=provenance,
    )


_FEWEST_FRAMES = 10
_GRAVITY = "gravity.magnitude"


def planned_camera_imu(
    plan: CameraImuPlan, rig: PlannedRig, noise: ImuNoise, imu_rate_hz: float, seed: int = 0
) -> Calibration:
    """Return the calibration that a planned recording would give, with its covariance; the values are the rig's own.

    Parameters
    ----------
    plan, rig : see there
    noise : of the IMU
    imu_rate_hz : its sample rate
    seed : of the path

    Raises
    ------
    OptionError
        If the board would hardly be seen.
    """
    with threadpool_limits(1, user_api="blas"):
        recording = planned_recording(plan, rig, imu_rate_hz, seed)
        options = CameraImuOptions(
            model=plan.model,
            gravity=plan.gravity,
            latitude=plan.latitude,
            free=plan.free,
            fix=plan.fix,
            prior=plan.prior,
        )
        gravity = local_gravity(options)
        parameters = _truth(rig, recording, gravity)
        measurements = _measurements(rig, recording)
        levels = _levels(plan, noise, imu_rate_hz, len(rig.cameras))
        chosen = estimation_choices(parameters, options)
        columns = border_layout(parameters, chosen.status, chosen.prior_sigma, (_GRAVITY,))
        state = RigState(trajectory=_trajectory(recording, measurements, imu_rate_hz), parameters=parameters)
        lin = linearize_batch(measurements, state, columns, levels, probing=True)
        solution = Solution(
            state=state,
            measurements=measurements,
            noise=levels,
            noise_found=levels,
            layout=columns,
            lin=lin,
            step=gauss_newton_step(lin),
            iterations=(),
            converged=True,
        )
        found = publish_rig(solution_uncertainty(solution, (_GRAVITY,)), parameters, gravity_sigma=gravity.sigma)
    used = dict(zip(rig.cameras, measurements.visual, strict=True))
    frames = {name: len(np.unique(data.exposures.frame)) for name, data in used.items()}
    return Calibration(
        imus=found.imus,
        cameras=found.cameras,
        frame="accel-x",
        gravity=gravity,
        uncertainty=Covariance(names=covariance_names(found.imus, found.cameras), matrix=found.covariance),
        assessment=Assessment(
            verdict="pass",
            findings=(),
            model=plan.model,
            camera_imu=CameraImuFit(
                frames_found=frames,
                frames_used=frames,
                corners_used={name: len(data.exposures.points) for name, data in used.items()},
                reprojection_rms_px=dict.fromkeys(frames, plan.pixel_sigma),
                duration_s=plan.duration_s,
                converged=True,
            ),
        ),
        provenance=Provenance(method="plan", options=changed_options(plan), seed=seed),
    )


def _truth(rig: PlannedRig, recording: PlannedRecording, gravity: Gravity) -> RigParameters:
    return RigParameters(
        gravity_axes=gravity_axes(recording.gravity_target),
        gravity_m_s2=gravity.value,
        target_scale=1.0,
        imus=(ImuParameters.ideal(),),
        cameras=tuple(
            CameraParameters(
                name=name,
                R_cam_imu=camera.T_cam_imu[:3, :3],
                p_cam_imu=camera.T_cam_imu[:3, 3],
                time_shift_s=camera.time_shift_cam_imu,
                camera=camera.camera,
            )
            for name, camera in rig.cameras.items()
        ),
    )


def _measurements(rig: PlannedRig, recording: PlannedRecording) -> Measurements:
    every = np.ones(len(recording.t_s), dtype=bool)
    inertial = InertialData(
        imu=0,
        t_s=recording.t_s,
        gyroscope=TriadData(values=recording.omega_imu, used=every),
        accelerometer=TriadData(values=recording.f_imu, used=every),
    )
    visual = tuple(_visual(i, frames, rig, name) for i, (name, frames) in enumerate(recording.frames.items()))
    used = tuple(np.ones(len(data.exposures), dtype=bool) for data in visual)
    return Measurements(inertial=(inertial,), visual=visual, used=used)


def _visual(index: int, frames: CameraFrames, rig: PlannedRig, name: str) -> VisualData:
    exposures = gather_exposures(frames, rig.target)
    if len(exposures) < _FEWEST_FRAMES:
        raise OptionError(
            f"{name} would see the board in {len(exposures)} frames only. Plan a longer recording, a smaller motion, "
            "another distance (--distance-m), or a board that fits into the image."
        )
    t_s = np.asarray((frames.t_ns[exposures.frame] - START_NS) * 1e-9, dtype=np.float64)
    if not frames.camera.line_delay_s:
        return VisualData(camera=index, exposures=exposures, t_s=t_s)
    return VisualData(camera=index, exposures=per_corner(exposures), t_s=t_s[exposures.of_corner])


def _levels(plan: CameraImuPlan, noise: ImuNoise, imu_rate_hz: float, cameras: int) -> NoiseLevels:
    root = float(np.sqrt(imu_rate_hz))
    return NoiseLevels(
        imus=(
            InertialNoise(
                gyroscope=noise.gyroscope_noise_density * root, accelerometer=noise.accelerometer_noise_density * root
            ),
        ),
        walks=((noise.gyroscope_random_walk, noise.accelerometer_random_walk),),
        pixel_sigma=(plan.pixel_sigma,) * cameras,
        huber=np.inf,
    )


def _trajectory(recording: PlannedRecording, measurements: Measurements, imu_rate_hz: float) -> Trajectory:
    path = ImuPath(t_s=recording.t_s, R=recording.motion.R_target_body, position=recording.motion.p_target_body)
    seen = np.sort(np.concatenate([data.t_s for data in measurements.visual]))
    wanted = max(KNOTS_PER_PERIOD * recording.fastest_hz, min(DEFAULT_PER_S, imu_rate_hz / 3))
    knots = float(np.clip(5 * np.ceil(wanted / 5 - 1e-9), 5.0, LARGEST_SHARE * imu_rate_hz))
    return initial_trajectory(path, seen, knots, order=6, gyroscope_biases=[np.zeros(3)])
