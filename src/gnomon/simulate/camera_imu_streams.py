"""What a rig records on its path, and what is true of it.

Of the cameras exact corners of every frame, and what a detector and a clock make of them; of the IMUs what they feel,
and what their sensors and clocks make of it.
"""

from dataclasses import fields, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from ..frozen import value_class
from ..geometry.rotations import acceleration_by_place, along_axes, rotvec_from_rotation
from ..models.camera import Booleans, Camera
from ..recording import CameraFrames, Floats, ImuSamples, Integers, TriadSamples
from ..results.calibration import CameraCalibration, ImuCalibration
from .camera_imu_path import CameraPath, RigidMotion
from .camera_imu_rig import ImuTruth, earth_rate_target, gravity_target
from .scenarios.camera_imu import CameraImuScenario
from .trajectory import rotvec_quaternions

START_NS = 1_600_000_000_000_000_000
"""First timestamp of the IMU; timestamps are of the order of real ones, which float64 cannot hold to the nanosecond."""

BORDER_PX = 4.0
"""Corners nearer to the image's border are not detected."""

LATE_S = (0.005, 0.02)

_SETTLED_S = 1e-12
_SEARCHES = 10


@value_class
class CameraTruth:
    """What is true of the frames and the corners of `CameraFrames`, in the same order.

    Attributes
    ----------
    exposure_s : (n,) instant at which the top row of each frame was exposed [s on the IMU's clock from its first
        timestamp]
    late, shifted : (n,) whether the frame's timestamp is late, whether all its corners are shifted
    pixels : (m, 2) exact corners [px]
    outlier : (m,) whether the corner was detected in a wrong place
    visible : fraction of the board's points that are seen, mean over the frames
    """

    exposure_s: Floats
    late: Booleans
    shifted: Booleans
    pixels: Floats
    outlier: Booleans
    visible: float


@value_class
class FrameStreams:
    """Random numbers of one camera, one stream a purpose."""

    pixel_noise: np.random.Generator
    outliers: np.random.Generator
    dropped: np.random.Generator
    late: np.random.Generator
    shifted: np.random.Generator
    jitter: np.random.Generator


@value_class
class View:
    """A camera that is carried along a path before a board.

    Attributes
    ----------
    path : of cam0
    T_cam_cam0 : (4, 4) of this camera
    camera : its lens
    points : (k, 3) of the board [m]
    """

    path: CameraPath
    T_cam_cam0: Floats
    camera: Camera
    points: Floats

    def corners(self, t_s: Floats) -> tuple[Floats, Booleans]:
        """Return the exact pixels (n, k, 2) of frames whose top rows are exposed at t_s (n,), and which are seen."""
        pixels = self._at_once(t_s)
        if self.camera.line_delay_s:
            self._roll(t_s, pixels)
        farthest = np.array(self.camera.resolution) - 1 - BORDER_PX
        with np.errstate(invalid="ignore"):
            inside = (pixels >= BORDER_PX) & (pixels <= farthest)
        return pixels, inside[..., 0] & inside[..., 1]

    def _at_once(self, t_s: Floats) -> Floats:
        """Return the pixels (n, k, 2) of frames whose rows are all exposed at t_s (n,)."""
        R, p = self.path.pose(t_s)
        pixels = self._project((self.points @ R - p[:, None] @ R).reshape(-1, 3)).reshape(len(t_s), -1, 2)
        pixels[p[:, 2] <= 0] = np.nan  # behind the board
        return pixels

    def _project(self, p_cam0: Floats) -> Floats:
        p_cam = p_cam0 @ self.T_cam_cam0[:3, :3].T + self.T_cam_cam0[:3, 3]
        return self.camera.project(p_cam, point_jacobian=False).pixels

    def _roll(self, t_s: Floats, pixels: Floats) -> None:
        """Move pixels (n, k, 2), in place, to where they are when their own row is exposed: t = t_frame + v delay.

        The row changes nearly linearly over an exposure: secants, first over the whole of it, soon find the instant.
        """
        height, delay_s = self.camera.resolution[1], self.camera.line_delay_s
        with np.errstate(invalid="ignore"):
            near = np.abs(pixels[..., 1] - height / 2) < height
        frame, point = np.nonzero(near)
        start_s, points = t_s[frame], self.points[point]
        before_s, before = start_s, pixels[near]
        slope = (self._at_once(t_s + height * delay_s)[near][:, 1] - before[:, 1]) / (height * delay_s)
        now_s = start_s + delay_s * before[:, 1] / (1 - delay_s * np.nan_to_num(slope))
        for _ in range(_SEARCHES):
            R, p = self.path.pose(now_s)
            now = self._project(np.einsum("nji,nj->ni", R, points - p))
            step = now_s - before_s
            np.divide(now[:, 1] - before[:, 1], step, out=slope, where=np.abs(step) > _SETTLED_S)
            next_s = (start_s + delay_s * (now[:, 1] - slope * now_s)) / (1 - delay_s * slope)
            before_s, before, now_s = now_s, now, np.where(np.isfinite(next_s), next_s, now_s)
            if np.abs(now_s - before_s).max(initial=0.0) < _SETTLED_S:
                break
        pixels[~near] = np.nan
        pixels[near] = before


def simulated_frames(
    scenario: CameraImuScenario,
    truth: CameraCalibration,
    view: View,
    *,
    stated: Camera,
    exposure_s: Floats,
    clock_offset_s: float,
    streams: FrameStreams,
) -> tuple[CameraFrames, CameraTruth, CameraCalibration]:
    """Return the frames of a camera, what is true of them, and the true camera with the clocks' offset in its shift.

    Parameters
    ----------
    scenario : what to simulate
    truth : the true camera
    view : what it sees
    stated : the camera that goes with the recording
    exposure_s : (n,) instants at which it exposes, on the IMU's clock [s]
    clock_offset_s : added to its timestamps
    streams : random numbers
    """
    offset_ns = round(clock_offset_s * 1e9)
    stamp_ns, late = _stamps(scenario, truth.time_shift_cam_imu, exposure_s, offset_ns, streams)
    kept = streams.dropped.random(len(exposure_s)) >= scenario.dropped_frames
    kept &= outside_gaps(exposure_s, scenario.camera_gaps_s)
    order = np.argsort(stamp_ns, kind="stable")
    order = order[kept[order]]
    pixels, seen = view.corners(exposure_s)
    if scenario.target_type not in {"aprilgrid", "charuco"}:  # detected whole or not at all
        seen &= seen.all(axis=1, keepdims=True)
    detected, outlier, shifted = _detected(scenario, pixels, streams)
    chosen = seen[order]
    frame, point = np.nonzero(chosen)
    frames = CameraFrames(t_ns=stamp_ns[order], frame=frame, point=point, pixels=detected[order][chosen], camera=stated)
    return (
        frames,
        CameraTruth(
            exposure_s=exposure_s[order],
            late=late[order],
            shifted=shifted[order],
            pixels=pixels[order][chosen],
            outlier=outlier[order][chosen],
            visible=float(chosen.mean()) if chosen.size else 0.0,
        ),
        replace(truth, time_shift_cam_imu=truth.time_shift_cam_imu - offset_ns * 1e-9),
    )


def _stamps(
    scenario: CameraImuScenario, time_shift_s: float, exposure_s: Floats, offset_ns: int, streams: FrameStreams
) -> tuple[Integers, Booleans]:
    """Return the timestamps [ns], and which of them are late."""
    late = streams.late.random(len(exposure_s)) < scenario.late_frames
    error_s = np.where(late, streams.late.uniform(*LATE_S, len(exposure_s)), 0.0)
    error_s += scenario.camera_jitter_s * streams.jitter.standard_normal(len(exposure_s))
    own_s = exposure_s - time_shift_s + error_s
    return START_NS + offset_ns + np.rint(own_s * 1e9).astype(np.int64), late


def _detected(
    scenario: CameraImuScenario, pixels: Floats, streams: FrameStreams
) -> tuple[Floats, NDArray[np.bool_], NDArray[np.bool_]]:
    """Return where corners are detected (n, k, 2), which of them are outliers (n, k), which frames are shifted (n,)."""
    detected = pixels + scenario.pixel_noise_px * streams.pixel_noise.standard_normal(pixels.shape)
    outlier = np.zeros(pixels.shape[:2], dtype=bool)
    if scenario.outliers:
        outlier = streams.outliers.random(pixels.shape[:2]) < scenario.outliers
        length = scenario.outlier_px * streams.outliers.uniform(0.5, 1.5, pixels.shape[:2])
        detected += np.where(outlier, length, 0.0)[..., None] * _directions(pixels.shape[:2], streams.outliers)
    shifted = streams.shifted.random(len(pixels)) < scenario.shifted_frames
    shift = scenario.shift_px * _directions((len(pixels),), streams.shifted)
    detected += np.where(shifted[:, None], shift, 0.0)[:, None]
    width, height = scenario.resolution
    return np.clip(detected, 0.0, (width - 1.0, height - 1.0)), outlier, shifted


def _directions(shape: tuple[int, ...], rng: np.random.Generator) -> Floats:
    angle = rng.uniform(0, 2 * np.pi, shape)
    return np.stack([np.cos(angle), np.sin(angle)], axis=-1)


def outside_gaps(t_s: Floats, gaps_s: tuple[tuple[float, float], ...]) -> Booleans:
    """Return which instants (n,) are in none of the gaps (start, length) [s]."""
    kept = np.ones(len(t_s), dtype=bool)
    for start, length in gaps_s:
        kept &= (t_s < start) | (t_s >= start + length)
    return kept


@value_class
class TrueTrajectory:
    """Motion of an IMU.

    Attributes
    ----------
    t_s : (n,) instants at which the recorded samples were taken [s on the clock of imu0 from the start]
    p_target_imu : (n, 3) origin of the IMU in the target's frame [m]
    R_target_imu : (n, 3, 3)
    velocity, acceleration : (n, 3) of the origin, in the target's frame [m/s], [m/s^2]
    omega_imu : (n, 3) angular rate that a gyroscope feels, the Earth's included, frame of the IMU [rad/s]
    alpha_imu : (n, 3) its derivative by time [rad/s^2]
    f_imu : (n, 3) specific force at the origin, frame of the IMU [m/s^2]
    path : of cam0, in closed form
    T_cam0_imu : (4, 4)
    start_ns : timestamp of t = 0 [ns]
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

    @classmethod
    def of(cls, scenario: CameraImuScenario, path: CameraPath, T_cam0_imu: Floats, t_s: Floats) -> Self:
        """Return the motion at instants (n,) [s] of what is carried along a path."""
        motion = path.at(t_s).of(T_cam0_imu)
        R, earth = motion.R_target_body, earth_rate_target(scenario)
        # The board turns with the Earth: Coriolis' acceleration; the centrifugal one is part of gravity.
        acceleration = motion.acceleration + 2 * np.cross(earth, motion.velocity) - gravity_target(scenario)
        earth_body = earth @ R
        return cls(
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

    @property
    def q_target_imu_wxyz(self) -> Floats:
        """Attitude, (n, 4), v_target = q v_imu q*."""
        phi = rotvec_from_rotation(self.R_target_imu)
        return rotvec_quaternions(phi, np.ones((len(phi), 1)))

    def at(self, t_s: Floats) -> RigidMotion:
        """Return the exact motion of the IMU against the target at any instants (k,) [s from the start]."""
        return self.path.at(t_s).of(self.T_cam0_imu)


@value_class
class SimulatedImu:
    """The samples of one IMU, and what is true of them.

    Attributes
    ----------
    samples : as recorded
    sensor : its true parameters
    calibration : what is to be estimated; biases are means over the recording
    trajectory : motion of its frame at the samples of the gyroscope
    b_a, b_g : (k, 3), (n, 3) true biases at the recorded samples [m/s^2], [rad/s]
    """

    samples: ImuSamples
    sensor: ImuTruth
    calibration: ImuCalibration
    trajectory: TrueTrajectory
    b_a: Floats
    b_g: Floats


@value_class
class ImuStreams:
    """Random numbers of one IMU, one stream a purpose."""

    accelerometer_noise: np.random.Generator
    gyroscope_noise: np.random.Generator
    accelerometer_walk: np.random.Generator
    gyroscope_walk: np.random.Generator
    dropped_samples: np.random.Generator
    imu_jitter: np.random.Generator
    accelerometer_instants: np.random.Generator
    phase: np.random.Generator

    @classmethod
    def spawned(cls, seed: int, number: int) -> Self:
        """Return the streams of imu1, imu2, ... that follow from a recording's seed."""
        purposes = [stream.name for stream in fields(cls)]
        return cls(**dict(zip(purposes, np.random.default_rng((seed, number)).spawn(len(purposes)), strict=True)))


@value_class
class _Instants:
    """When samples are taken.

    Attributes
    ----------
    rate_hz : how many a second
    t_s : (n,) [s on the clock of imu0 from the start]
    stamp_ns : (n,) what the IMU's own clock says then [ns]
    kept : (n,) whether the sample is recorded
    """

    rate_hz: float
    t_s: Floats
    stamp_ns: Integers
    kept: Booleans


def simulated_imu(
    scenario: CameraImuScenario,
    path: CameraPath,
    T_cam0_imu: Floats,
    sensor: ImuTruth,
    streams: ImuStreams,
    *,
    topic: str = "/imu0",
) -> SimulatedImu:
    """Return what an IMU records of a path.

    Parameters
    ----------
    scenario : what to simulate
    path : of cam0
    T_cam0_imu : (4, 4) of this IMU
    sensor : its true parameters
    streams : random numbers
    topic : ROS topic
    """
    gyroscope, accelerometer = _instants(scenario, sensor, streams)
    motion = TrueTrajectory.of(scenario, path, T_cam0_imu, gyroscope.t_s)
    felt = motion
    if accelerometer is not gyroscope or sensor.accelerometer_shift_s:
        felt = TrueTrajectory.of(scenario, path, T_cam0_imu, accelerometer.t_s + sensor.accelerometer_shift_s)
    f = felt.f_imu
    if sensor.places_m.any():
        f = f + along_axes(acceleration_by_place(felt.omega_imu, felt.alpha_imu), sensor.places_m)
    ideal, noise = sensor.calibration(np.zeros(3), np.zeros(3)), sensor.noise
    assert ideal.gyroscope is not None
    b_a = sensor.b_a + _walk(noise["accelerometer_random_walk"], accelerometer.t_s, streams.accelerometer_walk)
    b_g = sensor.b_g + _walk(noise["gyroscope_random_walk"], gyroscope.t_s, streams.gyroscope_walk)
    force = f @ ideal.required_accelerometer.sensitivity.T + b_a
    rate = motion.omega_imu @ ideal.gyroscope.sensitivity.T
    rate = rate + motion.f_imu @ ideal.gyroscope.g_sensitivity.T + b_g
    for name, values, instants, limit in (
        ("accelerometer", force, accelerometer, scenario.accelerometer_range),
        ("gyroscope", rate, gyroscope, scenario.gyroscope_range),
    ):
        sigma = noise[f"{name}_noise_density"] * np.sqrt(instants.rate_hz)
        np.add(values, sigma * getattr(streams, f"{name}_noise").standard_normal(values.shape), out=values)
        if limit is not None:
            np.clip(values, -limit, limit, out=values)
    b_a, b_g = b_a[accelerometer.kept], b_g[gyroscope.kept]
    if not gyroscope.kept.all():
        motion = TrueTrajectory.of(scenario, path, T_cam0_imu, gyroscope.t_s[gyroscope.kept])
    return SimulatedImu(
        samples=ImuSamples(
            accelerometer=_recorded(accelerometer, force, "m/s^2"),
            gyroscope=_recorded(gyroscope, rate, "rad/s"),
            noise=sensor.nominal,
            topic=topic,
        ),
        sensor=sensor,
        calibration=sensor.calibration(b_a.mean(axis=0), b_g.mean(axis=0)),
        trajectory=motion,
        b_a=b_a,
        b_g=b_g,
    )


def _instants(scenario: CameraImuScenario, sensor: ImuTruth, streams: ImuStreams) -> tuple[_Instants, _Instants]:
    """Return when gyroscope and accelerometer are read: the same where they share their timestamps."""
    further = sensor.T_imu_body is not None
    rate_hz = (scenario.further_imu_rate_hz if further else None) or scenario.imu_rate_hz
    start_s = streams.phase.random() / rate_hz if further else 0.0
    gyroscope = _sampled(scenario, sensor, rate_hz, start_s, (streams.dropped_samples, streams.imu_jitter))
    own_hz = scenario.accelerometer_rate_hz
    if own_hz is None:
        return gyroscope, gyroscope
    rng = streams.accelerometer_instants
    return gyroscope, _sampled(scenario, sensor, own_hz, rng.random() / own_hz, (rng, rng))


def _sampled(
    scenario: CameraImuScenario,
    sensor: ImuTruth,
    rate_hz: float,
    start_s: float,
    streams: tuple[np.random.Generator, np.random.Generator],
) -> _Instants:
    """Return instants, with random numbers for the samples that are lost, and for errors of the timestamps."""
    t_s = start_s + np.arange(int((scenario.duration_s - start_s) * rate_hz + 1e-6) + 1) / rate_hz
    dropped, jitter = streams
    kept = dropped.random(len(t_s)) >= scenario.dropped_samples
    kept &= outside_gaps(t_s, scenario.imu_gaps_s)
    error_s = scenario.imu_jitter_s * jitter.standard_normal(len(t_s))
    own_s = t_s - sensor.time_shift_s + error_s
    stamp_ns = START_NS + sensor.clock_offset_ns + np.rint(own_s * 1e9).astype(np.int64)
    return _Instants(rate_hz=rate_hz, t_s=t_s, stamp_ns=stamp_ns, kept=kept)


def _recorded(instants: _Instants, values: Floats, unit: str) -> TriadSamples:
    return TriadSamples(t_ns=instants.stamp_ns[instants.kept], values=values[instants.kept], unit=unit)


def _walk(density: float, t_s: Floats, rng: np.random.Generator) -> Floats:
    """Return random walks (n, 3) that start from zero."""
    steps = rng.standard_normal((len(t_s), 3))
    steps[0] = 0.0
    steps[1:] *= density * np.sqrt(np.diff(t_s))[:, None]
    return np.cumsum(steps, axis=0)
