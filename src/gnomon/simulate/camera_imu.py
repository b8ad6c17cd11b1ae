"""The simulation of cameras and an IMU before a board (Krebs, section 5.1.1)."""

from collections.abc import Mapping
from dataclasses import fields, replace

import numpy as np

from ..frozen import FrozenMapping, value_class
from ..geometry.rotations import rotvec_from_rotation
from ..models.origin import Origin, single_point_weights
from ..models.target import Target
from ..recording import CameraFrames, Floats, Recording
from ..results.calibration import Assessment, Calibration, CameraCalibration, CameraImuFit, ImuCalibration
from .camera_imu_path import CameraPath, drawn_path
from .camera_imu_rig import (
    corner_offsets,
    drawn_cameras,
    drawn_imu_truth,
    gravity_target,
    nominal_extrinsics,
    place_imu,
    stated_lens,
)
from .camera_imu_streams import (
    CameraTruth,
    FrameStreams,
    ImuStreams,
    SimulatedImu,
    TrueTrajectory,
    View,
    simulated_frames,
    simulated_imu,
)
from .scenarios.camera_imu import CameraImuScenario
from .sensor import true_calibration
from .walk import path_of_walk


@value_class(eq=True)
class MotionStatistics:
    """How lively a recording is: means and largest values over the IMU's samples, and how much of the board is seen."""

    mean_rate_rad_s: float
    max_rate_rad_s: float
    mean_acceleration_m_s2: float
    max_acceleration_m_s2: float
    visible: Mapping[str, float]


@value_class
class CameraImuSimulation:
    """A recording of cameras and an IMU, and everything that is true of it.

    Attributes
    ----------
    scenario, seed : what was simulated
    recording : as a sensor rig would deliver it; nominal noise and intrinsics, no guess of extrinsics or time shift
    target : the board, as its owner describes it
    truth : what is to be estimated, in body frame "accel-x", with zero covariance; biases are means over the recording;
        where accelerometers sit at different places the origin of an IMU is its p*, that of `imus` the x accelerometer
    truth_parameters : by the names of the batch estimation, such as "imu0.M_g" (3,) or "cam0.time_shift_cam_imu" ();
        "imu0.q_bg" is the rotation vector of C_bg, "imu0.B_g" is (3, 3), "imu0.lever_arms" (6,),
        "cam0.T_cam_imu.rotation" is the rotation vector of R_cam_imu, "imu1.T_imu_body.rotation" that of R_imu_body,
        "imu1.time_shift" and "imu0.accelerometer_shift" are those of clocks, "target.offsets" are those of the corners
        (k, 3)
    gravity_target : (3,) gravity in the target's frame [m/s^2]
    imus : "imu0", ... -> what is true of its samples
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
    imus: Mapping[str, SimulatedImu]
    frames: Mapping[str, CameraTruth]
    statistics: MotionStatistics

    @property
    def trajectory(self) -> TrueTrajectory:
        """Motion of the body, imu0."""
        return self.imus["imu0"].trajectory

    @property
    def b_a(self) -> Floats:
        """True biases at the recorded samples of the accelerometer of imu0, (k, 3) [m/s^2]."""
        return self.imus["imu0"].b_a

    @property
    def b_g(self) -> Floats:
        """True biases at the recorded samples of the gyroscope of imu0, (n, 3) [rad/s]."""
        return self.imus["imu0"].b_g


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
    "accelerometer_instants",
    "phase",
    "cam1_exposures",
)


def simulate_camera_imu(scenario: CameraImuScenario | None = None, seed: int = 0) -> CameraImuSimulation:
    """Make a recording of cameras and an IMU that are waved together before a board, and what is true of it.

    Parameters
    ----------
    scenario : what to simulate; the default scenario where None
    seed : every random number follows from it; the same scenario and seed give the same recording

    Returns
    -------
    simulation : recording, target, and the truth about sensors, path, biases, frames and corners

    Raises
    ------
    OptionError
        If the scenario's lens or board is impossible.

    Examples
    --------
    >>> simulation = simulate_camera_imu(CameraImuScenario(duration_s=2.0), seed=1)
    >>> len(simulation.recording.cameras["cam0"].t_ns)
    40
    >>> float(simulation.truth_parameters["cam0.time_shift_cam_imu"])
    0.007
    """
    scenario = scenario or CameraImuScenario()
    streams = _streams(scenario, seed)
    target, gravity = scenario.stated_board(), gravity_target(scenario)
    offsets = corner_offsets(scenario, target, streams["board"])
    points = scenario.target_scale * (target.points + offsets)
    middle = scenario.target_scale * (target.points.min(axis=0) + target.points.max(axis=0)) / 2
    if scenario.motion == "walk":
        path = path_of_walk(scenario, middle, streams["path"])
    else:
        path = drawn_path(scenario, middle, nominal_extrinsics(), streams["path"])
    exposures = _exposures(scenario, streams)
    rig = drawn_cameras(scenario, streams["rig"])
    imus = _simulated_imus(scenario, seed, path, rig["cam0"].T_cam_imu, streams)
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
            exposure_s=exposures[name],
            clock_offset_s=scenario.clock_offset_s + (name == "cam1") * scenario.clock_offset_difference_s,
            streams=_frame_streams(streams[name]),
        )
    truth = _truth(scenario, seed, {name: _with_origin(imu) for name, imu in imus.items()}, cameras, frames)
    parameters = {**_truth_parameters(scenario, imus, truth), "target.offsets": offsets}
    return CameraImuSimulation(
        scenario=scenario,
        seed=seed,
        recording=Recording(imus={name: imu.samples for name, imu in imus.items()}, cameras=recorded),
        target=target,
        truth=truth,
        truth_parameters=FrozenMapping(parameters),
        gravity_target=gravity,
        imus=FrozenMapping(imus),
        frames=FrozenMapping(frames),
        statistics=_statistics(imus["imu0"].trajectory, frames),
    )


def _streams(scenario: CameraImuScenario, seed: int) -> dict[str, np.random.Generator]:
    """Return one stream a purpose: an option for one leaves the others as they are."""

    def spawned(seed: int) -> dict[str, np.random.Generator]:
        return dict(zip(_STREAMS, np.random.default_rng(seed).spawn(len(_STREAMS)), strict=True))

    streams = spawned(seed)
    if scenario.trajectory_seed is not None:
        own = spawned(scenario.trajectory_seed)
        streams |= {name: own[name] for name in ("path", "cam1_exposures")}
    if scenario.sensor_seed is not None:
        own = spawned(scenario.sensor_seed)
        streams |= {name: own[name] for name in ("imu", "rig", "board")}
    return streams


def _simulated_imus(
    scenario: CameraImuScenario,
    seed: int,
    path: CameraPath,
    T_cam0_body: Floats,
    streams: Mapping[str, np.random.Generator],
) -> dict[str, SimulatedImu]:
    """Return what each IMU records; the streams of the further ones are their own."""
    own = ImuStreams(**{purpose.name: streams[purpose.name] for purpose in fields(ImuStreams)})
    imus = {"imu0": simulated_imu(scenario, path, T_cam0_body, drawn_imu_truth(scenario, streams["imu"]), own)}
    sensor_seed = seed if scenario.sensor_seed is None else scenario.sensor_seed
    for number in range(1, scenario.imus):
        errors, pose = np.random.default_rng((sensor_seed, number, 1)).spawn(2)
        sensor = place_imu(scenario, drawn_imu_truth(scenario, errors, further=True), number, pose)
        assert sensor.T_imu_body is not None
        T_cam0_imu = T_cam0_body @ np.linalg.inv(sensor.T_imu_body)
        own = ImuStreams.spawned(seed, number)
        imus[f"imu{number}"] = simulated_imu(scenario, path, T_cam0_imu, sensor, own, topic=f"/imu{number}")
    return imus


def _frame_streams(rng: np.random.Generator) -> FrameStreams:
    purposes = [field.name for field in fields(FrameStreams)]
    return FrameStreams(**dict(zip(purposes, rng.spawn(len(purposes)), strict=True)))


def _exposures(scenario: CameraImuScenario, streams: Mapping[str, np.random.Generator]) -> dict[str, Floats]:
    """Return when each camera exposes [s on the clock of imu0]."""
    step_s = 1 / scenario.camera_rate_hz
    together, apart = (
        np.arange(step_s * streams[name].random(), scenario.duration_s, step_s) for name in ("path", "cam1_exposures")
    )
    return {"cam0": together, "cam1": together if scenario.synchronous_cameras else apart}


def _statistics(trajectory: TrueTrajectory, frames: Mapping[str, CameraTruth]) -> MotionStatistics:
    rate = np.linalg.norm(trajectory.omega_imu, axis=1)
    acceleration = np.linalg.norm(trajectory.acceleration, axis=1)
    return MotionStatistics(
        mean_rate_rad_s=float(rate.mean()),
        max_rate_rad_s=float(rate.max()),
        mean_acceleration_m_s2=float(acceleration.mean()),
        max_acceleration_m_s2=float(acceleration.max()),
        visible=FrozenMapping({name: truth.visible for name, truth in frames.items()}),
    )


def _truth_parameters(
    scenario: CameraImuScenario, imus: Mapping[str, SimulatedImu], truth: Calibration
) -> dict[str, Floats]:
    found = {"gravity.magnitude": np.array(scenario.gravity), "target.scale": np.array(scenario.target_scale)}
    for name, imu in imus.items():
        sensor, pose = imu.sensor, truth.imus[name].T_imu_body
        found |= {f"{name}.{key}": getattr(sensor, key) for key in ("S_a", "M_a", "S_g", "M_g", "q_bg", "B_g")}
        found[f"{name}.lever_arms"] = sensor.places_m[1:].ravel()
        found[f"{name}.accelerometer_shift"] = np.array(sensor.accelerometer_shift_s)
        if pose is not None:
            found |= {
                f"{name}.T_imu_body.rotation": rotvec_from_rotation(pose[:3, :3]),
                f"{name}.T_imu_body.translation": pose[:3, 3],
                f"{name}.time_shift": np.array(imu.calibration.time_shift_s),
            }
    for name, camera in truth.cameras.items():
        found |= {
            f"{name}.T_cam_imu.rotation": rotvec_from_rotation(camera.T_cam_imu[:3, :3]),
            f"{name}.T_cam_imu.translation": camera.T_cam_imu[:3, 3],
            f"{name}.time_shift_cam_imu": np.array(camera.time_shift_cam_imu),
            f"{name}.line_delay": np.array(camera.camera.line_delay_s),
            f"{name}.exposure_squared": np.array(0.0),  # of corners; images have their own
            f"{name}.intrinsics": camera.camera.intrinsics,
            f"{name}.distortion_coeffs": camera.camera.distortion_coeffs,
        }
    return found


def _with_origin(imu: SimulatedImu) -> ImuCalibration:
    """Return the sensor with how its motion weighs its accelerometers, where they do not sit at one point."""
    if not imu.sensor.places_m.any():
        return imu.calibration
    motion = imu.trajectory.at(imu.trajectory.t_s)
    return replace(imu.calibration, origin=Origin(weights=single_point_weights(motion.omega, motion.alpha)))


def _truth(
    scenario: CameraImuScenario,
    seed: int,
    imus: Mapping[str, ImuCalibration],
    cameras: Mapping[str, CameraCalibration],
    frames: Mapping[str, CameraTruth],
) -> Calibration:
    """Return what is to be estimated; T_cam_imu is at p*, as what is estimated is (`models.origin`)."""
    counts = {name: len(truth.exposure_s) for name, truth in frames.items()}
    return true_calibration(
        scenario,
        seed,
        imus=imus,
        cameras=cameras,
        frame="accel-x",
        gravity_m_s2=scenario.gravity,
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
    ).with_origin("optimal")
