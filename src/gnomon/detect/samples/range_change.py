"""A recording in which the accelerometer reads gravity several times as large from one instant on.

Its full-scale range was set anew (a brown-out sets it back), its unit was changed, or another sensor's samples follow.
No bias or scale of a working sensor does that. The rests of one side only can be calibrated together.
"""

import numpy as np

from ...frozen import value_class
from ...recording import Floats
from ...results.intervals import StaticIntervals

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
