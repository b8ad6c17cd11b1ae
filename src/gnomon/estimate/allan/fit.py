"""The noise of one axis from its Allan variances: a weighted fit that knows how the estimates scatter together.

The Allan variance is linear in the squares of the coefficients, which are fitted by generalised least squares with none
below zero. The covariance of the estimates is that of the fitted noise itself, not of the observed variances, which are
low where their weights would be high; a few rounds settle it. A kind of noise that is not significant is taken out, and
gets an upper bound. Where the curve is not made of these kinds of noise alone, as no real one quite is, a relative
misfit of the model at every averaging time, found from the residuals, widens all sigmas.
"""

from dataclasses import dataclass, field, replace
from typing import Self

import numpy as np

from ...intervals import Booleans
from ...recording import Floats, Integers
from .model import KINDS, allan_design, estimate_covariance, line_effect

_SIGNIFICANT = 3.0  # sigmas
_WORTH = 2.0  # of twice the log likelihood, for a kind of noise to stay in the fit
_TINY = 1e-9
_FEWEST = 8  # averaging times in a fit
_ROUNDS = 20
_EXCESS = 5.0  # sigmas of the weighted squares of the residuals, for a misfit of the model
_WHITE = KINDS.index("white_noise")
_ALL = np.full(len(KINDS), True)
_SLOW = np.array([kind != "quantisation" for kind in KINDS])  # the shortest averaging times alone show quantisation


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class AxisFit:
    """The noise of one axis, for a sample period of one.

    Attributes
    ----------
    theta : (4,) squares of the coefficients, in the order of KINDS; zero where none was found
    sigma : (4,) their standard deviations; nan where none was found
    bound : (4,) what theta is below with about 97 %, where none was found; else nan
    slope, slope_sigma : of the samples over time, and what the noise alone makes of it
    ramp : whether the slope is no accident
    misfit : relative misfit of the model at every averaging time (1 sigma, of the Allan variance)
    fitted : (4,) theta of all kinds in the fit, also of those that are not sure
    first : index of the first averaging time in the fit
    scatter : (k,) relative standard deviations of the estimates of the Allan variance, in such noise
    """

    theta: Floats
    sigma: Floats
    bound: Floats
    slope: float
    slope_sigma: float
    ramp: bool
    misfit: float
    fitted: Floats
    first: int = 0
    scatter: Floats = field(default_factory=lambda: np.empty(0))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class AllanFit:
    """The fit for all recordings of one length.

    Attributes
    ----------
    design : (k, 4) Allan variance of each kind of noise at theta = 1
    straight : (k, 4) the same without a straight line through the samples
    slope_variance : (4,) variance of the slope of that line at theta = 1
    covariance : (4, 4, k, k) of the estimates, see `estimate_covariance`
    dof : (k,) the larger, the fewer differences are independent; for the first weights
    """

    design: Floats
    straight: Floats
    slope_variance: Floats
    covariance: Floats
    dof: Floats

    @classmethod
    def of(cls, factors: Integers, samples: int) -> Self:
        """Prepare the fit for averaging times (k,) in samples and a length of the recording."""
        line, design = line_effect(factors, samples), allan_design(factors)
        return cls(
            design=design,
            straight=design - line.taken,
            slope_variance=line.slope_variance,
            covariance=estimate_covariance(factors, samples),
            dof=np.sqrt(factors.astype(np.float64)),
        )

    def fit(self, straight: Floats, slope: float, optional: int = 0) -> AxisFit:
        """Fit the Allan variances (k,) of one axis without the straight line through its samples, of this slope.

        So many of the shortest averaging times may be left out, where a filter or vibration makes them misfit: up to
        the first one without misfit, or the one of which the least remains.
        """
        straight = np.maximum(straight, _TINY * straight.max())
        misfits = [self._misfit(straight, _ALL)]
        while misfits[-1] > 0 and len(misfits) <= min(optional, len(straight) - _FEWEST):
            misfits.append(self._after(len(misfits))._misfit(straight[len(misfits) :], _SLOW))
        first = int(np.argmin(misfits))
        part = self._after(first)
        found = part._fit(straight[first:], slope, _SLOW if first else _ALL, misfits[first])
        scatter = np.sqrt(np.diag(self._scatter(found.fitted))) / (self.design @ found.fitted)
        return replace(found, first=first, scatter=scatter)

    def _after(self, first: int) -> "AllanFit":
        """Return the fit without the shortest averaging times."""
        return AllanFit(
            design=self.design[first:],
            straight=self.straight[first:],
            slope_variance=self.slope_variance,
            covariance=np.ascontiguousarray(self.covariance[:, :, first:, first:]),
            dof=self.dof[first:],
        )

    def _fit(self, straight: Floats, slope: float, kinds: Booleans, misfit: float) -> AxisFit:
        """Take out the kinds of noise that are not worth their place, the least one first."""
        found = self._solved(straight, kinds, misfit)
        while True:
            without = {i: self._solved(straight, found.without(i), misfit) for i in found.optional()}
            evidence = {i: one.unlikely - found.unlikely for i, one in without.items()}
            weakest = min(evidence, key=evidence.__getitem__, default=_WHITE)
            if evidence.get(weakest, np.inf) > _WORTH:
                break
            found = without[weakest]
        strong = [evidence.get(i, np.inf) > _SIGNIFICANT**2 for i in range(len(KINDS))]
        sure = found.kinds & np.array(strong) & (found.theta > 0)
        bound = np.array([np.nan if sure[i] else self._bound(straight, found, i, misfit) for i in range(len(KINDS))])
        spread = float(np.sqrt(self.slope_variance @ np.where(sure, found.theta, bound)))
        return AxisFit(
            theta=np.where(sure, found.theta, 0.0),
            sigma=np.where(sure, found.sigma, np.nan),
            bound=bound,
            slope=slope,
            slope_sigma=spread,
            ramp=abs(slope) > _SIGNIFICANT * spread,
            misfit=misfit,
            fitted=found.theta,
        )

    def _solved(self, variance: Floats, kinds: Booleans, misfit: float, held: Floats | None = None) -> "_Found":
        """Return the estimate with some kinds of noise only, besides those whose theta is held."""
        from scipy.optimize import nnls

        design = self.straight[:, kinds]
        held = np.zeros(len(kinds)) if held is None else held
        theta, before = held.copy(), held.copy()
        others = self.straight @ held
        root = np.diag(variance * self.dof)
        for _ in range(_ROUNDS):
            weights = np.linalg.inv(root)
            theta[kinds] = nnls(weights @ design, weights @ (variance - others))[0]
            if np.allclose(theta, before, rtol=1e-4, atol=0):
                break
            before = theta.copy()
            own = (misfit * (self.straight @ theta)) ** 2 + (_TINY * variance) ** 2
            scatter = self._scatter(theta) + np.diag(own)
            root = np.linalg.cholesky(scatter)
        weights = np.linalg.inv(root)
        residual = weights @ (variance - self.straight @ theta)
        sigma = np.full(len(kinds), np.nan)
        sigma[kinds] = np.sqrt(np.diag(_inverse(weights @ design)))
        return _Found(
            kinds=kinds,
            theta=theta,
            sigma=sigma,
            weights=np.asarray(weights, dtype=np.float64),
            unlikely=float(residual @ residual + 2 * np.log(np.diag(root)).sum()),
        )

    def _scatter(self, theta: Floats) -> Floats:
        return np.einsum("p,q,pqij->ij", theta, theta, self.covariance)

    def _misfit(self, variance: Floats, kinds: Booleans) -> float:
        """Return the relative misfit with which the residuals are as large as expected; zero where they are without."""
        theta = self._solved(variance, kinds, 0.0).theta
        fitted = self.straight @ theta
        residual, scatter = variance - fitted, self._scatter(theta) + np.diag((_TINY * variance) ** 2)
        freedom = max(len(variance) - int(kinds.sum()), 1)

        def excess(misfit: float) -> float:
            total = scatter + np.diag((misfit * fitted) ** 2)
            return float(residual @ np.linalg.solve(total, residual)) - freedom

        if excess(0.0) < _EXCESS * np.sqrt(2 * freedom):
            return 0.0
        low, high = 0.0, 1.0
        while excess(high) > 0 and high < 1e3:
            low, high = high, 2 * high
        for _ in range(30):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if excess(middle) > 0 else (low, middle)
        return high

    def _bound(self, variance: Floats, found: "_Found", kind: int, misfit: float) -> float:
        """Return what theta of a kind is at most: twice the log likelihood falls by four there."""
        held = np.zeros(len(found.kinds))
        step = np.diag(_inverse(found.weights @ self.straight[:, [kind]]))[0] ** 0.5

        def likely(theta: float) -> bool:
            held[kind] = theta
            return self._solved(variance, found.without(kind), misfit, held).unlikely < found.unlikely + 4

        low, high = 0.0, float(found.theta[kind] + step)
        for _ in range(60):
            if not likely(high):
                break
            low, high = high, 2 * high
        for _ in range(6):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if likely(middle) else (low, middle)
        return high


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Found:
    """theta and sigma as in AxisFit; weights (k, k) whiten the residuals; unlikely is -2 log likelihood."""

    kinds: Booleans
    theta: Floats
    sigma: Floats
    weights: Floats
    unlikely: float

    def optional(self) -> list[int]:
        """Return the kinds that could be left out."""
        return [i for i in range(len(self.kinds)) if self.kinds[i] and i != _WHITE]

    def without(self, kind: int) -> Booleans:
        return self.kinds & (np.arange(len(self.kinds)) != kind)


def _inverse(design: Floats) -> Floats:
    """Return the inverse of the normal matrix, (p, p)."""
    scale = np.linalg.norm(design, axis=0)
    return np.linalg.pinv((design / scale).T @ (design / scale), hermitian=True) / np.outer(scale, scale)
