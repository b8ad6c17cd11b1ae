"""Verdict and advice on a calibration on a turntable."""

from collections.abc import Iterator, Sequence

import numpy as np

from ..calibration import Assessment, Holdout
from ..findings import Finding
from ..models.gravity import EARTH_RATE_RAD_S
from ..recording import Floats
from ..triad_diagnostics import TriadDiagnostics
from ..triad_options import TurntableOptions
from ..trust import TrustNote
from ..units import GYROSCOPE_UNITS_RAD_S
from .imu_verdict import axis_findings, convergence_findings
from .triad_verdict import redundancy_findings, relative_sigmas, triad_trust_findings
from .trust_findings import trust_note
from .turntable_tables import TurntableEvidence, holdout_rms, turntable_trusts
from .verdict import SEVERITIES, graded, gravity_findings, verdict_of, worst_first

_RATE_WORTH = 2e-4  # what a video gives
_SCALE_WARN, _SCALE_FAIL = 2e-3, 2e-2  # relative sigma, without that of the rates
_RATE_WARN, _RATE_FAIL = 2e-2, 0.1  # of the rates, which the scales share
_ANGLE_WARN_RAD, _ANGLE_FAIL_RAD = 3e-3, 3e-2
_HOLDOUT_WARN, _HOLDOUT_FAIL = 2e-3, 2e-2  # of the fastest rate
_FEW_AXES = 9
_ALIKE_DEG = 15.0
_WANDER = 1e-3  # of the rate, from part to part
_CONTRADICT, _RATIO_FAIL = 4.0, 0.02  # sigmas; share
_FAR_SCALE = 0.05
_PULL_RAD, _TILT_RAD = 1e-3, 2e-3  # that are worth telling
_MOST_NAMED = 6


def assess_turntable(
    evidence: TurntableEvidence,
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
    ordered = worst_first(findings)
    return Assessment(
        verdict=verdict_of(ordered),
        findings=ordered,
        holdout=Holdout(
            accelerometer_rms=float("nan") if found is None else holdout_rms(found.fit), rate_rms=holdout_rms(fit)
        ),
        intervals_found=len(parts.names) + len(parts.left_out),
        intervals_used=int(fit.used.sum()),
        model="g-sensitivity" if fit.free[12:].any() else "basic",
        held_by_prior=held_names(evidence),
        trust=trust_note(diagnostics.trust) if diagnostics.trust is not None else TrustNote(),
    )


def _relative_sigmas(evidence: TurntableEvidence) -> Floats:
    """Return the relative sigmas of the sensitivity (3, 3), with those of the accelerometer's directions."""
    return relative_sigmas(evidence.fit.fit, evidence.fit.covariance[-21:-12, -21:-12])


def _uncertainty(evidence: TurntableEvidence) -> Iterator[Finding]:
    fit, sigma = evidence.fit.fit, _relative_sigmas(evidence)
    scale, angle = float(np.diag(sigma).max()), float(sigma[~np.eye(3, dtype=bool)].max())
    by_rate = float(np.min(fit.group_sigma[evidence.parts.data.rates > 0]))
    own = float(np.sqrt(max(scale**2 - by_rate**2, 0.0))) if fit.scale_known else scale
    grades = (
        graded(own, _SCALE_WARN, _SCALE_FAIL),
        graded(angle, _ANGLE_WARN_RAD, _ANGLE_FAIL_RAD),
        graded(by_rate if fit.scale_known else 0.0, _RATE_WARN, _RATE_FAIL),
    )
    severity = min(grades, key=SEVERITIES.__getitem__)
    by_speed = fit.scale_known and by_rate > 0.7 * scale
    what = "scales are known" if fit.scale_known else "scales are known against each other"
    cure = "Add orientations, and let the platter turn longer in each."
    yield Finding(
        severity=severity,
        code="uncertainty-gyroscope",
        message=f"The gyroscope's {what} to {100 * scale:.3f} % and its axes to {1e3 * angle:.2f} mrad "
        "(1 sigma, worst axis).",
        consequence="" if severity == "good" else "That is coarser than a turntable can give.",
        cure="" if severity == "good" else "Measure the speed better." if by_speed and grades[1] == "good" else cure,
    )
    if by_speed and by_rate > _RATE_WORTH and severity != "problem":
        yield Finding(
            severity="info",
            code="rate-dominates",
            message=f"Most of the scales' uncertainty is that of the speed, {100 * by_rate:.3f} %, which all share.",
            consequence="Ratios of the scales and the angles between the axes are known better.",
            cure="Measure the speed over many turns, such as with a video (--rate VIDEO), or state --rate-sigma.",
        )
    if not fit.scale_known:
        yield Finding(
            severity="warning",
            code="rate-unknown",
            message="The speed was taken as unknown (--free rate.scale): turns at one unknown rate show bias, "
            "misalignment and the ratios of the scales, but not their common factor.",
            consequence="All scales are those at the stated speed times one factor that nothing here tells; their "
            "sigmas are no measurement.",
            cure="Measure the speed, such as with a video (--rate VIDEO).",
        )


def _rates(evidence: TurntableEvidence, diagnostics: TriadDiagnostics) -> Iterator[Finding]:
    """Say where the stated speeds do not fit each other, whichever parts were used."""
    found, parts = evidence.fit, evidence.parts
    turning = [rate for rate in diagnostics.rates if rate.stated > 0]
    unused = [rate.name for rate in parts.rates[:-1] if rate.name not in {one.name for one in turning}]
    if unused:
        yield Finding(
            severity="warning",
            code="rate-not-found",
            message=f"No steady part turned at {' and '.join(unused)}.",
            cure="Check the stated speeds.",
        )
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
        yield Finding(
            severity="problem" if apart > _RATIO_FAIL else "warning",
            code="rates-contradict",
            message=f"The stated speeds contradict each other: the gyroscope shows {turning[high].name} to "
            f"{turning[low].name} in a ratio that is {100 * apart:.2f} % larger than stated.",
            consequence="One of them is wrong, and the scales with it.",
            cure="Measure each speed, such as with a video, or state how well they are known (--rate-sigma).",
        )


def _in_one_attitude(evidence: TurntableEvidence) -> Iterator[Finding]:
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
        yield Finding(
            severity="problem",
            code="rates-contradict",
            message=f"In one orientation the gyroscope shows speeds in a ratio of {shown:.4f}; those stated for them "
            f"have a ratio of {stated:.4f}.",
            consequence="One of the stated speeds is wrong, and the scales with it.",
            cure="Check the stated speeds, or count the turns in a minute at each.",
        )


def _holdout(evidence: TurntableEvidence) -> Iterator[Finding]:
    fit = evidence.fit.fit
    rms, fastest = holdout_rms(fit), float(evidence.parts.data.rate.max())
    severity = graded(rms, _HOLDOUT_WARN * fastest, _HOLDOUT_FAIL * fastest)
    yield Finding(
        severity=severity,
        code="holdout-rate",
        message=f"Steady parts that were left out show their speed to {1e3 * rms:.3f} mrad/s rms.",
        consequence="" if severity == "good" else "The gyroscope does not show the same speed in all orientations.",
        cure=""
        if severity == "good"
        else "Check that the platter keeps its speed, and that the sensor cannot slip on it.",
    )


def _orientations(evidence: TurntableEvidence) -> Iterator[Finding]:
    """Count the axes about which the sensor was turned; one and its opposite are two."""
    direction = evidence.fit.fit.direction[evidence.fit.fit.used]
    direction = direction[np.isfinite(direction).all(axis=1)]
    different: list[np.ndarray] = []
    for axis in direction:
        if all(axis @ other < np.cos(np.radians(_ALIKE_DEG)) for other in different):
            different.append(axis)
    count = len(different)
    few = count < _FEW_AXES
    yield Finding(
        severity="warning" if few else "good",
        code="orientations",
        message=f"The platter's axis had {count} different directions in the sensor.",
        consequence="Fewer than nine leave little to check the result by." if few else "",
        cure="Put the sensor on the platter in eighteen orientations: each face down, and each edge." if few else "",
    )


def held_names(evidence: TurntableEvidence) -> tuple[str, ...]:
    """Return the paths of scalars that only a weak assumption holds."""
    names = [f"imu0.gyroscope.sensitivity[{i},{j}]" for i in range(3) for j in range(3)]
    names += [f"imu0.gyroscope.bias[{i}]" for i in range(3)]
    names += [f"imu0.gyroscope.g_sensitivity[{i},{j}]" for i in range(3) for j in range(3)]
    return tuple(name for name, held in zip(names, evidence.fit.fit.held_by_prior, strict=True) if held)


def _not_observable(evidence: TurntableEvidence) -> Iterator[Finding]:
    held = held_names(evidence)
    if not evidence.fit.fit.scale_known and np.diag(_relative_sigmas(evidence)).max() < _SCALE_FAIL:
        held = tuple(name for name in held if ".sensitivity" not in name)  # the common scale, which is told
    if held:
        yield Finding(
            severity="problem",
            code="not-observable",
            message=f"These recordings do not determine {len(held)} of the gyroscope's numbers ({', '.join(held[:3])}"
            f"{', ...' if len(held) > 3 else ''}).",
            consequence="They are held by a weak assumption and must not be used as measured.",
            cure="Add orientations, with each face of the sensor down once.",
        )


def _left_out(evidence: TurntableEvidence) -> Iterator[Finding]:
    parts, fit = evidence.parts, evidence.fit.fit
    out = [f"{name} ({why})" for name, why in parts.left_out]
    out += [
        f"{name} (it does not agree with the others)"
        for name, used in zip(parts.names, fit.used, strict=True)
        if not used
    ]
    if out:
        more = f" and {len(out) - _MOST_NAMED} more" if len(out) > _MOST_NAMED else ""
        total = len(parts.names) + len(parts.left_out)
        yield Finding(
            severity="warning" if len(out) > 0.1 * total else "info",
            code="parts-left-out",
            message=f"{len(out)} of {total} steady parts left out: {'; '.join(out[:_MOST_NAMED])}{more}.",
            consequence="The others are used.",
            cure="Let the platter reach its speed and turn for some turns, below the end of the sensor's range, before "
            "anything is touched.",
        )


def _platter(evidence: TurntableEvidence, options: TurntableOptions) -> Iterator[Finding]:
    """Tell of speed that wanders, of tilt, of centripetal acceleration and of the earth's rate where they count."""
    data, fit, found = evidence.parts.data, evidence.fit.fit, evidence.fit.accelerometer
    turning = data.rate > 0
    share = np.hypot(np.median(data.wander[turning] / data.rate[turning]), fit.extra_sigma / data.rate[turning].min())
    if share > _WANDER:
        yield Finding(
            severity="warning" if share > 10 * _WANDER else "info",
            code="platter-wanders",
            message=f"The platter's speed differs by {100 * share:.2g} % (1 sigma) from one steady part to the next.",
            consequence="The parts are weighed by that.",
            cure="Let it turn longer in each orientation, and fasten the sensor.",
        )
    slowest = float(data.rate[turning].min())
    earth = EARTH_RATE_RAD_S / np.sqrt(3) / slowest
    if options.latitude is None and earth > 0.5 * float(np.min(fit.group_sigma[data.rates > 0])):
        yield Finding(
            severity="info",
            code="earth-rate",
            message=f"The earth's own rate, up to {100 * EARTH_RATE_RAD_S / slowest:.2g} % of the slowest speed, is "
            "part of the scales' uncertainty.",
            cure="State --latitude to take it off.",
        )
    if found is None:
        return
    if found.tilt > _TILT_RAD:
        yield Finding(
            severity="info",
            code="platter-tilt",
            message=f"The platter's axis is {np.degrees(found.tilt):.2f} deg from the vertical; its direction is taken "
            "from gravity's mean over the turns.",
        )
    apart = [axis for axis in data.axes if axis.rate > 0 and not axis.separated]
    if apart:
        pull = max(axis.rate for axis in apart) ** 2 * 0.1 / evidence.gravity.value
        yield Finding(
            severity="info" if pull < _PULL_RAD else "warning",
            code="centripetal",
            message=f"In {len(apart)} orientations the platter never rested: at 10 cm from its axis the centripetal "
            f"acceleration would turn the measured vertical by {np.degrees(np.arctan(pull)):.2f} deg.",
            consequence="The direction of the platter's axis is trusted no better than that there.",
            cure="Record the platter at rest before it turns in each orientation, or at two speeds.",
        )


def _frames(evidence: TurntableEvidence) -> Iterator[Finding]:
    """Say what the axes of the result mean."""
    found = evidence.fit
    if found.accelerometer is not None:
        yield Finding(
            severity="good",
            code="frames",
            message=f"The platter turned {found.sense}, seen from above, as both triads are right-handed; gravity "
            "relates the gyroscope's axes to those of the accelerometer.",
        )
        return
    recorded = evidence.parts.accelerometer_unit is not None
    why = f"The accelerometer is not used: {evidence.no_accelerometer.rstrip('.')}. " if recorded else ""
    yield Finding(
        severity="warning" if recorded else "info",
        code="frames-unrelated",
        message=f"{why}Magnitudes alone do not relate the gyroscope's axes to any other frame.",
        consequence="The body frame is the gyroscope's own (gyro-x); rotations against an accelerometer are not in it.",
        cure="Record the accelerometer, too, or relate the two by gnomon imu.",
    )


def _scale_far(evidence: TurntableEvidence) -> Iterator[Finding]:
    unit = evidence.parts.gyroscope_unit
    nominal = GYROSCOPE_UNITS_RAD_S[unit]
    if nominal is None:
        return
    ratio = float(np.abs(np.linalg.det(evidence.fit.fit.sensitivity))) ** (1 / 3) * nominal
    if abs(ratio - 1) > _FAR_SCALE:
        yield Finding(
            severity="warning",
            code="scale-far",
            message=f"The gyroscope shows {ratio:.4g} times the stated speed in {unit}.",
            consequence="Either it is that far off, or the platter turned at another speed than stated.",
            cure="Count the turns in a minute, or give a video of the platter as --rate.",
        )


def _drift(evidence: TurntableEvidence) -> Iterator[Finding]:
    if not evidence.fit.drifts:
        return
    fit = evidence.fit.fit
    span = float(np.max(np.ptp(evidence.fit.drift, axis=0) / np.linalg.norm(fit.sensitivity, axis=1)))
    yield Finding(
        severity="info",
        code="bias-drift",
        message=f"The gyroscope's bias moved by {1e3 * span:.2g} mrad/s over the session; it is followed from rest to "
        "rest.",
        cure="Let the sensor warm up before recording.",
    )
