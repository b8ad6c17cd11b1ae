"""Parts of one recording, each estimated for itself and compared with the others.

The difference of two parts' estimates is linear in the pulls of their clusters, so that for independent errors the
covariance of all differences together is known, and with it how large differences pooled over parameters and parts
would be by chance.
"""

from collections.abc import Mapping, Sequence
from itertools import combinations

import numpy as np

from ...frozen import value_class
from ...recording import Floats, Integers
from ...results.result import Booleans
from ...results.trust import BlockAgreement, Splits
from .clusters import ClusterSums, Robust, part_estimates

_CHANCE_SIGMA = 2.326  # of a normal deviate that one of a hundred exceeds
_ROUNDING_ERRORS = 100.0  # that a variance must be above; it is as a rule above 1e4 of them, or below one
_MOST_PRIOR = 0.3  # of a difference's variance; beyond, it tells more of what was assumed than of the parts


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


def part_differences(sums: ClusterSums, jacobian: Floats, wider: Robust, splits: Sequence[Split]) -> Differences:
    """Compare parts of a recording pair by pair.

    Parameters
    ----------
    sums : of clusters
    jacobian : (m, p) of the scalars by the parameters of the sums
    wider : by how much the variances of the scalars are larger than for independent errors
    splits : ways to cut the clusters
    """
    pairs = [pair for split in splits for pair in _pairs(sums, jacobian, split)]
    arms = np.concatenate([pair[2] for pair in pairs])  # (d, c, p): what a pull of each cluster moves
    prior = np.concatenate([pair[3] for pair in pairs])  # (d, p): what that of the prior moves
    flat = arms.reshape(len(arms), arms.shape[1] * arms.shape[2])
    by_errors = (arms.swapaxes(0, 1) @ sums.information).swapaxes(0, 1).reshape(flat.shape) @ flat.T
    by_prior = prior @ sums.prior_information @ prior.T
    scalar = np.concatenate([pair[0] for pair in pairs])
    where = [pair[4] for pair in pairs for _ in pair[0]]
    own, assumed = np.diag(by_errors), np.diag(by_prior)
    sizes = np.abs(arms)
    rounding = np.finfo(np.float64).eps * np.sum(
        (sizes.swapaxes(0, 1) @ np.abs(sums.information)).swapaxes(0, 1) * sizes, axis=(1, 2)
    )
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


def _pairs(sums: ClusterSums, jacobian: Floats, split: Split) -> list[tuple[Integers, Floats, Floats, Floats, str]]:
    """Return of each pair of parts the scalars, differences, and how pulls of clusters and of the prior move them."""
    steps, inverses = part_estimates(sums, split.part)
    rows = np.flatnonzero(split.counts)
    of_part = split.part[:, None] == np.arange(len(steps))
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
