"""The data doctor: what is good and bad about a recording before anything is estimated from it."""

from dataclasses import replace
from functools import partial

from ...findings import Finding
from ...recording import Recording, TriadSamples
from ..verdict import merge_by_cause
from .imu_checks import check_by_rests, find_imu_rests
from .signals import check_signal, check_stamps

_OF_VALUES = {"isolated-readings", "saturation", "samples-stuck", "samples-repeated", "dead-band"}


def check_magnetometers(recording: Recording) -> list[Finding]:
    """Look at the magnetometers of a recording; a problem of theirs spoils nothing else, and is a warning."""
    findings: list[Finding] = []
    for name, imu in recording.imus.items():
        if imu.magnetometer is None or len(imu.magnetometer) < 2:
            continue
        alone = not len(imu.accelerometer)
        for finding in check_field_samples(imu.magnetometer, f"{name} magnetometer"):
            severe = finding.severity == "problem" and not alone
            findings.append(replace(finding, severity="warning") if severe else finding)
    return findings


def check_field_samples(samples: TriadSamples, label: str) -> list[Finding]:
    """Return findings on timestamps and values of a triad of which only the strength counts, which needs no time."""
    found: list[Finding] = []
    for finding in (*check_stamps(samples, label), *check_signal(samples, label)):
        if finding.severity == "warning" and finding.code == "saturation":
            found.append(replace(finding, consequence="They are masked.", cure="Set a wider range."))
        elif finding.severity == "warning" and finding.code not in _OF_VALUES:
            times = "Strengths do not depend on time; how the sensors stand to each other may suffer."
            found.append(replace(finding, severity="info", consequence=times))
        else:
            found.append(finding)
    return found


def check(recording: Recording, *, window_s: float = 1.0, multiplier: float | None = None) -> tuple[Finding, ...]:
    """Look at a recording and say what is good or bad about it for the calibration of an IMU.

    Parameters
    ----------
    window_s, multiplier : of the static detector, see `ImuOptions`

    Every finding states its consequence and its cure. Codes: time-backward, time-constant, time-repeated, time-rounded,
    rate, rate-changed, jitter, gaps; signal-constant, axis-constant, axis-stuck, isolated-readings, saturation,
    samples-stuck, samples-repeated, samples-skipped; samples-missing, gyroscope-missing, gyroscope-silent;
    gravity-magnitude, range-changed, never-static, rests-unsteady, always-static, attitudes, intervals-left-out,
    static-start, clocks-apart, triads-apart, vibration; poses; temperature, temperature-hot, temperature-implausible.

    Returns
    -------
    Findings, those of one IMU by severity, causes before what follows from them; otherwise in the order timestamps,
    values, motion, IMU by IMU. Severity "problem" means that it cannot be calibrated.
    """
    findings = check_by_rests(recording, partial(find_imu_rests, window_s=window_s, multiplier=multiplier))
    if any(imu.magnetometer is not None for imu in recording.imus.values()):
        alone = all(not len(imu.gyroscope) for imu in recording.imus.values())
        findings = tuple(_for_a_magnetometer(finding, alone=alone) for finding in findings)
    return merge_by_cause(list(findings)) if len(recording.imus) == 1 else findings


_OF_RESTS = {"never-static", "attitudes"}


def _for_a_magnetometer(finding: Finding, *, alone: bool) -> Finding:
    """Return a finding on rests as one for a recording that may be there for its magnetometer, which needs none."""
    if finding.code not in _OF_RESTS or finding.severity == "good":
        return finding
    return replace(
        finding,
        severity="info" if alone else "warning",
        consequence=f"gnomon magnetometer needs no rests; gnomon imu does. {finding.consequence}",
    )
