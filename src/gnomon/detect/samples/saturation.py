"""Samples at the end of the sensor's range, which say "at least this much" and no more."""

import numpy as np
from numpy.typing import NDArray

from ...recording import Floats, TriadSamples

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
    marked = np.zeros(len(samples), bool)
    if len(samples) < 4:
        return marked
    for axis in range(3):
        values = samples.values[:, axis]
        noise, median = _noise_and_median(values)
        for extreme in (values.max(), values.min()):
            near = float(abs(extreme - median))
            if near > _FAR * noise and _is_flat_top(values, float(extreme), noise):
                marked |= values == extreme
        if full_scale is not None:
            marked |= np.abs(values) >= full_scale * (1 - 1e-9)
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
