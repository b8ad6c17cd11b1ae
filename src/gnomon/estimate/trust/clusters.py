"""The covariance that survives correlated residuals: clusters of time, and the jackknife over them (CR3).

An estimate theta minimises J = sum over clusters of J_c, plus the prior's J_p. With everything else (a trajectory, the
directions of gravity) eliminated, each cluster has a pull s_c = -dJ_c/dtheta and an information S_c; the pulls and the
prior's sum up to zero. Left out, a cluster moves the estimate by

    d_c = -(S - S_c)^-1 s_c,    S = sum S_c + P,

and with n clusters longer than the residuals' memory the covariance is (n - 1) / n sum d_c d_c', however the residuals
within a cluster are correlated. A part of a recording has the estimate that its own clusters pull to, and a smaller
model that of its own parameters: halves, thirds and submodels cost no further solution.
"""

from dataclasses import replace

import numpy as np

from ...frozen import value_class
from ...recording import Floats, Integers


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
        order = np.argsort(which, kind="stable")
        first = np.searchsorted(which[order], np.arange(len(numbers)))
        return replace(
            self,
            t_s=np.add.reduceat(self.t_s[order], first) / np.bincount(which),
            pull=np.add.reduceat(self.pull[order], first),
            information=np.add.reduceat(self.information[order], first),
        )

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


def jackknife_covariance(sums: ClusterSums) -> Floats:
    """Return the covariance (p, p) by leaving out clusters (CR3); what was known beforehand counts as it was stated."""
    moves, count = leave_clusters_out(sums), len(sums)
    total = _inverse(sums.total)
    return (count - 1) / count * moves.T @ moves + total @ sums.prior_information @ total


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
    numbers = np.unique(part[part >= 0])
    steps, inverses = [], []
    for number in numbers:
        own = part == number
        information = sums.information[own].sum(axis=0) + sums.prior_information
        steps.append(_solved(information, sums.pull[own].sum(axis=0) + sums.prior_pull))
        inverses.append(_inverse(information))
    return np.array(steps), np.array(inverses)


def held_out_costs(sums: ClusterSums) -> Floats:
    """Return how much the cost of each cluster changes from `theta` to the estimate without it, (c,).

    The estimate without cluster c is that of the other clusters and the prior; the model is that of the parameters of
    `sums`, and zero change is their present value. Smaller models are compared by `ClusterSums.of_parameters`.
    """
    rest_pull = sums.pull.sum(axis=0) + sums.prior_pull - sums.pull
    steps = _solved(sums.total - sums.information, rest_pull)
    return np.einsum("cp,cpq,cq->c", steps, sums.information, steps) / 2 - np.einsum("cp,cp->c", sums.pull, steps)


def _solved(matrix: Floats, right: Floats) -> Floats:
    """Solve symmetric equations (..., p, p) x = (..., p) whose units differ by many powers of ten."""
    scaled, size = _scaled(matrix)
    solution = np.linalg.solve(scaled, (size * right)[..., None])[..., 0]
    return np.asarray(size * solution, dtype=np.float64)


def _inverse(matrix: Floats) -> Floats:
    scaled, size = _scaled(matrix)
    return np.asarray(np.linalg.inv(scaled) * _outer(size), dtype=np.float64)


def _scaled(matrix: Floats) -> tuple[Floats, Floats]:
    """Return matrices (..., p, p) of unit diagonal, and by what (..., p) rows and columns were multiplied."""
    diagonal = np.einsum("...ii->...i", matrix)
    size = 1 / np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
    return matrix * _outer(size), size


def _outer(size: Floats) -> Floats:
    return size[..., :, None] * size[..., None, :]
