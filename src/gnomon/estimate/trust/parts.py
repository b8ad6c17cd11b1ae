"""Sigmas that hold by the scatter of stretches of time, and whether parts of a recording agree within them.

Each part is estimated for itself and compared with the others. The difference of two parts' estimates is linear in the
pulls of their clusters, so that for independent errors the covariance of all differences together is known, and with it
how large differences pooled over parameters and parts would be by chance.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from itertools import combinations
from statistics import NormalDist

import numpy as np
from numpy.typing import NDArray

from ...frozen import value_class
from ...recording import Floats, Integers
from ...recording.samples import median_of
from ...results.result import Booleans
from ...results.trust import BlockAgreement, Clusters, ParameterChange, SigmaRatio, Splits, Trust
from .changes import estimates_are_judged, parameter_changes
from .clusters import (
    ClusterSums,
    Robust,
    correlation_time,
    group_into_clusters,
    leave_clusters_out,
    part_estimates,
    robust_variances,
)

_FEWEST_IN_PART = 5  # stretches
_NTH = {2: ("first", "second"), 3: ("first", "middle", "last")}
_UNSTABLE_CHANCE = 0.01  # that the bias of a sensor which stays is called unstable

_CHANCE_SIGMA = 2.326  # of a normal deviate that one of a hundred exceeds
_ROUNDING_ERRORS = 100.0  # that a variance must be above; it is as a rule above 1e4 of them, or below one
_MOST_PRIOR = 0.3  # of a difference's variance; beyond, it tells more of what was assumed than of the parts


@value_class
class Instability:
    """How far a bias differed between parts that follow each other.

    Attributes
    ----------
    block : path
    size : largest difference between two parts of any of its scalars [unit]
    sigma : of that difference, for independent errors [unit]
    where : which scalar and which parts, such as "[2], first third and last third"
    proven : whether it is larger than chance explains
    """

    block: str
    size: float
    sigma: float
    where: str
    proven: bool


@value_class
class RobustCovariance:
    """What stretches of time say of an estimate's uncertainty.

    Attributes
    ----------
    covariance : (m, m) of the scalars, cluster-robust unless the ordinary one was wanted
    trust : without the steps of a model choice
    instabilities : of the biases
    """

    covariance: Floats
    trust: Trust
    instabilities: tuple[Instability, ...]


@value_class
class Split:
    """One way to cut a recording.

    Attributes
    ----------
    name : such as "halves"
    part : (c,) number of the part of each cluster, from 0
    labels : of the parts, such as ("first half", "second half")
    counts : (m,) bool, scalars that are compared
    """

    name: str
    part: Integers
    labels: tuple[str, ...]
    counts: Booleans


@value_class
class Differences:
    """Differences between the estimates of pairs of parts, d in number.

    Attributes
    ----------
    scalar : (d,) number of the scalar
    where : (d,) the two parts, in words
    value : (d,)
    sigma, ordinary_sigma : (d,) published, and for independent errors
    correlation : (d, d) for independent errors
    """

    scalar: Integers
    where: tuple[str, ...]
    value: Floats
    sigma: Floats
    ordinary_sigma: Floats
    correlation: Floats

    def __len__(self) -> int:
        return len(self.value)

    @property
    def limit(self) -> float:
        """Root mean square of value / sigma that honest sigmas exceed in one of a hundred recordings."""
        freedom = len(self) ** 2 / float(np.sum(self.correlation**2))
        spread = 2 / (9 * freedom)  # of the cube root of chi-square over its degrees of freedom (Wilson and Hilferty)
        return float((1 - spread + _CHANCE_SIGMA * np.sqrt(spread)) ** 1.5)


def robust_covariance(
    sums: ClusterSums,
    jacobian: Floats,
    names: Sequence[str],
    ordinary: Floats,
    *,
    biases: Collection[str],
    widened: bool = True,
    single: ClusterSums | None = None,
    order: Integers | None = None,
    by_cause: Callable[[], ParameterChange | None] | None = None,
    moves: Floats | None = None,
) -> RobustCovariance:
    """Return the covariance from clusters of time, and how parts of the recording agree.

    Halves and thirds that follow each other would show a bias that wanders, which its sigma does not mean to cover: it
    is the bias of this recording. Biases are compared between stretches that take turns; how they differ between halves
    and thirds is told apart.

    Parameters
    ----------
    sums : of the shortest stretches of time, static intervals or poses
    jacobian : (m, p) of the scalars by the parameters of the sums
    names : (m,) of the scalars, such as "imu0.gyroscope.bias[0]"
    ordinary : (m, m) covariance for independent errors, with what comes from outside the recording, such as gravity
    biases : paths of biases
    widened : whether the covariance from clusters is wanted, not that for independent errors
    single, order : sums of single views, and their numbers as they were recorded, by which changes are looked for;
        those of the stretches where not given
    by_cause : see `parameter_changes`
    moves : what `leave_clusters_out` returns for the sums, where that is known
    """
    paths = np.array([name.split("[")[0] for name in names], dtype=object)
    number = {path: k for k, path in enumerate(dict.fromkeys(paths))}
    block = np.array([number[path] for path in paths])
    estimated = np.diag(ordinary) > 0
    remembered = correlation_time((leave_clusters_out(sums) if moves is None else moves) @ jacobian.T, block)
    phases, length = group_into_clusters(sums, remembered)
    found = robust_variances(phases, jacobian, block)
    if not widened:
        found = replace(found, factor=np.ones_like(found.factor))
    covariance = ordinary
    if widened:
        covariance = found.covariance + _from_outside(ordinary - found.from_errors - found.from_prior)
    biased = np.array([path in biases for path in paths], dtype=bool)
    comparison = PartComparison(sums=sums, jacobian=jacobian, found=found, names=names, paths=paths)
    spacing = float(median_of(np.diff(sums.t_s))) if len(sums) > 1 else 0.0  # one rest, and the rest known beforehand
    return RobustCovariance(
        covariance=covariance,
        trust=Trust(
            clusters=Clusters(count=found.clusters, length_s=length * spacing, memory_s=remembered * spacing)
            if widened
            else None,
            names=tuple(np.array(names, dtype=object)[estimated]),
            ordinary_sigma=np.sqrt(np.diag(ordinary)[estimated]),
            sigma=np.sqrt(np.diag(covariance)[estimated]),
            ratios=_ratios(found, paths, estimated) if widened else (),
            splits=comparison.splits(estimated, biased, length),
            changes=parameter_changes(
                single or sums, jacobian, names, biases=biases, judged=estimated, order=order, by_cause=by_cause
            ),
        ),
        instabilities=tuple(comparison.instability(path, estimated) for path in biases if (paths == path).any())
        if len(sums) >= 2 * _FEWEST_IN_PART
        else (),
    )


def _from_outside(covariance: Floats) -> Floats:
    """Return the part of a covariance (m, m) that the recording does not give, without variances below zero.

    It is a difference: where nothing comes from outside, lost digits may leave it negative.
    """
    positive = np.diag(covariance) > 0
    return np.where(np.outer(positive, positive), covariance, 0.0)


def _ratios(found: Robust, paths: NDArray[np.object_], estimated: Booleans) -> tuple[SigmaRatio, ...]:
    """Return ratios of sigmas block by block, of what the errors of the recording make of them."""
    moved = estimated & (np.diag(found.from_errors) > 0)
    return tuple(
        SigmaRatio(block=path, ratio=float(np.sqrt(np.mean(found.factor[(paths == path) & moved]))))
        for path in dict.fromkeys(paths[moved])
    )


@value_class
class PartComparison:
    """Parts of a recording, compared: its stretches, and the scalars with the paths (m,) of their blocks."""

    sums: ClusterSums
    jacobian: Floats
    found: Robust
    names: Sequence[str]
    paths: NDArray[np.object_]

    def splits(self, estimated: Booleans, biased: Booleans, length: int) -> Splits | None:
        """Compare halves and thirds, biases apart, and clusters of `length` stretches that take turns."""
        if len(self.sums) < 2 * _FEWEST_IN_PART or not estimates_are_judged():
            return None
        turns = Split(
            name="taking turns",
            part=np.arange(len(self.sums)) // length % 2,
            labels=("odd clusters", "even clusters"),
            counts=estimated,
        )
        splits = [*self._consecutive(estimated & ~biased), turns]
        found = part_differences(self.sums, self.jacobian, self.found, splits)
        if not len(found):
            return None
        blocks = {path: np.flatnonzero(self.paths == path) for path in dict.fromkeys(self.paths)}
        return part_agreement(found, splits, self.names, blocks)

    def instability(self, path: str, estimated: Booleans) -> Instability:
        """Compare a bias between halves and thirds."""
        splits = self._consecutive(estimated & (self.paths == path))
        found = part_differences(self.sums, self.jacobian, self.found, splits) if splits else ()
        if not found:
            return Instability(block=path, size=0.0, sigma=0.0, where="", proven=False)
        z = np.abs(found.value) / found.ordinary_sigma
        worst = int(np.argmax(z))
        element = self.names[int(found.scalar[worst])].removeprefix(path)
        return Instability(
            block=path,
            size=float(abs(found.value[worst])),
            sigma=float(found.ordinary_sigma[worst]),
            where=f"{element}, {found.where[worst]}",
            proven=float(z[worst]) > NormalDist().inv_cdf(1 - _UNSTABLE_CHANCE / (2 * len(z))),
        )

    def _consecutive(self, counts: Booleans) -> list[Split]:
        n = len(self.sums)
        return [
            Split(
                name=name,
                part=np.arange(n) * parts // n,
                labels=tuple(f"{nth} {name[:-1].replace('halve', 'half')}" for nth in _NTH[parts]),
                counts=counts,
            )
            for name, parts in (("halves", 2), ("thirds", 3))
            if n >= parts * _FEWEST_IN_PART
        ]


def part_differences(sums: ClusterSums, jacobian: Floats, wider: Robust, splits: Sequence[Split]) -> Differences:
    """Compare parts of a recording pair by pair.

    Parameters
    ----------
    sums : of clusters
    jacobian : (m, p) of the scalars by the parameters of the sums
    wider : by how much the variances of the scalars are larger than for independent errors
    splits : ways to cut the clusters
    """
    # Clusters that every split has in the same part are moved alike: their sums are enough.
    beside = np.ravel_multi_index([split.part for split in splits], [int(split.part.max()) + 1 for split in splits])
    _, first, which = np.unique(beside, return_index=True, return_inverse=True)
    alike = (which == np.arange(len(first))[:, None]).astype(np.float64)
    information, sizes_of = (np.tensordot(alike, one, 1) for one in (sums.information, np.abs(sums.information)))
    pairs = [pair for split in splits for pair in _pairs(sums, jacobian, split, first)]
    arms = np.concatenate([pair[2] for pair in pairs])  # (d, c, p): what a pull of each group moves
    prior = np.concatenate([pair[3] for pair in pairs])  # (d, p): what that of the prior moves
    flat = arms.reshape(len(arms), arms.shape[1] * arms.shape[2])
    by_errors = (arms.swapaxes(0, 1) @ information).swapaxes(0, 1).reshape(flat.shape) @ flat.T
    by_prior = prior @ sums.prior_information @ prior.T
    scalar = np.concatenate([pair[0] for pair in pairs])
    where = [pair[4] for pair in pairs for _ in pair[0]]
    own, assumed = np.diag(by_errors), np.diag(by_prior)
    sizes = np.abs(arms)
    rounding = np.finfo(np.float64).eps * np.sum((sizes.swapaxes(0, 1) @ sizes_of).swapaxes(0, 1) * sizes, axis=(1, 2))
    ordinary = np.sqrt(np.maximum(own + assumed, 0.0))
    # What nothing moves is held by the model; and a part that determines nothing has sums of rounding errors.
    told = (own > _ROUNDING_ERRORS * rounding) & (assumed <= _MOST_PRIOR * ordinary**2)
    size = np.where(ordinary > 0, ordinary, 1.0)
    correlation = (by_errors + by_prior) / np.outer(size, size)
    return Differences(
        scalar=scalar[told],
        where=tuple(np.array(where, dtype=object)[told]),
        value=np.concatenate([pair[1] for pair in pairs])[told],
        sigma=np.sqrt((wider.factor[scalar] * own + assumed)[told]),
        ordinary_sigma=ordinary[told],
        correlation=correlation[np.ix_(told, told)],
    )


def _pairs(
    sums: ClusterSums, jacobian: Floats, split: Split, shown: Integers
) -> list[tuple[Integers, Floats, Floats, Floats, str]]:
    """Return of pairs of parts the scalars, differences, and how pulls of clusters and of the prior move them."""
    steps, inverses = part_estimates(sums, split.part)
    rows = np.flatnonzero(split.counts)
    of_part = split.part[shown, None] == np.arange(len(steps))
    gains = jacobian[rows] @ inverses
    found: list[tuple[Integers, Floats, Floats, Floats, str]] = []
    for i, j in combinations(range(len(steps)), 2):
        arms = of_part[:, i, None] * gains[i][:, None, :] - of_part[:, j, None] * gains[j][:, None, :]
        value = jacobian[rows] @ (steps[i] - steps[j])
        found.append((rows, value, arms, gains[i] - gains[j], f"{split.labels[i]} and {split.labels[j]}"))
    return found


def part_agreement(
    found: Differences, splits: Sequence[Split], names: Sequence[str], blocks: Mapping[str, Integers]
) -> Splits:
    """Return how parts agree, block by block.

    Parameters
    ----------
    names : (m,) of the scalars, such as "imu0.gyroscope.bias[0]"
    blocks : path -> numbers of its scalars
    """
    z, ordinary = found.value / found.sigma, found.value / found.ordinary_sigma
    rows: list[BlockAgreement] = []
    for path, members in blocks.items():
        own = np.flatnonzero(np.isin(found.scalar, members))
        if not len(own):
            continue
        worst = int(own[np.argmax(np.abs(z[own]))])
        element = names[int(found.scalar[worst])].removeprefix(path)
        rows.append(
            BlockAgreement(
                block=path,
                comparisons=len(own),
                z_rms=_rms(z[own]),
                z_rms_ordinary=_rms(ordinary[own]),
                largest=float(abs(z[worst])),
                where=f"{element}, {found.where[worst]}" if element else found.where[worst],
            )
        )
    return Splits(
        splits=tuple(split.name for split in splits),
        blocks=tuple(rows),
        z_rms=_rms(z),
        z_rms_ordinary=_rms(ordinary),
        limit=found.limit,
    )


def _rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(values**2)))
