"""Verdict and advice on a turntable calibration: what to trust, what to do next; and what it was made of, as tables."""

from collections.abc import Iterator, Sequence

import numpy as np

from ...estimate.triads.triad import TriadFit, TriadPoses
from ...estimate.triads.triad_trust import merge_trusts
from ...estimate.trust.parts import RobustCovariance
from ...estimate.turntable.fit import TurntableFit
from ...estimate.turntable.parts import TurntableParts
from ...findings import Finding, list_first, make_finding
from ...frozen import value_class
from ...models.gravity import EARTH_RATE_RAD_S
from ...options import TurntableOptions
from ...recording import Floats
from ...results.calibration import Assessment, Gravity, Holdout
from ...results.sensor_diagnostics import (
    GyroscopeAtRest,
    PeriodCurve,
    PoseTable,
    TriadDiagnostics,
    TriadRecord,
    TriadTrial,
    TurntableRate,
)
from ...results.trust import UncertaintySummary
from ...units import GYROSCOPE_UNITS_RAD_S
from ..verdict import (
    LIMITS,
    grade_by_limits,
    gravity_findings,
    most_severe,
    uncertainty_summary,
    with_verdict,
)
from .imu_verdict import axis_findings, convergence_findings, mean_scale, scale_and_angle
from .poses_verdict import held_names, redundancy_findings, relative_sigmas, triad_trust_findings

_RATE_WORTH = 2e-4  # what a video gives
_SCALE_FAIL = LIMITS["scale"][1]
_FEW_AXES = 9
_ALIKE_DEG = 15.0
_WANDER = 1e-3  # of the rate, from part to part
_CONTRADICT, _RATIO_FAIL = 4.0, 0.02  # sigmas; share
_FAR_SCALE = 0.05
_PULL_RAD, _TILT_RAD = 1e-3, 2e-3  # that are worth telling
_MOST_NAMED = 6


@value_class
class TurntableFitSummary:
    """Everything that a calibration on a turntable was made of.

    Attributes
    ----------
    parts : steady parts and their speeds
    fit : the calibration
    rivals : model -> its fit, of those that were compared
    gravity : what was taken for gravity
    no_accelerometer : why the accelerometer was not used, or ""
    videos : what videos of the platter showed
    """

    parts: TurntableParts
    fit: TurntableFit
    rivals: dict[str, TurntableFit]
    gravity: Gravity
    no_accelerometer: str
    videos: tuple[PeriodCurve, ...]


def assess_turntable(
    evidence: TurntableFitSummary,
    diagnostics: TriadDiagnostics,
    options: TurntableOptions,
    *,
    agreement: Sequence[Finding] = (),
) -> Assessment:
    """Judge a calibration.

    Parameters
    ----------
    evidence : what the calibration was made of
    diagnostics : its tables
    options : as stated
    agreement : what was known beforehand, and whether the recordings agree
    """
    fit, parts = evidence.fit.fit, evidence.parts
    findings = [
        *parts.findings,
        *agreement,
        *_uncertainty(evidence),
        *_rates(evidence, diagnostics),
        *_holdout(evidence),
        *_orientations(evidence),
        *_not_observable(evidence),
        *redundancy_findings(fit),
        *_left_out(evidence),
        *_platter(evidence, options),
        *_frames(evidence),
        *_scale_far(evidence),
        *_drift(evidence),
        *triad_trust_findings(turntable_trusts(evidence.fit)),
        *convergence_findings(fit.converged, fit.iterations),
    ]
    found = evidence.fit.accelerometer
    if found is not None:
        findings += [*axis_findings(fit.sensitivity), *gravity_findings(evidence.gravity)]
    assessment = Assessment(
        holdout=Holdout(
            accelerometer_rms=float("nan") if found is None else holdout_rms(found.fit), rate_rms=holdout_rms(fit)
        ),
        intervals_found=len(parts.names) + len(parts.left_out),
        intervals_used=int(fit.used.sum()),
        model="g-sensitivity" if fit.free[12:].any() else "basic",
        held_by_prior=assumption_held_names(evidence),
        trust=uncertainty_summary(diagnostics.trust) if diagnostics.trust is not None else UncertaintySummary(),
    )
    return with_verdict(assessment, findings)


def _relative_sigmas(evidence: TurntableFitSummary) -> Floats:
    """Return the relative sigmas of the sensitivity (3, 3), with those of the accelerometer's directions."""
    return relative_sigmas(evidence.fit.fit, evidence.fit.covariance[-21:-12, -21:-12])


def _uncertainty(evidence: TurntableFitSummary) -> Iterator[Finding]:
    fit, sigma = evidence.fit.fit, _relative_sigmas(evidence)
    scale, angle = scale_and_angle(sigma)
    by_rate = float(np.min(fit.group_sigma[evidence.parts.data.rates > 0]))
    own = float(np.sqrt(max(scale**2 - by_rate**2, 0.0))) if fit.scale_known else scale
    of_axes, of_rate = (
        grade_by_limits("axes", angle),
        grade_by_limits("table speed", by_rate if fit.scale_known else 0.0),
    )
    severity = most_severe(grade_by_limits("scale", own), of_axes, of_rate)
    by_speed = fit.scale_known and by_rate > 0.7 * scale
    what = "scales are known" if fit.scale_known else "scales are known against each other"
    cure = "Add orientations, and let the platter turn longer in each."
    yield make_finding(
        "uncertainty-gyroscope",
        severity=severity,
        case="by-speed" if by_speed and of_axes == "good" else "",
        what=what,
        scale=scale,
        angle=angle,
        cure=cure,
    )
    if by_speed and by_rate > _RATE_WORTH and severity != "problem":
        yield make_finding("rate-dominates", by_rate=by_rate)
    if not fit.scale_known:
        yield make_finding("rate-unknown")


def _rates(evidence: TurntableFitSummary, diagnostics: TriadDiagnostics) -> Iterator[Finding]:
    """Say where the stated speeds do not fit each other, whichever parts were used."""
    found, parts = evidence.fit, evidence.parts
    turning = [rate for rate in diagnostics.rates if rate.stated > 0]
    unused = [rate.name for rate in parts.rates[:-1] if rate.name not in {one.name for one in turning}]
    if unused:
        yield make_finding("rate-not-found", unused=" and ".join(unused))
    yield from _in_one_attitude(evidence)
    if len(turning) < 2:
        return
    shown = np.linalg.norm(found.fit.physical(found.poses.measured, found.poses.force), axis=1)
    names = np.array([rate.name for rate in parts.rates])[parts.data.speed]
    ratio = np.array([np.median(shown[names == rate.name]) / rate.stated for rate in turning])
    sigma = np.array([rate.stated_sigma / rate.stated for rate in turning])
    least = float(np.min(found.fit.magnitude_sigma)) / min(rate.stated for rate in turning)
    low, high = int(np.argmin(ratio)), int(np.argmax(ratio))
    apart = float(ratio[high] / ratio[low] - 1)
    if apart > _CONTRADICT * float(np.hypot(np.hypot(sigma[low], sigma[high]), least)):
        yield make_finding(
            "rates-contradict/between",
            severity="problem" if apart > _RATIO_FAIL else "warning",
            first=turning[high].name,
            second=turning[low].name,
            apart=apart,
        )


def _in_one_attitude(evidence: TurntableFitSummary) -> Iterator[Finding]:
    """Compare speeds by what the gyroscope shows of them in one attitude, where its scale does not matter."""
    data, fit = evidence.parts.data, evidence.fit.fit
    size = np.linalg.norm(data.measured - fit.bias, axis=1)
    ratios: list[tuple[float, float]] = []
    for attitude in np.unique(data.pose):
        mine = np.flatnonzero((data.pose == attitude) & (data.rate > 0))
        if len(mine) > 1:
            slow, fast = mine[np.argmin(size[mine])], mine[np.argmax(size[mine])]
            ratios.append((float(size[fast] / size[slow]), float(data.rate[fast] / data.rate[slow])))
    if not ratios:
        return
    shown, stated = np.median(ratios, axis=0)
    if abs(np.log(shown / stated)) > _RATIO_FAIL:
        yield make_finding("rates-contradict/one-orientation", shown=shown, stated=stated)


def _holdout(evidence: TurntableFitSummary) -> Iterator[Finding]:
    fit = evidence.fit.fit
    rms, fastest = holdout_rms(fit), float(evidence.parts.data.rate.max())
    severity = grade_by_limits("held-out rate", rms, fastest)
    yield make_finding("holdout-rate", severity=severity, rms=rms)


def _orientations(evidence: TurntableFitSummary) -> Iterator[Finding]:
    """Count the axes about which the sensor was turned; one and its opposite are two."""
    direction = evidence.fit.fit.direction[evidence.fit.fit.used]
    direction = direction[np.isfinite(direction).all(axis=1)]
    different: list[np.ndarray] = []
    for axis in direction:
        if all(axis @ other < np.cos(np.radians(_ALIKE_DEG)) for other in different):
            different.append(axis)
    count = len(different)
    few = count < _FEW_AXES
    yield make_finding("orientations", severity="warning" if few else "good", case="few" if few else "", count=count)


def assumption_held_names(evidence: TurntableFitSummary) -> tuple[str, ...]:
    """Return the paths of scalars that only a weak assumption holds."""
    return held_names("gyroscope", evidence.fit.fit.held_by_prior)


def _not_observable(evidence: TurntableFitSummary) -> Iterator[Finding]:
    held = assumption_held_names(evidence)
    if not evidence.fit.fit.scale_known and np.diag(_relative_sigmas(evidence)).max() < _SCALE_FAIL:
        held = tuple(name for name in held if ".sensitivity" not in name)  # the common scale, which is told
    if held:
        yield make_finding("not-observable/turntable", count=len(held), held=list_first(held, 3))


def _left_out(evidence: TurntableFitSummary) -> Iterator[Finding]:
    parts, fit = evidence.parts, evidence.fit.fit
    out = [f"{name} ({why})" for name, why in parts.left_out]
    out += [
        f"{name} (it does not agree with the others)"
        for name, used in zip(parts.names, fit.used, strict=True)
        if not used
    ]
    if out:
        total = len(parts.names) + len(parts.left_out)
        yield make_finding(
            "parts-left-out",
            severity="warning" if len(out) > 0.1 * total else "info",
            count=len(out),
            total=total,
            out=list_first(out, _MOST_NAMED, "; "),
        )


def _platter(evidence: TurntableFitSummary, options: TurntableOptions) -> Iterator[Finding]:
    """Tell of speed that wanders, of tilt, of centripetal acceleration and of the earth's rate where they count."""
    data, fit, found = evidence.parts.data, evidence.fit.fit, evidence.fit.accelerometer
    turning = data.rate > 0
    share = np.hypot(np.median(data.wander[turning] / data.rate[turning]), fit.extra_sigma / data.rate[turning].min())
    if share > _WANDER:
        yield make_finding("platter-wanders", severity="warning" if share > 10 * _WANDER else "info", share=share)
    slowest = float(data.rate[turning].min())
    earth = EARTH_RATE_RAD_S / np.sqrt(3) / slowest
    if options.latitude is None and earth > 0.5 * float(np.min(fit.group_sigma[data.rates > 0])):
        yield make_finding("earth-rate", percent=100 * EARTH_RATE_RAD_S / slowest)
    if found is None:
        return
    if found.tilt > _TILT_RAD:
        yield make_finding("platter-tilt", tilt=found.tilt)
    apart = [axis for axis in data.axes if axis.rate > 0 and not axis.separated]
    if apart:
        pull = max(axis.rate for axis in apart) ** 2 * 0.1 / evidence.gravity.value
        yield make_finding(
            "centripetal",
            severity="info" if pull < _PULL_RAD else "warning",
            count=len(apart),
            pull_rad=np.arctan(pull),
        )


def _frames(evidence: TurntableFitSummary) -> Iterator[Finding]:
    """Say what the axes of the result mean."""
    found = evidence.fit
    if found.accelerometer is not None:
        yield make_finding("frames/handedness", sense=found.sense)
        return
    recorded = evidence.parts.accelerometer_unit is not None
    why = f"The accelerometer is not used: {evidence.no_accelerometer.rstrip('.')}. " if recorded else ""
    yield make_finding("frames-unrelated", severity="warning" if recorded else "info", why=why)


def _scale_far(evidence: TurntableFitSummary) -> Iterator[Finding]:
    unit = evidence.parts.gyroscope_unit
    nominal = GYROSCOPE_UNITS_RAD_S[unit]
    if nominal is None:
        return
    ratio = mean_scale(evidence.fit.fit.sensitivity) * nominal
    if abs(ratio - 1) > _FAR_SCALE:
        yield make_finding("scale-far", ratio=ratio, unit=unit)


def _drift(evidence: TurntableFitSummary) -> Iterator[Finding]:
    if not evidence.fit.drifts:
        return
    fit = evidence.fit.fit
    span = float(np.max(np.ptp(evidence.fit.drift, axis=0) / np.linalg.norm(fit.sensitivity, axis=1)))
    yield make_finding("bias-drift", span=span)


def holdout_rms(fit: TriadFit) -> float:
    """Return the rms of |x| minus the magnitude of the parts that were left out, one at a time [SI]."""
    return float(np.sqrt(np.mean(fit.magnitude_holdout[fit.used] ** 2)))


def describe_turntable(evidence: TurntableFitSummary) -> TriadDiagnostics:
    """Return the diagnostics of a calibration on a turntable."""
    parts, found = evidence.parts, evidence.fit
    triads = {"gyroscope": _gyroscope(parts, found)}
    if found.accelerometer is not None and parts.accelerometer_unit is not None:
        triads = {"accelerometer": _accelerometer(parts, found), **triads}
    chosen = "g-sensitivity" if found.fit.free[12:].any() else "basic"
    noise = {"gyroscope.density": float(np.sqrt(np.mean(parts.noise / np.sum(found.fit.sensitivity**2, axis=1))))}
    if found.accelerometer is not None:
        noise["platter.tilt"] = found.accelerometer.tilt
    return TriadDiagnostics(
        kind="turntable",
        triads=triads,
        gravity=None if found.accelerometer is None else evidence.gravity,
        at_rest=_at_rest(parts, found),
        rates=_rate_table(parts, found.fit),
        videos=evidence.videos,
        trials=tuple(
            TriadTrial(
                model=model,
                chosen=model == chosen,
                holdout_rms=holdout_rms(rival.fit),
                parameters=int(rival.fit.free.sum()),
            )
            for model, rival in evidence.rivals.items()
        ),
        noise=noise,
        trust=merge_trusts([one.trust for one, _ in turntable_trusts(found)]),
    )


def turntable_trusts(found: TurntableFit) -> list[tuple[RobustCovariance, TriadFit]]:
    """Return what attitudes say of each triad, and its fit."""
    trusts = [(found.trust, found.fit)]
    return trusts if found.accelerometer is None else [(found.accelerometer.trust, found.accelerometer.fit), *trusts]


def _gyroscope(parts: TurntableParts, found: TurntableFit) -> TriadRecord:
    fit = found.fit
    return TriadRecord(
        quantity="angular rate",
        unit=parts.gyroscope_unit,
        si_unit="rad/s",
        poses=_table(fit, found.poses, parts.names, (parts.start_s, parts.stop_s), parts.samples),
        noise_sigma=_noise_sigma(found.poses, fit),
        extra_sigma=fit.extra_sigma,
    )


def _accelerometer(parts: TurntableParts, found: TurntableFit) -> TriadRecord:
    assert found.accelerometer is not None and parts.accelerometer_unit is not None  # noqa: PT018
    fit, poses, attitude = found.accelerometer.fit, found.accelerometer.poses, found.accelerometer.attitude
    members = [np.flatnonzero(parts.data.pose == k) for k in attitude]
    names = tuple(f"attitude {k + 1}" for k in attitude)
    start_s = np.array([parts.start_s[m].min() if len(m) else np.nan for m in members])
    stop_s = np.array([parts.stop_s[m].max() if len(m) else np.nan for m in members])
    return TriadRecord(
        quantity="specific force",
        unit=parts.accelerometer_unit,
        si_unit="m/s^2",
        poses=_table(fit, poses, names, (start_s, stop_s), np.zeros(len(attitude), dtype=np.int64)),
        noise_sigma=_noise_sigma(poses, fit),
        extra_sigma=fit.extra_sigma,
    )


def _table(
    fit: TriadFit, poses: TriadPoses, names: tuple[str, ...], span_s: tuple[Floats, Floats], samples: np.ndarray
) -> PoseTable:
    return PoseTable(
        name=names,
        start_s=span_s[0],
        stop_s=span_s[1],
        samples=samples,
        measured=poses.measured,
        magnitude=poses.magnitude,
        direction=fit.direction,
        error_before=_uncalibrated(poses.measured, poses.magnitude, fit),
        error_after=fit.magnitude_error,
        error_holdout=fit.magnitude_holdout,
        sigma=fit.magnitude_sigma,
        used=fit.used,
        reason=tuple("" if used else "it does not agree with the others" for used in fit.used),
    )


def _uncalibrated(measured: Floats, magnitude: Floats, fit: TriadFit) -> Floats:
    """Return |x| - magnitude with one scale for all axes, and of the offset no more than that of counts."""
    size = float(np.abs(np.linalg.det(fit.sensitivity))) ** (1 / 3)
    offset = np.mean(fit.bias) if np.abs(fit.bias).max() > size * magnitude.max() else 0.0
    return np.linalg.norm(measured - offset, axis=1) / size - magnitude


def _noise_sigma(poses: TriadPoses, fit: TriadFit) -> float:
    return float(np.sqrt(np.median(poses.variance / np.sum(fit.sensitivity**2, axis=1))))


def _rate_table(parts: TurntableParts, fit: TriadFit) -> tuple[TurntableRate, ...]:
    rates: list[TurntableRate] = []
    for k, rate in enumerate(parts.rates):
        count = int(np.count_nonzero(parts.data.speed == k))
        if count:
            rates.append(
                TurntableRate(
                    name=rate.name,
                    stated=rate.rate_rad_s,
                    stated_sigma=rate.sigma_rad_s,
                    estimated=rate.rate_rad_s * float(fit.group_factor[k]),
                    estimated_sigma=rate.rate_rad_s * float(fit.group_sigma[k]),
                    parts=count,
                    turns=rate.turns,
                )
            )
    return tuple(rates)


def _at_rest(parts: TurntableParts, found: TurntableFit) -> GyroscopeAtRest | None:
    """Return the gyroscope at rest in several attitudes; None without accelerometer or rests."""
    rest, force = parts.data.rate == 0, found.poses.force
    if force is None or not rest.any():
        return None
    fit, drift = found.fit, found.drift[rest]
    earth = found.poses.magnitude_sigma[rest, None] * np.linalg.norm(fit.sensitivity, axis=1)
    return GyroscopeAtRest(
        t_s=parts.data.t_s[rest],
        force=force[rest],
        measured=parts.data.measured[rest],
        predicted=fit.bias + drift + force[rest] @ fit.g_sensitivity.T,
        drift=drift,
        sigma=np.sqrt(found.poses.variance[rest] + earth**2),
        unit=parts.gyroscope_unit,
    )
