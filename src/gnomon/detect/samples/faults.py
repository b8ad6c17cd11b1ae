"""Faults of samples: clipped, held, isolated, stamped twice, written twice, or of another range from one instant on.

What is harmless is repaired; harmful faults are left for the data doctor to name. A sample at the end of the sensor's
range says "at least this much" and no more.

Stretches that occur twice are a file appended to itself, or two that share a part. Copies that were written with other
decimals differ by less than samples do: readings are compared in steps of half of what the smallest tenth of all
changes is. Sensors repeat single readings by chance, and at rest, coarsely quantised, they do so all the time. Readings
that do not change are therefore counted once, and a stretch counts from 64 changes in succession on, between at least
32 different readings: a noise of one step flips between fewer, and more noise does not repeat itself.

In some recordings the accelerometer reads gravity several times as large from one instant on: its full-scale range was
set anew (a brown-out sets it back), its unit was changed, or another sensor's samples follow. No bias or scale of a
working sensor does that. The rests of one side only can be calibrated together.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ...frozen import value_class
from ...recording import Floats, Integers, TriadSamples, kept_with_array, smallest_steps
from ...recording.samples import distinct_values, median_of, quantile_of
from ...results.result import Booleans, StaticIntervals

_RARE = 0.01
_BESIDE = 3  # samples on either side of a reading
_OFF = 10.0  # times as far from the line as they are; white noise never is
_SAMPLES = 10_000  # that tell what is usual
_HELD, _SLOWER, _JUMP = 0.005, 0.2, 3.0  # of the samples, more than by chance; beyond, the sensor is slower; steps
_STRAIGHT, _LEVEL, _FEWEST_ON_LINES, _LOOKED_AT = 0.02, 0.02, 5, 20_000  # of the usual bend, and of that; how many tell

_BAND_PLACES, _BAND_TIMES = 12, 3.0
"""Of a dead band: by how many places more than times those of any reading beside it; coarse steps make it twice."""

_LIMITS = (32767.0, -32768.0, -32767.0, 65535.0, 8388607.0, -8388608.0)
"""Ends of the range of 16 and 24 bit converters; reaching one exactly is no coincidence."""

_FAR = 10.0  # noise levels between the median and an extreme that a resting sensor never shows
_BAND = 3.0  # noise levels below the extreme in which the ordinary samples are counted
_NOISE_SAMPLES = 10_000
_ENOUGH, _DISTINCT, _TIES = 20, 0.95, 5

_LENGTH = 64  # successive different readings
_DIFFERENT = 32  # of them
_SMALL = 0.1  # quantile of changes
_CHANGES_LOOKED_AT = 10_000  # changes, about, that tell it
_SAME = 1e-9  # step [unit] of readings of which no change was seen
_MOST_OFFSETS = 16
_MOST_KEPT = 1 << 19  # stretches that are remembered of a long recording
_BASE = 0x9E3779B97F4A7C15  # odd: it has an inverse modulo 2^64
_COLUMNS = (0xBF58476D1CE4E5B9, 0x94D049BB133111EB, 0xD6E8FEB86659FD93)

_Hashes = NDArray[np.uint64]

_FACTOR = 1.25  # from which on it is no error of a sensor; ranges differ by two
_ALIKE = 0.25  # of a side's median: scales of raw counts differ by that from axis to axis
_FEW_ODD = 0.1  # of a side's rests that may read anything
_FEWEST_RESTS = 2  # on either side


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
    return float(median_of(sizes)) or float(np.min(sizes, initial=np.inf, where=sizes > 0))


def without_readings(values: Floats, at: Integers) -> Floats:
    """Return values (n, 3) in which those at some indices (k,) lie on the line between their neighbours, in steps."""
    kept = np.delete(np.arange(len(values)), at)
    before = values[kept[np.maximum(np.searchsorted(kept, at) - 1, 0)]]
    between = np.column_stack([np.interp(at, kept, column[kept]) for column in values.T])
    step = np.nan_to_num(smallest_steps(values))
    mended = values.copy()
    mended[at] = before + np.rint((between - before) / np.where(step > 0, step, 1.0)) * step
    return mended


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
        least = _STRAIGHT * float(median_of(bend[:: len(bend) // _LOOKED_AT + 1]))
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
        places_of, repeated = column[new], column[~new]
        if not len(repeated):
            continue
        usual, count = np.unique(repeated[:: 1 + len(repeated) // _SAMPLES], return_counts=True)
        most = int(np.argmax(count))
        found[axis] = usual[most]
        if not column.min() < usual[most] < column.max():
            continue
        near = usual[max(most - _BESIDE, 0) : most + _BESIDE + 1]
        counts = [int(np.count_nonzero(places_of == value)) for value in near]
        own = counts.pop(min(most, _BESIDE))
        if own > _BAND_PLACES + _BAND_TIMES * max(counts, default=0):
            places[axis] = own
    return found, places


def saturated_samples(samples: TriadSamples, full_scale: float | None = None) -> Booleans:
    """Mark the samples of which an axis is clipped, (n,).

    A signal that is cut off stands on its extreme value again and again while it hardly ever visits the values just
    below: the extreme must come in runs, more often than twice the ordinary samples in a band of three noise levels
    below it, and lie far from what the sensor shows at rest. Noise, coarse quantisation and the rounded top of a slow
    motion fail one of the three. In a signal whose values never repeat, the second is not asked for. The end of the
    range of a 16 or 24 bit converter needs no further evidence.

    Parameters
    ----------
    samples : in counts or any unit
    full_scale : end of the range where it is known [unit of the samples]; samples at or beyond +- this are marked, too
    """
    if full_scale is None or len(samples) < 4:
        return _flat_tops(samples.values)
    return _flat_tops(samples.values) | (np.abs(samples.values) >= full_scale * (1 - 1e-9)).any(axis=1)


@kept_with_array
def _flat_tops(samples: Floats) -> Booleans:
    marked = np.zeros(len(samples), bool)
    for values in np.ascontiguousarray(samples.T) if len(samples) >= 4 else ():
        noise, middle = _noise_and_median(values)
        for extreme in (values.max(), values.min()):
            near = float(abs(extreme - middle))
            if near > _FAR * noise and _is_flat_top(values, float(extreme), noise):
                marked |= values == extreme
    marked.flags.writeable = False
    return marked


def _noise_and_median(values: Floats) -> tuple[float, float]:
    """Return the level of sample-to-sample changes, at least one quantum, and the median; of part of a long signal."""
    stride = max(1, len(values) // _NOISE_SAMPLES)
    steps = np.abs(values[1::stride] - values[:-1:stride])
    noise = float(median_of(steps))
    if noise == 0:
        moving = steps[steps > 0]
        noise = float(moving.min()) if moving.size else 0.0
    return noise, float(median_of(values[::stride]))


def _is_flat_top(values: Floats, extreme: float, noise: float) -> bool:
    at = values == extreme
    count = int(np.count_nonzero(at))
    if extreme in _LIMITS or (extreme == 0 and bool((values == 65535).any())):
        return True
    if count < 3 or not bool((at[1:] & at[:-1]).any()):
        return False
    below = values[(np.abs(values - extreme) <= _BAND * noise) & ~at]
    # Where no other value occurs twice, as in floating point numbers in motion, repeated extremes are no chance.
    fine = len(below) >= _ENOUGH and len(distinct_values(below)) > _DISTINCT * len(below)
    return count > 2 * len(below) or (fine and count >= _TIES)


@value_class(eq=True)
class Repeat:
    """A stretch of samples that occurs twice.

    Attributes
    ----------
    first, first_stop : where it begins and one past its end
    second, second_stop : the same of its copy, in the same series or in the other one
    """

    first: int
    first_stop: int
    second: int
    second_stop: int


def repeated_stretches(values: Floats, other: Floats | None = None) -> list[Repeat]:
    """Return stretches of samples that occur twice, in the order of the copies.

    Parameters
    ----------
    values : (n, 3)
    other : (m, 3) in which copies are looked for; in `values` itself where not given
    """
    step = _coarseness(values)
    at, readings = _changes(_in_steps(values, step))
    at_other, others = (at, readings) if other is None else _changes(_in_steps(other, step))
    if min(len(readings), len(others)) < _LENGTH:
        return []
    hashes = _stretch_hashes(_row_hashes(readings))
    hashes_other = hashes if other is None else _stretch_hashes(_row_hashes(others))
    offsets = _offsets(hashes, hashes_other, same=other is None)
    found = [run for offset in offsets for run in _runs(readings, others, offset)]
    ends, ends_other = np.append(at, len(values)), np.append(at_other, len(values if other is None else other))
    repeats = [
        Repeat(
            first=int(ends[start]),
            first_stop=int(ends[start + count]),
            second=int(ends_other[start + offset]),
            second_stop=int(ends_other[start + offset + count]),
        )
        for start, count, offset in found
    ]
    return sorted(repeats, key=lambda repeat: repeat.second)


class RepeatWatch:
    """Looks for stretches that occur twice in samples that come block by block, in memory that does not grow."""

    def __init__(self) -> None:
        self._readings, self._t_s = np.empty((0, 3)), np.empty(0)  # not yet looked for, in steps
        self._step: Floats | None = None
        self._hashes, self._at_s = np.empty(0, np.uint64), np.empty(0)  # of stretches seen, in the order of the hashes
        self._every, self._stretches = _LENGTH, 0
        self._found: list[Floats] = []  # when a stretch begins, and when it did before [s]

    def add(self, values: Floats, t_s: Floats) -> None:
        """Take the next samples (n, 3) and when they were measured (n,) [s]."""
        if self._step is None:
            self._step = _coarseness(values)
        before = self._readings[-1:]
        at, readings = _changes(np.concatenate([before, _in_steps(values, self._step)]))
        at, readings = at[len(before) :], readings[len(before) :]
        self._readings = np.concatenate([self._readings, readings])
        self._t_s = np.concatenate([self._t_s, t_s[at - len(before)]])
        if len(self._readings) < 2 * _LENGTH:
            return
        hashes = _stretch_hashes(_row_hashes(self._readings))
        kept = np.arange(-self._stretches % self._every, len(hashes), self._every)
        self._stretches += len(hashes)
        self._keep(np.append(self._hashes, hashes[kept]), np.append(self._at_s, self._t_s[kept]))
        place = np.minimum(np.searchsorted(self._hashes, hashes), len(self._hashes) - 1)
        hits = np.flatnonzero((self._hashes[place] == hashes) & (self._at_s[place] < self._t_s[: len(hashes)]))
        varied = [k for k in hits if len(np.unique(self._readings[k : k + _LENGTH], axis=0)) >= _DIFFERENT]
        self._found.append(np.column_stack([self._t_s[varied], self._at_s[place[varied]]]))
        self._readings, self._t_s = self._readings[len(hashes) :], self._t_s[len(hashes) :]

    def _keep(self, hashes: _Hashes, at_s: Floats) -> None:
        if len(hashes) > _MOST_KEPT:
            by_time = np.argsort(at_s)[::2]
            hashes, at_s, self._every = hashes[by_time], at_s[by_time], 2 * self._every
        order = np.argsort(hashes, kind="stable")
        self._hashes, self._at_s = hashes[order], at_s[order]

    def copies(self) -> tuple[Floats, float]:
        """Return when stretches (k, 2) begin and when they did before [s], and which share of all readings are copies.

        All have the same distance in time, that of most of them.
        """
        found = np.concatenate([np.empty((0, 2)), *self._found])
        if not len(found):
            return found, 0.0
        back = np.round(found[:, 0] - found[:, 1], 2)
        distances, count = np.unique(back, return_counts=True)
        share = len(found) * self._every / max(self._stretches, 1)
        return found[back == distances[np.argmax(count)]], min(share, 1.0)


def _coarseness(values: Floats) -> Floats:
    """Return steps (3,) [unit] in which readings are compared; where none changes they have to be the same."""
    stride = max(1, len(values) // _CHANGES_LOOKED_AT)
    steps = np.abs(values[1::stride] - values[:-1:stride])
    changes = [column[column != 0] for column in steps.T]
    return np.array([quantile_of(change, _SMALL) / 2 if len(change) else _SAME for change in changes])


def _in_steps(values: Floats, step: Floats) -> Floats:
    return np.round(values / step) + 0.0  # no negative zeros, whose bits differ


def _changes(values: Floats) -> tuple[Integers, Floats]:
    """Return where the reading changes (k,), and the readings from there on (k, 3)."""
    if not len(values):
        return np.zeros(0, np.int64), values
    changed = values[1:] != values[:-1]
    at = np.flatnonzero(np.append(True, changed[:, 0] | changed[:, 1] | changed[:, 2]))  # any(axis=1) is slow
    return at, values[at]


def _row_hashes(readings: Floats) -> _Hashes:
    bits = np.ascontiguousarray(readings).view(np.uint64)
    mixed = np.zeros(len(bits), np.uint64)
    for column, factor in enumerate(_COLUMNS):
        mixed ^= bits[:, column] * np.uint64(factor)
        mixed ^= mixed >> np.uint64(29)
        mixed *= np.uint64(_BASE)
    return mixed ^ (mixed >> np.uint64(32))


def _stretch_hashes(rows: _Hashes) -> _Hashes:
    """Return a hash of the readings i to i + 63 for each i, as differences of one sum modulo 2^64."""
    powers = np.multiply.accumulate(np.full(len(rows), _BASE, np.uint64))
    total = np.append(np.uint64(0), np.add.accumulate(rows * powers))
    back = np.multiply.accumulate(np.full(len(rows), pow(_BASE, -1, 2**64), np.uint64))
    return (total[_LENGTH:] - total[:-_LENGTH]) * back[: len(rows) - _LENGTH + 1]


def _offsets(hashes: _Hashes, others: _Hashes, *, same: bool) -> list[int]:
    """Return by how much copies are shifted, the most frequent first; every 64th stretch is looked for."""
    anchors = np.arange(0, len(hashes), _LENGTH)
    unique, first = np.unique(hashes[anchors], return_index=True)
    ends = np.zeros(1 << 16, dtype=bool)  # of the hashes: most are told apart by them
    ends[unique & 0xFFFF] = True
    hits = np.flatnonzero(ends[others & 0xFFFF])
    place = np.minimum(np.searchsorted(unique, others[hits]), len(unique) - 1)
    same_hash = unique[place] == others[hits]
    hits = hits[same_hash]
    shift = hits - anchors[first[place[same_hash]]]
    if same:
        shift = shift[shift >= _LENGTH]
    values, counts = np.unique(shift, return_counts=True)
    return [int(value) for value in values[np.argsort(-counts, kind="stable")][:_MOST_OFFSETS]]


def _runs(readings: Floats, others: Floats, offset: int) -> list[tuple[int, int, int]]:
    """Return start and number of the readings that are repeated at an offset, and the offset."""
    start = max(0, -offset)
    count = min(len(readings) - start, len(others) - start - offset)
    apart = np.abs(readings[start : start + count] - others[start + offset : start + offset + count])
    alike = np.asarray((apart <= 1).all(axis=1), dtype=bool)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], alike.view(np.int8), [0]])))
    runs = [(start + int(a), int(b - a), offset) for a, b in zip(edges[::2], edges[1::2], strict=True)]
    return [
        run
        for run in runs
        if run[1] >= _LENGTH and len(np.unique(readings[run[0] : run[0] + _LENGTH], axis=0)) >= _DIFFERENT
    ]


@value_class
class RangeChange:
    """Where the accelerometer began to read gravity as another number.

    Attributes
    ----------
    last, first : last sample of the last rest before it, and first sample of the first rest after it
    factor : what is read after it, over what was read before
    kept : samples of the side that is calibrated, from its first to one past its last
    """

    last: int
    first: int
    factor: float
    kept: tuple[int, int]


def find_range_change(
    read: Floats, parts: StaticIntervals, samples: int, gravity: float | None = None, enough: int = 0
) -> RangeChange | None:
    """Return the one instant from which on gravity is read as another number; None where all read about the same.

    The side that reads gravity is kept where it has enough rests, else the one with more of them.

    Parameters
    ----------
    read : (m,) magnitude of gravity as each part read it [unit]
    parts : (m,) rests in order of time, found whatever their noise, or stretches of a motion
    samples : number of samples of the recording
    gravity : in that unit; None for counts
    enough : number of rests that determine a calibration
    """
    if len(read) < 2 * _FEWEST_RESTS or not (read > 0).all():
        return None
    logs = np.log(read)
    away = np.cumsum(logs - logs.mean())[_FEWEST_RESTS - 1 : -_FEWEST_RESTS]
    k = int(np.argmax(np.abs(away))) + _FEWEST_RESTS
    before, after = float(median_of(read[:k])), float(median_of(read[k:]))
    sides = (read[:k], before), (read[k:], after)
    alike = all(float(np.mean(np.abs(side / middle - 1) > _ALIKE)) <= _FEW_ODD for side, middle in sides)
    low, high = (side for side, _ in sorted(sides, key=lambda side: side[1]))
    apart = quantile_of(low, 1 - _FEW_ODD) < quantile_of(high, _FEW_ODD)
    if not (alike and apart) or max(before, after) < _FACTOR * min(before, after):
        return None
    last, first = int(parts.stop[k - 1]) - 1, int(parts.start[k])
    middle = (last + first + 1) // 2
    counts = (k, len(read) - k)
    errors = [abs(np.log(one / gravity)) if gravity else 0.0 for one in (before, after)]
    best = min((0, 1), key=lambda side: (counts[side] < enough, errors[side] > np.log(_FACTOR), -counts[side]))
    return RangeChange(
        last=last, first=first, factor=after / before, kept=(0, middle) if best == 0 else (middle, samples)
    )
