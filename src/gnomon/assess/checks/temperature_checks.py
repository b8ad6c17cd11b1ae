"""The doctor's look at the thermometer: what it tells, whether its unit is plausible, and the warm-up over."""

from math import log

import numpy as np

from ...findings import Finding, make_finding
from ...options.requirements import USES, USUAL_SLOPE, Use
from ...recording import Floats, TemperatureSamples, smallest_steps

CHIP_DEGC = (-60.0, 130.0)
"""Temperatures at which a chip may work."""
_HOT_DEGC = 65.0
"""Degrees Celsius that a chip rarely has, and Fahrenheit often reads."""
_STEADY_K, _STEPS = 1.0, 3.0
_NEAR_K = 0.5
"""How far from its end a warm-up is called over [K]."""
_RATIOS = (0.02, 0.9)
"""Change from the second to the last third over that from the first to the second, of which a time constant follows."""
_PARTS = 300


def check_temperature(samples: TemperatureSamples, label: str) -> list[Finding]:
    """Return findings on the thermometer of an IMU; nothing of fewer than two readings.

    Parameters
    ----------
    samples : its readings
    label : such as "imu0 thermometer", for messages
    """
    if len(samples) < 2:
        return []
    celsius = samples.celsius()
    if celsius is None:
        return [make_finding("temperature/counts", label=label)]
    known = np.isfinite(celsius)
    if np.count_nonzero(known) < 2:
        return []
    t_ns, celsius = samples.t_ns[known], celsius[known]
    middle = float(np.median(celsius))
    if not CHIP_DEGC[0] <= middle <= CHIP_DEGC[1]:
        return [make_finding("temperature-implausible", label=label, middle=middle, unit=samples.unit)]
    doubtful = middle > _HOT_DEGC and samples.unit == "degC"
    findings = [make_finding("temperature-hot", label=label, middle=middle)] if doubtful else []
    step = float(smallest_steps(celsius[:, None])[0])
    if not np.isfinite(step):
        return [*findings, make_finding("temperature/one-value", label=label, middle=middle)]
    seconds = (t_ns - t_ns[0]) * 1e-9
    return [*findings, _course(seconds, celsius, step, label)]


def _course(t_s: Floats, celsius: Floats, step_k: float, label: str) -> Finding:
    """Return whether the temperature was steady, settles or moves."""
    parts = np.array([part.mean() for part in np.array_split(celsius, min(_PARTS, len(celsius)))])
    low, high = float(parts.min()), float(parts.max())
    if high - low < max(_STEADY_K, _STEPS * step_k):
        return make_finding("temperature/steady", label=label, low=low, high=high, step=step_k)
    settling = warm_up(t_s, celsius)
    if settling is None:
        return make_finding("temperature/moves", label=label, low=low, high=high)
    time_constant, remaining = settling[0], abs(settling[1])
    if remaining < _NEAR_K:
        return make_finding("temperature/settled", label=label, low=low, high=high, time_constant=time_constant)
    return make_finding(
        "temperature/settles",
        label=label,
        low=low,
        high=high,
        time_constant=time_constant,
        remaining=remaining,
        wait=time_constant * log(remaining / _NEAR_K),
        near=_NEAR_K,
        uses="; ".join(_wait(use, time_constant, remaining) for use in USES.values()),
    )


def _wait(use: Use, time_constant_s: float, remaining_k: float) -> str:
    """Return how long to wait until usual biases move by less than a use needs."""
    near = min(use.needs[f"{triad}_bias"] / slope for triad, slope in USUAL_SLOPE.items())
    wait = max(time_constant_s * log(remaining_k / near), 0.0)
    return f"{use.name} {near:.1f} K, {f'{wait:.0f} s' if wait else 'at once'}"


def warm_up(t_s: Floats, celsius: Floats) -> tuple[float, float] | None:
    """Return the time constant [s] of a temperature that approaches its end exponentially, and what is left of it [K].

    Means over thirds of T_end - D exp(-t / tau) change from one to the next by a ratio of exp(-third / tau), whatever
    T_end and D are; thermometers' steps average out in them. None where the changes are no such approach.

    Parameters
    ----------
    t_s : (n,) from the start, rising [s]
    celsius : (n,) [degC]
    """
    duration = float(t_s[-1])
    edges = np.searchsorted(t_s, [duration / 3, 2 * duration / 3])
    thirds = np.split(celsius, edges)
    if duration <= 0 or min(map(len, thirds)) < 2:
        return None
    first, second, last = (float(part.mean()) for part in thirds)
    ratio = (last - second) / (second - first) if second != first else np.inf
    if not _RATIOS[0] < ratio < _RATIOS[1]:
        return None
    # Of the mean over the last third, (1 - ratio) tau / third of what was left at its start is missing to the end.
    third = duration / 3
    time_constant = -third / log(ratio)
    missing = (last - second) * ratio / (1 - ratio)
    return time_constant, missing * ratio / ((1 - ratio) * time_constant / third)
