"""Pulls and information that static intervals and rotations have on the parameters, for covariances by clusters.

A stretch of time is a static interval with the rotation that follows it. The directions of gravity are eliminated as in
the factor of the solution: with Z = inv(N_uu) N_up, a stretch whose normal equations are H and whose gradient is g has
the information T' H T and the pull -T' g, T = [-Z; I]. Over all stretches and the prior the information adds up to the
Schur complement, and the pulls to zero.
"""

import numpy as np

from ...recording import Floats
from ...results.intervals import Booleans
from ..trust.clusters import ClusterSums
from .fit import MultiPositionFit
from .noise_levels import rotation_variance

_RUN, _MOST_OF_RUN = 5, 4  # rotations


def segment_sums(fit: MultiPositionFit, rotations: Booleans | None = None) -> ClusterSums:
    """Return the sums of each static interval with the rotation behind it, over the free parameters of a fit.

    Parameters
    ----------
    rotations : (n - 1,) which of them count; those that the fit used where not given
    """
    lines, whitening, free = fit.lines, fit.whitening, fit.free
    cross = np.swapaxes(fit.arrow.cross_covariance, 1, 2)
    follow = np.swapaxes(np.linalg.solve(fit.arrow.corner_covariance, cross), 1, 2)  # -Z, (n, 2, p)
    n, _, p = follow.shape
    pull, information = np.zeros((n, p)), np.zeros((n, p, p))
    for name in ("accelerometer", "gyroscope"):
        root = getattr(whitening, name)
        rows = root @ (getattr(lines, f"{name}_theta")[..., free] + getattr(lines, f"{name}_u") @ follow)
        _add(pull, information, rows, np.einsum("kij,kj->ki", root, getattr(lines, name)))
    rows = lines.rotation_theta[..., free] + lines.rotation_u @ follow[:-1] + follow[1:]
    weight = whitening.rotation[:, None]
    if rotations is not None:
        spread = np.sqrt(rotation_variance(fit.data, fit.state) + fit.extra.rotation)
        weight = (rotations / spread)[:, None]
    _add(pull[:-1], information[:-1], weight[..., None] * rows, weight * lines.rotation)
    prior = whitening.prior[np.ix_(free, free)]
    return ClusterSums(
        t_s=fit.data.interval_s,
        pull=pull,
        information=information,
        prior_pull=-(whitening.prior @ fit.from_prior)[free],
        prior_information=prior,
    )


def with_runs(fit: MultiPositionFit) -> Booleans:
    """Return the rotations (n - 1,) that a fit used, and those left out as outliers many of which follow each other.

    Outliers come one by one. Where they are most of a stretch of the recording, it is the stretch that differs.
    """
    linked = np.flatnonzero(fit.data.linked)
    out = ~fit.rotation_used[linked]
    many = np.convolve(out, np.ones(_RUN), mode="full")  # number left out of the last few, up to each
    used = fit.rotation_used.copy()
    for end in np.flatnonzero(many[: len(out)] >= _MOST_OF_RUN):
        used[linked[max(0, end - _RUN + 1) : end + 1]] = True
    return used


def free_jacobian(fit: MultiPositionFit, jacobian: Floats) -> Floats:
    """Return derivatives (m, 30) by theta as those (m, p) by the free parameters of the sums."""
    return np.pad(jacobian, ((0, 0), (0, len(fit.free) - jacobian.shape[1])))[:, fit.free]


def _add(pull: Floats, information: Floats, rows: Floats, residual: Floats) -> None:
    pull -= np.einsum("kip,ki->kp", rows, residual)
    information += np.swapaxes(rows, 1, 2) @ rows
