"""The data doctor's look at each stream of cameras and IMUs, before anything is estimated from them.

What only an estimate shows (a wrong size of the board, intrinsics of another camera, too little rotation) is said after
it.
"""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace

import numpy as np

from ...detect.samples.faults import RangeChange, find_range_change
from ...estimate.trust.changes import look_or_postpone
from ...findings import Finding, make_finding
from ...models.target import Target
from ...recording import CameraFrames, Floats, ImuSamples, Integers, Recording, TriadSamples, measurable_numbers
from ...results.result import StaticIntervals
from ...units import ACCELEROMETER_UNITS_M_S2, GYROSCOPE_UNITS_RAD_S, STANDARD_GRAVITY_M_S2
from .board_views import FEWEST_CORNERS, BoardSightings, board_sightings, check_handedness, image_coverage
from .clock_checks import check_epochs
from .image_checks import check_images
from .imu_checks import looks_like, range_changed_finding, why_no_gravity
from .rig_lens import check_image_size
from .signals import check_exchanged, check_signal, check_stamps, check_vibration, is_silent

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
        return findings + _images(name, frames, seen)  # they may tell why
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
    return [*findings, *_images(name, frames, seen), *_board_in_image(name, frames, seen)]


def _images(name: str, frames: CameraFrames, seen: BoardSightings) -> list[Finding]:
    """Return findings on the images, where it is known what they were like."""
    return [] if frames.quality is None else check_images(name, frames, seen.frame[seen.usable])


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


def _useless(name: str, seen: BoardSightings) -> Iterator[Finding]:
    useless = int(np.count_nonzero(~seen.usable))
    if not useless:
        return
    share = useless / len(seen.usable)
    many = share > _MANY
    yield make_finding(
        "corners-few",
        severity="warning" if many else "info",
        case="many" if many else "",
        name=name,
        useless=useless,
        frames=len(seen.usable),
        fewest_corners=FEWEST_CORNERS,
    )


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


def _duration(name: str, usable: Integers) -> Iterator[Finding]:
    length_s = float(usable[-1] - usable[0]) * 1e-9
    if length_s >= _ENOUGH_S:
        return
    short = length_s < _SHORT_S
    yield make_finding(
        "stream-short/camera",
        severity="problem" if short else "warning",
        case="short" if short else "",
        name=name,
        length_s=length_s,
    )


def _board_in_image(name: str, frames: CameraFrames, seen: BoardSightings) -> list[Finding]:
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


_SLOW_IMU_HZ, _SLOWEST_IMU_HZ = 50.0, 10.0
_SHORT_IMU_S = 5.0
_PLAUSIBLE, _POSSIBLE = 1.2, 2.0  # median specific force over gravity, or the inverse
_FASTEST_RAD_S = 35.0  # the full scale of usual gyroscopes, 2000 deg/s
_STILL_RAD_S, _SLOWEST_RAD_S = 0.05, 0.1
_SWING_S, _SWINGS = 0.3, 9


_RETOLD = {
    "gaps": ("There the trajectory rests on the other sensors alone.", "Record with a faster link or a lower rate."),
    "time-constant": ("Nothing can be integrated.", "Write the time of each sample, in nanoseconds."),
    "time-repeated": (
        "Only the first sample of each timestamp tells its time.",
        "Write every sample once, in nanoseconds.",
    ),
    "time-rounded": (
        "Rounded timestamps act like noise.",
        "Write the timestamps with all their digits, in nanoseconds.",
    ),
    "signal-constant": ("The sensor measured nothing.", "Check that it is switched on, and what the header names."),
    "axis-constant": ("The sensor did not measure this axis.", "Check its configuration, and what the header names."),
    "saturation": ("They are masked.", "Turn more slowly, or set a wider range."),
    "samples-stuck": ("Stuck samples contradict the camera.", "Check the link to the sensor, and cut this part out."),
}
"""Consequence and cure of findings of the other doctors, whose words are for recordings with rests."""


def check_moving_imu(name: str, imu: ImuSamples) -> list[Finding]:
    """Return findings on the samples of an IMU that moved in front of a board; linear time.

    Codes: samples-missing, samples-lost, unit, imu-rate, stream-short, gravity-magnitude, range-changed,
    rate-magnitude, gyroscope-silent, imu-still, and those of the timestamps and the signals.
    """
    unusable = _unusable(name, imu)
    if unusable:
        return unusable
    accelerometer = _in_si(imu.accelerometer, ACCELEROMETER_UNITS_M_S2)
    gyroscope = _in_si(imu.gyroscope, GYROSCOPE_UNITS_RAD_S)
    imu = replace(imu, accelerometer=accelerometer, gyroscope=gyroscope)
    findings: list[Finding] = []
    if np.array_equal(accelerometer.t_ns, gyroscope.t_ns):
        findings += check_stamps(accelerometer, name)
    else:
        findings += check_stamps(accelerometer, f"{name} accelerometer") + check_stamps(gyroscope, f"{name} gyroscope")
    for samples, sensor in ((accelerometer, "accelerometer"), (gyroscope, "gyroscope")):
        findings += check_signal(samples, f"{name} {sensor}")
    findings = [_retold(finding) for finding in findings]
    if any(finding.code in {"time-constant", "signal-constant"} for finding in findings):
        return findings
    gravity = _gravity(name, accelerometer)
    if gravity[0].code == "gravity-magnitude" and gravity[0].severity != "good":
        exchanged = check_exchanged(accelerometer, gyroscope, name)
        if exchanged:
            return exchanged
    shaken = check_vibration(accelerometer, gyroscope, name)
    return [*findings, *_rate(name, gyroscope), *gravity, *_motion(name, imu), *shaken]


def _unusable(name: str, imu: ImuSamples) -> list[Finding]:
    """Return problems that leave nothing else to look at."""
    accelerometer, gyroscope = f"{name} accelerometer", f"{name} gyroscope"
    found = _incomplete(accelerometer, imu.accelerometer) or _incomplete(gyroscope, imu.gyroscope)
    return [] if found is None else [found]


def _in_si(samples: TriadSamples, units: dict[str, float | None]) -> TriadSamples:
    factor = units[samples.unit]
    if factor is None or factor == 1:
        return samples
    return replace(samples, values=samples.values * factor, unit=next(iter(units)))


def _incomplete(label: str, samples: TriadSamples) -> Finding | None:
    if len(samples) < 2:
        return make_finding("samples-missing/rig", label=label, samples=len(samples))
    if samples.unit == "count":
        return make_finding("unit/counts", label=label)
    lost = ~np.logical_and.reduce(measurable_numbers(samples.values), axis=1)
    if lost.any():
        return make_finding(
            "samples-lost", label=label, lost=np.count_nonzero(lost), samples=len(lost), first=np.argmax(lost)
        )
    return None


def _retold(finding: Finding) -> Finding:
    if finding.code not in _RETOLD or not finding.cure:
        return finding
    consequence, cure = _RETOLD[finding.code]
    return replace(finding, consequence=consequence, cure=cure)


def _rate(name: str, gyroscope: TriadSamples) -> list[Finding]:
    findings: list[Finding] = []
    rate_hz, duration_s = gyroscope.rate_hz, gyroscope.duration_s
    if rate_hz < _SLOW_IMU_HZ:
        findings.append(
            make_finding(
                "imu-rate", severity="problem" if rate_hz < _SLOWEST_IMU_HZ else "warning", name=name, rate_hz=rate_hz
            )
        )
    if duration_s < _SHORT_IMU_S:
        findings.append(make_finding("stream-short/imu", name=name, duration_s=duration_s))
    return findings


def _gravity(name: str, accelerometer: TriadSamples) -> list[Finding]:
    width = max(1, min(round(_SWING_S * accelerometer.rate_hz), len(accelerometer) // 10))
    parts = len(accelerometer) // width
    means = accelerometer.values[: parts * width].reshape(parts, width, 3).mean(axis=1)  # shaking averages out
    read = np.linalg.norm(means, axis=1)
    change = _range_change(read, width, len(accelerometer))
    if change is not None:
        return [range_changed_finding(change, accelerometer, name, "problem")]
    found = float(np.median(read))
    ratio = max(found, 1e-9) / STANDARD_GRAVITY_M_S2
    ratio = max(ratio, 1 / ratio)
    message = f"{name}: the accelerometer usually reads {found:.3f} m/s^2"
    averaged = width >= round(_SWING_S * accelerometer.rate_hz)
    if ratio <= (_PLAUSIBLE if averaged else _POSSIBLE):
        return [make_finding("gravity-magnitude/good", message=f"{message}, 9.81 but for bias and motion.")]
    message += f", expected about 9.81.{looks_like(found, 'm/s^2')}"
    return [
        make_finding(
            "gravity-magnitude/motion",
            severity="problem" if ratio > _POSSIBLE else "warning",
            message=message,
            found=why_no_gravity(found, message),
        )
    ]


def _range_change(read: Floats, width: int, samples: int) -> RangeChange | None:
    """Return where gravity is read as another number, by medians over several swings of the hand.

    Parameters
    ----------
    read : (m,) magnitude of the mean over each swing [m/s^2]
    width : samples of a swing
    samples : of the recording
    """
    parts = len(read) // _SWINGS
    starts = _SWINGS * width * np.arange(parts)
    stretches = StaticIntervals(start=starts, stop=starts + _SWINGS * width)
    return find_range_change(np.median(read[: parts * _SWINGS].reshape(parts, _SWINGS), axis=1), stretches, samples)


def _motion(name: str, imu: ImuSamples) -> Iterator[Finding]:
    """Yield findings on how much the gyroscope shows."""
    rates = imu.gyroscope.values - np.median(imu.gyroscope.values, axis=0)
    if np.sqrt((rates**2).sum(axis=1).mean()) < _STILL_RAD_S and is_silent(imu.gyroscope):
        yield _silent(name, is_silent(imu.accelerometer))
        return
    peak = float(np.abs(rates).max())
    found = f"{name}: the gyroscope reads up to {peak:.4g} rad/s ({np.degrees(peak):.4g} deg/s) from its median."
    state = 'State the unit if it is another one (--units, for example "g deg/s")'
    if peak >= _FASTEST_RAD_S:
        consequence, cure = "Hands do not turn so fast; the unit may be wrong.", f"{state}."
    elif peak <= _SLOWEST_RAD_S:
        consequence, cure = "The turns are too slow to tell much, or the unit is wrong.", f"{state}, or turn faster."
    else:
        return
    yield make_finding("rate-magnitude", found=found, consequence=consequence, cure=cure)


def _silent(name: str, still: bool) -> Finding:
    """Return what to say where the gyroscope shows only noise; `still` where the accelerometer does, too."""
    if still:
        return make_finding("imu-still", name=name)
    return make_finding("gyroscope-silent/motion", name=name)
