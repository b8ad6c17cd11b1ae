"""What a thermometer tells before anything is estimated, and the verdict on a calibration over the temperature."""

from collections.abc import Iterator, Sequence
from math import log

import numpy as np

from ...findings import Finding, make_finding
from ...options.requirements import USES, USUAL_SLOPE, Use
from ...recording import Floats, TemperatureSamples, smallest_steps
from ...results.temperature import TemperatureResult, TriadOverTemperature
from ..verdict import merge_by_cause

_BRANCHES_SIGMAS, _BRANCHES_SHARE = 4.0, 0.05
"""When rising and falling differ: in sigmas, and of the change over the range."""


_OFF_Z = 3.5
_STIRRED = 0.02
_FALL = 0.5
"""Of the range, by which a temperature falls from the beginning to the end of a recording."""


_COLDEST_DEGC = -40.0
"""Chips are specified from here on; rooms, freezers and climate chambers in which one cools are warmer."""


_SHOWN = {"gyroscope": (1e3, "mrad/s"), "accelerometer": (1e3, "mm/s^2")}


def temperature_findings(result: TemperatureResult, thermometers: Sequence[Finding]) -> tuple[Finding, ...]:
    """Return reasons and advice, the worst first.

    Parameters
    ----------
    thermometers : what the thermometers show, of each recording
    """
    findings = [*thermometers]
    low, high = result.low_degc, result.high_degc
    if not result.supported_order:
        findings.append(make_finding("temperature-range/narrow", low=low, high=high, step=result.step_k))
    else:
        findings.append(make_finding("temperature-range/good", low=low, high=high, most=result.supported_order))
    for name, triad in result.triads.items():
        findings += [_order_finding(name, triad, result), *_branch_findings(name, triad)]
        if (off := _off(triad)) is not None:
            axis, recording, z = off
            findings.append(make_finding("warm-ups-differ", name=name, axis=axis, recording=recording, z=z))
    for name, triad in result.sensitivities.items():
        findings.append(_sensitivity_finding(name, triad, result))
        if (off := _off(triad)) is not None:
            axis, recording, z = off
            findings.append(make_finding("sensitivities-differ", name=name, axis=axis, recording=recording, z=z))
    findings += _felt_findings(result)
    if (fall := _fall(result)) is not None:
        kind = "beyond" if low < _COLDEST_DEGC else "cools"
        findings.append(make_finding(f"temperature-falls/{kind}", fall=fall, low=low, high=high))
    if result.lag_s:
        findings.append(make_finding("thermometer-lag", lag=result.lag_s, sigma=result.lag_sigma_s))
    changes = "accelerometer" in result.triads and result.triads["accelerometer"].order > 0
    findings += [
        *([make_finding("turn-on-unknown")] if len(result.names) == 1 else []),
        *([make_finding("temperature-one-way")] if _one_way(result) else []),
        *([make_finding("one-attitude")] if changes and "accelerometer" not in result.sensitivities else []),
        *([make_finding("sensor-nominal")] if result.nominal else []),
    ]
    if result.stirred > _STIRRED:
        findings.append(make_finding("warm-up-stirred", share=100 * result.stirred))
    return merge_by_cause(findings)


def _one_way(result: TemperatureResult) -> bool:
    """Return whether warm-ups at rest tell what the temperature does, and it goes one way in all of them."""
    warm_ups = [one for one in result.triads.values() if len(one.axes[0].degc) > len(one.left_out_z)]
    return any(one.order for one in warm_ups) and all(np.isnan(one.branches).all() for one in warm_ups)


def _fall(result: TemperatureResult) -> float | None:
    """Return by how much the temperature falls in a recording, the least of all [K]; None where one does not."""
    axis = next(iter(result.triads.values())).axes[0]
    courses = [axis.degc[axis.warm_up == one] for one in np.unique(axis.warm_up)]
    falls = [float(course[0] - course[-1]) for course in courses]
    enough = result.supported_order and min(falls) > _FALL * (result.high_degc - result.low_degc)
    return min(falls) if enough else None


def _order_finding(name: str, triad: TriadOverTemperature, result: TemperatureResult) -> Finding:
    factor, unit = _SHOWN[name]
    if not triad.order:
        sigma = factor * max(float(np.std(axis.values)) for axis in triad.axes)
        return make_finding("temperature-order/none", name=name, sigma=sigma, unit=unit)
    change = max(float(np.ptp(axis.change)) for axis in triad.axes)
    sigma = max(float(axis.sigma.max()) for axis in triad.axes)
    return make_finding(
        "temperature-order/found",
        name=name,
        order=triad.order,
        change=factor * change,
        sigma=factor * sigma,
        unit=unit,
        range=result.high_degc - result.low_degc,
    )


def _sensitivity_finding(name: str, triad: TriadOverTemperature, result: TemperatureResult) -> Finding:
    span = result.high_degc - result.low_degc
    if not triad.order:
        sigma = max(float(np.sqrt(np.mean(axis.values**2))) for axis in triad.axes)
        return make_finding("temperature-scale/none", name=name, scatter=sigma, range=span)
    change = max(float(np.ptp(axis.change)) for axis in triad.axes)
    sigma = max(float(np.hypot(axis.sigma[0], axis.sigma[-1])) for axis in triad.axes)
    return make_finding("temperature-scale/found", name=name, order=triad.order, change=change, sigma=sigma, range=span)


def _felt_findings(result: TemperatureResult) -> Iterator[Finding]:
    """Say by how much the gyroscope's g-sensitivity changes, where it does."""
    name, imu = next(iter(result.calibration.imus.items()))
    found = imu.temperature
    if found is None or found.gyroscope_g_sensitivity is None or imu.gyroscope is None:
        return
    ends = found.change("gyroscope_g_sensitivity", np.array([result.low_degc, result.high_degc]))
    change = np.abs(ends[1] - ends[0])
    worst = np.unravel_index(int(np.argmax(change)), change.shape)
    order, span = len(found.gyroscope_g_sensitivity), result.high_degc - result.low_degc
    slope = result.calibration.sigma(f"{name}.temperature.gyroscope_g_sensitivity")[(0, *worst)]
    readings = np.cbrt(np.abs(np.linalg.det(imu.required_accelerometer.sensitivity)))
    per_si = 1e3 * readings / np.cbrt(np.abs(np.linalg.det(imu.gyroscope.sensitivity)))
    yield make_finding(
        "temperature-g-sensitivity",
        change=float(per_si * change[worst]),
        sigma=float(per_si * span * slope),
        order=order,
        range=span,
    )


def _branch_findings(name: str, triad: TriadOverTemperature) -> Iterator[Finding]:
    z = np.abs(triad.branches) / triad.branches_sigma
    change = max(float(np.ptp(axis.change)) for axis in triad.axes)
    apart = (z > _BRANCHES_SIGMAS) & (np.abs(triad.branches) > _BRANCHES_SHARE * change)
    if not apart.any():
        return
    axis = int(np.nanargmax(np.where(apart, z, np.nan)))
    factor, unit = _SHOWN[name]
    yield make_finding(
        "temperature-branches",
        name=name,
        axis="xyz"[axis],
        apart=factor * float(triad.branches[axis]),
        sigma=factor * float(triad.branches_sigma[axis]),
        unit=unit,
    )


def _off(triad: TriadOverTemperature) -> tuple[str, int, float] | None:
    """Return which axis of which recording lies off what the others foretell, and by how many sigmas, or None."""
    z = triad.left_out_z
    if not np.isfinite(z).any() or float(np.nanmax(np.abs(z))) < _OFF_Z:
        return None
    recording, axis = np.unravel_index(int(np.nanargmax(np.abs(z))), z.shape)
    return "xyz"[axis], int(recording) + 1, float(np.nanmax(np.abs(z)))


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
