"""Which blocks of parameters a recording asks for: the fit to clusters of time that an estimate has not seen.

"Set to 0 what the recording does not determine" (Krebs, section 5.2) made rigorous. Every smaller model is
estimated from the same cluster sums; for each cluster of time the model is estimated from the others, and its cost on
the one left out is compared with that of the model without the block. A block that is not there makes gains and losses
alike: were all their signs random, their sum would exceed what is needed by chance alone, and the more blocks are
tried the more is needed.
"""

from collections.abc import Sequence
from dataclasses import field, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from ...frozen import value_class
from ...recording import Floats, Integers
from .clusters import ClusterSums, held_out_costs, whole_estimate

_CHANCE = 0.01
"""Chance that a block which is not there is added by any of the tries."""

_LEAST_GAIN = 2.0  # of the log-likelihood: less is no evidence at all, however well the clusters agree
_DRAWS = 20_000
_MOST_SIGNS = 1_000
"""Clusters that get a sign of their own; more are taken together, so that the memory does not grow."""
_TOGETHER = 1_000  # draws


@value_class
class CandidateBlock:
    """A block of parameters that a model may have or not.

    Attributes
    ----------
    name : of the step, such as "lever arms"
    columns : (k,) of the sums
    away : (k,) step from the present values to those that a model without the block holds them at
    forced : in the model whatever the recording says (True), never (False), or by evidence (None)
    least : gain of the log-likelihood that is needed, however certain it is
    alike : whether its columns are one effect that only makes them larger: clusters that pull them so prove it, also
        where they are too few for their gains to; pulled the other way it brings nothing
    beside : (m,) columns that move along while it is judged: what is held may be wrong, and look like it
    """

    name: str
    columns: Integers
    away: Floats
    forced: bool | None = None
    least: float = 0.0
    alike: bool = False
    beside: Integers = field(default_factory=lambda: np.zeros(0, dtype=np.int64))


@value_class
class CandidateStep:
    """What one candidate brings.

    Attributes
    ----------
    candidate : see there
    gain, gain_sigma : held-out log-likelihood, summed over the clusters, and its standard deviation
    needed : what the gain must exceed
    used : whether it is in the model
    change, sigma : (p,) what it moves among all columns of the sums, and the sigmas of the larger model; nan where held
    """

    candidate: CandidateBlock
    gain: float
    gain_sigma: float
    needed: float
    used: bool
    change: Floats
    sigma: Floats


def model_steps(sums: ClusterSums, always: Integers, candidates: Sequence[CandidateBlock]) -> tuple[CandidateStep, ...]:
    """Return what each candidate brings, in their order.

    Those on which the recording decides join the model one by one, the one with the largest gain first, as long as one
    proves itself; each is shown by what the model has from it or would have from it. The others are shown one after the
    other, beyond those before them and those that were added.

    Parameters
    ----------
    sums : of clusters longer than the residuals' memory, over all columns
    always : columns that every model estimates
    candidates : those that are decided on first, in the order of the ladder
    """
    bench = _Bench(sums, always, candidates)
    decided = [candidate for candidate in candidates if candidate.forced is not None]
    open_ones = [candidate for candidate in candidates if candidate.forced is None]
    stated = [candidate for candidate in decided if candidate.forced]
    added: list[CandidateBlock] = []
    while rest := [candidate for candidate in open_ones if candidate not in added]:
        trials = [bench.step(candidate, [*stated, *added]) for candidate in rest]
        best = max(trials, key=lambda step: step.gain - step.needed)
        if best.gain <= best.needed:
            break
        added.append(best.candidate)
    found: dict[str, CandidateStep] = {}
    for candidate in candidates:
        if candidate.forced is None:
            others = [*stated, *(other for other in added if other is not candidate)]
            found[candidate.name] = replace(bench.step(candidate, others), used=candidate in added)
        else:
            before = decided[: decided.index(candidate)]
            kept = [*(other for other in before if other.forced), *added]
            found[candidate.name] = replace(bench.step(candidate, kept), used=candidate.forced)
    return tuple(found.values())


@lru_cache(4)  # some MB each
def _random_signs(count: int) -> NDArray[np.int8]:
    """Return signs (draws, count), 0 or 1, the same ones always."""
    rng = np.random.default_rng(0)
    return np.concatenate([rng.integers(0, 2, (_TOGETHER, count)).astype(np.int8) for _ in range(_DRAWS // _TOGETHER)])


class _Bench:
    """Models on trial, each estimated once."""

    def __init__(self, sums: ClusterSums, always: Integers, candidates: Sequence[CandidateBlock]) -> None:
        self._sums, self._always, self._candidates = sums, always, candidates
        self._models: dict[frozenset[str], _Model] = {}
        tries = sum(candidate.forced is None for candidate in candidates)
        self._level = 1 - _CHANCE / max(tries, 1)
        self._signs = _random_signs(min(len(sums), _MOST_SIGNS))

    def step(self, candidate: CandidateBlock, kept: Sequence[CandidateBlock]) -> CandidateStep:
        """Return what a candidate brings to a model."""
        if len(candidate.beside):
            name = f"beside {candidate.name}"
            kept = [*kept, CandidateBlock(name=name, columns=candidate.beside, away=np.zeros(len(candidate.beside)))]
        without, larger = self._model(kept), self._model([*kept, candidate])
        gains = without.costs - larger.costs
        gain, needed = float(gains.sum()), self._by_chance(gains)
        if candidate.alike:
            pulls = self._pulls(candidate, kept, without)
            gain = gain if pulls.sum() > 0 else min(gain, 0.0)
            needed = 0.0 if pulls.sum() > self._by_chance(pulls) else needed
        needed = max(needed, _LEAST_GAIN, candidate.least)
        return CandidateStep(
            candidate=candidate,
            gain=gain,
            gain_sigma=float(np.sqrt(len(gains)) * np.std(gains, ddof=1)),
            needed=needed,
            used=gain > needed,
            change=larger.estimate - without.estimate,
            sigma=larger.sigma,
        )

    def _by_chance(self, gains: Floats) -> float:
        """Return what the sum of gains, or of pulls, (c,) exceeds by chance alone, were all their signs random."""
        count = self._signs.shape[1]
        own = np.add.reduceat(gains, np.arange(count) * len(gains) // count) if len(gains) else gains
        sums = [self._signs[k : k + _TOGETHER] @ own for k in range(0, _DRAWS, _TOGETHER)]
        return float(np.quantile(2 * np.concatenate(sums) - own.sum(), self._level))

    def _pulls(self, candidate: CandidateBlock, kept: Sequence[CandidateBlock], without: "_Model") -> Floats:
        """Return how clusters (c,) pull a candidate's columns from a model without it, whose own columns follow."""
        moved, _ = self._sums.moved(without.estimate)
        free = np.concatenate([self._always, *(other.columns for other in kept)]).astype(np.int64)
        own = candidate.columns
        follow = whole_estimate(moved.of_parameters(free))[1] @ moved.total[np.ix_(free, own)].sum(axis=1)
        return np.asarray(moved.pull[:, own].sum(axis=1) - moved.pull[:, free] @ follow, dtype=np.float64)

    def _model(self, kept: Sequence[CandidateBlock]) -> "_Model":
        names = frozenset(candidate.name for candidate in kept)
        if names not in self._models:
            self._models[names] = _Model.of(self._sums, self._always, self._candidates, kept)
        return self._models[names]


@value_class
class _Model:
    """A model by its cluster sums.

    Attributes
    ----------
    costs : (c,) of each cluster by the estimate from the others, relative to the present values of all columns
    estimate : (p,) step from the present values
    sigma : (p,) ordinary standard deviations; nan where held
    """

    costs: Floats
    estimate: Floats
    sigma: Floats

    @classmethod
    def of(
        cls, sums: ClusterSums, always: Integers, candidates: Sequence[CandidateBlock], kept: Sequence[CandidateBlock]
    ) -> "_Model":
        """Return the model of some columns and the candidates kept, the others held without."""
        estimate, sigma = np.zeros(sums.pull.shape[1]), np.full(sums.pull.shape[1], np.nan)
        inside = {candidate.name for candidate in kept}
        for candidate in candidates:
            if candidate.name not in inside:
                estimate[candidate.columns] = candidate.away
        held, costs = sums.moved(estimate)
        free = np.concatenate([always, *(candidate.columns for candidate in kept)]).astype(np.int64)
        own = held.of_parameters(free)
        step, covariance = whole_estimate(own)
        with np.errstate(invalid="ignore"):  # of what runs away
            estimate[free], sigma[free] = step, np.sqrt(np.diag(covariance))
        return cls(costs=costs + held_out_costs(own), estimate=estimate, sigma=sigma)
