"""Biases that stepped, wandered or warmed up while an IMU was recorded: what they did, and which bias is published."""

import numpy as np

from ..diagnostics import BiasSegments, ImuDiagnostics
from ..estimate.multiposition.model import PARAMETERS
from ..findings import Finding
from ..recording import Floats
from .imu_tables import ImuEvidence, interval_numbers
from .left_out import cluster

_SHOWN = 4  # parts of a recording
_MOST_USED = 0.5  # of the static intervals of a part: where fewer show the same gravity, it is of another sensor
_SHORT = 5  # static intervals: fewer tell the published bias from little


def changes_in_model(evidence: ImuEvidence) -> tuple[str, ...]:
    """Return what the biases follow in time, such as ("drift", "accelerometer bias steps")."""
    found: list[str] = []
    for triad, functions in (
        ("", evidence.fit.data.of_gyroscope),
        ("accelerometer ", evidence.fit.data.of_accelerometer),
    ):
        if functions.of_kind("walk", "line", "warm-up").any():
            found.append(f"{triad}drift")
        if functions.of_kind("step").any():
            found.append(f"{triad}bias steps")
    return tuple(found)


def drift_findings(evidence: ImuEvidence) -> list[Finding]:
    """Say how far the biases wandered or warmed up, where they did."""
    fit, findings = evidence.fit, list[Finding]()
    for k, triad in enumerate(("gyroscope", "accelerometer")):
        functions = (fit.data.of_gyroscope, fit.data.of_accelerometer)[k]
        per_si = _per_si(evidence, triad)
        smooth = functions.of_kind("walk", "line", "warm-up")
        if not smooth.any():
            continue
        moved = functions.at_rest[:, smooth] @ _coefficients(evidence, k)[smooth] / per_si
        size = float(np.abs(moved).max())
        if functions.of_kind("warm-up").any():
            findings.append(
                Finding(
                    severity="info",
                    code="warm-up",
                    message=f"The {triad}'s bias moved by up to {_shown(triad, float(np.ptp(moved, axis=0).max()))} "
                    f"like that of a sensor that warms up: with a time constant of {fit.changes[k].warm_up_s:.0f} s.",
                    consequence="The course is part of the model; the bias given is its mean over the recording, which "
                    "is not the one of the warm sensor.",
                    cure="Let the sensor warm up before it is used or calibrated.",
                )
            )
        elif size > 0:
            findings.append(
                Finding(
                    severity="info",
                    code=f"{triad}-drift",
                    message=f"The {triad}'s bias wandered by up to {_shown(triad, size)} during the recording.",
                    consequence="The wandering is part of the model; the bias given is its mean over time.",
                    cure="Let the sensor warm up before it is used or calibrated.",
                )
            )
    return findings


def step_findings(evidence: ImuEvidence, diagnostics: ImuDiagnostics) -> list[Finding]:
    """Say when biases stepped, what they were in each part, and which is given; and which rates were left out."""
    findings = [*_sensor_finding(evidence, diagnostics)]
    findings += [_step_finding(evidence, one) for one in diagnostics.bias_segments]
    functions = evidence.fit.data.of_gyroscope
    alone = functions.of_kind("single")
    if alone.any():
        marked = np.zeros(len(evidence.chosen.rests), dtype=bool)
        marked[evidence.rows] = functions.at_rest[:, alone].any(axis=1)
        several = int(marked.sum()) > 1
        findings.append(
            Finding(
                severity="info",
                code="rates-left-out",
                message=f"The gyroscope's mean in static interval{'s' if several else ''} {interval_numbers(marked)} "
                f"of {len(marked)} is not used: it does not go with the others.",
                consequence="Gravity of these intervals and the rotations beside them are used.",
                cure="Let go of the sensor in every attitude, and power it throughout.",
            )
        )
    return findings


def _sensor_finding(evidence: ImuEvidence, diagnostics: ImuDiagnostics) -> list[Finding]:
    """Say that from some rest on the accelerometer has other scales and axes: another sensor, or another range.

    Where too few rests are left behind a step of the gyroscope's bias to tell, it counts that gravity differs in most.
    """
    found = diagnostics.intervals
    at, severity = evidence.course.sensor, "problem"
    row = int(np.flatnonzero(evidence.chosen.rests.used)[at]) if at else 0
    if not row:
        for segments in diagnostics.bias_segments:
            for start, stop in zip(segments.start_s, segments.stop_s, strict=True):
                own = (found.start_s >= start) & (found.stop_s <= stop)
                if own.any() and np.mean(found.used[own]) < _MOST_USED:
                    row, severity = max(int(np.argmax(own)), 1), "warning"
    if not row:
        return _cluster_finding(evidence, diagnostics)
    return [
        Finding(
            severity="problem" if severity == "problem" else "warning",
            code="sensor-changed",
            message=f"Between {found.stop_s[row - 1]:.1f} s and {found.start_s[row]:.1f} s the accelerometer's scales "
            "or axes changed, not its bias alone: another sensor, another range, or another mounting from there on.",
            consequence="One calibration cannot be right for both parts.",
            cure=f"Cut the recording at {0.5 * (found.stop_s[row - 1] + found.start_s[row]):.1f} s and calibrate the "
            "parts one by one.",
        )
    ]


def _cluster_finding(evidence: ImuEvidence, diagnostics: ImuDiagnostics) -> list[Finding]:
    """Say that static intervals behind each other do not agree with the others: too few to tell what changed."""
    rests = diagnostics.intervals
    usable = np.flatnonzero(evidence.chosen.rests.used)
    ends = cluster(~rests.used[usable])
    if ends is None:
        return []
    first, last = usable[list(ends)]
    cuts = [0.5 * float(rests.stop_s[k - 1] + rests.start_s[k]) for k in (first, last + 1) if 0 < k < len(rests.used)]
    at = " and ".join(f"{cut:.1f} s" for cut in cuts)
    when = f"between {at}" if len(cuts) > 1 else f"from {at} on" if first else f"until {at}"
    marked = ~rests.used
    marked[:first], marked[last + 1 :] = False, False
    return [
        Finding(
            severity="warning",
            code="sensor-changed",
            message=f"Static intervals {interval_numbers(marked)} of {len(marked)} do not agree with the others, and "
            f"lie together: {when} something differs: another sensor, a knock, a clamp, or the temperature.",
            consequence="They are not used: the result holds for the rest of the recording alone.",
            cure=f"Find out what was changed there, cut the recording at {at}, and calibrate the longest part alone.",
        )
    ]


def _step_finding(evidence: ImuEvidence, one: BiasSegments) -> Finding:
    per_si = _per_si(evidence, one.triad)
    steps = np.diff(one.bias, axis=0) / per_si
    where = [
        f"{_shown(one.triad, float(np.abs(step).max()))} between {one.stop_s[k]:.1f} s and {one.start_s[k + 1]:.1f} s"
        for k, step in enumerate(steps)
    ]
    parts = [
        f"{one.start_s[k]:.0f} to {one.stop_s[k]:.0f} s: {' '.join(f'{x:.5g}' for x in one.bias[k] / per_si)}"
        for k in range(len(one.bias))
    ]
    unit = "rad/s" if one.triad == "gyroscope" else "m/s^2"
    more = f"; and {len(where) - _SHOWN} more" if len(where) > _SHOWN else ""
    t_s = evidence.accelerometer.t_s[evidence.accelerometer.intervals.start]
    few = int(np.sum(t_s >= one.start_s[one.published])) < _SHORT
    return Finding(
        severity="warning" if few else "info",
        code="bias-step",
        message=f"The {one.triad}'s bias stepped by {'; by '.join(where[:_SHOWN])}{more}, as after switching off and "
        "on, or where recordings were joined.",
        consequence="Each part has a bias of its own, and the rotation across the step is not used. The bias given is "
        f"that of the last part. Bias by parts [{unit}]: {'; '.join(parts[-_SHOWN:])}."
        + (f" The last part has fewer than {_SHORT} static intervals." if few else ""),
        cure="Power the sensor throughout, and estimate the bias anew after each switching on.",
    )


def _coefficients(evidence: ImuEvidence, k: int) -> Floats:
    """Return the coefficients (j, 3) [unit] of the functions of time of the gyroscope (k = 0) or accelerometer (1)."""
    fit, problem = evidence.fit, evidence.problem
    count = len(fit.data.of_gyroscope.kind)
    knots = fit.state.theta[PARAMETERS:].reshape(-1, 3)
    return (knots[:count] * problem.gyroscope.spread, knots[count:] * problem.accelerometer.spread)[k]


def _per_si(evidence: ImuEvidence, triad: str) -> Floats:
    """Return what one rad/s or m/s^2 reads on each axis, (3,) [unit]."""
    return np.linalg.norm(getattr(evidence.estimate, f"{triad}_sensitivity"), axis=1)


def _shown(triad: str, size: float) -> str:
    if triad == "gyroscope":
        return f"{1e3 * size:.2g} mrad/s ({np.degrees(size):.2g} deg/s)"
    return f"{1e3 * size:.2g} mm/s^2"
