"""What the steps of a converter do to means of resting samples.

A sensor reads x + noise, rounded to steps; here the step is 1 and x lies about half a step from a code at most. White
noise of more than half a step carries the mean over all parts of a step, and rounding errors cancel. A quieter sensor
shows one code for anything within a step, or flips between two of them: a share p of the upper one says
x = 1/2 + s inv(Phi)(p), where the noise s is known. It is known where a third code is seen, too, and otherwise anything
below where one would be: the mean p is off by 1/2 - p where there is hardly any noise, and by nothing at the most noise
there may be. A tremor, which is regular, dwells at its ends, and leaves an error also where it is larger than a step.
"""

from functools import cache

import numpy as np

from ...frozen import value_class
from ...recording import Floats, smallest_steps
from ...results.result import StaticIntervals

_COARSE = 0.3  # variance from sample to sample, in squared steps; that of white noise of 0.46 of a step
_REGULAR = 2.7  # fourth moment over squared variance: 3 for white noise, 1.5 for a tremor
_WIDE = 4.0  # variance of a tremor that leaves no error to speak of
_STRAY = 0.003  # share of samples that something else than noise put beside their code
_BESIDE = 4  # codes on each side that are looked at
_MOST = 100.0  # samples of an interval that count; more would need a finer table
_TOLD = 2000.0  # samples of all intervals that tell one kind of noise from another
_PART = 100  # intervals

_NOISE = np.linspace(0.0, 1.0, 401)  # in steps
_WAVE, _OF = np.nonzero(np.arange(1, 400)[:, None] * _NOISE < 1.0)  # beyond, a wave adds less than 1e-17
_TERMS = np.exp(-4 * (np.pi * (_WAVE + 1) * _NOISE[_OF]) ** 2) / (2 * (np.pi * (_WAVE + 1)) ** 2)
_OF_MEANS = np.bincount(_OF, _TERMS, len(_NOISE))
_SCATTER = _NOISE**2 + 1 / 12 - _OF_MEANS
"""Of rounded samples about their mean: what noise and rounding do together, less what the mean has of it."""


def rounding_variance(values: Floats, intervals: StaticIntervals, step: Floats | None = None) -> Floats:
    """Return the variance of each mean at rest that rounding makes, (n, 3) [unit^2], however long the rest is.

    It is D^2 / 12 for steps D where all samples of all rests read one code.

    Parameters
    ----------
    values : (m, 3) [unit]
    intervals : n static intervals
    step : (3,) of the values, 0 where they never change; found where it is not given
    """
    step = np.nan_to_num(smallest_steps(values)) if step is None else step
    inside = np.zeros(len(values), dtype=bool)
    for start, stop in zip(intervals.start, intervals.stop, strict=True):
        inside[start + 1 : stop] = True  # the difference to the sample before is one of this rest
    squares, count = np.square(np.diff(values, axis=0)), int(inside[1:].sum())
    scatter = 0.5 * (inside[1:].astype(np.float64) @ squares) / max(count, 1)
    with np.errstate(divide="ignore", invalid="ignore"):
        seen = np.where(step > 0, scatter / step**2, np.inf)
    variance = np.tile(step**2 * np.interp(seen, _SCATTER, _OF_MEANS), (len(intervals), 1))
    for axis in np.flatnonzero((seen < _WIDE) & (count > 0)):
        codes = np.rint((values[:, axis] - values[0, axis]) / step[axis])
        counts, spread, peak = _beside_their_mean(codes, intervals)
        if seen[axis] < _COARSE or (spread < _WIDE and peak < _REGULAR * spread**2):
            # Samples that follow each other say less than independent ones.
            counts *= min(seen[axis] / spread, 1.0) if spread > 0 else 1.0
            counts *= np.minimum(_MOST / np.maximum(counts.sum(axis=1, keepdims=True), 1.0), 1.0)
            variance[:, axis] = step[axis] ** 2 * _squared_error(counts)
    return np.asarray(variance, dtype=np.float64)


def _beside_their_mean(codes: Floats, intervals: StaticIntervals) -> tuple[Floats, float, float]:
    """Return how many samples of each interval read which code about their mean, (n, 9), and how all of them spread.

    The spread is the second and the fourth moment about each interval's mean.
    """
    counts = np.zeros((len(intervals), 2 * _BESIDE + 1))
    squares = fourths = samples = 0.0
    for k, (start, stop) in enumerate(zip(intervals.start, intervals.stop, strict=True)):
        own = codes[start:stop]
        mean = float(own.mean())
        near = (own - np.rint(mean)).astype(np.int64) + _BESIDE
        counts[k] = np.bincount(near[(near >= 0) & (near <= 2 * _BESIDE)], minlength=2 * _BESIDE + 1)
        off = np.square(own - mean)
        squares, fourths, samples = squares + float(off.sum()), fourths + float(off @ off), samples + len(own)
    return counts, squares / max(samples, 1.0), fourths / max(samples, 1.0)


@value_class
class _Codes:
    """What is seen with each kind of noise and each x.

    Attributes
    ----------
    logarithm : (9, kinds, x) of the share of the codes from -4 to 4
    squares : (kinds, x) of the error of a mean
    beforehand : (kinds,) logarithm of how likely a kind is; as often without a tremor as with one
    """

    logarithm: Floats
    squares: Floats
    beforehand: Floats


@cache
def _codes() -> _Codes:
    """Return the table for white noise of some sizes, each with a tremor (a sine) of some sizes."""
    from scipy.special import ndtr  # few recordings need it

    white = np.concatenate([np.geomspace(2e-3, 0.08, 8), np.linspace(0.1, 0.6, 21)])
    tremor = np.array([0.0, 0.3, 0.5, 0.7, 0.85, 1.0, 1.2, 1.5, 1.9, 2.4, 3.0])
    fine, most = 30, _BESIDE + 1.2  # points in a step
    y = np.arange(-round(most * fine), round(most * fine) + 1) / fine
    ends = np.append(y - 0.5 / fine, y[-1] + 0.5 / fine)
    of_sine = np.where(tremor[1:] > 0, 0.5 + np.arcsin(np.clip(ends[:, None] / tremor[1:], -1, 1)) / np.pi, 0.0)
    mass = np.column_stack([y == 0, np.diff(of_sine, axis=0)])  # (y, tremor)
    apart = np.arange(-2 * len(y), 2 * len(y) + 1) / fine
    index = np.subtract.outer(np.arange(len(y)), np.arange(len(y))) + 2 * len(y)
    below = np.stack([ndtr(apart / s)[index] @ mass for s in white]).transpose(1, 0, 2).reshape(len(y), -1)
    x = np.arange(-round(0.6 * fine), round(0.6 * fine) + 1)
    edges = (np.arange(-_BESIDE - 1, _BESIDE + 1) + 0.5) * fine
    at = np.rint(edges[:, None] - x + len(y) // 2).astype(np.int64)
    share = np.diff(below[at], axis=0).transpose(0, 2, 1)  # (code, kind, x)
    share /= share.sum(axis=0)
    mean = np.tensordot(np.arange(-_BESIDE, _BESIDE + 1), share, 1)
    return _Codes(
        logarithm=np.log((1 - _STRAY) * share + _STRAY / len(share)),
        squares=np.square(mean - x / fine),
        beforehand=np.tile(np.log(np.where(tremor > 0, 0.5 / (len(tremor) - 1), 0.5)), len(white)),
    )


def _squared_error(counts: Floats) -> Floats:
    """Return the expected square of each mean's error, (n,) [step^2], whatever the size of the noise and x may be.

    Parameters
    ----------
    counts : (n, 9) of codes; the noise is the same in all intervals, x may be another in each
    """
    codes = _codes()
    best, mean, squares = (np.empty((len(counts), len(codes.squares))) for _ in range(3))
    for first in range(0, len(counts), _PART):
        part = slice(first, first + _PART)
        exponent = np.tensordot(counts[part], codes.logarithm, 1)
        best[part] = exponent.max(axis=2)
        weight = np.exp(exponent - best[part][..., None])
        mean[part] = best[part] + np.log(weight.mean(axis=2))
        squares[part] = np.sum(weight * codes.squares, axis=2) / weight.sum(axis=2)

    # Noise is of none of these kinds exactly, and many samples shall not choose one as if it were.
    trusted = min(_TOLD / max(float(counts.sum()), 1.0), 1.0)

    def averaged(likelihood: Floats) -> Floats:
        of_kind = trusted * likelihood.sum(axis=0) + codes.beforehand
        of_kind = np.exp(of_kind - of_kind.max())
        return squares @ of_kind / of_kind.sum()

    # Where x is the same in all intervals, as a bias is, that all flip is no coincidence; where it is not, it is one.
    return np.maximum(averaged(best), averaged(mean))
