"""Verdict and advice on a magnetometer: what to trust, what to do next; and what it was calibrated from, as tables."""

from collections.abc import Iterator

import numpy as np

from ...estimate.triads.attitudes import DipFit, GravityFit
from ...estimate.triads.field_poses import FieldPoses, field_of
from ...estimate.triads.magnetometer import MagnetometerFit
from ...estimate.triads.triad_trust import FEWEST_BLOCKS
from ...estimate.trust.parts import RobustCovariance
from ...findings import Finding, Severity, list_first, make_finding
from ...frozen import value_class
from ...recording import Floats, TriadSamples
from ...results.calibration import Assessment, Gravity, Holdout
from ...results.result import Booleans
from ...results.sensor_diagnostics import DipTable, PoseTable, TriadDiagnostics, TriadRecord, TriadTrial
from ...results.sensors import ImuCalibration
from ...units import MAGNETOMETER_UNITS_UT
from ..priors import NAMES, TRIADS, Prior, prior_findings
from ..verdict import bias_findings, grade_by_limits, parts_disagree, uncertainty_summary, with_verdict
from .imu_verdict import convergence_findings, entry_sigmas, mean_scale, scale_and_angle
from .poses_verdict import held_names

_MAGNETOMETER_HANDEDNESS_SIGNIFICANT = 4.0  # sigmas
_LEAST_DIP_DEG = 3.0
_TELLING_LATITUDE_DEG = 20.0
"""Farther from the equator than this the field dips as on that hemisphere everywhere on Earth."""
_OFF_DEG = 5.0
_TURNED_RAD = np.radians(60.0)  # as chips are mounted on purpose, or as an axis of the wrong sign looks


@value_class
class FieldFitSummary:
    """Everything that a magnetometer's calibration was made of.

    Attributes
    ----------
    t_s, values, usable : samples, their instants [s], and whether they are not clipped
    unit : of the samples
    field : strength of the field as stated [uT], or None
    stated_dip_deg, latitude_deg : as stated [deg], or None
    poses, fit : what was fitted, and the fit
    rivals : model -> fit
    up, dip : the accelerometer along, and how the magnetometer stands to it; None where that cannot be told
    accelerometer : its samples, or None
    dip_sigma_rad : of the dip; nan without
    imu, covariance : the result, and its covariance
    gravity : as it was taken
    trust : how far the parameters can be trusted, in the magnetometer's own frame
    """

    t_s: Floats
    values: Floats
    usable: Booleans
    unit: str
    field: float | None
    stated_dip_deg: float | None
    latitude_deg: float | None
    poses: FieldPoses
    fit: MagnetometerFit
    rivals: dict[str, MagnetometerFit]
    up: GravityFit | None
    accelerometer: TriadSamples | None
    dip: DipFit | None
    dip_sigma_rad: float
    imu: ImuCalibration
    covariance: Floats
    gravity: Gravity
    trust: RobustCovariance

    @property
    def strength(self) -> float:
        """Strength of the field in the unit of the calibrated field."""
        return self.field or 1.0

    @property
    def direction(self) -> Floats:
        """(n, 3) unit vectors of the field in each pose, body frame."""
        aligned = self.imu.accelerometer is not None and self.dip is not None
        return self.fit.direction @ self.dip.rotation.T if aligned and self.dip is not None else self.fit.direction


@value_class
class FieldOutliers:
    """Samples far off the ellipsoid: stretches of time [s], (m, 2), and how many stand alone."""

    stretches: Floats
    single: int


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


_ROWS, _ATTITUDES = 400, 200
_STRAY = 6.0  # sigmas
_STRETCH_S, _GAP_S = 0.5, 1.0
_FEWEST_IN_STRETCH = 4
_MAD = 1.4826


def field_outliers(evidence: FieldFitSummary) -> FieldOutliers:
    """Return where the strength of the field was not that of the place."""
    fit, t_s = evidence.fit, evidence.t_s
    error = sample_errors(evidence)
    pull = np.linalg.inv(fit.iron.sensitivity)
    by_noise = float(np.max(np.sum(pull**2 * evidence.poses.noise**2, axis=1)))
    far = np.abs(error) > _STRAY * np.sqrt(by_noise + fit.iron.extra_sigma**2)
    for start, stop in zip(evidence.poses.start[~fit.used], evidence.poses.stop[~fit.used], strict=True):
        far[start:stop] = True
    far = np.flatnonzero(far & evidence.usable)
    if not len(far):
        return FieldOutliers(stretches=np.empty((0, 2)), single=0)
    breaks = np.flatnonzero(np.diff(t_s[far]) > _GAP_S)
    first, last = np.concatenate([[0], breaks + 1]), np.concatenate([breaks, [len(far) - 1]])
    count = last - first + 1
    long = (t_s[far[last]] - t_s[far[first]] >= _STRETCH_S) & (count >= _FEWEST_IN_STRETCH)
    return FieldOutliers(
        stretches=np.column_stack([t_s[far[first[long]]], t_s[far[last[long]]]]), single=int(count[~long].sum())
    )


def sample_errors(evidence: FieldFitSummary) -> Floats:
    """Return |x| less the strength of the field of every sample, (n,)."""
    iron = evidence.fit.iron
    return np.linalg.norm(field_of(evidence.values, iron.sensitivity, iron.bias), axis=1) - evidence.strength


def describe_field(evidence: FieldFitSummary) -> TriadDiagnostics:
    """Return the tables."""
    fit, poses = evidence.fit, evidence.poses
    field = evidence.strength
    error = sample_errors(evidence)[evidence.usable]
    triads = {
        "magnetometer": TriadRecord(
            quantity="magnetic field",
            unit=evidence.unit,
            si_unit="uT" if evidence.field is not None else "",
            poses=_table(evidence, fit.used, poses.measured, evidence.direction, field),
            noise_sigma=float(np.median(np.sqrt(np.maximum(fit.sigma**2 - fit.iron.extra**2, 0.0)))),
            extra_sigma=fit.iron.extra_sigma,
        )
    }
    return TriadDiagnostics(
        kind="magnetometer",
        triads=triads,
        gravity=evidence.gravity if evidence.up is not None else None,
        dip=_dips(evidence),
        trials=tuple(
            TriadTrial(
                model=name,
                chosen=one is fit,
                holdout_rms=one.holdout_rms,
                parameters=9 if name == "full" else 4,
            )
            for name, one in evidence.rivals.items()
        ),
        noise={
            "magnetometer.sample_sigma": float(np.sqrt(np.mean(poses.noise**2))),
            "magnetometer.error_std": float(np.std(error)) / field,
            "magnetometer.error_spread": _MAD * float(np.median(np.abs(error - np.median(error)))) / field,
            "magnetometer.block_s": fit.blocks.length_s,
            "magnetometer.sigma_factor": fit.sigma_factor,
        },
        trust=evidence.trust.trust,
    )


def _table(evidence: FieldFitSummary, used: Booleans, measured: Floats, direction: Floats, field: float) -> PoseTable:
    fit, poses = evidence.fit, evidence.poses
    some = np.arange(0, len(poses), max(1, -(-len(poses) // _ROWS)))
    length = np.linalg.norm(measured, axis=1)
    return PoseTable(
        name=tuple(str(i + 1) for i in some),
        start_s=evidence.t_s[poses.start[some]],
        stop_s=evidence.t_s[poses.stop[some] - 1],
        samples=poses.samples[some],
        measured=measured[some],
        magnitude=np.full(len(some), field),
        direction=direction[some],
        error_before=(length[some] / np.median(length[used]) - 1) * field,
        error_after=fit.error[some],
        error_holdout=fit.error_holdout[some],
        sigma=fit.sigma[some],
        used=used[some],
        reason=tuple("" if one else "the strength of the field differs here" for one in used[some]),
    )


def _dips(evidence: FieldFitSummary) -> DipTable | None:
    dip, up = evidence.dip, evidence.up
    if dip is None or up is None:
        return None
    quiet = np.flatnonzero(dip.weight > 0)
    quiet = np.sort(quiet[np.argsort(dip.sigma[quiet], kind="stable")][:_ATTITUDES])
    sines = np.clip(dip.sine + dip.error[quiet], -1, 1)
    return DipTable(
        attitude=quiet.astype(np.float64) + 1,
        dip_rad=-np.arcsin(sines),
        estimated_rad=dip.dip_rad,
        sigma_rad=evidence.dip_sigma_rad,
    )
