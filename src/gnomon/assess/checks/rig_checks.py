"""What camera and IMU say of each other before anything is estimated: axes, clocks, timestamps, board and lens."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from ...detect.samples.faults import find_range_change, saturated_samples
from ...errors import InitialisationError
from ...estimate.camera_imu.start.alignment import (
    Alignment,
    ClockGrowth,
    GyroscopeIntegral,
    align_camera,
    clock_changes,
    gyroscope_integral,
)
from ...estimate.camera_imu.start.board_poses import BoardPoses, board_poses
from ...estimate.camera_imu.start.first_guess import ImuStream
from ...findings import Finding, make_finding
from ...models.camera import Camera
from ...models.target import Target
from ...recording import CameraFrames, Floats, ImuSamples, Recording
from ...results.result import Booleans, StaticIntervals
from ...units import ACCELEROMETER_UNITS_M_S2, GYROSCOPE_UNITS_RAD_S
from ..directions import axis_words
from ..imu.imu_verdict import axis_findings
from ..verdict import merge_by_cause
from .board_views import BoardTurns, board_move, moved_finding
from .clock_checks import far_drift_finding, look_at_drift
from .rig_axes import (
    AxesFit,
    FrameTimes,
    FrameTurns,
    accelerometer_axes,
    averaged_force,
    exchanged_axes,
    felt_force,
    force_by_gyroscope,
    frame_times,
    gyroscope_axes,
    rotation_break,
    turns_between_frames,
)
from .rig_lens import check_lens

_WHOLE, _EXPLAINED, _GYRO_EXPLAINED = 0.95, 0.9, 0.8
_MIRRORED = 2.0  # times as much as a mirror leaves, what a rotation leaves
_DELAY_S, _SIGMAS = 0.5e-3, 5.0
_CERTAIN_S, _LATE_S, _LATE_SIGMAS = 3e-3, 4e-3, 5.0
_LATE_SHARE, _FEWEST_LATE, _FEWEST_FRAMES = 0.04, 8, 60
_JUMP_S, _JUMP_GAIN = 4e-3, 0.5
_NEAR_GAP_S, _GAP_SHARE = 0.5, 0.05
_SHIFT_S = 0.1
_CORNERS = 12
_SCATTERED = 3.0  # times the usual scatter of a frame's corners about its pose
_SLOW_RAD_S = 0.15
_WINDOW_S = 1.0


def check_recording_rig(recording: Recording, target: Target, *, lens: bool = True) -> tuple[Finding, ...]:
    """Look at all cameras beside the first IMU, and at the first one beside the others; samples are in order of time.

    Codes: those of `check_look`, board-moved, clock or clock-drift, and not-aligned.
    """
    (first, samples), *others = recording.imus.items()
    findings = _beside(first, samples, recording.cameras, target, lens=lens)
    guide = dict(list(recording.cameras.items())[:1])
    for name, samples in others:
        found = _beside(name, samples, guide, target, lens=False)
        findings += [name_imu(name, finding) for finding in found if finding.code in _OF_AN_IMU]
    return merge_by_cause(findings)


_OF_AN_IMU = frozenset(
    {
        *("not-aligned", "axes-differ", "axes-mirrored", "triads-apart", "clock-jump", "clock", "clock-drift"),
        *("time-shift", "gyroscope-range-changed", "rotation-breaks", "axes-changed"),
    }
)
"""Findings on a camera beside an IMU that tell something of the IMU."""

_NAME_THE_IMU = frozenset(
    {"triads-apart", "clock-jump", "clock", "clock-drift", "time-shift", "gyroscope-range-changed"}
)


def name_imu(imu: str, finding: Finding) -> Finding:
    """Return a finding that names the IMU which it is about."""
    named = finding if finding.code in _NAME_THE_IMU else replace(finding, message=f"{imu}: {finding.message}")
    return replace(named, subject=finding.subject or imu)


def _beside(
    imu: str, samples: ImuSamples, cameras: Mapping[str, CameraFrames], target: Target, *, lens: bool = True
) -> list[Finding]:
    """Return what cameras and an IMU say of each other."""
    stream, clipped = _stream(samples)
    if stream is None:
        return []
    integral = gyroscope_integral(stream.t_s, stream.rate)
    origin = int(samples.gyroscope.t_ns[0])
    findings: list[Finding] = []
    turns: dict[str, BoardTurns] = {}
    for name, frames in cameras.items():
        poses = board_poses(frames, target, np.asarray((frames.t_ns - origin) * 1e-9, dtype=np.float64))
        try:
            alignment = align_camera(poses, integral, name)
        except InitialisationError as error:
            jumps = check_clock_changes(name, poses, integral, None, imu)
            findings += jumps or [make_finding("not-aligned", reason=str(error))]
            continue
        if jumps := check_clock_changes(name, poses, integral, alignment, imu):
            findings += jumps  # all that follows would be about a time shift that does not hold
            continue
        camera = frames.camera if lens else None
        found, seen = check_look(name, poses, alignment, camera, target, stream=stream, imu=imu, unusable=clipped)
        findings += found
        turns |= {} if seen is None else {name: seen}
        findings += look_at_drift(name, poses, stream, alignment.time_shift_s, imu)
    move = board_move(turns)
    return findings if move is None else [*findings, moved_finding(move)]


def _stream(samples: ImuSamples) -> tuple[ImuStream | None, Booleans | None]:
    """Return the readings on the gyroscope's timestamps, and which of those are clipped; None for counts."""
    turn, push = GYROSCOPE_UNITS_RAD_S[samples.gyroscope.unit], ACCELEROMETER_UNITS_M_S2[samples.accelerometer.unit]
    if turn is None or push is None:
        return None, None
    origin = int(samples.gyroscope.t_ns[0])
    t_s, t_force = (
        np.asarray((triad.t_ns - origin) * 1e-9, dtype=np.float64)
        for triad in (samples.gyroscope, samples.accelerometer)
    )
    once = np.concatenate([[True], np.diff(t_s) > 0])
    force = [np.interp(t_s[once], t_force, push * samples.accelerometer.values[:, i]) for i in range(3)]
    stream = ImuStream(t_s=t_s[once], rate=samples.gyroscope.values[once] * turn, force=np.stack(force, axis=1))
    return stream, saturated_samples(samples.gyroscope)[once]


def check_look(
    name: str,
    poses: BoardPoses,
    alignment: Alignment,
    camera: Camera | None,
    target: Target,
    *,
    stream: ImuStream,
    imu: str,
    unusable: Booleans | None = None,
) -> tuple[list[Finding], BoardTurns | None]:
    """Return findings on one camera beside the IMU, and by how much it saw the board turn, where that can be told.

    Codes: rotation-breaks, axes-changed, axes-differ, axes-mirrored, tag-spacing, rolling-shutter, distortion,
    clock-jump, frames-late, triads-apart, time-shift, motion-slow.

    Parameters
    ----------
    name, poses, alignment : of the camera
    camera : its lens, None where that was looked at beside another IMU already
    target : the board
    stream, imu : readings of the IMU, and its name
    unusable : (n,) readings of the gyroscope that are clipped
    """
    shift = alignment.time_shift_s
    certain = poses.scatter_px < _SCATTERED * float(np.nanmedian(poses.scatter_px))
    certain &= np.diff(poses.exposures.start) >= _CORNERS
    findings = [] if camera is None else check_lens(name, poses, camera, target, certain)
    poses = poses.where(certain)
    gyroscope = gyroscope_axes(poses, stream, shift)
    if gyroscope is None:
        return findings, None
    if min(gyroscope.explained, gyroscope.used) < _WHOLE:
        broken = _breaks(name, poses, gyroscope_integral(stream.t_s, stream.rate), shift, imu)
        if broken:
            return [*broken, *findings], None
    findings += _slow(name, alignment)
    accelerometer = accelerometer_axes(poses, stream, shift)
    if accelerometer is not None and min(accelerometer.explained, accelerometer.used) < _WHOLE:
        findings += check_accelerometer_change(poses, stream, shift, imu)
    told = gyroscope.hand != 0 and gyroscope.explained > _EXPLAINED
    whole = exchanged_axes(poses, stream, shift, gyroscope) if told else None
    findings = [*(_axes(name, gyroscope, whole) or _hand(name, gyroscope, alignment)), *findings]
    if gyroscope.explained < _GYRO_EXPLAINED or gyroscope.hand == 0:
        return findings, None
    times = frame_times(poses, stream, shift, gyroscope, unusable)
    jump: list[Finding] = []
    if times is not None:
        jump = _jump(name, imu, times)
        findings += jump or _late(name, times)
    apart: list[Finding] = []
    if not jump and accelerometer is not None and accelerometer.explained > _EXPLAINED:
        apart = _apart(imu, gyroscope, accelerometer)
    if not (jump or apart) and told and (whole is None or np.array_equal(whole, np.eye(3))):
        apart = late_accelerometer(imu, poses, stream, shift, gyroscope)
    findings += apart
    return [*findings, *_shift(name, imu, shift)], None if times is None else times.turns


def _breaks(name: str, poses: BoardPoses, integral: GyroscopeIntegral, shift_s: float, imu: str) -> list[Finding]:
    at_s = rotation_break(turns_between_frames(poses, integral, shift_s))
    if at_s is None:
        return []
    return [make_finding("rotation-breaks", name=name, imu=imu, after_s=at_s - shift_s - float(poses.t_s[0]))]


def _breaks_by_thirds(name: str, poses: BoardPoses, integral: GyroscopeIntegral, imu: str) -> list[Finding]:
    """Say where camera and gyroscope cease to show one rotation, by a part that can be aligned, as the whole cannot."""
    third = np.arange(len(poses)) * 3 // max(len(poses), 1)
    for k in (0, 2):
        try:
            shift_s = align_camera(poses.where(third == k), integral, name).time_shift_s
        except InitialisationError:
            continue
        if found := _breaks(name, poses, integral, shift_s, imu):
            return found
    return []


def _slow(name: str, alignment: Alignment) -> list[Finding]:
    fastest = float(alignment.axes[0])
    if not 0 < fastest < _SLOW_RAD_S:
        return []
    axis = axis_words(alignment.directions[:, 0], of_camera=True)
    return [make_finding("motion-slow", name=name, fastest=fastest, axis=axis)]


def _axes(name: str, gyroscope: AxesFit, whole: Floats | None) -> list[Finding]:
    """Compare the axes of both triads by what the camera saw: only a signed exchange of axes is told."""
    if whole is None or np.array_equal(whole, np.eye(3)):
        return []
    hand = gyroscope.hand * float(np.linalg.det(whole))
    if np.array_equal(whole, -np.eye(3)):
        return [_mirrored(name, hand)]
    found = axis_findings(whole)[0]
    wrong = "accelerometer" if hand < 0 < gyroscope.hand else "gyroscope"
    which = f"Seen from {name} the {wrong} is the left-handed one." if hand * gyroscope.hand < 0 else ""
    return [make_finding("axes-differ/rig", found=found.message, which=which, cure=found.cure)]


def _hand(name: str, gyroscope: AxesFit, alignment: Alignment) -> list[Finding]:
    """Say that the gyroscope's axes are left-handed: with a mirror it reads what the camera saw, by no rotation."""
    left, by_rotation = 1 - gyroscope.explained, 1 - alignment.score
    if gyroscope.hand >= 0 or left > 1 - _GYRO_EXPLAINED or by_rotation < max(_MIRRORED * left, 1 - _EXPLAINED):
        return []
    return [make_finding("axes-mirrored/gyroscope", name=name, score=alignment.score, explained=gyroscope.explained)]


def _mirrored(name: str, hand: float) -> Finding:
    wrong = "accelerometer" if hand < 0 else "gyroscope"
    return make_finding("axes-mirrored/triad", case="accelerometer" if hand < 0 else "", name=name, wrong=wrong)


def _late(name: str, times: FrameTimes) -> list[Finding]:
    certain = times.sigma_s < _CERTAIN_S
    if certain.sum() < _FEWEST_FRAMES:
        return []
    off = np.abs(times.alone_s[certain])
    late = off > np.maximum(_LATE_S, _LATE_SIGMAS * (times.sigma_s * times.scatter)[certain])
    share = float(late.mean())
    if late.sum() < _FEWEST_LATE or share < _LATE_SHARE:
        return []
    return [make_finding("frames-late", name=name, share=share, median_off=np.median(off[late]), largest_off=off.max())]


def check_clock_changes(
    name: str, poses: BoardPoses, integral: GyroscopeIntegral, alignment: Alignment | None, imu: str
) -> list[Finding]:
    """Return what of the clocks is too bad for one time shift to begin with (codes clock-jump, clock-drift).

    What looks like it is told instead: a gyroscope whose range changed (code gyroscope-range-changed), or where nothing
    could be aligned one that shows the camera's rotation in a part only (code rotation-breaks).

    Parameters
    ----------
    name, poses : of the camera
    integral, imu : of the gyroscope, and the IMU's name
    alignment : of the whole recording; None where it failed
    """
    shift_s = 0.0 if alignment is None else alignment.time_shift_s
    findings = _range_changed(imu, turns_between_frames(poses, integral, shift_s))
    changes = () if findings else clock_changes(poses, integral, alignment)
    if isinstance(changes, ClockGrowth):
        length_s = float(poses.t_s[-1] - poses.t_s[0])
        return [far_drift_finding(name, imu, changes.drift, changes.sigma, length_s=length_s)]
    for step in changes:
        ahead_s = step.before_s - step.after_s  # of the camera's clock against the IMU's
        # A clock that was set forward leaves a gap of that length in its own stream.
        if ahead_s > 0:
            which = name if _gap(poses.t_s, step.at_s, ahead_s) else ""
        else:
            which = imu if _gap(integral.t_s, step.at_s + step.before_s, -ahead_s) else ""
        at_s = step.at_s - float(poses.t_s[0])
        findings.append(
            _jumped(imu, name, -ahead_s, at_s, which) if which == imu else _jumped(name, imu, ahead_s, at_s, which)
        )
    if not findings and alignment is None:
        return _breaks_by_thirds(name, poses, integral, imu)
    return findings


def _range_changed(imu: str, turns: FrameTurns) -> list[Finding]:
    """Say where the gyroscope began to show several times as much of a rotation: by its scatter about each second."""
    if not len(turns.seen):
        return []
    second = ((turns.start_s - turns.start_s[0]) / _WINDOW_S).astype(np.int64)
    start = np.flatnonzero(np.diff(second, prepend=-1))
    stop = np.append(start[1:], len(second))
    scatter = np.array([[np.std(rate[a:b], axis=0) for a, b in zip(start, stop, strict=True)] for rate in turns[2:]])
    seen, read = np.linalg.norm(scatter, axis=2)
    told = (seen > _SLOW_RAD_S) & (read > 0)
    parts = StaticIntervals(start=start[told], stop=stop[told])
    change = find_range_change(read[told] / seen[told], parts, len(second))
    if change is None:
        return []
    t_from_s, t_to_s = float(turns.start_s[change.last]), float(turns.stop_s[change.first])
    return [make_finding("gyroscope-range-changed", label=imu, factor=change.factor, t_from_s=t_from_s, t_to_s=t_to_s)]


def _gap(t_s: Floats, at_s: float, length_s: float) -> bool:
    """Tell whether a stream has a gap of that length about an instant."""
    near = (t_s[1:] > at_s - _NEAR_GAP_S) & (t_s[:-1] < at_s + _NEAR_GAP_S)
    steps = np.diff(t_s)
    usual = float(np.median(steps))
    return bool((np.abs(steps[near] - usual - length_s) < 0.5 * usual + _GAP_SHARE * length_s).any())


def _jumped(name: str, other: str, step_s: float, at_s: float, which: str = "") -> Finding:
    size = f"{step_s * 1e3:+.3g} ms" if abs(step_s) < 0.9995 else f"{step_s:+.4g} s"
    cause = f" Its timestamps have a gap of that length there: it is {which} that jumped." if which else ""
    return make_finding("clock-jump/rotation", name=name, size=size, other=other, at_s=at_s, cause=cause)


def _jump(name: str, imu: str, times: FrameTimes) -> list[Finding]:
    """Look for one step in the time shift: two levels must explain the timestamps far better than a straight line."""
    certain = times.sigma_s < _CERTAIN_S
    if certain.sum() < _FEWEST_FRAMES:
        return []
    t, late = times.t_s[certain], times.late_s[certain]
    line = np.polyfit(t, late, 1)
    ramp = float(np.abs(late - np.polyval(line, t)).sum())
    edges = np.linspace(0.05, 0.95, 91) * len(t)
    costs = [_two_levels(late, int(edge)) for edge in edges]
    k = int(edges[int(np.argmin(costs))])
    if min(costs) > _JUMP_GAIN * ramp or abs(np.median(late[k:]) - np.median(late[:k])) < _JUMP_S:
        return []
    at_s = float(t[k])
    step_s = times.level(at_s, float("inf")) - times.level(0.0, at_s)
    if abs(step_s) < _JUMP_S:
        return []
    return [_jumped(name, imu, step_s, at_s)]


def _two_levels(late: Floats, k: int) -> float:
    return float(np.abs(late[:k] - np.median(late[:k])).sum() + np.abs(late[k:] - np.median(late[k:])).sum())


def _apart(imu: str, gyroscope: AxesFit, accelerometer: AxesFit) -> list[Finding]:
    delay = accelerometer.delay_s - gyroscope.delay_s
    sigma = float(np.hypot(accelerometer.delay_sigma_s, gyroscope.delay_sigma_s))
    if abs(delay) < max(_DELAY_S, _SIGMAS * sigma):
        return []
    return [_later_triad(imu, delay, sigma)]


def _later_triad(imu: str, delay: float, sigma: float) -> Finding:
    """Return that the accelerometer comes later than the gyroscope by a delay [s]; earlier, where it is below zero."""
    later, earlier = ("accelerometer", "gyroscope") if delay > 0 else ("gyroscope", "accelerometer")
    return make_finding("triads-apart/rig", later=later, imu=imu, delay=abs(delay), sigma=sigma, earlier=earlier)


def _shift(name: str, imu: str, shift_s: float) -> list[Finding]:
    if abs(shift_s) < _SHIFT_S:
        return []
    which = "ahead of" if shift_s < 0 else "behind"
    return [make_finding("time-shift", name=name, shift_s=abs(shift_s), which=which, imu=imu)]


_BETTER, _LEFT = 0.1, 0.1  # what a change leaves, of what no change leaves and of the readings' power
_LEAST = 0.05  # of the frames, on either side


def check_accelerometer_change(poses: BoardPoses, stream: ImuStream, time_shift_s: float, imu: str) -> list[Finding]:
    """Return a problem where axes of the accelerometer are others from one instant on (code axes-changed).

    Parameters
    ----------
    poses, stream : of the board, of the IMU
    time_shift_s : t_imu - t_cam, about
    imu : its name
    """
    felt = felt_force(poses, stream, time_shift_s)
    if felt is None:
        return []
    t_s, design, read = felt
    changes = [one for axis in range(3) if (one := _change(design, read, axis)) is not None]
    if not changes:
        return []
    told = ", ".join(f"{'xyz'[axis]} reads what would have been {source}" for axis, source, _ in changes)
    at_s = float(np.median([t_s[k] for *_, k in changes]) - stream.t_s[0])
    return [make_finding("axes-changed/rig", label=imu, read=told, at_s=at_s)]


def _change(design: Floats, read: Floats, axis: int) -> tuple[int, str, int] | None:
    """Return the axis, what it reads later, such as -x, and the first frame of that; None where nothing changes."""
    basis, _ = np.linalg.qr(design / np.linalg.norm(design, axis=0))
    part = np.cumsum(basis[:, None, :] * read[:, :, None], axis=0)  # (n, 3, p)
    power = np.cumsum(read**2, axis=0)
    same = float(power[-1, axis] - (part[-1, axis] ** 2).sum())
    edge = max(1, round(_LEAST * len(read)))
    best: tuple[float, str, int] | None = None
    for source in range(3):
        for sign in (1, -1):
            if (source, sign) == (axis, 1):
                continue
            own = part[:-1, axis] + sign * (part[-1, source] - part[:-1, source])
            whole = power[:-1, axis] + power[-1, source] - power[:-1, source]
            left = (whole - (own**2).sum(axis=1))[edge:-edge]
            k = int(np.argmin(left))
            if left[k] < _BETTER * same and left[k] < _LEFT * whole[edge + k] and (best is None or left[k] < best[0]):
                best = float(left[k]), f"{'-' if sign < 0 else ''}{'xyz'[source]}", edge + k + 1
    return None if best is None else (axis, best[1], best[2])


_SEARCH_S, _TRIALS, _STEP_S = 0.1, 41, 0.01
_COMES_LATE_S, _COMES_LATE_SIGMAS, _CLEARLY = 0.015, 4.0, 2.0
_LEFT_OF_FORCE = 0.1  # of the variance of the force, at most


def late_accelerometer(
    imu: str, poses: BoardPoses, stream: ImuStream, time_shift_s: float, gyroscope: AxesFit
) -> list[Finding]:
    """Say that an accelerometer's readings come by much later or earlier than the gyroscope's (code triads-apart)."""
    seen = force_by_gyroscope(poses, stream, time_shift_s, gyroscope)
    if seen is None:
        return []
    at, step_s, known, free = seen
    q, force = np.linalg.qr(free.reshape(-1, free.shape[2]))[0], averaged_force(stream, step_s)

    def left_at(delay_s: float) -> Floats:
        wanted = (force(at + delay_s) - known).ravel()
        return wanted - q @ (q.T @ wanted)

    delays = np.linspace(-_SEARCH_S, _SEARCH_S, _TRIALS)
    best = min(delays.tolist(), key=lambda delay_s: float((left_at(delay_s) ** 2).sum()))
    slope = (left_at(best + _STEP_S) - left_at(best - _STEP_S)) / (2 * _STEP_S)
    best -= float(slope @ left_at(best)) / float(slope @ slope)
    left, before = left_at(best), left_at(0.0)
    sigma = 2.0 * float(np.sqrt((left**2).mean() / (slope @ slope)))  # neighbouring differences share poses
    delay = best - gyroscope.delay_s
    read = force(at)
    explained = left @ left < _LEFT_OF_FORCE * ((read - read.mean(axis=0)) ** 2).sum() and abs(best) < _SEARCH_S
    clear = abs(delay) > max(_COMES_LATE_S, _COMES_LATE_SIGMAS * sigma) and before @ before > _CLEARLY * (left @ left)
    if not (explained and clear):
        return []
    return [_later_triad(imu, delay, sigma)]
