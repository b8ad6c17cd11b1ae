"""Verdict and advice on an IMU calibration: what to trust, what to do next."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Literal

import numpy as np

from ...estimate.multiposition.model import B_, BG_, CG_, G_, LOWER, S_
from ...estimate.multiposition.noise_levels import rotation_variance
from ...estimate.multiposition.problem import ImuEstimate
from ...estimate.multiposition.triad_changes import least_turn_seen
from ...estimate.trust.changes import estimates_are_judged
from ...findings import Finding, make_finding
from ...recording import Floats
from ...recording.samples import median_of
from ...results.calibration import Assessment, Gravity, Holdout
from ...results.sensor_diagnostics import ImuDiagnostics
from ...units import ACCELEROMETER_UNITS_M_S2, GYROSCOPE_UNITS_RAD_S
from ..checks.imu_checks import left_out_rests_findings as rests_left_out
from ..observability import weak_findings
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
from .imu_tables import ACROSS_STEP, ImuFitSummary, interval_numbers
from .recording_changes import changes_in_model, drift_findings, step_findings

_TOUCHED, _WHOLE = 0.6, 0.85  # share of a rest that is still: where it was touched, and as a rule
_REST_S = 2.0
_MOST_TOUCHED = 0.3  # of the intervals: more are unsteady throughout


def touched_findings(evidence: ImuFitSummary) -> list[Finding]:
    """Name intervals that are a small part of their rest, as the most generous threshold sees it (interval-touched)."""
    chosen = evidence.chosen.intervals
    generous = max(evidence.trials, key=lambda trial: trial.multiplier).intervals
    t_s = evidence.accelerometer.t_s
    start, stop = t_s[chosen.start], t_s[chosen.stop - 1]
    rest_start, rest_stop = t_s[generous.start], t_s[generous.stop - 1]
    share = np.ones(len(chosen))
    length = np.zeros(len(chosen))
    for k in range(len(chosen)):
        around = np.flatnonzero((rest_start < stop[k]) & (rest_stop > start[k]))
        if len(around) == 1:
            rest = int(around[0])
            length[k] = rest_stop[rest] - rest_start[rest]
            share[k] = (stop[k] - start[k]) / max(length[k], 1e-9)
    touched = (share < _TOUCHED) & (length > _REST_S)
    if not touched.any() or median_of(share) < _WHOLE or touched.mean() > _MOST_TOUCHED:
        return []
    worst = int(np.argmin(np.where(touched, share, np.inf)))
    several = int(touched.sum()) > 1
    numbers = f"{interval_numbers(evidence.marked(touched))} of {len(evidence.chosen.rests)}"
    return [
        make_finding(
            "interval-touched",
            plural="s" if several else "",
            numbers=numbers,
            verb="were" if several else "was",
            length_s=length[worst],
            t_s=t_s[generous.start][(rest_start < stop[worst]) & (rest_stop > start[worst])][0],
            share=share[worst],
        )
    ]


_BEYOND_NOISE = 3.0  # times the noise; healthy recordings of cheap sensors reach two
_ROTATION_WARN_RAD = 3e-3  # what general use needs of a gyroscope's axes


def rotation_scatter(evidence: ImuFitSummary) -> list[Finding]:
    """Say that rotations end further from the measured gravity than the gyroscope's noise at rest explains."""
    fit = evidence.fit
    if not fit.rotation_used.any():
        return []
    noise = float(np.sqrt(median_of(rotation_variance(fit.data, fit.state)[fit.rotation_used])))
    extra = float(np.sqrt(fit.extra.rotation))
    if extra <= _BEYOND_NOISE * noise:
        return []
    return [
        make_finding(
            "beyond-noise/rotations",
            severity="warning" if extra > _ROTATION_WARN_RAD else "info",
            extra=extra,
            ratio=extra / noise,
            noise=noise,
        )
    ]


def _unseen_turn(evidence: ImuFitSummary) -> list[Finding]:
    """Say how small a turn of a triad in mid-recording passes, where general use would feel it."""
    judged = estimates_are_judged() and evidence.fit.rotation_used.any()
    least = least_turn_seen(evidence.fit) if judged else 0.0
    if not _ROTATION_WARN_RAD < least < np.pi:
        return []
    rests = int(evidence.fit.interval_used.sum())
    return [make_finding("turn-unseen", least=least, needed=_ROTATION_WARN_RAD, rests=rests)]


_AXES = "xyz"
_TOLD_AGAIN = "intervals-left-out"  # by the doctor, who does not know the fit


def assess_imu(
    noticed: tuple[Finding, ...],
    evidence: ImuFitSummary,
    diagnostics: ImuDiagnostics,
    gravity: Gravity,
) -> Assessment:
    """Judge a calibration.

    Parameters
    ----------
    noticed : what the data doctor found; what was fine is not repeated
    evidence : what the calibration was made of
    diagnostics : its tables
    gravity : what was taken for gravity
    """
    chosen = next(trial for trial in diagnostics.trials if trial.chosen)
    holdout = Holdout(accelerometer_rms=chosen.accelerometer_rms, rotation_rms=chosen.rotation_rms)
    changed = any(f.code == "axes-changed" for f in noticed)  # which no step of a bias is
    findings = [
        *(_weighed(f, diagnostics) for f in noticed if f.severity != "good" and f.code != _TOLD_AGAIN),
        *holdout_findings(holdout, gravity.value),
        *_uncertainty_findings(evidence, gravity),
        *_observability_findings(evidence),
        *axis_findings(evidence.estimate.gyroscope_sensitivity),
        *unit_findings("accelerometer", evidence.estimate.accelerometer_sensitivity, evidence.accelerometer_unit),
        *unit_findings("gyroscope", evidence.estimate.gyroscope_sensitivity, evidence.gyroscope_unit),
        *left_out_intervals_findings(diagnostics),
        *touched_findings(evidence),
        *gravity_findings(gravity),
        *_model_findings(evidence, diagnostics),
        *drift_findings(evidence),
        *([] if changed else step_findings(evidence, diagnostics)),
        *bias_findings(evidence.instabilities, _unit_per_si(evidence.estimate)),
        *rotation_scatter(evidence),
        *_unseen_turn(evidence),
        *model_incomplete(evidence.trust),
        *parts_disagree(evidence.trust.splits),
        *_allan_findings(diagnostics),
        *convergence_findings(evidence.fit.converged, evidence.fit.iterations),
    ]
    assessment = Assessment(
        holdout=holdout,
        intervals_found=len(diagnostics.intervals.used),
        intervals_used=int(diagnostics.intervals.used.sum()),
        rotations_found=len(diagnostics.rotations.used),
        rotations_used=int(diagnostics.rotations.used.sum()),
        model=chosen.model,
        held_by_prior=_held_names(evidence.fit.held_by_prior),
        trust=replace(
            uncertainty_summary(evidence.trust),
            added=changes_in_model(evidence),
            tries=len(evidence.trust.models),
        ),
    )
    return with_verdict(assessment, findings)


def _unit_per_si(estimate: ImuEstimate) -> dict[str, float]:
    sensitivities = {"accelerometer": estimate.accelerometer_sensitivity, "gyroscope": estimate.gyroscope_sensitivity}
    return {triad: mean_scale(matrix) for triad, matrix in sensitivities.items()}


def _weighed(finding: Finding, diagnostics: ImuDiagnostics) -> Finding:
    """Return what the doctor found; saturation that cost no rotation is no reason to warn."""
    harmless = finding.code == "saturation" and not any("saturated" in why for why in diagnostics.rotations.reason)
    if not harmless:
        return finding
    return replace(
        finding, severity="info", consequence="No rotation between static intervals is touched by it.", cure=""
    )


def convergence_findings(converged: bool, iterations: int | None = None) -> list[Finding]:
    """Say that the fit did not settle, and within how many steps where that is known; nothing if it did."""
    if converged:
        return []
    within = "" if iterations is None else f" within {iterations} steps"
    return [make_finding("not-converged/imu", within=within)]


def holdout_findings(holdout: Holdout, gravity_m_s2: float) -> list[Finding]:
    """Judge the errors on data that the fit had not seen."""
    still = grade_by_limits("held-out gravity", holdout.accelerometer_rms, gravity_m_s2)
    turned = grade_by_limits("held-out rotation", holdout.rotation_rms)
    return [
        make_finding("holdout-accelerometer/imu", severity=still, accelerometer_rms=holdout.accelerometer_rms),
        make_finding("holdout-rotation", severity=turned, rotation_rms=holdout.rotation_rms),
    ]


def _relative_sigmas(evidence: ImuFitSummary, gravity: Gravity) -> tuple[float, float, float, float]:
    """Return the largest sigmas of the accelerometer's scales (gravity apart) and angles, then the gyroscope's."""
    estimate = evidence.estimate
    by_a = entry_sigmas(estimate.accelerometer_sensitivity, estimate.covariance[:9, :9])
    by_g = entry_sigmas(estimate.gyroscope_sensitivity, estimate.covariance[12:21, 12:21])
    scale, angle = scale_and_angle(by_a)
    return max(scale**2 - (gravity.sigma / gravity.value) ** 2, 0.0) ** 0.5, angle, *scale_and_angle(by_g)


def _uncertainty_findings(evidence: ImuFitSummary, gravity: Gravity) -> list[Finding]:
    scale_a, angle_a, scale_g, angle_g = _relative_sigmas(evidence, gravity)
    rows = (
        ("accelerometer", scale_a, angle_a, most_useful_attitude(evidence)),
        ("gyroscope", scale_g, angle_g, _missing_rotation(evidence)),
    )
    findings: list[Finding] = []
    for triad, scale, angle, cure in rows:
        severity = most_severe(grade_by_limits("scale", scale), grade_by_limits("axes", angle))
        findings.append(
            make_finding(f"uncertainty-{triad}/imu", severity=severity, scale=scale, angle=angle, cure=cure)
        )
    return findings


def most_useful_attitude(evidence: ImuFitSummary) -> str:
    """Name the attitude that would lower the accelerometer's uncertainty most."""
    free = slice(0, 9)
    covariance = evidence.fit.covariance[free, free]
    inverse = np.linalg.inv(evidence.fit.state.matrices[0])
    u = ATTITUDES / np.linalg.norm(ATTITUDES, axis=1, keepdims=True)
    pull = u @ inverse  # derivative of |f| by the measurement
    rows = np.empty((len(u), 9))
    for column, (i, j) in enumerate(zip(*LOWER, strict=True)):
        rows[:, column] = -pull[:, i] * u[:, j]
    rows[:, 6:] = -pull
    scale = np.sqrt(np.maximum(np.diag(covariance), np.finfo(float).tiny))
    gain = np.sum((rows @ covariance / scale) ** 2, axis=1) / (
        np.einsum("ij,jk,ik->i", rows, covariance, rows) + median_of(np.diag(covariance))
    )
    return f"Add static intervals with {attitude_words(ATTITUDES[np.argmax(gain)])}."


def _missing_rotation(evidence: ImuFitSummary) -> str:
    """Name the axis about which the sensor was turned too little."""
    sigmas = np.sqrt(np.diag(evidence.fit.covariance)[CG_]).reshape(3, 3)
    worst = int(np.argmax(np.linalg.norm(sigmas, axis=0)))
    return f"Turn the sensor about its {_AXES[worst]} axis more often, with that axis level, by a quarter turn or more."


def _held_names(held: np.ndarray) -> tuple[str, ...]:
    """Return the YAML paths of scalars that only the prior holds."""
    names = [f"imu0.accelerometer.sensitivity[{i},{j}]" for i, j in zip(*LOWER, strict=True)]
    names += [*NAMES[TRIADS["accelerometer"]][9:], *NAMES[TRIADS["gyroscope"]]]
    return tuple(name for name, flag in zip(names, held, strict=True) if flag)


def _observability_findings(evidence: ImuFitSummary) -> list[Finding]:
    """Say what the recording does not determine: in words of motions, and what is left over by its name."""
    weak = evidence.trust.weak
    held = evidence.fit.held_by_prior
    said = " ".join(one.words for one in weak if one.held)
    groups = (
        ("the accelerometer's scales and axes", "accelerometer", S_, most_useful_attitude(evidence)),
        ("the accelerometer's bias", "accelerometer", B_, most_useful_attitude(evidence)),
        ("the gyroscope's scales and axes", "axes of the gyroscope", CG_, _missing_rotation(evidence)),
        ("the gyroscope's bias", "-", BG_, "Hold the sensor still for longer."),
        ("the gyroscope's g-sensitivity", "g-sensitivity", G_, most_useful_attitude(evidence)),
    )
    return weak_findings(weak, with_camera=False) + [
        make_finding("not-observable/imu", count=int(held[part].sum()), what=what, cure=cure)
        for what, word, part, cure in groups
        if held[part].any() and word not in said
    ]


def axis_findings(sensitivity: Floats) -> list[Finding]:
    """Name gyroscope axes that do not point along the accelerometer's: swapped columns, wrong signs, a left hand.

    Gravity shows neither the sign nor the hand of the accelerometer's axes; they are taken as recorded.
    """
    share = sensitivity / np.linalg.norm(sensitivity, axis=1, keepdims=True)
    along = np.argmax(np.abs(share), axis=1)
    sign = np.sign(share[np.arange(3), along])
    if np.array_equal(along, np.arange(3)) and (sign > 0).all():
        return []
    words = [f"{_AXES[i]} measures about {'-' if sign[i] < 0 else '+'}{_AXES[along[i]]}" for i in range(3)]
    hand = "right-handed" if np.linalg.det(sensitivity) > 0 else "left-handed"
    flipped = [_AXES[i] for i in range(3) if sign[i] < 0 and along[i] == i]
    guess = "Check the order of the columns (--columns) and the signs of both sensors."
    if np.array_equal(along, np.arange(3)) and len(flipped) == 1:
        guess = f"Most likely the sign of gyroscope {flipped[0]} is flipped."
    elif np.array_equal(along, np.arange(3)) and len(flipped) == 2:
        other = next(a for a in _AXES if a not in flipped)
        guess = (
            f"Most likely the sign of accelerometer {other} is flipped, or those of gyroscope {' and '.join(flipped)}."
        )
    elif np.array_equal(along, np.arange(3)):
        guess = "Most likely all signs of the gyroscope are flipped."
    return [make_finding("axes-differ/imu", words=", ".join(words), hand=hand, guess=guess)]


def left_out_intervals_findings(diagnostics: ImuDiagnostics) -> list[Finding]:
    """Name intervals and rotations that were not used."""
    findings: list[Finding] = []
    intervals, rotations = diagnostics.intervals, diagnostics.rotations
    findings += rests_left_out(intervals.start_s, intervals.stop_s, intervals.reason)
    out, reasons = int(np.sum(~rotations.used)), sorted({why for why in rotations.reason if why})
    many = out > 0.1 * len(rotations.used)
    if out and (many or reasons != [ACROSS_STEP]):  # of the step itself another finding tells
        findings.append(
            make_finding(
                "rotations-left-out",
                severity="warning" if many else "info",
                out=out,
                rotations=len(rotations.used),
                reasons="; ".join(reasons[:3]),
            )
        )
    return findings


def _model_findings(evidence: ImuFitSummary, diagnostics: ImuDiagnostics) -> Iterator[Finding]:
    step = next((step for step in evidence.trust.models if step.name == "g-sensitivity"), None)
    if step is None:
        return
    by_name = {trial.model: trial for trial in diagnostics.trials}
    basic, full = by_name["basic"], by_name["g-sensitivity"]
    how = "as stated" if step.forced else "chosen"
    yield make_finding(
        "model",
        model=full.model if step.used else basic.model,
        how=how,
        gain=step.gain,
        needed=step.needed,
        full_rms=full.rotation_rms,
        basic_rms=basic.rotation_rms,
    )


def _allan_findings(diagnostics: ImuDiagnostics) -> list[Finding]:
    allan = diagnostics.allan
    if allan is None or not np.isfinite(allan.t_init_s):
        held = float(diagnostics.intervals.stop_s[0] - diagnostics.intervals.start_s[0])
        return [make_finding("t-init/short", held=held)]
    return [make_finding("t-init/unknown", t_init_s=allan.t_init_s, static_s=allan.static_s)]


_UNIT_FACTOR = 1.5
_SIGNS = np.indices((3, 3, 3)).reshape(3, -1).T - 1.0
ATTITUDES = _SIGNS[_SIGNS.any(axis=1)]
"""Axes that point up, or down, or halfway, (26, 3)."""


def attitude_words(attitude: Floats) -> str:
    """Name one of `ATTITUDES`, such as "x up and z down (tilted halfway)"."""
    ups = [f"{axis} {'up' if value > 0 else 'down'}" for axis, value in zip("xyz", attitude, strict=True) if value]
    return " and ".join(ups) + (" (tilted halfway)" if len(ups) > 1 else "")


def mean_scale(sensitivity: Floats) -> float:
    """Return the geometric mean of the scales of a sensitivity (3, 3)."""
    return float(np.abs(np.linalg.det(sensitivity))) ** (1 / 3)


def entry_sigmas(sensitivity: Floats, covariance: Floats) -> Floats:
    """Return the sigmas of the entries of a sensitivity relative to its rows, (3, 3), from their covariance (9, 9)."""
    sigma = np.sqrt(np.maximum(np.diag(covariance), 0.0)).reshape(3, 3)
    return sigma / np.linalg.norm(sensitivity, axis=1)[:, None]


def scale_and_angle(sigma: Floats) -> tuple[float, float]:
    """Return the largest relative sigma of the scales, on the diagonal of (3, 3), and of the angles beside it."""
    return float(np.diag(sigma).max()), float(sigma[~np.eye(3, dtype=bool)].max())


def unit_findings(triad: Literal["accelerometer", "gyroscope"], sensitivity: Floats, unit: str) -> list[Finding]:
    """Warn where one scale is far from the others, or all from what the unit says, which counts say nothing of."""
    table = ACCELEROMETER_UNITS_M_S2 if triad == "accelerometer" else GYROSCOPE_UNITS_RAD_S
    nominal = table.get(unit)
    scales = np.linalg.norm(sensitivity, axis=1)
    usual = float(median_of(scales))
    odd = int(np.argmax(np.abs(np.log(scales / usual))))
    if not 1 / _UNIT_FACTOR < scales[odd] / usual < _UNIT_FACTOR:
        return [make_finding("unit/axis", triad=triad, axis="xyz"[odd], ratio=scales[odd] / usual)]
    ratio = mean_scale(sensitivity) * (nominal or np.nan)
    if 1 / _UNIT_FACTOR < ratio < _UNIT_FACTOR or not np.isfinite(ratio):
        return []
    others = [name for name, size in table.items() if size and 0.8 < ratio / (nominal or 1) * size < 1.25]
    by_rate = triad == "gyroscope" and not others
    fits = f" Its values look like {others[0]}." if others else ""
    if by_rate:
        fits = f" So they would be if the sample rate were {ratio:.3g} times what the timestamps say."
    return [make_finding("unit/far", triad=triad, ratio=ratio, unit=unit, fits=fits, case="rate" if by_rate else "")]
