"""The overlapping Allan variance of a triad, sample block by sample block, in memory that does not grow.

With sums of m samples, d_m(k) = y[k] + ... + y[k + m - 1], and their differences, z_m(k) = d_m(k + m) - d_m(k), the
overlapping Allan variance is the mean of z_m^2 over all k, divided by 2 m^2. Averaging times double from one to the
next, so that d_2m(k) = d_m(k) + d_m(k + m): two additions and a product a sample and averaging time.
"""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from math import log2
from typing import Any

import numpy as np

from ...frozen import value_class
from ...kernel import load_kernel
from ...kernel.library import allan_long, allan_short
from ...recording import Floats, Integers

_SHORT = 12
"""Averaging times below 2^12 samples are summed up as the samples come, longer ones from d_m of 2^12 samples."""
_HALO = 1 << _SHORT
_CHUNK = 1 << 18
_KEPT = 1 << 22  # values of d_m kept of each axis; of longer recordings every second, fourth, ... one


@value_class
class AllanVariance:
    """Overlapping Allan variances of three axes.

    Attributes
    ----------
    rate_hz : sample rate [Hz]
    samples : number of samples
    factors : (k,) averaging times in samples
    variance : (k, 3) [unit^2]
    straight : (k, 3) the same without what a straight line through the samples adds [unit^2]
    slope : (3,) of that line [unit/s]
    """

    rate_hz: float
    samples: int
    factors: Integers
    variance: Floats
    straight: Floats
    slope: Floats

    @property
    def tau_s(self) -> Floats:
        """Averaging times (k,) [s]."""
        return self.factors / self.rate_hz


def overlapping_allan(values: Floats, rate_hz: float) -> AllanVariance:
    """Return the overlapping Allan variances of samples (n, 3) for averaging times of 1, 2, 4, ... samples to n / 3."""
    sums = AllanSums()
    sums.add(values)
    return sums.variance(rate_hz)


class AllanSums:
    """Sums for the overlapping Allan variance of samples that come in blocks."""

    def __init__(self) -> None:
        self.samples = 0
        self._waiting = np.empty((0, 3))
        self._axes: tuple[_Axis, ...] = tuple(_Axis() for _ in range(3))

    def add(self, values: Floats) -> None:
        """Take the next samples, (n, 3)."""
        self.samples += len(values)
        start = 0
        if len(self._waiting):
            start = min(max(_CHUNK + _HALO - len(self._waiting), 0), len(values))
            self._waiting = np.concatenate([self._waiting, values[:start]])
            if len(self._waiting) < _CHUNK + _HALO:
                return
            self._process(self._waiting)
            # what follows the terms of this chunk begins the next one
            if start >= _HALO:
                start -= _HALO
            else:
                self._waiting = np.concatenate([self._waiting[len(self._waiting) - _HALO :], values[start:]])
                return
        while len(values) - start >= _CHUNK + _HALO:
            self._process(values[start : start + _CHUNK + _HALO])
            start += _CHUNK
        self._waiting = values[start:].copy()

    def _process(self, rows: Floats) -> None:
        """Sum up over all samples that have enough successors."""
        self._each(lambda axis, values: axis.add(values, len(values) - _HALO), rows)

    def _each(self, work: Callable[["_Axis", Floats], Any], rows: Floats) -> list[Any]:
        """Do a piece of work for every axis, side by side: NumPy lets other threads run in its long loops."""
        if self.samples < _CHUNK:
            return [work(axis, rows[:, i]) for i, axis in enumerate(self._axes)]
        with ThreadPoolExecutor(len(self._axes)) as pool:
            return list(pool.map(work, self._axes, rows.T))

    def variance(self, rate_hz: float) -> AllanVariance:
        """Return the variances over all samples so far, at most a third of them averaged; ends the summation."""
        levels = _levels(self.samples)
        found = self._each(lambda axis, values: axis.finished(values, levels), self._waiting)
        self._axes, self._waiting = (), np.empty((0, 3))  # other sums may need the memory
        squares, straight = (np.stack([one[i] for one in found], axis=1) for i in range(2))
        return _published(self.samples, rate_hz, squares, straight, np.array([one[2] for one in found]))


def _levels(samples: int) -> int:
    """Return the number of averaging times 1, 2, 4, ... up to a third of the samples."""
    return int(log2(samples / 3)) + 1 if samples >= 3 else 0


def _published(samples: int, rate_hz: float, means: Floats, straight: Floats, slope: Floats) -> AllanVariance:
    """Return variances of mean squares (k, 3) of z_m, and of a slope (3,) [unit a sample]."""
    factors = 1 << np.arange(len(means), dtype=np.int64)
    return AllanVariance(
        rate_hz=rate_hz,
        samples=samples,
        factors=factors,
        variance=means / (2.0 * factors**2)[:, None],
        straight=straight / (2.0 * factors**2)[:, None],
        slope=slope * rate_hz,
    )


class _Axis:
    """The sums of one axis."""

    def __init__(self) -> None:
        self._squares, self._terms = np.zeros(_SHORT), np.zeros(_SHORT)
        self._kept: list[Floats] = []  # d_m of 2^12 samples, at every `stride`-th sample
        self._stride, self._held, self._total = 1, 0, 0
        self._zero = float("nan")
        self._first = np.empty(0)
        self._line = np.zeros(3)  # number of samples, their sum, their sum times their numbers; from the zero

    def add(self, values: Floats, count: int) -> None:
        """Take in the terms that begin at the first `count` samples; up to 2^12 more follow them."""
        if not len(values):
            return
        if np.isnan(self._zero):
            self._zero, self._first = float(values[0]), values[:_HALO].copy()
        squares, terms, (numbered, total), last = _short_sums(values, self._zero, count)
        self._squares += squares
        self._terms += terms
        self._line += [count, total, numbered + self._line[0] * total]
        self._kept.append(last if self._stride == 1 else last[-self._total % self._stride :: self._stride].copy())
        self._total += len(last)
        self._held += len(self._kept[-1])
        if self._held > _KEPT:
            self._kept, self._stride = [np.concatenate(self._kept)[::2].copy()], 2 * self._stride
            self._held = len(self._kept[0])

    def finished(self, rest: Floats, levels: int) -> tuple[Floats, Floats, float]:
        """Return the mean squares of so many averaging times, the samples `rest` being the last ones.

        Then the same without the straight line through the samples, and its slope [unit a sample].
        """
        self.add(rest, len(rest))
        n = self._line[0]
        slope = (self._line[2] - self._line[1] * (n - 1) / 2) / max(n * (n * n - 1) / 12, 1.0)
        squares, terms, totals = self._squares[:levels], self._terms[:levels], self._totals(rest, min(levels, _SHORT))
        if levels > _SHORT:
            long = _long_sums(np.concatenate(self._kept), _HALO // self._stride, levels - _SHORT)
            squares, terms, totals = (np.append(a, b) for a, b in zip((squares, terms, totals), long, strict=True))
        line = slope * 4.0 ** np.arange(levels)  # z_m of the line is slope m^2
        means = squares / np.maximum(terms, 1)
        straight = np.maximum(means - 2 * line * totals / np.maximum(terms, 1) + line**2, 0.0)
        return means, straight, slope

    def _totals(self, rest: Floats, levels: int) -> Floats:
        """Return the sums of z_m of shorter averaging times: terms cancel but for the first and the last d_m."""
        totals = np.zeros(levels)
        for level in range(levels):
            m = 1 << level
            weights = np.minimum(np.arange(1, 2 * m), np.arange(2 * m - 1, 0, -1))
            totals[level] = weights @ (rest[len(rest) - len(weights) :] - self._first[: len(weights)])
        return totals


def _short_sums(values: Floats, zero: float, count: int) -> tuple[Floats, Floats, Floats, Floats]:
    """Return sums of samples (n,) for averaging times below 2^12 samples, see `allan_short`."""
    if load_kernel() is not None:
        return allan_short(values, zero, count, _SHORT)
    about = values - zero
    squares, terms, _, last = _doubled(about, count, 1, _SHORT)
    line = np.array([np.arange(float(count)) @ about[:count], about[:count].sum()])
    return squares, terms, line, last


def _long_sums(sums: Floats, m: int, levels: int) -> tuple[Floats, Floats, Floats]:
    """Return sums for averaging times of m, 2 m, 4 m, ... samples from sums (n,) of m samples, see `allan_long`."""
    return allan_long(sums, m, levels) if load_kernel() is not None else _doubled(sums, len(sums), m, levels)[:3]


def _doubled(d: Floats, count: int, m: int, levels: int) -> tuple[Floats, Floats, Floats, Floats]:
    """Return sums of z_m^2 that begin at the first `count` places, their numbers, sums of all z_m, and the last d_m."""
    squares, terms, totals = np.zeros((3, levels))
    for level in range(levels):
        pairs = len(d) - m
        if pairs <= 0:
            return squares, terms, totals, d[:0]
        count = min(count, pairs)
        z = d[m:] - d[:pairs]
        squares[level], terms[level], totals[level] = z[:count] @ z[:count], count, z.sum()
        d, m = d[:pairs] + d[m:], 2 * m
    return squares, terms, totals, d[:count]
