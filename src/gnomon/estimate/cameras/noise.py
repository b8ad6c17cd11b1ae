"""How corners are weighed: their scatter from the residuals, and what the detector knows of each."""

import numpy as np

from ...recording import Floats
from ..camera_imu.start.board_poses import SMALLEST_PX
from ..camera_imu.terms.corner_sums import CornerSums
from .views import CameraCorners

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
