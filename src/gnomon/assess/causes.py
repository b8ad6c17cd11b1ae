"""Which findings are causes and which follow from them, so that the cause is said first and alone.

Findings are the consequence of a cause where it makes them by itself: a wrong spacing of the tags looks like a wrong
size of the board, a clock that jumped like one that drifts. They are kept, as information that names the cause, and the
cause takes over their severity.
"""

from dataclasses import replace

from ..findings import Finding, Severity

SEVERITIES: dict[Severity, int] = {"problem": 0, "warning": 1, "info": 2, "good": 3}
"""The worst first."""

_LOUD = ("problem", "warning")

_BENT = frozenset(
    {
        *("not-converged", "target-scale", "intrinsics-doubtful", "reprojection", "frames-left-out", "noise-differs"),
        *("model-too-simple", "model-incomplete", "parts-disagree", "rotation-disagrees", "imprecise", "clock-drift"),
        *("corners-outlying", "gyroscope-drift", "walk-differs", "need"),
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
    "axes-differ": _BENT | {"triads-apart"},
    "axes-mirrored": _BENT | {"triads-apart"},
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
    "clock-jump": _BENT | {"frames-late", "triads-apart", "board-moved"},
    "board-moved": _BENT | {"frames-late", "triads-apart"},
    "frames-late": _BENT | {"triads-apart"},
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
            ),
        }
    ),
    "accelerometer-drift": frozenset({"holdout-accelerometer", "beyond-noise", "model-incomplete", "parts-disagree"}),
}
"""Cause -> what it explains; causes in the order in which they are told, the most fundamental first."""

_ORDER = {code: rank for rank, code in enumerate(_EXPLAINS)}
_SYMPTOMS = frozenset().union(*_EXPLAINS.values()) - _EXPLAINS.keys()


def causes_first(findings: list[Finding]) -> tuple[Finding, ...]:
    """Return findings by severity, causes before what follows from them, otherwise in their order."""
    told = _explained(findings)
    return tuple(sorted(told, key=lambda finding: (SEVERITIES[finding.severity], _rank(finding.code))))


def _rank(code: str) -> int:
    return _ORDER.get(code, len(_ORDER) + (code in _SYMPTOMS))


def _explained(findings: list[Finding]) -> list[Finding]:
    """Return findings of which those that follow from a cause are information, and the cause is as bad as they were."""
    told = list(findings)
    for cause in sorted({f.code for f in told if f.severity in _LOUD and f.code in _EXPLAINS}, key=_ORDER.__getitem__):
        if not any(f.code == cause and f.severity in _LOUD for f in told):
            continue  # another cause explains this one
        follow = [k for k, f in enumerate(told) if f.severity in _LOUD and f.code in _EXPLAINS[cause]]
        if not follow:
            continue
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
