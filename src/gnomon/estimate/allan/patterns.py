"""What is no noise in the means of a resting sensor: one step, a wave, a warm-up.

Each of them makes an Allan variance like that of a random walk or of a bias instability. Means over equal blocks of
time are compared with noise of known kinds in any proportion, with and without such a pattern, by their likelihoods.
"""

from functools import cache
from typing import Literal

import numpy as np

from ...frozen import value_class
from ...recording import Floats
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
