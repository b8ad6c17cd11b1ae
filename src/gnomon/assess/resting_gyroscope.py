"""What rests show of a gyroscope (document B, section 5.2), and what they leave open."""

import numpy as np

from ..findings import Finding
from .pose_tables import RestingGyroscope

_DRIFT_SIGMAS = 5.0
_SCATTER = 3.0  # times the noise at rest


def gyroscope_findings(gyroscope: RestingGyroscope | None, why_not: str) -> list[Finding]:
    """Say what the rests show of a gyroscope.

    Parameters
    ----------
    gyroscope : None where it was not calibrated
    why_not : the reason, or "" where none was recorded
    """
    if gyroscope is None:
        if not why_not:
            return []
        return [
            Finding(
                severity="warning",
                code="gyroscope-not-calibrated",
                message=f"The gyroscope is not calibrated: {why_not}",
                consequence="The accelerometer's calibration does not suffer.",
            )
        ]
    findings = [
        _static_finding(gyroscope),
        *_rotation_findings(gyroscope),
        *_scale_findings(gyroscope),
        *_scatter_findings(gyroscope),
    ]
    if not gyroscope.timed:
        findings.append(
            Finding(
                severity="info",
                code="order-as-time",
                message="When the poses were measured is not known; their order stands for it.",
                consequence="A drift of the gyroscope is told from g-sensitivity by this order.",
                cure="Give a column t with the time of each pose.",
            )
        )
    if not gyroscope.latitude_known and gyroscope.sensitivity is not None:
        findings.append(
            Finding(
                severity="info",
                code="earth-rate-unknown",
                message="The Earth's vertical rate follows gravity like g-sensitivity: up to 7.4e-6 rad/s per m/s^2.",
                consequence="It is in the sigma of the g-sensitivity.",
                cure="State --latitude to have it taken off.",
            )
        )
    return findings


def _static_finding(gyroscope: RestingGyroscope) -> Finding:
    how = f"{len(gyroscope.used)} rests, {gyroscope.fit.degrees_of_freedom} more than a fit without error needs"
    if gyroscope.sensitivity is None:
        G = "; ".join(" ".join(f"{x:.3g}" for x in row) for row in gyroscope.g_sensitivity)
        return Finding(
            severity="info",
            code="static-experiment",
            message=f"The g-sensitivity comes from {how}: [{G}] {gyroscope.unit} per m/s^2, sensor axes by body axes.",
        )
    sigma = np.sqrt(np.diag(gyroscope.covariance)[24:33]).reshape(3, 3) * gyroscope.unit_rad_s[:, None]
    size = np.abs(gyroscope.g_sensitivity) * gyroscope.unit_rad_s[:, None]
    clear = int(np.sum(size > 2 * sigma))
    return Finding(
        severity="info",
        code="static-experiment",
        message=f"The gyroscope is judged by {how}. Its g-sensitivity is known to {sigma.max():.2g} rad/s per m/s^2 "
        f"(1 sigma, worst entry); {clear} of 9 entries are above twice their sigma.",
    )


def _rotation_findings(gyroscope: RestingGyroscope) -> list[Finding]:
    """Say what the rotations between few rests were used for, and of which gravity shows no angle."""
    turned, reasons = gyroscope.turned, gyroscope.rotation_reasons
    if turned is None:
        if not reasons:
            return []
        why = sorted({reason for reason in reasons if reason}) or ["counts tell no scale to count whole turns by"]
        return [
            Finding(
                severity="info",
                code="rotations-unused",
                message=f"{len(reasons)} rotations between the rests are not used: {'; '.join(why[:3])}.",
                consequence="The gyroscope's scales and axes are not measured by them.",
                cure="Rest in nine attitudes or more, with rotations that the gyroscope can follow between them.",
            )
        ]
    sensitivity = turned.sensitivity
    size = np.linalg.norm(sensitivity, axis=1)
    share = 100 * np.sqrt(np.diag(turned.covariance)[[0, 4, 8]]) / size
    named = [f"{axis} {share[k]:.2g} %" for k, axis in enumerate("xyz") if turned.measured[k]]
    said = f"known to {', '.join(named)} (1 sigma)" if named else "no better known by them"
    held = [axis for k, axis in enumerate("xyz") if not turned.measured[k]]
    findings = [
        Finding(
            severity="info",
            code="rotations-few-attitudes",
            message=f"{int(turned.used.sum())} of {len(turned.used)} rotations between the rests are used for the "
            f"gyroscope's scales and axes: scales are {said}; the rotations end within "
            f"{1e3 * turned.rms_rad:.2g} mrad rms of gravity.",
            consequence=f"The scale of {' and '.join(held)} is what the unit says." if held else "",
            cure="Turn about each axis while it is level, by a quarter turn or more." if held else "",
        )
    ]
    if turned.vertical.any():
        angles = ", ".join(f"{np.degrees(a):.1f}" for a in turned.angle_rad[turned.vertical][:6])
        findings.append(
            Finding(
                severity="info",
                code="turns-about-vertical",
                message=f"{int(turned.vertical.sum())} of the rotations were about the vertical: by {angles} deg, as "
                "the scales above say.",
                consequence="Gravity shows no angle about the vertical; they say nothing of the scale.",
                cure="Turn about level axes; a full turn from rest to rest is best.",
            )
        )
    return findings


def _scale_findings(gyroscope: RestingGyroscope) -> list[Finding]:
    if gyroscope.sensitivity is None:
        return [
            Finding(
                severity="warning",
                code="gyroscope-scale-unknown",
                message="Rests do not show the gyroscope's scale, and counts do not tell it.",
                consequence="The calibration holds the accelerometer alone.",
                cure="Give a calibration of the gyroscope with --prior, or samples in rad/s or deg/s.",
            )
        ]
    if not gyroscope.assumed:
        return []
    if gyroscope.turned is not None and gyroscope.turned.measured.any():
        return []  # said with the rotations
    return [
        Finding(
            severity="info",
            code="gyroscope-scale-assumed",
            message=f"Rests do not show the gyroscope's scales and axes: they are what {gyroscope.unit} says, give or "
            "take 3 % and 30 mrad.",
            consequence="Bias and g-sensitivity depend on them only by what a stated latitude takes off for the "
            "Earth's rate.",
            cure="Give a calibration with --prior, or "
            + (
                "turn about each axis while it is level."
                if gyroscope.rotation_reasons
                else "record rotations between the rests, too."
            ),
        )
    ]


def _scatter_findings(gyroscope: RestingGyroscope) -> list[Finding]:
    """Say how far bias and drift move the means, where noise does not explain it."""
    unit = gyroscope.unit_rad_s if gyroscope.sensitivity is not None else np.ones(3)
    name = "rad/s" if gyroscope.sensitivity is not None else gyroscope.unit
    drift = float(np.max(np.ptp(gyroscope.fit.drift, axis=0) * unit))
    noise = float(np.sqrt(np.mean(gyroscope.variance * unit**2)))
    scatter = float(np.max(gyroscope.fit.extra_sigma * unit))
    findings: list[Finding] = []
    if noise > 0 and drift > _DRIFT_SIGMAS * noise:
        findings.append(
            Finding(
                severity="info",
                code="gyroscope-drift",
                message=f"The gyroscope's bias drifted by {drift:.2g} {name} during the recording.",
                consequence="The drift is part of the model; the bias given is its mean over the poses.",
                cure="Let the sensor warm up before it is used or calibrated.",
            )
        )
    if noise > 0 and scatter > _SCATTER * noise:
        findings.append(
            Finding(
                severity="info",
                code="rests-scatter",
                message=f"The gyroscope's means scatter by {scatter:.2g} {name} more than their noise of {noise:.2g}.",
                consequence="The sigmas account for it.",
                cure="Rest longer in each attitude and repeat attitudes, so that more of the scatter averages out.",
            )
        )
    return findings
