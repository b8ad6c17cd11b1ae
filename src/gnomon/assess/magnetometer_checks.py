"""The doctor's look at magnetometers: whatever does not depend on how they were turned."""

from dataclasses import replace

from ..findings import Finding
from ..recording import Recording, TriadSamples
from .signals import check_signal
from .stamps import check_stamps

_OF_VALUES = {"saturation", "samples-stuck", "samples-repeated"}


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
    """Return findings on stamps and values of a triad of which only the strength counts, which needs no time."""
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
