"""What is no noise in the means of a resting sensor: steps, a wave, a warm-up.

Each of them makes an Allan variance like that of a random walk or of a bias instability. Means over equal blocks of
time are compared with noise of known kinds in any proportion, with and without such a pattern, by their likelihoods.

Whether a sensor takes its slow errors away: a high-pass filter, an auto-zero, a bias that is drawn back to its mean.

No kind of noise has less power at low frequencies than at higher ones, and what walks has the more the lower they are.
Behind a high-pass filter there is less: the power spectrum of the means over equal spans of time is compared with that
of any sum of the kinds of noise, as they are and behind a filter of some corner frequency. The periodogram's ordinates
scatter about the spectrum as chi-square of two degrees of freedom, so that with P their mean over a band of n

    twice the log likelihood = - 2 sum n (log S + P / S)

(Whittle, 1953). The weights in S, none below zero, are found by multiplicative updates (Fevotte, Bertin, Durrieu 2009).
"""

from functools import cache
from typing import Literal

import numpy as np

from ...frozen import value_class
from ...recording import Floats
from ...results.result import Booleans
from .deviation import KINDS, integral_covariances

PatternKind = Literal["step", "steps", "wave", "warm-up"]

_BLOCKS = 96
_FEWEST = 24
_PROPORTIONS = (0.0, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0)
"""Of bias instability and of random walk, in the variance of differences of neighbouring means, to white noise."""
_WARM_UPS = (0.02, 0.05, 0.1, 0.2, 0.4)  # time constants, of the recording
_SURE: dict[PatternKind, float] = {"step": 30.0, "wave": 34.0, "warm-up": 30.0}
"""Of twice the log likelihood: the best of some two hundred steps gains 12 by chance, and noise has longer tails."""
_PERHAPS_BELOW = 12.0  # in 60 healthy recordings of an hour waves gain 21 at most, others 19


@value_class(eq=True)
class MeansPattern:
    """A pattern in the means of one axis.

    Attributes
    ----------
    kind : of it
    time_s : when the (largest) step is, the period of the wave, or the time constant of the warm-up [s]
    size : of the (largest) step, amplitude of the wave, or what the warm-up changes [unit]
    gain : of twice the log likelihood; of several steps, twice the log of the chance that noise makes the second one
    sure : whether chance does not explain it
    """

    kind: PatternKind
    time_s: float
    size: float
    gain: float
    sure: bool = True


@value_class(kw_only=False)
class _Candidates:
    """Patterns as columns (blocks, m), in groups of one or two that are fitted together."""

    columns: Floats
    kind: tuple[PatternKind, ...]
    time: Floats
    pair: bool


def find_pattern(means: Floats, duration_s: float) -> MeansPattern | None:
    """Return the pattern that explains the means (k,) of equal spans of time best, where noise does not, or hardly.

    A straight line in time is no pattern.
    """
    count = len(means) // max(1, len(means) // _BLOCKS)
    length = len(means) // max(count, 1)
    if count < _FEWEST:
        return None
    count = len(means) // length
    blocks = means[: count * length].reshape(count, length).mean(axis=1)
    difference = np.diff(blocks)
    if not float(np.ptp(difference)) > 0:
        return None
    null, best = np.inf, [(np.inf, 0, 0.0)] * 2
    candidates = _candidates(count)
    for whitener, log_determinant, columns in _whitened(count):
        d = whitener @ difference
        line = whitener @ np.ones(count - 1)
        line /= np.linalg.norm(line)
        d = d - line * (line @ d)
        square, n = float(d @ d), count - 2
        null = min(null, n * np.log(square / n) + log_determinant)
        for k, (group, basis) in enumerate(zip(candidates, columns, strict=True)):
            gains = np.sum((np.einsum("pnm,n->pm", basis, d)) ** 2, axis=0)
            at = int(np.argmax(gains))
            left = n * np.log(max(square - float(gains[at]), 1e-12 * square) / n) + log_determinant
            if left < best[k][0]:
                # the amplitude of a single pattern, or of both of a pair
                raw = np.diff(group.columns[:, at :: len(group.time)] if group.pair else group.columns[:, [at]], axis=0)
                design = np.column_stack([whitener @ raw, line])
                size = np.linalg.lstsq(design, whitener @ difference, rcond=None)[0][:-1]
                best[k] = (left, at, float(np.linalg.norm(size) if group.pair else size[0]))
    found: list[MeansPattern] = []
    for (left, at, size), group in zip(best, candidates, strict=True):
        kind, gain = group.kind[at], null - left
        if gain > _SURE[kind] - _PERHAPS_BELOW:
            span, sure = duration_s * count * length / len(means), gain > _SURE[kind]
            found.append(MeansPattern(kind=kind, time_s=float(group.time[at]) * span, size=size, gain=gain, sure=sure))
    return max(found, key=lambda one: (one.sure, one.gain), default=None)


@cache
def _candidates(count: int) -> tuple[_Candidates, _Candidates]:
    """Return single patterns and waves, of recordings of so many blocks."""
    edge = np.arange(2, 2 * count - 1) / 2  # between blocks and in their middle
    steps = np.clip(np.arange(count)[:, None] + 1 - edge, 0.0, 1.0)
    t = (np.arange(count)[:, None] + 0.5) / count
    decays = np.exp(-t / np.array(_WARM_UPS))
    singles = _Candidates(
        np.concatenate([steps, decays], axis=1),
        ("step",) * len(edge) + ("warm-up",) * len(_WARM_UPS),
        np.concatenate([edge / count, _WARM_UPS]),
        False,
    )
    cycles = np.arange(2, count // 4 * 2 + 1) / 2
    phase = 2 * np.pi * cycles * t
    waves = _Candidates(
        np.concatenate([np.cos(phase), np.sin(phase)], axis=1), ("wave",) * len(cycles), 1 / cycles, True
    )
    return singles, waves


@cache
def _whitened(count: int) -> tuple[tuple[Floats, float, tuple[Floats, Floats]], ...]:
    """Return, for every proportion of the kinds of noise, what whitens differences of means, and whitened patterns.

    Whitener (count - 1, count - 1), log determinant of the covariance, and orthonormal patterns (1 or 2, count - 1, m)
    without the straight line.
    """
    ends = np.arange(count + 1.0)
    second = np.diff(np.eye(count + 1), n=2, axis=0)
    covariances = integral_covariances(np.subtract.outer(ends, ends))
    by_kind = [
        second @ covariances[KINDS.index(kind)] @ second.T
        for kind in ("white_noise", "bias_instability", "random_walk")
    ]
    white, flicker, walk = (one / one[0, 0] for one in by_kind)
    found: list[tuple[Floats, float, tuple[Floats, Floats]]] = []
    for b in _PROPORTIONS:
        for k in _PROPORTIONS:
            root = np.linalg.cholesky(white + b * flicker + k * walk)
            whitener = np.linalg.inv(root)
            line = whitener @ np.ones(count - 1)
            line /= np.linalg.norm(line)
            groups: list[Floats] = []
            for group in _candidates(count):
                columns = whitener @ np.diff(group.columns, axis=0)
                columns -= np.outer(line, line @ columns)
                columns /= np.maximum(np.linalg.norm(columns, axis=0), 1e-12)
                if group.pair:
                    first, other = np.split(columns, 2, axis=1)
                    other = other - first * np.sum(first * other, axis=0)
                    other /= np.maximum(np.linalg.norm(other, axis=0), 1e-12)
                    groups.append(np.stack([first, other]))
                else:
                    groups.append(columns[None])
            found.append((whitener, 2 * float(np.log(np.diag(root)).sum()), (groups[0], groups[1])))
    return tuple(found)


_FEWEST_SPANS = 40  # on either side of a step, in the recording
_SURE_OF_STEPS, _PERHAPS_STEPS = 12.5, 7.0  # in 120 healthy recordings the second step has 8.7 at most
_LONE = 6.0  # usual differences of neighbouring means, by which a touch differs from both


def find_steps(means: Floats, duration_s: float) -> tuple[MeansPattern | None, ...]:
    """Return, of each axis, the largest of several steps in the means (k, 3) of equal spans of time, or None.

    A sensor that is zeroed now and then, or has popcorn noise, steps by more than Gaussian noise does, whatever its
    spectrum: that makes the differences of neighbouring means Gaussian and stationary, and their median tells how they
    scatter. The second largest counts, as one step alone is a pattern of its own; all axes may step together.
    """
    from scipy.special import fdtrc  # a part of what loading chi2 costs  # pyright: ignore[reportMissingTypeStubs]

    count = len(means)
    if count < 2 * _FEWEST_SPANS:
        return None, None, None
    values = means - np.median(means, axis=0)
    around = np.stack([values[:-2], values[1:-1], values[2:]])
    lone = np.abs(values[1:-1] - np.median(around, axis=0)) > _LONE * np.median(np.abs(np.diff(values, axis=0)), axis=0)
    values[1:-1] = np.where(lone, np.median(around, axis=0), values[1:-1])
    sums = np.cumsum(np.pad(values, ((1, 0), (0, 0))), axis=0)
    best: list[tuple[float, float, Floats]] = [(0.0, 0.0, np.zeros(3))] * 4
    for span in 2 ** np.arange((count // _FEWEST_SPANS).bit_length()):
        steps = (sums[2 * span :] - 2 * sums[span:-span] + sums[: -2 * span]) / span
        steps -= np.median(steps, axis=0)
        usual = np.median(np.abs(steps), axis=0) / 0.6745
        squares = (steps / np.where(usual > 0, usual, np.inf)) ** 2
        looks, freedom = 3 * count / span, 0.3 * count / span
        for axis, ratio in enumerate((*squares.T, squares.mean(axis=1))):
            at = int(np.argmax(ratio))
            second = np.delete(ratio, slice(max(at - 2 * span + 1, 0), at + 2 * span)).max(initial=0.0)
            chance = looks * fdtrc(1 if axis < 3 else 3, freedom, second)
            best[axis] = max(
                best[axis], (-2 * np.log(max(chance, 1e-300)), (at + span) / count, steps[at]), key=lambda one: one[0]
            )
    alone = [gain > _SURE_OF_STEPS for gain, *_ in best[:3]]
    found: list[MeansPattern | None] = []
    for axis in range(3):
        gain, share, sizes = max(best[axis], best[3], key=lambda one: one[0])
        sure = alone[axis] or (gain > _SURE_OF_STEPS and not any(alone))
        one = MeansPattern(kind="steps", time_s=share * duration_s, size=float(sizes[axis]), gain=gain, sure=sure)
        found.append(one if gain > _PERHAPS_STEPS else None)
    return tuple(found)


_SLOPES = (0.0, -0.5, -1.0, -1.5, -2.0)  # of the power spectra, as in `model.COLUMNS` without quantisation
_ORDERS = (1, 2)  # of the filter
_CORNERS = 24
_LOWEST_CORNER = 4.0  # periods in the recording
_HIGHEST = 0.25  # frequency for the interval of the means
_FIRST = 2  # ordinate: the straight line takes from the lowest one
_WIDTH = 1.06  # of a band, where it holds more than one ordinate
_FEWEST_TIMES = 40  # bands
_UPDATES = 80
_LINES, _LINE_CHANCE = 3, 1e-3  # bands with a spectral line, that are left out
_UNFILTERED = 0.2  # of the filter's time constant
# Of twice the log likelihood. In 250 healthy recordings all axes together gain 10 at most by chance, a single one 13.
_SURE_OF_FILTER, _OWN = 20.0, 4.0  # of one axis or of all together; of an axis that others confirm
# The same of all together and of one axis, in the recording or a half of it, for what is told to hold behind it, too.
_PERHAPS, _PERHAPS_HALF = (3.0, 5.0), (8.0, 9.0)


@value_class
class HighPass:
    """A filter that takes slow errors away.

    Attributes
    ----------
    corner_hz : frequency below which it does
    axes : (3,) bool, behind it
    gain : of twice the log likelihood, of these axes
    sure : whether chance does not explain it
    """

    corner_hz: float
    axes: Booleans
    gain: float
    sure: bool = True


def find_high_pass(means: Floats, interval_s: float) -> HighPass | None:
    """Return the filter behind which the means (k, 3) of equal spans of time are, where there is one, or half of them.

    Parameters
    ----------
    interval_s : length of such a span [s]
    """
    found = _high_pass(means, interval_s, _PERHAPS)
    if found is not None and found.sure:
        return found
    halves = [_high_pass(half, interval_s, _PERHAPS_HALF) for half in np.array_split(means, 2)]
    return max((one for one in (found, *halves) if one is not None), key=lambda one: (one.sure, one.gain), default=None)


def _high_pass(means: Floats, interval_s: float, perhaps: tuple[float, float]) -> HighPass | None:
    count = len(means)
    if count < 8:
        return None
    f, power, ordinates = _bands(means)
    if len(f) < _FEWEST_TIMES:
        return None
    corners = np.geomspace(_LOWEST_CORNER / count, f[-1] / 2, _CORNERS)
    filters = [1 / (1 + (corner / f) ** (2 * order)) for order in _ORDERS for corner in corners]
    kinds = f[:, None] ** np.array(_SLOPES)
    spectra = np.stack([kinds, *(one[:, None] * kinds for one in filters)])
    gains = np.stack([_gains(spectra, power[:, axis], ordinates) for axis in range(power.shape[1])])
    together, alone = int(np.argmax(gains.sum(axis=0))), int(np.argmax(gains.max(axis=0)))
    for sure, least, own in ((True, _SURE_OF_FILTER, _OWN), (False, *perhaps)):
        for best, gain, each in (
            (together, gains[:, together].sum(), own if sure else -np.inf),
            (alone, gains[:, alone].max(), max(least, own)),
        ):
            if gain > (least if best == together else each):
                corner_hz = float(corners[best % _CORNERS]) / interval_s
                return HighPass(corner_hz=corner_hz, axes=gains[:, best] > each, gain=float(gain), sure=sure)
    return None


def _bands(means: Floats) -> tuple[Floats, Floats, Floats]:
    """Return frequencies (m,) [1/interval], mean power of each band (m, 3), and its number of ordinates (m,)."""
    count = len(means)
    t = np.arange(count) - (count - 1) / 2
    centred = means - means.mean(axis=0)
    centred = centred - np.outer(t, t @ centred / (t @ t))
    last = int(_HIGHEST * count)
    power = np.abs(np.fft.rfft(centred, axis=0)[_FIRST : last + 1]) ** 2
    power = power / np.maximum(np.median(power, axis=0), 1e-300)
    edges = (
        np.unique(np.rint(_FIRST * _WIDTH ** np.arange(np.log(last / _FIRST) / np.log(_WIDTH))).astype(int)) - _FIRST
    )
    ordinates = np.diff(edges, append=len(power)).astype(np.float64)
    f = np.add.reduceat(np.arange(_FIRST, last + 1) / count, edges) / ordinates
    return f, np.add.reduceat(power, edges) / ordinates[:, None], ordinates


def _gains(spectra: Floats, power: Floats, ordinates: Floats) -> Floats:
    """Return by how much twice the log likelihood is larger with each filter than without one, (filters,).

    Parameters
    ----------
    spectra : (1 + filters, m, kinds) of each kind of noise, first without a filter
    power, ordinates : (m,)
    """
    from scipy.special import gammaincc  # loaded for long recordings only  # pyright: ignore[reportMissingTypeStubs]

    plain = _fitted(spectra[:1], power, ordinates)[0]
    chance = gammaincc(ordinates, ordinates * power / plain)
    worst = np.argsort(chance)[:_LINES]
    used = ordinates.copy()
    used[worst[chance[worst] < _LINE_CHANCE / len(power)]] = 0.0
    fitted = _fitted(spectra, power, used)
    unlikely = 2 * np.sum(used * (np.log(fitted) + power / fitted), axis=1)
    return unlikely[0] - unlikely[1:]


def _fitted(spectra: Floats, power: Floats, ordinates: Floats) -> Floats:
    """Return the most likely sum of spectra (..., m, kinds) for each set, (..., m)."""
    size = np.maximum(np.average(spectra, axis=1, weights=np.maximum(ordinates, 1e-9)), 1e-300)
    scaled = spectra / size[:, None]
    weights = np.full((len(spectra), spectra.shape[2]), 0.2)
    for _ in range(_UPDATES):
        fitted = (scaled @ weights[..., None])[..., 0]
        down = ordinates / fitted
        up = down * power / fitted
        weights = weights * (up[:, None] @ scaled)[:, 0] / np.maximum((down[:, None] @ scaled)[:, 0], 1e-300)
        weights = np.maximum(weights, 1e-12)
    return (scaled @ weights[..., None])[..., 0]


def longest_unfiltered_s(found: HighPass | None, axis: int) -> float:
    """Return up to which averaging time the Allan variance of an axis is as without the filter [s].

    White noise behind a filter of time constant T lacks a third of (tau / T)^2 there.
    """
    return np.inf if found is None or not found.axes[axis] else _UNFILTERED / (2 * np.pi * found.corner_hz)
