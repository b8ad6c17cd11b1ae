"""Whether a sensor takes its slow errors away: a high-pass filter, an auto-zero, a bias that is drawn back to its mean.

No kind of noise has less power at low frequencies than at higher ones, and what walks has the more the lower they are.
Behind a high-pass filter there is less: the power spectrum of the means over equal spans of time is compared with that
of any sum of the kinds of noise, as they are and behind a filter of some corner frequency. The periodogram's ordinates
scatter about the spectrum as chi-square of two degrees of freedom, so that with P their mean over a band of n

    twice the log likelihood = - 2 sum n (log S + P / S)

(Whittle, 1953). The weights in S, none below zero, are found by multiplicative updates (Fevotte, Bertin, Durrieu 2009).
"""

import numpy as np

from ...frozen import value_class
from ...recording import Floats
from ...results.intervals import Booleans

_SLOPES = (0.0, -0.5, -1.0, -1.5, -2.0)  # of the power spectra, as in `model.COLUMNS` without quantisation
_ORDERS = (1, 2)  # of the filter
_CORNERS = 24
_LOWEST_CORNER = 4.0  # periods in the recording
_HIGHEST = 0.25  # frequency for the interval of the means
_FIRST = 2  # ordinate: the straight line takes from the lowest one
_WIDTH = 1.06  # of a band, where it holds more than one ordinate
_FEWEST = 40  # bands
_UPDATES = 80
_LINES, _LINE_CHANCE = 3, 1e-3  # bands with a spectral line, that are left out
_UNFILTERED = 0.2  # of the filter's time constant
_SURE, _OWN = 26.0, 4.0  # of twice the log likelihood: of one axis or of all together; of an axis that others confirm
_PERHAPS = 3.0  # of all together, for bounds that hold behind a filter, too; chance alone may reach it


@value_class
class HighPass:
    """A filter that takes slow errors away.

    Attributes
    ----------
    corner_hz : frequency below which it does
    axes : (3,) bool, behind it
    gain : of twice the log likelihood, of these axes
    sure : whether chance does not explain it
    """

    corner_hz: float
    axes: Booleans
    gain: float
    sure: bool = True


def find_high_pass(means: Floats, interval_s: float) -> HighPass | None:
    """Return the filter behind which the means (k, 3) of equal spans of time are, where there is one.

    Parameters
    ----------
    interval_s : length of such a span [s]
    """
    count = len(means)
    if count < 8:
        return None
    f, power, ordinates = _bands(means)
    if len(f) < _FEWEST:
        return None
    corners = np.geomspace(_LOWEST_CORNER / count, f[-1] / 2, _CORNERS)
    filters = [1 / (1 + (corner / f) ** (2 * order)) for order in _ORDERS for corner in corners]
    kinds = f[:, None] ** np.array(_SLOPES)
    spectra = np.stack([kinds, *(one[:, None] * kinds for one in filters)])
    gains = np.stack([_gains(spectra, power[:, axis], ordinates) for axis in range(power.shape[1])])
    together = int(np.argmax(gains.sum(axis=0)))
    best = together
    if gains[:, best].sum() < _SURE:
        best = int(np.argmax(gains.max(axis=0)))
    axes = gains[:, best] > (_OWN if best == together else _SURE)
    gain = float(gains[axes, best].sum())
    if gain < _SURE and gains[:, together].sum() > _PERHAPS:
        all_axes, hz = np.ones(power.shape[1], dtype=bool), float(corners[together % _CORNERS]) / interval_s
        return HighPass(corner_hz=hz, axes=all_axes, gain=float(gains[:, together].sum()), sure=False)
    if gain < _SURE:
        return None
    return HighPass(corner_hz=float(corners[best % _CORNERS]) / interval_s, axes=axes, gain=gain)


def _bands(means: Floats) -> tuple[Floats, Floats, Floats]:
    """Return frequencies (m,) [1/interval], mean power of each band (m, 3), and its number of ordinates (m,)."""
    count = len(means)
    t = np.arange(count) - (count - 1) / 2
    centred = means - means.mean(axis=0)
    centred = centred - np.outer(t, t @ centred / (t @ t))
    last = int(_HIGHEST * count)
    power = np.abs(np.fft.rfft(centred, axis=0)[_FIRST : last + 1]) ** 2
    power = power / np.maximum(np.median(power, axis=0), 1e-300)
    edges = (
        np.unique(np.rint(_FIRST * _WIDTH ** np.arange(np.log(last / _FIRST) / np.log(_WIDTH))).astype(int)) - _FIRST
    )
    ordinates = np.diff(edges, append=len(power)).astype(np.float64)
    f = np.add.reduceat(np.arange(_FIRST, last + 1) / count, edges) / ordinates
    return f, np.add.reduceat(power, edges) / ordinates[:, None], ordinates


def _gains(spectra: Floats, power: Floats, ordinates: Floats) -> Floats:
    """Return by how much twice the log likelihood is larger with each filter than without one, (filters,).

    Parameters
    ----------
    spectra : (1 + filters, m, kinds) of each kind of noise, first without a filter
    power, ordinates : (m,)
    """
    from scipy.special import gammaincc  # loaded for long recordings only  # pyright: ignore[reportMissingTypeStubs]

    plain = _fitted(spectra[:1], power, ordinates)[0]
    chance = gammaincc(ordinates, ordinates * power / plain)
    worst = np.argsort(chance)[:_LINES]
    used = ordinates.copy()
    used[worst[chance[worst] < _LINE_CHANCE / len(power)]] = 0.0
    fitted = _fitted(spectra, power, used)
    unlikely = 2 * np.sum(used * (np.log(fitted) + power / fitted), axis=1)
    return unlikely[0] - unlikely[1:]


def _fitted(spectra: Floats, power: Floats, ordinates: Floats) -> Floats:
    """Return the most likely sum of spectra (..., m, kinds) for each set, (..., m)."""
    size = np.maximum(np.average(spectra, axis=1, weights=np.maximum(ordinates, 1e-9)), 1e-300)
    scaled = spectra / size[:, None]
    weights = np.full((len(spectra), spectra.shape[2]), 0.2)
    for _ in range(_UPDATES):
        fitted = (scaled @ weights[..., None])[..., 0]
        down = ordinates / fitted
        up = down * power / fitted
        weights = weights * (up[:, None] @ scaled)[:, 0] / np.maximum((down[:, None] @ scaled)[:, 0], 1e-300)
        weights = np.maximum(weights, 1e-12)
    return (scaled @ weights[..., None])[..., 0]


def longest_unfiltered_s(found: HighPass | None, axis: int) -> float:
    """Return up to which averaging time the Allan variance of an axis is as without the filter [s].

    White noise behind a filter of time constant T lacks a third of (tau / T)^2 there.
    """
    return np.inf if found is None or not found.axes[axis] else _UNFILTERED / (2 * np.pi * found.corner_hz)
