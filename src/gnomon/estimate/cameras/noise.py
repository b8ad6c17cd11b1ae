"""How corners are weighed: their scatter from the residuals, and what the detector knows of each.

Views that are alike: their corners err alike, and they count as one where the covariance is taken from the scatter.

A detector's error depends on where in the image a corner is, how large and how tilted the board is and how it moves.
Consecutive frames of a video share all of that until the board has moved on.
"""

import numpy as np

from ...recording import Floats, Integers
from ..camera_imu.start.board_poses import SMALLEST_PX
from ..camera_imu.terms.visual_terms import CornerSums
from .rig import CameraCorners, RigViews

HUBER = 3.0
"""Distance in sigmas from which on a corner counts less; one of ninety does by chance."""


def usual_sigma(sums: CornerSums, freedom: float = 1.0) -> float:
    """Return the standard deviation per axis by the median distance; wrong corners do not count.

    Parameters
    ----------
    sums : of one camera; corners that the lens cannot image are left out
    freedom : share of the residuals' freedom that no parameter took up
    """
    distance = _distances(sums)
    if not len(distance):
        return 1.0
    return max(float(np.median(distance)) / np.sqrt(2 * np.log(2) * freedom), SMALLEST_PX)


def bounded_sigma(sums: CornerSums, counted: np.ndarray, huber: float, freedom: float) -> float:
    """Return the standard deviation per axis by the mean square, distances beyond `huber` usual ones cut off.

    It holds for the weighted sums of the estimate where the residuals have longer tails than a normal distribution.

    Parameters
    ----------
    sums : of one camera
    counted : (m,) corners that take part
    huber : as for the weights; infinite for least squares
    freedom : as for `usual_sigma`
    """
    distance = _distances(sums, counted)
    if not len(distance):
        return usual_sigma(sums, freedom)
    if not np.isfinite(huber):
        return max(float(np.sqrt(np.mean(distance**2) / (2 * freedom))), SMALLEST_PX)
    limit = huber * float(np.median(distance)) / np.sqrt(2 * np.log(2))
    share = 1 - np.exp(-0.5 * huber**2)
    cut = np.minimum(distance, limit)
    return max(float(np.sqrt(np.mean(cut**2) / (2 * freedom * share))), SMALLEST_PX)


def relative_corner_sigmas(seen: CameraCorners, sigma_px: float) -> Floats | None:
    """Return the standard deviation of each corner over that of a usual one.

    What the detector knows of each corner adds up with what is common to all, such as the errors of the board.
    """
    if seen.own_sigma_px is None or not len(seen.own_sigma_px):
        return None
    own = np.square(seen.own_sigma_px)
    variance = own + max(sigma_px**2 - float(np.median(own)), 0.0)
    return np.sqrt(variance / np.median(variance))


def _distances(sums: CornerSums, counted: np.ndarray | None = None) -> Floats:
    comparable = sums.comparable
    some = np.isfinite(comparable[:, 0])
    if counted is not None:
        some &= counted
    return np.linalg.norm(comparable[some], axis=1)


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
