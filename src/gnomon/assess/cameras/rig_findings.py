"""What a camera-IMU estimation says of itself: parts that the model took up, single faults, and effects that it lacks.

Also what was noticed before the estimation, judged again by what came of it. Before it every frame has a pose of its
own, and errors of lens, board and view look like faults of clocks and boards. The estimation weighs them together: what
it explains is no reason to refuse its result. A board that only shifted shows there alone: at one moment the trajectory
passes from one place to another and the accelerometer does not.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import pi, sqrt
from typing import TYPE_CHECKING

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
from ..verdict import grade_by_limits
from .camera_imu_tables import MISFIT

if TYPE_CHECKING:
    from ...estimate.camera_imu.layout import BorderLayout
    from ...estimate.camera_imu.parameters import CameraParameters, ImuParameters, RigParameters
    from ...estimate.camera_imu.result.uncertainty import TriadMisfit
    from ...models.camera import Camera


_FOCAL_WARN, _PRINCIPAL_WARN_PX = 0.03, 15.0
"""Beyond these it is doubtful that the stated intrinsics are of this camera."""


_DELAYED, _CERTAIN, _FILTERED = "triads-apart", 3.0, 4.0
_FAST_RAD_S = 2 * pi * 5
"""Angular frequency of a fast motion of a hand, at which a filter is described."""


def added_findings(
    added: tuple[str, ...], start: "RigParameters", found: "RigParameters", *, board_told: bool, arms_told: bool = False
) -> list[Finding]:
    """Say what was added to the model.

    Parameters
    ----------
    added : steps of the model choice that are in the model
    start, found : parameters as they were stated and as they were estimated
    board_told : whether the recording is long enough to tell whether corners of the board lie off their places
    arms_told : whether it proves that the accelerometers do not sit at one point
    """
    findings: list[Finding] = []
    if arms_told:
        findings += [_lever_arms(f"imu{i}", imu) for i, imu in enumerate(found.imus)]
    if "intrinsics" in added:
        findings += [_lens(*pair, board_told) for pair in zip(start.cameras, found.cameras, strict=True)]
    if "exposure" in added:
        findings += [
            make_finding("exposure-found", name=entry.name, mean_s=max(entry.exposure_s2, 0.0) ** 0.5)
            for entry in found.cameras
        ]
    if "board" in added and found.board is not None:
        findings.append(_board(found.board.points, found.board.offsets))
    return findings


def delays_found(
    noticed: Sequence[Finding], imus: "Sequence[ImuParameters]", sigmas_s: Mapping[int, float], *, decided: bool
) -> list[Finding]:
    """Return what was noticed before the estimation, with the delays of accelerometers as the estimation tells them.

    Parameters
    ----------
    noticed : before the estimation
    imus : as they were estimated
    sigmas_s : of the delays that were estimated, by the number of the IMU [s]
    decided : whether the estimation decided by evidence on those that it does not have
    """
    if not sigmas_s and not decided:
        return list(noticed)
    told = [finding for finding in noticed if finding.code != _DELAYED]
    seen = len(told) < len(noticed)
    return told + [
        _delay(f"imu{i}", imus[i].accelerometer_shift_s, sigma_s)
        for i, sigma_s in sigmas_s.items()
        if (seen or not imus[i].apart) and abs(imus[i].accelerometer_shift_s) > _CERTAIN * sigma_s
    ]


def _delay(name: str, shift_s: float, sigma_s: float) -> Finding:
    later, earlier = ("accelerometer", "gyroscope") if shift_s < 0 else ("gyroscope", "accelerometer")
    return make_finding(
        "triads-apart/estimated", name=name, shift_s=abs(shift_s), sigma_s=sigma_s, later=later, earlier=earlier
    )


def misfits_found(misfits: "Sequence[TriadMisfit]") -> list[Finding]:
    """Say which triads show fast motion too small, or have another scale for negative readings.

    It is a warning where that is certain and moves a parameter by more than its standard deviation.
    """
    findings: list[Finding] = []
    for one in misfits:
        name, triad = f"imu{one.imu}", ("gyroscope", "accelerometer")[one.kind]
        severity = "warning" if one.moved > 1 and abs(one.size) > _FILTERED * one.sigma else "info"
        if one.axis is None:
            found = make_finding(
                "triad-filtered",
                severity=severity,
                name=name,
                triad=triad,
                share=one.size * _FAST_RAD_S**2,
                sigma=one.sigma * _FAST_RAD_S**2,
                cutoff_hz=1 / (2 * pi * sqrt(2 * one.size)),
                moved=one.moved,
            )
        else:
            found = make_finding(
                "scale-asymmetry",
                severity=severity,
                name=name,
                triad=triad,
                axis="xyz"[one.axis],
                way="smaller" if one.size > 0 else "larger",
                share=2 * abs(one.size),
                sigma=2 * one.sigma,
                moved=one.moved,
            )
        findings.append(found)
    return findings


def steps_left_out(failed: Mapping[str, str]) -> list[Finding]:
    """Say which steps the recording asks for, but could not be estimated: step -> reason."""
    return [make_finding("step-left-out", name=name, reason=reason) for name, reason in failed.items()]


def out_of_order(columns: "BorderLayout", found: "RigParameters") -> list[Finding]:
    """Say where g-sensitivity is estimated and what matters more, scale and misalignment, is taken for ideal."""
    findings: list[Finding] = []
    for i, imu in enumerate(found.imus):
        late, early = columns.get(f"imu{i}.B_g"), columns.get(f"imu{i}.S_g")
        if late is None or early is None or not columns.free[late].any() or columns.free[early].any():
            continue
        if np.any(imu.S_g != 1):
            continue  # somebody knows it
        findings.append(make_finding("model-too-simple/scale-fixed", i=i))
    return findings


def _lever_arms(name: str, imu: "ImuParameters") -> Finding:
    apart = ", ".join(
        f"{axis} at {' '.join(f'{1e3 * value:.1f}' for value in place)} mm"
        for axis, place in zip("xyz", imu.places.tolist(), strict=True)
    )
    return make_finding("lever-arms-found", name=name, apart=apart, words=imu.origin.words)


def _at_border_px(stated: "Camera", found: "Camera") -> float:
    """Return the largest distance of both images of one ray, at the corners and the middle of the edges [px]."""
    pixels = np.stack(np.meshgrid(*np.linspace(0, np.array(found.resolution) - 1.0, 3).T), axis=-1).reshape(-1, 2)
    rays, seen = found.unproject(pixels)
    image = stated.project(rays[seen], point_jacobian=False)
    return float(np.max(np.linalg.norm(image.pixels - pixels[seen], axis=1)[image.valid], initial=0.0))


def _lens(stated: "CameraParameters", found: "CameraParameters", board_told: bool) -> Finding:
    before, after = stated.camera.intrinsics[-4:], found.camera.intrinsics[-4:]
    focal = float(np.mean(after[:2] / before[:2]) - 1)
    moved = float(np.linalg.norm(after[2:] - before[2:]))
    doubtful = abs(focal) > _FOCAL_WARN or moved > _PRINCIPAL_WARN_PX
    k3 = found.camera.distortion_coeffs[4] if found.camera.distortion == "radtan5" else 0.0
    bent = f", up to {_at_border_px(stated.camera, found.camera):.3g} px at the border of the image"
    bent += f"; k3 is {k3:.3g}" if k3 else ""
    consequence = "The lens was estimated jointly: the corners fit clearly better with it than with the stated one."
    cure = "Use the lens of this result, or calibrate the camera anew."
    if doubtful:
        cure = "Check that camchain.yaml is of this camera, lens and resolution."
    elif not board_told:
        consequence = "A board that is not flat looks the same in so short a recording: either may be wrong."
        cure = "See that the board is flat, or record for 20 s: that tells the two apart."
    return make_finding(
        "lens-found",
        severity="warning" if doubtful or not board_told else "info",
        name=found.name,
        focal=focal,
        moved=moved,
        bent=bent,
        consequence=consequence,
        cure=cure,
    )


def _board(points: Floats, offsets: Floats) -> Finding:
    """Say where the corners lie; of a board with another aspect the size is known no better than half of that."""
    rms, most = (1e3 * f(np.linalg.norm(offsets, axis=1)) for f in (_rms, np.max))
    centred = points - points.mean(axis=0)
    x, y, _ = np.sum(centred * offsets, axis=0) / np.maximum(np.sum(centred**2, axis=0), 1e-300)
    stretched = grade_by_limits("scale", abs(y - x) / 2) != "good"
    return make_finding(
        "board-found/rig",
        severity="warning" if stretched else "info",
        case="stretched" if stretched else "",
        rms=rms,
        most=most,
        also=f"; its y axis is {100 * (y - x):+.2g} % longer against x than stated" if stretched else "",
    )


def _rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(values**2)))


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
