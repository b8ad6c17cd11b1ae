"""The course of an IMU's temperature: a thermometer's steps smoothed away, its lag undone."""

import numpy as np
from numpy.typing import NDArray

from ..frozen import value_class
from .samples import Floats, Integers, TemperatureSamples, frozen_array, smallest_steps

Booleans = NDArray[np.bool_]

_BINS, _SHORTEST_S = 150, 1.0
_ORDER = 3
_PENALTIES = np.geomspace(1e-6, 1e9, 16)
_TIE = 1e-9
_ROUNDED, _EXACT = 1.0, 0.05
"""Sigma of a bin's reading that the steps round, which its neighbours share, and of where a reading changes [steps]."""


@value_class
class TemperatureCourse:
    """Temperature of a chip over time.

    Attributes
    ----------
    t_s : (n,) evenly spaced, from `origin_ns` on [s]
    degc : (n,) smoothed readings [degC]
    step_k : smallest step of the readings, nan where they never change [K]
    origin_ns : of the recording's clock [ns]
    """

    t_s: Floats
    degc: Floats
    step_k: float
    origin_ns: int

    def __post_init__(self) -> None:
        object.__setattr__(self, "t_s", frozen_array(self.t_s))
        object.__setattr__(self, "degc", frozen_array(self.degc))

    def at(self, t_ns: Integers) -> Floats:
        """Return the temperature (k,) at timestamps (k,) [degC]; the first and the last hold outside."""
        return np.interp((t_ns - self.origin_ns) * 1e-9, self.t_s, self.degc)

    def with_rate(self, t_ns: Integers) -> Floats:
        """Return the temperature [degC] at timestamps (k,), and how fast it rises [K/s], (k, 2)."""
        slopes = np.gradient(self.degc, self.t_s)
        rate = np.interp((t_ns - self.origin_ns) * 1e-9, self.t_s, slopes)
        return np.column_stack([self.at(t_ns), rate])


def temperature_course(samples: TemperatureSamples, lag_s: float = 0.0) -> TemperatureCourse | None:
    """Return the course of the temperature; None for counts, and for fewer than two readings that are numbers.

    Where a reading changes, the temperature is between both values: that tells it far better than a thermometer's
    steps, and is its mean where noise makes the readings dance. The course is the smooth one through these points
    by penalised third differences (Whittaker, On a new method of graduation, 1923), as smooth as is likeliest
    (restricted likelihood; Wahba, Annals of Statistics 1985); between them it stays near the reading.

    Parameters
    ----------
    lag_s : by which the thermometer follows the sensor: it reads x with lag_s dx/dt = T - x [s]
    """
    read = known_readings(samples)
    if read is None:
        return None
    t_ns, celsius = read
    origin = int(t_ns[0])
    seconds = np.asarray((t_ns - origin) * 1e-9, dtype=np.float64)
    bins = int(np.clip(min(seconds[-1] / _SHORTEST_S, len(seconds)), 3, _BINS))
    width = float(seconds[-1]) / bins
    step = float(smallest_steps(celsius[:, None])[0])
    change = np.flatnonzero(np.diff(celsius))
    middles = [np.asarray((one[change] + one[change + 1]) / 2, dtype=np.float64) for one in (seconds, celsius)]
    between = _binned(middles[0], middles[1], width)
    reading = _binned(seconds, celsius, width)
    middle = np.asarray((np.arange(bins) + 0.5) * width, dtype=np.float64)
    if bins <= _ORDER + 1 or not len(change):
        plain = np.interp(middle, reading.t_s, reading.mean)
        return TemperatureCourse(t_s=middle, degc=plain, step_k=step, origin_ns=origin)
    alone = ~np.isin(reading.bin, between.bin)
    count = int(np.count_nonzero(alone))
    exact = np.concatenate([np.ones(len(between.bin), dtype=bool), np.zeros(count, dtype=bool)])
    unit = float(np.nan_to_num(step, nan=1.0))
    smooth = _graduated(
        np.clip(np.concatenate([between.t_s, reading.t_s[alone]]) / width - 0.5, 0, bins - 1),
        np.concatenate([between.mean, reading.mean[alone]]),
        np.concatenate([np.hypot(between.sigma, _EXACT * unit), np.full(count, _ROUNDED * unit)]),
        exact,
        n=bins,
        lag=lag_s / width,
    )
    return TemperatureCourse(t_s=middle, degc=smooth, step_k=step, origin_ns=origin)


def known_readings(samples: TemperatureSamples) -> tuple[Integers, Floats] | None:
    """Return the timestamps (n,) [ns] and temperatures (n,) [degC] of the readings that are numbers.

    None for counts, and for fewer than two readings at different times.
    """
    celsius = samples.celsius()
    if celsius is None:
        return None
    known = np.isfinite(celsius)
    t_ns, celsius = samples.t_ns[known], celsius[known]
    return (t_ns, celsius) if len(t_ns) > 1 and t_ns[-1] > t_ns[0] else None


@value_class
class _Binned:
    """Values in bins: the bins with any, and of each the mean time [s], mean and its sigma [degC].

    The sigmas are those of one noise in all bins, the trend in each left out: a bin of two points tells none.
    """

    bin: Integers
    t_s: Floats
    mean: Floats
    sigma: Floats


def _binned(t_s: Floats, values: Floats, width_s: float) -> _Binned:
    bins, of, count = np.unique((t_s / width_s).astype(np.int64), return_inverse=True, return_counts=True)

    def mean(numbers: Floats) -> Floats:
        return np.asarray(np.bincount(of, numbers, minlength=len(bins)) / count, dtype=np.float64)

    when, middle = mean(t_s), mean(values)
    t, v = t_s - when[of], values - middle[of]
    spread = mean(t * t)
    trend = mean(t * v) / np.maximum(spread, 1e-12)
    squares = float(np.sum(count * np.maximum(mean(v * v) - trend**2 * spread, 0.0)))
    variance = squares / max(int(np.maximum(count - 2, 0).sum()), 1)
    return _Binned(bin=bins, t_s=when, mean=middle, sigma=np.sqrt(variance / count))


def _graduated(place: Floats, value: Floats, sigma: Floats, exact: Booleans, *, n: int, lag: float) -> Floats:
    """Return the smoothest course (n,) whose readings pass points at places 0 to n - 1 within their sigmas.

    Parameters
    ----------
    exact : (m,) of the points, those whose errors differ from each other
    lag : of the readings [bins]
    """
    from scipy.linalg import cho_factor, cho_solve

    left = np.minimum(place.astype(np.int64), n - 2)
    right = (place - left)[:, None]
    weight = 1 / np.maximum(sigma, 1e-9)
    read = _lagging(n, lag)
    rows = weight[:, None] * ((1 - right) * read[left] + right * read[left + 1])
    wanted = weight * value
    rough = np.diff(np.eye(n), _ORDER, axis=0)
    rough = np.pad(rough.T @ rough, (0, rows.shape[1] - n))
    normal, target = rows.T @ rows, rows.T @ wanted
    exact = exact | (not exact.any())
    scale = float(np.trace(normal)) / n

    def course(penalty: float) -> tuple[Floats, float]:
        """Return the course, and minus twice its restricted log likelihood, the size of the sigmas left open."""
        factor = cho_factor(normal + scale * (penalty * rough + _TIE * np.eye(len(normal))), lower=True)
        found = np.asarray(cho_solve(factor, target))
        off = float(np.sum((rows @ found - wanted)[exact] ** 2)) + scale * penalty * float(found @ rough @ found)
        volume = 2 * float(np.log(np.diag(factor[0])).sum()) - (n - _ORDER) * float(np.log(penalty))
        return found[:n], np.count_nonzero(exact) * float(np.log(max(off, 1e-300))) + volume

    return min((course(penalty) for penalty in _PENALTIES), key=lambda one: one[1])[0]


def _lagging(n: int, lag: float) -> Floats:
    """Return what makes readings (n,) of temperatures (n,), and of how far the first reading lies off where it lags.

    x' = (u - x) / lag is solved exactly for a course u that is straight from bin to bin.
    """
    if lag <= 0:
        return np.eye(n)
    decay = np.exp(-1 / lag)
    later = 1 - lag * (1 - decay)
    earlier = 1 - decay - later
    rows = np.zeros((n, n + 1))
    rows[0, 0] = rows[0, n] = 1.0
    for k in range(1, n):
        rows[k] = decay * rows[k - 1]
        rows[k, k - 1] += earlier
        rows[k, k] += later
    return rows
