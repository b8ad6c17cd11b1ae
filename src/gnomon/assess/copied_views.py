"""Views that are copies of others, corner by corner: they count once."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from ..findings import Finding, make_finding
from ..recording import CameraFrames, Recording

_FEW = 0.02


def without_copies(recording: Recording) -> tuple[Recording, tuple[Finding, ...]]:
    """Return a recording of cameras in which every view is there once, and what there is to say of the copies.

    Noise makes the corners of two images differ, also of a board that does not move: what is equal to the last digit is
    the same image, copied or delivered again.
    """
    cameras: dict[str, CameraFrames] = {}
    findings: list[Finding] = []
    for name, frames in recording.cameras.items():
        copies, views = _copies(frames)
        cameras[name] = frames
        if copies:
            kept = ~np.isin(frames.frame, list(copies))
            sigma = None if frames.sigma_px is None else frames.sigma_px[kept]
            cameras[name] = replace(
                frames, frame=frames.frame[kept], point=frames.point[kept], pixels=frames.pixels[kept], sigma_px=sigma
            )
            findings.append(_finding(name, copies, views))
    return (replace(recording, cameras=cameras), tuple(findings)) if findings else (recording, ())


def _copies(frames: CameraFrames) -> tuple[dict[int, int], int]:
    """Return the frames whose corners are those of an earlier one -> that one, and how many frames have corners."""
    shown, first = np.unique(frames.frame, return_index=True)
    ends = np.append(first, len(frames.frame))
    seen: dict[bytes, int] = {}
    copies: dict[int, int] = {}
    for k, frame in enumerate(shown.tolist()):
        part = slice(ends[k], ends[k + 1])
        order = np.argsort(frames.point[part], kind="stable")
        key = frames.point[part][order].tobytes() + frames.pixels[part][order].tobytes()
        if seen.setdefault(key, frame) != frame:
            copies[frame] = seen[key]
    return copies, len(shown)


def _finding(name: str, copies: Mapping[int, int], views: int) -> Finding:
    share = len(copies) / views
    frame, original = next(iter(copies.items()))
    return make_finding(
        "views-copied",
        severity="warning" if share > _FEW else "info",
        name=name,
        count=len(copies),
        views=views,
        frame=frame + 1,
        original=original + 1,
    )
