"""A recording in which the accelerometer reads gravity several times as large from one instant on.

Its full-scale range was set anew (a brown-out sets it back), its unit was changed, or another sensor's samples follow.
No bias or scale of a working sensor does that. The rests of one side only can be calibrated together.

Samples at the end of the sensor's range, which say "at least this much" and no more.
"""

import numpy as np
from numpy.typing import NDArray

from ...frozen import value_class
from ...recording import Floats, TriadSamples, kept_with_array
from ...results.result import StaticIntervals

_FACTOR = 1.25  # from which on it is no error of a sensor; ranges differ by two
_ALIKE = 0.25  # of a side's median: scales of raw counts differ by that from axis to axis
_FEW = 0.1  # of a side's rests that may read anything
_FEWEST = 2  # rests on either side


@value_class
class RangeChange:
    """Where the accelerometer began to read gravity as another number.

    Attributes
    ----------
    last, first : last sample of the last rest before it, and first sample of the first rest after it
    factor : what is read after it, over what was read before
    kept : samples of the side that is calibrated, from its first to one past its last
    """

    last: int
    first: int
    factor: float
    kept: tuple[int, int]


def find_range_change(
    read: Floats, parts: StaticIntervals, samples: int, gravity: float | None = None, enough: int = 0
) -> RangeChange | None:
    """Return the one instant from which on gravity is read as another number; None where all read about the same.

    The side that reads gravity is kept where it has enough rests, else the one with more of them.

    Parameters
    ----------
    read : (m,) magnitude of gravity as each part read it [unit]
    parts : (m,) rests in order of time, found whatever their noise, or stretches of a motion
    samples : number of samples of the recording
    gravity : in that unit; None for counts
    enough : number of rests that determine a calibration
    """
    if len(read) < 2 * _FEWEST or not (read > 0).all():
        return None
    logs = np.log(read)
    away = np.cumsum(logs - logs.mean())[_FEWEST - 1 : -_FEWEST]
    k = int(np.argmax(np.abs(away))) + _FEWEST
    before, after = float(np.median(read[:k])), float(np.median(read[k:]))
    sides = (read[:k], before), (read[k:], after)
    alike = all(float(np.mean(np.abs(side / middle - 1) > _ALIKE)) <= _FEW for side, middle in sides)
    low, high = (side for side, _ in sorted(sides, key=lambda side: side[1]))
    apart = np.quantile(low, 1 - _FEW) < np.quantile(high, _FEW)
    if not (alike and apart) or max(before, after) < _FACTOR * min(before, after):
        return None
    last, first = int(parts.stop[k - 1]) - 1, int(parts.start[k])
    middle = (last + first + 1) // 2
    counts = (k, len(read) - k)
    errors = [abs(np.log(one / gravity)) if gravity else 0.0 for one in (before, after)]
    best = min((0, 1), key=lambda side: (counts[side] < enough, errors[side] > np.log(_FACTOR), -counts[side]))
    return RangeChange(
        last=last, first=first, factor=after / before, kept=(0, middle) if best == 0 else (middle, samples)
    )


Booleans = NDArray[np.bool_]

_LIMITS = (32767.0, -32768.0, -32767.0, 65535.0, 8388607.0, -8388608.0)
"""Ends of the range of 16 and 24 bit converters; reaching one exactly is no coincidence."""

_FAR = 10.0  # noise levels between the median and an extreme that a resting sensor never shows
_BAND = 3.0  # noise levels below the extreme in which the ordinary samples are counted
_NOISE_SAMPLES = 10_000
_ENOUGH, _DISTINCT, _TIES = 20, 0.95, 5


def saturated_samples(samples: TriadSamples, full_scale: float | None = None) -> Booleans:
    """Mark the samples of which an axis is clipped, (n,).

    A signal that is cut off stands on its extreme value again and again while it hardly ever visits the values just
    below: the extreme must come in runs, more often than twice the ordinary samples in a band of three noise levels
    below it, and lie far from what the sensor shows at rest. Noise, coarse quantisation and the rounded top of a slow
    motion fail one of the three. In a signal whose values never repeat, the second is not asked for. The end of the
    range of a 16 or 24 bit converter needs no further evidence.

    Parameters
    ----------
    samples : in counts or any unit
    full_scale : end of the range where it is known [unit of the samples]; samples at or beyond +- this are marked, too
    """
    if full_scale is None or len(samples) < 4:
        return _flat_tops(samples.values)
    return _flat_tops(samples.values) | (np.abs(samples.values) >= full_scale * (1 - 1e-9)).any(axis=1)


@kept_with_array
def _flat_tops(samples: Floats) -> Booleans:
    marked = np.zeros(len(samples), bool)
    for values in np.ascontiguousarray(samples.T) if len(samples) >= 4 else ():
        noise, median = _noise_and_median(values)
        for extreme in (values.max(), values.min()):
            near = float(abs(extreme - median))
            if near > _FAR * noise and _is_flat_top(values, float(extreme), noise):
                marked |= values == extreme
    marked.flags.writeable = False
    return marked


def _noise_and_median(values: Floats) -> tuple[float, float]:
    """Return the level of sample-to-sample changes, at least one quantum, and the median; of part of a long signal."""
    stride = max(1, len(values) // _NOISE_SAMPLES)
    steps = np.abs(values[1::stride] - values[:-1:stride])
    noise = float(np.median(steps))
    if noise == 0:
        moving = steps[steps > 0]
        noise = float(moving.min()) if moving.size else 0.0
    return noise, float(np.median(values[::stride]))


def _is_flat_top(values: Floats, extreme: float, noise: float) -> bool:
    at = values == extreme
    count = int(np.count_nonzero(at))
    if extreme in _LIMITS or (extreme == 0 and bool((values == 65535).any())):
        return True
    if count < 3 or not bool((at[1:] & at[:-1]).any()):
        return False
    below = values[(np.abs(values - extreme) <= _BAND * noise) & ~at]
    # Where no other value occurs twice, as in floating point numbers in motion, repeated extremes are no chance.
    fine = len(below) >= _ENOUGH and len(np.unique(below)) > _DISTINCT * len(below)
    return count > 2 * len(below) or (fine and count >= _TIES)
