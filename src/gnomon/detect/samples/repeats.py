"""Stretches of samples that occur twice: a file appended to itself, or two that share a part.

Copies that were written with other decimals differ by less than samples do: readings are compared in steps of half of
what the smallest tenth of all changes is.

Sensors repeat single readings by chance, and at rest, coarsely quantised, they do so all the time. Readings that do not
change are therefore counted once, and a stretch counts from 64 changes in succession on, between at least 32 different
readings: a noise of one step flips between fewer, and more noise does not repeat itself.
"""

import numpy as np
from numpy.typing import NDArray

from ...frozen import value_class
from ...recording import Floats, Integers

_LENGTH = 64  # successive different readings
_DISTINCT = 32  # of them
_SMALL = 0.1  # quantile of changes
_LOOKED_AT = 10_000  # changes, about, that tell it
_SAME = 1e-9  # step [unit] of readings of which no change was seen
_MOST_OFFSETS = 16
_MOST_KEPT = 1 << 19  # stretches that are remembered of a long recording
_BASE = 0x9E3779B97F4A7C15  # odd: it has an inverse modulo 2^64
_COLUMNS = (0xBF58476D1CE4E5B9, 0x94D049BB133111EB, 0xD6E8FEB86659FD93)

_Hashes = NDArray[np.uint64]


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
        varied = [k for k in hits if len(np.unique(self._readings[k : k + _LENGTH], axis=0)) >= _DISTINCT]
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
    stride = max(1, len(values) // _LOOKED_AT)
    steps = np.abs(values[1::stride] - values[:-1:stride])
    changes = [column[column != 0] for column in steps.T]
    return np.array([np.quantile(change, _SMALL) / 2 if len(change) else _SAME for change in changes])


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
        if run[1] >= _LENGTH and len(np.unique(readings[run[0] : run[0] + _LENGTH], axis=0)) >= _DISTINCT
    ]
