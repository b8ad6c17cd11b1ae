"""The part of a video in which the phase rises evenly, and its rate with a sigma that irregular speed enters."""

from dataclasses import replace
from itertools import pairwise
from typing import Self

import numpy as np

from ...frozen import value_class
from ...recording import Floats, Integers
from ...results.result import Booleans

_OUTLYING = 4.0
_FINEST = 2e-3  # rad: no block is known better
_LONGEST_GAP = 0.35  # of the part
_FEWEST_BLOCKS, _MOST_BLOCKS = 8, 128
_PASSES = 8
_MOST_RATES = 2000
_LEAST_WALK, _MOST_WALK, _WALKS = 3.0, 1e3, 12
"""Variance that a random walk gains from block to block, in units of that of a block's own error. The least, which is
to be divided by the square of the number of blocks, no longer matters."""
_SURELY = 3.0


@value_class
class PhaseLine:
    """A straight line through phases.

    Attributes
    ----------
    rate : [rad/s]
    phase : at the time 0 [rad]
    """

    rate: float
    phase: float

    def off(self, t_s: Floats, phase: Floats) -> Floats:
        """Return by how much phases differ from the line, between -pi and pi [rad]."""
        return (phase - self.phase - self.rate * t_s + np.pi) % (2 * np.pi) - np.pi


@value_class
class DeviationMeans:
    """Means over some pictures each, of their time and of their distance from a line.

    Attributes
    ----------
    t_s : (m,) [s]
    off : (m,) [rad]
    variance : (m,) of `off`, as far as the pictures of a block are independent [rad^2]
    number : (m,) which block of even length it is, ascending
    length_s, start_s : of a block, and where the first begins [s]
    """

    t_s: Floats
    off: Floats
    variance: Floats
    number: Integers
    length_s: float
    start_s: float

    @property
    def span(self) -> tuple[float, float]:
        """From when to when the blocks last [s]."""
        first, last = int(self.number[0]), int(self.number[-1])
        return self.start_s + self.length_s * first, self.start_s + self.length_s * (last + 1)

    def chosen(self, kept: Integers) -> Self:
        """Return some of the blocks."""
        parts = {name: getattr(self, name)[kept] for name in ("t_s", "off", "variance", "number")}
        return replace(self, **parts)


@value_class
class EvenRate:
    """The rate at which a phase rises over the steady part.

    Attributes
    ----------
    line : best one
    sigma : of the rate, irregular speed included [rad/s]
    drift : by how much the rate rises from the part's beginning to its end [rad/s]
    drift_sigma : of that
    walk : share of the variance of a block's phase that is due to irregular speed
    """

    line: PhaseLine
    sigma: float
    drift: float
    drift_sigma: float
    walk: float


def coherent_line(t_s: Floats, phase: Floats, rate: float, half_width: float) -> PhaseLine:
    """Return the line that most phases are near, among rates about `rate` [rad/s]."""
    step = 0.5 / max(float(t_s[-1] - t_s[0]), 1e-9)
    count = min(int(half_width / step) + 2, _MOST_RATES)
    vector = np.exp(1j * (phase - rate * t_s))
    offsets = step * np.arange(-count, count + 1)
    total = np.array([np.sum(vector * np.exp(-1j * offset * t_s)) for offset in offsets])
    top = int(np.clip(np.argmax(np.abs(total)), 1, len(total) - 2))
    left, middle, right = np.abs(total[top - 1 : top + 2]).tolist()
    bend = left - 2 * middle + right
    offset = float(offsets[top]) + (step * np.clip(0.5 * (left - right) / bend, -1, 1) if bend < 0 else 0.0)
    start = np.angle(np.sum(vector * np.exp(-1j * offset * t_s)))
    return PhaseLine(rate=rate + offset, phase=float(start))


def blocks_of(
    t_s: Floats, off: Floats, sigma: Floats, good: Booleans, *, length_s: float, start_s: float
) -> DeviationMeans:
    """Average the good pictures over blocks of even length; blocks of which most are not good are left out.

    Parameters
    ----------
    t_s, off, sigma : (n,) of all pictures [s, rad, rad]
    good : (n,) which of them count
    length_s, start_s : of a block, and where the first begins [s]
    """
    number = np.floor((t_s - start_s) / length_s).astype(np.int64)
    count = np.bincount(number, weights=good)
    kept = np.flatnonzero((count > 0.5 * np.bincount(number)) & (count >= 2))
    weight = good / (sigma**2 + np.median(sigma) ** 2)
    total = np.maximum(np.bincount(number, weights=weight), 1e-300)
    mean = np.bincount(number, weights=weight * off) / total
    square = np.bincount(number, weights=weight * (off - mean[number]) ** 2) / total
    usual = float(np.median(square[kept])) if len(kept) else 0.0
    return DeviationMeans(
        t_s=(np.bincount(number, weights=weight * t_s) / total)[kept],
        off=mean[kept],
        variance=0.5 * (square[kept] + usual) / count[kept] + 1e-12,
        number=kept,
        length_s=length_s,
        start_s=start_s,
    )


def steady_blocks(blocks: DeviationMeans) -> Integers:
    """Return the longest run of blocks that is on a line of its own, as indices."""
    chosen = np.arange(len(blocks.off))
    for _ in range(_PASSES):
        if len(chosen) < 3:
            break
        t, off = blocks.t_s[chosen], blocks.off[chosen]
        slope, start = _robust_line(t, off)
        spread = 1.4826 * float(np.median(np.abs(off - start - slope * t)))
        near = np.abs(blocks.off - start - slope * blocks.t_s) < _OUTLYING * np.hypot(spread, _FINEST)
        run = longest_run(blocks.number[near])
        again = np.flatnonzero(near & np.isin(blocks.number, run))
        if np.array_equal(again, chosen):
            break
        chosen = again
    return chosen


def longest_run(numbers: Integers) -> Integers:
    """Return the longest run of ascending numbers, without gaps that are long against what is on both their sides."""
    runs = np.split(numbers, np.flatnonzero(np.diff(numbers) > 1) + 1)
    while len(runs) > 1:
        gaps = [int(after[0] - before[-1]) - 1 for before, after in pairwise(runs)]
        least = int(np.argmin(gaps))
        if gaps[least] > max(1, _LONGEST_GAP * (len(runs[least]) + len(runs[least + 1]))):
            break
        runs[least : least + 2] = [np.concatenate(runs[least : least + 2])]
    return max(runs, key=len)


def _robust_line(t: Floats, off: Floats) -> tuple[float, float]:
    """Return slope and start of a line, by iterated weights."""
    weight = np.ones(len(t))
    slope, start = 0.0, float(np.median(off))
    for _ in range(20):
        total = weight.sum()
        mean_t, mean_off = float(weight @ t / total), float(weight @ off / total)
        spread = float(weight @ (t - mean_t) ** 2)
        slope = float(weight @ ((t - mean_t) * (off - mean_off))) / spread if spread > 0 else 0.0
        start = mean_off - slope * mean_t
        residual = np.abs(off - start - slope * t)
        weight = 1 / np.maximum(residual, max(1.4826 * float(np.median(residual)), 1e-6))
    return slope, start


def even_rate(line: PhaseLine, blocks: DeviationMeans) -> EvenRate:
    """Fit the rate to the blocks of the steady part by generalised least squares.

    A block's error has a part of its own and one of a random walk, as irregular speed makes it; their ratio is not
    known, and the result is the mean over all ratios by their restricted likelihood, with the spread that they leave.

    Raises
    ------
    ValueError
        If there are fewer than four blocks.
    """
    if len(blocks.off) < 4:
        raise ValueError(f"{len(blocks.off)} blocks do not tell a rate with its error")
    middle = 0.5 * float(blocks.t_s[0] + blocks.t_s[-1])
    span = float(blocks.t_s[-1] - blocks.t_s[0])
    base = np.column_stack([np.ones(len(blocks.off)), blocks.t_s - middle])
    rate, variance, walk = _mixture(blocks, base, 1)
    bent = np.column_stack([base, (blocks.t_s - middle) ** 2 / (2 * span)])
    drift, drift_variance, _ = _mixture(blocks, bent, 2)
    if abs(drift) > _SURELY * np.sqrt(drift_variance):
        variance += drift**2 / 12  # the rate of any one moment
    start = float(np.average(blocks.off, weights=1 / blocks.variance)) - rate * float(
        np.average(blocks.t_s, weights=1 / blocks.variance)
    )
    return EvenRate(
        line=PhaseLine(rate=line.rate + rate, phase=line.phase + start),
        sigma=float(np.sqrt(variance)),
        drift=drift,
        drift_sigma=float(np.sqrt(drift_variance)),
        walk=walk,
    )


def _mixture(blocks: DeviationMeans, design: Floats, wanted: int) -> tuple[float, float, float]:
    """Return a coefficient, its variance, and the share of the walk, averaged over the ratio of walk to own error."""
    count, unknown = design.shape
    own = float(np.median(blocks.variance))
    elapsed = (blocks.t_s - blocks.t_s[0]) / max(float(np.median(np.diff(blocks.t_s))), 1e-9)
    together = np.minimum.outer(elapsed, elapsed)
    ratios = np.geomspace(_LEAST_WALK / count**2, _MOST_WALK, _WALKS)
    values = np.empty((_WALKS, 3))
    for k, ratio in enumerate(ratios):
        covariance = np.diag(blocks.variance / own) + ratio * together
        root = np.linalg.cholesky(covariance)
        a, y = np.linalg.solve(root, design), np.linalg.solve(root, blocks.off)
        normal = a.T @ a
        found = np.linalg.solve(normal, a.T @ y)
        square = max(float(np.sum((y - a @ found) ** 2)), 1e-300)
        free = count - unknown
        likelihood = -0.5 * free * np.log(square) - np.log(np.diag(root)).sum() - 0.5 * np.linalg.slogdet(normal)[1]
        wide = square / max(free - 2, 1)  # of Student's distribution
        values[k] = found[wanted], wide * np.linalg.inv(normal)[wanted, wanted], likelihood
    weight = np.exp(values[:, 2] - values[:, 2].max())
    weight /= weight.sum()
    mean = float(weight @ values[:, 0])
    variance = float(weight @ (values[:, 1] + (values[:, 0] - mean) ** 2))
    return mean, variance, float(weight @ (ratios / (1 + ratios)))


def block_length(turns: float, period_s: float) -> float:
    """Return a length of blocks that is some whole periods, or a part of one where there are few [s]."""
    if turns < _FEWEST_BLOCKS:
        return period_s * turns / _FEWEST_BLOCKS
    return period_s * np.ceil(turns / _MOST_BLOCKS)
