"""The overlapping Allan variance of a triad, sample block by sample block, in memory that does not grow.

With sums of m samples, d_m(k) = y[k] + ... + y[k + m - 1], and their differences, z_m(k) = d_m(k + m) - d_m(k), the
overlapping Allan variance is the mean of z_m^2 over all k, divided by 2 m^2. Averaging times double from one to the
next, so that d_2m(k) = d_m(k) + d_m(k + m), and sum z_m^2 follows from sums of squares and of products of d_m alone:
one product and one addition a sample and averaging time.

The overlapping Allan variance of samples that fit into memory, from products of their running sum.

With the running sum x, z_m(k) = x[k + 2 m] - 2 x[k + m] + x[k], and the sum of z_m^2 over all k consists of products of
x with itself m and 2 m places later. Averaging times double from one to the next, so that each needs one such product
of the whole length, and some at the ends. Where x is so much larger than its differences that their rounding would
show, this is of no use (`rounding`).
"""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from math import log2
from os import cpu_count
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...frozen import value_class
from ...kernel import load_kernel
from ...kernel.library import lagged_products, running_sums
from ...recording import Floats, Integers

_PRODUCTS_PIECE = 1 << 17  # of the running sum; it and what is multiplied with it stay in the processor's memory
_EPSILON = float(np.finfo(np.float64).eps)


@value_class
class AxisProducts:
    """Sums over one axis.

    Attributes
    ----------
    means : (k,) mean of z_m^2 for m = 1, 2, 4, ...
    totals : (k,) mean of z_m
    slope : of the straight line through the samples [unit a sample]
    rounding : relative error of `means` that rounding may have made
    """

    means: Floats
    totals: Floats
    slope: float
    rounding: float


def product_sums(values: Floats, levels: int) -> list[AxisProducts]:
    """Return the sums of each axis of samples (n, 3), for so many averaging times; 2^levels samples are the least."""
    compiled = load_kernel() is not None
    with ThreadPoolExecutor(min(3, cpu_count() or 1)) as pool:
        sums = running_sums(values, pool.map) if compiled else pool.map(_running_sum, values.T)
        work = lagged_products if compiled else _sums
        return list(pool.map(lambda x: _axis_products(len(x) - 1, *work(x, levels)), sums))


def _running_sum(y: Floats) -> Floats:
    x = np.empty(len(y) + 1)
    x[0] = 0.0
    np.cumsum(y - y.mean(), out=x[1:])  # z_m does not see the mean
    return x


def _sums(x: Floats, levels: int) -> tuple[Floats, Floats, Floats]:
    """Return the products of x with itself later, its square and its sum, and sums at its ends."""
    return _lagged_products(x, levels + 1), np.array([np.dot(x, x), x.sum()]), _end_sums(x, levels)


def _axis_products(n: int, lagged: Floats, whole: Floats, ends: Floats) -> AxisProducts:
    """Return the sums of an axis of n samples from those of its running sum, see `_sums`."""
    levels = ends.shape[1]
    square, total = float(whole[0]), float(whole[1])
    terms = n + 1 - 2.0 ** np.arange(1, levels + 1)
    squares, products, sums = ends[:4], ends[4:6].sum(axis=0), ends[6:]
    middle = 4 * (square - squares[0] - squares[3])
    outer = 2 * square - squares.sum(axis=0)
    means = (outer + middle - 4 * (2 * lagged[:-1] - products) + 2 * lagged[1:]) / terms
    least = float((means * (terms - 1)).min())
    return AxisProducts(
        means=means,
        totals=(sums[0] + sums[1]) / terms,
        slope=-total / (n * (n * n - 1.0) / 12),
        rounding=16 * _EPSILON * square / least if least > _EPSILON * square else np.inf,
    )


def _end_sums(x: Floats, levels: int) -> Floats:
    """Return sums over the first and the last m and 2 m values of x, of m = 1, 2, 4, ..., (8, levels).

    Squares of the first, the second, the last but one and the last m; products of the first with the second, and of the
    last two; the sum of the first without that of the second, and of the last without that of the one before.
    """
    found, n = np.zeros((8, levels)), len(x)
    for rows, last in (([0, 1, 4, 6], False), ([3, 2, 5, 7], True)):
        square, total = float(x[-int(last)] ** 2), float(x[-int(last)])
        for level in range(levels):
            m = 1 << level
            near, far = (x[n - m :], x[n - 2 * m : n - m]) if last else (x[:m], x[m : 2 * m])
            far_square, far_total = float(np.dot(far, far)), float(far.sum())
            found[rows, level] = square, far_square, float(np.dot(near, far)), total - far_total
            square, total = square + far_square, total + far_total
    return found


def _lagged_products(x: Floats, count: int) -> Floats:
    """Return the products of x (n,) with the values 1, 2, 4, ... places later, (count,)."""
    found = np.zeros(count)
    for start in range(0, len(x), _PRODUCTS_PIECE):
        piece = x[start : start + _PRODUCTS_PIECE]
        for k in range(count):
            later = x[start + (1 << k) : start + (1 << k) + len(piece)]
            found[k] += np.dot(piece[: len(later)], later)
    return found


_SHORT = 12
"""Averaging times below 2^12 samples are summed up as the samples come, longer ones from d_m of 2^12 samples."""
_HALO = 1 << _SHORT
_CHUNK = 1 << 18
_KEPT = 1 << 22  # values of d_m kept of each axis; of longer recordings every second, fourth, ... one
_PIECE = 1 << 15
_ROUNDING = 1e-7  # relative, that is let pass
_EXACT = 0.3  # share of the squares that must remain in the differences, for single precision to suffice


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
    n = len(values)
    if _CHUNK <= n <= _KEPT:
        levels = _levels(n)
        found = product_sums(values, levels)
        if max(axis.rounding for axis in found) < _ROUNDING:
            line = np.array([axis.slope for axis in found]) * 4.0 ** np.arange(levels)[:, None]
            means = np.stack([axis.means for axis in found], axis=1)
            totals = np.stack([axis.totals for axis in found], axis=1)
            straight = np.maximum(means - 2 * line * totals + line**2, 0.0)
            return _published(n, rate_hz, means, straight, line[0])
    sums = AllanSums()
    sums.add(values)
    return sums.variance(rate_hz)


class AllanSums:
    """Sums for the overlapping Allan variance of samples that come in blocks."""

    def __init__(self) -> None:
        self.samples = 0
        self._waiting = np.empty((0, 3))
        self._axes: tuple[_Axis, ...] = tuple(_Axis(_Space()) for _ in range(3))

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

    def __init__(self, space: "_Space") -> None:
        self._space = space
        self._squares, self._terms = np.zeros(_SHORT), np.zeros(_SHORT)
        self._kept: list[Floats] = []  # d_m of 2^12 samples, at every `stride`-th sample
        self._stride, self._held, self._total = 1, 0, 0
        self._zero = float("nan")
        self._first = np.empty(0)
        self._line = np.zeros(3)  # number of samples, their sum, their sum times their numbers; from the first middle
        self._kind: type[Any] = np.float32

    def add(self, values: Floats, count: int) -> None:
        """Take in the terms that begin at the first `count` samples; up to 2^12 more follow them."""
        if not len(values):
            return
        middle = float(values.mean())
        if np.isnan(self._zero):
            self._zero, self._first = middle, values[:_HALO].copy()
        centred = np.subtract(values, middle, out=self._space.array(3, len(values), np.float64))
        middle -= self._zero
        self._sum_line(centred[:count], middle)
        sums = _squares(centred, self._kind, count=count, levels=_SHORT, space=self._space)
        if not sums.exact:
            self._kind = np.float64
            sums = _squares(centred, self._kind, count=count, levels=_SHORT, space=self._space)
        self._squares += sums.squares
        self._terms += sums.terms
        kept = sums.last[-self._total % self._stride :: self._stride]
        self._kept.append(np.add(kept, _HALO * middle, dtype=np.float64))
        self._total += len(sums.last)
        self._held += len(self._kept[-1])
        if self._held > _KEPT:
            self._kept, self._stride = [np.concatenate(self._kept)[::2]], 2 * self._stride
            self._held = len(self._kept[0])

    def _sum_line(self, centred: Floats, middle: float) -> None:
        """Take in samples for the straight line, as their distances from a middle."""
        n = len(centred)
        total = float(centred.sum()) + n * middle
        numbered = float(np.dot(self._numbers(n), centred)) + middle * n * (n - 1) / 2
        self._line += [n, total, numbered + self._line[0] * total]

    def _numbers(self, count: int) -> Floats:
        if len(self._space.numbers) < count:
            self._space.numbers = np.arange(float(count))
        return self._space.numbers[:count]

    def finished(self, rest: Floats, levels: int) -> tuple[Floats, Floats, float]:
        """Return the mean squares of so many averaging times, the samples `rest` being the last ones.

        Then the same without the straight line through the samples, and its slope [unit a sample].
        """
        self.add(rest, len(rest))
        n = self._line[0]
        slope = (self._line[2] - self._line[1] * (n - 1) / 2) / max(n * (n * n - 1) / 12, 1.0)
        squares, terms, totals = self._squares[:levels], self._terms[:levels], self._totals(rest, min(levels, _SHORT))
        if levels > _SHORT:
            sums = self._long(levels - _SHORT)
            squares, terms = np.append(squares, sums.squares), np.append(terms, sums.terms)
            totals = np.append(totals, sums.totals)
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

    def _long(self, levels: int) -> "_Sums":
        """Return the sums of averaging times from 2^12 samples on."""
        kept = np.concatenate(self._kept)
        kept -= kept.mean()
        shift = _HALO // self._stride
        sums = _squares(kept, np.float32, count=len(kept), levels=levels, space=self._space, shift=shift)
        if sums.exact:
            return sums
        return _squares(kept, np.float64, count=len(kept), levels=levels, space=self._space, shift=shift)


class _Space:
    """Memory for some arrays, kept from call to call: new memory costs more than the work that is done in it."""

    def __init__(self) -> None:
        self._arrays: dict[tuple[int, Any], NDArray[Any]] = {}
        self.numbers = np.empty(0)  # 0, 1, 2, ...

    def array(self, which: int, length: int, kind: type[Any]) -> NDArray[Any]:
        """Return an array of this length and type; what it held before is lost."""
        held = self._arrays.get((which, kind))
        if held is None or len(held) < length:
            held = self._arrays[which, kind] = np.empty(length, kind)
        return held[:length]


@value_class
class _Sums:
    """Sums of z_m^2 for m that double.

    Attributes
    ----------
    squares, terms, totals : (levels,) the sums, of how many terms, and the sums of z_m itself over all pairs
    last : d_m of the averaging time after the last one
    exact : whether no difference was so small against its terms that their rounding would show
    """

    squares: Floats
    terms: Floats
    totals: Floats
    last: NDArray[Any]
    exact: bool


@np.errstate(over="ignore", invalid="ignore")  # beyond single precision they are not exact, and summed up in double
def _squares(values: Floats, kind: type[Any], *, count: int, levels: int, space: _Space, shift: int = 1) -> _Sums:
    """Return sums over the terms that begin at the first `count` places.

    Parameters
    ----------
    values : (n,) d_m of the first averaging time, about zero
    kind : precision, np.float32 or np.float64
    levels : number of averaging times
    shift : the first m, in places
    """
    squares, terms, totals, exact = np.zeros(levels), np.zeros(levels), np.zeros(levels), True
    before = float(np.dot(values[:count], values[:count]))  # in double precision, since it enters all others
    d: NDArray[Any] = values
    if kind is not np.float64:
        d = space.array(2, len(values), kind)
        d[:] = values
    for level in range(levels):
        pairs = len(d) - shift  # d(k), d(k + m)
        if pairs <= 0:
            return _Sums(squares=squares, terms=terms, totals=totals, last=d[:0], exact=exact)
        used = min(count, pairs)
        before -= _dot(d[used:count], d[used:count])
        both = 2 * before + _dot(d[used : used + shift], d[used : used + shift]) - _dot(d[:shift], d[:shift])
        products = 2 * _dot(d[:used], d[shift : shift + used])
        squares[level], terms[level] = max(both - products, 0.0), used
        totals[level] = float(d[pairs:].sum()) - float(d[:shift].sum())
        exact = exact and squares[level] >= _EXACT * both
        d = np.add(d[:pairs], d[shift:], out=space.array(level % 2, len(values), kind)[:pairs])
        before, count, shift = both + products, used, 2 * shift
    return _Sums(squares=squares, terms=terms, totals=totals, last=d[:count], exact=exact)


def _dot(a: NDArray[Any], b: NDArray[Any]) -> float:
    """Return a product that is summed up in pieces, so that single precision does not accumulate."""
    return sum(float(np.dot(a[i : i + _PIECE], b[i : i + _PIECE])) for i in range(0, len(a), _PIECE))
