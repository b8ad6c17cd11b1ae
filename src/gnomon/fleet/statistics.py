"""What many results tell together, each weighed by its own sigma: mean and spread, limits, charts, stations.

Values are y_i with standard deviations s_i; devices differ among each other by a spread tau, so that the variance of
y_i about the mean is tau^2 + s_i^2 (random effects, DerSimonian and Laird 1986).
"""

from collections.abc import Sequence
from math import erfc, sqrt
from statistics import NormalDist
from typing import Any

import numpy as np

from ..errors import OptionError
from ..frozen import value_class
from ..recording import Floats, Integers
from .entries import LibraryEntry

Booleans = np.ndarray[Any, np.dtype[np.bool_]]
_ROUNDS = 20
_MAD = 1.4826  # of a normal distribution, standard deviation over median absolute deviation


@value_class
class Population:
    """Mean and spread of a quantity over devices.

    Attributes
    ----------
    mean, mean_sigma : of all devices, and its standard deviation
    spread : standard deviation between devices, own sigmas taken off
    heterogeneity : Q, the weighted sum of squares about the fixed-effect mean
    count : results that were used
    z : (n,) of each result against the others' mean and spread; nan where it has no value
    kept : (n,) those that were used: all but outliers and nan
    """

    mean: float
    mean_sigma: float
    spread: float
    heterogeneity: float
    count: int
    z: Floats
    kept: Booleans


def _moments(values: Floats, variances: Floats) -> tuple[float, float, float, float]:
    """Return mean, its sigma, tau^2 and Q, by the moments of DerSimonian and Laird (1986).

    With w = 1 / s^2: Q = sum w (y - y_w)^2, C = sum w - sum w^2 / sum w, tau^2 = max(0, (Q - (n - 1)) / C).
    """
    w = 1 / variances
    whole = float(w.sum())
    off = values - float(w @ values) / whole
    q, c = float((w * off) @ off), whole - float(w @ w) / whole
    tau2 = max(0.0, (q - (len(values) - 1)) / c) if c > 0 else 0.0
    if tau2:
        w = 1 / (tau2 + variances)
        whole = float(w.sum())
    return float(w @ values) / whole, whole**-0.5, tau2, q


def robust_population(values: Floats, sigmas: Floats, limit: float) -> Population:
    """Return mean and spread of the values (n,) within `limit` standard deviations, those beyond left out.

    It starts at the median and the median absolute deviation, and goes on until the same values are kept.
    """
    known = np.isfinite(values) & np.isfinite(sigmas)
    z = np.full(len(values), np.nan)
    if not known.any():
        return Population(mean=np.nan, mean_sigma=np.nan, spread=np.nan, heterogeneity=np.nan, count=0, z=z, kept=known)
    y, variances = values[known], sigmas[known] ** 2
    centre = float(np.median(y))
    spread2 = max((_MAD * float(np.median(np.abs(y - centre)))) ** 2 - float(np.median(variances)), 0.0)
    inside = (y - centre) ** 2 <= limit**2 * (spread2 + variances)
    rounds = _ROUNDS
    while True:
        if not inside.any():
            inside[:] = True
        whole = bool(inside.all())
        centre, mean_sigma, spread2, q = _moments(*((y, variances) if whole else (y[inside], variances[inside])))
        used, off, width = inside, y - centre, spread2 + variances
        inside = off**2 <= limit**2 * width
        rounds -= 1
        if not rounds or (inside == used).all():
            break
    z[known] = off / np.sqrt(width)
    kept = known.copy()
    kept[known] = used
    return Population(
        mean=centre,
        mean_sigma=mean_sigma,
        spread=sqrt(spread2),
        heterogeneity=q,
        count=int(np.count_nonzero(used)),
        z=z,
        kept=kept,
    )


# ---- capability and yield ----


@value_class(eq=True)
class Capability:
    """Process capability: cp is nan with one limit, yield_expected is that of a normal distribution."""

    cp: float
    cpk: float
    yield_expected: float


def process_capability(mean: float, sigma: float, *, lower: float = -np.inf, upper: float = np.inf) -> Capability:
    """Return Cp = (U - L) / 6 sigma and Cpk = min(U - mean, mean - L) / 3 sigma (Montgomery, 8.2 and 8.8).

    Raises
    ------
    OptionError
        If sigma is not above zero, or the limits are in the wrong order.
    """
    if not (sigma > 0 and lower < upper):
        raise OptionError(f"capability: sigma {sigma} must be above zero, and {lower} below {upper}.")
    below, above = (mean - lower) / sigma, (upper - mean) / sigma
    cp = (upper - lower) / (6 * sigma) if np.isfinite(upper - lower) else float("nan")
    inside = 1 - 0.5 * erfc(below / sqrt(2)) - 0.5 * erfc(above / sqrt(2))
    return Capability(cp=cp, cpk=min(below, above) / 3, yield_expected=inside)


def wilson_interval(good: int, count: int, z: float = 1.959963984540054) -> tuple[float, float]:
    """Return the interval of a share at 95 % (Wilson 1927)."""
    if count == 0:
        return 0.0, 1.0
    p, n = good / count, count
    middle = (p + z * z / (2 * n)) / (1 + z * z / n)
    half = z / (1 + z * z / n) * sqrt(p * (1 - p) / n + z * z / (4 * n * n))
    return max(middle - half, 0.0), min(middle + half, 1.0)


# ---- charts ----


@value_class
class ControlChart:
    """Points in their order, centre and limits; all (n,)."""

    points: Floats
    centre: Floats
    lower: Floats
    upper: Floats

    @property
    def signals(self) -> list[int]:
        """Indices of the points beyond the limits."""
        return np.flatnonzero((self.points < self.lower) | (self.points > self.upper)).tolist()


def individuals_chart(values: Floats, centre: float | None = None, *, usual: Booleans | None = None) -> ControlChart:
    """Return the chart of individuals: mean +- 2.66 times the mean moving range, 3 / d2 with d2 = 2 / sqrt(pi).

    The published 1.128 is d2 to four digits (Montgomery, 6.33). Only `usual` values (n,) count for centre and range.
    """
    counted = values if usual is None else values[usual]
    middle = float(np.mean(counted)) if centre is None else centre
    reach = 3 * float(np.abs(np.diff(counted)).mean()) / (2 / sqrt(np.pi)) if len(counted) > 1 else np.inf
    flat = np.full(len(values), middle)
    return ControlChart(points=values, centre=flat, lower=flat - reach, upper=flat + reach)


def ewma_chart(
    values: Floats, sigmas: Floats | float, centre: float, *, weight: float = 0.2, width: float = 3.0
) -> ControlChart:
    """Return the exponentially weighted moving average of values (n,), which starts at the centre.

    z_i = weight y_i + (1 - weight) z_(i-1); its variance follows with each value's own, sigmas^2. With equal ones it is
    sigma^2 weight / (2 - weight) (1 - (1 - weight)^(2 i)) (Montgomery, 9.25).
    """
    squares = np.broadcast_to(np.asarray(sigmas, dtype=float) ** 2, values.shape)
    points, variance = np.empty(len(values)), np.empty(len(values))
    z, v = centre, 0.0
    for i, (y, s2) in enumerate(zip(values.tolist(), squares.tolist(), strict=True)):
        z = weight * y + (1 - weight) * z
        v = weight**2 * s2 + (1 - weight) ** 2 * v
        points[i], variance[i] = z, v
    flat, reach = np.full(len(values), centre), width * np.sqrt(variance)
    return ControlChart(points=points, centre=flat, lower=flat - reach, upper=flat + reach)


# ---- stations ----


@value_class(eq=True)
class GaugeStudy:
    """Gauge repeatability and reproducibility: variances of the AIAG's analysis of variance.

    Attributes
    ----------
    repeatability, reproducibility, interaction, part : variances
    share : standard deviation of the gauge over that of all, the %GRR as a fraction
    categories : distinct categories, 1.41 part / gauge
    """

    repeatability: float
    reproducibility: float
    interaction: float
    part: float

    @property
    def gauge(self) -> float:
        """Variance of the gauge."""
        return self.repeatability + self.reproducibility + self.interaction

    @property
    def share(self) -> float:
        """Standard deviation of the gauge over that of all measurements."""
        return sqrt(self.gauge / (self.gauge + self.part))


def gauge_study(table: Floats, pooling: float = 0.25) -> GaugeStudy:
    """Return the variances of measurements (parts, stations, repetitions) by analysis of variance with random effects.

    The interaction is pooled with the repeatability where its F test has p > `pooling` (AIAG, Measurement Systems
    Analysis, 4th edition, appendix A). Negative variances are zero.
    """
    from scipy.special import fdtrc

    p, o, r = table.shape
    mean = table.mean()
    parts, stations, cells = table.mean((1, 2)), table.mean((0, 2)), table.mean(2)
    ms_part = o * r * ((parts - mean) ** 2).sum() / (p - 1)
    ms_station = p * r * ((stations - mean) ** 2).sum() / (o - 1)
    ss_cross = r * ((cells - parts[:, None] - stations + mean) ** 2).sum()
    ss_error = ((table - cells[:, :, None]) ** 2).sum()
    df_cross, df_error = (p - 1) * (o - 1), p * o * (r - 1)
    ms_cross, ms_error = ss_cross / df_cross, ss_error / df_error
    interaction = 0.0
    if ms_error > 0 and fdtrc(df_cross, df_error, ms_cross / ms_error) > pooling:
        ms_cross = ms_error = (ss_cross + ss_error) / (df_cross + df_error)
    else:
        interaction = max((ms_cross - ms_error) / r, 0.0)
    return GaugeStudy(
        repeatability=float(ms_error),
        reproducibility=float(max((ms_station - ms_cross) / (p * r), 0.0)),
        interaction=float(interaction),
        part=float(max((ms_part - ms_cross) / (o * r), 0.0)),
    )


@value_class(eq=True)
class GroupOffset:
    """How far a group is from the others, which share no result with it."""

    group: str
    offset: float
    sigma: float
    count: int

    @property
    def z(self) -> float:
        """The offset over its standard deviation."""
        return self.offset / self.sigma


def group_offsets(values: Floats, variances: Floats, number: Integers, groups: Sequence[str]) -> list[GroupOffset]:
    """Return how far each group's weighted mean is from that of all others; nan is left out.

    Variances (n,) are known, number (n,) is that of the group.
    """
    known = np.isfinite(values) & np.isfinite(variances)
    w, of = 1 / variances[known], number[known]
    weight, pull = (np.bincount(of, weights=one, minlength=len(groups)) for one in (w, w * values[known]))
    count, others = np.bincount(of, minlength=len(groups)), weight.sum() - weight
    return [
        GroupOffset(
            group=group,
            offset=float(pull[k] / weight[k] - (pull.sum() - pull[k]) / others[k]),
            sigma=sqrt(1 / weight[k] + 1 / others[k]),
            count=int(count[k]),
        )
        for k, group in enumerate(groups)
        if 0 < count[k] < len(w)
    ]


# ---- changes in time ----


@value_class(eq=True)
class TimeChange:
    """A step or a drift of a series: z, where it began (index), and its size over the whole series."""

    kind: str
    z: float
    at: int
    size: float


def time_changes(values: Floats, variances: Floats, days: Floats) -> list[TimeChange]:
    """Return the best step and the best straight drift of a series (n,) in its order; nan is left out.

    The step is the largest |difference of the weighted means before and after| over its standard deviation; the drift
    is the weighted regression on the days, where they differ.
    """
    index = np.flatnonzero(np.isfinite(values) & np.isfinite(variances))
    y, w, t = values[index], 1 / variances[index], days[index]
    if len(y) < 8:
        return []
    cut_w, cut_wy = np.cumsum(w)[:-1], np.cumsum(w * y)[:-1]
    after_w, after_wy = w.sum() - cut_w, (w * y).sum() - cut_wy
    size = after_wy / after_w - cut_wy / cut_w
    z = size / np.sqrt(1 / cut_w + 1 / after_w)
    best = int(np.argmax(np.abs(z)))
    found = [TimeChange(kind="step", z=float(z[best]), at=int(index[best + 1]), size=float(size[best]))]
    centred = t - w @ t / w.sum()
    information = float(w @ centred**2)
    if t.max() > t.min():
        slope = float(w @ (centred * y)) / information
        drift = slope * sqrt(information)
        found.append(TimeChange(kind="drift", z=drift, at=int(index[0]), size=slope * float(t.max() - t.min())))
    return found


@value_class(eq=True)
class ScalarChange:
    """A scalar of a device that changed: size [unit], and z by the sigmas of both results."""

    name: str
    unit: str
    size: float
    z: float


def largest_change(before: LibraryEntry, after: LibraryEntry) -> ScalarChange | None:
    """Return which scalar changed most between two results of a device; None where they share none."""
    if before.names != after.names:
        return None
    variance = before.sigmas**2 + after.sigmas**2
    known = (before.sigmas > 0) & (after.sigmas > 0)
    if not known.any():
        return None
    z = np.where(known, (after.values - before.values) / np.sqrt(np.where(known, variance, 1.0)), 0.0)
    k = int(np.argmax(np.abs(z)))
    size = float(after.values[k] - before.values[k])
    return ScalarChange(name=after.names[k], unit=after.units[k], size=size, z=float(z[k]))


def normal_limit(chance: float) -> float:
    """Return z that a standard normal number exceeds in absolute value with this chance."""
    return -NormalDist().inv_cdf(chance / 2)
