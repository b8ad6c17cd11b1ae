"""Segments of a recording between which a bias stepped, and the exponential of a sensor that warms up.

A segment is a run of static intervals with a bias of its own: before and after a power cycle, of one of several
recordings that were joined. The bias of segment j is b + c_j, where one segment, as a rule the last, has c = 0, so that
b is the bias of that segment; or none has, and b is the mean of a population of which each c_j is a sample.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ...recording import Floats, Integers
from .drift import mean_at_rest
from .model import BiasFunctions, MultiPositionData

_WEAK_ACCELEROMETER, _WEAK_GYROSCOPE = 0.3, 1.0
"""Sigma of a step beforehand, scaled units: as of the biases themselves."""


def with_bias_segments(
    data: MultiPositionData,
    *,
    gyroscope: Integers | None = None,
    accelerometer: Integers | None = None,
    reference: int | None = -1,
    gyroscope_sigma: Floats | None = None,
    accelerometer_sigma: Floats | None = None,
) -> MultiPositionData:
    """Return the data with a bias of its own in each segment; rotations from one segment to another are unlinked.

    Parameters
    ----------
    data : of n static intervals
    gyroscope, accelerometer : (n,) number of the segment of each static interval, from 0; None where the bias is one
    reference : the segment whose bias is the bias of the model; -1 for the last; None where each differs from it
    gyroscope_sigma, accelerometer_sigma : (3,) standard deviation of a segment's difference beforehand, scaled units;
        None where next to nothing is known of it
    """
    linked = data.linked.copy()
    for segment in (gyroscope, accelerometer):
        if segment is not None:
            linked &= segment[1:] == segment[:-1]
    data = replace(data, linked=linked)
    if gyroscope is not None:
        steps = _steps(gyroscope, reference, gyroscope_sigma, _WEAK_GYROSCOPE)
        data = replace(data, gyroscope_functions=data.of_gyroscope.beside(steps))
    if accelerometer is not None:
        steps = _steps(accelerometer, reference, accelerometer_sigma, _WEAK_ACCELEROMETER)
        data = replace(data, accelerometer_functions=data.of_accelerometer.beside(steps))
    return data


def _steps(segment: Integers, reference: int | None, sigma: Floats | None, weak: float) -> BiasFunctions:
    numbers = np.unique(segment)
    others = numbers if reference is None else np.delete(numbers, reference)
    at_rest = (segment[:, None] == others).astype(np.float64)
    return BiasFunctions(
        at_rest=at_rest,
        in_motion=at_rest[:-1],  # a rotation that leaves the segment is not used
        kind=("step",) * len(others),
        sigma=np.broadcast_to(weak if sigma is None else sigma, (len(others), 3)).astype(np.float64),
    )


def without_rates(data: MultiPositionData, intervals: Sequence[int]) -> MultiPositionData:
    """Return the data with a free rate in some static intervals: their means say nothing of the gyroscope's bias."""
    if not len(intervals):
        return data
    at_rest = np.eye(len(data.interval_s))[:, list(intervals)]
    free = BiasFunctions(
        at_rest=at_rest,
        in_motion=np.zeros((len(data.rotation_s), len(intervals))),
        kind=("single",) * len(intervals),
        sigma=np.full((len(intervals), 3), _WEAK_GYROSCOPE),
    )
    return replace(data, gyroscope_functions=data.of_gyroscope.beside(free))


def with_warm_up(
    data: MultiPositionData, *, gyroscope_s: float = 0.0, accelerometer_s: float = 0.0
) -> MultiPositionData:
    """Return the data with an exponential in time, of mean zero over the recording, in the biases.

    Parameters
    ----------
    gyroscope_s, accelerometer_s : time constants [s]; 0 where a bias does not follow one
    """
    if gyroscope_s:
        function = _exponential(data, gyroscope_s, _WEAK_GYROSCOPE)
        data = replace(data, gyroscope_functions=data.of_gyroscope.beside(function))
    if accelerometer_s:
        function = _exponential(data, accelerometer_s, _WEAK_ACCELEROMETER)
        data = replace(data, accelerometer_functions=data.of_accelerometer.beside(function))
    return data


def _exponential(data: MultiPositionData, time_constant_s: float, sigma: float) -> BiasFunctions:
    start, stop = data.span_s
    mean = time_constant_s / (stop - start) * -np.expm1(-(stop - start) / time_constant_s)

    def decay(t_s: Floats) -> Floats:
        return (np.exp(-(t_s - start) / time_constant_s) - mean)[:, None]

    return BiasFunctions(
        at_rest=mean_at_rest(data, decay),
        in_motion=decay(data.rotation_s),
        kind=("warm-up",),
        sigma=np.full((1, 3), sigma),
    )
