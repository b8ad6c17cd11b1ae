"""From pulls and information of stretches of time to sigmas that hold, and to what parts of the recording say."""

from collections.abc import Callable, Collection, Sequence
from dataclasses import replace
from statistics import NormalDist

import numpy as np
from numpy.typing import NDArray

from ...frozen import value_class
from ...recording import Floats, Integers
from ...results.result import Booleans
from ...results.trust import Clusters, ParameterChange, SigmaRatio, Splits, Trust
from .changes import estimates_are_judged, parameter_changes
from .clusters import (
    ClusterSums,
    Robust,
    correlation_time,
    group_into_clusters,
    leave_clusters_out,
    robust_variances,
)
from .parts import Split, part_agreement, part_differences

_FEWEST_IN_PART = 5  # stretches
_NTH = {2: ("first", "second"), 3: ("first", "middle", "last")}
_CHANCE = 0.01  # that the bias of a sensor which stays is called unstable


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
    spacing = float(np.median(np.diff(sums.t_s))) if len(sums) > 1 else 0.0  # one rest, and the rest known beforehand
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
            proven=float(z[worst]) > NormalDist().inv_cdf(1 - _CHANCE / (2 * len(z))),
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
