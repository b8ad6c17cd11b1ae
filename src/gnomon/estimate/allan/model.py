"""What noise of known kinds makes of the Allan variance: its mean, and how its estimates scatter together.

Averaging times are in samples, m; the parameters theta are variances for a sample period of one:

    kind               spectrum        Allan variance            integral's generalised covariance
    quantisation  Q    Q^2 (2 pi f)^2  3 Q^2 / m^2               Q^2 at s = 0
    white noise   N    N^2             N^2 / m                   -N^2 |s| / 2
    instability   B    B^2 / (2 pi f)  (2 ln 2 / pi) B^2         B^2 s^2 ln|s| / (2 pi)
    random walk   K    K^2 / (2 pi f)^2  K^2 m / 3               K^2 |s|^3 / 12

and between them, so that noise of other slopes is noticed, theta with

    below white        theta / f^(1/2)    theta m^(-1/2)            -|s|^(3/2) / (4 - 2 sqrt 2)
    below flicker      theta / f^(3/2)    theta m^(1/2)             |s|^(5/2) / (4 sqrt 2 - 4)

(two-sided spectra, IEEE 952; the last two but for a factor). A filter in the sensor that passes low frequencies as they
are takes the integral's variance over m from N^2 m to N^2 (m - a) for m beyond its memory, whatever filter it is, which
takes 3 N^2 a / (2 m^2) from the Allan variance.

The integral x of the noise has no covariance, but its second differences have one, which follows from the generalised
covariance g(s) by differencing it at both ends. The estimates at averaging times i and j are means of squares of
Gaussian second differences, whence their covariance 2 cov(z_i, z_j)^2, summed over all pairs.
"""

from math import log, pi, sqrt

import numpy as np

from ...frozen import value_class
from ...recording import Floats, Integers

KINDS = ("quantisation", "white_noise", "bias_instability", "random_walk")
COLUMNS = (*KINDS, "below_white", "below_flicker", "filter")
"""What a fit may be made of: kinds of noise, noise of slopes between them, and what a low-pass filter takes off."""

FLOOR = 2 * log(2) / pi
"""Allan variance of 1/f noise in units of B^2: the floor of the Allan deviation is 0.664 B."""
_SECOND = np.array([1.0, -2.0, 1.0])
_FINE = 8  # lags in the shorter averaging time, near the lags where the covariance bends
_NODES, _BEGINS = 240, 48  # of the integrals over the recording
_TAIL = 60  # lags beyond
_FAR = 40  # of the longer averaging time: beyond, 1/f noise is no more correlated


def allan_design(factors: Integers) -> Floats:
    """Return the Allan variance that each of COLUMNS makes at theta = 1, (k, 7)."""
    m = factors.astype(np.float64)
    kinds = [3 / m**2, 1 / m, np.full(len(m), FLOOR), m / 3]
    return np.stack([*kinds, m**-0.5, m**0.5, -3 / m**2], axis=1)


def integral_covariances(lag: Floats) -> Floats:
    """Return the generalised covariances of the integral of each of COLUMNS, (7, ...); a filter has none."""
    size = np.abs(lag)
    with np.errstate(divide="ignore", invalid="ignore"):
        flicker = np.where(size > 0, size**2 * np.log(size), 0.0) / (2 * pi)
    between = -(size**1.5) / (4 - 2 * sqrt(2)), size**2.5 / (4 * sqrt(2) - 4)
    return np.stack([(size == 0).astype(np.float64), -size / 2, flicker, size**3 / 12, *between, np.zeros_like(size)])


def estimate_covariance(factors: Integers, samples: int) -> Floats:
    """Return C (7, 7, k, k): the estimates of the Allan variance have covariance sum_pq theta_p theta_q C[p, q].

    Parameters
    ----------
    factors : (k,) averaging times in samples, rising
    samples : length of the recording
    """
    count = len(factors)
    C = np.zeros((len(COLUMNS), len(COLUMNS), count, count))
    for i in range(count):
        for j in range(i, count):
            C[:, :, i, j] = C[:, :, j, i] = _pair(int(factors[i]), int(factors[j]), samples)
    return C


def _pair(short: int, long: int, samples: int) -> Floats:
    """Return the covariance (7, 7) of the estimates at two averaging times."""
    terms = samples + 1 - 2 * short, samples + 1 - 2 * long
    lag = _lags(short, long, terms)
    ends = np.add.outer(lag, np.add.outer(-short * np.arange(3.0), long * np.arange(3.0)))
    r = np.einsum("pnab,a,b->pn", integral_covariances(ends), _SECOND, _SECOND)
    # how many pairs of terms have this lag, and how many lags each one stands for
    pairs = np.minimum(terms[0], terms[1] - lag) - np.maximum(0, -lag)
    stands_for = np.gradient(lag) if len(lag) > 1 else np.ones(1)
    stands_for[[0, -1]] = 0.5 * (stands_for[[0, -1]] + 1) if len(lag) > 1 else 1.0
    weight = pairs * stands_for / (2.0 * short**2 * long**2 * terms[0] * float(terms[1]))
    return (r * weight) @ r.T


def _lags(short: int, long: int, terms: tuple[int, int]) -> Floats:
    """Return lags, dense about those at which an end of one difference meets an end of the other."""
    reach = _FAR * long
    dense = np.arange(0.0, 4 * short + 1, max(1.0, short / _FINE))
    steps = np.unique(np.rint(np.concatenate([[1.0], dense, np.geomspace(4 * short, reach, _TAIL)])))
    steps = np.concatenate([-steps[::-1], steps])
    meet = [short * a - long * b for a in range(3) for b in range(3)]
    lag = np.unique(np.add.outer(meet, steps))
    return lag[(lag > -terms[0]) & (lag < terms[1])]


@value_class
class LineEffect:
    """What a straight line through the samples takes along, for theta = 1 of each kind.

    Attributes
    ----------
    slope_variance : (7,) variance of its slope [per sample]
    taken : (k, 7) by how much the Allan variance of noise is lower when the line is taken away
    """

    slope_variance: Floats
    taken: Floats


def line_effect(factors: Integers, samples: int) -> LineEffect:
    """Return what least squares with a straight line does to noise."""
    edges = np.linspace(0, samples, _NODES + 1)
    middle = (edges[1:] + edges[:-1]) / 2 - samples / 2
    weight = middle / (middle @ middle) * _NODES / samples  # of increments of the integral
    ends = -np.diff(weight, prepend=0.0, append=0.0)
    variance = np.einsum("i,pij,j->p", ends, integral_covariances(np.subtract.outer(edges, edges)), ends)
    taken = np.zeros((len(factors), len(COLUMNS)))
    for row, m in enumerate(factors.astype(np.float64)):
        begins = np.linspace(0, samples - 2 * m, _BEGINS)
        lags = np.subtract.outer(np.add.outer(begins, m * np.arange(3.0)), edges)
        together = np.einsum("pkai,a,i->pk", integral_covariances(lags), _SECOND, ends).mean(axis=1)
        taken[row] = together - 0.5 * m**2 * variance
    return LineEffect(slope_variance=variance, taken=taken)
