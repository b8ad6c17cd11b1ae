"""What was noticed before the estimation, judged again by what came of it.

Before the estimation every frame has a pose of its own, and errors of lens, board and view look like faults of clocks
and boards. The estimation weighs them together: what it explains is no reason to refuse its result.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..diagnostics import CameraImuDiagnostics, SignalFit
from ..findings import Finding
from .board_turn import BoardMove, moved_finding
from .camera_imu_tables import MISFIT

_MAY_BE_EXPLAINED = frozenset({"clock-jump", "distortion", "tag-spacing"})
_LEFT_OUT, _PIXELS = 0.05, 1.0
_WITHIN_S, _WINDOW_S = 1.0, 0.6
_TIMES = 5.0
"""By how much a moment's contradiction between the trajectory and the gyroscope stands out from the usual one; of sound
recordings the largest is 2 to 3 times as large."""


def judged_again(
    noticed: Sequence[Finding], move: BoardMove | None, diagnostics: CameraImuDiagnostics, *, converged: bool
) -> list[Finding]:
    """Return what was noticed before the estimation: what this explains does not fail its result.

    Parameters
    ----------
    noticed : before the estimation
    move : of the board, as it seemed before the estimation, or None
    diagnostics : of the estimation, with its trust
    converged : whether it came to rest
    """
    told = [*noticed, *([] if move is None else [moved_finding(move)])]
    if not (converged and _explains(diagnostics)):
        return told
    held = move is not None and _contradicted(diagnostics.signals, move.t_s)
    return [
        _explained(finding)
        if finding.severity == "problem"
        and (finding.code in _MAY_BE_EXPLAINED or (finding.code == "board-moved" and not held))
        else finding
        for finding in told
    ]


def _explained(finding: Finding) -> Finding:
    return replace(
        finding,
        severity="warning",
        consequence="The estimation, which weighs all of it together, explains nearly all frames nevertheless, and its "
        "parts agree: it is more likely an error of single poses.",
    )


def _explains(diagnostics: CameraImuDiagnostics) -> bool:
    """Tell whether an estimation fits nearly all frames as they were stated, and its parts agree."""
    for fit in diagnostics.corners.values():
        bad = sum(reason == MISFIT for reason in fit.frame_reason)
        if bad > _LEFT_OUT * max(int(fit.frame_used.sum()), 1) or not fit.sigma_px < _PIXELS:
            return False
    trust = diagnostics.trust
    if trust is None:
        return True
    added = any(step.used and not step.forced and step.name in {"board", "intrinsics", "k3"} for step in trust.models)
    return not added and (trust.splits is None or trust.splits.z_rms <= trust.splits.limit)


def _contradicted(signals: dict[str, SignalFit], t_s: float) -> bool:
    """Tell whether the trajectory turns about an instant otherwise than the gyroscope says, more than usual."""
    name = next((name for name in signals if name.endswith(".gyroscope")), None)
    if name is None:
        return True
    fit = signals[name]
    left = np.where(fit.used[:, None], fit.measured - fit.predicted, 0.0)
    step_s = float(np.median(np.diff(fit.t_s)))
    width = max(1, min(round(_WINDOW_S / step_s), len(left) - 1))
    total = np.concatenate([np.zeros((1, 3)), np.cumsum(left, axis=0)]) * step_s
    size = np.linalg.norm(total[width:] - total[:-width], axis=1)
    middle = fit.t_s[: len(size)] + _WINDOW_S / 2
    near = np.abs(middle - t_s) < _WITHIN_S
    return bool(near.any() and size[near].max() > _TIMES * float(np.median(size)))
