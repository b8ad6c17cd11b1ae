"""What verdicts on calibrations of any kind have in common: severity, verdict, trust, and which findings are causes.

Findings are the consequence of a cause where it makes them by itself: a wrong spacing of the tags looks like a wrong
size of the board, a clock that jumped like one that drifts. They are kept, as information that names the cause, and the
cause takes over their severity.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import radians, sqrt

from ..estimate.trust.parts import Instability
from ..findings import Finding, Severity, list_first, make_finding
from ..options.requirements import GENERAL_RIG
from ..results.calibration import Assessment, Gravity, Verdict
from ..results.trust import SigmaRatio, Splits, Trust, UncertaintySummary
from ..units import STANDARD_GRAVITY_M_S2

SEVERITIES: dict[Severity, int] = {"problem": 0, "warning": 1, "info": 2, "good": 3}
"""The worst first."""

_LOUD = ("problem", "warning")

_BENT = frozenset(
    {
        *("not-converged", "target-scale", "intrinsics-doubtful", "reprojection", "frames-left-out", "noise-differs"),
        *("model-too-simple", "model-incomplete", "parts-disagree", "rotation-disagrees", "imprecise", "clock-drift"),
        *("corners-outlying", "gyroscope-drift", "walk-differs", "need", "triad-filtered"),
    }
)
"""What a camera-IMU estimation says when something does not fit, whatever it is."""

_MISFIT = frozenset(
    {
        *("reprojection", "board-found", "board-bow", "board-aspect", "lens-uncertain", "views-left-out"),
        *("corners-outlying", "holdout-reprojection", "parts-disagree", "not-converged", "baseline-uncertain"),
    }
)
"""What a calibration of cameras alone says where the lens model is wrong."""

_EXPLAINS: dict[str, frozenset[str]] = {
    "stamps-unit": _BENT | {"streams-apart", "clock-drift"},
    "triads-apart": _BENT | {"never-static", "rotations-left-out", "holdout-rotation", "rests-unsteady"},
    "gravity-magnitude": frozenset({"attitudes", "always-static", "unit", "gravity-doubtful"}),
    "axis-stuck": frozenset({"attitudes", "never-static", "rests-unsteady", "vibration", "gravity-magnitude"}),
    "rate-changed": frozenset({"noise-differs", "imu-rate"}),
    "range-changed": frozenset({"gravity-magnitude", "unit"}),
    "gyroscope-range-changed": frozenset(
        {
            *_BENT,
            *("frames-late", "board-moved", "clock-jump", "rotation-one-axis"),
            *("not-observable", "parameter-changed", "unit", "rotations-left-out", "holdout-rotation", "beyond-noise"),
            *("uncertainty-gyroscope", "parts-disagree", "model-incomplete"),
        }
    ),
    "axes-changed": frozenset(
        {
            *_BENT,
            *("axes-differ", "sensor-changed", "intervals-left-out", "holdout-accelerometer", "holdout-rotation"),
            *("not-observable", "parameter-changed", "rotations-left-out", "beyond-noise", "static-start"),
            *("uncertainty-accelerometer", "uncertainty-gyroscope", "parts-disagree", "model-incomplete"),
        }
    ),
    "rotation-breaks": _BENT | {"not-observable", "parameter-changed", "frames-late", "board-moved", "distortion"},
    "axes-differ": _BENT | {"triads-apart"},
    "axes-mirrored": _BENT | {"triads-apart"},
    "dead-band": frozenset({"samples-stuck", "samples-repeated", "noise-repeated", "isolated-readings"}),
    "samples-repeated": frozenset({"noise-differs", "jitter"}),
    "jitter": frozenset({"time-repeated", "noise-differs", "gyroscope-drift", "frames-late", "triads-apart"}),
    "saturation": frozenset(
        {"rotations-left-out", "target-scale", "noise-differs", "parts-disagree", "board-moved", "frames-late"}
    ),
    "gaps": frozenset({"rotations-left-out"}),
    "tag-spacing": (_BENT | {"distortion"}) - {"clock-drift"},
    "rolling-shutter": (_BENT | {"frames-late", "board-moved", "triads-apart"}) - {"clock-drift"},
    "distortion": (_BENT | {"frames-late", "board-moved", "triads-apart"}) - {"clock-drift"},
    "frames-repeated": _BENT | {"frames-late", "triads-apart", "board-moved"},
    "clock-jump": _BENT | {"frames-late", "triads-apart", "board-moved", "time-shift-varies"},
    "board-moved": _BENT | {"frames-late", "triads-apart"},
    "frames-late": _BENT | {"triads-apart", "time-shift-varies"},
    "triad-filtered": frozenset({"noise-differs", "model-incomplete", "parts-disagree", "imprecise", "need"}),
    "vibration": frozenset({"noise-differs", "model-incomplete", "parts-disagree", "rests-unsteady"}),
    "rotation-one-axis": frozenset({"not-converged", "imprecise", "parts-disagree", "need"}),
    "target-scale": frozenset({"model-incomplete", "parts-disagree"}),
    "intrinsics-doubtful": frozenset({"model-incomplete", "parts-disagree", "target-scale", "reprojection"}),
    "model-too-simple": frozenset({"model-incomplete", "parts-disagree"}),
    "motion-slow": frozenset(
        {
            "rotation-disagrees",
            "parts-disagree",
            "model-incomplete",
            "imprecise",
            "rate-magnitude",
            "need",
        }
    ),
    "few-attitudes": frozenset({"uncertainty-accelerometer"}),
    "not-observable": frozenset(
        {"uncertainty-accelerometer", "uncertainty-gyroscope", "holdout-accelerometer", "holdout-rotation", "imprecise"}
    ),
    "attitudes-alike": frozenset({"lens-uncertain", "not-converged", "parts-disagree", "holdout-reprojection"}),
    "views-few": frozenset({"lens-uncertain", "not-converged", "holdout-reprojection", "baseline-uncertain"}),
    "lens-model": _MISFIT,
    "board-small": frozenset({"lens-uncertain", "image-coverage", "not-converged", "baseline-uncertain"}),
    "image-coverage": frozenset({"lens-uncertain"}),
    "parameter-changed": frozenset(
        {
            *("parts-disagree", "model-incomplete", "holdout-accelerometer", "holdout-rotation"),
            *(
                "rotations-left-out",
                "uncertainty-accelerometer",
                "uncertainty-gyroscope",
                "beyond-noise",
                "imprecise",
                "lens-uncertain",
                "turn-unseen",
            ),
        }
    ),
    "accelerometer-drift": frozenset({"holdout-accelerometer", "beyond-noise", "model-incomplete", "parts-disagree"}),
}
"""Cause -> what it explains; causes in the order in which they are told, the most fundamental first."""

_ORDER = {code: rank for rank, code in enumerate(_EXPLAINS)}
_SYMPTOMS = frozenset().union(*_EXPLAINS.values()) - _EXPLAINS.keys()
_SEEN_BY_EACH_CAMERA = "triads-apart"  # with other digits; it is told once of an IMU


def merge_by_cause(findings: list[Finding]) -> tuple[Finding, ...]:
    """Return findings by severity, causes before what follows from them, otherwise in their order."""
    seen = {f.subject: f for f in reversed(findings) if f.code == _SEEN_BY_EACH_CAMERA}
    told = _explained([f for f in findings if f.code != _SEEN_BY_EACH_CAMERA or f is seen[f.subject]])
    return tuple(sorted(told, key=lambda finding: (SEVERITIES[finding.severity], _rank(finding.code))))


def _rank(code: str) -> int:
    return _ORDER.get(code, len(_ORDER) + (code in _SYMPTOMS))


def _explained(findings: list[Finding]) -> list[Finding]:
    """Return findings of which those that follow from a loud cause are information, and it is as bad as they were."""
    told = list(findings)
    for cause in sorted({f.code for f in told if f.severity in _LOUD and f.code in _EXPLAINS}, key=_ORDER.__getitem__):
        if not any(f.code == cause and f.severity in _LOUD for f in told):
            continue  # another cause explains this one
        follow = [
            k for k, f in enumerate(told) if f.severity != "good" and f.code in _EXPLAINS[cause] and not f.follows_from
        ]
        worst: Severity = "problem" if any(told[k].severity == "problem" for k in follow) else "warning"
        for k in follow:
            told[k] = replace(
                told[k], severity="info", consequence=f"It follows from: {cause}.", cure="", follows_from=cause
            )
        for k, finding in enumerate(told):
            if finding.code == cause and SEVERITIES[worst] < SEVERITIES[finding.severity] < SEVERITIES["info"]:
                told[k] = replace(finding, severity=worst)
                break
    return told


_INCOMPLETE = 2.0
"""Published sigma over that for independent errors from which on the model leaves something out."""
_VARIES = 5.0  # the same, from which on a time shift is no constant

_SHOWN = 3


def uncertainty_summary(trust: Trust) -> UncertaintySummary:
    """Return what the calibration file keeps."""
    clusters = trust.clusters
    return UncertaintySummary(
        covariance="ordinary" if clusters is None else "cluster-robust",
        clusters=0 if clusters is None else clusters.count,
        cluster_s=0.0 if clusters is None else clusters.length_s,
        sigma_ratio={entry.block: entry.ratio for entry in trust.ratios},
        split_z=float("nan") if trust.splits is None else trust.splits.z_rms,
    )


def underestimated_blocks(trust: Trust) -> list[SigmaRatio]:
    """Return the blocks whose errors are larger than independent errors would be, the worst first."""
    wide = [entry for entry in trust.ratios if entry.ratio > _INCOMPLETE]
    return sorted(wide, key=lambda entry: -entry.ratio) if trust.clusters is not None else []


def model_incomplete(trust: Trust, likely: Sequence[str] = (), cure: str = "") -> list[Finding]:
    """Say where errors are larger than independent errors would be: the model leaves something out.

    Parameters
    ----------
    trust : of a result
    likely : what the residuals show to be missing, as parts of a sentence
    cure : the next step
    """
    wide = underestimated_blocks(trust)
    if not wide or trust.clusters is None:
        return []
    missing = f" Likely missing: {'; '.join(likely)}." if likely else ""
    return [
        make_finding(
            "model-incomplete/rig",
            lasting=_lasting(trust.clusters.memory_s),
            listed=list_first([f"{entry.block} {entry.ratio:.2g} times" for entry in wide], _SHOWN),
            stretches=trust.clusters.count,
            missing=missing,
            cure=cure,
        )
    ]


def _lasting(memory_s: float) -> str:
    return f"Errors that last for {memory_s:.2g} s" if memory_s > 0 else "Errors of different size"


def time_shift_varies(trust: Trust) -> list[Finding]:
    """Say that a camera's time shift differs from one stretch of time to the next, by more than general use needs."""
    found: list[Finding] = []
    for entry in underestimated_blocks(trust):
        name, _, path = entry.block.partition(".")
        if trust.clusters is None or path != "time_shift_cam_imu" or entry.ratio < _VARIES:
            continue
        spread_s = float(trust.sigma[trust.names.index(entry.block)]) * sqrt(trust.clusters.count)
        if spread_s > GENERAL_RIG.needs["time_shift"]:
            found.append(make_finding("time-shift-varies", name=name, spread_ms=1e3 * spread_s, ratio=entry.ratio))
    return found


def parts_disagree(splits: Splits | None, cure: str = "") -> list[Finding]:
    """Say that parts of the recording contradict each other by more than their sigmas allow."""
    if splits is None or splits.z_rms <= splits.limit:
        return []
    worst = max(splits.blocks, key=lambda entry: entry.z_rms)
    return [
        make_finding(
            "parts-disagree",
            splits=", ".join(splits.splits),
            z_rms=splits.z_rms,
            limit=splits.limit,
            block=worst.block,
            largest=worst.largest,
            where=worst.where,
            case="explained" if cure else "",
            cure=cure,
        )
    ]


_SHOWN_IN = {"accelerometer": "m/s^2", "gyroscope": "rad/s", "magnetometer": "of the field"}


def bias_findings(instabilities: Sequence[Instability], per_si: Mapping[str, float]) -> list[Finding]:
    """Say which biases differ between parts of the recording that follow each other, and by how much.

    Parameters
    ----------
    instabilities : of the biases
    per_si : triad -> its unit per SI unit
    """
    findings: list[Finding] = []
    for one in instabilities:
        if not one.proven:
            continue
        triad = one.block.split(".")[1]
        scale = 1 / per_si[triad]
        findings.append(
            make_finding(
                "bias-instability/recordings",
                triad=triad,
                moved=scale * one.size,
                unit=_SHOWN_IN[triad],
                where=one.where,
                sigmas=one.size / one.sigma,
            )
        )
    return findings


_ON_EARTH_M_S2 = 9.76, 9.84


def verdict_of(findings: tuple[Finding, ...]) -> Verdict:
    """Return fail where a problem was found, warn where a warning was, else pass."""
    severities = {finding.severity for finding in findings}
    return "fail" if "problem" in severities else "warn" if "warning" in severities else "pass"


def with_verdict(assessment: Assessment, findings: Sequence[Finding]) -> Assessment:
    """Return an assessment with findings, causes before what follows from them, and the verdict that they give."""
    ordered = merge_by_cause([*findings])
    return replace(assessment, findings=ordered, verdict=verdict_of(ordered))


LIMITS: dict[str, tuple[float, float]] = {
    # of accelerometer and gyroscope: relative sigma without what all scales share, sigma [rad]
    "scale": (2e-3, 2e-2),
    "axes": (3e-3, 3e-2),
    "table speed": (2e-2, 0.1),  # relative sigma
    # errors on data left out: part of gravity, of the fastest rate; [rad]; part of the field
    "held-out gravity": (2e-3, 2e-2),
    "held-out rate": (2e-3, 2e-2),
    "held-out rotation": (0.02, 0.2),
    "held-out field": (0.03, 0.15),
    "magnetometer": (0.01, 0.05),  # sigma, part of the field
    "noise misfit": (0.15, 0.6),  # of the Allan deviation
    # cameras: [px], parts, sigmas [rad], [m], [s]
    "corner residual": (1.0, 3.0),
    "left out": (0.25, 0.6),
    "board size": (3e-3, 3e-2),
    "scene size": (1e-2, 5e-2),
    "focal length": (3e-3, 3e-2),
    "centre": (2.0, 15.0),
    "stated centre": (1.0, 15.0),  # 1 px is some 0.1 deg of rotation
    "lens model": (1.03, 3.0),  # residuals over those of the best
    "baseline": (0.01, 0.1),
    "rotation": (radians(0.1), radians(1.0)),
}
"""What is judged -> from which value on it is a warning, and a problem."""


def grade_by_limits(quantity: str, value: float, of: float = 1.0) -> Severity:
    """Return the severity of a value by LIMITS, which are parts of `of`."""
    warn, fail = LIMITS[quantity]
    return grade_value(value, warn * of, fail * of)


def grade_value(value: float, warn: float, fail: float) -> Severity:
    """Return "problem" beyond fail, "warning" beyond warn, "good" else."""
    return "problem" if not value <= fail else "warning" if value > warn else "good"


def most_severe(*grades: Severity) -> Severity:
    """Return the worst of them."""
    return min(grades, key=SEVERITIES.__getitem__)


def gravity_findings(gravity: Gravity) -> list[Finding]:
    """Say aloud what was taken for gravity."""
    relative = gravity.sigma / gravity.value
    least, most = _ON_EARTH_M_S2
    if not least - gravity.sigma < gravity.value < most + gravity.sigma:
        return [
            make_finding(
                "gravity/implausible",
                gravity=gravity.value,
                source=gravity.source,
                least=least,
                most=most,
                off=abs(gravity.value / STANDARD_GRAVITY_M_S2 - 1),
            )
        ]
    if relative < 1e-3:
        return [make_finding("gravity/known", gravity=gravity.value, source=gravity.source)]
    return [
        make_finding(
            "gravity/assumed", gravity=gravity.value, sigma=gravity.sigma, source=gravity.source, relative=relative
        )
    ]


def comparison_left_out(what: str, reason: str) -> Finding:
    """Say that something could not be estimated that would only have been compared with the result."""
    return make_finding("comparison-left-out", what=what, reason=reason)
