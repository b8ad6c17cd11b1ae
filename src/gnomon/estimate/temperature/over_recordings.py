"""Sensitivities and biases over temperature, from calibrations at several temperatures.

Calibration i, at temperature T_i, gives scalars y_i with covariance V_i:

    y_i ~ N(sum_j p_j (T_i - T_ref)^j, V_i + diag(tau^2)),

with a tau for each block of like scalars, what differs from one switching-on to the next (`between_recordings`), and an
order for each part: the highest whose coefficients are no chance, and, where there are enough recordings, foretell
those left out better.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from ...frozen import value_class
from ...recording import Floats
from ..trust.between_recordings import RecordingBlock, RegressedEstimate, regress_estimates

_LIKELY = 1e-5
"""Probability by chance below which an order is taken up."""
_MORE = 3
"""Recordings more than the order from which on one can be left out, and the others still tell their scatter."""


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
    from scipy.special import chdtrc  # on demand  # pyright: ignore[reportMissingTypeStubs]

    found = recorded.fit(dict.fromkeys(recorded.blocks, order))
    places = found.start[:-1] + order
    last = found.coefficients[places]
    size = float(last @ np.linalg.solve(found.covariance[np.ix_(places, places)], last))
    if chdtrc(len(last), size) > _LIKELY:
        return False
    if not recorded.can_leave_out(order):
        return True
    return recorded.foretold(order)[1] < recorded.foretold(order - 1)[1]
