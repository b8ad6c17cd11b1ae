"""What changed while an IMU was recorded: axes, range, the sensor itself, and biases that stepped or wandered.

Of biases it is said what they did, and which one is published.
"""

from collections.abc import Iterator

import numpy as np

from ...estimate.multiposition.model import PARAMETERS, BiasFunctions
from ...estimate.multiposition.problem import MultiPositionProblem
from ...estimate.multiposition.triad_changes import find_axes_change
from ...findings import Finding, list_first, make_finding
from ...recording import Floats
from ...results.result import Booleans
from ...results.sensor_diagnostics import BiasSegments, ImuDiagnostics
from ...results.sensors import TemperatureDependence
from .imu_tables import ImuFitSummary, interval_numbers

_TRIADS, _BIASES = ("gyroscope", "accelerometer"), (slice(21, 24), slice(9, 12))
_SEEN = 0.3  # of the bias's sigma, from which on a course is worth a word
_SHOWN = 4  # parts of a recording
_MOST_USED = 0.5  # of the static intervals of a part: where fewer show the same gravity, it is of another sensor
_MOSTLY = 0.5  # of a variance
_CURVE = 100  # temperatures at which a polynomial is looked at
_SHORT = 5  # static intervals: fewer tell the published bias from little


def changes_in_model(evidence: ImuFitSummary) -> tuple[str, ...]:
    """Return what the biases follow in time, such as ("drift", "accelerometer bias steps")."""
    found: list[str] = []
    for k, triad in enumerate(("", "accelerometer ")):
        if _course(evidence, k) is not None:
            found.append(f"{triad}drift")
        if _functions(evidence, k).of_kind("step").any():
            found.append(f"{triad}bias steps")
        if _functions(evidence, k).of_kind("temperature").any():
            found.append(f"{triad}bias over the temperature")
    return tuple(found)


def drift_findings(evidence: ImuFitSummary) -> list[Finding]:
    """Say how far the biases wandered or warmed up, where they did."""
    findings = list[Finding]()
    for k, triad in enumerate(_TRIADS):
        moved = _course(evidence, k)
        if moved is None:
            continue
        if _functions(evidence, k).of_kind("warm-up").any():
            findings.append(
                make_finding(
                    "warm-up",
                    triad=triad,
                    moved=_shown(triad, float(np.ptp(moved, axis=0).max())),
                    warm_up_s=evidence.fit.changes[k].warm_up_s,
                )
            )
        else:
            findings.append(
                make_finding(
                    f"{triad}-drift/imu",
                    case="stepped" if evidence.fit.changes[k].steps else "",
                    moved=_shown(triad, float(np.abs(moved).max())),
                )
            )
    findings += _slope_findings(evidence)
    for triad, own in zip(_TRIADS, _BIASES, strict=True):
        unseen, sigma = evidence.unseen_sigma[own], np.sqrt(np.diag(evidence.estimate.covariance)[own])
        if np.any(unseen**2 > _MOSTLY * sigma**2):
            size = float(np.max(unseen / _per_si(evidence, triad)))
            findings.append(make_finding("bias-change-possible", triad=triad, size=_shown(triad, size)))
    return findings


def _slope_findings(evidence: ImuFitSummary) -> Iterator[Finding]:
    """Yield by how much the biases follow the temperature."""
    found = evidence.temperature
    if found is None:
        return
    first = len(evidence.unseen_sigma)
    for part, coefficients in found.parts():
        own = slice(first, first := first + coefficients.size)
        per_si = _per_si(evidence, part.removesuffix("_bias"))
        scale = np.tile(1 / per_si, len(coefficients))
        covariance = evidence.estimate.covariance[own, own] * np.outer(scale, scale)
        yield slope_finding(part, coefficients / per_si, covariance, found)


def slope_finding(
    part: str, coefficients: Floats, covariance: Floats, found: TemperatureDependence, unit: str = ""
) -> Finding:
    """Say by how much a bias, or a scale, follows the temperature.

    Parameters
    ----------
    part : such as "gyroscope_bias"
    coefficients, covariance : (order, 3) and (3 order, 3 order) [SI per K^j]
    found : in which range, about which reference
    unit : "uT" or "local field" of a magnetometer's bias, "1" of scales; else it follows from the part
    """
    triad, kind = part.split("_")
    what = {"bias": "bias", "sensitivity": "scale"}[kind]
    d = np.linspace(found.low_degc, found.high_degc, _CURVE) - found.reference_degc
    powers = np.vander(d, len(coefficients) + 1, increasing=True)[:, 1:]
    moved = powers @ coefficients
    worst = int(np.argmax(np.ptp(moved, axis=0)))
    ends = powers[np.argmax(moved[:, worst])] - powers[np.argmin(moved[:, worst])]
    return make_finding(
        "temperature-slope",
        triad=triad,
        what=what,
        change=_shown(triad, float(np.ptp(moved[:, worst])), unit),
        sigma=_shown(triad, float(np.sqrt(ends @ covariance[worst::3, worst::3] @ ends)), unit),
        low=found.low_degc,
        high=found.high_degc,
        reference=found.reference_degc,
        more=_TURN_IT if triad == "magnetometer" else _WARM_IT,
    )


def step_findings(evidence: ImuFitSummary, diagnostics: ImuDiagnostics) -> list[Finding]:
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
            make_finding(
                "rates-left-out", plural="s" if several else "", intervals=interval_numbers(marked), count=len(marked)
            )
        )
    return findings


def _sensor_finding(evidence: ImuFitSummary, diagnostics: ImuDiagnostics) -> list[Finding]:
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
        make_finding(
            "sensor-changed/gap",
            severity="problem" if severity == "problem" else "warning",
            stop_s=found.stop_s[row - 1],
            start_s=found.start_s[row],
            between_s=0.5 * (found.stop_s[row - 1] + found.start_s[row]),
        )
    ]


def _cluster_finding(evidence: ImuFitSummary, diagnostics: ImuDiagnostics) -> list[Finding]:
    """Say that static intervals behind each other do not agree with the others: too few to tell what changed."""
    rests = diagnostics.intervals
    usable = np.flatnonzero(evidence.chosen.rests.used)
    ends = significant_cluster(~rests.used[usable])
    if ends is None:
        return []
    first, last = usable[list(ends)]
    cuts = [0.5 * float(rests.stop_s[k - 1] + rests.start_s[k]) for k in (first, last + 1) if 0 < k < len(rests.used)]
    at = " and ".join(f"{cut:.1f} s" for cut in cuts)
    when = f"between {at}" if len(cuts) > 1 else f"from {at} on" if first else f"until {at}"
    marked = ~rests.used
    marked[:first], marked[last + 1 :] = False, False
    return [
        make_finding(
            "sensor-changed/intervals", intervals=interval_numbers(marked), count=len(marked), when=when, at=at
        )
    ]


def _step_finding(evidence: ImuFitSummary, one: BiasSegments) -> Finding:
    per_si = _per_si(evidence, one.triad)
    steps = np.diff(one.bias, axis=0) / per_si
    when = [
        f"between {stop:.1f} s and {start:.1f} s" if start > stop else f"at {stop:.1f} s, at rest"
        for stop, start in zip(one.stop_s[:-1], one.start_s[1:], strict=True)
    ]
    where = [f"{_shown(one.triad, float(np.abs(step).max()))} {at}" for step, at in zip(steps, when, strict=True)]
    parts = [
        f"{one.start_s[k]:.0f} to {one.stop_s[k]:.0f} s: {' '.join(f'{x:.5g}' for x in one.bias[k] / per_si)}"
        for k in range(len(one.bias))
    ]
    unit = "rad/s" if one.triad == "gyroscope" else "m/s^2"
    t_s = evidence.accelerometer.t_s[evidence.accelerometer.intervals.start]
    few = int(np.sum(t_s >= one.start_s[one.published])) < _SHORT
    return make_finding(
        "bias-step",
        severity="warning" if few else "info",
        triad=one.triad,
        where=list_first(where, _SHOWN, "; by "),
        case="few" if few else "",
        unit=unit,
        parts="; ".join(parts[-_SHOWN:]),
        short=_SHORT,
    )


def _course(evidence: ImuFitSummary, k: int) -> Floats | None:
    """Return how a bias wandered or warmed up over the rests, (n, 3) [SI]; None where less than its sigma shows."""
    functions = _functions(evidence, k)
    smooth = functions.of_kind("walk", "line", "warm-up")
    if not smooth.any():
        return None
    moved = functions.at_rest[:, smooth] @ _coefficients(evidence, k)[smooth]
    sigma = np.sqrt(np.diag(evidence.estimate.covariance)[_BIASES[k]])
    return moved / _per_si(evidence, _TRIADS[k]) if np.any(np.abs(moved) > _SEEN * sigma) else None


def _functions(evidence: ImuFitSummary, k: int) -> BiasFunctions:
    """Return the functions of time of the gyroscope's bias (k = 0) or the accelerometer's (1)."""
    return (evidence.fit.data.of_gyroscope, evidence.fit.data.of_accelerometer)[k]


def _coefficients(evidence: ImuFitSummary, k: int) -> Floats:
    """Return the coefficients (j, 3) [unit] of the functions of time of the gyroscope (k = 0) or accelerometer (1)."""
    fit, problem = evidence.fit, evidence.problem
    count = len(fit.data.of_gyroscope.kind)
    knots = fit.state.theta[PARAMETERS:].reshape(-1, 3)
    return (knots[:count] * problem.gyroscope.spread, knots[count:] * problem.accelerometer.spread)[k]


def _per_si(evidence: ImuFitSummary, triad: str) -> Floats:
    """Return what one rad/s or m/s^2 reads on each axis, (3,) [unit]."""
    return np.linalg.norm(getattr(evidence.estimate, f"{triad}_sensitivity"), axis=1)


_TURN_IT = "turn it through all attitudes while it warms up by more, and cools again"
_WARM_IT = "and turn-on scatter record warm-ups at rest: gnomon temperature WARM-UP... --calibration RESULT"
_PARTS_OF = {"1": " %", "local field": " % of the local field"}


def _shown(triad: str, size: float, unit: str = "") -> str:
    if unit:
        return f"{100 * size:.2g}{_PARTS_OF[unit]}" if unit in _PARTS_OF else f"{size:.2g} {unit}"
    if triad == "gyroscope":
        return f"{1e3 * size:.2g} mrad/s ({np.degrees(size):.2g} deg/s)"
    return f"{1e3 * size:.2g} mm/s^2"


def axes_changed_findings(problem: MultiPositionProblem) -> list[Finding]:
    """Return that from one instant on the axes of a triad, or the gyroscope's scale, are others.

    Parameters
    ----------
    problem : with all rests, also those at which gravity is read as no other rest has it
    """
    change = find_axes_change(problem)
    if change is None:
        return []
    t_from_s, t_to_s = problem.start_s[change.row], problem.stop_s[change.row]
    if change.factor != 1:
        return [
            make_finding(
                "gyroscope-range-changed", label="imu0", factor=change.factor, t_from_s=t_from_s, t_to_s=t_to_s
            )
        ]
    read = [
        f"{axis} reads what would have been {'-' if row.sum() < 0 else ''}{'xyz'[int(np.argmax(np.abs(row)))]}"
        for axis, row, same in zip("xyz", change.after, np.eye(3), strict=True)
        if (row != same).any()
    ]
    return [
        make_finding(
            "axes-changed",
            label="imu0",
            triad=change.triad,
            read=", ".join(read),
            t_from_s=t_from_s,
            t_to_s=t_to_s,
        )
    ]


_FEWEST = 3  # rests behind each other
_CHANCE = 0.05  # that rests left out independently of each other lie as close together


def significant_cluster(out: Booleans) -> tuple[int, int] | None:
    """Return the first rest and the last one of those left out behind each other; None where chance explains them.

    Of the stretches that hold three or more, and more left out than used, the one that is least likely where as many
    are left out independently: the hypergeometric probability, times the places where it may begin.

    Parameters
    ----------
    out : (n,) rests that do not agree with the others
    """
    at = np.flatnonzero(out)
    if len(at) < _FEWEST:
        return None
    from scipy.stats import hypergeom  # slow to load, and rarely needed

    least, found = _CHANCE, None
    for k, first in enumerate(at):
        for held, last in enumerate(at[k + _FEWEST - 1 :], start=_FEWEST):
            length = last - first + 1
            places = len(out) - length + 1
            chance = places * float(hypergeom.sf(held - 1, len(out), len(at), length))
            if 2 * held > length and chance < least:
                least, found = chance, (int(first), int(last))
    return found
