"""Boards that look the same from two ends, or four: their corners numbered alike in all frames of a camera.

From frame to frame the motion tells. Where the board was lost for longer, the gyroscope foresees how it comes back: the
frames that follow each other tell the camera's axes and clock, whatever the ends, and these tell the rest.
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from ...detect.boards.board import BoardView
from ...detect.boards.checkerboard_order import (
    OrderedViews,
    Turned,
    about_normal,
    ambiguous_turns,
    angle_between,
    consistent_order,
    renumber_view,
)
from ...errors import InitialisationError
from ...estimate.camera_imu.start.alignment import Alignment
from ...estimate.camera_imu.start.first_guess import CameraAlignment, ImuStream, align_cameras
from ...findings import Finding, make_finding
from ...geometry.rotations import rk4n_steps, rotation_from_quaternion, running_products
from ...models.target import Target
from ...recording import CameraFrames, Floats, Integers

_PAIRS = 100  # frames of two cameras that are compared


def number_cameras_alike(
    cameras: Mapping[str, CameraFrames], target: Target, origin_ns: int, stream: ImuStream
) -> tuple[dict[str, CameraFrames], tuple[Finding, ...]]:
    """Return the cameras with corners that are numbered alike, and what there is to say about it.

    Frames of which that is not certain, even with the gyroscope, lose their corners.

    Parameters
    ----------
    cameras : by name
    target : the board
    origin_ns : where the seconds of all timestamps start [ns]
    stream : of the IMU
    """
    if len(ambiguous_turns(target)) == 1:
        return dict(cameras), ()
    found: dict[str, CameraFrames] = {}
    findings: list[Finding] = []
    for name, frames in cameras.items():
        views = board_views(frames)
        ordered = consistent_order(views, frames.t_ns, target, camera=frames.camera)
        if not ordered.certain:
            ordered = _with_gyroscope(name, with_views(frames, ordered.views), target, origin_ns, stream) or ordered
        if not ordered.certain:
            ordered, lost = _longest_piece(ordered)
            findings.append(make_finding("board-ends", name=name, lost=lost, frames=len(frames.t_ns)))
        found[name] = with_views(frames, ordered.views)
    return _from_one_end(found, target, origin_ns, stream), tuple(findings)


def board_views(frames: CameraFrames) -> list[BoardView]:
    """Return the corners frame by frame."""
    edges = np.searchsorted(frames.frame, np.arange(len(frames.t_ns) + 1))
    sigma = np.ones(len(frames.frame)) if frames.sigma_px is None else frames.sigma_px
    return [
        BoardView(point=frames.point[a:b], pixels=frames.pixels[a:b], sigma_px=sigma[a:b])
        for a, b in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True)
    ]


def with_views(frames: CameraFrames, views: tuple[BoardView, ...]) -> CameraFrames:
    """Return the frames with other corners."""
    return replace(
        frames,
        frame=np.repeat(np.arange(len(views)), [len(view) for view in views]),
        point=np.concatenate([view.point for view in views]),
        pixels=np.concatenate([view.pixels for view in views]),
        sigma_px=None if frames.sigma_px is None else np.concatenate([view.sigma_px for view in views]),
    )


def _with_gyroscope(
    name: str, frames: CameraFrames, target: Target, origin_ns: int, stream: ImuStream
) -> OrderedViews | None:
    """Return the views in the order that the gyroscope foresees; None where it cannot be aligned with the camera."""
    try:
        (look,) = align_cameras({name: frames}, target, origin_ns, stream)
    except InitialisationError:
        return None
    turned = _foreseen(look.alignment, origin_ns, stream)
    return consistent_order(board_views(frames), frames.t_ns, target, camera=frames.camera, turned=turned)


def _from_one_end(
    cameras: dict[str, CameraFrames], target: Target, origin_ns: int, stream: ImuStream
) -> dict[str, CameraFrames]:
    """Return the cameras with the board numbered from the same end in all of them.

    Each camera alone may count from another end. Its frames tell the attitude of the IMU before the board; the attitude
    that the first camera tells, carried to the same instant by the gyroscope, differs from it by the turns in question.
    """
    if len(cameras) == 1:
        return cameras
    try:
        first, *others = align_cameras(cameras, target, origin_ns, stream)
    except InitialisationError:
        return cameras  # the calibration says what is wrong
    R_start_imu = _integrated(first.alignment, stream)
    found = dict(cameras)
    for look in others:
        apart = _apart(first, look, R_start_imu, stream)
        ways = ambiguous_turns(target)
        angles = [np.median([angle_between(about_normal(way), R) for R in apart]) for way in ways]
        turns = ways[int(np.argmin(angles))]
        views = tuple(renumber_view(view, target, turns) for view in board_views(look.frames))
        found[look.name] = with_views(look.frames, views)
    return found


def _apart(first: CameraAlignment, second: CameraAlignment, R_start_imu: Floats, stream: ImuStream) -> Floats:
    """Return R_target_imu by the second camera relative to that by the first, (n, 3, 3), where frames are close."""
    t_first, t_second = (look.poses.t_s + look.alignment.time_shift_s for look in (first, second))
    near = np.clip(np.searchsorted(t_first, t_second), 1, len(t_first) - 1)
    near -= np.abs(t_first[near - 1] - t_second) < np.abs(t_first[near] - t_second)
    chosen = np.argsort(np.abs(t_first[near] - t_second), kind="stable")[:_PAIRS]
    R_target_imu = [
        np.swapaxes(look.poses.R_cam_target[index], 1, 2) @ look.alignment.R_cam_imu
        for look, index in ((first, near[chosen]), (second, chosen))
    ]
    before, after = (
        np.clip(np.searchsorted(stream.t_s, t, side="right") - 1, 0, len(stream.t_s) - 1)
        for t in (t_first[near[chosen]], t_second[chosen])
    )
    carried = R_target_imu[0] @ np.swapaxes(R_start_imu[before], 1, 2) @ R_start_imu[after]
    return R_target_imu[1] @ np.swapaxes(carried, 1, 2)


def _integrated(alignment: Alignment, stream: ImuStream) -> Floats:
    """Return the attitude of the IMU at its timestamps relative to that at the first, (n, 3, 3)."""
    rate = (stream.rate - alignment.gyroscope_bias) / alignment.rate_scale
    steps = rk4n_steps(rate[:-1], rate[1:], np.diff(stream.t_s))
    products = running_products(steps, np.array([len(steps)]))
    return rotation_from_quaternion(np.concatenate([[[1.0, 0, 0, 0]], products]))


def _foreseen(alignment: Alignment, origin_ns: int, stream: ImuStream) -> Turned:
    R_start_imu = _integrated(alignment, stream)

    def sample(t_ns: int) -> int | None:
        t_s = (t_ns - origin_ns) * 1e-9 + alignment.time_shift_s
        if not stream.t_s[0] <= t_s <= stream.t_s[-1]:
            return None
        return int(np.searchsorted(stream.t_s, t_s, side="right")) - 1

    def turned(first_ns: int, second_ns: int) -> np.ndarray | None:
        first, second = sample(first_ns), sample(second_ns)
        if first is None or second is None:
            return None
        R_imu = R_start_imu[second].T @ R_start_imu[first]
        return alignment.R_cam_imu @ R_imu @ alignment.R_cam_imu.T

    return turned


def _longest_piece(ordered: OrderedViews) -> tuple[OrderedViews, int]:
    """Return the views without those outside of the longest piece, and the number of those."""
    counts: Integers = np.bincount(ordered.piece[ordered.piece >= 0])
    kept = ordered.piece == int(np.argmax(counts))
    views = tuple(view if keep else _empty(view) for view, keep in zip(ordered.views, kept.tolist(), strict=True))
    return replace(ordered, views=views), int(counts.sum() - counts.max())


def _empty(view: BoardView) -> BoardView:
    return replace(view, point=view.point[:0], pixels=view.pixels[:0], sigma_px=view.sigma_px[:0])
