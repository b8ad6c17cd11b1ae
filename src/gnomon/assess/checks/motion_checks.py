"""The data doctor's look at an IMU that moves all the time, as in front of a camera's board."""

from dataclasses import replace

import numpy as np

from ...detect.samples.rests import RangeChange, find_range_change
from ...findings import Finding, make_finding
from ...recording import Floats, ImuSamples, TriadSamples, measurable_numbers
from ...results.result import StaticIntervals
from ...units import ACCELEROMETER_UNITS_M_S2, GYROSCOPE_UNITS_RAD_S, STANDARD_GRAVITY_M_S2
from .protocol import looks_like, range_changed_finding, why_no_gravity
from .signals import check_exchanged, check_signal, check_stamps, check_vibration, is_silent

_SLOW_HZ, _SLOWEST_HZ = 50.0, 10.0
_SHORT_S = 5.0
_PLAUSIBLE, _POSSIBLE = 1.2, 2.0  # median specific force over gravity, or the inverse
_FASTEST_RAD_S = 35.0  # the full scale of usual gyroscopes, 2000 deg/s
_STILL_RAD_S, _SLOWEST_RAD_S = 0.05, 0.1
_SWING_S, _SWINGS = 0.3, 9

_RETOLD = {
    "gaps": ("There the trajectory rests on the other sensors alone.", "Record with a faster link or a lower rate."),
    "time-constant": ("Nothing can be integrated.", "Write the time of each sample, in nanoseconds."),
    "time-repeated": (
        "Only the first sample of each timestamp tells its time.",
        "Write every sample once, in nanoseconds.",
    ),
    "time-rounded": (
        "Rounded timestamps act like noise.",
        "Write the timestamps with all their digits, in nanoseconds.",
    ),
    "signal-constant": ("The sensor measured nothing.", "Check that it is switched on, and what the header names."),
    "axis-constant": ("The sensor did not measure this axis.", "Check its configuration, and what the header names."),
    "saturation": ("They are masked.", "Turn more slowly, or set a wider range."),
    "samples-stuck": ("Stuck samples contradict the camera.", "Check the link to the sensor, and cut this part out."),
}
"""Consequence and cure of findings of the other doctors, whose words are for recordings with rests."""


def check_moving_imu(name: str, imu: ImuSamples) -> list[Finding]:
    """Return findings on the samples of an IMU that moved in front of a board; linear time.

    Codes: samples-missing, samples-lost, unit, imu-rate, stream-short, gravity-magnitude, range-changed,
    rate-magnitude, gyroscope-silent, imu-still, and those of the timestamps and the signals.
    """
    unusable = _unusable(name, imu)
    if unusable:
        return unusable
    accelerometer = _in_si(imu.accelerometer, ACCELEROMETER_UNITS_M_S2)
    gyroscope = _in_si(imu.gyroscope, GYROSCOPE_UNITS_RAD_S)
    imu = replace(imu, accelerometer=accelerometer, gyroscope=gyroscope)
    findings: list[Finding] = []
    if np.array_equal(accelerometer.t_ns, gyroscope.t_ns):
        findings += check_stamps(accelerometer, name)
    else:
        findings += check_stamps(accelerometer, f"{name} accelerometer") + check_stamps(gyroscope, f"{name} gyroscope")
    for samples, sensor in ((accelerometer, "accelerometer"), (gyroscope, "gyroscope")):
        findings += check_signal(samples, f"{name} {sensor}")
    findings = [_retold(finding) for finding in findings]
    if any(finding.code in {"time-constant", "signal-constant"} for finding in findings):
        return findings
    gravity = _gravity(name, accelerometer)
    if gravity[0].code == "gravity-magnitude" and gravity[0].severity != "good":
        exchanged = check_exchanged(accelerometer, gyroscope, name)
        if exchanged:
            return exchanged
    shaken = check_vibration(accelerometer, gyroscope, name)
    return [*findings, *_rate(name, gyroscope), *gravity, *_motion(name, imu), *shaken]


def _unusable(name: str, imu: ImuSamples) -> list[Finding]:
    """Return problems that leave nothing else to look at."""
    accelerometer, gyroscope = f"{name} accelerometer", f"{name} gyroscope"
    found = _incomplete(accelerometer, imu.accelerometer) or _incomplete(gyroscope, imu.gyroscope)
    return [] if found is None else [found]


def _in_si(samples: TriadSamples, units: dict[str, float | None]) -> TriadSamples:
    factor = units[samples.unit]
    if factor is None or factor == 1:
        return samples
    return replace(samples, values=samples.values * factor, unit=next(iter(units)))


def _incomplete(label: str, samples: TriadSamples) -> Finding | None:
    if len(samples) < 2:
        return make_finding("samples-missing/rig", label=label, samples=len(samples))
    if samples.unit == "count":
        return make_finding("unit/counts", label=label)
    lost = ~np.logical_and.reduce(measurable_numbers(samples.values), axis=1)
    if lost.any():
        return make_finding(
            "samples-lost", label=label, lost=np.count_nonzero(lost), samples=len(lost), first=np.argmax(lost)
        )
    return None


def _retold(finding: Finding) -> Finding:
    if finding.code not in _RETOLD or not finding.cure:
        return finding
    consequence, cure = _RETOLD[finding.code]
    return replace(finding, consequence=consequence, cure=cure)


def _rate(name: str, gyroscope: TriadSamples) -> list[Finding]:
    findings: list[Finding] = []
    rate_hz, duration_s = gyroscope.rate_hz, gyroscope.duration_s
    if rate_hz < _SLOW_HZ:
        findings.append(
            make_finding(
                "imu-rate", severity="problem" if rate_hz < _SLOWEST_HZ else "warning", name=name, rate_hz=rate_hz
            )
        )
    if duration_s < _SHORT_S:
        findings.append(make_finding("stream-short/imu", name=name, duration_s=duration_s))
    return findings


def _gravity(name: str, accelerometer: TriadSamples) -> list[Finding]:
    width = max(1, min(round(_SWING_S * accelerometer.rate_hz), len(accelerometer) // 10))
    parts = len(accelerometer) // width
    means = accelerometer.values[: parts * width].reshape(parts, width, 3).mean(axis=1)  # shaking averages out
    read = np.linalg.norm(means, axis=1)
    change = _range_change(read, width, len(accelerometer))
    if change is not None:
        return [range_changed_finding(change, accelerometer, name, "problem")]
    found = float(np.median(read))
    ratio = max(found, 1e-9) / STANDARD_GRAVITY_M_S2
    ratio = max(ratio, 1 / ratio)
    message = f"{name}: the accelerometer usually reads {found:.3f} m/s^2"
    averaged = width >= round(_SWING_S * accelerometer.rate_hz)
    if ratio <= (_PLAUSIBLE if averaged else _POSSIBLE):
        return [make_finding("gravity-magnitude/good", message=f"{message}, 9.81 but for bias and motion.")]
    message += f", expected about 9.81.{looks_like(found, 'm/s^2')}"
    return [
        make_finding(
            "gravity-magnitude/motion",
            severity="problem" if ratio > _POSSIBLE else "warning",
            message=message,
            found=why_no_gravity(found, message),
        )
    ]


def _range_change(read: Floats, width: int, samples: int) -> RangeChange | None:
    """Return where gravity is read as another number, by medians over several swings of the hand.

    Parameters
    ----------
    read : (m,) magnitude of the mean over each swing [m/s^2]
    width : samples of a swing
    samples : of the recording
    """
    parts = len(read) // _SWINGS
    starts = _SWINGS * width * np.arange(parts)
    stretches = StaticIntervals(start=starts, stop=starts + _SWINGS * width)
    return find_range_change(np.median(read[: parts * _SWINGS].reshape(parts, _SWINGS), axis=1), stretches, samples)


def _motion(name: str, imu: ImuSamples) -> list[Finding]:
    """Return findings on how much the gyroscope shows."""
    rates = imu.gyroscope.values - np.median(imu.gyroscope.values, axis=0)
    if np.sqrt((rates**2).sum(axis=1).mean()) < _STILL_RAD_S and is_silent(imu.gyroscope):
        return [_silent(name, is_silent(imu.accelerometer))]
    peak = float(np.abs(rates).max())
    found = f"{name}: the gyroscope reads up to {peak:.4g} rad/s ({np.degrees(peak):.4g} deg/s) from its median."
    state = 'State the unit if it is another one (--units, for example "g deg/s")'
    if peak >= _FASTEST_RAD_S:
        consequence, cure = "Hands do not turn so fast; the unit may be wrong.", f"{state}."
    elif peak <= _SLOWEST_RAD_S:
        consequence, cure = "The turns are too slow to tell much, or the unit is wrong.", f"{state}, or turn faster."
    else:
        return []
    return [
        make_finding("rate-magnitude", found=found, consequence=consequence, cure=cure),
    ]


def _silent(name: str, still: bool) -> Finding:
    """Return what to say where the gyroscope shows only noise; `still` where the accelerometer does, too."""
    if still:
        return make_finding("imu-still", name=name)
    return make_finding("gyroscope-silent/motion", name=name)
