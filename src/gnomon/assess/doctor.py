"""The data doctor: what is good and bad about a recording before anything is estimated from it."""

import numpy as np

from ..findings import Finding, make_finding
from ..recording import ImuSamples, Recording, TriadSamples
from .lost_samples import check_lost_samples
from .protocol import check_protocol
from .signals import check_signal
from .stamps import check_stamps
from .triad_clocks import check_triad_clocks
from .vibration import check_vibration

_POSES = 9


def check(recording: Recording, *, window_s: float = 1.0, multiplier: float | None = None) -> tuple[Finding, ...]:
    """Look at a recording and say what is good or bad about it for the calibration of an IMU.

    Parameters
    ----------
    window_s, multiplier : of the static detector, see `ImuOptions`

    Every finding states its consequence and its cure. Codes: time-backward, time-constant, time-repeated, time-rounded,
    rate, jitter, gaps; signal-constant, axis-constant, saturation, samples-stuck, samples-repeated, samples-skipped;
    samples-missing, gyroscope-missing, gyroscope-silent; gravity-magnitude, never-static, rests-unsteady,
    always-static, attitudes, intervals-left-out, static-start, clocks-apart, triads-apart, vibration; poses.

    Returns
    -------
    Findings in the order stamps, values, motion, IMU by IMU; severity "problem" means that it cannot be calibrated.
    """
    if recording.pieces or recording.poses is not None:
        return tuple(_check_poses(recording))
    return tuple(
        finding
        for name, imu in recording.imus.items()
        for finding in _check_imu(name, imu, window_s=window_s, multiplier=multiplier)
    )


def _check_poses(recording: Recording) -> list[Finding]:
    """Look at poses, which need neither rests between them nor one rate."""
    count, what = len(recording.pieces), "files"
    if recording.poses is not None:
        count, what = len(recording.poses), "averages"
    findings = [
        finding
        for name, imu in recording.imus.items()
        for quantity, samples in (("accelerometer", imu.accelerometer), ("gyroscope", imu.gyroscope))
        if len(samples) > 1
        for finding in check_signal(samples, f"{name} {quantity}")
    ]
    enough = count >= _POSES
    return [
        *findings,
        make_finding(
            "poses", severity="good" if enough else "warning", case="enough" if enough else "", count=count, what=what
        ),
    ]


def _check_imu(name: str, imu: ImuSamples, *, window_s: float, multiplier: float | None) -> list[Finding]:
    accelerometer, gyroscope = imu.accelerometer, imu.gyroscope
    if len(accelerometer) < 2 or len(gyroscope) == 1:
        return [
            make_finding("samples-missing/imu", name=name, accelerometer=len(accelerometer), gyroscope=len(gyroscope))
        ]
    findings: list[Finding] = []
    if len(gyroscope) == 0:
        findings.append(make_finding("gyroscope-missing/imu", name=name))
        findings += check_stamps(accelerometer, f"{name} accelerometer")
    elif np.array_equal(accelerometer.t_ns, gyroscope.t_ns):
        findings += check_stamps(accelerometer, name)
    else:
        findings += check_stamps(accelerometer, f"{name} accelerometer")
        findings += check_stamps(gyroscope, f"{name} gyroscope")
        findings += _clocks(accelerometer, gyroscope, name)
    signals = check_signal(accelerometer, f"{name} accelerometer")
    usable = not any(finding.code == "signal-constant" for finding in signals)
    findings += signals
    if len(gyroscope) > 1:
        findings += check_signal(gyroscope, f"{name} gyroscope")
        findings += check_vibration(accelerometer, gyroscope, name)
        findings += check_lost_samples(gyroscope, f"{name} gyroscope")
    usable = usable and not any(finding.code == "time-constant" for finding in findings)
    if usable and len(gyroscope) > 1:
        findings += check_triad_clocks(imu, name)
    if not usable:
        return findings
    return findings + check_protocol(imu, name, window_s=window_s, multiplier=multiplier)


def _clocks(accelerometer: TriadSamples, gyroscope: TriadSamples, name: str) -> list[Finding]:
    first = max(accelerometer.t_ns[0], gyroscope.t_ns[0])
    last = min(accelerometer.t_ns[-1], gyroscope.t_ns[-1])
    longest = max(accelerometer.duration_s, gyroscope.duration_s)
    common = max(0.0, float(last - first) * 1e-9)
    if common > 0.9 * longest:
        return []
    return [
        make_finding(
            "clocks-apart", severity="problem" if common == 0 else "warning", name=name, common=common, longest=longest
        )
    ]
