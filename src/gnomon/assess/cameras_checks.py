"""The data doctor's look at views of a board, before lenses are estimated from them."""

import numpy as np

from ..detect.boards.board import BoardView
from ..detect.boards.tag_spacing import tag_spacing
from ..findings import Finding
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
        return (
            Finding(
                severity="problem",
                code="cameras-missing",
                message="There is no camera in this recording.",
                cure="Give a folder with images, or with corners that were detected in them.",
            ),
        )
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
        return Finding(severity="good", code="views", message=message)
    few = usable < FEWEST_VIEWS
    return Finding(
        severity="problem" if few else "warning",
        code="views-few",
        message=message,
        consequence=f"A lens cannot be told from fewer than {FEWEST_VIEWS} views."
        if few
        else "Nothing is left over to test the result with, and its sigmas are rough.",
        cure="Take 20 to 60 views: near and far, tilted by 20 to 45 degrees to all four sides, and with the board in "
        "every corner of the image.",
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
    return [
        Finding(
            severity="problem",
            code="tag-spacing",
            message=f"{name}: in the images the gap between the tags is {gap:.2f} of the side of a tag; target.yaml "
            f"states tagSpacing {target.tag_spacing:.3g}.",
            consequence="Tags that are not where they are said to be bend every pose and the lens with them.",
            cure="Measure a tag and the gap beside it; tagSpacing is the gap over the side. Correct target.yaml.",
        )
    ]


def _board_view(frames: CameraFrames, first: int, last: int) -> BoardView:
    order = first + np.argsort(frames.point[first:last])
    return BoardView(point=frames.point[order], pixels=frames.pixels[order], sigma_px=np.ones(len(order)))
