"""What rests show of a gyroscope (document B, section 5.2), and what they leave open."""

import numpy as np

from ..findings import Finding, make_finding
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
        return [make_finding("gyroscope-not-calibrated", why_not=why_not)]
    findings = [
        _static_finding(gyroscope),
        *_rotation_findings(gyroscope),
        *_scale_findings(gyroscope),
        *_scatter_findings(gyroscope),
    ]
    if not gyroscope.timed:
        findings.append(make_finding("order-as-time"))
    if not gyroscope.latitude_known and gyroscope.sensitivity is not None:
        findings.append(make_finding("earth-rate-unknown"))
    return findings


def _static_finding(gyroscope: RestingGyroscope) -> Finding:
    how = f"{len(gyroscope.used)} rests, {gyroscope.fit.degrees_of_freedom} more than a fit without error needs"
    if gyroscope.sensitivity is None:
        G = "; ".join(" ".join(f"{x:.3g}" for x in row) for row in gyroscope.g_sensitivity)
        return make_finding("static-experiment/none", how=how, g=G, unit=gyroscope.unit)
    sigma = np.sqrt(np.diag(gyroscope.covariance)[24:33]).reshape(3, 3) * gyroscope.unit_rad_s[:, None]
    size = np.abs(gyroscope.g_sensitivity) * gyroscope.unit_rad_s[:, None]
    clear = int(np.sum(size > 2 * sigma))
    return make_finding("static-experiment/found", how=how, sigma=sigma.max(), clear=clear)


def _rotation_findings(gyroscope: RestingGyroscope) -> list[Finding]:
    """Say what the rotations between few rests were used for, and of which gravity shows no angle."""
    turned, reasons = gyroscope.turned, gyroscope.rotation_reasons
    if turned is None:
        if not reasons:
            return []
        why = sorted({reason for reason in reasons if reason}) or ["counts tell no scale to count whole turns by"]
        return [make_finding("rotations-unused", count=len(reasons), why="; ".join(why[:3]))]
    sensitivity = turned.sensitivity
    size = np.linalg.norm(sensitivity, axis=1)
    share = 100 * np.sqrt(np.diag(turned.covariance)[[0, 4, 8]]) / size
    named = [f"{axis} {share[k]:.2g} %" for k, axis in enumerate("xyz") if turned.measured[k]]
    said = f"known to {', '.join(named)} (1 sigma)" if named else "no better known by them"
    held = [axis for k, axis in enumerate("xyz") if not turned.measured[k]]
    findings = [
        make_finding(
            "rotations-few-attitudes",
            case="held" if held else "",
            rotations=int(turned.used.sum()),
            total=len(turned.used),
            said=said,
            rms_rad=turned.rms_rad,
            held=" and ".join(held),
        )
    ]
    if turned.vertical.any():
        angles = ", ".join(f"{np.degrees(a):.1f}" for a in turned.angle_rad[turned.vertical][:6])
        findings.append(make_finding("turns-about-vertical", count=int(turned.vertical.sum()), angles=angles))
    return findings


def _scale_findings(gyroscope: RestingGyroscope) -> list[Finding]:
    if gyroscope.sensitivity is None:
        return [make_finding("gyroscope-scale-unknown")]
    if not gyroscope.assumed:
        return []
    if gyroscope.turned is not None and gyroscope.turned.measured.any():
        return []  # said with the rotations
    return [
        make_finding(
            "gyroscope-scale-assumed",
            unit=gyroscope.unit,
            case="not-level" if gyroscope.rotation_reasons else "",
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
        findings.append(make_finding("gyroscope-drift/rests", drift=drift, unit=name))
    if noise > 0 and scatter > _SCATTER * noise:
        findings.append(make_finding("rests-scatter", scatter=scatter, unit=name, noise=noise))
    return findings
