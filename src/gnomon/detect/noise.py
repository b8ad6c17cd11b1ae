"""The noise of a resting sensor, as it acts on means of its samples, and its Allan deviation (document A, 3.4.3)."""

import numpy as np

from ..intervals import StaticIntervals
from ..recording import Floats

_BLOCK_S = 0.25
"""Means over blocks of this length hold the noise of a filtered sensor, whose samples are not independent."""


def resting_density(values: Floats, intervals: StaticIntervals, rate_hz: float) -> Floats:
    """Return the white-noise density of each axis at rest, (3,) [unit^2 s], such that a mean over T s has density / T.

    From half the mean squared difference of neighbouring block means (Allan's variance at a quarter of a second), which
    slow drift and the attitude itself leave alone.

    Parameters
    ----------
    values : (n, 3) [unit]
    intervals : static intervals
    rate_hz : sample rate [Hz]
    """
    length = max(2, round(_BLOCK_S * rate_hz))
    squares, count = np.zeros(3), 0
    for start, stop in zip(intervals.start, intervals.stop, strict=True):
        blocks = (stop - start) // length
        if blocks > 1:
            means = values[start : start + blocks * length].reshape(blocks, length, 3).mean(axis=1)
            squares += np.sum(np.diff(means, axis=0) ** 2, axis=0)
            count += blocks - 1
    if count == 0:
        return np.zeros(3)
    return 0.5 * squares / count * length / rate_hz


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
