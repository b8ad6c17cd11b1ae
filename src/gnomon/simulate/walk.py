"""A rig that is carried round a closed circuit, and the landmarks that its camera sees on the way.

Nothing is rendered: landmarks lie at both sides of the way and are seen through each other, and a track is where one
is, off by noise. The path is an ellipse with the steps and the sway of a walk, in closed form (`camera_imu_path`).
"""

from dataclasses import replace

import numpy as np

from ..frozen import value_class
from ..recording import Floats, ImuSamples, Integers
from .camera_imu_path import COORDINATES, CameraPath
from .camera_imu_rig import ImuTruth
from .camera_imu_streams import ImuStreams, TrueTrajectory, simulated_imu
from .scenarios.camera_imu import CameraImuScenario


@value_class(eq=True)
class WalkScenario:
    """A walk round a circuit."""

    length_m: tuple[float, float] = (60.0, 120.0)
    """Shortest and longest way round, in metres."""

    speed_m_s: tuple[float, float] = (1.0, 1.4)
    """Slowest and fastest walk."""

    imu_rate_hz: float = 200.0
    """Sample rate of the IMU."""

    camera_rate_hz: float = 10.0
    """Images of which the tracks are used."""

    landmarks_per_m: float = 16.0
    """Landmarks along the way, 1.5 to 4 m aside of it."""

    pixel_noise_px: float = 0.5
    """Standard deviation of a track's place, per axis."""

    focal_px: float = 460.0
    """Focal length of the lens, which is taken to be known."""

    half_image_px: tuple[float, float] = (320.0, 240.0)
    """Half of the image's width and height."""

    longest: int = 12
    """Images in which a landmark is followed at most; then a new track begins."""

    lost: float = 0.02
    """Fraction of the tracks that are lost from image to image."""


@value_class
class SimulatedWalk:
    """What a rig records on its way, and what is true of it.

    Attributes
    ----------
    length_m, duration_s : of the way
    samples : of the IMU
    stamp_s : (k,) timestamps of the images on the clock of the IMU, without the time shift [s]
    imu_t_s : (n,) of the samples, on the same clock [s]
    R_world_imu, p_world_imu, velocity : (k, 3, 3), (k, 3), (k, 3) at the images [m] [m/s]
    b_a, b_g : (3,) biases at the first sample [m/s^2], [rad/s]
    gravity : (3,) in the world, whose y axis points up [m/s^2]
    last, count, rays : tracks, as `estimate.invariant_filter.Sightings`
    """

    length_m: float
    duration_s: float
    samples: ImuSamples
    stamp_s: Floats
    imu_t_s: Floats
    R_world_imu: Floats
    p_world_imu: Floats
    velocity: Floats
    b_a: Floats
    b_g: Floats
    gravity: Floats
    last: Integers
    count: Integers
    rays: Floats


_DEPTH_M = (0.5, 8.0)
_FEWEST = 4
_MARGIN_S = 0.1


def simulate_walk(
    scenario: WalkScenario, sensor: ImuTruth, T_cam_imu: Floats, time_shift_s: float, seed: int
) -> SimulatedWalk:
    """Return a walk round a circuit with a given rig.

    Parameters
    ----------
    scenario : what to simulate
    sensor : the true IMU
    T_cam_imu : (4, 4) true
    time_shift_s : t_imu - t_cam [s]
    seed : of the way, of the landmarks and of all noise
    """
    for_path, for_points, for_tracks, for_imu = np.random.default_rng(seed).spawn(4)
    length_m, duration_s = (float(for_path.uniform(*limits)) for limits in (scenario.length_m, (0.0, 1.0)))
    duration_s = length_m / (scenario.speed_m_s[0] + duration_s * np.ptp(scenario.speed_m_s))
    path = _walked(length_m, duration_s, for_path)
    rig = CameraImuScenario(
        duration_s=duration_s + 2 * _MARGIN_S, imu_rate_hz=scenario.imu_rate_hz, board_lean_deg=0.0, board_turn_deg=0.0
    )
    imu = simulated_imu(rig, path, T_cam_imu, sensor, ImuStreams.spawned(int(for_imu.integers(2**63)), 0))
    images = max(2, round(duration_s * scenario.camera_rate_hz) + 1)
    exposed_s = _MARGIN_S + np.linspace(0.0, duration_s, images)
    at = TrueTrajectory.of(rig, path, T_cam_imu, exposed_s)
    R, p = path.pose(exposed_s)
    points = _landmarks(scenario, half_axes(path), length_m, for_points)
    last, count, rays = _tracks(scenario, np.swapaxes(R, 1, 2), p, points, for_tracks)
    return SimulatedWalk(
        length_m=length_m,
        duration_s=duration_s,
        samples=imu.samples,
        stamp_s=exposed_s - time_shift_s,
        imu_t_s=imu.trajectory.t_s,
        R_world_imu=at.R_target_imu,
        p_world_imu=at.p_target_imu,
        velocity=at.velocity,
        b_a=imu.b_a[0],
        b_g=imu.b_g[0],
        gravity=np.array([0.0, -rig.gravity, 0.0]),
        last=last,
        count=count,
        rays=rays,
    )


_SWAYS = (  # coordinate, rms, lowest and highest frequency [Hz], sinusoids
    ("yaw", 0.14, 0.1, 0.8, 4),
    ("pitch", 0.07, 0.1, 0.8, 4),
    ("roll", 0.05, 0.1, 0.8, 4),
    ("pitch", 0.012, 1.7, 2.0, 1),
    ("roll", 0.02, 0.85, 1.0, 1),
    ("shake_y", 0.018, 1.7, 2.0, 1),
    ("shake_x", 0.015, 0.85, 1.0, 1),
    ("shake_z", 0.015, 0.85, 1.0, 1),
)
"""A step takes half a second: the body rises with each, and sways with every other."""


def path_of_walk(scenario: CameraImuScenario, middle: Floats, rng: np.random.Generator) -> CameraPath:
    """Draw cam0's path once round an ellipse, about where it would be waved before a board at `middle` (3,) [m]."""
    speed_m_s = float(rng.uniform(*WalkScenario().speed_m_s))
    path = _walked(speed_m_s * scenario.duration_s, scenario.duration_s, rng)
    return replace(path, middle=middle, offset=scenario.distance_m * np.eye(len(COORDINATES))[-1])


def half_axes(path: CameraPath) -> Floats:
    """Return the two half axes of the ellipse of a walk with their signs, along x and z (2,) [m]."""
    return path.amplitude[[COORDINATES.index("shake_x"), COORDINATES.index("shake_z")], [0, 1]]


def _walked(length_m: float, duration_s: float, rng: np.random.Generator) -> CameraPath:
    pulsation, phase, places, sizes = list[float](), list[float](), list[int](), list[float]()

    def add(name: str, size: float, frequency_hz: float, start: float) -> None:
        places.append(COORDINATES.index(name))
        sizes.append(size)
        pulsation.append(2 * np.pi * frequency_hz)
        phase.append(start)

    side = 1.0 if rng.random() < 0.5 else -1.0
    slender = rng.uniform(0.05, 0.25)
    mean_m = length_m / (2 * np.pi * (1 + slender**2 / 4))
    half = np.array([side * mean_m * (1 + slender), -mean_m * (1 - slender)])
    add("shake_x", half[0], 1 / duration_s, np.pi / 2)
    add("shake_z", half[1], 1 / duration_s, 0.0)
    for name, rms, low_hz, high_hz, count in _SWAYS:
        for frequency_hz in low_hz * (high_hz / low_hz) ** ((np.arange(count) + rng.random(count)) / count):
            add(name, rms * float(np.sqrt(2 / count)), float(frequency_hz), float(rng.uniform(0, 2 * np.pi)))
    amplitude = np.zeros((len(COORDINATES), len(places)))
    amplitude[places, range(len(places))] = sizes
    slope = np.zeros(len(COORDINATES))
    slope[COORDINATES.index("azimuth")] = side * 2 * np.pi / duration_s
    return CameraPath(
        middle=np.zeros(3),
        offset=np.zeros(len(COORDINATES)),
        slope=slope,
        pulsation=np.array(pulsation),
        phase=np.array(phase),
        amplitude=amplitude,
    )


def _landmarks(scenario: WalkScenario, half: Floats, length_m: float, rng: np.random.Generator) -> Floats:
    """Return points (n, 3) at both sides of the way, from the floor to above the head [m]."""
    count = round(scenario.landmarks_per_m * length_m)
    angle = rng.uniform(0, 2 * np.pi, count)
    on_way = np.stack([half[0] * np.cos(angle), half[1] * np.sin(angle)], axis=1)
    normal = np.stack([np.cos(angle) / half[0], np.sin(angle) / half[1]], axis=1)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    aside = rng.uniform(1.5, 4.0, count) * rng.choice([-1.0, 1.0], count)
    flat = on_way + normal * aside[:, None]
    return np.stack([flat[:, 0], rng.uniform(-1.5, 1.2, count), flat[:, 1]], axis=1)


def _tracks(
    scenario: WalkScenario, C: Floats, p: Floats, points: Floats, rng: np.random.Generator
) -> tuple[Integers, Integers, Floats]:
    """Return the tracks of landmarks (n, 3) in cameras C (k, 3, 3) R_cam_world at p (k, 3)."""
    width, noise = scenario.longest, scenario.pixel_noise_px / scenario.focal_px
    limit = np.array(scenario.half_image_px) / scenario.focal_px
    with np.errstate(divide="ignore", invalid="ignore"):
        place = np.einsum("kij,knj->kni", C, points - p[:, None])
        seen = np.abs(place[..., :2] / place[..., 2:])
    seen = (seen < limit).all(axis=2) & (place[..., 2] > _DEPTH_M[0]) & (place[..., 2] < _DEPTH_M[1])
    kept = rng.random(seen.shape) >= scenario.lost
    age = np.zeros(len(points), dtype=np.int64)
    last: list[Integers] = []
    count: list[Integers] = []
    which: list[Integers] = []
    for k in range(len(p)):
        age = np.where(seen[k], np.where(kept[k], age, 0) + 1, 0)
        goes_on = seen[k + 1] & kept[k + 1] if k + 1 < len(p) else np.zeros(len(points), dtype=bool)
        ends = np.flatnonzero((age >= width) | ((age >= _FEWEST) & ~goes_on))
        last.append(np.full(len(ends), k))
        count.append(age[ends])
        which.append(ends)
        age[age >= width] = 0
    ends, counts, point = (np.concatenate(parts) for parts in (last, count, which))
    images = ends[:, None] - np.arange(width)[::-1]
    there = place[np.maximum(images, 0), point[:, None]]
    own = np.arange(width) >= width - counts[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        rays = there[..., :2] / there[..., 2:]
    rays = np.where(own[..., None], rays + noise * rng.standard_normal(rays.shape), 0.0)
    return ends, counts, rays
