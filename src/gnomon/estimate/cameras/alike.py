"""Views that are alike: their corners err alike, and they count as one where the covariance is taken from the scatter.

A detector's error depends on where in the image a corner is, how large and how tilted the board is and how it moves.
Consecutive frames of a video share all of that until the board has moved on.
"""

import numpy as np

from ...recording import Floats, Integers
from .rig import RigViews

_MOVED = 0.1  # of the image's width
_PAUSE_NS = 2_000_000_000


def views_alike(views: RigViews) -> Integers:
    """Return the number of the cluster of each view, (v,), ascending: consecutive views that look alike.

    A new cluster begins where the board's points have moved by a tenth of the image's width since its first view, in
    some camera, or where two seconds passed without a view.
    """
    places = [_places(views, number) for number in range(len(views.cameras))]
    widths = [frames.camera.resolution[0] for frames in views.cameras.values()]
    cluster, first = np.zeros(len(views), np.int64), 0
    for k in range(1, len(views)):
        moved = [_moved(place[first], place[k]) / width for place, width in zip(places, widths, strict=True)]
        on = not any(np.isfinite(moved)) or np.nanmax(moved) > _MOVED or views.t_ns[k] - views.t_ns[k - 1] > _PAUSE_NS
        cluster[k] = cluster[k - 1] + on
        first = k if on else first
    return cluster


def _places(views: RigViews, number: int) -> Floats:
    """Return where each view of a camera has each point of the board, (v, n, 2) [px]; nan where it has not."""
    frames = tuple(views.cameras.values())[number]
    seen = np.flatnonzero(views.frame[:, number] >= 0)
    of_frame = np.full(len(frames.t_ns), -1)
    of_frame[views.frame[seen, number]] = seen
    view = of_frame[frames.frame]
    found = np.full((len(views), len(views.target), 2), np.nan)
    found[view[view >= 0], frames.point[view >= 0]] = frames.pixels[view >= 0]
    return found


def _moved(before: Floats, after: Floats) -> float:
    """Return the median distance of the points that both hold; nan where these are none."""
    both = np.isfinite(before[:, 0]) & np.isfinite(after[:, 0])
    return float(np.median(np.linalg.norm(after[both] - before[both], axis=1))) if both.any() else float("nan")
