"""Sigmas of a triad that hold where poses do not err alike or not independently.

How far a magnetometer's parameters can be trusted: the blocks of time behind its covariance, and parts compared.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ...recording import Floats, Integers
from ...results.sensors import element_names
from ...results.trust import BlockAgreement, Clusters, SigmaRatio, Splits, Trust
from ..trust.changes import parameter_changes
from ..trust.clusters import ClusterSums, Robust
from ..trust.parts import PartComparison, RobustCovariance, robust_covariance
from .magnetometer import MagnetometerFit
from .triad import TriadFit

_FEWEST_FREEDOM = 3.0  # below, Student's t has no variance


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


_PATHS = ("imu0.magnetometer.sensitivity", "imu0.magnetometer.bias")
_NAMES = (*element_names(_PATHS[0], (3, 3)), *element_names(_PATHS[1], (3,)))
_OPEN = 1e-9  # of the information: what a part leaves open stays finite


def field_trust(fit: MagnetometerFit, t_s: Floats) -> RobustCovariance:
    """Return what blocks of time say of a magnetometer, in its own frame.

    Parameters
    ----------
    t_s : (n,) when each pose was measured [s]
    """
    basis, stage = fit.iron.basis, fit.stage
    known = np.zeros_like(stage.covariance) if stage.precision is None else stage.precision
    by_prior = basis @ stage.covariance @ known @ stage.covariance @ basis.T
    ordinary, covariance = basis @ stage.covariance @ basis.T, basis @ fit.covariance @ basis.T
    from_errors = ordinary - by_prior
    own = np.diag(from_errors)
    factor = np.where(own > 0, (np.diag(covariance) - np.diag(by_prior)) / np.where(own > 0, own, 1.0), 1.0)
    sums = _sums(fit, t_s, known)
    found = Robust(
        factor=np.maximum(factor, 1.0),
        from_errors=from_errors,
        from_prior=by_prior,
        correlation=np.eye(len(own)),
        clusters=len(sums),
    )
    paths = np.array([name.split("[")[0] for name in _NAMES], dtype=object)
    estimated = np.diag(ordinary) > 0
    comparison = PartComparison(sums=sums, jacobian=basis, found=found, names=_NAMES, paths=paths)
    return RobustCovariance(
        covariance=covariance,
        trust=Trust(
            clusters=Clusters(count=len(sums), length_s=fit.blocks.length_s, memory_s=fit.blocks.memory_s),
            names=tuple(np.array(_NAMES, dtype=object)[estimated]),
            ordinary_sigma=np.sqrt(np.diag(ordinary)[estimated]),
            sigma=np.sqrt(np.diag(covariance)[estimated]),
            ratios=tuple(
                SigmaRatio(block=path, ratio=float(np.sqrt(np.mean(found.factor[(paths == path) & estimated]))))
                for path in dict.fromkeys(paths[estimated])
            ),
            splits=comparison.splits(estimated, paths == _PATHS[1], 1),
            changes=parameter_changes(sums, basis, _NAMES, judged=estimated),
        ),
        instabilities=(comparison.instability(_PATHS[1], estimated),),
    )


def _sums(fit: MagnetometerFit, t_s: Floats, known: Floats) -> ClusterSums:
    block = np.unique(fit.blocks.block, return_inverse=True)[1]
    _, first = np.unique(block, return_index=True)
    jacobian, residual = fit.stage.jacobian, fit.stage.residual
    pull = -np.add.reduceat(jacobian * residual[:, None], first)
    information = np.add.reduceat(jacobian[:, :, None] * jacobian[:, None, :], first)
    return ClusterSums(
        t_s=np.bincount(block, t_s) / np.bincount(block),
        pull=pull,
        information=information,
        prior_pull=-pull.sum(axis=0) if known.any() else np.zeros(len(known)),
        prior_information=known + _OPEN * np.diag(np.diag(information.sum(axis=0))),
    )
