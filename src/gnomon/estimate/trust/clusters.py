"""Sums over clusters of time, the covariance that survives correlated residuals, and which blocks a recording asks for.

An estimate theta minimises J = sum over clusters of J_c, plus the prior's J_p. With everything else (a trajectory, the
directions of gravity) eliminated, each cluster has a pull s_c = -dJ_c/dtheta and an information S_c; the pulls and the
prior's sum up to zero. Left out, a cluster moves the estimate by

    d_c = -(S - S_c)^-1 s_c,    S = sum S_c + P,

and with n clusters longer than the residuals' memory the covariance is (n - 1) / n sum d_c d_c', however the residuals
within a cluster are correlated (the jackknife, CR3). A part of a recording has the estimate that its own clusters pull
to, and a smaller model that of its own parameters: halves, thirds and submodels cost no further solution.

With as few clusters as a recording of forty static intervals has, these variances scatter, and they are too large where
a cluster determines much of its own residual. Both are known for independent errors from the information alone: the
expectation E of each variance V, and how many degrees of freedom V has. So V / E is how much more than independent
errors the recording shows, and it is shrunk by what others show: to that of its block of parameters, and that one to 1.

"Set to 0 what the recording does not determine" (Krebs, section 5.2) made rigorous: every smaller model is estimated
from the same sums; for each cluster it is estimated from the others, and its cost on the one left out is compared with
that of the model without a block. A block that is not there makes gains and losses alike: were all their signs random,
their sum would exceed what is needed by chance alone, and the more blocks are tried the more is needed.
"""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import field, replace
from functools import lru_cache
from random import Random

import numpy as np
from numpy.typing import NDArray

from ...frozen import value_class
from ...recording import Floats, Integers
from ...recording.samples import distinct_values, quantile_of

_NEARLY = 1e-12  # of the information, where there is none at all
_MANY = 100  # parameters, from which on a factor of Cholesky saves more than calls cost

_BLOCK_COUNTS = 12.0  # degrees of freedom that the other parameters of a block count as
_ONE_COUNTS = 4.0  # and that independence counts as
_LEAST = 1.0  # factor of a variance: clusters never make sigmas smaller
_CORRELATIONS_COUNT = 3.0  # clusters for each scalar from which the jackknife's correlations count half
_FEWEST = 12  # clusters that are not made fewer
_MOST_MEMORY = 4  # stretches
_CORRELATED = 0.1, 1.5  # correlation that counts as some, and in units of its own sigma

_CHANCE = 0.01
"""Chance that a block which is not there is added by any of the tries."""

_LEAST_GAIN = 2.0  # of the log-likelihood: less is no evidence at all, however well the clusters agree
_DRAWS = 20_000
_MOST_SIGNS = 1_000
"""Clusters that get a sign of their own; more are taken together, so that the memory does not grow."""
_TOGETHER = 1_000  # draws


@value_class
class ClusterSums:
    """Pulls and information of stretches of time at an estimate, the rest eliminated.

    Attributes
    ----------
    t_s : (c,) middle of each stretch [s], ascending
    pull : (c, p) minus the gradient of the stretch's cost
    information : (c, p, p)
    prior_pull : (p,), prior_information : (p, p) of what was known beforehand
    """

    t_s: Floats
    pull: Floats
    information: Floats
    prior_pull: Floats
    prior_information: Floats

    def __len__(self) -> int:
        return len(self.t_s)

    @property
    def total(self) -> Floats:
        """Information of all stretches and the prior, (p, p)."""
        return self.information.sum(axis=0) + self.prior_information

    def gathered(self, cluster: Integers) -> "ClusterSums":
        """Return the sums of clusters of stretches, by the number (c,) of the cluster of each; empty ones vanish."""
        numbers, which = np.unique(cluster, return_inverse=True)
        if len(numbers) == len(self) and (np.diff(cluster) > 0).all():
            return self
        count, size = len(numbers), len(self.prior_pull)
        pull, information = np.zeros((count, size)), np.zeros((count, size, size))
        for number, own, told in zip(which.tolist(), self.pull, self.information, strict=True):
            pull[number] += own  # one by one: of many parameters a copy in another order would be large
            information[number] += told
        t_s = np.bincount(which, self.t_s) / np.bincount(which)
        return replace(self, t_s=t_s, pull=pull, information=information)

    def moved(self, step: Floats) -> tuple["ClusterSums", Floats]:
        """Return the sums at other values, a step (p,) away, and by how much the cost of each stretch grows, (c,)."""
        towards = self.information @ step
        moved = replace(
            self,
            pull=self.pull - towards,
            prior_pull=self.prior_pull - self.prior_information @ step,
        )
        return moved, (towards / 2 - self.pull) @ step

    def of_parameters(self, index: Integers) -> "ClusterSums":
        """Return the sums with only some parameters, the others held."""
        return ClusterSums(
            t_s=self.t_s,
            pull=self.pull[:, index],
            information=self.information[:, index[:, None], index],
            prior_pull=self.prior_pull[index],
            prior_information=self.prior_information[np.ix_(index, index)],
        )


def leave_clusters_out(sums: ClusterSums) -> Floats:
    """Return how the estimate moves when each cluster is left out, (c, p)."""
    rest = sums.total - sums.information
    return _solved(rest, -sums.pull)


def whole_estimate(sums: ClusterSums) -> tuple[Floats, Floats]:
    """Return the step (p,) to the minimum of all stretches and the prior, and the inverse information (p, p)."""
    return _solved(sums.total, sums.pull.sum(axis=0) + sums.prior_pull), _inverse(sums.total)


def part_estimates(sums: ClusterSums, part: Integers) -> tuple[Floats, Floats]:
    """Return how far each part's own estimate lies from that of the whole, (k, p), and its inverse information.

    Parameters
    ----------
    sums : of clusters
    part : (c,) number of the part that a cluster belongs to; negative for none
    """
    belongs = (part == distinct_values(part[part >= 0])[:, None]).astype(np.float64)
    information = np.tensordot(belongs, sums.information, 1) + sums.prior_information
    return _solved(information, belongs @ sums.pull + sums.prior_pull), _inverse(information)


def held_out_costs(sums: ClusterSums) -> Floats:
    """Return how much the cost of each cluster changes from `theta` to the estimate without it, (c,).

    The estimate without cluster c is that of the other clusters and the prior; the model is that of the parameters of
    `sums`, and zero change is their present value. Smaller models are compared by `ClusterSums.of_parameters`.
    """
    rest_pull = sums.pull.sum(axis=0) + sums.prior_pull - sums.pull
    steps = _solved(sums.total - sums.information, rest_pull)
    along = (sums.information @ steps[:, :, None])[:, :, 0]
    return np.einsum("cp,cp->c", along / 2 - sums.pull, steps)


def _solved(matrix: Floats, right: Floats) -> Floats:
    """Solve symmetric equations (..., p, p) x = (..., p) whose units differ by many powers of ten."""
    scaled, size = _scaled(matrix)
    return size * _solved_if_scaled(scaled, (size * right)[..., None])[..., 0]


def _solved_if_scaled(matrix: Floats, right: Floats) -> Floats:
    """Solve equations of unit diagonal; what nothing tells may be anywhere."""
    if matrix.shape[-1] >= _MANY:
        from ...solve.factorisation import solve_positive

        with suppress(np.linalg.LinAlgError):  # not positive definite, but for rounding
            sides = np.broadcast_to(right, (*matrix.shape[:-1], right.shape[-1])).reshape(-1, *right.shape[-2:])
            found = [solve_positive(*one) for one in zip(matrix.reshape(-1, *matrix.shape[-2:]), sides, strict=True)]
            return np.array(found).reshape(*matrix.shape[:-1], -1)
    try:
        solution = np.linalg.solve(matrix, right)
    except np.linalg.LinAlgError:
        solution = np.linalg.solve(matrix + _NEARLY * np.eye(matrix.shape[-1]), right)
    return np.asarray(solution, dtype=np.float64)


def _inverse(matrix: Floats) -> Floats:
    scaled, size = _scaled(matrix)
    return _solved_if_scaled(scaled, np.eye(size.shape[-1])) * _outer(size)


def _scaled(matrix: Floats) -> tuple[Floats, Floats]:
    """Return matrices (..., p, p) of unit diagonal, and by what (..., p) rows and columns were multiplied."""
    diagonal = np.einsum("...ii->...i", matrix)
    size = 1 / np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
    return matrix * _outer(size), size


def _outer(size: Floats) -> Floats:
    return size[..., :, None] * size[..., None, :]


@value_class
class Robust:
    """How the variances of m scalars compare with those for independent errors.

    Attributes
    ----------
    factor : (m,) of the part of each variance that comes from the recording's errors
    from_errors : (m, m) covariance by these errors where they are independent
    from_prior : (m, m) covariance by the errors of what was known beforehand
    correlation : (m, m) of the jackknife
    clusters : their number
    """

    factor: Floats
    from_errors: Floats
    from_prior: Floats
    correlation: Floats
    clusters: int

    @property
    def covariance(self) -> Floats:
        """Covariance (m, m); what was known beforehand counts as it was stated.

        Few clusters tell correlations of many parameters badly: the fewer, the more those of independent errors count.
        """
        share = self.clusters / (self.clusters + _CORRELATIONS_COUNT * len(self.factor))
        own, root = np.sqrt(np.maximum(np.diag(self.from_errors), 0.0)), np.sqrt(self.factor)  # zero but for rounding
        blended = (1 - share) * self.from_errors + share * self.correlation * np.outer(own, own)
        return blended * np.outer(root, root) + self.from_prior


def robust_variances(phases: Sequence[ClusterSums], jacobian: Floats, block: Integers, *, many: bool = False) -> Robust:
    """Return by how much the variances of scalars are larger than for independent errors.

    Parameters
    ----------
    phases : sums of clusters; the same stretches of time cut with other borders
    jacobian : (m, p) of the scalars by the parameters of the sums
    block : (m,) number of the block of parameters that a scalar belongs to
    many : whether clusters are of so many residuals that their scatter is not drawn to that of independent errors
    """
    found = [_jackknife(sums, jacobian) for sums in phases]
    shown, expected, freedom = (np.mean([one[k] for one in found], axis=0) for k in range(3))
    variance = np.diag(shown)
    told = expected > 0
    total, prior = phases[0].total, phases[0].prior_information
    gain = jacobian @ _inverse(total)
    from_errors = gain @ (total - prior) @ gain.T
    size = np.sqrt(np.where(variance > 0, variance, 1.0))
    correlation = shown / np.outer(size, size)
    np.fill_diagonal(correlation, 1.0)
    if many:
        factor = _beyond_independent(variance - expected, np.diag(from_errors), block)
    else:
        factor = _shrunk(np.where(told, variance / np.where(told, expected, 1.0), 1.0), told * freedom, block)
    return Robust(
        factor=factor,
        from_errors=from_errors,
        from_prior=gain @ prior @ gain.T,
        correlation=correlation,
        clusters=round(float(np.mean([len(sums) for sums in phases]))),
    )


def _jackknife(sums: ClusterSums, jacobian: Floats) -> tuple[Floats, Floats, Floats]:
    """Return the jackknife's covariance (m, m) without the prior's share, and what it is for independent errors.

    The latter are the expectation of its variances and their degrees of freedom, (m,) each.
    """
    total = sums.total
    size = 1 / np.sqrt(np.where(np.diag(total) > 0, np.diag(total), 1.0))
    information = sums.information * np.outer(size, size)
    total = total * np.outer(size, size)
    arms = _solved_if_scaled(total - information, (jacobian * size).T).swapaxes(1, 2)
    arms = np.ascontiguousarray(arms)  # (c, m, p): what a pull of each cluster moves
    moves = np.einsum("cmp,cp->cm", arms, sums.pull * size)
    seen = arms @ information
    # At the estimate a cluster pulls as its errors do, less its share of what all errors pull together.
    own = np.einsum("cmp,cmp->mc", seen, arms)
    # The covariance of the pulls is diag(own) - shared T shared'.
    shared, inverse = np.swapaxes(seen, 0, 1), _solved_if_scaled(total, np.eye(len(total)))  # (m, c, p)
    weighed = shared @ inverse
    less = np.einsum("mcp,mcp->mc", weighed, shared)
    # Of the shape that is smaller, (m, c, c) or (m, p, p): the trace of the square is the same.
    few = len(sums) < len(total)
    inner = weighed @ np.swapaxes(shared, 1, 2) if few else np.swapaxes(shared, 1, 2) @ weighed
    apart = np.sum(inner * np.swapaxes(inner, 1, 2), axis=(1, 2)) - np.sum(less**2, axis=1)  # squares off the diagonal
    expected = np.sum(own - less, axis=1)
    spread = np.sum((own - less) ** 2, axis=1) + np.maximum(apart, 0.0)
    return moves.T @ moves, expected, expected**2 / np.where(spread > 0, spread, 1.0)


def _beyond_independent(excess: Floats, independent: Floats, block: Integers) -> Floats:
    """Return factors (m,) of variances by what is shown beyond independent errors, each half-way to its block's mean.

    What the jackknife shows of independent errors beyond their variance is known; of others it stays, on the safe side.
    """
    told = independent > 0
    raw = np.where(told, 1 + excess / np.where(told, independent, 1.0), 1.0)
    _, which = np.unique(block, return_inverse=True)
    mean = np.bincount(which, told * raw) / np.maximum(np.bincount(which, told), 1)
    return np.asarray(np.where(told, np.maximum((raw + mean[which]) / 2, _LEAST), 1.0))


def _shrunk(raw: Floats, freedom: Floats, block: Integers) -> Floats:
    """Return factors (m,) of variances, each drawn to that of its block, and this one to 1."""
    _, which = np.unique(block, return_inverse=True)
    total = np.bincount(which, freedom)
    mean = np.bincount(which, freedom * raw) / np.where(total > 0, total, 1.0)
    # Scalars of a block share residuals: together they have fewer degrees of freedom than one by one.
    total = total / np.sqrt(np.maximum(np.bincount(which, freedom > 0), 1))
    of_block = ((total * mean + _ONE_COUNTS) / (total + _ONE_COUNTS))[which]
    return np.asarray(np.maximum((freedom * raw + _BLOCK_COUNTS * of_block) / (freedom + _BLOCK_COUNTS), _LEAST))


def correlation_time(moves: Floats, block: Integers) -> int:
    """Return over how many stretches of time errors are correlated, by what each stretch moves in a block of scalars.

    Parameters
    ----------
    moves : (c, m) of scalars, by single stretches that are left out
    block : as in `robust_variances`
    """
    size = np.linalg.norm(moves, axis=0)
    moves = moves / np.where(size > 0, size, 1.0)
    longest = 0
    for number in distinct_values(block):
        own = moves[:, (block == number) & (size > 0)]
        least = max(_CORRELATED[0], _CORRELATED[1] / np.sqrt(max(own.size, 1)))
        for lag in range(1, min(_MOST_MEMORY, len(own) - 2) + 1):
            if not own.size or float(np.mean(np.sum(own[lag:] * own[:-lag], axis=0))) < least:
                break
            longest = max(longest, lag)
    return longest


def cluster_length(stretches: int, memory: int) -> int:
    """Return how many of the stretches make a cluster that outlasts the memory."""
    return max(min(1 + 2 * memory, stretches // _FEWEST), 1)


def group_into_clusters(sums: ClusterSums, memory: int) -> tuple[list[ClusterSums], int]:
    """Return sums of clusters that outlast the memory, cut with two sets of borders, and how many stretches they have.

    Parameters
    ----------
    sums : of single stretches
    memory : over how many of them errors are correlated
    """
    length = cluster_length(len(sums), memory)
    number = np.arange(len(sums))
    shifts = [0] if length == 1 else [0, length // 2]
    return [sums.gathered((number + shift) // length) for shift in shifts], length


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
def _random_signs(count: int) -> NDArray[np.uint8]:
    """Return signs (draws, count), 0 or 1, the same ones always."""
    drawn = np.frombuffer(Random(0).randbytes(_DRAWS * count // 8), np.uint8)  # NumPy's generators take time to load
    return np.unpackbits(drawn).reshape(_DRAWS, count)


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
        return float(quantile_of(2 * np.concatenate(sums) - own.sum(), self._level))

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
