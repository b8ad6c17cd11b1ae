"""The overlapping Allan variance of a triad, and what noise of known kinds makes of it.

It is summed up sample block by sample block, in memory that does not grow.

With S(k), the sum of the first k samples, the overlapping Allan variance of m samples averaged is the mean of z_m^2
over all k, divided by 2 m^2, where z_m(k) = S(k + 2 m) - 2 S(k + m) + S(k). Averaging times m are powers of two.

Noise of known kinds gives it a mean, and tells how its estimates scatter together.

Averaging times are in samples, m; the parameters theta are variances for a sample period of one:

    kind               spectrum        Allan variance            integral's generalised covariance
    quantisation  Q    Q^2 (2 pi f)^2  3 Q^2 / m^2               Q^2 at s = 0
    white noise   N    N^2             N^2 / m                   -N^2 |s| / 2
    instability   B    B^2 / (2 pi f)  (2 ln 2 / pi) B^2         B^2 s^2 ln|s| / (2 pi)
    random walk   K    K^2 / (2 pi f)^2  K^2 m / 3               K^2 |s|^3 / 12

and between them, so that noise of other slopes is noticed, theta with

    below white        theta / f^(1/2)    theta m^(-1/2)            -|s|^(3/2) / (4 - 2 sqrt 2)
    below flicker      theta / f^(3/2)    theta m^(1/2)             |s|^(5/2) / (4 sqrt 2 - 4)

(two-sided spectra, IEEE 952; the last two but for a factor). A filter in the sensor that passes low frequencies as they
are takes the integral's variance over m from N^2 m to N^2 (m - a) for m beyond its memory, whatever filter it is, which
takes 3 N^2 a / (2 m^2) from the Allan variance.

The integral x of the noise has no covariance, but its second differences have one, which follows from the generalised
covariance g(s) by differencing it at both ends. The estimates at averaging times i and j are means of squares of
Gaussian second differences, whence their covariance 2 cov(z_i, z_j)^2, summed over all pairs.
"""

import ctypes
from collections.abc import Sequence
from math import log, log2, pi, sqrt

import numpy as np

from ...frozen import value_class
from ...kernel import array_in, array_out, c_long, load_kernel
from ...processes import results_ahead
from ...recording import Floats, Integers

_SHORT = 12
"""Of averaging times that are summed up as the samples come (SHORT in kernel.c)."""
_HALO = 1 << _SHORT
"""Averaging times below 2^12 samples are summed up as the samples come, longer ones from samples that are kept."""
_CHUNK, _CHUNKS = 1 << 18, 4  # samples of a chunk, and how many are taken at once
_KEPT = 1 << 22  # samples kept; of longer recordings two, four, ... are one

KINDS = ("quantisation", "white_noise", "bias_instability", "random_walk")
COLUMNS = (*KINDS, "below_white", "below_flicker", "filter")
"""What a fit may be made of: kinds of noise, noise of slopes between them, and what a low-pass filter takes off."""

FLOOR = 2 * log(2) / pi
"""Allan variance of 1/f noise in units of B^2: the floor of the Allan deviation is 0.664 B."""
_SECOND = np.array([1.0, -2.0, 1.0])
_FINE = 8  # lags in the shorter averaging time, near the lags where the covariance bends
_NODES, _BEGINS = 240, 48  # of the integrals over the recording
_TAIL = 60  # lags beyond
_FAR = 40  # of the longer averaging time: beyond, 1/f noise is no more correlated


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
        self._squares, self._terms = np.zeros((3, _SHORT)), np.zeros(_SHORT)
        self._kept: list[Floats] = []  # samples (k, 3), each the sum of `stride`
        self._marks: list[Floats] = []  # S (k, 3) of the first 0, 2^12, 2 2^12, ... samples
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
        sums = results_ahead(lambda part: _short_sums(*part, self._first[0], self._stride), parts)
        for (part, own), (marks, end, squares, line, thinned) in zip(parts, sums, strict=True):
            self._squares += squares
            self._terms += np.clip(len(part) + 1 - (2 << np.arange(_SHORT)), 0, own)
            self._kept.append(part[:own] if self._stride == 1 else thinned)
            self._marks.append((marks if own == len(part) else marks[:-1]) + self._line[1])
            self._line += [np.full(3, own), end, (own - 1) * end - line + self._line[0] * end]
        if sum(map(len, self._kept)) > _KEPT:
            ends = [len(part) // 2 * 2 for part in self._kept]
            self._kept = [
                part[:end:2] + part[1:end:2] - 2 * self._zero for part, end in zip(self._kept, ends, strict=True)
            ]
            self._stride *= 2

    @property
    def _zero(self) -> Floats:
        """What kept samples are summed up about, (3,)."""
        return self._first[0] if self._stride == 1 else np.zeros(3)

    def variance(self, rate_hz: float) -> AllanVariance:
        """Return the variances over all samples so far, at most a third of them averaged; ends the summation."""
        levels, rest = _levels(self.samples), self._waiting
        if len(rest):
            self._process(rest, len(rest))
        factors = 1 << np.arange(levels, dtype=np.int64)
        squares, terms, totals = self._squares[:, :levels], self._terms[:levels], self._totals(rest, factors)
        if levels > _SHORT:
            m = _HALO // self._stride
            long = _long_sums(self._kept, np.concatenate(self._marks), self._zero, m, levels - _SHORT)
            squares, totals = (np.append(a, b, axis=1) for a, b in zip((squares, totals), long, strict=True))
            held = sum(map(len, self._kept)) + 1
            terms = np.append(terms, held - 2 * (m << np.arange(levels - _SHORT)))
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
        totals = np.zeros((3, min(len(factors), _SHORT)))
        for level, m in enumerate(factors[:_SHORT].tolist()):
            weights = np.minimum(np.arange(1, 2 * m), np.arange(2 * m - 1, 0, -1))
            totals[:, level] = weights @ (rest[len(rest) - len(weights) :] - self._first[: len(weights)])
        return totals


def _levels(samples: int) -> int:
    """Return the number of averaging times 1, 2, 4, ... up to a third of the samples."""
    return int(log2(samples / 3)) + 1 if samples >= 3 else 0


def _short_sums(values: Floats, count: int, zero: Floats, stride: int) -> tuple[Floats, Floats, Floats, Floats, Floats]:
    """Return sums of samples (n, 3) for averaging times below 2^12 samples, see `_kernel_short`."""
    if load_kernel() is not None:
        return _kernel_short(values, zero, count, stride)
    sums = np.concatenate([np.zeros((1, 3)), np.cumsum(values - zero, axis=0)])
    squares = [np.sum(_differences(sums, 1 << level)[:count] ** 2, axis=0) for level in range(_SHORT)]
    first = sums[: count + 1]
    return (
        first[::_HALO],
        first[-1],
        np.stack(squares, axis=1),
        first[:-1].sum(axis=0),
        np.diff(first[::stride], axis=0),
    )


def _long_sums(samples: list[Floats], marks: Floats, zero: Floats, m: int, levels: int) -> tuple[Floats, Floats]:
    """Return sums for averaging times of m, 2 m, 4 m, ... samples, see `_kernel_long`."""
    if load_kernel() is not None:
        return _kernel_long(samples, marks, zero, m, levels)
    sums = np.cumsum(np.concatenate([np.zeros((1, 3)), *(part - zero for part in samples)]), axis=0)
    found = [_differences(sums, m << level) for level in range(levels)]
    return np.stack([np.sum(z**2, axis=0) for z in found], axis=1), np.stack([z.sum(axis=0) for z in found], axis=1)


def _differences(sums: Floats, m: int) -> Floats:
    """Return z_m from S (n, 3)."""
    return sums[2 * m :] - 2 * sums[m:-m] + sums[: -2 * m]


def allan_design(factors: Integers) -> Floats:
    """Return the Allan variance that each of COLUMNS makes at theta = 1, (k, 7)."""
    m = factors.astype(np.float64)
    kinds = [3 / m**2, 1 / m, np.full(len(m), FLOOR), m / 3]
    return np.stack([*kinds, m**-0.5, m**0.5, -3 / m**2], axis=1)


def integral_covariances(lag: Floats) -> Floats:
    """Return the generalised covariances of the integral of each of COLUMNS, (7, ...); a filter has none."""
    size = np.abs(lag)
    with np.errstate(divide="ignore", invalid="ignore"):
        flicker = np.where(size > 0, size**2 * np.log(size), 0.0) / (2 * pi)
    between = -(size**1.5) / (4 - 2 * sqrt(2)), size**2.5 / (4 * sqrt(2) - 4)
    return np.stack([(size == 0).astype(np.float64), -size / 2, flicker, size**3 / 12, *between, np.zeros_like(size)])


def estimate_covariance(factors: Integers, samples: int) -> Floats:
    """Return C (7, 7, k, k): the estimates of the Allan variance have covariance sum_pq theta_p theta_q C[p, q].

    Parameters
    ----------
    factors : (k,) averaging times in samples, rising
    samples : length of the recording
    """
    count = len(factors)
    C = np.zeros((len(COLUMNS), len(COLUMNS), count, count))
    for i in range(count):
        for j in range(i, count):
            C[:, :, i, j] = C[:, :, j, i] = _pair(int(factors[i]), int(factors[j]), samples)
    return C


def _pair(short: int, long: int, samples: int) -> Floats:
    """Return the covariance (7, 7) of the estimates at two averaging times."""
    terms = samples + 1 - 2 * short, samples + 1 - 2 * long
    lag = _lags(short, long, terms)
    ends = np.add.outer(lag, np.add.outer(-short * np.arange(3.0), long * np.arange(3.0)))
    r = np.einsum("pnab,a,b->pn", integral_covariances(ends), _SECOND, _SECOND)
    # how many pairs of terms have this lag, and how many lags each one stands for
    pairs = np.minimum(terms[0], terms[1] - lag) - np.maximum(0, -lag)
    stands_for = np.gradient(lag) if len(lag) > 1 else np.ones(1)
    stands_for[[0, -1]] = 0.5 * (stands_for[[0, -1]] + 1) if len(lag) > 1 else 1.0
    weight = pairs * stands_for / (2.0 * short**2 * long**2 * terms[0] * float(terms[1]))
    return (r * weight) @ r.T


def _lags(short: int, long: int, terms: tuple[int, int]) -> Floats:
    """Return lags, dense about those at which an end of one difference meets an end of the other."""
    reach = _FAR * long
    dense = np.arange(0.0, 4 * short + 1, max(1.0, short / _FINE))
    steps = np.unique(np.rint(np.concatenate([[1.0], dense, np.geomspace(4 * short, reach, _TAIL)])))
    steps = np.concatenate([-steps[::-1], steps])
    meet = [short * a - long * b for a in range(3) for b in range(3)]
    lag = np.unique(np.add.outer(meet, steps))
    return lag[(lag > -terms[0]) & (lag < terms[1])]


@value_class
class LineEffect:
    """What a straight line through the samples takes along, for theta = 1 of each kind.

    Attributes
    ----------
    slope_variance : (7,) variance of its slope [per sample]
    taken : (k, 7) by how much the Allan variance of noise is lower when the line is taken away
    """

    slope_variance: Floats
    taken: Floats


def line_effect(factors: Integers, samples: int) -> LineEffect:
    """Return what least squares with a straight line does to noise."""
    edges = np.linspace(0, samples, _NODES + 1)
    middle = (edges[1:] + edges[:-1]) / 2 - samples / 2
    weight = middle / (middle @ middle) * _NODES / samples  # of increments of the integral
    ends = -np.diff(weight, prepend=0.0, append=0.0)
    variance = np.einsum("i,pij,j->p", ends, integral_covariances(np.subtract.outer(edges, edges)), ends)
    taken = np.zeros((len(factors), len(COLUMNS)))
    for row, m in enumerate(factors.astype(np.float64)):
        begins = np.linspace(0, samples - 2 * m, _BEGINS)
        lags = np.subtract.outer(np.add.outer(begins, m * np.arange(3.0)), edges)
        together = np.einsum("pkai,a,i->pk", integral_covariances(lags), _SECOND, ends).mean(axis=1)
        taken[row] = together - 0.5 * m**2 * variance
    return LineEffect(slope_variance=variance, taken=taken)


# ---- the same, compiled ----

_NEAR = 16_384  # numbers that the processor keeps near


def _kernel_short(
    values: Floats, zero: Floats, count: int, stride: int
) -> tuple[Floats, Floats, Floats, Floats, Floats]:
    """Return sums of the first samples (n, 3) about a zero (3,); the first `count` begin a term.

    Returns
    -------
    the sums of the first 0, 2^12, 2 2^12, ... samples (k, 3) and of the first `count` (3,), those of z_m^2 (3, k) for
    1, 2, 4, ... samples averaged, those of the first `count` sums (3,), and those of `stride` samples each (k, 3)
    """
    library = load_kernel()
    assert library is not None
    row = 1 << _SHORT
    marks, end, line = np.empty((count // row + 1, 3)), np.empty(3), np.zeros(3)
    squares, thinned = np.zeros((3, _SHORT)), np.empty((count // stride if stride > 1 else 0, 3))
    step, across = (c_long(stride // values.itemsize) for stride in values.strides)
    library.gnomon_allan_short(
        *(c_long(len(values)), ctypes.c_void_p(values.ctypes.data), step, across, array_in(zero), c_long(count)),
        *(c_long(stride), *map(array_out, (marks, end, squares, line, thinned, np.empty(3 * (3 * row + 8) + 8)))),
    )
    return marks, end, squares, line, thinned


def _kernel_long(samples: Sequence[Floats], marks: Floats, zero: Floats, m: int, levels: int) -> tuple[Floats, Floats]:
    """Return sums of z_m^2 and of z_m (3, levels) for averaging times of m, 2 m, 4 m, ... samples.

    Parameters
    ----------
    samples : in parts (k, 3), all but the last of multiples of m
    marks : sums of what is before every m-th (rows, 3); they are changed
    zero : about which the samples are summed up (3,)
    """
    library = load_kernel()
    assert library is not None
    parts = [np.ascontiguousarray(part) for part in samples]
    starts = [part.ctypes.data + m * part.strides[0] * np.arange(-(-len(part) // m)) for part in parts]
    rows = np.concatenate([*starts, np.zeros(1, np.int64)])  # the last one may be a sum without a sample
    width = min(m, max(_NEAR // len(marks) // 8 * 8, 8))
    squares, totals, work = np.zeros((3, levels)), np.zeros((3, levels)), np.empty(3 * width * (len(marks) + 1) + 8)
    library.gnomon_allan_long(
        *(
            c_long(sum(map(len, parts)) + 1),
            array_in(rows),
            array_out(marks),
            array_in(zero),
            c_long(m),
            c_long(width),
            c_long(levels),
        ),
        *map(array_out, (work, squares, totals)),
    )
    return squares, totals
