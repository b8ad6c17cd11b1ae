"""What a camera-IMU estimation says of single faults: wrong corners, a bias that ran away, a trajectory in pieces."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from ...estimate.camera_imu.result.misfits import (
    CountingCorners,
    ResidualPattern,
    board_evidence,
    corner_correlation,
    counting_corners,
    lens_evidence,
)
from ...estimate.camera_imu.solution import Solution
from ...findings import Finding, make_finding
from ...recording import Floats, Integers
from ...results.camera_diagnostics import BiasTrack, CameraImuDiagnostics, CornerFit, SignalFit
from ...results.result import Booleans
from ..checks.board_views import BoardMove, moved_finding
from .camera_imu_tables import MISFIT

_FAR = 5.0  # sigmas
_FAR_INFO, _FAR_WARN = 0.005, 0.05
_OFTEN, _FEW, _NEARLY_ALL = 0.2, 0.1, 0.8  # of a point's sightings, of the board's points, of all far ones
_ENDS = 0.15  # of the recording, over which the bias of its start and its end are taken
_WALKS, _LEAST_RAD_S = 5.0, np.radians(0.1)
_APART_S, _WANDERS = 0.1, 0.5  # beyond what knots leave of fast motion; of sound recordings it is 0


def residual_findings(diagnostics: CameraImuDiagnostics) -> list[Finding]:
    """Return findings of codes corners-outlying, gyroscope-drift and residuals-wander."""
    points = "corners" if diagnostics.scene is None else "landmarks"
    findings = [finding for name, fit in diagnostics.corners.items() for finding in outlying_corners(name, fit, points)]
    for name, track in diagnostics.biases.items():
        if name.endswith(".gyroscope"):
            findings += _drift(name, track)
    return findings + [
        finding for name, fit in diagnostics.signals.items() for finding in wandering_residuals(name, fit)
    ]


def wandering_residuals(name: str, fit: SignalFit) -> list[Finding]:
    """Say where a gyroscope's residuals last: no noise, and no bias that walks, is left over like that."""
    apart = max(round(_APART_S * (len(fit.t_s) - 1) / max(float(np.ptp(fit.t_s)), 1e-9)), 1)
    if not name.endswith(".gyroscope"):
        return []
    # Vibration comes back after a whole period, and not in between.
    correlation = min(residual_correlation(fit, max(apart // part, 1)) for part in (1, 2, 3, 4, 5, apart))
    if correlation < _WANDERS:
        return []
    return [make_finding("residuals-wander", name=name, correlation=correlation, apart_s=_APART_S)]


def residual_correlation(fit: SignalFit, apart: int = 1) -> float:
    """Return the correlation of the residuals of a triad that are so many samples apart."""
    residual = (fit.measured - fit.predicted)[fit.used]
    power = float(np.sum(residual**2))
    return float(np.sum(residual[apart:] * residual[:-apart])) / power if power > 0 else 0.0


def outlying_corners(name: str, fit: CornerFit, points: str = "corners") -> list[Finding]:
    """Return what to say where many corners, or whatever `points` are seen instead, lie far from where they should."""
    used = fit.frame_used[fit.frame] & np.isfinite(fit.residual[:, 0])
    if not used.any():
        return []
    size = np.linalg.norm(fit.residual[used], axis=1)
    far = size > _FAR * fit.sigma_px
    share = float(far.mean())
    if share < _FAR_INFO:
        return []
    many, place = share > _FAR_WARN, _one_place(fit.point[used], far) if points == "corners" else ""
    return [
        make_finding(
            "corners-outlying",
            severity="warning" if many else "info",
            case="place" if place else "many" if many else "",
            place=f" Nearly all of these are number {place} of the board." if place else "",
            share=share,
            points=points,
            name=name,
            far=_FAR,
            far_px=_FAR * fit.sigma_px,
            median_size=np.median(size[far]),
        )
    ]


def _one_place(point: Integers, far: Booleans) -> str:
    """Return the numbers of the few points of a board that are far so often that they make nearly all of what is."""
    seen, bad = np.bincount(point), np.bincount(point[far], minlength=int(point.max()) + 1)
    often = np.flatnonzero(bad > _OFTEN * np.maximum(seen, 1))
    few = len(often) <= _FEW * np.count_nonzero(seen) and bad[often].sum() > _NEARLY_ALL * far.sum()
    return ", ".join(map(str, often)) if few else ""


def _drift(name: str, track: BiasTrack) -> list[Finding]:
    """Say where a gyroscope's bias ran from one value to another, further than its random walk goes."""
    part = max(1, round(_ENDS * len(track.t_s)))
    change = track.value[-part:].mean(axis=0) - track.value[:part].mean(axis=0)
    size = float(np.linalg.norm(change))
    walked = track.random_walk * np.sqrt(3 * max(float(np.ptp(track.t_s)), 1e-9))
    if not size > max(_WALKS * walked, _LEAST_RAD_S):
        return []
    return [make_finding("gyroscope-drift/rig", name=name, size=size, ratio=size / max(walked, 1e-12))]


def cut_findings(segments: int, imus: Sequence[str]) -> list[Finding]:
    """Say that the trajectory has several pieces, and what that costs where there are several IMUs.

    Code: trajectory-cut.
    """
    if segments == 1:
        return []
    first, *others = imus
    lost = (
        f"In a gap of {first} neither frames nor the samples of {', '.join(others)} are used; apart from that nothing"
    )
    return [
        make_finding(
            "trajectory-cut",
            case="others" if others else "",
            segments=segments,
            first=first if others else "the IMU",
            lost=lost if others else "Nothing",
            imu=first,
        )
    ]


_CHANCE, _SHARE = 0.01, 0.02
_LASTING = 0.2
"""Correlation of a corner's residuals in frames that follow each other, from which on they are no noise."""


_COLOURED = 0.2
"""Correlation of neighbouring residuals of an IMU: of white noise it is a little below zero."""


def unmodelled_effects(solution: Solution, signals: Mapping[str, SignalFit]) -> list[str]:
    """Return what the residuals of corners and IMU show, as parts of a sentence.

    Parameters
    ----------
    solution : the estimate
    signals : "imu0.accelerometer", ... -> readings and what the estimate predicts
    """
    found, corners = list[str](), counting_corners(solution)
    if _there(board := board_evidence(corners)):
        found.append(
            f"corners that stay off their places on the board by {board.rms_px:.2g} px in all frames (a bad print, a "
            "bent board, or a bias of the detector)"
        )
    if _there(lens := lens_evidence(corners)):
        found.append(
            f"a lens that is not quite the stated one, {lens.rms_px:.2g} px off in the same parts of all images"
        )
    if not found and (lasting := _lasting(corners)) > _LASTING:
        found.append(
            "errors of the detector that depend on attitude and distance, or a lens that its model cannot follow (a "
            f"corner's residual is correlated by {lasting:.2g} from frame to frame)"
        )
    for name, fit in signals.items():
        correlation = residual_correlation(fit)
        if correlation > _COLOURED:
            found.append(
                f"vibration, or motion faster than the trajectory's knots, in {name} (neighbouring residuals are "
                f"correlated by {correlation:.2g})"
            )
    return found


def _lasting(corners: Sequence[CountingCorners]) -> float:
    """Return the largest correlation, of any camera, of a corner's residual with that in the next frame."""
    return max((corner_correlation(one) for one in corners if len(one.point)), default=0.0)


def _there(pattern: ResidualPattern) -> bool:
    return pattern.chance < _CHANCE and pattern.share > _SHARE


_MAY_BE_EXPLAINED = frozenset({"clock-jump", "distortion", "tag-spacing"})
_JUMPS = frozenset({"frames-late", "frames-repeated", "clock-jump"})
"""What makes the trajectory jump where the board stays."""


_LEFT_OUT, _PIXELS = 0.05, 1.0
_WITHIN_S, _WINDOW_S = 1.0, 0.6
_TIMES = 5.0
"""By how much a moment's contradiction between the trajectory and the gyroscope stands out from the usual one; of sound
recordings the largest is 2 to 3 times as large."""


_SHIFT_S = 0.25
"""Half of the time within which a board shifts; its places are compared with as long before and after."""


_SHIFT_M, _SHIFT_TIMES, _SHIFT_USUAL = 2e-3, 5.0, 0.9
"""A shift is told from where it stands out so far from what nine tenths of the recording show; that of sound ones is
up to 1.8 times as large, that of a board shifted by 5 mm 6 times."""


_FEWEST = 40  # times as long must a recording be


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
    jumps = any(finding.code in _JUMPS and finding.severity in ("problem", "warning") for finding in noticed)
    shown = move or (None if jumps else _shift(diagnostics))
    told = [*noticed, *([] if shown is None else [moved_finding(shown)])]
    if not (converged and _explains(diagnostics)):
        return told
    held = move is not None and _contradicted(diagnostics.signals, move.t_s)
    added = _added(diagnostics)
    explained = {"distortion"} if added & {"intrinsics", "k3"} else set[str]() if added else set(_MAY_BE_EXPLAINED)
    if not (added or held):
        explained.add("board-moved")
    return [
        _explained(finding, lens=bool(added))
        if finding.severity == "problem" and finding.code in explained
        else finding
        for finding in told
    ]


def _explained(finding: Finding, *, lens: bool) -> Finding:
    return replace(
        finding,
        severity="warning",
        consequence="The lens was estimated jointly: with it nearly all frames fit, and the recording's parts agree."
        if lens
        else "The estimation, which weighs all of it together, explains nearly all frames nevertheless, and its "
        "parts agree: it is more likely an error of single poses.",
    )


def _explains(diagnostics: CameraImuDiagnostics) -> bool:
    """Tell whether an estimation fits nearly all frames, and its parts agree."""
    for fit in diagnostics.corners.values():
        bad = sum(reason == MISFIT for reason in fit.frame_reason)
        if bad > _LEFT_OUT * max(int(fit.frame_used.sum()), 1) or not fit.sigma_px < _PIXELS:
            return False
    trust = diagnostics.trust
    return trust is None or trust.splits is None or trust.splits.z_rms <= trust.splits.limit


def _added(diagnostics: CameraImuDiagnostics) -> set[str]:
    """Return what of lens and board was estimated by evidence: frames fit with it, not as they were stated."""
    trust, blocks = diagnostics.trust, {"board", "intrinsics", "k3"}
    return set() if trust is None else {step.name for step in trust.models if step.used and step.name in blocks}


def _contradicted(signals: dict[str, SignalFit], t_s: float) -> bool:
    """Tell whether the trajectory turns about an instant otherwise than the gyroscope says, more than usual."""
    name = next((name for name in signals if name.endswith(".gyroscope")), None)
    if name is None:
        return True
    fit = signals[name]
    total, step_s = _summed(fit)
    width = max(1, min(round(_WINDOW_S / step_s), len(total) - 2))
    size = np.linalg.norm(total[width:] - total[:-width], axis=1)
    middle = fit.t_s[: len(size)] + _WINDOW_S / 2
    near = np.abs(middle - t_s) < _WITHIN_S
    return bool(near.any() and size[near].max() > _TIMES * float(np.median(size)))


def _shift(diagnostics: CameraImuDiagnostics) -> BoardMove | None:
    """Return where the board shifted: the trajectory's place changes there otherwise than the accelerometer says.

    What the accelerometer read and the trajectory did not do, summed twice, is a place p that the trajectory lacks. A
    board that shifts makes it step and leaves its velocity. With h half of the time that it takes and velocities taken
    from as long before and after, the step is p(t + h) - p(t - h) - (p(t - h) - p(t - 2h)) - (p(t + 2h) - p(t + h)).
    A camera that slipped on its mount steps, too; where the parts of the recording tell that, they tell it alone.
    """
    name = next((name for name in diagnostics.signals if name.endswith(".accelerometer")), None)
    seen = {camera: fit for camera, fit in diagnostics.corners.items() if fit.frame_used.any()}
    if name is None or not seen:
        return None
    if diagnostics.trust is not None and any(".T_cam_imu" in one.block for one in diagnostics.trust.changes):
        return None
    fit = diagnostics.signals[name]
    velocity, step_s = _summed(fit)
    place, h = np.cumsum(velocity, axis=0) * step_s, max(1, round(_SHIFT_S / step_s))
    if len(place) < _FEWEST * h:
        return None
    before, within, after = (place[k * h :][: len(place) - 4 * h] for k in (0, 1, 3))
    sooner, moved, later = within - before, after - within, place[4 * h :] - after
    size = np.linalg.norm(moved - sooner - later, axis=1)
    least = max(_SHIFT_M, _SHIFT_TIMES * float(np.quantile(size, _SHIFT_USUAL)))
    told = np.where(np.linalg.norm(later - sooner, axis=1) < size, size, 0.0)
    k = int(told.argmax())
    if told[k] < least:
        return None
    t_s = float(fit.t_s[k + 2 * h])
    first = next(iter(seen.values()))
    after_s = t_s - float(first.frame_t_s[first.frame_corners > 0][0])
    return BoardMove(t_s=t_s, turn_rad=0.0, cameras=tuple(seen), after_s=after_s, shift_m=float(told[k]))


def _summed(fit: SignalFit) -> tuple[Floats, float]:
    """Return what a triad read and the trajectory did not do, summed over time (n + 1, 3), and the time of a sample."""
    left = np.where(fit.used[:, None], fit.measured - fit.predicted, 0.0)
    step_s = float(np.median(np.diff(fit.t_s)))
    return np.concatenate([np.zeros((1, 3)), np.cumsum(left, axis=0)]) * step_s, step_s
