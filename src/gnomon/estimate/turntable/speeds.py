"""Which of the stated speeds each steady part on a turntable had, by its measured magnitude alone."""

import numpy as np

from ...errors import DetectionError
from ...frozen import value_class
from ...recording import Floats, Integers
from ...results.result import Booleans

NO_SPEED = -1
_AT_REST = 0.25  # of the slowest speed; less is no turning
_SAME_PLACE = 0.05  # of the largest distance: means of one cluster
_UNSCALED = 1.3  # factor by which an uncalibrated axis may be off
_COST_UNUSED = 0.5  # of a stated speed that no part has
_FARTHEST, _COST_FAR, _CLEARLY = 1.5, 0.1, 0.1  # factor of a scale; cost of its logarithm; gain for another scale
_ROUNDS = 10


@value_class
class Speeds:
    """Speeds of steady parts.

    Attributes
    ----------
    index : (n,) of the speed; NO_SPEED where it is none of those stated
    zero : (3,) what the gyroscope shows at rest, about [unit]
    scale : (3,) about what an axis shows for 1 rad/s [unit]
    shown : (n,) magnitude by these [rad/s]
    """

    index: Integers
    zero: Floats
    scale: Floats
    shown: Floats


def assign_speeds(means: Floats, speeds: Floats, allowed: Booleans, unit_rad_s: float | None) -> Speeds:
    """Return the speed of each part.

    Parameters
    ----------
    means : (n, 3) of steady parts [unit]
    speeds : (g,) stated, zero among them [rad/s]
    allowed : (n, g) which speeds a part may have, such as those of its file
    unit_rad_s : one unit in rad/s; None for counts, whose zero and size are not known either

    Raises
    ------
    DetectionError
        If no part turns.
    """
    if unit_rad_s is not None:
        zero, size = np.zeros(3), _size_by_ratios(means, speeds, allowed, 1 / unit_rad_s)
    else:
        zero, size = _zero_and_size(means, speeds, allowed)
    scale = np.full(3, size)
    index = np.full(len(means), NO_SPEED)
    for _ in range(_ROUNDS):
        shown = np.linalg.norm((means - zero) / scale, axis=1)
        new = _nearest(shown, speeds, allowed)
        if np.array_equal(new, index):
            break
        index = new
        rests = (index != NO_SPEED) & (speeds[index] == 0)
        if rests.any():
            zero = np.median(means[rests], axis=0)
        scale = _axis_scales(means - zero, speeds[index], (index != NO_SPEED) & ~rests, size)
    shown = np.linalg.norm((means - zero) / scale, axis=1)
    return Speeds(index=index, zero=zero, scale=scale, shown=shown)


def _size_by_ratios(means: Floats, speeds: Floats, allowed: Booleans, nominal: float) -> float:
    """Return what the sensor shows for 1 rad/s, where its unit says what it should show.

    A scale that is off by up to `_FARTHEST` is found by the ratios of the speeds; the one that the unit says is kept
    where no other explains the parts clearly better.
    """
    radius, turning = np.linalg.norm(means, axis=1), speeds[speeds > 0]
    moving = radius[radius > _AT_REST * turning.min() * nominal / _FARTHEST]
    if not len(moving):
        return nominal
    sizes = np.outer(np.quantile(moving, np.linspace(0, 1, 21)), 1 / turning).ravel()
    sizes = np.append(sizes[np.abs(np.log(sizes / nominal)) < np.log(_FARTHEST)], nominal)
    costs = np.array([
        _cost(radius / size, speeds, allowed) + _COST_FAR * abs(float(np.log(size / nominal))) for size in sizes
    ])  # fmt: skip
    return float(sizes[np.argmin(costs)]) if costs.min() < costs[-1] - _CLEARLY else nominal


def reassign_speeds(shown: Floats, speeds: Floats, allowed: Booleans, tolerance: float) -> Integers:
    """Return the speed of each part by its calibrated magnitude (n,) [rad/s]; none beyond a relative tolerance."""
    return _nearest(shown, speeds, allowed, 1 + tolerance)


def _nearest(shown: Floats, speeds: Floats, allowed: Booleans, factor: float = _UNSCALED) -> Integers:
    turning = speeds[speeds > 0]
    at_rest = shown < _AT_REST * turning.min()
    with np.errstate(divide="ignore"):
        away = np.abs(np.log(np.maximum(shown, 1e-12))[:, None] - np.log(speeds))
    away = np.where(allowed & (speeds > 0), away, np.inf)
    index = np.argmin(away, axis=1)
    index[away[np.arange(len(shown)), index] > np.log(factor)] = NO_SPEED
    rest = np.flatnonzero(speeds == 0)
    index[at_rest] = rest[0] if len(rest) else NO_SPEED
    return index


def _axis_scales(offset: Floats, rate: Floats, turning: Booleans, size: float) -> Floats:
    """Return what each axis shows for 1 rad/s, (3,), where the parts tell it: sum over axes (m / s)^2 = rate^2."""
    squares = offset[turning] ** 2
    if len(squares) < 6:
        return np.full(3, size)
    found = np.linalg.lstsq(squares / rate[turning, None] ** 2, np.ones(len(squares)), rcond=1e-3)[0]
    scales = np.sqrt(1 / np.maximum(found, 1e-30))
    return scales if np.all(np.abs(np.log(scales / size)) < 2 * np.log(_UNSCALED)) else np.full(3, size)


def _zero_and_size(means: Floats, speeds: Floats, allowed: Booleans) -> tuple[Floats, float]:
    """Return the zero (3,) and the size of 1 rad/s of counts that make the magnitudes those of the stated speeds best.

    Rests all show the zero; without rests it is the centre of the sphere on which the parts lie.
    """
    if len(means) < 2 or not np.ptp(means, axis=0).any():
        raise DetectionError(
            f"{len(means)} steady parts found, all alike; the speeds cannot be told from them. "
            "Record the turntable at rest and turning, with the sensor in many orientations."
        )
    apart = np.linalg.norm(means[:, None] - means, axis=2)
    close = apart < _SAME_PLACE * apart.max()
    densest = close[np.argmax(close.sum(axis=1))]
    candidates = [means[densest].mean(axis=0)]
    for chosen in (means, means[~densest]):
        if len(chosen) >= 6:
            design = np.column_stack([2 * chosen, np.ones(len(chosen))])
            candidates.append(np.linalg.lstsq(design, np.sum(chosen**2, axis=1), rcond=1e-12)[0][:3])
    best = (np.inf, candidates[0], 1.0)
    turning = speeds[speeds > 0]
    for zero in candidates:
        radius = np.linalg.norm(means - zero, axis=1)
        for size in np.unique(np.outer(np.quantile(radius[radius > 0], np.linspace(0, 1, 21)), 1 / turning)):
            cost = _cost(radius / size, speeds, allowed)
            if cost < best[0]:
                best = (cost, zero, float(size))
    return best[1], best[2]


def _cost(shown: Floats, speeds: Floats, allowed: Booleans) -> float:
    with np.errstate(divide="ignore"):
        away = np.abs(np.log(np.maximum(shown, 1e-12))[:, None] - np.log(np.maximum(speeds, 1e-300)))
    away = np.where(allowed & (speeds > 0), away, np.inf)
    turning = shown >= _AT_REST * speeds[speeds > 0].min()
    if not turning.any():
        return np.inf
    nearest = np.argmin(away, axis=1)[turning]
    unused = np.count_nonzero(speeds > 0) - len(np.unique(nearest))
    return float(np.mean(np.minimum(away.min(axis=1)[turning], 1.0))) + _COST_UNUSED * unused
