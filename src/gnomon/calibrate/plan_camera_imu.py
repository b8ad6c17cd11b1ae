"""What a planned recording of cameras and an IMU would tell: the normal equations at the truth, and no noise drawn.

plan -> exact measurements -> trajectory through the truth -> linearise once -> covariance -> what it would publish
"""

import numpy as np
from threadpoolctl import threadpool_limits

from ..errors import OptionError
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
from ..models.noise import ImuNoise
from ..options import CameraImuOptions
from ..recording import CameraFrames
from ..results.calibration import (
    Assessment,
    Calibration,
    CameraImuFit,
    Covariance,
    Gravity,
    Provenance,
    covariance_names,
)
from ..simulate.camera_imu_frames import START_NS
from ..simulate.planned import CameraImuPlan, PlannedRecording, PlannedRig, planned_recording
from ..simulate.sensor import changed_options
from .steps.preparation import local_gravity

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
