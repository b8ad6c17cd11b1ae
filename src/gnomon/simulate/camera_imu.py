"""The simulation of cameras and an IMU before a board (document B, section 5.1.1)."""

from collections.abc import Mapping
from dataclasses import dataclass, fields
from types import MappingProxyType

import numpy as np

from .._version import __version__
from ..calibration import (
    Assessment,
    Calibration,
    CameraCalibration,
    CameraImuFit,
    Covariance,
    Gravity,
    ImuCalibration,
    Provenance,
    covariance_names,
)
from ..geometry.rigid_body import acceleration_by_place, along_axes
from ..geometry.rotation_vector import rotvec_from_rotation
from ..models.target import Target
from ..recording import CameraFrames, Floats, ImuSamples, Integers, Recording, TriadSamples
from .camera_imu_frames import START_NS, CameraTruth, FrameStreams, View, outside, simulated_frames
from .camera_imu_motion import drawn_path
from .camera_imu_path import CameraPath, RigidMotion
from .camera_imu_rig import (
    ImuTruth,
    board,
    corner_offsets,
    drawn_cameras,
    drawn_imu_truth,
    earth_rate_target,
    gravity_target,
    nominal_extrinsics,
    stated_lens,
)
from .camera_imu_scenario import CameraImuScenario
from .trajectory import exponential
from .truth import changed_options


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TrueTrajectory:
    """Motion of the IMU.

    Attributes
    ----------
    t_s : (n,) instants at which the recorded samples were taken [s on the IMU's clock from the start]
    p_target_imu : (n, 3) origin of the IMU in the target's frame [m]
    R_target_imu : (n, 3, 3)
    velocity, acceleration : (n, 3) of the origin, in the target's frame [m/s], [m/s^2]
    omega_imu : (n, 3) angular rate that a gyroscope feels, the Earth's included, body frame [rad/s]
    alpha_imu : (n, 3) its derivative by time [rad/s^2]
    f_imu : (n, 3) specific force at the origin, body frame [m/s^2]
    path : of cam0, in closed form
    T_cam0_imu : (4, 4)
    start_ns : stamp of t = 0 [ns]
    """

    t_s: Floats
    p_target_imu: Floats
    R_target_imu: Floats
    velocity: Floats
    acceleration: Floats
    omega_imu: Floats
    alpha_imu: Floats
    f_imu: Floats
    path: CameraPath
    T_cam0_imu: Floats
    start_ns: int = START_NS

    @property
    def q_target_imu_wxyz(self) -> Floats:
        """Attitude, (n, 4), v_target = q v_imu q*."""
        phi = rotvec_from_rotation(self.R_target_imu)
        return exponential(phi, np.ones((len(phi), 1)))

    def at(self, t_s: Floats) -> RigidMotion:
        """Return the exact motion of the IMU against the target at any instants (k,) [s from the start]."""
        return self.path.at(t_s).of(self.T_cam0_imu)


@dataclass(frozen=True, slots=True, kw_only=True)
class MotionStatistics:
    """How lively a recording is: means and largest values over the IMU's samples, and how much of the board is seen."""

    mean_rate_rad_s: float
    max_rate_rad_s: float
    mean_acceleration_m_s2: float
    max_acceleration_m_s2: float
    visible: Mapping[str, float]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CameraImuSimulation:
    """A recording of cameras and an IMU, and everything that is true of it.

    Attributes
    ----------
    scenario, seed : what was simulated
    recording : as a sensor rig would deliver it; nominal noise and intrinsics, no guess of extrinsics or time shift
    target : the board, as its owner describes it
    truth : what is to be estimated, in body frame "accel-x", with zero covariance; biases are means over the recording
    truth_parameters : by the names of the batch estimation, such as "imu0.M_g" (3,) or "cam0.time_shift_cam_imu" ();
        "imu0.q_bg" is the rotation vector of C_bg, "imu0.B_g" is (3, 3), "imu0.lever_arms" (6,),
        "cam0.T_cam_imu.rotation" is the rotation vector of R_cam_imu, "target.offsets" are those of the corners (k, 3)
    gravity_target : (3,) gravity in the target's frame [m/s^2]
    trajectory : motion of the IMU
    b_a, b_g : (n, 3) true biases at the recorded samples [m/s^2], [rad/s]
    frames : "cam0", ... -> what is true of each frame and corner
    statistics : what the motion came to
    """

    scenario: CameraImuScenario
    seed: int
    recording: Recording
    target: Target
    truth: Calibration
    truth_parameters: Mapping[str, Floats]
    gravity_target: Floats
    trajectory: TrueTrajectory
    b_a: Floats
    b_g: Floats
    frames: Mapping[str, CameraTruth]
    statistics: MotionStatistics


_STREAMS = (
    "path",
    "imu",
    "rig",
    "accelerometer_noise",
    "gyroscope_noise",
    "accelerometer_walk",
    "gyroscope_walk",
    "dropped_samples",
    "imu_jitter",
    "cam0",
    "cam1",
    "board",
)


def simulated_camera_imu(scenario: CameraImuScenario, seed: int) -> CameraImuSimulation:
    """Make a recording and its truth; see `gnomon.simulate_camera_imu`."""
    streams = _streams(scenario, seed)
    target, gravity = board(scenario), gravity_target(scenario)
    offsets = corner_offsets(scenario, target, streams["board"])
    points = scenario.target_scale * (target.points + offsets)
    middle = scenario.target_scale * (target.points.min(axis=0) + target.points.max(axis=0)) / 2
    path = drawn_path(scenario, middle, nominal_extrinsics(), streams["path"])
    exposure_s = _exposures(scenario, streams["path"])
    imu = drawn_imu_truth(scenario, streams["imu"])
    rig = drawn_cameras(scenario, streams["rig"])
    samples, trajectory, b_a, b_g = _simulated_imu(scenario, path, rig["cam0"], imu, streams)
    recorded: dict[str, CameraFrames] = {}
    cameras: dict[str, CameraCalibration] = {}
    frames: dict[str, CameraTruth] = {}
    for name, camera in rig.items():
        T_cam_cam0 = camera.T_cam_imu @ np.linalg.inv(rig["cam0"].T_cam_imu)
        view = View(path=path, T_cam_cam0=T_cam_cam0, camera=camera.camera, points=points)
        recorded[name], frames[name], cameras[name] = simulated_frames(
            scenario,
            camera,
            view,
            stated=stated_lens(scenario, f"/{name}/image_raw"),
            exposure_s=exposure_s,
            streams=_frame_streams(streams[name]),
        )
    imus = {"imu0": imu.calibration(b_a.mean(axis=0), b_g.mean(axis=0))}
    return CameraImuSimulation(
        scenario=scenario,
        seed=seed,
        recording=Recording(imus={"imu0": samples}, cameras=recorded),
        target=target,
        truth=_truth(scenario, seed, imus, cameras, frames),
        truth_parameters=MappingProxyType({**_truth_parameters(scenario, imu, cameras), "target.offsets": offsets}),
        gravity_target=gravity,
        trajectory=trajectory,
        b_a=b_a,
        b_g=b_g,
        frames=MappingProxyType(frames),
        statistics=_statistics(trajectory, frames),
    )


def _streams(scenario: CameraImuScenario, seed: int) -> dict[str, np.random.Generator]:
    """Return one stream a purpose: an option for one leaves the others as they are."""

    def spawned(seed: int) -> dict[str, np.random.Generator]:
        return dict(zip(_STREAMS, np.random.default_rng(seed).spawn(len(_STREAMS)), strict=True))

    streams = spawned(seed)
    if scenario.trajectory_seed is not None:
        streams["path"] = spawned(scenario.trajectory_seed)["path"]
    if scenario.sensor_seed is not None:
        own = spawned(scenario.sensor_seed)
        streams |= {name: own[name] for name in ("imu", "rig", "board")}
    return streams


def _frame_streams(rng: np.random.Generator) -> FrameStreams:
    purposes = [field.name for field in fields(FrameStreams)]
    return FrameStreams(**dict(zip(purposes, rng.spawn(len(purposes)), strict=True)))


def _exposures(scenario: CameraImuScenario, rng: np.random.Generator) -> Floats:
    step_s = 1 / scenario.camera_rate_hz
    return np.arange(step_s * rng.random(), scenario.duration_s, step_s)


def _simulated_imu(
    scenario: CameraImuScenario,
    path: CameraPath,
    cam0: CameraCalibration,
    imu: ImuTruth,
    streams: dict[str, np.random.Generator],
) -> tuple[ImuSamples, TrueTrajectory, Floats, Floats]:
    """Return samples, the motion at them, and both biases."""
    rate_hz = scenario.imu_rate_hz
    t_s = np.arange(int(scenario.duration_s * rate_hz + 1e-6) + 1) / rate_hz
    trajectory = _trajectory(scenario, path, cam0.T_cam_imu, t_s)
    sensor = imu.calibration(np.zeros(3), np.zeros(3))
    assert sensor.gyroscope is not None
    accelerometer = sensor.required_accelerometer
    f, omega = trajectory.f_imu, trajectory.omega_imu
    felt = f
    if imu.places_m.any():
        felt = f + along_axes(acceleration_by_place(omega, trajectory.alpha_imu), imu.places_m)
    b_a = imu.b_a + _walk(imu.noise["accelerometer_random_walk"], t_s, streams["accelerometer_walk"])
    b_g = imu.b_g + _walk(imu.noise["gyroscope_random_walk"], t_s, streams["gyroscope_walk"])
    force = felt @ accelerometer.sensitivity.T + b_a
    rate = omega @ sensor.gyroscope.sensitivity.T + f @ sensor.gyroscope.g_sensitivity.T + b_g
    for name, values, limit in (
        ("accelerometer", force, scenario.accelerometer_range),
        ("gyroscope", rate, scenario.gyroscope_range),
    ):
        sigma = imu.noise[f"{name}_noise_density"] * np.sqrt(rate_hz)
        np.add(values, sigma * streams[f"{name}_noise"].standard_normal(values.shape), out=values)
        if limit is not None:
            np.clip(values, -limit, limit, out=values)
    kept = streams["dropped_samples"].random(len(t_s)) >= scenario.dropped_samples
    kept &= outside(t_s, scenario.imu_gaps_s)
    stamp_ns = _stamps(scenario, t_s, streams["imu_jitter"])[kept]
    samples = ImuSamples(
        accelerometer=TriadSamples(t_ns=stamp_ns, values=force[kept], unit="m/s^2"),
        gyroscope=TriadSamples(t_ns=stamp_ns, values=rate[kept], unit="rad/s"),
        noise=imu.nominal,
        topic="/imu0",
    )
    if not kept.all():
        trajectory = _trajectory(scenario, path, cam0.T_cam_imu, t_s[kept])
    return samples, trajectory, b_a[kept], b_g[kept]


def _trajectory(scenario: CameraImuScenario, path: CameraPath, T_cam0_imu: Floats, t_s: Floats) -> TrueTrajectory:
    motion = path.at(t_s).of(T_cam0_imu)
    R, earth = motion.R_target_body, earth_rate_target(scenario)
    # The board turns with the Earth: Coriolis' acceleration; the centrifugal one is part of gravity.
    acceleration = motion.acceleration + 2 * np.cross(earth, motion.velocity) - gravity_target(scenario)
    earth_body = earth @ R
    return TrueTrajectory(
        t_s=t_s,
        p_target_imu=motion.p_target_body,
        R_target_imu=R,
        velocity=motion.velocity,
        acceleration=motion.acceleration,
        omega_imu=motion.omega + earth_body,
        alpha_imu=motion.alpha - np.cross(motion.omega, earth_body),
        f_imu=np.einsum("nji,nj->ni", R, acceleration),
        path=path,
        T_cam0_imu=T_cam0_imu,
    )


def _walk(density: float, t_s: Floats, rng: np.random.Generator) -> Floats:
    """Return random walks (n, 3) that start from zero."""
    steps = rng.standard_normal((len(t_s), 3))
    steps[0] = 0.0
    steps[1:] *= density * np.sqrt(np.diff(t_s))[:, None]
    return np.cumsum(steps, axis=0)


def _stamps(scenario: CameraImuScenario, t_s: Floats, rng: np.random.Generator) -> Integers:
    error_s = scenario.imu_jitter_s * rng.standard_normal(len(t_s))
    return START_NS + np.rint((t_s + error_s) * 1e9).astype(np.int64)


def _statistics(trajectory: TrueTrajectory, frames: Mapping[str, CameraTruth]) -> MotionStatistics:
    rate = np.linalg.norm(trajectory.omega_imu, axis=1)
    acceleration = np.linalg.norm(trajectory.acceleration, axis=1)
    return MotionStatistics(
        mean_rate_rad_s=float(rate.mean()),
        max_rate_rad_s=float(rate.max()),
        mean_acceleration_m_s2=float(acceleration.mean()),
        max_acceleration_m_s2=float(acceleration.max()),
        visible=MappingProxyType({name: truth.visible for name, truth in frames.items()}),
    )


def _truth_parameters(
    scenario: CameraImuScenario, imu: ImuTruth, cameras: Mapping[str, CameraCalibration]
) -> Mapping[str, Floats]:
    found = {"gravity.magnitude": np.array(scenario.gravity), "target.scale": np.array(scenario.target_scale)}
    found |= {f"imu0.{name}": getattr(imu, name) for name in ("S_a", "M_a", "S_g", "M_g", "q_bg", "B_g")}
    found["imu0.lever_arms"] = imu.places_m[1:].ravel()
    for name, camera in cameras.items():
        found |= {
            f"{name}.T_cam_imu.rotation": rotvec_from_rotation(camera.T_cam_imu[:3, :3]),
            f"{name}.T_cam_imu.translation": camera.T_cam_imu[:3, 3],
            f"{name}.time_shift_cam_imu": np.array(camera.time_shift_cam_imu),
            f"{name}.line_delay": np.array(camera.camera.line_delay_s),
            f"{name}.intrinsics": camera.camera.intrinsics,
            f"{name}.distortion_coeffs": camera.camera.distortion_coeffs,
        }
    return MappingProxyType(found)


def _truth(
    scenario: CameraImuScenario,
    seed: int,
    imus: Mapping[str, ImuCalibration],
    cameras: Mapping[str, CameraCalibration],
    frames: Mapping[str, CameraTruth],
) -> Calibration:
    names = covariance_names(imus, cameras)
    options = changed_options(scenario)
    counts = {name: len(truth.exposure_s) for name, truth in frames.items()}
    return Calibration(
        imus=imus,
        cameras=cameras,
        frame="accel-x",
        gravity=Gravity(value=scenario.gravity, sigma=0.0, source="simulation"),
        uncertainty=Covariance(names=names, matrix=np.zeros((len(names), len(names)))),
        assessment=Assessment(
            verdict="pass",
            findings=(),
            model="full",
            camera_imu=CameraImuFit(
                frames_found=counts,
                frames_used=counts,
                corners_used={name: len(truth.pixels) for name, truth in frames.items()},
                reprojection_rms_px=dict.fromkeys(frames, scenario.pixel_noise_px),
                duration_s=scenario.duration_s,
                converged=True,
            ),
        ),
        provenance=Provenance(gnomon_version=__version__, method="simulation", options=options, seed=seed),
    )
