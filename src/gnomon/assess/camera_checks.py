"""The data doctor's look at cameras and IMU together, before anything is estimated from them.

What only an estimate shows (a wrong size of the board, intrinsics of another camera, too little rotation) is said
after it.
"""

from collections.abc import Iterable, Mapping

import numpy as np

from ..findings import Finding
from ..models.target import Target
from ..recording import CameraFrames, ImuSamples, Integers, Recording
from .camera_views import FEWEST_CORNERS, Views, image_coverage, views
from .clock_checks import check_epochs
from .handedness import check_handedness
from .image_checks import check_images
from .motion_checks import check_moving_imu

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
    frames-backward, corners-unknown, corners-outside, frames, frames-few, board-mirrored, frames-repeated, corners-few,
    frame-rate, frame-jitter, frame-gaps, board-unseen, image-coverage, board-small, stream-short, streams-apart, of
    their stamps stamps-zero and stamps-unit, and of their images those of `check_images`; of the IMUs those of
    `check_moving_imu`.

    Returns
    -------
    Findings IMU by IMU, camera by camera; severity "problem" means that it cannot be calibrated.
    """
    findings = [finding for name, imu in recording.imus.items() for finding in check_moving_imu(name, imu)]
    findings += [finding for finding in check_epochs(all_stamps(recording)) if finding.severity == "problem"]
    if not recording.cameras:
        findings.append(
            Finding(
                severity="problem",
                code="cameras-missing",
                message="There is no camera in this recording.",
                consequence="Only an IMU alone can be calibrated from it, if it rests in many attitudes.",
                cure="Give the folder with the corners of the camera, or calibrate with gnomon imu.",
            )
        )
    for name, frames in recording.cameras.items():
        findings += _check_camera(name, frames, target)
        for imu in beside(name, recording.cameras, recording.imus):
            shift_s = frames.time_shift_cam_imu_s or 0.0
            findings += check_common_time(name, frames.t_ns, imu, recording.imus[imu], shift_s)
    return tuple(findings)


def beside(camera: str, cameras: Iterable[str], imus: Iterable[str]) -> list[str]:
    """Return the IMUs beside which a camera is looked at: the first one, and all of them for the first camera."""
    return list(imus)[: None if camera == next(iter(cameras)) else 1]


def all_stamps(recording: Recording) -> dict[str, Integers]:
    """Return the stamps of all streams, "cam0", ..., "imu0", ..., (n,) each [ns]."""
    return {name: frames.t_ns for name, frames in recording.cameras.items()} | imu_stamps(recording.imus)


def imu_stamps(imus: Mapping[str, ImuSamples]) -> dict[str, Integers]:
    """Return the stamps of IMUs: of the gyroscope, where it has any, else of the accelerometer."""
    triads = {name: imu.gyroscope if len(imu.gyroscope) else imu.accelerometer for name, imu in imus.items()}
    return {name: samples.t_ns for name, samples in triads.items()}


def _check_camera(name: str, frames: CameraFrames, target: Target) -> list[Finding]:
    wrong = impossible(name, frames, target)
    if wrong is not None:
        return [wrong]
    seen = views(frames, target)
    findings = [_count(name, frames, seen, target)]
    if findings[0].severity == "problem":
        return findings + check_images(name, frames, seen.frame[seen.usable])  # they may tell why
    usable = frames.t_ns[seen.frame[seen.usable]]
    findings += _repeated(name, frames)
    findings += _useless(name, seen)
    findings += check_handedness(name, frames, seen.frame[seen.usable], target)
    findings += check_rhythm(name, frames.t_ns)
    findings += _unseen(name, usable)
    findings += _duration(name, usable)
    findings += check_images(name, frames, seen.frame[seen.usable])
    return findings + _image(name, frames, seen)


def impossible(name: str, frames: CameraFrames, target: Target) -> Finding | None:
    """Return why no calibration can use the frames of a camera, or None."""
    back = np.flatnonzero(np.diff(frames.t_ns) <= 0)
    if len(back):
        return Finding(
            severity="problem",
            code="frames-backward",
            message=f"{name}: the stamp of frame {int(back[0]) + 1} is not later than that of the frame before, as in "
            f"{len(back)} of {len(frames.t_ns)} frames.",
            consequence="The order of the frames is not known.",
            cure="Sort the frames by their stamps, and give each stamp once.",
        )
    beyond = (frames.point < 0) | (frames.point >= len(target.points))
    if beyond.any():
        return Finding(
            severity="problem",
            code="corners-unknown",
            message=f"{name}: {int(np.count_nonzero(beyond))} of {len(beyond)} corners are not on the target, which "
            f"has points 0 to {len(target.points) - 1}; the first is point {frames.point[int(np.argmax(beyond))]}.",
            consequence="The board is another one, so that nothing fits.",
            cure="Give the target of the board that was seen.",
        )
    return _outside(name, frames)


def _outside(name: str, frames: CameraFrames) -> Finding | None:
    (width, height), u, v = frames.camera.resolution, frames.pixels[:, 0], frames.pixels[:, 1]
    outside = (u < -0.5) | (v < -0.5) | (u > width - 0.5) | (v > height - 0.5)
    if np.count_nonzero(outside) <= 0.5 * len(outside):
        return None
    return Finding(
        severity="problem",
        code="corners-outside",
        message=f"{name}: {int(np.count_nonzero(outside))} of {len(outside)} corners lie outside the image of "
        f"{width} x {height} px.",
        consequence="Intrinsics and resolution are those of another camera or image size.",
        cure="Give the camchain of this camera, at the size of the images in which the corners were detected.",
    )


def _count(name: str, frames: CameraFrames, seen: Views, target: Target) -> Finding:
    usable = int(np.count_nonzero(seen.usable))
    span_s = (int(frames.t_ns[-1]) - int(frames.t_ns[0])) * 1e-9 if len(frames.t_ns) else 0.0
    message = f"{name}: {len(frames.t_ns)} frames in {span_s:.1f} s, the board in {usable} of them"
    if usable >= _ENOUGH_FRAMES:
        corners = int(np.median(seen.corners[seen.usable]))
        return Finding(
            severity="good",
            code="frames",
            message=f"{message}, usually {corners} of its {len(target.points)} corners.",
        )
    few = usable < FEWEST_FRAMES
    return Finding(
        severity="problem" if few else "warning",
        code="frames-few",
        message=f"{message} ({FEWEST_CORNERS} corners or more, not on one line).",
        consequence="They do not tell how the camera moved." if few else "The result will be uncertain.",
        cure="Record for a minute at 20 Hz, with the board in sight and sharp.",
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
        Finding(
            severity="warning" if share > _REPEATED else "info",
            code="frames-repeated",
            message=f"{name}: {len(same)} frames ({100 * share:.2g} %) show the same corners as the frame before, to "
            "the last digit: the same image was delivered twice, under a new stamp.",
            consequence="The camera seems to stand still and then to jump; such frames bend the result.",
            cure="Look at the driver's buffers and at the load of the computer; record at a lower frame rate.",
        )
    ]


def _useless(name: str, seen: Views) -> list[Finding]:
    useless = int(np.count_nonzero(~seen.usable))
    if not useless:
        return []
    share = useless / len(seen.usable)
    many = share > _MANY
    return [
        Finding(
            severity="warning" if many else "info",
            code="corners-few",
            message=f"{name}: {useless} of {len(seen.usable)} frames with corners have fewer than {FEWEST_CORNERS} of "
            "them, or all on one line.",
            consequence="Such frames tell no pose of their own.",
            cure="Keep the board in sight; more light and a shorter exposure keep it sharp." if many else "",
        )
    ]


def check_rhythm(name: str, t_ns: Integers) -> list[Finding]:
    """Return findings on the frame rate, lost frames and irregular stamps; `t_ns` (n,) ascending, two or more."""
    steps = np.diff(t_ns)
    period = float(np.median(steps))
    findings: list[Finding] = []
    if 1e9 / period < _SLOW_HZ:
        findings.append(
            Finding(
                severity="warning",
                code="frame-rate",
                message=f"{name}: {1e9 / period:.2g} frames a second.",
                consequence="Between frames the trajectory rests on the IMU alone, whose errors are to be found.",
                cure="Record at 20 Hz.",
            )
        )
    if float(np.median(np.abs(steps - period))) > _JITTER * period:
        findings.append(
            Finding(
                severity="warning",
                code="frame-jitter",
                message=f"{name}: the stamps are irregular: half of the steps are {period * 1e-6:.3g} ms or less, "
                f"their mean is {steps.mean() * 1e-6:.3g} ms, the longest {steps.max() * 1e-6:.4g} ms.",
                consequence="Such stamps may tell when frames arrived, not when they were exposed.",
                cure="Stamp the frames at their exposure, or use the camera's own clock.",
            )
        )
        return findings
    gaps = np.flatnonzero(steps > _GAP_PERIODS * period)
    if len(gaps):
        lost = int(np.rint(steps[gaps] / period - 1).sum())
        longest = int(gaps[np.argmax(steps[gaps])])
        severe = lost > _LOST_SHARE * len(t_ns)
        findings.append(
            Finding(
                severity="warning" if severe else "info",
                code="frame-gaps",
                message=f"{name}: {len(gaps)} gap{'s' * (len(gaps) > 1)}, about {lost} frames missing; the longest "
                f"lasts {steps[longest] * 1e-9:.3g} s, {_seconds(t_ns, longest):.2f} s after the start.",
                consequence="The IMU bridges short gaps; long ones leave the trajectory loose.",
                cure="Record to a faster disk, or at a lower frame rate." if severe else "",
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
    return [
        Finding(
            severity="warning",
            code="board-unseen",
            message=f"{name}: the board is out of sight for {length_s:.1f} s, from {_seconds(usable, longest):.1f} s "
            "after it was first seen.",
            consequence="There the trajectory rests on the IMU alone and tells little.",
            cure="Move so that the board stays in the image.",
        )
    ]


def _duration(name: str, usable: Integers) -> list[Finding]:
    length_s = float(usable[-1] - usable[0]) * 1e-9
    if length_s >= _ENOUGH_S:
        return []
    short = length_s < _SHORT_S
    return [
        Finding(
            severity="problem" if short else "warning",
            code="stream-short",
            message=f"{name}: the board is seen for {length_s:.1f} s.",
            consequence="That is too short to find the time shift and the biases."
            if short
            else "Biases are uncertain.",
            cure="Record for a minute, and turn about all three axes.",
        )
    ]


def _image(name: str, frames: CameraFrames, seen: Views) -> list[Finding]:
    """Return findings on where and how large the board is in the image."""
    findings: list[Finding] = []
    covered = image_coverage(frames.pixels, frames.camera.resolution)
    extent = float(np.median(seen.extent_px[seen.usable])) / float(np.hypot(*frames.camera.resolution))
    good = covered >= _COVERED
    findings.append(
        Finding(
            severity="good" if good else "warning",
            code="image-coverage",
            message=f"{name}: corners were seen in {100 * covered:.0f} % of the image.",
            consequence=""
            if good
            else "Errors of the intrinsics in the rest of the image stay hidden, and bend the pose.",
            cure="" if good else "Let the board come into every part of the image.",
        )
    )
    if extent < _SMALL:
        findings.append(
            Finding(
                severity="warning",
                code="board-small",
                message=f"{name}: the board usually spans {100 * extent:.0f} % of the image's diagonal.",
                consequence="A small board tells the pose badly, and with it the translation between camera and IMU.",
                cure="Come closer, so that the board fills half of the image.",
            )
        )
    return findings


def check_common_time(
    camera: str, t_ns: Integers, imu_name: str, imu: ImuSamples, time_shift_s: float = 0.0
) -> list[Finding]:
    """Say where the streams have little time in common; their clocks need not be one, so that it is no fault.

    Parameters
    ----------
    t_ns : (n,) stamps of the camera, ascending
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
        Finding(
            severity="warning" if some and common < _SHORT_S else "info",
            code="streams-apart",
            message=f"{camera} and {imu_name} have {found} in common by their stamps ({camera} lasts "
            f"{(last - first) * 1e-9:.1f} s, {imu_name} {samples.duration_s:.1f} s).",
            consequence="Their clocks are taken for unrelated; the time shift is searched over everything.",
            cure="If they have one clock, check that both streams are of one recording and that their stamps have the "
            "same unit.",
        )
    ]
