"""The overlapping Allan variance of a triad, sample block by sample block, in memory that does not grow.

With S(k), the sum of the first k samples, the overlapping Allan variance of m samples averaged is the mean of z_m^2
over all k, divided by 2 m^2, where z_m(k) = S(k + 2 m) - 2 S(k + m) + S(k). Averaging times m are powers of two.
"""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from math import log2
from typing import Any

import numpy as np

from ...frozen import value_class
from ...kernel import load_kernel
from ...kernel.library import ALLAN_SHORT, allan_long, allan_short
from ...recording import Floats, Integers

_HALO = 1 << ALLAN_SHORT
"""Averaging times below 2^12 samples are summed up as the samples come, longer ones from the S that are kept."""
_CHUNK, _CHUNKS = 1 << 18, 4  # samples of a chunk, and how many are worked on at once
_KEPT = 1 << 22  # S kept of each axis; of longer recordings every second, fourth, ... one


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
        self._waiting = self._first = np.empty((0, 3))  # the last samples, and the first ones
        self._squares, self._terms = np.zeros((3, ALLAN_SHORT)), np.zeros(ALLAN_SHORT)
        self._kept: list[Floats] = []  # S (3, k) from a chunk's own beginning, at every `stride`-th sample
        self._zeros: list[Floats] = []  # S (3,) where the chunks begin
        self._stride = 1
        self._line = np.zeros((3, 3))  # number of samples, their sums, their sums times their numbers; from the first

    def add(self, values: Floats) -> None:
        """Take the next samples, (n, 3)."""
        self.samples += len(values)
        values = np.concatenate([self._waiting, values]) if len(self._waiting) else values
        ready = (len(values) - _HALO) // _HALO * _HALO
        ready = ready if ready >= _CHUNK else 0
        for start in range(0, ready, _CHUNKS * _CHUNK):
            stop = min(start + _CHUNKS * _CHUNK, ready)
            self._process(values[start : stop + _HALO], stop - start)
        self._waiting = values[ready:].copy()

    def _process(self, values: Floats, count: int) -> None:
        """Sum up over the first samples, which have enough successors or are the last ones."""
        if not len(self._first):
            self._first = values[:_HALO].copy()
        parts = [(values[k : k + _CHUNK + _HALO], min(count - k, _CHUNK)) for k in range(0, count, _CHUNK)]
        parts = [(part[: own + _HALO], own) for part, own in parts]
        for (part, own), found in zip(parts, _side_by_side(partial(_short_sums, self._first[0]), parts), strict=True):
            sums, squares, line = found
            self._squares += squares
            self._terms += np.clip(len(part) + 1 - (2 << np.arange(ALLAN_SHORT)), 0, own)
            kept = sums[:, : own + (own == len(part)) : self._stride]
            self._kept.append(kept if self._stride == 1 else kept.copy())
            self._zeros.append(self._line[1].copy())
            self._line += [
                np.full(3, own),
                sums[:, own],
                (own - 1) * sums[:, own] - line + self._line[0] * sums[:, own],
            ]
        if sum(part.shape[1] for part in self._kept) > _KEPT:
            self._kept, self._zeros = [_joined(self._kept, self._zeros)[:, ::2].copy()], [np.zeros(3)]
            self._stride *= 2

    def variance(self, rate_hz: float) -> AllanVariance:
        """Return the variances over all samples so far, at most a third of them averaged; ends the summation."""
        levels, rest = _levels(self.samples), self._waiting
        if len(rest):
            self._process(rest, len(rest))
        factors = 1 << np.arange(levels, dtype=np.int64)
        squares, terms, totals = self._squares[:, :levels], self._terms[:levels], self._totals(rest, factors)
        if levels > ALLAN_SHORT:
            parts = [([part[i] for part in self._kept], np.array(self._zeros)[:, i]) for i in range(3)]
            m = _HALO // self._stride
            long = _side_by_side(partial(_long_sums, m, levels - ALLAN_SHORT), parts)
            squares, totals = (
                np.append(a, b, axis=1) for a, b in zip((squares, totals), zip(*long, strict=True), strict=True)
            )
            held = sum(len(part) for part in parts[0][0])
            terms = np.append(terms, held - 2 * (m << np.arange(levels - ALLAN_SHORT)))
        self._kept, self._waiting = [], np.empty((0, 3))  # other sums may need the memory
        n, total, numbered = self._line
        slope = (numbered - total * (n - 1) / 2) / np.maximum(n * (n * n - 1) / 12, 1.0)
        line = slope[:, None] * 4.0 ** np.arange(levels)  # z_m of the line is slope m^2
        means, totals = squares / terms, totals / terms
        straight = np.maximum(means - 2 * line * totals + line**2, 0.0)
        return AllanVariance(
            rate_hz=rate_hz,
            samples=self.samples,
            factors=factors,
            variance=(means / (2.0 * factors**2)).T,
            straight=(straight / (2.0 * factors**2)).T,
            slope=slope * rate_hz,
        )

    def _totals(self, rest: Floats, factors: Integers) -> Floats:
        """Return the sums of z_m (3, k) of shorter averaging times: the first and the last samples are left of them."""
        totals = np.zeros((3, min(len(factors), ALLAN_SHORT)))
        for level, m in enumerate(factors[:ALLAN_SHORT].tolist()):
            weights = np.minimum(np.arange(1, 2 * m), np.arange(2 * m - 1, 0, -1))
            totals[:, level] = weights @ (rest[len(rest) - len(weights) :] - self._first[: len(weights)])
        return totals


def _levels(samples: int) -> int:
    """Return the number of averaging times 1, 2, 4, ... up to a third of the samples."""
    return int(log2(samples / 3)) + 1 if samples >= 3 else 0


def _side_by_side(work: Callable[..., Any], parts: Sequence[tuple[Any, Any]]) -> list[Any]:
    """Do a piece of work for every part; the kernel and NumPy let other threads run in their long loops."""
    if len(parts) == 1:
        return [work(*parts[0])]
    with ThreadPoolExecutor(len(parts)) as pool:
        return list(pool.map(work, *zip(*parts, strict=True)))


def _joined(parts: list[Floats], zeros: Sequence[Floats] | Floats) -> Floats:
    """Return S in one piece."""
    return np.concatenate([(part.T + zero).T for part, zero in zip(parts, zeros, strict=True)], axis=-1)


def _short_sums(zero: Floats, values: Floats, count: int) -> tuple[Floats, Floats, Floats]:
    """Return sums of samples (n, 3) for averaging times below 2^12 samples, see `allan_short`."""
    if load_kernel() is not None:
        return allan_short(values, zero, count)
    sums = np.concatenate([np.zeros((1, 3)), np.cumsum(values - zero, axis=0)]).T.copy()
    squares = [np.sum(_differences(sums, 1 << level)[:, :count] ** 2, axis=1) for level in range(ALLAN_SHORT)]
    return sums, np.stack(squares, axis=1), sums[:, :count].sum(axis=1)


def _long_sums(m: int, levels: int, parts: list[Floats], zeros: Floats) -> tuple[Floats, Floats]:
    """Return sums for averaging times of m, 2 m, 4 m, ... places of one axis, see `allan_long`."""
    if load_kernel() is not None:
        return allan_long(parts, zeros, m, levels)
    found = [_differences(_joined(parts, zeros), m << level) for level in range(levels)]
    return np.array([z @ z for z in found]), np.array([z.sum() for z in found])


def _differences(sums: Floats, m: int) -> Floats:
    """Return z_m from S along the last axis."""
    return sums[..., 2 * m :] - 2 * sums[..., m:-m] + sums[..., : -2 * m]
