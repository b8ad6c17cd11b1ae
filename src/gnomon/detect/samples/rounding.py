"""What the steps of a converter do to means of resting samples."""

import numpy as np

from ...intervals import StaticIntervals
from ...recording import Floats

_SAMPLES = 65_536

_NOISE = np.linspace(0.0, 1.0, 401)  # in steps
_WAVES = np.arange(1, 400)[:, None]
_OF_MEANS = np.sum(np.exp(-4 * (np.pi * _WAVES * _NOISE) ** 2) / _WAVES**2, axis=0) / (2 * np.pi**2)
_SCATTER = _NOISE**2 + 1 / 12 - _OF_MEANS
"""Of rounded samples about their mean: what noise and rounding do together, less what the mean has of it."""


def smallest_steps(values: Floats) -> Floats:
    """Return the smallest change of each axis from sample to sample, (3,); nan where it never changes."""
    steps = np.abs(np.diff(values[:_SAMPLES], axis=0))
    return np.array([axis[axis > 0].min(initial=np.inf) if axis.any() else np.nan for axis in steps.T])


def rounding_variance(values: Floats, intervals: StaticIntervals) -> Floats:
    """Return the variance of a mean at rest that rounding alone makes, (3,) [unit^2], however long the rest is.

    Noise of more than a step carries the mean over all parts of a step, and rounding errors cancel. A sensor that is
    quieter shows one number, or two, for anything within a step: with steps D and noise s the error of the mean has the
    variance D^2 / (2 pi^2) sum_k exp(-4 pi^2 k^2 s^2 / D^2) / k^2, which is D^2 / 12 without noise. The samples scatter
    about their mean by s^2 + D^2 / 12 less this, by which s is found.

    Parameters
    ----------
    values : (n, 3) [unit]
    intervals : static intervals
    """
    step = np.nan_to_num(smallest_steps(values))
    inside = np.zeros(len(values), dtype=bool)
    for start, stop in zip(intervals.start, intervals.stop, strict=True):
        inside[start + 1 : stop] = True  # the difference to the sample before is one of this rest
    changes = np.diff(values, axis=0)[inside[1:]]
    scatter = 0.5 * np.mean(changes**2, axis=0) if len(changes) else np.zeros(3)
    with np.errstate(divide="ignore", invalid="ignore"):
        seen = np.where(step > 0, scatter / step**2, np.inf)
    return np.asarray(step**2 * np.interp(seen, _SCATTER, _OF_MEANS), dtype=np.float64)
