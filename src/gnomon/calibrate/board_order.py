"""Boards that look the same from two ends, or four: their corners numbered alike in all frames of a camera.

From frame to frame the motion tells. Where the board was lost for longer, the gyroscope foresees how it comes back: the
frames that follow each other tell the camera's axes and clock, whatever the ends, and these tell the rest.
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from ..detect.board import BoardView
from ..detect.checkerboard_order import OrderedViews, Turned, ambiguous_turns, consistent_order
from ..errors import InitialisationError
from ..estimate.camera_imu.alignment import Alignment
from ..estimate.camera_imu.first_guess import ImuStream, looks
from ..findings import Finding
from ..geometry.quaternion import rk4n_steps, rotation_from_quaternion, running_products
from ..models.target import Target
from ..recording import CameraFrames, Integers


def numbered_alike(
    cameras: Mapping[str, CameraFrames], target: Target, origin_ns: int, stream: ImuStream
) -> tuple[dict[str, CameraFrames], tuple[Finding, ...]]:
    """Return the cameras with corners that are numbered alike, and what there is to say about it.

    Frames of which that is not certain, even with the gyroscope, lose their corners.

    Parameters
    ----------
    cameras : by name
    target : the board
    origin_ns : where the seconds of all stamps start [ns]
    stream : of the IMU
    """
    if len(ambiguous_turns(target)) == 1:
        return dict(cameras), ()
    found: dict[str, CameraFrames] = {}
    findings: list[Finding] = []
    for name, frames in cameras.items():
        views = views_of(frames)
        ordered = consistent_order(views, frames.t_ns, target, camera=frames.camera)
        if not ordered.certain:
            ordered = _with_gyroscope(name, with_views(frames, ordered.views), target, origin_ns, stream) or ordered
        if not ordered.certain:
            ordered, lost = _longest_piece(ordered)
            findings.append(_uncertain(name, lost, len(frames.t_ns)))
        found[name] = with_views(frames, ordered.views)
    return found, tuple(findings)


def views_of(frames: CameraFrames) -> list[BoardView]:
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
        (look,) = looks({name: frames}, target, origin_ns, stream)
    except InitialisationError:
        return None
    turned = _foreseen(look.alignment, origin_ns, stream)
    return consistent_order(views_of(frames), frames.t_ns, target, camera=frames.camera, turned=turned)


def _foreseen(alignment: Alignment, origin_ns: int, stream: ImuStream) -> Turned:
    rate = (stream.rate - alignment.gyroscope_bias) / alignment.rate_scale
    steps = rk4n_steps(rate[:-1], rate[1:], np.diff(stream.t_s))
    products = running_products(steps, np.array([len(steps)]))
    R_start_imu = rotation_from_quaternion(np.concatenate([[[1.0, 0, 0, 0]], products]))

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


def _uncertain(name: str, lost: int, frames: int) -> Finding:
    return Finding(
        severity="warning",
        code="board-ends",
        message=f"{name}: the board looks the same from more than one end and was out of view in between; of {lost} of "
        f"{frames} frames it is not certain which end is which.",
        consequence="These frames are left out.",
        cure="Use an AprilGrid, or a checkerboard with an even number of inner corners along one side and an odd "
        "number along the other.",
    )
