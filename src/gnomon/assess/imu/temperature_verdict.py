"""What there is to say of a sensor over its temperature."""

from collections.abc import Iterator, Sequence

import numpy as np

from ...findings import Finding, make_finding
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
