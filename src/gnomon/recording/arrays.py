"""Arrays of what was measured: read-only, finite, on clocks with gaps."""

from collections.abc import Callable, Sequence
from functools import wraps
from typing import Any, TypeVar
from weakref import ref

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import RecordingError


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
    alike = all(np.array_equal(stamps[0], others) for others in stamps[1:])
    every = stamps[0] if alike else np.sort(np.concatenate(stamps), kind="stable")  # np.unique of integers is slow
    surplus = np.maximum(np.diff(every) - longest_ns, 0)
    if not surplus.any():
        return list(stamps)
    taken = np.concatenate([[0], np.cumsum(surplus)])
    return [np.asarray(t_ns - taken[np.searchsorted(every, t_ns)], dtype=np.int64) for t_ns in stamps]


Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
_LONGEST_PAUSE_NS = 2_000_000_000  # between packets
_PACKET_FACTOR = 3.0  # a mean step this much longer than the median comes from packets, not from gaps


def frozen_array(values: ArrayLike, dtype: Any = np.float64) -> NDArray[Any]:
    """Return a read-only C-ordered array; values are copied unless they already are one."""
    if isinstance(values, np.ndarray) and values.dtype == dtype and values.flags.c_contiguous:
        if not values.flags.writeable:
            return values
        array = values.copy()
    else:
        array = np.array(values, dtype=dtype, order="C")
    array.flags.writeable = False
    return array


def usual_step(steps: NDArray[Any], unit_ns: float = 1.0) -> float:
    """Return the usual one of steps between timestamps (n,): the median, or the mean where samples came in packets.

    Parameters
    ----------
    steps : [`unit_ns`]
    """
    step = float(np.median(steps))
    together = steps[steps < max(_LONGEST_PAUSE_NS / unit_ns, step)]  # what was cut out between poses is no pause
    mean = float(np.mean(together)) if len(together) else step
    return mean if mean > _PACKET_FACTOR * step else step


Known = TypeVar("Known")


def kept_with_array(function: Callable[[NDArray[Any]], Known]) -> Callable[[NDArray[Any]], Known]:
    """Keep what a function tells of an array that nobody can change for as long as that lives: many ask for it."""
    kept: dict[int, tuple[ref[NDArray[Any]], Known]] = {}

    @wraps(function)
    def once(array: NDArray[Any]) -> Known:
        key = id(array)
        if (known := kept.get(key)) is not None and known[0]() is array:
            return known[1]
        found = function(array)
        if not array.flags.writeable:
            kept[key] = (ref(array, lambda _: kept.pop(key, None)), found)
        return found

    return once


@kept_with_array
def usual_rate(t_ns: Integers) -> float:
    """Return the sample rate of timestamps (n,) [Hz], from `usual_step`; nan if unknown."""
    step = usual_step(np.diff(t_ns)) if len(t_ns) > 1 else 0.0
    return 1e9 / step if step > 0 else float("nan")


_LARGEST = 1e100  # squares and sums of samples stay finite; no sensor reads a number like that


def measurable_numbers(values: Floats) -> NDArray[np.bool_]:
    """Return which numbers a sensor can have read: not NaN, not infinite, not beyond all measure."""
    return np.abs(values) < _LARGEST


def ns_from_s(t_s: ArrayLike) -> Integers:
    """Return seconds (n,) as whole nanoseconds; a RecordingError where they are not finite or too large."""
    t = np.asarray(t_s, dtype=np.float64)
    if not np.isfinite(t).all():
        raise RecordingError(f"timestamp {int(np.argmin(np.isfinite(t)))} is not a finite number of seconds.")
    return np.rint(t * 1e9).astype(np.int64)


_STEP_SAMPLES = 65_536
_ARITHMETIC = 1e-13  # of the largest value; what a conversion of units leaves


@kept_with_array
def smallest_steps(values: Floats) -> Floats:
    """Return the smallest change from sample to sample of each axis of values (n, k); nan where it never changes."""
    columns = np.ascontiguousarray(values[:_STEP_SAMPLES].T)  # along which all is fast
    steps = np.abs(np.diff(columns))
    least = _ARITHMETIC * np.abs(columns).max(axis=1, initial=0.0)  # what a conversion of units may differ by
    found = np.where(steps > least[:, None], steps, np.inf).min(axis=1, initial=np.inf)
    return np.where(found < np.inf, found, np.nan)
