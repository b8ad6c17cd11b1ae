"""The noise of one axis from its Allan variances: a weighted fit that knows how the estimates scatter together.

The Allan variance is linear in the squares of the coefficients, which are fitted by generalised least squares with none
below zero. The covariance of the estimates is that of the fitted noise itself, not of the observed variances, which are
low where their weights would be high; a few rounds settle it. A kind of noise that is not significant is taken out, and
gets an upper bound.

Whether the curve is made of these kinds alone is told by the weighted squares of the residuals, which follow the law of
chi-square where it is (Hansen 1982; for wavelet variances, which these are, Guerrier et al. 2013). Where they do not:

* Noise of a slope between these kinds is added, if all averaging times are explained then. What it changes, and its own
  sigmas, widen those of all kinds; it does so as well where it is likely without being needed.
* Else the shortest averaging times are left out for a filter's sake, and what it does to the longer ones is in the fit.
  Sigmas are widened by what leaving out one more changes (Hausman 1978).
* What then is left makes a relative misfit of the model at every averaging time, which widens all sigmas.

Where the deviation falls faster than that of white noise up to the end, the sensor takes its slow errors away, and only
shorter averaging times tell of its noise.
"""

from dataclasses import field, replace
from typing import Self

import numpy as np

from ...frozen import value_class
from ...recording import Floats, Integers
from ...results.result import Booleans
from ...solve.least_squares import solve_nonnegative
from .deviation import COLUMNS, KINDS, allan_design, estimate_covariance, line_effect

_SIGNIFICANT = 3.0  # sigmas
_WORTH = 2.0  # of twice the log likelihood, for a kind of noise to stay in the fit
_TINY = 1e-9
_FEWEST = 8  # averaging times in a fit
_ROUNDS = 20
_EXCESS = 5.0  # sigmas of the weighted squares of the residuals, for a misfit of the model
_WHITE = KINDS.index("white_noise")
_SLOWEST = np.array([kind in {"bias_instability", "random_walk"} for kind in KINDS])
_ALL = np.array([column in KINDS for column in COLUMNS])
# The shortest averaging times alone show quantisation; where a filter hides them, it takes as much off as that adds.
_SLOW = np.array([column in {*KINDS[1:], "filter"} for column in COLUMNS])
_BETWEEN = tuple(COLUMNS.index(column) for column in ("below_white", "below_flicker"))
_FILTER = COLUMNS.index("filter")
_BOUND = 7.0  # of twice the log likelihood; four is two sigma of a normal law, and long averaging times have none
_OTHER_SLOPE = 4.0  # of twice the log likelihood, for noise of another slope to widen sigmas
_OTHER_SLOPE_FITTED = 10.0  # the same, for it to be in the fit
_OF_TRIAD = 6.0  # more of both, where all axes together tell
_LOOK_BACK, _FALLEN, _NO_CHANCE = 5, 0.6, 1e-5  # of the variance of white noise, at the longest averaging times
_BEFORE_FALL = 3  # averaging times between those that fall and those that tell of the noise


@value_class
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
    fitted : (7,) theta of all of COLUMNS in the fit, also of those that are not sure
    first, stop : index of the first averaging time in the fit, and of the first one after it
    falls : whether a high-pass filter takes slow errors away, so that longer averaging times are left out
    delay : of the low-pass filter in the fit [samples]: white noise through one pole shows its time constant; or 0
    other_slope : by how much noise of a slope between the kinds changes theta of white noise, relative
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
    stop: int = 0
    falls: bool = False
    delay: float = 0.0
    other_slope: float = 0.0
    scatter: Floats = field(default_factory=lambda: np.empty(0))


@value_class
class AllanFit:
    """The fit for all recordings of one length.

    Attributes
    ----------
    design : (k, 7) Allan variance of each of COLUMNS at theta = 1
    straight : (k, 7) the same without a straight line through the samples
    slope_variance : (7,) variance of the slope of that line at theta = 1
    covariance : (7, 7, k, k) of the estimates, see `estimate_covariance`
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

    def other_slopes(self, straight: Floats) -> Floats:
        """Return by how much noise of each slope between the kinds raises twice the log likelihood of an axis, (2,)."""
        straight = np.maximum(straight, _TINY * straight.max())
        one, *others = (self._solved(straight, kinds, 0.0) for kinds in (_ALL, *map(_with, _BETWEEN)))
        return np.array([one.unlikely - other.unlikely for other in others])

    def fit(
        self,
        straight: Floats,
        slope: float,
        optional: int = 0,
        unfiltered: int | None = None,
        triad: Floats | None = None,
        *,
        sure: bool = True,
    ) -> AxisFit:
        """Fit the Allan variances (k,) of one axis without the straight line through its samples, of this slope.

        What all axes of the `triad` together tell of noise of other slopes (2,), from `other_slopes`, counts as well.

        Only so many averaging times are `unfiltered` where a filter takes slow errors away, for `sure` or perhaps.
        So many of the shortest averaging times may be left out, where a filter or vibration makes them misfit: up to
        the first one without misfit, or the one of which the least remains.
        """
        straight = np.maximum(straight, _TINY * straight.max())
        stop = self._falls_from(straight)
        falls = stop < len(straight) or (unfiltered is not None and sure)
        if unfiltered is not None:
            stop = min(stop, max(unfiltered, _FEWEST))
        triad = np.zeros(len(_BETWEEN)) if triad is None else triad - _OF_TRIAD
        first, kinds, misfit = self._part(0, stop)._explained(straight[:stop], optional, triad)
        part = self._part(first, stop)
        triad = triad if first == 0 else np.zeros(len(_BETWEEN))  # which was told from all averaging times
        found = part._fit(straight[first:stop], slope, kinds, misfit, triad=triad, bounded=_SLOWEST & falls)
        noise = np.where(np.arange(len(COLUMNS)) == _FILTER, 0.0, found.fitted)
        scatter = np.sqrt(np.diag(self._scatter(noise))) / (self.design @ noise)
        return replace(found, first=first, stop=stop, falls=falls, scatter=scatter)

    def _explained(self, straight: Floats, optional: int, triad: Floats) -> tuple[int, Booleans, float]:
        """Return how many of the shortest averaging times to leave out, of what the rest is made (7,), and its misfit.

        Noise of a slope between the kinds comes before a filter: it explains all averaging times.
        """
        for others in ((), _BETWEEN[:1], _BETWEEN[1:], _BETWEEN):
            kinds = _with(*others)
            if not self._misfit(straight, kinds):
                gains = np.maximum(self.other_slopes(straight), triad)
                worth = float(gains.max()) > _OTHER_SLOPE_FITTED
                return 0, kinds | _with(_BETWEEN[int(np.argmax(gains))]) if worth else kinds, 0.0
        first, misfit = self._without_filter(straight, optional)
        return first, _SLOW if first else _ALL, misfit

    def _without_filter(self, straight: Floats, optional: int) -> tuple[int, float]:
        """Return how many of the shortest averaging times to leave out, and the misfit of the others."""
        misfits = [self._misfit(straight, _ALL)]
        while misfits[-1] > 0 and len(misfits) <= min(optional, len(straight) - _FEWEST):
            misfits.append(self._part(len(misfits))._misfit(straight[len(misfits) :], _SLOW))
        first = int(np.argmin(misfits))
        if 0 < first < min(optional, len(straight) - _FEWEST):  # what is left of a filter may pass for other noise
            first += 1
            return first, self._part(first)._misfit(straight[first:], _SLOW)
        return first, misfits[first]

    def _falls_from(self, straight: Floats) -> int:
        """Return how many averaging times come before those at which the variance falls faster than white noise's.

        No kind of noise does so but quantisation, at short ones; nor does a wave to the end.
        """
        from scipy.special import chdtr  # a part of what loading chi2 costs  # pyright: ignore[reportMissingTypeStubs]

        white = self.straight[:, _WHITE]
        level, freedom = straight / white, 2 * white**2 / np.diag(self.covariance[_WHITE, _WHITE])
        for stop in range(_FEWEST, len(level) - 2):
            ratio = level[stop:] / level[stop - _LOOK_BACK : stop].max()
            falls = (ratio < _FALLEN).all() and ratio[-2:].mean() < _FALLEN * ratio[0]
            if falls and chdtr(freedom[stop:], freedom[stop:] * ratio).min() < _NO_CHANCE:
                return max(stop - _BEFORE_FALL, _FEWEST)
        return len(level)

    def _part(self, first: int, stop: int | None = None) -> "AllanFit":
        """Return the fit to some of the averaging times."""
        return AllanFit(
            design=self.design[first:stop],
            straight=self.straight[first:stop],
            slope_variance=self.slope_variance,
            covariance=np.ascontiguousarray(self.covariance[:, :, first:stop, first:stop]),
            dof=self.dof[first:stop],
        )

    def _fit(
        self, straight: Floats, slope: float, kinds: Booleans, misfit: float, *, triad: Floats, bounded: Booleans
    ) -> AxisFit:
        """Take out the kinds of noise that are not worth their place, the least one first.

        Kinds (4,) that are `bounded` get an upper bound even where they show.
        """
        found = self._solved(straight, kinds, misfit)
        while True:
            without = {i: self._solved(straight, found.without(i), misfit) for i in found.optional()}
            evidence = {i: one.unlikely - found.unlikely for i, one in without.items()}
            weakest = min(evidence, key=evidence.__getitem__, default=_WHITE)
            if evidence.get(weakest, np.inf) > _WORTH:
                break
            found = without[weakest]
        strong = [evidence.get(i, np.inf) > _SIGNIFICANT**2 for i in range(len(KINDS))]
        count = len(KINDS)
        theta = found.theta[:count]
        # What was left out may be there, up to its bound, and the others would then be other ones.
        sigma = found.sigma[:count]
        if (left_out := _SLOWEST & ~found.kinds[:count]).any():
            all_slow = found.kinds | np.append(left_out, np.zeros(len(COLUMNS) - count, dtype=bool))
            sigma = np.fmax(sigma, self._solved(straight, all_slow, misfit).sigma[:count])
        change, other_sigma = self._other_slopes(straight, found, misfit, triad)
        sigma = np.hypot(np.hypot(np.fmax(sigma, other_sigma), change), self._next(straight, found, misfit))
        # what noise of another slope could make as well was not found
        sure = found.kinds[:count] & (2 * theta > change) & np.array(strong) & ~bounded
        bound = np.array([np.nan if sure[i] else self._bound(straight, found, i, misfit) for i in range(count)])
        for i in np.flatnonzero(_SLOWEST & ~found.kinds[:count]).tolist():  # it may be there, and the others other ones
            held = np.where(np.arange(len(COLUMNS)) == i, bound[i] / 2, 0.0)
            other = self._solved(straight, found.kinds, misfit, held)
            sigma = np.hypot(sigma, (other.theta - found.theta)[:count])
        bound += 2 * change
        spread = float(np.sqrt(self.slope_variance[:count] @ np.where(sure, theta, bound)))
        return AxisFit(
            theta=np.where(sure, theta, 0.0),
            sigma=np.where(sure, sigma, np.nan),
            bound=bound,
            slope=slope,
            slope_sigma=spread,
            ramp=abs(slope) > _SIGNIFICANT * spread,
            misfit=misfit,
            fitted=found.theta,
            delay=2 * float(found.theta[_FILTER] / theta[_WHITE]) if theta[_WHITE] > 0 else 0.0,
            other_slope=float(change[_WHITE] / theta[_WHITE]) if theta[_WHITE] > 0 else 0.0,
        )

    def _other_slopes(self, straight: Floats, found: "_Found", misfit: float, triad: Floats) -> tuple[Floats, Floats]:
        """Return by how much noise of a slope between the kinds, where it explains more, changes theta (4,).

        Then the largest sigma (4,) with such noise.
        """
        change, sigma = np.zeros(len(KINDS)), np.zeros(len(KINDS))
        for column, gain in zip(_BETWEEN, triad.tolist(), strict=True):
            inside = bool(found.kinds[column])
            kinds = found.without(column) if inside else found.kinds | (np.arange(len(COLUMNS)) == column)
            other = self._solved(straight, kinds, misfit)
            if inside or max(found.unlikely - other.unlikely, gain) > _OTHER_SLOPE:
                change = np.maximum(change, np.abs(other.theta - found.theta)[: len(KINDS)])
                sigma = np.fmax(sigma, (found if inside else other).sigma[: len(KINDS)])
        return change, sigma

    def _next(self, straight: Floats, found: "_Found", misfit: float) -> Floats:
        """Return by how much theta (4,) changes if one averaging time more is left out for a filter's sake."""
        if not found.kinds[_FILTER] or len(straight) <= _FEWEST:
            return np.zeros(len(KINDS))
        other = self._part(1)._solved(straight[1:], found.kinds, misfit)
        return np.abs(other.theta - found.theta)[: len(KINDS)]

    def _solved(self, variance: Floats, kinds: Booleans, misfit: float, held: Floats | None = None) -> "_Found":
        """Return the estimate with some kinds of noise only, besides those whose theta is held."""
        design = self.straight[:, kinds]
        held = np.zeros(len(kinds)) if held is None else held
        theta, before = held.copy(), held.copy()
        others = self.straight @ held
        root = np.diag(variance * self.dof)
        for _ in range(_ROUNDS):
            weights = np.linalg.inv(root)
            theta[kinds] = solve_nonnegative(weights @ design, weights @ (variance - others), theta[kinds])
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
        """Return what theta of a kind is at most: the likelihood falls by so much there that 97 % of bounds hold."""
        held = np.zeros(len(found.kinds))
        step = np.diag(_inverse(found.weights @ self.straight[:, [kind]]))[0] ** 0.5

        def likely(theta: float) -> bool:
            held[kind] = theta
            return self._solved(variance, found.without(kind), misfit, held).unlikely < found.unlikely + _BOUND

        low, high = 0.0, float(found.theta[kind] + step)
        for _ in range(60):
            if not likely(high):
                break
            low, high = high, 2 * high
        for _ in range(6):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if likely(middle) else (low, middle)
        return high


def _with(*columns: int) -> Booleans:
    """Return the mask (7,) of all kinds of noise and of other columns."""
    return _ALL | np.isin(np.arange(len(COLUMNS)), columns)


@value_class
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
