"""Sigmas of a triad that hold where poses do not err alike or not independently, as when a hand turns the sensor.

The field differs from place to place, and a hand accelerates: neighbouring residuals err together, and the covariance
for independent errors is too small. Blocks of time longer than this memory are as good as independent; how the estimate
moves when each is left out tells its covariance (the delete-one-block jackknife). Each step is one exact Gauss-Newton
step. Estimates that rest on earlier ones move along with them.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ...frozen import value_class
from ...recording import Floats, Integers
from ...results.sensors import element_names
from ...results.trust import BlockAgreement, Splits, Trust
from ..trust.clusters import ClusterSums
from ..trust.parts import RobustCovariance, robust_covariance
from .triad import TriadFit

_FEWEST_FREEDOM = 3.0  # below, Student's t has no variance

_CELLS_S = 0.25
_FORGOTTEN = 0.1  # correlation that counts as none
_LONGER = 3.0  # a block, than that takes
FEWEST_BLOCKS = 15
_SHORTEST_S = 1.0


def triad_sums(fit: TriadFit, stretch: Integers, t_s: Floats) -> ClusterSums:
    """Return pulls and information of stretches of time on the free parameters.

    Parameters
    ----------
    stretch : (n,) number of the stretch, from 0 and rising in time, that a pose belongs to
    t_s : (n,) when each pose was measured [s]
    """
    lines = fit.lines
    row = stretch[lines.pose]
    order = np.argsort(row, kind="stable")
    _, first = np.unique(row[order], return_index=True)
    jacobian, residual = lines.jacobian[order], lines.residual[order]
    return ClusterSums(
        t_s=np.bincount(stretch, t_s) / np.bincount(stretch),
        pull=-np.add.reduceat(jacobian * residual[:, None], first),
        information=np.add.reduceat(jacobian[:, :, None] * jacobian[:, None, :], first),
        prior_pull=lines.prior_pull,
        prior_information=lines.prior_information,
    )


def robust_triad(
    fit: TriadFit,
    triad: str,
    *,
    t_s: Floats | None = None,
    stretch: Integers | None = None,
    g_sensitivity: bool = False,
    widened: bool = True,
) -> tuple[TriadFit, RobustCovariance]:
    """Return the fit with the covariance from clusters of poses, and how parts of the recording agree.

    Parameters
    ----------
    fit : of n poses
    triad : its path, such as "imu0.accelerometer"
    t_s : (n,) when each pose was measured [s]; None where only their order is known
    stretch : (n,) number of the stretch of a pose, such as its attitude on a turntable; each its own where not given
    g_sensitivity : whether it belongs to the triad
    widened : as in `robust_covariance`
    """
    n = len(fit.used)
    t_s = np.arange(n, dtype=np.float64) if t_s is None else t_s
    stretch = np.arange(n) if stretch is None else np.unique(stretch, return_inverse=True)[1]
    names = [*element_names(f"{triad}.sensitivity", (3, 3)), *element_names(f"{triad}.bias", (3,))]
    names += element_names(f"{triad}.g_sensitivity", (3, 3)) if g_sensitivity else []
    count = len(names)
    found = robust_covariance(
        triad_sums(fit, stretch, t_s),
        fit.lines.unscaled[:count],
        names,
        fit.covariance[:count, :count],
        biases=(f"{triad}.bias",),
        widened=widened,
    )
    covariance = fit.covariance.copy()
    covariance[:count, :count] = found.covariance * _few_residuals(fit)
    return replace(fit, covariance=covariance), found


def _few_residuals(fit: TriadFit) -> float:
    """Return by how much variances are larger since few residuals tell the level of noise: as Student's t has it."""
    if not fit.extra_sigma > 0:
        return 1.0
    share = min(1.0, fit.extra_sigma**2 / max(float(np.median(fit.magnitude_sigma[fit.used] ** 2)), 1e-300))
    freedom = max(fit.degrees_of_freedom, _FEWEST_FREEDOM)
    return 1 + share * 2 / (freedom - 2)


def merge_trusts(trusts: Sequence[Trust]) -> Trust:
    """Return what recordings of several triads say, as if they were of one."""
    if len(trusts) == 1:
        return trusts[0]
    counted = [trust.clusters for trust in trusts if trust.clusters is not None]
    return Trust(
        clusters=min(counted, key=lambda clusters: clusters.count) if counted else None,
        names=tuple(name for trust in trusts for name in trust.names),
        ordinary_sigma=np.concatenate([trust.ordinary_sigma for trust in trusts]),
        sigma=np.concatenate([trust.sigma for trust in trusts]),
        ratios=tuple(ratio for trust in trusts for ratio in trust.ratios),
        splits=_pooled([trust.splits for trust in trusts if trust.splits is not None]),
        changes=tuple(change for trust in trusts for change in trust.changes),
    )


def _pooled(splits: Sequence[Splits]) -> Splits | None:
    if not splits:
        return None
    blocks: tuple[BlockAgreement, ...] = tuple(block for one in splits for block in one.blocks)
    weight = np.array([sum(block.comparisons for block in one.blocks) for one in splits])

    def pooled(values: list[float]) -> float:
        return float(np.sqrt(np.average(np.square(values), weights=weight)))

    return Splits(
        splits=tuple(dict.fromkeys(name for one in splits for name in one.splits)),
        blocks=blocks,
        z_rms=pooled([one.z_rms for one in splits]),
        z_rms_ordinary=pooled([one.z_rms_ordinary for one in splits]),
        limit=pooled([one.limit for one in splits]),
    )


@value_class
class Stage:
    """One least-squares estimate, linearised at its solution; residuals in units of their sigma.

    Attributes
    ----------
    residual : (n,); zero rows where a pose was not used
    jacobian : (n, p) derivative by its own parameters
    earlier : derivatives (n, q) by the parameters of each of the stages before it; empty where it rests on none
    covariance : (p, p) for independent errors, with what was known beforehand
    precision : (p, p) of what was known beforehand; None where that is nothing
    """

    residual: Floats
    jacobian: Floats
    covariance: Floats
    earlier: tuple[Floats, ...] = ()
    precision: Floats | None = None


def memory_s(t_s: Floats, residual: Floats) -> float:
    """Return after how long residuals (n,) at rising times have forgotten each other [s]."""
    cell, which, count = np.unique(np.floor((t_s - t_s[0]) / _CELLS_S), return_inverse=True, return_counts=True)
    mean = np.bincount(which, residual) / count
    power = float(np.mean(mean**2))
    if power <= 0:
        return 0.0
    most = int(min(cell[-1] + 1, 4 * len(cell))) // 4  # after a jump of the clock most cells are empty
    for lag in range(1, most):
        later = np.minimum(np.searchsorted(cell, cell + lag), len(cell) - 1)
        pairs = cell[later] == cell + lag
        if pairs.any() and float(mean[later[pairs]] @ mean[pairs]) / pairs.sum() < _FORGOTTEN * power:
            return (lag - 1) * _CELLS_S
    return most * _CELLS_S


@value_class
class TimeBlocks:
    """Blocks of time.

    Attributes
    ----------
    block : (n,) of each pose
    length_s : of a block [s]
    memory_s : after which errors are forgotten [s]
    """

    block: Integers
    length_s: float
    memory_s: float

    @classmethod
    def of(cls, t_s: Floats, memory: float) -> "TimeBlocks":
        """Return blocks of rising times (n,), three times as long as the memory unless they became too few."""
        span = float(t_s[-1] - t_s[0]) * (1 + 1e-9)
        length = min(max(_LONGER * memory, _SHORTEST_S), span / FEWEST_BLOCKS)
        block = np.unique(np.floor((t_s - t_s[0]) / length), return_inverse=True)[1]  # without those that are empty
        return cls(block=block.astype(np.int64), length_s=length, memory_s=memory)

    @property
    def long_enough(self) -> bool:
        """Whether they are long enough."""
        return self.length_s > (_LONGER - 0.5) * self.memory_s

    @property
    def seen(self) -> float:
        """Share of the variance of means that blocks show: errors that straddle a border are missed."""
        ratio = self.length_s * np.log(1 / _FORGOTTEN) / self.memory_s if self.memory_s > 0 else np.inf
        return float(1 - (1 - np.exp(-ratio)) / ratio)


def leave_blocks_out(stages: Sequence[Stage], block: Integers) -> Floats:
    """Return how all parameters, stage by stage, move when each block is left out, (blocks, p + q + ...)."""
    count = int(block.max()) + 1
    moved: list[Floats] = []
    for stage in stages:
        j, r = stage.jacobian, stage.residual
        size = np.linalg.norm(j, axis=0)
        size = np.where(size > 0, size, 1.0)
        j = j / size
        known = 0.0 if stage.precision is None else stage.precision / np.outer(size, size)
        inner = _by_block(j[:, :, None] * j[:, None, :], block, count)
        pull = _by_block(j * r[:, None], block, count)
        for by, step in zip(stage.earlier, moved, strict=False):
            cross = _by_block(j[:, :, None] * by[:, None, :], block, count)
            pull -= np.einsum("bpq,bq->bp", cross.sum(axis=0) - cross, step)
        rest = inner.sum(axis=0) - inner + known
        moved.append((np.linalg.pinv(rest, rcond=1e-13, hermitian=True) @ pull[..., None])[..., 0] / size)
    return np.concatenate(moved, axis=1)


def block_covariance(stages: Sequence[Stage], blocks: TimeBlocks, moves: Floats) -> Floats:
    """Return the joint covariance of all parameters.

    The blocks tell the variances, none of them below that for independent errors. Correlations of many parameters they
    tell badly, and of more parameters than blocks not at all: the fewer blocks, the more the correlations for
    independent errors count.
    """
    count = len(np.unique(blocks.block[np.any([stage.residual != 0 for stage in stages], axis=0)]))
    # A variance of few degrees of freedom is taken for larger, as Student's is.
    student = (count - 1) / max(count - 3, 1)
    covariance = student * (count - 1) / max(count, 1) / blocks.seen * moves.T @ moves
    ordinary, known = _independent(stages)
    covariance += known
    variance = np.maximum(np.diag(covariance), np.diag(ordinary))
    share = len(variance) / (len(variance) + count)
    correlation = (1 - share) * _correlation(covariance) + share * _correlation(ordinary)
    return correlation * np.sqrt(np.outer(variance, variance))


def _independent(stages: Sequence[Stage]) -> tuple[Floats, Floats]:
    """Return the joint covariance for independent errors, and the part of it that the prior brings."""
    edges = np.concatenate([[0], np.cumsum([len(stage.covariance) for stage in stages])])
    total = np.eye(edges[-1])
    ordinary, known = np.zeros_like(total), np.zeros_like(total)
    for k, stage in enumerate(stages):
        at = slice(edges[k], edges[k + 1])
        ordinary[at, at] = stage.covariance
        if stage.precision is not None:
            known[at, at] = stage.covariance @ stage.precision @ stage.covariance
        for j, by in enumerate(stage.earlier):
            total[at] -= stage.covariance @ (stage.jacobian.T @ by) @ total[edges[j] : edges[j + 1]]
    return total @ ordinary @ total.T, total @ known @ total.T


def _correlation(covariance: Floats) -> Floats:
    sigma = np.sqrt(np.diag(covariance))
    sigma = np.where(sigma > 0, sigma, 1.0)
    correlation = covariance / np.outer(sigma, sigma)
    np.fill_diagonal(correlation, 1.0)
    return correlation


def _by_block(rows: Floats, block: Integers, count: int) -> Floats:
    flat = rows.reshape(len(rows), -1)
    order = np.argsort(block, kind="stable")
    sums = np.zeros((count, flat.shape[1]))
    found, first = np.unique(block[order], return_index=True)
    sums[found] = np.add.reduceat(flat[order], first, axis=0)
    return sums.reshape(count, *rows.shape[1:])


def by_direction(x: Floats, correction: Floats) -> Floats:
    """Return the derivatives (n, 3, 12) of the directions of vectors x = correction @ (measured - bias), (n, 3).

    By the entries of the sensitivity, whose inverse the correction is, in row order, and by the bias.
    """
    length = np.linalg.norm(x, axis=1)
    u = x / length[:, None]
    across = (np.eye(3) - u[:, :, None] * u[:, None, :]) @ correction / length[:, None, None]
    by_sensitivity = (across[:, :, :, None] * x[:, None, None, :]).reshape(len(x), 3, 9)
    return -np.concatenate([by_sensitivity, across], axis=2)
