"""Which blocks of parameters a recording asks for: the fit to clusters of time that an estimate has not seen.

"Set to 0 what the recording does not determine" (document B, section 5.2) made rigorous. Every smaller model is
estimated from the same cluster sums; for each cluster of time the model is estimated from the others, and its cost on
the one left out is compared with that of the model without the block. A gain that lies within the scatter between the
clusters is none, and the more blocks are tried the larger it must be.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import stdtrit

from ..recording import Floats, Integers
from .clusters import ClusterSums, held_out_costs, whole_estimate

_CHANCE = 0.01
"""Chance that a block which is not there is added by any of the tries."""

_LEAST_GAIN = 2.0  # of the log-likelihood: less is no evidence at all, however well the clusters agree


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Candidate:
    """A block of parameters that a model may have or not.

    Attributes
    ----------
    name : of the step, such as "lever arms"
    columns : (k,) of the sums
    away : (k,) step from the present values to those that a model without the block holds them at
    forced : in the model whatever the recording says (True), never (False), or by evidence (None)
    """

    name: str
    columns: Integers
    away: Floats
    forced: bool | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Step:
    """What one candidate brings to the model of those before it.

    Attributes
    ----------
    candidate : see there
    gain, gain_sigma : held-out log-likelihood, summed over the clusters, and its standard deviation
    needed : what the gain must exceed
    used : whether it is in the model
    change, sigma : (p,) what it moves among all columns of the sums, and the sigmas of the larger model; nan where held
    """

    candidate: Candidate
    gain: float
    gain_sigma: float
    needed: float
    used: bool
    change: Floats
    sigma: Floats


def model_steps(sums: ClusterSums, always: Integers, candidates: Sequence[Candidate]) -> tuple[Step, ...]:
    """Return what each candidate brings, in their order; each joins the model of those used before it.

    Parameters
    ----------
    sums : of clusters longer than the residuals' memory, over all columns
    always : columns that every model estimates
    candidates : in the order in which they are tried
    """
    tries = max(sum(candidate.forced is None for candidate in candidates), 1)
    factor = float(stdtrit(max(len(sums) - 1, 1), 1 - _CHANCE / tries))
    kept: list[Candidate] = []
    without = _Model.of(sums, always, candidates, kept)
    found: list[Step] = []
    for candidate in candidates:
        larger = _Model.of(sums, always, candidates, [*kept, candidate])
        gains = without.costs - larger.costs
        sigma = float(np.sqrt(len(gains)) * np.std(gains, ddof=1))
        needed = max(factor * sigma, _LEAST_GAIN)
        used = bool(gains.sum() > needed) if candidate.forced is None else candidate.forced
        found.append(
            Step(
                candidate=candidate,
                gain=float(gains.sum()),
                gain_sigma=sigma,
                needed=needed,
                used=used,
                change=larger.estimate - without.estimate,
                sigma=larger.sigma,
            )
        )
        if used:
            kept.append(candidate)
            without = larger
    return tuple(found)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
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
        cls, sums: ClusterSums, always: Integers, candidates: Sequence[Candidate], kept: Sequence[Candidate]
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
        estimate[free], sigma[free] = step, np.sqrt(np.diag(covariance))
        return cls(costs=costs + held_out_costs(own), estimate=estimate, sigma=sigma)
