"""The noise of a resting sensor, as it acts on means of its samples, and its Allan deviation (Tedaldi 2014, 3.4.3)."""

import numpy as np

from ...recording import Floats, Integers
from ...results.result import Booleans, StaticIntervals

_PIECE_S = 0.05
_PIECES = 5
"""The rule: blocks of five pieces, a quarter of a second."""
_LONGER, _SHORTER = (10, 20, 40), (2, 1)
_FEWEST_DIFFERENCES = 20


def resting_noise(values: Floats, intervals: StaticIntervals, rate_hz: float) -> tuple[Floats, Floats]:
    """Return two noise densities of each axis at rest, (3,) [unit^2 s].

    From half the mean squared difference of neighbouring block means (Allan's variance), which slow drift and the
    attitude itself leave alone. Blocks of a quarter of a second are the rule: they are long enough for a filtered
    sensor and many enough for a precise level. Other lengths replace them where they differ significantly.

    Parameters
    ----------
    values : (n, 3) [unit]
    intervals : static intervals
    rate_hz : sample rate [Hz]

    Returns
    -------
    of_means : a mean over T seconds has variance of_means / T; longer blocks count, since means are taken over seconds
    of_increments : an integral over T seconds has variance of_increments * T; shorter blocks count where they show
        less, since a hand's tremor is motion that a gyroscope measures rightly
    """
    length = max(1, round(_PIECE_S * rate_hz))
    sums, counts = _piece_sums(values, intervals, length)
    per_difference = 1 / (2 * length * rate_hz)

    def level(pieces: int) -> tuple[Floats, int]:
        squares, count = _block_differences(sums, counts, pieces)
        return squares / max(count, 1) * per_difference / pieces, count

    of_means = of_increments = level(_PIECES)[0]
    for pieces in _LONGER:
        found, count = level(pieces)
        if count < _FEWEST_DIFFERENCES:
            break
        of_means = np.where(_differ(found, of_means, count), found, of_means)
    for pieces in _SHORTER:
        found, count = level(pieces)
        lower = (found < of_increments) & _differ(found, of_increments, count)
        of_increments = np.where(lower, found, of_increments)
    return of_means, of_increments


def _piece_sums(values: Floats, intervals: StaticIntervals, length: int) -> tuple[Floats, Integers]:
    """Return running sums (pieces + 1, 3) over whole pieces of all intervals, and each interval's number of pieces."""
    counts = (intervals.stop - intervals.start) // length
    edges = np.repeat(intervals.start - length * (np.cumsum(counts) - counts), counts)
    edges += length * np.arange(len(edges))
    sums = np.zeros((len(edges) + 1, 3))
    if len(edges):
        pieces = values[edges].copy()
        for k in range(1, length):
            pieces += values[edges + k]
        np.cumsum(pieces - pieces[len(pieces) // 2], axis=0, out=sums[1:])
    return sums, counts


def _differ(level: Floats, density: Floats, count: int) -> Booleans:
    """Return whether two levels differ by more than three sigma of the one from `count` differences."""
    return np.abs(level - density) > 3 * np.sqrt(3 / max(count, 1)) * np.maximum(density, level)


def _block_differences(sums: Floats, counts: Integers, pieces: int) -> tuple[Floats, int]:
    """Return the summed squares (3,) and the number of differences of neighbouring block sums within intervals."""
    blocks = counts // pieces
    first = np.cumsum(counts) - counts
    edges = np.repeat(first - pieces * (np.cumsum(blocks + 1) - blocks - 1), blocks + 1)
    edges += pieces * np.arange(len(edges))
    within = np.ones(max(len(edges) - 1, 0), dtype=bool)
    within[np.cumsum(blocks + 1)[:-1] - 1] = False  # from the last edge of an interval to the first of the next
    both = within[1:] & within[:-1]
    differences = np.diff(np.diff(sums[edges], axis=0), axis=0)[both]
    return np.einsum("ij,ij->j", differences, differences), int(both.sum())


def allan_deviation(values: Floats, rate_hz: float, tau_s: Floats) -> Floats:
    """Return the Allan deviation of each axis by Eq. (3.17), (len(tau_s), 3) [unit]; nan where under two averages fit.

    Parameters
    ----------
    values : (n, 3) samples at rest [unit]
    rate_hz : sample rate [Hz]
    tau_s : averaging times [s]
    """
    deviation = np.full((len(tau_s), 3), np.nan)
    sums = np.zeros((3, len(values) + 1))
    sums[:, 1:] = values.T
    sums[:, 1:] -= sums[:, 1:].mean(axis=1, keepdims=True)  # small numbers keep the running sums exact
    np.cumsum(sums, axis=1, out=sums)
    for row, tau in enumerate(tau_s):
        length = max(1, round(tau * rate_hz))
        if len(values) // length >= 2:
            steps = np.diff(sums[:, ::length], 2, axis=1) / length
            deviation[row] = np.sqrt(0.5 * np.mean(steps**2, axis=1))
    return deviation


def averaging_time(tau_s: Floats, deviation: Floats) -> float:
    """Return T_init, the averaging time at which the curves of all axes have flattened [s]; nan where they still fall.

    Flat is where twice the averaging time would lower the deviation by less than 15 % (white noise: 29 %).

    Parameters
    ----------
    tau_s : (k,) rising by factors
    deviation : (k, 3)
    """
    seen = np.maximum(deviation, np.finfo(float).tiny)  # none where the converter is coarser than the noise
    slope = np.gradient(np.log(seen), np.log(tau_s), axis=0) if len(tau_s) > 2 else np.full(deviation.shape, -1.0)
    flat = np.all(slope > np.log(0.85) / np.log(2), axis=1)
    return float(tau_s[np.argmax(flat)]) if flat.any() else float("nan")
