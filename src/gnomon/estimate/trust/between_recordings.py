"""One sensor from several recordings: the mean, and how much the sensor changes from one recording to the next.

Recording i gives an estimate y_i with covariance V_i. The sensor itself is another one each time (it was switched on
anew, has another temperature, sits otherwise in its box):

    y_i ~ N(theta, V_i + T),   T = diag(tau_b^2), one tau for each block b of like scalars

This is the random-effects model of meta-analysis (DerSimonian and Laird 1986, multivariate: White 2009). With two to
six recordings a point estimate of tau claims too much (and is often zero). Each tau^2 is therefore taken by its
posterior mean under the restricted likelihood (Harville 1977) and a prior with a heavy tail about what is usual, f
(Gelman 2006 on why the tail matters where there are few groups):

    tau^2 ~ inverse gamma (1/2, f^2),   p(tau^2) ~ tau^-3 exp(-f^2 / tau^2).

Where V is small the mean is (2 f^2 + nu s^2) / (nu - 1) for nu differences between recordings of mean square s^2: a few
recordings of one morning do not show that the sensor never changes, and as they become more they decide. Where V is
large it stays of the order of f, and joining makes the result better than one recording.
"""

from collections.abc import Sequence

import numpy as np

from ...frozen import value_class
from ...recording import Floats, Integers

_NODES = 160
_LEAST, _MOST = 1e-2, 1e4  # of the variances between which tau^2 is looked for
_LEAST_CORRELATION = 1e-9  # of the eigenvalues of a correlation matrix


@value_class
class RecordingBlock:
    """Scalars that change alike from recording to recording.

    Attributes
    ----------
    index : (m,) their places
    usual : standard deviation of such a change, as is usual
    """

    index: Integers
    usual: float


@value_class
class JoinedEstimate:
    """What several recordings say together.

    Attributes
    ----------
    mean : (n,)
    mean_covariance : (n, n) of the mean
    scatter : (n,) standard deviation from recording to recording
    """

    mean: Floats
    mean_covariance: Floats
    scatter: Floats

    @property
    def covariance(self) -> Floats:
        """Of the sensor as it is on another occasion, about the mean, (n, n)."""
        return self.mean_covariance + np.diag(self.scatter**2)


def join_estimates(values: Floats, covariances: Floats, blocks: Sequence[RecordingBlock]) -> JoinedEstimate:
    """Join the estimates of several recordings.

    Parameters
    ----------
    values : (k, n) of at least two recordings
    covariances : (k, n, n) without what all share, positive definite
    blocks : each scalar is in one of them
    """
    within = np.array([_positive_definite(one) for one in covariances])
    variance = np.zeros(values.shape[1])
    for block in blocks:
        part = within[:, block.index[:, None], block.index]
        variance[block.index] = _between(values[:, block.index], part, block.usual)
    weights = np.linalg.inv(within + np.diag(variance))
    mean_covariance = np.linalg.inv(weights.sum(axis=0))
    mean = mean_covariance @ np.einsum("kij,kj->i", weights, values)
    return JoinedEstimate(mean=mean, mean_covariance=mean_covariance, scatter=np.sqrt(variance))


def _positive_definite(covariance: Floats) -> Floats:
    """Return a covariance without the negative eigenvalues that a difference of two may have."""
    sigma = np.sqrt(np.maximum(np.diag(covariance), np.finfo(float).tiny))
    size, axes = np.linalg.eigh(covariance / np.outer(sigma, sigma))
    return (axes * np.maximum(size, _LEAST_CORRELATION)) @ axes.T * np.outer(sigma, sigma)


def _between(values: Floats, within: Floats, usual: float) -> float:
    """Return the posterior mean of tau^2 of one block, (k, m) values and (k, m, m) covariances."""
    sizes = np.linalg.eigvalsh(within)
    least = _LEAST * min(usual**2, float(sizes.min()))
    most = _MOST * max(usual**2, float(sizes.max()), float(values.var(axis=0, ddof=1).max()))
    grid = np.geomspace(least, most, _NODES)
    weights = np.linalg.inv(within + grid[:, None, None, None] * np.eye(values.shape[1]))  # (node, k, m, m)
    total = weights.sum(axis=1)
    mean = np.linalg.solve(total, np.einsum("akij,kj->ai", weights, values)[..., None])[..., 0]
    off = values - mean[:, None, :]
    log = 0.5 * np.linalg.slogdet(weights)[1].sum(axis=1) - 0.5 * np.linalg.slogdet(total)[1]
    log -= 0.5 * np.einsum("aki,akij,akj->a", off, weights, off)
    log -= 1.5 * np.log(grid) + usual**2 / grid
    density = np.exp(log - log.max()) * grid  # the grid is even in log tau^2
    return float(density @ grid / density.sum())
