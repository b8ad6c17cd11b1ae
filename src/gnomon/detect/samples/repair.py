"""Harmless faults of timestamps and single readings, fixed; harmful ones are left for the data doctor to name."""

from dataclasses import replace

import numpy as np

from ...recording import Floats, Integers, TriadSamples, kept_with_array, smallest_steps
from ...results.result import Booleans

_RARE = 0.01
_BESIDE = 3  # samples on either side of a reading
_OFF = 10.0  # times as far from the line as they are; white noise never is
_SAMPLES = 10_000  # that tell what is usual
_HELD, _SLOWER, _JUMP = 0.005, 0.2, 3.0  # of the samples, more than by chance; beyond, the sensor is slower; steps
_STRAIGHT, _LEVEL, _FEWEST_ON_LINES, _LOOKED_AT = 0.02, 0.02, 5, 20_000  # of the usual bend, and of that; how many tell

_BAND_PLACES, _BAND_TIMES = 12, 3.0
"""Of a dead band: by how many places more than times those of any reading beside it; coarse steps make it twice."""


def repair_samples(samples: TriadSamples, *, counted: bool = False) -> TriadSamples:
    """Return the samples as they are used: no timestamp twice, and no isolated reading.

    An isolated reading is left out: the line between its neighbours stands in its place, which is what an integral over
    the gap would take.

    Parameters
    ----------
    samples, counted : see `drop_repeated_timestamps`
    """
    samples = drop_repeated_timestamps(samples, counted=counted)
    at = isolated_readings(samples.values)
    return replace(samples, values=without_readings(samples.values, at)) if len(at) else samples


def held_samples(values: Floats) -> Booleans:
    """Mark the samples (n,) of a triad that stand in for lost ones: they repeat the one before, until all axes jump.

    Coarse steps repeat, too, but by chance, or at rest, where what follows is a step away. None is marked where the
    sensor is slower than its recording. Others lie on lines between those that were measured, see `on_lines`.
    """
    same = values[1:] == values[:-1]
    repeats = np.concatenate([[False], same.all(axis=1)])
    lines = on_lines(values)
    lines &= _HELD < lines.mean() <= _SLOWER
    if not repeats.mean() - np.prod(same.mean(axis=0)) > _HELD:
        return lines
    others = np.append(np.flatnonzero(~repeats), len(values) - 1)
    following = values[others[np.searchsorted(others, np.arange(len(values)))]]
    repeats &= (np.abs(following - values) > _JUMP * np.nan_to_num(smallest_steps(values))).all(axis=1)
    return lines | (repeats & (_HELD < repeats.mean() <= _SLOWER))


def on_lines(values: Floats) -> Booleans:
    """Mark samples (n,), three or more in a row, that are the mean of their neighbours in all axes, and change."""
    marked = np.zeros(len(values), dtype=bool)
    if len(values) < _FEWEST_ON_LINES:
        return marked
    inner = np.ones(len(values) - 2, dtype=bool)
    rows = inner[2:]
    for column in np.ascontiguousarray(values.T):
        bend = np.abs(column[2:] - 2 * column[1:-1] + column[:-2])
        least = _STRAIGHT * float(np.median(bend[:: len(bend) // _LOOKED_AT + 1]))
        inner = inner & (bend <= least) & (np.abs(column[2:] - column[:-2]) > _LEVEL * least)
        rows = inner[2:] & inner[1:-1] & inner[:-2]
        if not rows.any():
            return marked
    for shift in (1, 2, 3):
        marked[shift : shift + len(rows)] |= rows
    return marked


def dead_bands(values: Floats) -> tuple[Floats, Integers]:
    """Return of each axis the reading that stands in for all near it, and in how many places (3,); 0 where none does.

    Such a reading is inside the range and occurs far more often than those next to it. One that is repeated is in one
    place: coarse steps, samples that are held and an axis that hangs make no dead band.
    """
    found, places = np.full(3, np.nan), np.zeros(3, np.int64)
    for axis, column in enumerate(np.ascontiguousarray(values.T)):
        new = np.concatenate([[True], column[1:] != column[:-1]])[: len(column)]
        repeated = column[~new]
        if not len(repeated):
            continue
        usual, count = np.unique(repeated[:: 1 + len(repeated) // _SAMPLES], return_counts=True)
        most = int(np.argmax(count))
        found[axis] = usual[most]
        if not column.min() < usual[most] < column.max():
            continue
        near = usual[max(most - _BESIDE, 0) : most + _BESIDE + 1]
        counts = [int(np.count_nonzero(column[new] == value)) for value in near]
        own = counts.pop(min(most, _BESIDE))
        if own > _BAND_PLACES + _BAND_TIMES * max(counts, default=0):
            places[axis] = own
    return found, places


def without_readings(values: Floats, at: Integers) -> Floats:
    """Return values (n, 3) in which those at some indices (k,) lie on the line between their neighbours, in steps."""
    kept = np.delete(np.arange(len(values)), at)
    before = values[kept[np.maximum(np.searchsorted(kept, at) - 1, 0)]]
    between = np.column_stack([np.interp(at, kept, column[kept]) for column in values.T])
    step = np.nan_to_num(smallest_steps(values))
    mended = values.copy()
    mended[at] = before + np.rint((between - before) / np.where(step > 0, step, 1.0)) * step
    return mended


@kept_with_array
def isolated_readings(values: Floats) -> Integers:
    """Return the indices of single readings that neither neighbour supports, as of a disturbed bus.

    On some axis such a reading is off from the middle between its neighbours by ten times more than the slope changes
    from one sample to the next around it, on any axis. A knock shakes the samples beside its peak, too. Where there are
    such readings, two of them may be neighbours: each is off among every second or third sample.

    Parameters
    ----------
    values : (n, 3)
    """
    found = _off_the_line(values)
    if not found.any():
        return np.empty(0, np.int64)
    for stride in (2, 3):
        off = np.zeros(len(values), dtype=bool)
        for phase in range(stride):
            off[phase::stride] = _off_the_line(values[phase::stride])
        off &= ~found
        found |= off & (np.convolve(off, np.ones(2 * _BESIDE + 1), "same") > 1.5)
    return np.flatnonzero(found)


def _off_the_line(values: Floats) -> Booleans:
    """Mark values (n, 3) that are off from the line on which the three on either side lie."""
    n, k = len(values), _BESIDE
    found = np.zeros(n, dtype=bool)
    if n < 2 * k + 2:
        return found
    columns = np.empty((3, n + 2))  # along which all is fast; mirrored at both ends
    columns[:, 0], columns[:, 1:-1], columns[:, -1] = values[1], values.T, values[n - 2]
    off = columns[:, :-2] + columns[:, 2:]
    off *= -0.5
    off += columns[:, 1:-1]
    np.abs(off, out=off)
    usual = np.array([_usual(axis) for axis in off])
    off /= usual[:, None]
    most = off.max(axis=0)
    far = most > _OFF
    far[2:] &= most[2:] > 1.9 * _OFF * most[:-2]  # of the bends below; most samples of a motion end here
    far[:-2] &= most[:-2] > 1.9 * _OFF * most[2:]
    at = np.flatnonzero(far)
    beside = np.abs(at[:, None] + np.r_[-k:0, 1 : k + 1])
    around = values[np.where(beside < n, beside, 2 * (n - 1) - beside)]
    slopes = np.diff(around, axis=1)
    slopes[:, k - 1] *= 0.5  # over two periods
    bends = (np.abs(np.diff(slopes, axis=1)).max(axis=1) / usual).max(axis=1)
    found[at] = most[at] > _OFF * np.maximum(bends, 1.0)
    return found


def _usual(sizes: Floats) -> float:
    """Return the median of sizes (n,), at least the smallest that is not zero; inf where there is none."""
    sizes = sizes[:: max(1, len(sizes) // _SAMPLES)]
    return float(np.median(sizes)) or float(np.min(sizes, initial=np.inf, where=sizes > 0))


def drop_repeated_timestamps(samples: TriadSamples, *, counted: bool = False) -> TriadSamples:
    """Return the samples without those whose timestamp equals the one before; the first of them is kept.

    A sample that repeats timestamp and values of the one before was written twice, and is always dropped, unless a
    coarse converter repeats values as often where the timestamps differ. One that repeats the timestamp alone is
    dropped only while such samples are rare (1 %): where they are many, the clock is coarser than the sample rate, and
    dropping them would lose good samples. Timestamps that go backwards are never touched.

    Parameters
    ----------
    samples : timestamps in any order
    counted : samples are counted, not timed (a uniform time base is stated): a timestamp that is wrong costs none of
    them
    """
    if len(samples) < 2:
        return samples
    same_stamp = samples.t_ns[1:] == samples.t_ns[:-1]
    if not same_stamp.any():
        return samples
    same_values = (samples.values[1:] == samples.values[:-1]).all(axis=1)
    drop = same_stamp & same_values
    if _by_chance(same_values, same_stamp):
        drop[:] = False
    if not counted and np.count_nonzero(same_stamp & ~drop) <= _RARE * len(samples):
        drop = same_stamp
    if not drop.any():
        return samples
    keep = np.concatenate([[True], ~drop])
    t_ns, values = samples.t_ns[keep], samples.values[keep]
    t_ns.flags.writeable = values.flags.writeable = False  # so that they are kept without a copy
    return TriadSamples(t_ns=t_ns, values=values, unit=samples.unit)


def _by_chance(same_values: Booleans, same_stamp: Booleans) -> bool:
    """Return whether values repeat no more often (three sigma) where the timestamp is repeated than where it is not."""
    here, elsewhere = same_values[same_stamp], same_values[~same_stamp]
    if not elsewhere.any():
        return False
    usual = float(elsewhere.mean())
    return float(here.mean()) <= usual + 3 * np.sqrt(usual * (1 - usual) / len(here))
