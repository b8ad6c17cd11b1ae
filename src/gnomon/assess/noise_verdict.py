"""Verdict and advice on the noise of an IMU: which coefficients a recording shows, and what a longer one would."""

from collections.abc import Mapping
from math import isfinite, pi

import numpy as np

from ..estimate.allan.fit import AxisFit
from ..findings import Finding, make_finding
from ..sensor_noise import TriadNoise
from .verdict import grade

_DIFFERENT = 2.0
_LONG_S = 3 * 3600.0
_OTHER_SLOPE_INFO, _OTHER_SLOPE_WARN = 0.01, 0.1  # of the white noise
_USUAL = {"accelerometer": (1e-6, 0.1), "gyroscope": (1e-8, 5e-3)}
"""White noise densities of sensors that exist, in SI."""


def assess_noise(
    noise: Mapping[str, TriadNoise], fits: Mapping[str, tuple[AxisFit, ...]], t_init_s: float
) -> list[Finding]:
    """Judge the coefficients of both sensors; `t_init_s` is the advice for calibrations by hand."""
    findings: list[Finding] = []
    for name, triad in noise.items():
        findings += [*_length(name, triad), *_walk(name, triad), *_misfit(name, triad)]
        findings += [*_filtered(name, triad, fits[name]), *_falling(name, triad, fits[name])]
        findings += _other_slope(name, fits[name])
        findings += [*_axes(name, triad), *_ramp(name, triad), *_usual(name, triad)]
    if isfinite(t_init_s):
        findings.append(make_finding("noise-t-init/found", t_init_s=t_init_s))
    elif "gyroscope" in noise:
        longest = min(noise["gyroscope"].duration_s / 9, 225.0)
        findings.append(make_finding("noise-t-init/longer", longest=longest))
    return findings


def span(seconds: float) -> str:
    """Return a time as a person says it.

    Examples
    --------
    >>> span(42), span(600), span(9000), span(259200)
    ('42 s', '10 min', '2.5 h', '72 h')
    """
    if seconds < 120:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 7200 else f"{seconds / 3600:.3g} h"


def _named(axes: list[int]) -> str:
    return " and ".join("xyz"[axis] for axis in axes)


def _length(name: str, triad: TriadNoise) -> list[Finding]:
    """Say which averaging times the length supports, and whether they show the floor of the curve."""
    known = [axis.white_noise.sigma / axis.white_noise.value for axis in triad.axes if axis.white_noise.found]
    worst = max(known, default=float("inf"))
    message = (
        f"{name}: {span(triad.duration_s)} at {triad.rate_hz:.6g} Hz show averaging times up to "
        f"{span(triad.tau_s[1])}; the white noise is known to {100 * worst:.2g} % (worst axis)."
    )
    hidden = [i for i, axis in enumerate(triad.axes) if not axis.bias_instability.found]
    # The floor is reached where white noise has fallen to it; its bound says what it is at most.
    if not hidden:
        return [make_finding("noise-length/good", message=message)]
    short = triad.duration_s < _LONG_S
    return [
        make_finding(
            "noise-length/bound",
            severity="warning" if short else "info",
            case="short" if short else "",
            message=message,
            hidden=_named(hidden),
            longer=span(max(4 * triad.duration_s, 3600)),
        )
    ]


def _walk(name: str, triad: TriadNoise) -> list[Finding]:
    hidden = [i for i, axis in enumerate(triad.axes) if not axis.random_walk.found]
    if not hidden:
        return []
    none = len(hidden) == 3
    short = triad.duration_s < _LONG_S
    return [
        make_finding(
            "noise-walk-bound",
            severity="warning" if none and short else "info",
            case="none" if none else "",
            name=name,
            hidden=_named(hidden),
            duration=span(triad.duration_s),
            longer=span(max(4 * triad.duration_s, 4 * 3600)),
        )
    ]


def _misfit(name: str, triad: TriadNoise) -> list[Finding]:
    worst = int(np.argmax([axis.misfit for axis in triad.axes]))
    misfit = triad.axes[worst].misfit
    severity = grade("noise misfit", misfit)
    if severity == "good":
        return []
    return [
        make_finding(
            "noise-misfit",
            severity=severity,
            name=name,
            axis="xyz"[worst],
            misfit=misfit,
        )
    ]


def _filtered(name: str, triad: TriadNoise, fits: tuple[AxisFit, ...]) -> list[Finding]:
    first = max(axis.fitted_from_s for axis in triad.axes)
    if first <= triad.tau_s[0] * 1.01:
        return []
    delay_s = max(fit.delay for fit in fits) / triad.rate_hz
    like = f" like those behind a low-pass filter of about {1 / (2 * pi * delay_s):.2g} Hz" if delay_s > 0 else ""
    return [make_finding("noise-filtered", name=name, first=first, like=like)]


def _falling(name: str, triad: TriadNoise, fits: tuple[AxisFit, ...]) -> list[Finding]:
    axes = [i for i, fit in enumerate(fits) if fit.falls]
    if not axes:
        return []
    longest = triad.tau_s[0] * 2.0 ** (min(fits[i].stop for i in axes) - 1)
    return [make_finding("noise-falls", name=name, axes=_named(axes), longest=span(longest))]


def _other_slope(name: str, fits: tuple[AxisFit, ...]) -> list[Finding]:
    worst = max(fit.other_slope for fit in fits) / 2
    if worst < _OTHER_SLOPE_INFO:
        return []
    return [
        make_finding(
            "noise-other-slope", severity="warning" if worst > _OTHER_SLOPE_WARN else "info", name=name, worst=worst
        )
    ]


def _axes(name: str, triad: TriadNoise) -> list[Finding]:
    values = [axis.white_noise.most for axis in triad.axes]
    if max(values) < _DIFFERENT * min(values):
        return []
    low, high = int(np.argmin(values)), int(np.argmax(values))
    return [
        make_finding(
            "noise-axes-differ", name=name, axis="xyz"[high], ratio=values[high] / values[low], lowest="xyz"[low]
        )
    ]


def _ramp(name: str, triad: TriadNoise) -> list[Finding]:
    drifting = [i for i, axis in enumerate(triad.axes) if axis.rate_ramp.found]
    if not drifting:
        return []
    worst = max(drifting, key=lambda i: triad.axes[i].rate_ramp.value)
    total = triad.axes[worst].rate_ramp.value * triad.duration_s
    unit = {"accelerometer": "m/s^2", "gyroscope": "rad/s"}[name]
    return [
        make_finding("noise-drift", name=name, drifting=_named(drifting), total=total, unit=unit, axis="xyz"[worst])
    ]


def _usual(name: str, triad: TriadNoise) -> list[Finding]:
    low, high = _USUAL[name]
    if low < triad.noise_density < high:
        return []
    unit = {"accelerometer": "m/s^2/sqrt(Hz)", "gyroscope": "rad/s/sqrt(Hz)"}[name]
    return [
        make_finding("noise-implausible", name=name, noise_density=triad.noise_density, unit=unit, low=low, high=high)
    ]
