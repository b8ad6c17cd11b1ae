"""The data doctor's look at views of a board, before lenses are estimated from them."""

import numpy as np

from ..detect.boards.board import BoardView
from ..detect.boards.tag_spacing import tag_spacing
from ..findings import Finding, make_finding
from ..models.target import Target
from ..recording import CameraFrames, Integers, Recording
from .camera_checks import impossible
from .camera_views import FEWEST_CORNERS, Views, views
from .handedness import check_handedness
from .image_checks import check_quality

FEWEST_VIEWS = 3
"""Fewer views of a plane do not determine the intrinsics of a pinhole."""

ENOUGH_VIEWS = 10
_OTHER_GAP = 0.03
_MOST_LOOKED_AT = 60


def check_views(recording: Recording, target: Target) -> tuple[Finding, ...]:
    """Look at the views of a board and say what is good or bad about them.

    Codes: cameras-missing, frames-backward, corners-unknown, corners-outside, views, views-few, board-mirrored,
    tag-spacing, and those of the images.

    Returns
    -------
    Findings camera by camera; severity "problem" means that they cannot be calibrated.
    """
    if not recording.cameras:
        return (make_finding("cameras-missing/views"),)
    return tuple(
        finding for name, frames in recording.cameras.items() for finding in _check_camera(name, frames, target)
    )


def _check_camera(name: str, frames: CameraFrames, target: Target) -> list[Finding]:
    wrong = impossible(name, frames, target)
    if wrong is not None:
        return [wrong]
    seen = views(frames, target)
    findings = [_count(name, frames, seen)]
    if frames.quality is not None:
        findings += check_quality(name, frames.quality, len(frames.frame), frames.sigma_px)
    if findings[0].severity != "problem":
        findings += check_handedness(name, frames, seen.frame[seen.usable], target)
        findings += _spacing(name, frames, seen.frame[seen.usable], target)
    return findings


def _count(name: str, frames: CameraFrames, seen: Views) -> Finding:
    usable = int(np.count_nonzero(seen.usable))
    message = (
        f"{name}: {len(frames.t_ns)} images, the board in {usable} of them ({FEWEST_CORNERS} corners or more, not on "
        "one line)."
    )
    if usable >= ENOUGH_VIEWS:
        return make_finding("views", message=message)
    few = usable < FEWEST_VIEWS
    return make_finding(
        "views-few/found",
        severity="problem" if few else "warning",
        case="few" if few else "",
        message=message,
        fewest_views=FEWEST_VIEWS,
    )


def _spacing(name: str, frames: CameraFrames, usable: Integers, target: Target) -> list[Finding]:
    """Say that the gap between the tags contradicts the images, whatever the lens."""
    if target.kind != "aprilgrid":
        return []
    chosen = usable[:: max(len(usable) // _MOST_LOOKED_AT, 1)]
    ends = np.searchsorted(frames.frame, [chosen, chosen + 1])
    gap = tag_spacing([_board_view(frames, first, last) for first, last in ends.T], target)
    if gap is None or abs(gap - target.tag_spacing) <= _OTHER_GAP:
        return []
    return [make_finding("tag-spacing/implausible", name=name, gap=gap, tag_spacing=target.tag_spacing)]


def _board_view(frames: CameraFrames, first: int, last: int) -> BoardView:
    order = first + np.argsort(frames.point[first:last])
    return BoardView(point=frames.point[order], pixels=frames.pixels[order], sigma_px=np.ones(len(order)))
