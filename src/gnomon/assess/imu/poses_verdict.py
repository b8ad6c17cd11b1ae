"""Verdict and advice on a calibration from rests: what to trust, what to do next.

Also what it shares with those on turntables and magnetometers, the other calibrations from known magnitudes.
"""

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np

from ...estimate.triads.angrisano import AngrisanoFit
from ...estimate.triads.triad import SIGNIFICANT, PoseDrift, PoseStep
from ...estimate.triads.triad_problem import B_, S_
from ...estimate.trust.parts import RobustCovariance
from ...findings import Finding, list_first, make_finding
from ...recording import Floats
from ...results.calibration import AccelerometerCalibration, Assessment, Gravity, Holdout
from ...results.result import Booleans
from ...results.sensor_diagnostics import PoseTable, TriadDiagnostics
from ...results.sensors import element_names
from ..priors import NAMES, TRIADS
from ..verdict import (
    bias_findings,
    grade_by_limits,
    gravity_findings,
    model_incomplete,
    most_severe,
    parts_disagree,
    uncertainty_summary,
    with_verdict,
)
from .imu_tables import root_mean_square
from .imu_verdict import ATTITUDES, attitude_words, entry_sigmas, mean_scale, scale_and_angle, unit_findings
from .pose_tables import PoseFitSummary, RestingGyroscope, gyroscope_findings

if TYPE_CHECKING:
    from ...estimate.triads.triad import TriadFit

_AXES = "xyz"
_DETERMINED = 9  # attitudes
_NAMED = 4
_DRIFT_WARN = 0.03  # m/s^2
_STEP_POSES = 3  # on either side of a step, for it to be more than poses that are off
_OPEN, _OPEN_WARN = 0.5, 0.8  # of a usual drift, that the poses do not tell
_OF_ROTATIONS = {"saturation", "gaps", "static-start", "time-rounded", "jitter", "gyroscope-missing"}


def assess_poses(evidence: PoseFitSummary, diagnostics: TriadDiagnostics) -> Assessment:
    """Judge a calibration of an accelerometer, and of a gyroscope at rest.

    Parameters
    ----------
    evidence : what the calibration was made of
    diagnostics : its tables
    """
    record, gyroscope = diagnostics.triads["accelerometer"], evidence.gyroscope
    table = record.poses
    holdout = Holdout(accelerometer_rms=_holdout(table), rate_rms=_rate_holdout(gyroscope))
    findings = [
        *[f for f in evidence.noticed if f.severity in ("warning", "info") and f.code not in _OF_ROTATIONS],
        *_attitude_findings(evidence),
        *scatter_findings(evidence.fit, record.noise_sigma, evidence.gravity.value, "m/s^2"),
        *_holdout_findings(holdout.accelerometer_rms, evidence.gravity.value),
        *_uncertainty_findings(evidence),
        *_observability_findings(evidence),
        *_stated_findings(evidence),
        *_drift_findings(evidence.drift),
        *_step_findings(evidence.step, table.name),
        *unit_findings("accelerometer", evidence.fit.sensitivity, evidence.poses.accelerometer_unit),
        *left_out_poses_findings(table, evidence.left_out),
        *gravity_findings(evidence.gravity),
        *gyroscope_findings(gyroscope, evidence.no_gyroscope),
        *triad_trust_findings([(evidence.trust, evidence.fit)]),
        *_convergence(evidence),
    ]
    assessment = Assessment(
        model=_model(gyroscope),
        holdout=holdout,
        intervals_found=len(table.used) + len(evidence.left_out),
        intervals_used=int(table.used.sum()),
        held_by_prior=_held(evidence),
        trust=uncertainty_summary(evidence.trust.trust),
    )
    return with_verdict(assessment, findings)


def assess_published(
    noticed: tuple[Finding, ...],
    left_out: tuple[tuple[str, str], ...],
    *,
    fit: AngrisanoFit,
    sensor: AccelerometerCalibration,
    diagnostics: TriadDiagnostics,
    gravity: Gravity,
) -> Assessment:
    """Judge what Angrisano's iteration came to."""
    table = diagnostics.triads["accelerometer"].poses
    holdout = Holdout(accelerometer_rms=_holdout(table))
    findings = [
        *(finding for finding in noticed if finding.severity != "good"),
        _iteration_finding(fit),
        *(_holdout_findings(holdout.accelerometer_rms, gravity.value) if fit.converged else ()),
        *unit_findings("accelerometer", sensor.sensitivity, sensor.unit),
        *left_out_poses_findings(table, left_out),
        *gravity_findings(gravity),
    ]
    assessment = Assessment(
        model="none",
        holdout=holdout,
        intervals_found=len(table.used) + len(left_out),
        intervals_used=len(table.used),
    )
    return with_verdict(assessment, findings)


def _drift_findings(drift: PoseDrift | None) -> list[Finding]:
    """Say how far the bias moved from the first pose to the last, and where nothing tells it."""
    if drift is None:
        return []
    size, sigma = float(np.linalg.norm(drift.change)), float(np.linalg.norm(drift.sigma))
    findings: list[Finding] = []
    if (np.abs(drift.change) > SIGNIFICANT * drift.sigma).any():
        moved = ", ".join(f"{1e3 * value:.2g}" for value in drift.change)
        findings.append(
            make_finding(
                "accelerometer-drift", severity="warning" if size > _DRIFT_WARN else "info", moved=moved, sigma=sigma
            )
        )
    if (drift.open > _OPEN).any():
        axes = " and ".join(_AXES[axis] for axis in np.flatnonzero(drift.open > _OPEN))
        severity = "warning" if drift.open.max() > _OPEN_WARN else "info"
        findings.append(make_finding("drift-not-told", severity=severity, axes=axes, sigma=sigma))
    return findings


def _step_findings(step: PoseStep | None, names: tuple[str, ...]) -> list[Finding]:
    """Say that a step of the bias would explain what the fit does not."""
    if step is None:
        return []
    moved = ", ".join(f"{1e3 * value:.2g}" for value in step.change)
    severity = "warning" if step.shorter > _STEP_POSES else "info"
    before, after = names[step.after], names[step.after + 1]
    return [make_finding("accelerometer-step", severity=severity, moved=moved, before=before, after=after)]


def _model(gyroscope: RestingGyroscope | None) -> str:
    if gyroscope is None or gyroscope.sensitivity is None:
        return "none"
    return "g-sensitivity" if gyroscope.g_sensitivity.any() else "basic"


def _holdout(table: PoseTable) -> float:
    known = table.used & np.isfinite(table.error_holdout)
    return root_mean_square(table.error_holdout[known])


def _rate_holdout(gyroscope: RestingGyroscope | None) -> float:
    if gyroscope is None or gyroscope.sensitivity is None:
        return float("nan")
    return root_mean_square(gyroscope.fit.holdout * gyroscope.unit_rad_s)


def _attitude_findings(evidence: PoseFitSummary) -> list[Finding]:
    count, n = evidence.attitudes, len(evidence.poses)
    message = f"{n} poses in {count} attitudes more than 10 deg apart."
    if evidence.known.knows("imu0.accelerometer.sensitivity"):
        return []
    if evidence.stated is None and count < _DETERMINED:
        return [make_finding("few-attitudes", message=message)]
    return redundancy_findings(evidence.fit) or [make_finding("attitudes/poses", message=message)]


def _holdout_findings(holdout_m_s2: float, gravity_m_s2: float) -> list[Finding]:
    if not np.isfinite(holdout_m_s2):
        return []
    severity = grade_by_limits("held-out gravity", holdout_m_s2, gravity_m_s2)
    return [make_finding("holdout-accelerometer/poses", severity=severity, holdout_m_s2=holdout_m_s2)]


def _uncertainty_findings(evidence: PoseFitSummary) -> Iterator[Finding]:
    fit, gravity = evidence.fit, evidence.gravity
    sigma = relative_sigmas(fit)
    scale = float(np.sqrt(np.maximum(np.diag(sigma) ** 2 - (gravity.sigma / gravity.value) ** 2, 0)).max())
    _, angle = scale_and_angle(sigma)
    own_frame = evidence.stated is None
    severity = grade_by_limits("scale", scale)
    if own_frame and evidence.attitudes >= _DETERMINED:  # few-attitudes says it of fewer, jig-alignment of known ones
        severity = most_severe(severity, grade_by_limits("axes", angle))
    axes = "its axes" if own_frame else "its axes in the jig"
    yield make_finding(
        "uncertainty-accelerometer",
        severity=severity,
        scale=scale,
        axes=axes,
        angle=angle,
        advice=farthest_attitude(fit.direction[fit.used]),
    )


def farthest_attitude(direction: Floats) -> str:
    """Name the attitude that is farthest from all that were recorded, as unit vectors (n, 3)."""
    u = ATTITUDES / np.linalg.norm(ATTITUDES, axis=1, keepdims=True)
    nearest = (u @ direction.T).max(axis=1) - 1e-3 * np.count_nonzero(ATTITUDES == 0, axis=1)
    return f"Add poses with {attitude_words(ATTITUDES[np.argmin(nearest)])}."


def _observability_findings(evidence: PoseFitSummary) -> list[Finding]:
    held = evidence.fit.held_by_prior
    groups = (("scales and axes", S_), ("bias", B_))
    return [
        make_finding(
            "not-observable/poses",
            count=int(held[part].sum()),
            what=what,
            advice=farthest_attitude(evidence.fit.direction[evidence.fit.used]),
        )
        for what, part in groups
        if held[part].any()
    ]


def _stated_findings(evidence: PoseFitSummary) -> list[Finding]:
    """Judge the attitudes that were stated, and say how the sensor lies in the jig."""
    stated = evidence.stated
    if stated is None:
        return []
    findings: list[Finding] = []
    for k in np.flatnonzero(stated.wrong)[:_NAMED]:
        guess = f" It fits with {stated.guess[k]}." if stated.guess[k] else ""
        findings.append(
            make_finding(
                "attitude-misstated/pose", name=evidence.poses.name[k], angle_rad=stated.angle_rad[k], guess=guess
            )
        )
    if int(stated.wrong.sum()) > _NAMED:
        names = ", ".join(evidence.poses.name[k] for k in np.flatnonzero(stated.wrong)[_NAMED:])
        findings.append(make_finding("attitude-misstated/others", names=names))
    if stated.mirrored:
        findings.append(make_finding("jig-mirrored"))
    return [*findings, _jig_finding(evidence)]


def _jig_finding(evidence: PoseFitSummary) -> Finding:
    assert evidence.stated is not None
    rows = evidence.fit.sensitivity / np.linalg.norm(evidence.fit.sensitivity, axis=1, keepdims=True)
    along = np.argmax(np.abs(rows), axis=1)
    words = [f"{_AXES[i]} along {'-' if rows[i, along[i]] < 0 else '+'}{_AXES[along[i]]}" for i in range(3)]
    off = float(np.degrees(np.arccos(np.clip(np.abs(rows[np.arange(3), along]), 0, 1)).max()))
    sigma = np.degrees(evidence.stated.sigma_rad)
    return make_finding("jig-alignment", words=", ".join(words), off=off, sigma=sigma)


def left_out_poses_findings(table: PoseTable, left_out: tuple[tuple[str, str], ...]) -> list[Finding]:
    """Name the poses that were not used, and why."""
    named = [*left_out, *((table.name[k], table.reason[k]) for k in np.flatnonzero(~table.used))]
    if not named:
        return []
    total = len(table.used) + len(left_out)
    listed = [f"{name} ({reason})" for name, reason in named]
    return [
        make_finding(
            "poses-left-out",
            severity="warning" if len(named) > 0.1 * total else "info",
            count=len(named),
            total=total,
            listed=list_first(listed, _NAMED, "; "),
        )
    ]


def _held(evidence: PoseFitSummary) -> tuple[str, ...]:
    """Return the YAML paths of scalars that an assumption holds, not the poses."""
    held = evidence.fit.held_by_prior[:12].copy()
    if evidence.stated is None and evidence.attitudes < _DETERMINED:
        held[[3, 6, 7]] |= not evidence.known.knows("imu0.accelerometer.sensitivity")
    gyroscope, found = evidence.gyroscope, held_names("accelerometer", held)
    if gyroscope is not None and gyroscope.sensitivity is not None and gyroscope.assumed:
        return *found, *element_names("imu0.gyroscope.sensitivity", (3, 3))
    return found


def _convergence(evidence: PoseFitSummary) -> list[Finding]:
    if evidence.fit.converged:
        return []
    return [make_finding("not-converged/poses", iterations=evidence.fit.iterations)]


def _iteration_finding(fit: AngrisanoFit) -> Finding:
    """Say how Angrisano's iteration ended."""
    angles, bias, scale = fit.group_sigma
    if fit.converged:
        return make_finding("iteration", iterations=fit.iterations, angles=angles, bias=bias, scale=scale)
    ends = {
        "mirrored": "an axis reversed; its sign was fixed",
        "wrong": f"a wrong minimum, which leaves {fit.residual_rms:.2g} m/s^2 unexplained in each pose",
        "diverged": "nowhere: the equations became singular",
        "not finished": "nowhere: the allowed number of steps is used up",
    }
    mended = fit.status == "mirrored"
    return make_finding(
        "wrong-minimum",
        severity="warning" if mended else "problem",
        case="mended" if mended else "",
        iterations=fit.iterations,
        end=ends[fit.status],
    )


_BEYOND_NOISE = 3.0  # times the noise of a mean, from where the noise is not the story
_SCATTER_WARN = 2e-3  # of the magnitude
_FEW_REDUNDANT = 3


def held_names(triad: str, held: Booleans) -> tuple[str, ...]:
    """Return the paths of those scalars of a triad that only an assumption holds."""
    return tuple(name for name, flag in zip(NAMES[TRIADS[triad]], held, strict=True) if flag)


def relative_sigmas(fit: "TriadFit", covariance: Floats | None = None) -> Floats:
    """Return the sigmas of the sensitivity's entries relative to its rows, (3, 3).

    Where the common scale of all axes is unknown they are those at a given common scale, which is the cube root of the
    determinant.

    Parameters
    ----------
    fit : of one triad
    covariance : (9, 9) of the sensitivity, where it is not that of the fit
    """
    given = fit.covariance[S_, S_] if covariance is None else covariance
    if not fit.scale_known:
        by_scale = np.linalg.inv(fit.sensitivity).T.ravel() / 3  # d log det^(1/3)
        common = given @ by_scale
        given = given - np.outer(common, common) / float(by_scale @ common)
    return entry_sigmas(fit.sensitivity, given)


def triad_trust_findings(trusts: Sequence["tuple[RobustCovariance, TriadFit]"]) -> list[Finding]:
    """Say where errors are larger than independent ones, whether parts agree, and which biases changed."""
    from ...estimate.triads.triad_trust import merge_trusts  # not of an IMU that was turned by hand

    trust = merge_trusts([one.trust for one, _ in trusts])
    findings = [*model_incomplete(trust), *parts_disagree(trust.splits)]
    for one, fit in trusts:
        scale = mean_scale(fit.sensitivity)
        findings += bias_findings(one.instabilities, {found.block.split(".")[1]: scale for found in one.instabilities})
    return findings


def redundancy_findings(fit: "TriadFit") -> list[Finding]:
    """Say that there are hardly more poses than unknowns; nothing else shows errors."""
    if fit.degrees_of_freedom >= _FEW_REDUNDANT:
        return []
    return [
        make_finding(
            "few-redundant",
            equations=int(fit.equations[fit.used].sum()),
            unknowns=int(fit.free.sum()),
            degrees_of_freedom=max(fit.degrees_of_freedom, 0),
        )
    ]


def scatter_findings(fit: "TriadFit", noise_sigma: float, magnitude: float, unit: str) -> list[Finding]:
    """Say that the residuals are larger than the noise at rest, and what that means.

    Parameters
    ----------
    fit : of one triad
    noise_sigma : typical sigma of a mean by the noise at rest [SI]
    magnitude : typical magnitude [SI]
    unit : of both
    """
    if not noise_sigma > 0 or fit.extra_sigma <= _BEYOND_NOISE * noise_sigma:
        return []
    return [
        make_finding(
            "beyond-noise/magnitude",
            severity="warning" if fit.extra_sigma > _SCATTER_WARN * magnitude else "info",
            extra_sigma=fit.extra_sigma,
            unit=unit,
            ratio=fit.extra_sigma / noise_sigma,
        )
    ]
