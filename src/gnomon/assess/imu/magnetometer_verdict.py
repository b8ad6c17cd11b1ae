"""Verdict and advice on a magnetometer's calibration: what to trust, what to do next."""

from collections.abc import Iterator

import numpy as np

from ...estimate.triads.triad_trust import FEWEST_BLOCKS
from ...findings import Finding, Severity, list_first, make_finding
from ...recording import Floats
from ...results.calibration import Assessment, Holdout
from ...units import MAGNETOMETER_UNITS_UT
from ..priors import NAMES, TRIADS, Prior, prior_findings
from ..verdict import bias_findings, grade_by_limits, parts_disagree, uncertainty_summary, with_verdict
from .imu_verdict import convergence_findings, entry_sigmas, mean_scale, scale_and_angle
from .magnetometer_tables import FieldFitSummary, FieldOutliers, field_outliers
from .poses_verdict import held_names

_MAGNETOMETER_HANDEDNESS_SIGNIFICANT = 4.0  # sigmas
_LEAST_DIP_DEG = 3.0
_TELLING_LATITUDE_DEG = 20.0
"""Farther from the equator than this the field dips as on that hemisphere everywhere on Earth."""
_OFF_DEG = 5.0
_TURNED_RAD = np.radians(60.0)  # as chips are mounted on purpose, or as an axis of the wrong sign looks


def handedness_findings(evidence: FieldFitSummary) -> list[Finding]:
    """Compare the dip with the stated one, or with that of the stated latitude; say where neither is known."""
    if evidence.dip is None or evidence.imu.accelerometer is None:
        return []
    found, sigma = np.degrees(evidence.dip.dip_rad), np.degrees(evidence.dip_sigma_rad)
    stated, latitude = evidence.stated_dip_deg, evidence.latitude_deg
    telling = abs(found) > max(_LEAST_DIP_DEG, _MAGNETOMETER_HANDEDNESS_SIGNIFICANT * sigma)
    if stated is not None and abs(stated) > _LEAST_DIP_DEG:
        expected, by = float(np.sign(stated)), f"the stated dip, {stated:g} deg"
    elif latitude is not None and abs(latitude) >= _TELLING_LATITUDE_DEG:
        expected, by = float(np.sign(latitude)), f"latitude {latitude:g} deg"
    else:
        near_equator = stated is None and latitude is not None
        turned = _turned_rad(evidence) if telling and found < 0 and not near_equator else 0.0
        return [_unchecked(found, near_equator=near_equator, turned_rad=turned)]
    if not telling:
        return [_unchecked(found, near_equator=True)]
    if np.sign(found) != expected:
        return [make_finding("magnetometer-handedness/wrong", found=found, by=by)]
    checked = make_finding("magnetometer-handedness/good", by=by)
    if stated is None or abs(found - stated) <= max(_OFF_DEG, _MAGNETOMETER_HANDEDNESS_SIGNIFICANT * sigma):
        return [checked]
    return [
        checked,
        make_finding("magnetometer-dip", found=found, sigma=sigma, stated=stated),
    ]


def _turned_rad(evidence: FieldFitSummary) -> float:
    """Return by what angle the magnetometer's axes are turned to the accelerometer's [rad]."""
    assert evidence.imu.magnetometer is not None
    left, _, right = np.linalg.svd(evidence.imu.magnetometer.sensitivity)
    return float(np.arccos(np.clip((np.trace(left @ right) - 1) / 2, -1, 1)))


def _unchecked(found_deg: float, *, near_equator: bool, turned_rad: float = 0.0) -> Finding:
    """Say that nothing told the handedness; loudly where the field dips as for few people, and the axes are turned.

    An axis that was negated north of the equator makes both. Boards whose magnetometer lies otherwise than the
    accelerometer turn the axes alone, and a field in the south alone dips upwards.
    """
    likely = turned_rad > _TURNED_RAD
    turned = f" The magnetometer's axes are turned by {np.degrees(turned_rad):.0f} deg to the accelerometer's."
    return make_finding(
        "magnetometer-handedness/unchecked",
        severity="warning" if likely else "info",
        case="near-equator" if near_equator else "",
        why="there the sign of the dip tells nothing" if near_equator else "neither --dip nor --latitude was stated",
        found_deg=found_deg,
        hemisphere="north" if found_deg > 0 else "south",
        turned=turned if likely else "",
    )


_COVER_RAD, _COVER_POINTS = np.radians(20.0), 200
_COVER_WARN = 0.7
_ALIGNED_WARN_RAD = 0.02
_EARTH_UT = (22.0, 67.0)
_LASTING = 0.2
"""Of the time: while a sensor is turned, iron is not as near to it for so long."""
_STRAY_WARN = 0.1
_MOST_NAMED = 5
_SIGNIFICANT = 4.0  # sigmas of a sum of squares


def assess_field(
    noticed: tuple[Finding, ...], evidence: FieldFitSummary, known: Prior, beside_accelerometer: bool
) -> Assessment:
    """Judge a calibration.

    Parameters
    ----------
    noticed : what was found while the recording was checked
    evidence : what the calibration was made of
    known : what was known beforehand
    beside_accelerometer : whether there was an accelerometer that could be used
    """
    fit = evidence.fit
    found = field_outliers(evidence)
    findings = [
        *noticed,
        *_holdout_findings(evidence),
        *_uncertainty_findings(evidence),
        *_coverage_findings(evidence),
        *_stray_findings(evidence, found),
        *_correlation_findings(evidence),
        *_strength_findings(evidence),
        *_alignment_findings(evidence, beside_accelerometer),
        *handedness_findings(evidence),
        *_left_out_findings(evidence),
        *_held_findings(evidence),
        *_prior_findings(evidence, known),
        *parts_disagree(evidence.trust.trust.splits),
        *bias_findings(
            evidence.trust.instabilities,
            {"magnetometer": mean_scale(evidence.fit.iron.sensitivity) * evidence.strength},
        ),
        *convergence_findings(fit.iron.converged, fit.iron.iterations),
    ]
    assessment = Assessment(
        model=fit.model,
        holdout=Holdout(field_rms=fit.holdout_rms / evidence.strength),
        intervals_found=len(fit.used),
        intervals_used=int(fit.used.sum()),
        held_by_prior=_held(evidence),
        trust=uncertainty_summary(evidence.trust.trust),
    )
    return with_verdict(assessment, findings)


def _holdout_findings(evidence: FieldFitSummary) -> list[Finding]:
    fit, field = evidence.fit, evidence.strength
    noise = float(np.sqrt(np.mean((fit.sigma**2 - fit.iron.extra**2)[fit.used]))) / field
    total = fit.holdout_rms / field
    unexplained = float(np.sqrt(max(total**2 - noise**2, 0.0)))
    severity = grade_by_limits("held-out field", unexplained)
    return [make_finding("holdout-magnetometer", severity=severity, total=total, noise=noise)]


def _uncertainty_findings(evidence: FieldFitSummary) -> Iterator[Finding]:
    magnetometer = evidence.imu.magnetometer
    assert magnetometer is not None
    rows = np.linalg.norm(magnetometer.sensitivity, axis=1)
    sigma = np.sqrt(np.diag(evidence.covariance)[-12:])
    # A common rotation of all axes is no matter of this; it is judged with the accelerometer.
    basis = evidence.fit.iron.basis[:9]
    scale, angle = scale_and_angle(entry_sigmas(magnetometer.sensitivity, basis @ evidence.fit.covariance @ basis.T))
    offset = float((sigma[9:] / rows).max()) / evidence.strength
    severity = grade_by_limits("magnetometer", max(scale, angle, offset))
    yield make_finding(
        "uncertainty-magnetometer",
        severity=severity,
        offset=offset,
        scale=scale,
        angle=angle,
        advice=_missing(evidence)[0] or "Record longer, in one place away from iron.",
    )


def sphere_points(count: int) -> Floats:
    """Return points spread evenly over the sphere, (count, 3), by a Fibonacci lattice."""
    k = np.arange(count)
    z, longitude = 1 - (2 * k + 1) / count, np.pi * (1 + np.sqrt(5)) * k
    across = np.sqrt(1 - z * z)
    return np.column_stack([across * np.cos(longitude), across * np.sin(longitude), z])


def sphere_coverage(direction: Floats) -> tuple[float, Floats]:
    """Return which share of the sphere lies within 20 deg of some direction (n, 3), and the emptiest point (3,)."""
    points = sphere_points(_COVER_POINTS)
    nearest = np.max(points @ direction.T, axis=1)
    return float(np.mean(nearest > np.cos(_COVER_RAD))), points[np.argmin(nearest)]


def _missing(evidence: FieldFitSummary) -> tuple[str, float]:
    """Return what to do about the largest hole, if there is one, and the share of the sphere that is covered."""
    share, hole = sphere_coverage(evidence.direction[evidence.fit.used])
    if share > 0.95:
        return "", share
    axes = [f"{'-' if value < 0 else ''}{axis}" for axis, value in zip("xyz", hole, strict=True) if abs(value) > 0.5]
    dip = evidence.dip.dip_rad if evidence.dip is not None else float("nan")
    where = " (north and steeply down, in the northern hemisphere)" if not np.isfinite(dip) or dip > 0.7 else ""
    return f"Turn the sensor until {' and '.join(axes)} point{'s' * (len(axes) == 1)} along the field{where}.", share


def _coverage_findings(evidence: FieldFitSummary) -> list[Finding]:
    cure, share = _missing(evidence)
    severity: Severity = "warning" if share < _COVER_WARN else "good"
    return [make_finding("magnetometer-coverage", severity=severity, share=share, cure=cure)]


def _stray_findings(evidence: FieldFitSummary, found: FieldOutliers) -> list[Finding]:
    findings: list[Finding] = []
    if len(found.stretches):
        share = float(np.sum(found.stretches[:, 1] - found.stretches[:, 0])) / float(np.ptp(evidence.t_s))
        longest = float(np.ptp(found.stretches, axis=1).max())
        findings.append(
            make_finding(
                "magnetometer-disturbed",
                severity="warning" if share > _STRAY_WARN else "info",
                case="lasting" if longest > _LASTING * np.ptp(evidence.t_s) else "",
                named=list_first([f"{low:.1f}-{high:.1f} s" for low, high in found.stretches], _MOST_NAMED),
                share=share,
            )
        )
    if found.single:
        share = found.single / len(evidence.t_s)
        findings.append(
            make_finding(
                "magnetometer-outliers",
                severity="warning" if share > _STRAY_WARN else "info",
                case="many" if share > _STRAY_WARN else "",
                single=found.single,
                share=share,
            )
        )
    return findings


def _correlation_findings(evidence: FieldFitSummary) -> list[Finding]:
    fit = evidence.fit
    findings = [
        make_finding(
            "magnetometer-correlated",
            severity="info" if fit.sigma_factor > 2 else "good",
            length_s=fit.blocks.length_s,
            sigma_factor=fit.sigma_factor,
        )
    ]
    if not fit.blocks.long_enough:
        findings.append(make_finding("magnetometer-short", fewest_blocks=FEWEST_BLOCKS))
    return findings


def _strength_findings(evidence: FieldFitSummary) -> Iterator[Finding]:
    """Say how strong the field is by the unit of the recording, and whether that can be."""
    magnetometer = evidence.imu.magnetometer
    assert magnetometer is not None
    factor = MAGNETOMETER_UNITS_UT.get(evidence.unit)
    if factor is None:
        return
    shown = mean_scale(magnetometer.sensitivity) * evidence.strength * factor
    likely = _EARTH_UT[0] < shown < _EARTH_UT[1]
    stated = "" if evidence.field is None else f"; {evidence.field:.3g} uT was stated"
    if not likely:
        yield make_finding("magnetometer-field/implausible", unit=evidence.unit, shown=shown, stated=stated)
        return
    yield make_finding(
        "magnetometer-field/stated",
        case="field-known" if evidence.field is not None else "",
        unit=evidence.unit,
        shown=shown,
        stated=stated,
    )


def _alignment_findings(evidence: FieldFitSummary, beside_accelerometer: bool) -> list[Finding]:
    dip = evidence.dip
    if not beside_accelerometer:
        return [make_finding("magnetometer-alone")]
    if dip is None or evidence.imu.accelerometer is None:
        return [make_finding("magnetometer-alignment/unknown")]
    iron = evidence.fit.iron
    words = f"The field dips by {np.degrees(dip.dip_rad):.2f} +- {np.degrees(evidence.dip_sigma_rad):.2f} deg"
    sigma = _alignment_sigma(evidence)
    if iron.in_own_frame:
        words += f"; the magnetometer's frame is known in that of the accelerometer to {1e3 * sigma:.2g} mrad"
    severity: Severity = "warning" if sigma > _ALIGNED_WARN_RAD else "info"
    return [make_finding("magnetometer-alignment/known", severity=severity, words=words)]


def _alignment_sigma(evidence: FieldFitSummary) -> float:
    """Return the largest sigma of a direction of the sensitivity, rotation included [rad]."""
    magnetometer = evidence.imu.magnetometer
    assert magnetometer is not None
    return scale_and_angle(entry_sigmas(magnetometer.sensitivity, evidence.covariance[-12:-3, -12:-3]))[1]


def _left_out_findings(evidence: FieldFitSummary) -> list[Finding]:
    """Say how much soft iron the hard-iron model leaves out, where that is no chance."""
    fit, full = evidence.fit, evidence.rivals.get("full")
    if fit.model == "full" or full is None:
        return []
    count = int(np.any(full.iron.basis[:9] != 0, axis=0).sum())
    # The common scale belongs to both models.
    scale = np.linalg.norm(fit.iron.sensitivity) / np.sqrt(3)
    left_out = fit.left_out[:, 0]
    shape = (full.iron.basis[:9] @ left_out).reshape(3, 3) / scale
    shape = shape - np.trace(shape) / 3 * np.eye(3)
    inverse = np.linalg.pinv(full.covariance[:count, :count], rcond=1e-10, hermitian=True)
    chi_squared = float(left_out[:count] @ inverse @ left_out[:count])
    if chi_squared < count + _SIGNIFICANT * np.sqrt(2 * count):
        return []
    return [make_finding("soft-iron-left-out", shape=np.abs(shape).max())]


def _held(evidence: FieldFitSummary) -> tuple[str, ...]:
    return held_names("magnetometer", evidence.fit.iron.held_by_prior)


def _held_findings(evidence: FieldFitSummary) -> Iterator[Finding]:
    held = _held(evidence)
    if not held:
        return
    yield make_finding(
        "not-observable/magnetometer",
        count=len(held),
        advice=_missing(evidence)[0] or "Turn the sensor through all attitudes.",
    )


def _prior_findings(evidence: FieldFitSummary, known: Prior) -> list[Finding]:
    """Compare with the prior where both are in the frame of the result."""
    values, covariance = np.zeros(len(NAMES)), np.eye(len(NAMES)) * 1e300
    at, rest = TRIADS["magnetometer"], len(evidence.covariance)
    magnetometer = evidence.imu.magnetometer
    assert magnetometer is not None
    values[at] = np.concatenate([magnetometer.sensitivity.ravel(), magnetometer.bias])
    covariance[at, at] = evidence.covariance[rest - 12 :, rest - 12 :]
    return prior_findings(known, values, covariance)
