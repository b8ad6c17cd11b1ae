"""What the cameras see: exact corners of every frame, and what a detector and a clock make of them."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ..frozen import value_class
from ..models.camera import Booleans, Camera
from ..recording import CameraFrames, Floats, Integers
from ..results.calibration import CameraCalibration
from .camera_imu_path import CameraPath
from .scenarios.camera_imu import CameraImuScenario

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
