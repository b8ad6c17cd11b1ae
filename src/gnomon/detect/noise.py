"""The noise of a resting sensor, as it acts on means of its samples, and its Allan deviation (document A, 3.4.3)."""

import numpy as np

from ..intervals import StaticIntervals
from ..recording import Floats

_BLOCK_S = 0.25
_LONGER_S = (0.5, 1.0, 2.0)
_SHORTER_S = (0.1, 0.05)
_FEWEST_DIFFERENCES = 20


def density_of_means(values: Floats, intervals: StaticIntervals, rate_hz: float) -> Floats:
    """Return the noise density of each axis at rest, (3,) [unit^2 s], such that a mean over T s has variance density / T.

    From half the mean squared difference of neighbouring block means (Allan's variance), which slow drift and the
    attitude itself leave alone. Blocks of a quarter of a second are the rule: they are long enough for a filtered
    sensor and many enough for a precise level. Longer blocks replace them where they differ significantly, since means
    are taken over seconds.

    Parameters
    ----------
    values : (n, 3) [unit]
    intervals : static intervals
    rate_hz : sample rate [Hz]
    """
    density, _ = _level(values, intervals, rate_hz, _BLOCK_S)
    for block_s in _LONGER_S:
        level, count = _level(values, intervals, rate_hz, block_s)
        if count < _FEWEST_DIFFERENCES:
            break
        density = np.where(_differ(level, density, count), level, density)
    return density


def density_of_increments(values: Floats, intervals: StaticIntervals, rate_hz: float) -> Floats:
    """Return the noise density of each axis in motion, (3,) [unit^2 s], such that an integral over T s has density * T.

    A hand's tremor at rest is motion that a gyroscope measures rightly, not noise. It dies out over shorter blocks,
    which replace the quarter of a second where they show significantly less.

    Parameters
    ----------
    values, intervals, rate_hz : see `density_of_means`
    """
    density, _ = _level(values, intervals, rate_hz, _BLOCK_S)
    for block_s in _SHORTER_S:
        level, count = _level(values, intervals, rate_hz, block_s)
        lower = (level < density) & _differ(level, density, count)
        density = np.where(lower, level, density)
    return density


def _level(values: Floats, intervals: StaticIntervals, rate_hz: float, block_s: float) -> tuple[Floats, int]:
    length = max(2, round(block_s * rate_hz))
    squares, count = _block_differences(values, intervals, length)
    return 0.5 * squares / max(count, 1) * length / rate_hz, count


def _differ(level: Floats, density: Floats, count: int) -> Floats:
    """Return whether two levels differ by more than three sigma of the one from `count` differences."""
    return np.abs(level - density) > 3 * np.sqrt(3 / max(count, 1)) * np.maximum(density, level)


def _block_differences(values: Floats, intervals: StaticIntervals, length: int) -> tuple[Floats, int]:
    """Return the summed squares (3,) and the number of differences of neighbouring block means within intervals."""
    squares, count = np.zeros(3), 0
    for start, stop in zip(intervals.start, intervals.stop, strict=True):
        blocks = (stop - start) // length
        if blocks > 1:
            means = values[start : start + blocks * length].reshape(blocks, length, 3).mean(axis=1)
            squares += np.sum(np.diff(means, axis=0) ** 2, axis=0)
            count += int(blocks) - 1
    return squares, count


def allan_deviation(values: Floats, rate_hz: float, tau_s: Floats) -> Floats:
    """Return the Allan deviation of each axis by Eq. (3.17), (len(tau_s), 3) [unit]; nan where under two averages fit.

    Parameters
    ----------
    values : (n, 3) samples at rest [unit]
    rate_hz : sample rate [Hz]
    tau_s : averaging times [s]
    """
    deviation = np.full((len(tau_s), 3), np.nan)
    for row, tau in enumerate(tau_s):
        length = max(1, round(tau * rate_hz))
        averages = len(values) // length
        if averages >= 2:
            means = values[: averages * length].reshape(averages, length, 3).mean(axis=1)
            deviation[row] = np.sqrt(0.5 * np.mean(np.diff(means, axis=0) ** 2, axis=0))
    return deviation


def averaging_time(tau_s: Floats, deviation: Floats) -> float:
    """Return T_init, the averaging time at which the curves of all axes have flattened [s]; nan where they still fall.

    Flat is where twice the averaging time would lower the deviation by less than 15 % (white noise: 29 %).

    Parameters
    ----------
    tau_s : (k,) rising by factors
    deviation : (k, 3)
    """
    slope = np.gradient(np.log(deviation), np.log(tau_s), axis=0) if len(tau_s) > 2 else np.full(deviation.shape, -1.0)
    flat = np.all(slope > np.log(0.85) / np.log(2), axis=1)
    return float(tau_s[np.argmax(flat)]) if flat.any() else float("nan")
