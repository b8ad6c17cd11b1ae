"""What is done to sound recordings of a camera and an IMU, and to what is stated of them, to make the faults."""

from dataclasses import replace
from math import radians

import numpy as np

from gnomon.geometry.rotations import rotation_from_rotvec
from gnomon.models.target import Target
from gnomon.options import CameraImuOptions
from gnomon.recording import CameraFrames, Floats, TriadSamples
from gnomon.simulate.camera_imu_streams import View
from gnomon.simulate.scenarios.camera_imu import CameraImuScenario

from .fault_recordings import (
    accelerometer,
    delayed,
    seconds,
    simulation_of,
    some,
    sound_recording,
    warming,
    with_frames,
    with_imu,
)
from .faults import FaultyRecording, Spoil

SOUND = CameraImuScenario(duration_s=50.0, random_extrinsics=True, lever_arm_m=0.15)
"""The rig and the motion of most of the recordings."""

_MOVED_AT_S = 25.0
_LEVER_ARM_M = np.array([[0.0, 0.0, 0.0], [0.03, 0.0, 0.0], [0.0, 0.0, 0.03]])


def jumping(frames: CameraFrames, _rng: np.random.Generator) -> CameraFrames:
    """Set the camera's clock by 40 ms while it runs."""
    later = seconds(frames.t_ns) > 0.4 * seconds(frames.t_ns)[-1]
    return replace(frames, t_ns=frames.t_ns + np.where(later, 40_000_000, 0))


def drifting(frames: CameraFrames, _rng: np.random.Generator) -> CameraFrames:
    """Let the camera's clock run fast by 40 ppm."""
    return replace(frames, t_ns=frames.t_ns + np.rint(40e-6 * (frames.t_ns - frames.t_ns[0])).astype(np.int64))


def stale(frames: CameraFrames, rng: np.random.Generator) -> CameraFrames:
    """Deliver every eighth image, about, a second time in place of the next one."""
    count = len(frames.t_ns)
    source = np.arange(count)
    held = np.flatnonzero(rng.random(count - 1) < 0.12) + 1
    source[held] = source[held - 1]
    corners = [np.flatnonzero(frames.frame == k) for k in range(count)]
    chosen = np.concatenate([corners[k] for k in source])
    frame = np.repeat(np.arange(count), [len(corners[k]) for k in source])
    return replace(frames, frame=frame, point=frames.point[chosen], pixels=frames.pixels[chosen])


def other_size(frames: CameraFrames, _rng: np.random.Generator) -> CameraFrames:
    """State the intrinsics of images of half the size."""
    camera = frames.camera
    half = replace(camera, intrinsics=camera.intrinsics / 2, resolution=(320, 240))
    return replace(frames, camera=half)


def no_distortion(frames: CameraFrames, _rng: np.random.Generator) -> CameraFrames:
    """State the lens without its distortion."""
    return replace(frames, camera=replace(frames.camera, distortion="none", distortion_coeffs=np.zeros(0)))


def mirrored(case: FaultyRecording, _rng: np.random.Generator) -> FaultyRecording:
    """Exchange left and right of the images; the corners are numbered as they are seen, from the left."""
    frames, target = case.recording.cameras["cam0"], case.target
    assert target is not None
    across = 2 * target.cols
    row, column = np.divmod(frames.point, across)
    point = row * across + across - 1 - column
    order = np.lexsort((point, frames.frame))
    pixels = frames.pixels.copy()
    pixels[:, 0] = 2 * frames.camera.intrinsics[-2] - pixels[:, 0]  # a lens whose middle is the mirror's
    return with_frames(case, replace(frames, frame=frames.frame[order], point=point[order], pixels=pixels[order]))


def board_moved(case: FaultyRecording, _rng: np.random.Generator) -> FaultyRecording:
    """Let the board lean by 2 deg more, and stand 4 cm further to the side, from the middle on."""
    simulation = simulation_of(case, SOUND)
    frames, truth = simulation.recording.cameras["cam0"], simulation.frames["cam0"]
    points = simulation.target.points
    middle = points.mean(axis=0)
    turned = (points - middle) @ rotation_from_rotvec(np.radians([2.0, 0.0, 0.5])).T + middle + [0.04, 0.0, 0.0]
    camera = simulation.truth.cameras["cam0"].camera
    view = View(path=simulation.trajectory.path, T_cam_cam0=np.eye(4), camera=camera, points=turned)
    pixels, seen = view.corners(truth.exposure_s)
    later = (truth.exposure_s > _MOVED_AT_S)[frames.frame]
    moved = pixels[frames.frame, frames.point] + frames.pixels - truth.pixels
    kept = ~later | seen[frames.frame, frames.point]
    changed = np.where(later[:, None], moved, frames.pixels)[kept]
    return with_frames(case, replace(frames, frame=frames.frame[kept], point=frames.point[kept], pixels=changed))


def tag_spacing(case: FaultyRecording, _rng: np.random.Generator) -> FaultyRecording:
    """State gaps between the tags of a quarter of a tag, where they are 0.3 of it."""
    return replace(
        case, target=Target.aprilgrid(tag_cols=6, tag_rows=6, tag_size_m=SOUND.target_size_m, tag_spacing=0.25)
    )


def noise_understated(case: FaultyRecording, _rng: np.random.Generator) -> FaultyRecording:
    """State a fifth of the IMU's noise."""
    imu = case.recording.imus["imu0"]
    assert imu.noise is not None
    noise = replace(
        imu.noise,
        gyroscope_noise_density=imu.noise.gyroscope_noise_density / 5,
        accelerometer_noise_density=imu.noise.accelerometer_noise_density / 5,
    )
    return with_imu(case, replace(imu, noise=noise))


def stated(**options: object) -> Spoil:
    """Return the fault of wrong options."""

    def spoil(case: FaultyRecording, _rng: np.random.Generator) -> FaultyRecording:
        return replace(case, options=CameraImuOptions(**options))  # pyright: ignore[reportArgumentType]

    return spoil


def other_imu(case: FaultyRecording, _rng: np.random.Generator) -> FaultyRecording:
    """Take the samples of another recording."""
    seed = case.truth.provenance.seed
    assert seed is not None
    return with_imu(case, sound_recording(SOUND, seed + 1000).recording.imus["imu0"])


def late_accelerometer(case: FaultyRecording, _rng: np.random.Generator) -> FaultyRecording:
    """Let a filter delay the accelerometer by 8 ms."""
    imu = case.recording.imus["imu0"]
    return with_imu(case, replace(imu, accelerometer=delayed(imu.accelerometer, 0.008)))


def size_effect(case: FaultyRecording, _rng: np.random.Generator) -> FaultyRecording:
    """Put the accelerometer's y and z axes 3 cm beside its x axis."""
    motion = simulation_of(case, SOUND).trajectory
    spin = motion.omega_imu
    turning = np.gradient(spin, motion.t_s, axis=0)
    arms = np.cross(turning[:, None], _LEVER_ARM_M) + np.cross(spin[:, None], np.cross(spin[:, None], _LEVER_ARM_M))
    felt = np.einsum("naa->na", arms)
    return accelerometer(lambda _, values: values + felt)(case, _rng)


def vibrating(case: FaultyRecording, _rng: np.random.Generator) -> FaultyRecording:
    """Let a propeller shake accelerometer and gyroscope at 73 Hz."""

    def shaken(amplitude: float, samples: TriadSamples) -> TriadSamples:
        phase = 2 * np.pi * 73.0 * seconds(samples.t_ns)[:, None] + np.arange(3)
        return replace(samples, values=samples.values + amplitude * np.sin(phase))

    imu = case.recording.imus["imu0"]
    return with_imu(
        case, replace(imu, accelerometer=shaken(1.0, imu.accelerometer), gyroscope=shaken(0.03, imu.gyroscope))
    )


def with_gaps(samples: TriadSamples, rng: np.random.Generator) -> TriadSamples:
    """Lose the samples of a dozen gaps."""
    kept = np.ones(len(samples), dtype=bool)
    for start in rng.integers(0, len(samples) - 80, 12):
        kept[start : start + rng.integers(30, 80)] = False
    return some(samples, kept)


def jittery(samples: TriadSamples, rng: np.random.Generator) -> TriadSamples:
    """Timestamp samples when they arrive."""
    late = rng.exponential(0.9 / samples.rate_hz, len(samples)) * 1e9
    return replace(samples, t_ns=np.maximum.accumulate(samples.t_ns + late.astype(np.int64)) + np.arange(len(samples)))


def inverse_stated(case: FaultyRecording, _rng: np.random.Generator) -> FaultyRecording:
    """State the inverse of the extrinsics."""
    stated = np.linalg.inv(case.truth.cameras["cam0"].T_cam_imu)
    return with_frames(case, replace(case.recording.cameras["cam0"], T_cam_imu=stated))


def warming_up(t_s: Floats, values: Floats) -> Floats:
    """Let the bias of a gyroscope (n, 3) drift by 4 deg/s and more [rad/s]."""
    return values + radians(4.0) * warming(t_s, 20.0) * np.array([1.0, -0.6, 0.4])
