"""Planned recordings without any noise: an IMU with its rests, and cameras with an IMU before a board."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Literal

import numpy as np

from ..errors import OptionError
from ..frozen import value_class
from ..models.target import Target
from ..options import check_ranges
from ..recording import CameraFrames, Floats
from ..results.calibration import CameraCalibration
from .camera_imu_path import CameraPath, RigidMotion, drawn_path
from .camera_imu_rig import drawn_cameras, gravity_target, nominal_extrinsics
from .camera_imu_streams import START_NS, View
from .scenarios.camera_imu import CameraImuScenario, HandMotionName
from .scenarios.recorded import Scenario
from .trajectory import hand_motions

PlannedMotion = HandMotionName | Literal["planar"]
_TURNS = {"x": (1, 5), "y": (0, 4), "z": (3,)}
"""Axis of the camera -> coordinates of the path that turn it about that axis."""

_PLANAR = {0, 2, 4, 6, 8}
"""Coordinates of a motion in the plane of the floor, before an upright board."""


@value_class(eq=True)
class CameraImuPlan:
    """How cameras and an IMU are to be waved before a board."""

    duration_s: float = 60.0
    """Length of the recording in seconds."""

    motion: PlannedMotion = "normal"
    """How it is waved, as in gnomon simulate camera-imu: gentle, normal, tremor, shaky, rolling, translation, one-axis,
    slow, static; or planar: turned about the vertical and moved in the plane of the floor, as a vehicle does."""

    turning: float = 1.0
    """How much more briskly it is turned than that motion does by itself."""

    shaking: float = 1.0
    """How much more strongly it is moved to and fro."""

    turn_axes: str = "xyz"
    """Axes of the camera about which it is turned: x to the right, y down, z forward."""

    distance_m: float = 0.9
    """Mean distance from the camera to the middle of the board in metres."""

    camera_rate_hz: float = 20.0
    """Frame rate of the cameras."""

    imu_rate_hz: float | None = None
    """Sample rate of the IMU in Hz; as imu.yaml states it, or 200."""

    pixel_sigma: float = 0.3
    """Standard deviation of a detected corner in px, per axis."""

    model: Literal["basic", "scale-misalignment", "full"] = "full"
    """Model of the IMU that is to be estimated, as in gnomon camera-imu."""

    free: tuple[str, ...] = ()
    """Parameters to estimate that are fixed otherwise, such as cam0.intrinsics, as in gnomon camera-imu."""

    fix: tuple[str, ...] = ()
    """Parameters that are not to be estimated, such as imu0.B_g."""

    prior: tuple[str, ...] = ()
    """Parameters to estimate with a prior, NAME=SIGMA, such as cam0.intrinsics=2."""

    gravity: float | None = None
    """Local gravity in m/s^2, where you know it."""

    latitude: float | None = None
    """Latitude in degrees; where it is stated, gravity is known."""

    def __post_init__(self) -> None:
        check_ranges(self, positive="distance_m", not_negative="turning shaking")
        if set(self.turn_axes) - set("xyz") or len(set(self.turn_axes)) < len(self.turn_axes):
            raise OptionError(f'turn_axes "{self.turn_axes}": name axes of the camera, such as xyz or z.')
        if self.duration_s > 3600:
            raise OptionError(f"duration_s {self.duration_s:g}: plan an hour at most; sigmas fall as its square root.")
        if self.duration_s * self.camera_rate_hz < 3:
            raise OptionError(f"duration_s {self.duration_s:g}: that is less than three frames.")


@value_class(eq=True)
class ImuPlan:
    """How an IMU is to be turned by hand into many attitudes, at rest in each."""

    intervals: int = 40
    """Attitudes in which it rests, the first one included."""

    t_init_s: float = 50.0
    """Length of the first rest in seconds."""

    hold_s: float = 4.0
    """Length of the other rests in seconds."""

    motion_s: float = 2.25
    """Length of a turn from one attitude to the next in seconds."""

    attitudes: Literal["sphere", "one-axis"] = "sphere"
    """sphere: each axis points up, down and level, and between. one-axis: tilted about the y axis alone."""

    rate_hz: float = 100.0
    """Sample rate in Hz."""

    model: Literal["basic", "g-sensitivity"] = "g-sensitivity"
    """Gyroscope bias that is to be estimated: constant (basic), or linear in the specific force."""

    gravity: float | None = None
    """Local gravity in m/s^2, where you know it."""

    latitude: float | None = None
    """Latitude in degrees; where it is stated, gravity and the Earth's rate are known."""

    def __post_init__(self) -> None:
        check_ranges(self, positive="t_init_s hold_s motion_s")
        if not 10 <= self.intervals <= 1000:
            raise OptionError(f"intervals {self.intervals}: plan 10 to 1000; 36 to 50 are best.")


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
