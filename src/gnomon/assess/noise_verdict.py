"""Verdict and advice on the noise of an IMU: which coefficients a recording shows, and what a longer one would."""

from collections.abc import Mapping
from math import isfinite, pi

import numpy as np

from ..estimate.allan.fit import AxisFit
from ..findings import Finding
from ..sensor_noise import TriadNoise

_DIFFERENT = 2.0
_MISFIT_WARN, _MISFIT_FAIL = 0.15, 0.6  # of the Allan deviation
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
        findings.append(
            Finding(
                severity="info",
                code="noise-t-init",
                message=f"Averaged over {t_init_s:.0f} s, the gyroscope's bias is known about as well as it can be.",
                consequence="That is the length of the rest at the start of a calibration by hand (T_init).",
            )
        )
    elif "gyroscope" in noise:
        longest = min(noise["gyroscope"].duration_s / 9, 225.0)
        findings.append(
            Finding(
                severity="info",
                code="noise-t-init",
                message=f"The gyroscope's Allan deviation still falls at {longest:.0f} s in one axis or more.",
                consequence=f"A calibration by hand gains from {longest:.0f} s or more of rest at its start (T_init).",
            )
        )
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
        return [Finding(severity="good", code="noise-length", message=message)]
    short = triad.duration_s < _LONG_S
    return [
        Finding(
            severity="warning" if short else "info",
            code="noise-length",
            message=f"{message} No bias instability is seen in {_named(hidden)}.",
            consequence="It is given as an upper bound."
            if not short
            else "The recording is too short for it: it is given as an upper bound only.",
            cure=f"Record for {span(max(4 * triad.duration_s, 3600))} or more at rest and at an even temperature."
            if short
            else "",
        )
    ]


def _walk(name: str, triad: TriadNoise) -> list[Finding]:
    hidden = [i for i, axis in enumerate(triad.axes) if not axis.random_walk.found]
    if not hidden:
        return []
    none = len(hidden) == 3
    short = triad.duration_s < _LONG_S
    taken = "the upper bounds are" if none else "those of the other axes are"
    return [
        Finding(
            severity="warning" if none and short else "info",
            code="noise-walk-bound",
            message=f"{name}: no random walk is seen in {_named(hidden)} within {span(triad.duration_s)}.",
            consequence=f"imu.yaml needs a number greater than zero: {taken} taken"
            + (", which may be far too large." if none else "."),
            cure=f"Record for {span(max(4 * triad.duration_s, 4 * 3600))} or more at rest and at an even temperature, "
            "or take the data sheet's."
            if none
            else "",
        )
    ]


def _misfit(name: str, triad: TriadNoise) -> list[Finding]:
    worst = int(np.argmax([axis.misfit for axis in triad.axes]))
    misfit = triad.axes[worst].misfit
    if misfit < _MISFIT_WARN:
        return []
    return [
        Finding(
            severity="problem" if misfit > _MISFIT_FAIL else "warning",
            code="noise-misfit",
            message=f"{name} {'xyz'[worst]}: the Allan deviation differs by {100 * misfit:.0f} % from that of white "
            "noise, bias instability and random walk.",
            consequence="Vibration or a periodic disturbance is in it, or the temperature changed. All sigmas are "
            "widened by that, but coefficients describe the sensor only roughly.",
            cure="Record away from fans, people and traffic, at an even temperature, and look at the figure.",
        )
    ]


def _filtered(name: str, triad: TriadNoise, fits: tuple[AxisFit, ...]) -> list[Finding]:
    first = max(axis.fitted_from_s for axis in triad.axes)
    if first <= triad.tau_s[0] * 1.01:
        return []
    delay_s = max(fit.delay for fit in fits) / triad.rate_hz
    like = f" like those behind a low-pass filter of about {1 / (2 * pi * delay_s):.2g} Hz" if delay_s > 0 else ""
    return [
        Finding(
            severity="info",
            code="noise-filtered",
            message=f"{name}: averaging times under {first:.3g} s do not fit in with longer ones{like}, and were left "
            "out.",
            consequence="Mostly a filter in the sensor, or vibration: single samples scatter otherwise than the "
            "density says, which is that of lower frequencies.",
        )
    ]


def _falling(name: str, triad: TriadNoise, fits: tuple[AxisFit, ...]) -> list[Finding]:
    axes = [i for i, fit in enumerate(fits) if fit.falls]
    if not axes:
        return []
    longest = triad.tau_s[0] * 2.0 ** (min(fits[i].stop for i in axes) - 1)
    return [
        Finding(
            severity="warning",
            code="noise-falls",
            message=f"{name} {_named(axes)}: there is less noise at low frequencies than any kind of noise has.",
            consequence="Something in the sensor or behind it takes slow errors away (a high-pass filter, auto-zero), "
            "or the bias is drawn back to its mean: the recording does not tell bias instability and random walk. "
            f"Their bounds are those of averaging times up to {span(longest)} only, and nothing bounds them beyond.",
            cure="Switch the high-pass filter or the auto-zero off, or take both from the data sheet.",
        )
    ]


def _other_slope(name: str, fits: tuple[AxisFit, ...]) -> list[Finding]:
    worst = max(fit.other_slope for fit in fits) / 2
    if worst < _OTHER_SLOPE_INFO:
        return []
    return [
        Finding(
            severity="warning" if worst > _OTHER_SLOPE_WARN else "info",
            code="noise-other-slope",
            message=f"{name}: noise with a spectrum between those of the usual kinds explains the curve better; with "
            f"it the white noise would differ by {100 * worst:.2g} %.",
            consequence="All sigmas are widened by what it would change.",
        )
    ]


def _axes(name: str, triad: TriadNoise) -> list[Finding]:
    values = [axis.white_noise.most for axis in triad.axes]
    if max(values) < _DIFFERENT * min(values):
        return []
    low, high = int(np.argmin(values)), int(np.argmax(values))
    return [
        Finding(
            severity="warning",
            code="noise-axes-differ",
            message=f"{name}: the white noise of {'xyz'[high]} is {values[high] / values[low]:.2g} times that of "
            f"{'xyz'[low]}.",
            consequence="imu.yaml holds one number for all three, the root of their mean square; it fits none of them.",
            cure="Where the data sheet says that they are alike, look for vibration; noise.yaml has every axis.",
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
        Finding(
            severity="info",
            code="noise-drift",
            message=f"{name} {_named(drifting)}: the mean drifts evenly, by {total:.3g} {unit} over the recording "
            f"({'xyz'[worst]}), which is more than its noise does.",
            consequence="Mostly the temperature. The drift is taken out before the coefficients are estimated, and "
            "given as rate ramp.",
            cure="Let the sensor warm up before it is recorded.",
        )
    ]


def _usual(name: str, triad: TriadNoise) -> list[Finding]:
    low, high = _USUAL[name]
    if low < triad.noise_density < high:
        return []
    unit = {"accelerometer": "m/s^2/sqrt(Hz)", "gyroscope": "rad/s/sqrt(Hz)"}[name]
    return [
        Finding(
            severity="warning",
            code="noise-implausible",
            message=f"{name}: a white noise of {triad.noise_density:.3g} {unit} is that of no usual sensor "
            f"({low:g} to {high:g}).",
            consequence="The unit of the recording may be another one.",
            cure='State it with --units, for example --units "g deg/s".',
        )
    ]
