"""The data doctor's look at cameras and IMU together, before anything is estimated from them.

What only an estimate shows (a wrong size of the board, intrinsics of another camera, too little rotation) is said
after it.
"""

from collections.abc import Iterable, Mapping

import numpy as np

from ...detect.boards.board import BoardView, tag_spacing
from ...estimate.trust.changes import look_or_postpone
from ...findings import Finding, make_finding
from ...models.target import Target
from ...recording import CameraFrames, ImuSamples, Integers, Recording
from ..cameras.camera_views import FEWEST_CORNERS, BoardSightings, board_sightings, check_handedness, image_coverage
from .clock_checks import check_epochs
from .image_checks import check_images, check_quality
from .motion_checks import check_moving_imu
from .rig_lens import check_image_size

FEWEST_FRAMES = 10
_ENOUGH_FRAMES = 60
_SLOW_HZ = 4.0
_SHORT_S, _ENOUGH_S = 5.0, 20.0
_GAP_PERIODS = 1.5
_LOST_SHARE = 0.1
_JITTER = 0.3  # of a period
_UNSEEN_S = 2.0
_MANY = 0.1
_REPEATED = 0.02
_COVERED = 0.3  # of the image
_SMALL = 0.15  # of the image's diagonal
_COMMON = 0.9


def check_cameras(recording: Recording, target: Target) -> tuple[Finding, ...]:
    """Look at a recording of cameras and IMUs and say what is good or bad about it.

    Every warning and every problem states its consequence and its cure. Codes of the cameras: cameras-missing,
    frames-backward, corners-unknown, corners-outside, image-size, frames, frames-few, board-mirrored, frames-repeated,
    corners-few, frame-rate, frame-jitter, frame-gaps, board-unseen, image-coverage, board-small, stream-short,
    streams-apart, of their stamps stamps-zero and stamps-unit, and of their images those of `check_images`; of the IMUs
    those of `check_moving_imu`.

    Returns
    -------
    Findings IMU by IMU, camera by camera; severity "problem" means that it cannot be calibrated.
    """
    findings = [finding for name, imu in recording.imus.items() for finding in check_moving_imu(name, imu)]
    findings += [finding for finding in check_epochs(all_stamps(recording)) if finding.severity == "problem"]
    if not recording.cameras:
        findings.append(make_finding("cameras-missing/rig"))
    for name, frames in recording.cameras.items():
        findings += _check_camera(name, frames, target)
        for imu in imus_to_align(name, recording.cameras, recording.imus):
            shift_s = frames.time_shift_cam_imu_s or 0.0
            findings += check_common_time(name, frames.t_ns, imu, recording.imus[imu], shift_s)
    return tuple(findings)


def imus_to_align(camera: str, cameras: Iterable[str], imus: Iterable[str]) -> list[str]:
    """Return the IMUs beside which a camera is looked at: the first one, and all of them for the first camera."""
    return list(imus)[: None if camera == next(iter(cameras)) else 1]


def all_stamps(recording: Recording) -> dict[str, Integers]:
    """Return the timestamps of all streams, "cam0", ..., "imu0", ..., (n,) each [ns]."""
    return {name: frames.t_ns for name, frames in recording.cameras.items()} | imu_stamps(recording.imus)


def imu_stamps(imus: Mapping[str, ImuSamples]) -> dict[str, Integers]:
    """Return the timestamps of IMUs: of the gyroscope, where it has any, else of the accelerometer."""
    triads = {name: imu.gyroscope if len(imu.gyroscope) else imu.accelerometer for name, imu in imus.items()}
    return {name: samples.t_ns for name, samples in triads.items()}


def _check_camera(name: str, frames: CameraFrames, target: Target) -> list[Finding]:
    wrong = unusable_frames_finding(name, frames, target)
    if wrong is not None:
        return [wrong]
    seen = board_sightings(frames, target)
    findings = [_count(name, frames, seen, target)]
    if findings[0].severity == "problem":
        return findings + check_images(name, frames, seen.frame[seen.usable])  # they may tell why
    return findings + look_or_postpone(lambda: _check_frames(name, frames, seen, target))


def _check_frames(name: str, frames: CameraFrames, seen: BoardSightings, target: Target) -> list[Finding]:
    usable = frames.t_ns[seen.frame[seen.usable]]
    findings = _repeated(name, frames)
    findings += _useless(name, seen)
    findings += check_handedness(name, frames, seen.frame[seen.usable], target)
    size = check_image_size(name, frames, seen.frame[seen.usable], target)
    findings += [] if size is None else [size]
    findings += check_rhythm(name, frames.t_ns)
    findings += _unseen(name, usable)
    findings += _duration(name, usable)
    findings += check_images(name, frames, seen.frame[seen.usable])
    return findings + _image(name, frames, seen)


def unusable_frames_finding(name: str, frames: CameraFrames, target: Target) -> Finding | None:
    """Return why no calibration can use the frames of a camera, or None."""
    back = np.flatnonzero(np.diff(frames.t_ns) <= 0)
    if len(back):
        return make_finding(
            "frames-backward/corners", name=name, frame=int(back[0]) + 1, count=len(back), frames=len(frames.t_ns)
        )
    beyond = (frames.point < 0) | (frames.point >= len(target.points))
    if beyond.any():
        return make_finding(
            "corners-unknown",
            name=name,
            unknown=int(np.count_nonzero(beyond)),
            corners=len(beyond),
            last=len(target.points) - 1,
            point=frames.point[int(np.argmax(beyond))],
        )
    return _outside(name, frames)


def _outside(name: str, frames: CameraFrames) -> Finding | None:
    (width, height), u, v = frames.camera.resolution, frames.pixels[:, 0], frames.pixels[:, 1]
    outside = (u < -0.5) | (v < -0.5) | (u > width - 0.5) | (v > height - 0.5)
    if np.count_nonzero(outside) <= 0.5 * len(outside):
        return None
    return make_finding(
        "corners-outside",
        name=name,
        outside=int(np.count_nonzero(outside)),
        corners=len(outside),
        width=width,
        height=height,
    )


def _count(name: str, frames: CameraFrames, seen: BoardSightings, target: Target) -> Finding:
    usable = int(np.count_nonzero(seen.usable))
    span_s = (int(frames.t_ns[-1]) - int(frames.t_ns[0])) * 1e-9 if len(frames.t_ns) else 0.0
    message = f"{name}: {len(frames.t_ns)} frames in {span_s:.1f} s, the board in {usable} of them"
    if usable >= _ENOUGH_FRAMES:
        corners = int(np.median(seen.corners[seen.usable]))
        return make_finding("frames/corners", message=message, corners=corners, points=len(target.points))
    few = usable < FEWEST_FRAMES
    return make_finding(
        "frames-few",
        severity="problem" if few else "warning",
        case="few" if few else "",
        message=message,
        fewest_corners=FEWEST_CORNERS,
    )


def _repeated(name: str, frames: CameraFrames) -> list[Finding]:
    """Look for frames whose corners are those of the frame before to the last digit: the same image once more."""
    count = np.bincount(frames.frame, minlength=len(frames.t_ns))
    start = np.concatenate([[0], np.cumsum(count)])
    again = np.flatnonzero((count[1:] == count[:-1]) & (count[1:] > 0)) + 1
    same = [
        k
        for k in again.tolist()
        if np.array_equal(frames.pixels[start[k] : start[k + 1]], frames.pixels[start[k - 1] : start[k]])
    ]
    if not same:
        return []
    share = len(same) / max(int(np.count_nonzero(count)), 1)
    return [
        make_finding(
            "frames-repeated",
            severity="warning" if share > _REPEATED else "info",
            name=name,
            count=len(same),
            share=share,
        )
    ]


def _useless(name: str, seen: BoardSightings) -> list[Finding]:
    useless = int(np.count_nonzero(~seen.usable))
    if not useless:
        return []
    share = useless / len(seen.usable)
    many = share > _MANY
    return [
        make_finding(
            "corners-few",
            severity="warning" if many else "info",
            case="many" if many else "",
            name=name,
            useless=useless,
            frames=len(seen.usable),
            fewest_corners=FEWEST_CORNERS,
        )
    ]


def check_rhythm(name: str, t_ns: Integers) -> list[Finding]:
    """Return findings on the frame rate, lost frames and irregular timestamps; `t_ns` (n,) ascending, two or more."""
    steps = np.diff(t_ns)
    period = float(np.median(steps))
    findings: list[Finding] = []
    if 1e9 / period < _SLOW_HZ:
        findings.append(make_finding("frame-rate", name=name, rate_hz=1e9 / period))
    if float(np.median(np.abs(steps - period))) > _JITTER * period:
        findings.append(
            make_finding(
                "frame-jitter",
                name=name,
                period_ms=period * 1e-6,
                mean_ms=steps.mean() * 1e-6,
                longest_ms=steps.max() * 1e-6,
            )
        )
        return findings
    gaps = np.flatnonzero(steps > _GAP_PERIODS * period)
    if len(gaps):
        lost = int(np.rint(steps[gaps] / period - 1).sum())
        longest = int(gaps[np.argmax(steps[gaps])])
        severe = lost > _LOST_SHARE * len(t_ns)
        findings.append(
            make_finding(
                "frame-gaps",
                severity="warning" if severe else "info",
                case="severe" if severe else "",
                name=name,
                count=len(gaps),
                plural="s" * (len(gaps) > 1),
                lost=lost,
                longest_s=steps[longest] * 1e-9,
                at=_seconds(t_ns, longest),
            )
        )
    return findings


def _seconds(t_ns: Integers, index: int) -> float:
    return float(t_ns[index] - t_ns[0]) * 1e-9


def _unseen(name: str, usable: Integers) -> list[Finding]:
    longest = int(np.argmax(np.diff(usable)))
    length_s = float(usable[longest + 1] - usable[longest]) * 1e-9
    if length_s <= _UNSEEN_S:
        return []
    return [make_finding("board-unseen", name=name, length_s=length_s, at=_seconds(usable, longest))]


def _duration(name: str, usable: Integers) -> list[Finding]:
    length_s = float(usable[-1] - usable[0]) * 1e-9
    if length_s >= _ENOUGH_S:
        return []
    short = length_s < _SHORT_S
    return [
        make_finding(
            "stream-short/camera",
            severity="problem" if short else "warning",
            case="short" if short else "",
            name=name,
            length_s=length_s,
        )
    ]


def _image(name: str, frames: CameraFrames, seen: BoardSightings) -> list[Finding]:
    """Return findings on where and how large the board is in the image."""
    findings: list[Finding] = []
    covered = image_coverage(frames.pixels, frames.camera.resolution)
    extent = float(np.median(seen.extent_px[seen.usable])) / float(np.hypot(*frames.camera.resolution))
    good = covered >= _COVERED
    findings.append(
        make_finding(
            "image-coverage/recorded",
            severity="good" if good else "warning",
            case="good" if good else "",
            name=name,
            covered=covered,
        )
    )
    if extent < _SMALL:
        findings.append(make_finding("board-small/rig", name=name, extent=extent))
    return findings


def check_common_time(
    camera: str, t_ns: Integers, imu_name: str, imu: ImuSamples, time_shift_s: float = 0.0
) -> list[Finding]:
    """Say where the streams have little time in common; their clocks need not be one, so that it is no fault.

    Parameters
    ----------
    t_ns : (n,) timestamps of the camera, ascending
    time_shift_s : t_imu - t_cam as it was stated
    """
    samples = imu.gyroscope
    if len(t_ns) < 2 or len(samples) < 2:
        return []
    shift = round(time_shift_s * 1e9)
    first, last = int(t_ns[0]) + shift, int(t_ns[-1]) + shift
    common = (min(last, int(samples.t_ns[-1])) - max(first, int(samples.t_ns[0]))) * 1e-9
    shorter = min((last - first) * 1e-9, samples.duration_s)
    if common > _COMMON * shorter:
        return []
    some = common > 0
    found = f"only {common:.1f} s" if some else "no time"
    return [
        make_finding(
            "streams-apart",
            severity="warning" if some and common < _SHORT_S else "info",
            camera=camera,
            imu_name=imu_name,
            found=found,
            camera_s=(last - first) * 1e-9,
            duration_s=samples.duration_s,
        )
    ]


FEWEST_VIEWS = 3
"""Fewer views of a plane do not determine the intrinsics of a pinhole."""

ENOUGH_VIEWS = 10
_OTHER_GAP = 0.03
_MOST_LOOKED_AT = 60


def check_views(recording: Recording, target: Target) -> tuple[Finding, ...]:
    """Look at the views of a board and say what is good or bad about them.

    Codes: cameras-missing, frames-backward, corners-unknown, corners-outside, views, views-few, board-mirrored,
    tag-spacing, and those of the images.

    Returns
    -------
    Findings camera by camera; severity "problem" means that they cannot be calibrated.
    """
    if not recording.cameras:
        return (make_finding("cameras-missing/views"),)
    return tuple(
        finding for name, frames in recording.cameras.items() for finding in _cameras_check_camera(name, frames, target)
    )


def _cameras_check_camera(name: str, frames: CameraFrames, target: Target) -> list[Finding]:
    wrong = unusable_frames_finding(name, frames, target)
    if wrong is not None:
        return [wrong]
    seen = board_sightings(frames, target)
    findings = [_cameras_count(name, frames, seen)]
    if frames.quality is not None:
        findings += check_quality(name, frames.quality, len(frames.frame), frames.sigma_px)
    if findings[0].severity != "problem":
        findings += check_handedness(name, frames, seen.frame[seen.usable], target)
        findings += _spacing(name, frames, seen.frame[seen.usable], target)
    return findings


def _cameras_count(name: str, frames: CameraFrames, seen: BoardSightings) -> Finding:
    usable = int(np.count_nonzero(seen.usable))
    message = (
        f"{name}: {len(frames.t_ns)} images, the board in {usable} of them ({FEWEST_CORNERS} corners or more, not on "
        "one line)."
    )
    if usable >= ENOUGH_VIEWS:
        return make_finding("views", message=message)
    few = usable < FEWEST_VIEWS
    return make_finding(
        "views-few/found",
        severity="problem" if few else "warning",
        case="few" if few else "",
        message=message,
        fewest_views=FEWEST_VIEWS,
    )


def _spacing(name: str, frames: CameraFrames, usable: Integers, target: Target) -> list[Finding]:
    """Say that the gap between the tags contradicts the images, whatever the lens."""
    if target.kind != "aprilgrid":
        return []
    chosen = usable[:: max(len(usable) // _MOST_LOOKED_AT, 1)]
    ends = np.searchsorted(frames.frame, [chosen, chosen + 1])
    gap = tag_spacing([_board_view(frames, first, last) for first, last in ends.T], target)
    if gap is None or abs(gap - target.tag_spacing) <= _OTHER_GAP:
        return []
    return [make_finding("tag-spacing/implausible", name=name, gap=gap, tag_spacing=target.tag_spacing)]


def _board_view(frames: CameraFrames, first: int, last: int) -> BoardView:
    order = first + np.argsort(frames.point[first:last])
    return BoardView(point=frames.point[order], pixels=frames.pixels[order], sigma_px=np.ones(len(order)))
