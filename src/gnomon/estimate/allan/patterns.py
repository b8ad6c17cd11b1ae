"""What is no noise in the means of a resting sensor: one step, a wave, a warm-up.

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
from .model import KINDS, integral_covariances

PatternKind = Literal["step", "wave", "warm-up"]

_BLOCKS = 96
_FEWEST = 24
_PROPORTIONS = (0.0, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0)
"""Of bias instability and of random walk, in the variance of differences of neighbouring means, to white noise."""
_WARM_UPS = (0.02, 0.05, 0.1, 0.2, 0.4)  # time constants, of the recording
_SURE: dict[PatternKind, float] = {"step": 30.0, "wave": 34.0, "warm-up": 30.0}
"""Of twice the log likelihood: the best of some two hundred steps gains 12 by chance, and noise has longer tails."""


@value_class(eq=True)
class MeansPattern:
    """A pattern in the means of one axis.

    Attributes
    ----------
    kind : of it
    time_s : when the step is, the period of the wave, or the time constant of the warm-up [s]
    size : of the step, amplitude of the wave, or what the warm-up changes [unit]
    gain : of twice the log likelihood
    """

    kind: PatternKind
    time_s: float
    size: float
    gain: float


@value_class(kw_only=False)
class _Candidates:
    """Patterns as columns (blocks, m), in groups of one or two that are fitted together."""

    columns: Floats
    kind: tuple[PatternKind, ...]
    time: Floats
    pair: bool


def find_pattern(means: Floats, duration_s: float) -> MeansPattern | None:
    """Return the pattern that explains the means (k,) of equal spans of time best, where noise does not.

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
        if gain > _SURE[kind]:
            span = duration_s * count * length / len(means)
            found.append(MeansPattern(kind=kind, time_s=float(group.time[at]) * span, size=size, gain=gain))
    return max(found, key=lambda one: one.gain, default=None)


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
_SURE_OF_FILTER, _OWN = (
    26.0,
    4.0,
)  # of twice the log likelihood: of one axis or of all together; of an axis that others confirm
_PERHAPS = 3.0  # of all together, for bounds that hold behind a filter, too; chance alone may reach it


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
    """Return the filter behind which the means (k, 3) of equal spans of time are, where there is one.

    Parameters
    ----------
    interval_s : length of such a span [s]
    """
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
    together = int(np.argmax(gains.sum(axis=0)))
    best = together
    if gains[:, best].sum() < _SURE_OF_FILTER:
        best = int(np.argmax(gains.max(axis=0)))
    axes = gains[:, best] > (_OWN if best == together else _SURE_OF_FILTER)
    gain = float(gains[axes, best].sum())
    if gain < _SURE_OF_FILTER and gains[:, together].sum() > _PERHAPS:
        all_axes, hz = np.ones(power.shape[1], dtype=bool), float(corners[together % _CORNERS]) / interval_s
        return HighPass(corner_hz=hz, axes=all_axes, gain=float(gains[:, together].sum()), sure=False)
    if gain < _SURE_OF_FILTER:
        return None
    return HighPass(corner_hz=float(corners[best % _CORNERS]) / interval_s, axes=axes, gain=gain)


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
