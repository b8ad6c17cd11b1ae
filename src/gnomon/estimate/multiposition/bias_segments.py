"""Segments between which a bias stepped, the exponential of a sensor that warms up, and its temperature.

A segment is a run of static intervals with a bias of its own: before and after a power cycle. The bias of segment j is
b + c_j, and c = 0 in the last one, so that b is its bias.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ...options.requirements import USUAL_SLOPE
from ...recording import Floats, Integers
from .bias_changes import shares_before
from .drift import mean_at_rest
from .model import PARAMETERS, BiasFunctions, MultiPositionData

_WEAK = {"accelerometer": 0.3, "gyroscope": 1.0}
"""Sigma of a step beforehand, scaled units: as of the biases themselves."""
_WEAK_K, WEAK_LAG_S = 10.0, 100.0
"""Change of the temperature that is as weakly known to move a bias [K], and lag of the thermometer [s]."""
LAG_LEFT_S = 2.0
"""Of a thermometer's lag that was undone, or is too small to be told [s]."""
BENDS_K = 50.0
"""Chips are made for some 125 K, over which their data sheets draw such curves as bend."""


def with_bias_steps(
    data: MultiPositionData, *, gyroscope: Sequence[float] = (), accelerometer: Sequence[float] = ()
) -> MultiPositionData:
    """Return the data with a bias of its own before each step; rotations across a step are unlinked.

    Parameters
    ----------
    data : of n static intervals
    gyroscope, accelerometer : places, ascending, at which each bias stepped; see `BiasChanges.steps`
    """
    linked = data.linked.copy()
    across = [int(place) - 1 for place in (*gyroscope, *accelerometer) if float(place).is_integer()]
    linked[across] = False
    data = replace(data, linked=linked)
    if gyroscope:
        steps = step_functions(np.array(gyroscope), len(data.interval_s), "gyroscope")
        data = replace(data, gyroscope_functions=data.of_gyroscope.beside(steps))
    if accelerometer:
        steps = step_functions(np.array(accelerometer), len(data.interval_s), "accelerometer")
        data = replace(data, accelerometer_functions=data.of_accelerometer.beside(steps))
    return data


def step_functions(places: Floats, n: int, triad: str) -> BiasFunctions:
    """Return one function for each segment but the last, whose bias is that of the model."""
    in_motion = np.arange(1, n)[:, None] < places
    return BiasFunctions(
        at_rest=np.diff(shares_before(places, n), axis=1, prepend=0.0),
        in_motion=np.diff(in_motion.astype(np.float64), axis=1, prepend=0.0),
        kind=("step",) * len(places),
        sigma=np.full((len(places), 3), _WEAK[triad]),
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
        sigma=np.full((len(intervals), 3), _WEAK["gyroscope"]),
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
        function = decay_functions(data, gyroscope_s, "gyroscope")
        data = replace(data, gyroscope_functions=data.of_gyroscope.beside(function))
    if accelerometer_s:
        function = decay_functions(data, accelerometer_s, "accelerometer")
        data = replace(data, accelerometer_functions=data.of_accelerometer.beside(function))
    return data


def decay_functions(data: MultiPositionData, time_constant_s: float, triad: str) -> BiasFunctions:
    """Return an exponential in time, of mean zero over the recording."""
    start, stop = data.span_s
    mean = time_constant_s / (stop - start) * -np.expm1(-(stop - start) / time_constant_s)

    def decay(t_s: Floats) -> Floats:
        return (np.exp(-(t_s - start) / time_constant_s) - mean)[:, None]

    return BiasFunctions(
        at_rest=mean_at_rest(data, decay),
        in_motion=decay(data.rotation_s),
        kind=("warm-up",),
        sigma=np.full((1, 3), _WEAK[triad]),
    )


def with_temperature(
    data: MultiPositionData, sensitivities: tuple[Floats, Floats], *, gyroscope: bool, accelerometer: bool
) -> MultiPositionData:
    """Return the data with biases that follow powers of the temperature T, which the data tell at rest and in motion.

    A thermometer that reads x and follows with a lag has T = x + lag x': the rate x' takes up what the lag leaves. Each
    higher power is expected to be worth as much as a usual slope is where the temperature differs by `BENDS_K`.

    Parameters
    ----------
    sensitivities : (3,) of gyroscope and accelerometer, what one rad/s and one m/s^2 read [scaled units]
    """
    if data.degc is None:
        return data
    at_rest, in_motion = data.degc
    follows = {"gyroscope": gyroscope, "accelerometer": accelerometer}
    for (triad, slope), sensitivity in zip(USUAL_SLOPE.items(), sensitivities, strict=True):
        if follows[triad]:
            kind = ("temperature", "warming", *["curve"] * (at_rest.shape[1] - 2))  # the last: both together
            weak = _WEAK[triad] / _WEAK_K * np.array([[1.0] * 3, [WEAK_LAG_S] * 3])
            curves = [slope * sensitivity / BENDS_K**power for power in range(1, len(kind) - 2)]
            sigma = np.concatenate([weak, np.reshape(curves, (-1, 3)), [2 * LAG_LEFT_S * curves[0]]])
            function = BiasFunctions(at_rest=at_rest, in_motion=in_motion, kind=kind, sigma=sigma)
            data = replace(data, **{f"{triad}_functions": getattr(data, f"of_{triad}").beside(function)})
    return data


def temperature_columns(data: MultiPositionData) -> dict[str, Integers]:
    """Return where the coefficients of the temperature, its rate and its higher powers stand, (k, 3) of each triad."""
    found: dict[str, Integers] = {}
    first = PARAMETERS
    for triad, functions in (("gyroscope", data.of_gyroscope), ("accelerometer", data.of_accelerometer)):
        if len(at := np.flatnonzero(functions.of_kind("temperature", "warming", "curve"))):
            found[triad] = first + 3 * at[:, None] + np.arange(3)
        first += 3 * len(functions.kind)
    return found
