"""Timestamps with long gaps, as a clock that jumps leaves them: work is bounded by their number, not their span."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray


def close_gaps(stamps: Sequence[NDArray[np.int64]], longest_ns: int) -> list[NDArray[np.int64]]:
    """Return timestamps of one clock, which stands still wherever none of them came for longer than `longest_ns`.

    An even grid over what is returned has at most `longest_ns` over its step points for each timestamp. Where there is
    no such gap the timestamps are returned as they are.

    Parameters
    ----------
    stamps : of several sensors, each (n,) and not falling [ns]
    longest_ns : what remains of a gap [ns]

    Examples
    --------
    >>> close_gaps([np.array([0, 10, 9000, 9010])], 100)
    [array([  0,  10, 110, 120])]
    """
    every = np.unique(np.concatenate(stamps))
    surplus = np.maximum(np.diff(every) - longest_ns, 0)
    if not surplus.any():
        return list(stamps)
    taken = np.concatenate([[0], np.cumsum(surplus)])
    return [np.asarray(t_ns - taken[np.searchsorted(every, t_ns)], dtype=np.int64) for t_ns in stamps]
