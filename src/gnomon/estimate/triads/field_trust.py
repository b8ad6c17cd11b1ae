"""How far a magnetometer's parameters can be trusted: the blocks of time behind its covariance, and parts compared."""

import numpy as np

from ...recording import Floats
from ...results.parameters import element_names
from ...results.trust import Clusters, SigmaRatio, Trust
from ..trust.changes import parameter_changes
from ..trust.cluster_trust import PartComparison, RobustCovariance
from ..trust.clusters import ClusterSums
from ..trust.robust import Robust
from .magnetometer import MagnetometerFit

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
