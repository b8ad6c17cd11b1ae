"""Images of a scene without a board -> landmarks, and where each image shows them.

follow points -> rotations, clock and axes by the gyroscope -> a first path and scene -> bundle adjustment
-> choose landmarks -> find them again in all images -> CameraFrames and Target
"""

from collections.abc import Container, Iterable, Iterator, Mapping
from dataclasses import replace

import numpy as np
from scipy.interpolate import CubicSpline

from ...detect.tracks import Landmarks, PointTracks, cut_pieces, follow_points
from ...errors import DetectionError, InitialisationError, RecordingError
from ...estimate.camera_imu.start.alignment import Alignment, align_camera, gyroscope_integral
from ...estimate.camera_imu.start.first_guess import ImuStream
from ...estimate.scene import (
    SeenTurns,
    adjust_bundle,
    attitudes_of,
    find_scene_path,
    rates_by_camera,
    turning_poses,
    turns_between,
)
from ...findings import Finding, make_finding
from ...formats.kalibr.camchain import CameraInput
from ...frozen import value_class
from ...models.camera import Camera
from ...models.target import Target
from ...processes import results_ahead
from ...progress import Progress, Step, tell_parts
from ...recording import CameraFrames, Floats, ImuSamples, Integers
from ...recording.recording import Frame, Grey, ImageStream
from ...units import ACCELEROMETER_UNITS_M_S2, GYROSCOPE_UNITS_RAD_S

_KEYS_HZ = 5.0
_FEWEST_POINTS = 30  # in the median image
_FEWEST_LANDMARKS = 25
_FEWEST_KEYS = 4  # key frames that see a point of the map
_TURN_S = (0.1, 0.4, 0.8)  # lengths of the turns that correct the gyroscope
_STILL_PX = 1.5  # a point moves over the longest of these, median of all
_PARALLAX_RAD = 0.02  # a point is seen from as different sides, at least, by the upper tenth of the points
_NEAREST_M = 0.02  # nearer than any scene: its size is that of the accelerometer's noise
_OFF_RAD = 0.05  # sightings that contradict the first scene
_RAY_PX = 1.5
_OFF = 4.0  # sigmas of sightings that are left out
_FAINT, _PRUNED = 3.0, 3  # of a point whose sightings scatter; rounds
_SEEN_TIMES = 22.0  # landmarks that are followed through a key frame; found again there are some times as many
_MOST_LANDMARKS = 300
_ALIKE = 0.8  # correlation of landmarks in a scene that repeats itself; elsewhere 0.4 to 0.7
_COMING = 0.2, 0.3  # share of landmarks that come or go: warned of, refused; waved 0.02 to 0.05, shaken 0.09 to 0.26
_REACH_PX, _NEAR_PX = 18.0, 6.0
_SCALE_SIGMA = 7e-4  # of focal lengths that errors of few landmarks feign: as freed lenses scatter in twelve rooms


_UNSETTLED = (
    "{name}: only {count} landmarks of the scene are seen again and again where they should be. Either the rig hardly "
    "moved, or turned about one axis only: shake it along all of its axes and turn it about all of them. Or the scene "
    "does not serve: it should stand still, one to three metres away, with plenty of edges and patterns that do not "
    "repeat themselves, in light that lets images be sharp."
)


_STAYED = (
    "{name}: it hardly moved from its place, so that nothing tells how far away anything is, nor how large. Shake the "
    "rig along all of its axes, by a hand's breadth or two, and turn it about all of them."
)


_ELSEWHERE = (
    "{name}: only {count} landmarks of the first camera are seen where its stated pose puts them. Either the pose or "
    "the lens is another one, or its clock runs apart, or it never looks at the same things. Leave it out: give --cam "
    "a file of the first camera alone."
)


@value_class
class _Scene:
    """Key frames and points.

    Attributes
    ----------
    R, p : (k, 3, 3), (k, 3) poses of the world in the camera's frame at key frames [m]
    points : (n, 3) [m]
    key, point, pixels : (m,), (m,), (m, 2) sightings: key frame, point, and where [px]
    """

    R: Floats
    p: Floats
    points: Floats
    key: Integers
    point: Integers
    pixels: Floats

    def where(self, kept: np.ndarray) -> "_Scene":
        """Return the scene with some of the sightings, (m,) bool."""
        return replace(self, key=self.key[kept], point=self.point[kept], pixels=self.pixels[kept])


@value_class
class _Motion:
    """How the camera turned, by the gyroscope.

    Attributes
    ----------
    t_s : (f,) when images were exposed, on the IMU's clock [s]
    inside : (i,) images within the IMU's recording
    stream, rate : readings, and angular rate (n, 3) with the camera's corrections [rad/s]
    alignment : of the camera
    """

    t_s: Floats
    inside: Integers
    stream: ImuStream
    rate: Floats
    alignment: Alignment


def map_landmarks(
    streams: Mapping[str, ImageStream], cameras: Mapping[str, CameraInput], samples: ImuSamples, tell: Progress
) -> tuple[dict[str, CameraFrames], Target, tuple[Finding, ...]]:
    """Return where the images of cameras show the landmarks of a scene, these, and what is wrong with them.

    The first camera maps them; the others, whose poses to it are stated (`relative_pose`), find them again.

    Parameters
    ----------
    streams, cameras : images and lens of each camera
    samples : of the IMU
    tell : called with a sentence from time to time

    Raises
    ------
    DetectionError
        If there is too little to follow, or the camera stood still.
    InitialisationError
        If camera and gyroscope do not agree, or the camera turned without moving.
    RecordingError
        If the images or the samples cannot be used.
    """
    name, known = next(iter(cameras.items()))
    images, t_ns = streams[name], _timestamps(name, streams[name])
    tracks = follow_points(
        _told(_decoded(images, known.camera), f"following points in the images of {name}", len(t_ns), tell)
    )
    _check_texture(name, tracks, len(t_ns))
    stream, origin_ns = _stream(samples)
    motion = _motion(name, tracks, known.camera, np.asarray((t_ns - origin_ns) * 1e-9, np.float64), stream)
    tell("finding where the camera went, and the landmarks")
    scene, at = _first_scene(name, tracks, known.camera, motion)
    scene, landmarks = _refined(name, images, known.camera, scene, at)
    frames: dict[str, CameraFrames] = {}
    for camera, entry in cameras.items():
        tell(f"finding the landmarks in all images of {camera}")
        placed = relative_pose(known, entry)
        assert placed is not None
        T, later_s = placed
        t_ns = _timestamps(camera, streams[camera])
        t_s = np.asarray((t_ns - origin_ns) * 1e-9, np.float64) + motion.alignment.time_shift_s + later_s
        inside = np.flatnonzero((t_s > stream.t_s[0]) & (t_s < stream.t_s[-1]))
        R, p = _between(motion, at, scene, t_s[inside])
        poses = T[:3, :3] @ R, p @ T[:3, :3].T + T[:3, 3]
        reach_px = _NEAR_PX if camera == name else _REACH_PX
        seen = _found_again(streams[camera], entry.camera, landmarks, inside, poses, reach_px=reach_px)
        if (count := len(np.unique(seen.track))) < _FEWEST_LANDMARKS:
            text = _UNSETTLED if camera == name else _ELSEWHERE
            raise DetectionError(text.format(name=camera, count=count))
        frames[camera] = CameraFrames(
            t_ns=t_ns,
            frame=seen.frame,
            point=seen.track,
            pixels=seen.pixels,
            camera=entry.camera,
            T_cam_imu=entry.T_cam_imu,
            time_shift_cam_imu_s=entry.time_shift_cam_imu_s,
            lens_covariance=entry.lens_covariance,
            detector_scale_sigma=_SCALE_SIGMA,
        )
    found = [
        make_finding("scene-blurred", severity="problem" if share > _COMING[1] else "warning", name=camera, share=share)
        for camera, seen in frames.items()
        if (share := coming_and_going(seen)) > _COMING[0]
    ]
    if (likeness := landmarks.likeness()) > _ALIKE:
        found.append(make_finding("scene-repeats", name=name, likeness=likeness))
    return frames, Target.landmarks(landmarks.points), tuple(found)


def coming_and_going(frames: CameraFrames) -> float:
    """Return by what share of them the number of landmarks changes from one image to the next."""
    count = np.bincount(frames.frame)[frames.frame.min() :]
    return float(np.abs(np.diff(count)).sum() / count.sum())


def relative_pose(first: CameraInput, other: CameraInput) -> tuple[Floats, float] | None:
    """Return T_other_first (4, 4) [m], and by how much the other's time shift is larger [s], as far as it is stated."""
    if other is first:
        return np.eye(4), 0.0
    shifts = other.time_shift_cam_imu_s, first.time_shift_cam_imu_s
    later_s = 0.0 if shifts[0] is None or shifts[1] is None else shifts[0] - shifts[1]
    for one, two in ((other.T_cam_cam0, first.T_cam_cam0), (other.T_cam_imu, first.T_cam_imu)):
        if one is not None and two is not None:
            return one @ np.linalg.inv(two), later_s
    return None


def _timestamps(name: str, images: ImageStream) -> Integers:
    t_ns = np.array([frame.t_ns for frame in images.frames([])], dtype=np.int64)
    if len(t_ns) < 2 or (np.diff(t_ns) <= 0).any():
        raise RecordingError(
            f"{name}: without a board images must be in the order of time, each with its own timestamp."
        )
    return t_ns


def _refined(name: str, images: ImageStream, camera: Camera, scene: _Scene, at: Integers) -> tuple[_Scene, Landmarks]:
    """Return key frames and landmarks, found again in them, of the scene with the points that were followed."""
    rows = _chosen_sightings(scene)
    if len(rows) < _FEWEST_LANDMARKS:
        raise DetectionError(_UNSETTLED.format(name=name, count=len(rows)))
    landmarks, anchors = _cut(images, camera, scene, at[scene.key[rows]], rows), scene.key[rows]
    found = _found_again(images, camera, landmarks, at, (scene.R, scene.p), reach_px=_REACH_PX)
    scene = replace(
        scene, points=landmarks.points, key=np.searchsorted(at, found.frame), point=found.track, pixels=found.pixels
    )
    scene = _adjusted(camera, scene)
    kept = np.flatnonzero(np.bincount(scene.point, minlength=len(rows)) >= _FEWEST_KEYS)
    if len(kept) < _FEWEST_LANDMARKS or len(_good_keys(scene)) < _FEWEST_KEYS:
        raise DetectionError(_UNSETTLED.format(name=name, count=len(kept)))
    anchor = anchors[kept]
    return scene, landmarks.moved(kept, scene.points[kept], scene.R[anchor], scene.p[anchor])


def _stream(samples: ImuSamples) -> tuple[ImuStream, int]:
    """Return the readings of an IMU in SI units on one time base, and where its seconds start [ns]."""
    triads = (samples.gyroscope, samples.accelerometer)
    factors = (GYROSCOPE_UNITS_RAD_S[triads[0].unit], ACCELEROMETER_UNITS_M_S2[triads[1].unit])
    if None in factors or min(len(triad) for triad in triads) < 2:
        raise RecordingError("without a board samples of gyroscope and accelerometer in SI units are needed.")
    origin = int(min(triad.t_ns[0] for triad in triads))
    t_s, other_s = (np.asarray((triad.t_ns - origin) * 1e-9, np.float64) for triad in triads)
    rate, force = (triad.values * factor for triad, factor in zip(triads, factors, strict=True) if factor is not None)
    force = np.stack([np.interp(t_s, other_s, force[:, axis]) for axis in range(3)], axis=1)
    return ImuStream(t_s=t_s, rate=rate, force=force), origin


def _decoded(images: ImageStream, camera: Camera, wanted: Container[int] | None = None) -> Iterator[Grey]:
    """Yield images, all or some of them; a few of the next ones are being decoded meanwhile."""

    def decode(frame: Frame) -> Grey:
        image = frame.decode()
        if image.shape[::-1] != camera.resolution:
            width, height = camera.resolution
            raise RecordingError(
                f"{frame.where}: an image of {image.shape[1]} x {image.shape[0]} px, but the lens is stated for "
                f"{width} x {height} px. Give the lens of this camera at this image size."
            )
        return image

    frames = enumerate(images.frames([]))
    return results_ahead(decode, (frame for k, frame in frames if wanted is None or k in wanted))


def _told(images: Iterable[Grey], text: str, count: int, tell: Progress) -> Iterator[Grey]:
    for number, image in enumerate(images):
        if number % max(count // 10, 1) == 0:
            tell(Step(text, number, count))
        yield image


def _check_texture(name: str, tracks: PointTracks, images: int) -> None:
    found = np.bincount(tracks.frame, minlength=images)
    followed = np.bincount(tracks.track, minlength=1)[tracks.track] >= _FEWEST_KEYS
    usual = float(np.median(np.bincount(tracks.frame[followed], minlength=images)))
    if usual < _FEWEST_POINTS:
        raise DetectionError(
            f"{name}: only {usual:.0f} points can be followed from image to image (median; {np.median(found):.0f} "
            "found). Too little is to be seen: walls without texture, darkness, or blur. Point the camera at things "
            "with edges and patterns, in good light, and expose for 5 ms at most."
        )


def _motion(name: str, tracks: PointTracks, camera: Camera, t_s: Floats, stream: ImuStream) -> _Motion:
    """Return how the camera turned, in space and time of the gyroscope."""
    rays = _rays(camera, tracks.pixels)
    tolerance = _RAY_PX / float(np.mean(camera.intrinsics[-4:-2]))
    steps = [max(1, round(length / float(np.median(np.diff(t_s))))) for length in _TURN_S]
    pairs = [(k, k + 1) for k in range(len(t_s) - 1)]
    pairs += [(k, k + step) for step in steps for k in range(0, len(t_s) - step, 2)]
    R, moved, known = turns_between(rays, [tracks.shared(*pair) for pair in pairs], tolerance)
    neighbours = len(t_s) - 1
    if float(np.median(moved[neighbours:])) < _STILL_PX / _RAY_PX * tolerance:
        raise DetectionError(
            f"{name}: hardly anything moves in its images. The rig has to be turned about all axes and shaken along "
            "all of them while it records."
        )
    try:
        poses = turning_poses(t_s, R[:neighbours])
        alignment = align_camera(poses, gyroscope_integral(stream.t_s, stream.rate), name)
    except InitialisationError as error:
        raise InitialisationError(
            f"{name} and the gyroscope do not show the same rotation at any time shift, by the points that were "
            "followed: hardly anything turned, or most of the scene moves by itself, or the lens is another one, or "
            "the streams are not of one recording. Turn about all three axes, briskly, in a scene that stands still."
        ) from error
    at_s = t_s + alignment.time_shift_s
    ends = np.array(pairs)[neighbours:][known[neighbours:]]
    start, stop = at_s[ends].T
    both = (start >= stream.t_s[0]) & (stop <= stream.t_s[-1])
    if not both.any():
        raise InitialisationError(_STAYED.format(name=name))
    R_imu = alignment.R_cam_imu.T @ np.swapaxes(R[neighbours:][known[neighbours:]], 1, 2) @ alignment.R_cam_imu
    turns = SeenTurns(start_s=start[both], stop_s=stop[both], R=R_imu[both])
    inside = np.flatnonzero((at_s > stream.t_s[0]) & (at_s < stream.t_s[-1]))
    return _Motion(t_s=at_s, inside=inside, stream=stream, rate=rates_by_camera(turns, stream), alignment=alignment)


def _rays(camera: Camera, pixels: Floats) -> Floats:
    rays, known = camera.unproject(pixels)
    rays = np.where(known[:, None], rays, (0.0, 0.0, -1.0))
    return rays / np.linalg.norm(rays, axis=1, keepdims=True)


def _first_scene(name: str, tracks: PointTracks, camera: Camera, motion: _Motion) -> tuple[_Scene, Integers]:
    """Return a scene with the points that were followed, and the images that are its key frames."""
    step = max(1, round(1 / (_KEYS_HZ * float(np.median(np.diff(motion.t_s))))))
    at = motion.inside[::step]
    tracks = tracks.where(np.isin(tracks.frame, at))
    tracks = tracks.where(np.bincount(tracks.track)[tracks.track] >= _FEWEST_KEYS)
    _, point = np.unique(tracks.track, return_inverse=True)
    key, stream = np.searchsorted(at, tracks.frame), motion.stream
    if len(at) < _FEWEST_KEYS or not len(point):
        raise DetectionError(f"{name}: no point is seen for long enough to tell where it is. Move more slowly.")
    R_imu = attitudes_of(motion.rate, stream.t_s, motion.t_s[at])
    R_world_cam = R_imu @ motion.alignment.R_cam_imu.T
    rays = np.einsum("mij,mj->mi", R_world_cam[key], _rays(camera, tracks.pixels))
    path = find_scene_path(
        motion.t_s[at], R_imu, stream, attitudes_of(motion.rate, stream.t_s, stream.t_s), (key, point, rays)
    )
    toward = np.zeros((len(path.points), 3))
    np.add.at(toward, point, rays)
    spread = np.sqrt(np.maximum(1 - np.linalg.norm(toward, axis=1) / np.bincount(point), 0.0))
    if float(np.quantile(spread, 0.9)) < _PARALLAX_RAD:
        raise InitialisationError(_STAYED.format(name=name))
    centre = path.position + R_imu @ path.arm
    R = np.swapaxes(R_world_cam, 1, 2)
    scene = _Scene(
        R=R, p=-np.einsum("kij,kj->ki", R, centre), points=path.points, key=key, point=point, pixels=tracks.pixels
    )
    scene = _adjusted(camera, scene.where(path.angle < _OFF_RAD))
    if not len(scene.point):
        raise InitialisationError(_STAYED.format(name=name))
    found = -np.einsum("kji,kj->ki", scene.R, scene.p)  # the adjustment leaves the size open
    size = float(np.linalg.norm(centre - centre.mean(axis=0)) / np.linalg.norm(found - found.mean(axis=0)))
    away_m = size * np.linalg.norm(scene.points[scene.point] - found[scene.key], axis=1)
    if float(np.median(away_m)) < _NEAREST_M:
        raise InitialisationError(_STAYED.format(name=name))
    return replace(scene, p=size * scene.p, points=size * scene.points), at


def _adjusted(camera: Camera, scene: _Scene) -> _Scene:
    """Return the scene after bundle adjustment, without sightings that contradict it, and points whose mean does."""
    for _ in tell_parts("adjusting where the camera went", range(_PRUNED), _PRUNED):
        if not len(scene.key):
            break
        found = adjust_bundle(camera, (scene.key, scene.point, scene.pixels), scene.R, scene.p, scene.points)
        off = np.nan_to_num(np.linalg.norm(found.residual, axis=1), nan=np.inf)
        count = np.maximum(np.bincount(scene.point, minlength=len(scene.points)), 1)
        mean = np.bincount(scene.point, np.minimum(off, 2 * _OFF * found.sigma_px), len(scene.points)) / count
        usual = (off < _OFF * found.sigma_px) & (mean < _FAINT * found.sigma_px)[scene.point]
        scene = replace(scene, R=found.R_cam_world, p=found.p_cam_world, points=found.points).where(usual)
        scene = scene.where((np.bincount(scene.point, minlength=len(scene.points)) >= _FEWEST_KEYS)[scene.point])
    return scene


def _chosen_sightings(scene: _Scene) -> Integers:
    """Return a sighting in the middle of each landmark's: points seen long, so that each key frame sees some."""
    count = np.bincount(scene.point, minlength=len(scene.points))
    keys_of = np.split(np.argsort(scene.point, kind="stable"), np.cumsum(count)[:-1])
    seen, taken = np.zeros(len(scene.R)), np.zeros(len(scene.points), dtype=bool)
    chosen: list[int] = []
    for _ in range(min(_MOST_LANDMARKS, int((count >= _FEWEST_KEYS).sum()))):
        gain = np.bincount(scene.point, np.maximum(1 - seen / _SEEN_TIMES, 0.0)[scene.key], len(scene.points))
        gain[taken] = 0.0
        best = int(gain.argmax())
        if gain[best] < 1.0:
            break
        rows = keys_of[best]
        seen[scene.key[rows]] += 1
        taken[best] = True
        chosen.append(int(rows[len(rows) // 2]))
    return np.array(chosen, dtype=np.int64)


def _cut(images: ImageStream, camera: Camera, scene: _Scene, taken: Integers, rows: Integers) -> Landmarks:
    """Return landmarks with the pieces of the images `taken` (n,) in which some sightings (n,) are."""
    key, wanted = scene.key[rows], sorted(set(taken.tolist()))
    pictures = zip(wanted, _decoded(images, camera, wanted), strict=True)
    pieces, blurred = cut_pieces(pictures, taken, scene.pixels[rows])
    return Landmarks(
        camera=camera,
        points=scene.points[scene.point[rows]],
        R_anchor=scene.R[key],
        p_anchor=scene.p[key],
        pieces=pieces,
        blurred=blurred,
    )


def _found_again(
    images: ImageStream,
    camera: Camera,
    landmarks: Landmarks,
    at: Integers,
    poses: tuple[Floats, Floats],
    *,
    reach_px: float,
) -> PointTracks:
    """Return where landmarks are in images `at` (k,), with about these poses."""
    pictures = zip(_decoded(images, camera, set(at.tolist())), *poses, strict=True)
    pictures = tell_parts("finding the landmarks in images", pictures, len(at))
    near = reach_px <= _NEAR_PX
    found = [(np.empty(0, np.int64), np.empty((0, 2)))]
    found += results_ahead(lambda one: landmarks.find(one[0], camera, *one[1:], reach_px=reach_px, near=near), pictures)
    track, pixels = (np.concatenate(part) for part in zip(*found, strict=True))
    return PointTracks(frame=np.repeat(at, [len(which) for which, _ in found[1:]]), track=track, pixels=pixels)


def _good_keys(scene: _Scene) -> Integers:
    """Return the key frames that see enough landmarks."""
    return np.flatnonzero(np.bincount(scene.key, minlength=len(scene.R)) >= _FEWEST_POINTS // 3)


def _between(motion: _Motion, at: Integers, scene: _Scene, t_s: Floats) -> tuple[Floats, Floats]:
    """Return the poses of the scene at instants (n,): turned by the gyroscope from the nearest key frame."""
    good = _good_keys(scene)
    key_s = motion.t_s[at[good]]
    nearest = np.abs(t_s[:, None] - key_s).argmin(axis=1)
    R_cam_imu = motion.alignment.R_cam_imu
    by_gyroscope = [
        R_cam_imu @ np.swapaxes(attitudes_of(motion.rate, motion.stream.t_s, some), 1, 2) for some in (t_s, key_s)
    ]
    # v_cam_then = R_then R_key' v_cam_key, by the gyroscope
    R = by_gyroscope[0] @ np.swapaxes(by_gyroscope[1][nearest], 1, 2) @ scene.R[good][nearest]
    centre = CubicSpline(key_s, -np.einsum("kji,kj->ki", scene.R[good], scene.p[good]))(t_s)
    return R, -np.einsum("kij,kj->ki", R, centre)
