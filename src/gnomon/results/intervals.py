"""Runs of samples in which the sensor rested."""

import numpy as np
from numpy.typing import NDArray

from ..frozen import value_class
from ..recording import Floats, Integers, frozen_array

Booleans = NDArray[np.bool_]


@value_class
class StaticIntervals:
    """Runs of static samples.

    Attributes
    ----------
    start, stop : (n,) int64, first sample and one past the last
    """

    start: Integers
    stop: Integers

    def __post_init__(self) -> None:
        object.__setattr__(self, "start", frozen_array(self.start, np.int64))
        object.__setattr__(self, "stop", frozen_array(self.stop, np.int64))

    def __len__(self) -> int:
        return len(self.start)

    def where(self, keep: Booleans) -> "StaticIntervals":
        """Return the intervals that `keep` (n,) marks."""
        return StaticIntervals(start=self.start[keep], stop=self.stop[keep])


def split_long(intervals: StaticIntervals, most: int) -> tuple[StaticIntervals, Integers]:
    """Return intervals of about the usual length, into which long ones are cut, and the number of each one's whole.

    Parameters
    ----------
    intervals : (n)
    most : parts of one interval, at most

    Returns
    -------
    (m) parts in the order of the intervals, and (m,) which interval each is of
    """
    length = intervals.stop - intervals.start
    usual = float(np.median(length)) if len(length) else 1.0
    parts = np.clip(np.round(length / max(usual, 1.0)), 1, most).astype(np.int64)
    whole = np.repeat(np.arange(len(parts)), parts)
    k = np.arange(len(whole)) - np.repeat(np.cumsum(parts) - parts, parts)
    edges = [intervals.start[whole] + length[whole] * (k + i) // parts[whole] for i in (0, 1)]
    return StaticIntervals(start=edges[0], stop=edges[1]), whole


def interval_means(values: Floats, intervals: StaticIntervals) -> Floats:
    """Return the mean of the samples of every interval, (n, 3) [unit]."""
    if not len(intervals):
        return np.empty((0, 3))
    edges = np.stack([intervals.start, intervals.stop], axis=1).ravel()
    last = edges[-1] == len(values)  # reduceat takes the end of the data for granted
    sums = np.add.reduceat(values, edges[:-1] if last else edges, axis=0)[::2]
    return sums / (intervals.stop - intervals.start)[:, None]
