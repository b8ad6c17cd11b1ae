"""The doctor's look at the motion: rests, attitudes, the static start, and gravity as a check of the unit."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Literal

import numpy as np

from ...detect.samples.faults import repair_samples, saturated_samples
from ...detect.samples.rests import RangeChange, RestDetection, Rests, detect_rests
from ...findings import Finding, make_finding
from ...recording import Floats, ImuSamples, TriadSamples
from ...recording.order_statistics import distinct_values, median_of
from ...results.result import StaticIntervals, interval_means
from ...units import ACCELEROMETER_UNITS_M_S2, STANDARD_GRAVITY_M_S2
from .signals import is_silent

TELLS_RESTS = ("attitudes", "always-static", "intervals-left-out")
_LISTED = 6  # runs of rests with one reason
_MANY = 0.1  # of the rests


def left_out_rests_findings(start_s: Floats, stop_s: Floats, reason: Sequence[str], label: str = "") -> list[Finding]:
    """Name the rests that are not used, with time, by reason; those behind each other as one run.

    Parameters
    ----------
    start_s, stop_s : (n,) of all rests that were found [s from the start of the recording]
    reason : (n,) why a rest is not used, or ""
    label : begins the message
    """
    out = [k for k, why in enumerate(reason) if why]
    if not out:
        return []
    listed: list[str] = []
    for why in dict.fromkeys(reason[k] for k in out):
        own = np.array([k for k in out if reason[k] == why])
        runs = np.split(own, np.flatnonzero(np.diff(own) > 1) + 1)
        names = [f"{run[0] + 1} to {run[-1] + 1}" if len(run) > 1 else f"{run[0] + 1}" for run in runs[:_LISTED]]
        shown = [
            f"{name} ({start_s[run[0]]:.1f} to {stop_s[run[-1]]:.1f} s)" for name, run in zip(names, runs, strict=False)
        ]
        more = f" and {sum(map(len, runs[_LISTED:]))} more, which the report lists" if len(runs) > _LISTED else ""
        listed.append(f"{', '.join(shown)}{more}: {why}")
    return [
        make_finding(
            "intervals-left-out",
            severity="warning" if len(out) > _MANY * len(reason) else "info",
            label=label,
            count=len(out),
            total=len(reason),
            listed="; ".join(listed),
        )
    ]


_APART_DEG = 10.0
_SOME, _NEEDED, _GOOD = 6, 9, 12  # attitudes: for scales and bias; for all nine parameters; to let errors show
_START_S = 20.0
_STILL = 0.9  # of the time at rest: the sensor was not turned between its rests either
_LAG_S = 0.05
_UNSTEADY, _MOVING = 1.35, 1.8  # wander within an interval; 0.9 to 1.1 where a sensor really rests
_PLAUSIBLE, _POSSIBLE = 0.15, 0.5  # relative error of gravity at rest, uncalibrated
_NONE = 0.1  # of gravity: less is none
_LOOKED_AT = 24  # intervals


def check_protocol(imu: ImuSamples, label: str, detection: RestDetection | None) -> list[Finding]:
    """Return findings on how the recording was made, by its rests; linear time."""
    accelerometer, found = imu.accelerometer, Rests.none()
    if detection is not None:
        accelerometer, found = detection.motion.samples, detection.chosen.rests
        imu = replace(imu, accelerometer=accelerometer, gyroscope=detection.gyroscope)
    rests = found.intervals
    unrest = _unrest(imu, rests) if len(rests) else float("inf")
    if unrest > _MOVING:
        return [make_finding("never-static", label=label, duration_s=accelerometer.duration_s)]
    means = interval_means(accelerometer.values, rests)
    attitudes, radius = distinct_attitudes(means, accelerometer)
    findings = _gravity(means, radius, accelerometer, label)
    if detection is not None and detection.range_change is not None:
        severity = "problem" if any(one.severity == "problem" for one in findings) else "warning"
        findings.insert(0, range_changed_finding(detection.range_change, accelerometer, label, severity))
    if unrest > _UNSTEADY:
        findings.append(make_finding("rests-unsteady", label=label, unrest=unrest))
    total = float((found.found.stop - found.found.start).sum()) / len(accelerometer)
    t_s = accelerometer.t_s
    left_out = left_out_rests_findings(t_s[found.kept.start], t_s[found.kept.stop - 1], found.reason, f"{label}: ")
    if attitudes < 2 and total > _STILL:
        return [*findings, make_finding("always-static", label=label, total=total), *left_out]
    findings += [_attitudes(attitudes, found, total, label), *left_out]
    findings.append(_static_start(accelerometer, found.found, label))
    if len(imu.gyroscope) > 1 and is_silent(imu.gyroscope):
        findings.append(make_finding("gyroscope-silent/rests", label=label, attitudes=attitudes))
    return findings


def find_imu_rests(
    imu: ImuSamples,
    *,
    window_s: float = 1.0,
    multiplier: float | None = None,
    accelerometer_range: float | None = None,
    gravity_m_s2: float = 9.81,
    counted: bool = False,
) -> RestDetection | None:
    """Find the rests of an IMU as every calibration does; None where it is shorter than two windows.

    Parameters
    ----------
    imu : as recorded
    window_s, multiplier, gravity_m_s2 : see `detect_rests`
    accelerometer_range : what the accelerometer can measure [unit], where it is known
    counted : whether the samples are on a uniform time base whatever their timestamps
    """
    accelerometer, gyroscope = (repair_samples(triad, counted=counted) for triad in (imu.accelerometer, imu.gyroscope))
    times = [
        np.asarray(1e-9 * (triad.t_ns - accelerometer.t_ns[0]), np.float64) for triad in (accelerometer, gyroscope)
    ]
    return detect_rests(
        accelerometer,
        gyroscope,
        saturated_samples(accelerometer, accelerometer_range),
        t_s=(times[0], times[1]),
        window_s=window_s,
        multiplier=multiplier,
        gravity_m_s2=gravity_m_s2,
    )


def _unrest(imu: ImuSamples, rests: StaticIntervals) -> float:
    """Return how much more a signal wanders within an interval than over 0.05 s; 1 for noise, median of the intervals.

    The detector looks for the quietest parts of a recording, and always finds some. Noise at rest changes as much in
    0.05 s as in a second; the slow sway of a motion does not. Both triads are looked at (geometric mean).
    """
    ratios: list[float] = []
    chosen = distinct_values(np.linspace(0, len(rests) - 1, min(len(rests), _LOOKED_AT)).astype(np.int64))
    edges = imu.accelerometer.t_ns[rests.start[chosen]], imu.accelerometer.t_ns[rests.stop[chosen] - 1]
    for samples in (imu.accelerometer, imu.gyroscope):
        if len(samples) < 2:
            continue
        lag = max(1, round(_LAG_S * samples.rate_hz))
        first, last = np.searchsorted(samples.t_ns, edges[0]), np.searchsorted(samples.t_ns, edges[1])
        found = [_wander(samples.values[a:b], lag) for a, b in zip(first, last, strict=True) if b - a > 4 * lag]
        if found:
            ratios.append(float(median_of(found)))
    return float(np.exp(np.mean(np.log(ratios)))) if ratios else 1.0


def _wander(values: Floats, lag: int) -> float:
    length = 40 * lag  # two seconds are enough, and a slow drift of the bias is no motion
    values = values[:length]
    short = 0.5 * float(((values[lag:] - values[:-lag]) ** 2).mean(axis=0).sum())
    return max(float(np.sqrt(values.var(axis=0).sum() / short)), 1e-3) if short > 0 else 1.0


def distinct_attitudes(means: Floats, accelerometer: TriadSamples) -> tuple[int, float]:
    """Return how many attitudes are at least 10 degrees apart, and gravity in the unit (nan if unknown).

    A chord between two readings of gravity needs no bias, only the radius of the sphere on which they lie: gravity in
    the unit. Raw counts, whose axes may have any scale, are divided by the range of each axis first.

    Parameters
    ----------
    means : (n, 3) over the rests [unit]
    accelerometer : its unit and samples
    """
    factor = ACCELEROMETER_UNITS_M_S2[accelerometer.unit]
    if factor:
        radius = STANDARD_GRAVITY_M_S2 / factor
        return _count_apart(means, radius), radius
    spread = 0.5 * np.ptp(means, axis=0)
    turned = spread > 5 * _rest_noise(accelerometer)
    if not turned.any():
        return 1, float("nan")
    scaled = np.where(turned, means / np.where(turned, spread, 1.0), 0.0)
    radius = _sphere_radius(scaled)
    # Too few attitudes lie on no certain sphere; half their span is then the least radius.
    span = float(np.linalg.norm(np.ptp(scaled, axis=0)))
    alike = turned.all() and spread.max() < 2 * spread.min()
    return (
        _count_apart(scaled, radius if np.isfinite(radius) else 0.5 * span),
        _sphere_radius(means) if alike else float("nan"),
    )


def _count_apart(means: Floats, radius: float) -> int:
    limit = 2 * radius * np.sin(np.radians(_APART_DEG) / 2)
    kept = means[:1]
    for mean in means[1:]:
        if (((kept - mean) ** 2).sum(axis=1) > limit**2).all():
            kept = np.vstack([kept, mean])
    return len(kept)


def _rest_noise(samples: TriadSamples) -> Floats:
    """Return the sample-to-sample noise of each axis, (3,) [unit]."""
    steps = np.diff(samples.values[:5000], axis=0)
    return np.sqrt((steps**2).mean(axis=0) / 2)


def _sphere_radius(points: Floats) -> float:
    """Return the radius of the sphere through points (n, 3) by linear least squares; nan if they leave it open."""
    if len(points) < 5:
        return float("nan")
    centred = points - points.mean(axis=0)
    size = float(np.sqrt((centred**2).sum(axis=1).mean()))
    if size == 0:
        return float("nan")
    centred = centred / size
    design = np.column_stack([2 * centred, np.ones(len(centred))])
    solution, _, rank, singular = np.linalg.lstsq(design, (centred**2).sum(axis=1), rcond=None)
    if rank < 4 or singular[-1] < 0.05 * singular[0]:
        return float("nan")
    square = float(solution[3] + (solution[:3] ** 2).sum())
    return size * float(np.sqrt(square)) if square > 0 else float("nan")


def _gravity(means: Floats, radius: float, accelerometer: TriadSamples, label: str) -> list[Finding]:
    factor = ACCELEROMETER_UNITS_M_S2[accelerometer.unit]
    if factor is None:
        if not np.isfinite(radius):
            return []
        message = f"{label}: gravity is about {radius:.4g} counts."
        return [make_finding("gravity-magnitude/counts", message=message)]
    found = float(median_of(np.linalg.norm(means, axis=1))) * factor
    error = abs(found / STANDARD_GRAVITY_M_S2 - 1)
    message = f"{label}: the accelerometer reads {found:.3f} m/s^2 at rest, expected about 9.81." + looks_like(
        found / factor, accelerometer.unit
    )
    if error <= _PLAUSIBLE:
        return [make_finding("gravity-magnitude/good", message=message)]
    return [
        make_finding(
            "gravity-magnitude/rest",
            severity="problem" if error > _POSSIBLE else "warning",
            message=message,
            found=why_no_gravity(found, message),
        )
    ]


def range_changed_finding(
    change: RangeChange, accelerometer: TriadSamples, label: str, severity: Literal["warning", "problem"]
) -> Finding:
    """Return that the accelerometer reads gravity as another number from an instant on."""
    t_s = accelerometer.t_s
    return make_finding(
        "range-changed",
        severity=severity,
        label=label,
        factor=change.factor,
        t_from_s=t_s[change.last],
        t_to_s=t_s[change.first],
    )


def looks_like(gravity: float, unit: str) -> str:
    """Return " It looks like g." where gravity as it was read is that of another unit; else ""."""
    for name, size in ACCELEROMETER_UNITS_M_S2.items():
        if size and name != unit and abs(gravity * size / STANDARD_GRAVITY_M_S2 - 1) <= _PLAUSIBLE:
            return f" It is in {name}, not in {unit}." if name != "m/s^2" else " It is in m/s^2 already."
    return ""


def why_no_gravity(found_m_s2: float, message: str) -> str:
    """Return what makes an accelerometer read far from gravity: the unit where it is known, none at all, or either."""
    if "It is in" in message:
        return "The stated unit is wrong."
    if found_m_s2 < _NONE * STANDARD_GRAVITY_M_S2:
        return "Most likely gravity was removed, as phones do for their linear acceleration."
    return "The unit is wrong, gravity was removed, or bias or scale are far off."


def _attitudes(attitudes: int, rests: Rests, share: float, label: str) -> Finding:
    usable = int(rests.used.sum())
    number = "1 rest" if len(rests) == 1 else f"{len(rests)} rests"
    where = " in one attitude" if attitudes == 1 else f" in {attitudes} attitudes more than 10 deg apart"
    message = f"{label}: {number} ({100 * share:.0f} % of the time){where}" + (
        f", {usable} of them usable." if usable < len(rests) else "."
    )
    if attitudes >= _GOOD:
        return make_finding("attitudes/enough", message=message)
    return make_finding(
        "attitudes/few",
        severity="warning" if attitudes >= _NEEDED else "problem",
        case="enough" if attitudes >= _NEEDED else "some" if attitudes >= _SOME else "",
        message=message,
    )


def _static_start(samples: TriadSamples, rests: StaticIntervals, label: str) -> Finding:
    begins = (samples.t_ns[rests.start[0]] - samples.t_ns[0]) * 1e-9
    length = (samples.t_ns[rests.stop[0] - 1] - samples.t_ns[rests.start[0]]) * 1e-9 if begins < 1.0 else 0.0
    message = f"{label}: the recording starts with {length:.1f} s at rest."
    if length >= _START_S:
        return make_finding("static-start/good", message=message)
    return make_finding("static-start/short", severity="info" if length > 0 else "warning", message=message)
