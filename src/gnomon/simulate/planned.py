"""Planned recordings without any noise: an IMU with its rests, and cameras with an IMU before a board."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from ..frozen import value_class
from ..models.target import Target
from ..recording import CameraFrames, Floats
from ..results.calibration import CameraCalibration
from .camera_imu_frames import START_NS, View
from .camera_imu_path import CameraPath, RigidMotion, drawn_path
from .camera_imu_rig import drawn_cameras, gravity_target, nominal_extrinsics
from .plans import CameraImuPlan, ImuPlan
from .scenarios.camera_imu import CameraImuScenario
from .scenarios.recorded import Scenario
from .trajectory import hand_motions

_TURNS = {"x": (1, 5), "y": (0, 4), "z": (3,)}
"""Axis of the camera -> coordinates of the path that turn it about that axis."""

_PLANAR = {0, 2, 4, 6, 8}
"""Coordinates of a motion in the plane of the floor, before an upright board."""


@value_class
class PlannedRig:
    """What is to be calibrated, as far as it is known.

    Attributes
    ----------
    cameras : by name
    target : the board
    """

    cameras: Mapping[str, CameraCalibration]
    target: Target


@value_class
class PlannedRecording:
    """What an ideal rig would measure.

    Attributes
    ----------
    t_s : (n,) instants of the IMU's samples [s]
    motion : of the IMU at them
    f_imu, omega_imu : (n, 3) specific force [m/s^2] and angular rate [rad/s], body frame
    gravity_target : (3,) [m/s^2]
    frames : exact corners, timestamps on each camera's own clock
    fastest_hz : highest frequency of the motion
    """

    t_s: Floats
    motion: RigidMotion
    f_imu: Floats
    omega_imu: Floats
    gravity_target: Floats
    frames: Mapping[str, CameraFrames]
    fastest_hz: float


def usual_rig() -> PlannedRig:
    """Return the rig of `gnomon simulate camera-imu`: one camera of 640 x 480 px and an AprilGrid of 6 x 6 tags."""
    scenario = CameraImuScenario()
    return PlannedRig(cameras=drawn_cameras(scenario, np.random.default_rng(0)), target=scenario.stated_board())


def planned_recording(plan: CameraImuPlan, rig: PlannedRig, imu_rate_hz: float, seed: int) -> PlannedRecording:
    """Return what an ideal rig would measure on a planned path.

    Parameters
    ----------
    plan : see there
    rig : cameras and board
    imu_rate_hz : sample rate
    seed : of the path, as `trajectory_seed` of a simulation
    """
    middle = (rig.target.points.min(axis=0) + rig.target.points.max(axis=0)) / 2
    rng = np.random.default_rng(seed).spawn(1)[0]
    path = _planned_path(plan, middle, rng)
    step_s = 1 / plan.camera_rate_hz
    exposure_s = np.arange(step_s * rng.random(), plan.duration_s, step_s)
    t_s = np.arange(int(plan.duration_s * imu_rate_hz + 1e-6) + 1) / imu_rate_hz
    first = next(iter(rig.cameras.values()))
    motion = path.at(t_s).of(first.T_cam_imu)
    gravity = gravity_target(CameraImuScenario())
    frames: dict[str, CameraFrames] = {}
    for name, camera in rig.cameras.items():
        T_cam_cam0 = camera.T_cam_imu @ np.linalg.inv(first.T_cam_imu)
        view = View(path=path, T_cam_cam0=T_cam_cam0, camera=camera.camera, points=rig.target.points)
        pixels, seen = view.corners(exposure_s)
        if rig.target.kind not in {"aprilgrid", "charuco"}:  # detected whole or not at all
            seen &= seen.all(axis=1, keepdims=True)
        frame, point = np.nonzero(seen)
        stamp_s = exposure_s - camera.time_shift_cam_imu
        frames[name] = CameraFrames(
            t_ns=START_NS + np.rint(stamp_s * 1e9).astype(np.int64),
            frame=frame,
            point=point,
            pixels=pixels[seen],
            camera=camera.camera,
        )
    moving = path.pulsation[np.any(path.amplitude != 0, axis=0)]
    return PlannedRecording(
        t_s=t_s,
        motion=motion,
        f_imu=np.einsum("nji,nj->ni", motion.R_target_body, motion.acceleration - gravity),
        omega_imu=motion.omega,
        gravity_target=gravity,
        frames=frames,
        fastest_hz=float(moving.max(initial=0.0) / (2 * np.pi)),
    )


def _planned_path(plan: CameraImuPlan, middle: Floats, rng: np.random.Generator) -> CameraPath:
    motion = "normal" if plan.motion == "planar" else plan.motion
    scenario = CameraImuScenario(motion=motion, duration_s=plan.duration_s, distance_m=plan.distance_m)
    path = drawn_path(scenario, middle, nominal_extrinsics(), rng)
    size = np.ones(len(path.offset))
    for axis, coordinates in _TURNS.items():
        size[list(coordinates)] = plan.turning * (axis in plan.turn_axes)
    size[[6, 7, 8]] = plan.shaking
    if plan.motion == "planar":
        size[[i for i in range(len(size)) if i not in _PLANAR]] = 0.0
    slope = path.slope * size
    return replace(path, amplitude=path.amplitude * size[:, None], slope=slope)


@value_class
class PlannedRests:
    """What an ideal IMU would measure.

    Attributes
    ----------
    t_s : (n,) instants of the samples [s]
    f_imu, omega_imu : (n, 3) specific force [m/s^2] and angular rate [rad/s]
    start_s, stop_s : (k,) when each rest begins and ends [s]
    """

    t_s: Floats
    f_imu: Floats
    omega_imu: Floats
    start_s: Floats
    stop_s: Floats


def planned_rests(plan: ImuPlan, gravity_m_s2: float, seed: int) -> PlannedRests:
    """Return what an ideal IMU would measure when it is turned as planned.

    Parameters
    ----------
    plan : see there
    gravity_m_s2 : magnitude of gravity
    seed : of the attitudes
    """
    scenario = Scenario(
        intervals=plan.intervals,
        attitudes=plan.attitudes,
        t_init_s=plan.t_init_s,
        hold_s=(plan.hold_s, plan.hold_s),
        motion_s=(plan.motion_s, plan.motion_s),
    )
    motions, end_s = hand_motions(scenario, np.random.default_rng(seed).spawn(2)[1])
    t_s = np.arange(int(end_s * plan.rate_hz + 1e-6) + 1) / plan.rate_hz
    f_imu, omega_imu = motions.evaluate(t_s, gravity_m_s2, np.zeros(3))
    return PlannedRests(
        t_s=t_s,
        f_imu=f_imu,
        omega_imu=omega_imu,
        start_s=np.concatenate([[0.0], motions.start_s + motions.duration_s]),
        stop_s=np.concatenate([motions.start_s, [end_s]]),
    )
