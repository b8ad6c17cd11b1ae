"""One sensor from several recordings: the mean, or a polynomial, and how much it changes from one to the next.

Recording i gives an estimate y_i with covariance V_i. The sensor itself is another one each time (it was switched on
anew, has another temperature, sits otherwise in its box):

    y_i ~ N(theta, V_i + T),   T = diag(tau_b^2), one tau for each block b of like scalars

Where something known explains a part of it, such as the temperature, theta is X_i beta instead, with powers of that.

This is the random-effects model of meta-analysis (DerSimonian and Laird 1986, multivariate: White 2009). With two to
six recordings a point estimate of tau claims too much (and is often zero). Each tau^2 is therefore taken by its
posterior mean under the restricted likelihood (Harville 1977) and a prior with a heavy tail about what is usual, f
(Gelman 2006 on why the tail matters where there are few groups):

    tau^2 ~ inverse gamma (1/2, f^2),   p(tau^2) ~ tau^-3 exp(-f^2 / tau^2).

Where V is small the mean is (2 f^2 + nu s^2) / (nu - 1) for nu differences between recordings of mean square s^2: a few
recordings of one morning do not show that the sensor never changes, and as they become more they decide. Where V is
large it stays of the order of f, and joining makes the result better than one recording.

Over temperatures each part of a calibration has an order of its own: the highest whose coefficients are no chance, and,
where there are enough recordings, foretell those left out better.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from ...frozen import value_class
from ...recording import Floats, Integers

_NODES = 160
_LEAST, _MOST = 1e-2, 1e4  # of the variances between which tau^2 is looked for
_LEAST_CORRELATION = 1e-9  # of the eigenvalues of a correlation matrix

_LIKELY = 1e-5
"""Probability by chance below which an order is taken up."""
_MORE = 3
"""Recordings more than the order from which on one can be left out, and the others still tell their scatter."""


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
class RegressedEstimate:
    """What several recordings say together of polynomials.

    Attributes
    ----------
    start : (n + 1,) where the coefficients of each scalar begin, that of the power 0 first
    coefficients : (p,)
    covariance : (p, p) of these
    scatter : (n,) standard deviation from recording to recording
    """

    start: Integers
    coefficients: Floats
    covariance: Floats
    scatter: Floats


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
    found = regress_estimates(values, covariances, blocks, [np.ones((len(values), 1))] * len(blocks))
    return JoinedEstimate(mean=found.coefficients, mean_covariance=found.covariance, scatter=found.scatter)


def regress_estimates(
    values: Floats, covariances: Floats, blocks: Sequence[RecordingBlock], powers: Sequence[Floats]
) -> RegressedEstimate:
    """Join the estimates of several recordings that differ by something known.

    Parameters
    ----------
    values, covariances, blocks : as for `join_estimates`
    powers : of each block, (k, 1 + order) of what is known of each recording, ones first
    """
    within = np.array([_positive_definite(one) for one in covariances])
    n = values.shape[1]
    variance, each = np.zeros(n), np.ones(n, dtype=np.int64)
    for block, own in zip(blocks, powers, strict=True):
        part = within[:, block.index[:, None], block.index]
        variance[block.index] = _between(values[:, block.index], part, block.usual, own)
        each[block.index] = own.shape[1]
    start = np.concatenate([[0], np.cumsum(each)])
    X = np.zeros((len(values), n, start[-1]))
    for block, own in zip(blocks, powers, strict=True):
        for scalar in block.index:
            X[:, scalar, start[scalar] : start[scalar + 1]] = own
    weights = np.linalg.inv(within + np.diag(variance))
    covariance = scaled_inverse(np.einsum("kip,kij,kjq->pq", X, weights, X, optimize=True))
    found = covariance @ np.einsum("kip,kij,kj->p", X, weights, values, optimize=True)
    return RegressedEstimate(start=start, coefficients=found, covariance=covariance, scatter=np.sqrt(variance))


def scaled_inverse(normal: Floats) -> Floats:
    """Return the inverse of a positive definite matrix whose rows may be of different units."""
    scale = 1 / np.sqrt(np.diag(normal))
    return np.asarray(np.linalg.inv(normal * np.outer(scale, scale)) * np.outer(scale, scale))


def _positive_definite(covariance: Floats) -> Floats:
    """Return a covariance without the negative eigenvalues that a difference of two may have."""
    sigma = np.sqrt(np.maximum(np.diag(covariance), np.finfo(float).tiny))
    size, axes = np.linalg.eigh(covariance / np.outer(sigma, sigma))
    return (axes * np.maximum(size, _LEAST_CORRELATION)) @ axes.T * np.outer(sigma, sigma)


def _between(values: Floats, within: Floats, usual: float, powers: Floats) -> float:
    """Return the posterior mean of tau^2 of one block, (k, m) values, (k, m, m) covariances and (k, p) powers."""
    powers = powers / np.maximum(np.abs(powers).max(axis=0), 1e-300)
    sizes = np.linalg.eigvalsh(within)
    least = _LEAST * min(usual**2, float(sizes.min()))
    most = _MOST * max(usual**2, float(sizes.max()), float(values.var(axis=0, ddof=1).max()))
    grid = np.geomspace(least, most, _NODES)
    weights = np.linalg.inv(within + grid[:, None, None, None] * np.eye(values.shape[1]))  # (node, k, m, m)
    count = powers.shape[1] * values.shape[1]
    total = np.einsum("kp,kq,akij->apiqj", powers, powers, weights, optimize=True).reshape(_NODES, count, count)
    target = np.einsum("kp,akij,kj->api", powers, weights, values, optimize=True).reshape(_NODES, count, 1)
    found = np.linalg.solve(total, target).reshape(_NODES, powers.shape[1], -1)
    off = values - np.einsum("kp,api->aki", powers, found)
    log = 0.5 * np.linalg.slogdet(weights)[1].sum(axis=1) - 0.5 * np.linalg.slogdet(total)[1]
    log -= 0.5 * np.einsum("aki,akij,akj->a", off, weights, off)
    log -= 1.5 * np.log(grid) + usual**2 / grid
    density = np.exp(log - log.max()) * grid  # the grid is even in log tau^2
    return float(density @ grid / density.sum())


@value_class
class Calibrations:
    """Calibrations of one sensor.

    Attributes
    ----------
    degc : (k,) less the reference [K]
    values : (k, n) [SI]
    covariances : (k, n, n)
    blocks : quantity -> its scalars; each is in one of them
    """

    degc: Floats
    values: Floats
    covariances: Floats
    blocks: Mapping[str, RecordingBlock]

    def without(self, left_out: int) -> "Calibrations":
        """Return all but one of them."""
        kept = np.arange(len(self.degc)) != left_out
        return replace(self, degc=self.degc[kept], values=self.values[kept], covariances=self.covariances[kept])

    def only(self, names: Sequence[str]) -> "Calibrations":
        """Return those scalars of them that belong to some quantities."""
        at = np.concatenate([self.blocks[name].index for name in names])
        ends = np.cumsum([0, *(len(self.blocks[name].index) for name in names)])
        blocks = {
            name: replace(self.blocks[name], index=np.arange(begin, end))
            for name, begin, end in zip(names, ends[:-1], ends[1:], strict=True)
        }
        return replace(self, values=self.values[:, at], covariances=self.covariances[:, at[:, None], at], blocks=blocks)

    def fit(self, orders: Mapping[str, int]) -> RegressedEstimate:
        """Return the polynomials of such orders; a quantity that is not named has order 0."""
        powers = [_powers(self.degc, orders.get(name, 0)) for name in self.blocks]
        return regress_estimates(self.values, self.covariances, list(self.blocks.values()), powers)

    def foretold(self, order: int) -> tuple[Floats, float]:
        """Return how far each recording lies off what the others foretell (k, n) [sigma], and -2 log density."""
        z, score = list[Floats](), 0.0
        for i, degc in enumerate(self.degc):
            found = self.without(i).fit(dict.fromkeys(self.blocks, order))
            rows = np.kron(np.eye(self.values.shape[1]), _powers(np.array([degc]), order))
            covariance = self.covariances[i] + np.diag(found.scatter**2) + rows @ found.covariance @ rows.T
            off = self.values[i] - rows @ found.coefficients
            z.append(off / np.sqrt(np.diag(covariance)))
            score += float(np.linalg.slogdet(covariance)[1] + off @ np.linalg.solve(covariance, off))
        return np.array(z), score

    def can_leave_out(self, order: int) -> bool:
        """Return whether a recording may be left out."""
        return len(self.degc) >= order + _MORE


def _powers(degc: Floats, order: int) -> Floats:
    return np.vander(degc, order + 1, increasing=True)


def proven_order(recorded: Calibrations, most: int) -> int:
    """Return the order that the recordings prove of all their scalars together.

    Parameters
    ----------
    most : the highest order that the range supports
    """
    return next((order for order in range(most, 0, -1) if _proven(recorded, order)), 0)


def _proven(recorded: Calibrations, order: int) -> bool:
    """Return whether the coefficients of the highest order are no chance, and of use."""
    from scipy.special import chdtrc

    found = recorded.fit(dict.fromkeys(recorded.blocks, order))
    places = found.start[:-1] + order
    last = found.coefficients[places]
    size = float(last @ np.linalg.solve(found.covariance[np.ix_(places, places)], last))
    if chdtrc(len(last), size) > _LIKELY:
        return False
    if not recorded.can_leave_out(order):
        return True
    return recorded.foretold(order)[1] < recorded.foretold(order - 1)[1]
