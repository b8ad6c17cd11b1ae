"""Poses for the estimation from gravity's magnitude: of a table of averages, of one file each, or of a recording."""

from dataclasses import replace

import numpy as np

from ...assess.checks.signals import check_magnitude, check_signal
from ...detect.samples.faults import repair_samples, saturated_samples
from ...detect.samples.stillness import resting_variances, variance_magnitude_squared, window_samples, window_variances
from ...errors import DetectionError, RecordingError
from ...estimate.multiposition.measurements import cut_segments, segments_between
from ...estimate.multiposition.noise_levels import resting_noise, rounding_variance
from ...estimate.multiposition.problem import gyroscope_intervals, why_unlinked
from ...estimate.triads.gyroscope_at_rests import RestRotations
from ...findings import Finding
from ...frozen import value_class
from ...options import ImuOptions
from ...recording import Floats, ImuSamples, Integers, Piece, Poses, Recording, TriadSamples
from ...recording.samples import time_base
from ...results.result import Booleans, StaticIntervals, interval_means, runs_below
from .preparation import (
    GAP_NS,
    LEFT_TO_RESTS,
    PreparedImu,
    assumption_finding,
    check_and_detect,
    raise_first_problem,
    recording_gaps,
)

_MULTIPLIER = 10.0
_SHORTEST_S = 0.5
_PARTS_OF_PIECE = 4  # windows in the shortest file of a pose
_FEWEST_SAMPLES = 8
_DIGITS = 6
"""Means of no more digits than this may be alike by chance."""
_OF_EACH_POSE = ("start_s", "stop_s", "variance", "gyroscope_variance")
_OTHER_ATTITUDE = 0.05  # of the range of all means


@value_class
class PreparedPoses:
    """Means of n rests, ready for estimation.

    Attributes
    ----------
    poses : the means
    start_s, stop_s : (n,) when [s from the start of the recording]; nan where that is not known
    variance : (n, 3) of the accelerometer's means by noise [unit^2]; zero where nothing tells it
    gyroscope_variance : (n, 3) of the gyroscope's means by noise [unit^2]; zero where nothing tells it
    left_out : name and reason of what gave no mean
    rotations : between consecutive rests, where they were recorded; or None
    findings : what was noticed
    """

    poses: Poses
    start_s: Floats
    stop_s: Floats
    variance: Floats
    gyroscope_variance: Floats
    left_out: tuple[tuple[str, str], ...] = ()
    rotations: RestRotations | None = None
    findings: tuple[Finding, ...] = ()


def prepare_poses(recording: Recording, options: ImuOptions, checked: PreparedImu | None = None) -> PreparedPoses:
    """Return the means of a recording's rests; those that were found already where it was `checked`.

    Raises
    ------
    RecordingError
        If the recording holds nothing that can be used; DetectionError if it never rests, or in one attitude only.
    """
    if recording.poses is not None:
        prepared = _without_copies(_from_table(recording.poses))
    elif not recording.imus:
        raise RecordingError("the recording holds no IMU. Give a file with accelerometer samples.")
    elif recording.pieces:
        prepared = _without_copies(_from_pieces(next(iter(recording.imus.values())), recording.pieces, options))
    else:
        prepared = _from_rests(recording, options, checked)
    said = (
        ()
        if not recording.pieces and recording.poses is None
        else tuple(map(assumption_finding, recording.assumptions))
    )
    return replace(prepared, findings=(*prepared.findings, *said))


def _without_copies(prepared: PreparedPoses) -> PreparedPoses:
    """Leave out poses whose means are those of an earlier one to the last digit: a file or a row that is there twice.

    Means of few digits are alike by chance.
    """
    poses = prepared.poses
    means = poses.accelerometer if poses.gyroscope is None else np.hstack([poses.accelerometer, poses.gyroscope])
    coarse = np.round(means, _DIGITS - 1 - int(np.floor(np.log10(np.abs(means).max(initial=1e-300)))))
    _, first, which = np.unique(means, axis=0, return_index=True, return_inverse=True)
    original = first[which.ravel()]
    copies = original != np.arange(len(poses))
    if not copies.any() or np.array_equal(coarse, means):
        return prepared
    left_out = [(poses.name[k], f"the same numbers as {poses.name[original[k]]}") for k in np.flatnonzero(copies)]
    arrays = {name: getattr(prepared, name)[~copies] for name in _OF_EACH_POSE}
    return replace(prepared, poses=poses.where(~copies), left_out=(*prepared.left_out, *left_out), **arrays)


def _without_gaps(samples: TriadSamples) -> TriadSamples:
    """Return the samples with timestamps that leave out the time between poses that was not recorded.

    Only then do they tell the rate. A step from one attitude to the next looks like the motion that it was.
    """
    gaps = recording_gaps(samples)
    steps = np.diff(samples.t_ns)
    if not gaps.any() or not (usual := int(np.median(steps))) > 0:
        return samples
    t_ns = samples.t_ns[0] + np.concatenate([[0], np.cumsum(np.where(gaps, usual, steps))])
    return replace(samples, t_ns=t_ns)


def _from_table(poses: Poses) -> PreparedPoses:
    nothing = np.zeros_like(poses.accelerometer)
    when = np.full(len(poses), np.nan) if poses.t_s is None else poses.t_s
    variance = nothing if poses.accelerometer_sigma is None else poses.accelerometer_sigma**2
    raise_first_problem(check_magnitude(poses.accelerometer, float(np.sqrt(variance.min())), "accelerometer"))
    return PreparedPoses(
        poses=poses,
        start_s=when,
        stop_s=when,
        variance=variance,
        gyroscope_variance=nothing if poses.gyroscope_sigma is None else poses.gyroscope_sigma**2,
    )


def _from_rests(recording: Recording, options: ImuOptions, checked: PreparedImu | None) -> PreparedPoses:
    """Find the rests of one recording."""
    name, samples = next(iter(recording.imus.items()))
    if checked is None:
        noticed, detection = check_and_detect(recording, name, options)
        findings = (*noticed, *map(assumption_finding, recording.assumptions))
    else:
        findings, detection = checked.findings, checked.rests
    raise_first_problem(findings, tolerated=LEFT_TO_RESTS)
    if detection is None:
        raise DetectionError(
            f"the recording of {samples.accelerometer.duration_s:.1f} s is too short for windows of "
            f"{options.window_s:g} s. Let the sensor rest for 2 to 4 s in each attitude."
        )
    counted = options.time_base == "uniform"
    accelerometer, gyroscope = (
        repair_samples(one, counted=counted) for one in (samples.accelerometer, samples.gyroscope)
    )
    origin = int(accelerometer.t_ns[0])
    t_s = time_base(accelerometer, origin, options.time_base).t_s
    t_gyro = time_base(gyroscope, origin, options.time_base).t_s if len(gyroscope) else np.empty(0)
    if np.array_equal(accelerometer.t_ns, gyroscope.t_ns):
        t_gyro = t_s
    accelerometer, gyroscope = _without_gaps(accelerometer), _without_gaps(gyroscope)
    rests = detection.chosen.rests
    intervals, number = rests.intervals, np.flatnonzero(rests.used)
    at_rest = gyroscope_intervals(t_gyro, t_s[intervals.start], t_s[intervals.stop - 1])
    means = _means(accelerometer, gyroscope, intervals, at_rest)
    names = tuple(f"rest {k + 1}" for k in number)
    left_out = tuple(
        (f"rest {k + 1} ({t_s[rests.kept.start[k]]:.1f} to {t_s[rests.kept.stop[k] - 1]:.1f} s)", why)
        for k, why in enumerate(rests.reason)
        if why
    )
    start_s, stop_s = t_s[intervals.start], t_s[intervals.stop - 1]
    return replace(
        means,
        poses=replace(means.poses, name=names, t_s=0.5 * (start_s + stop_s)),
        start_s=start_s,
        stop_s=stop_s,
        left_out=left_out,
        rotations=_rotations(gyroscope, t_gyro, saturated_samples(gyroscope, options.gyroscope_range), at_rest),
        findings=tuple(finding for finding in findings if finding.code not in {*LEFT_TO_RESTS, "intervals-left-out"}),
    )


def _rotations(
    gyroscope: TriadSamples, t_s: Floats, clipped: Booleans, at_rest: StaticIntervals
) -> RestRotations | None:
    """Return the rotations between consecutive rests; None where none was recorded."""
    if len(at_rest) < 2 or not len(gyroscope):
        return None
    first, lengths = segments_between(t_s, t_s[at_rest.stop[:-1] - 1], t_s[at_rest.start[1:]])
    longest = [np.max(np.diff(t_s[a : a + n]), initial=0.0) for a, n in zip(first, lengths, strict=True)]
    if min(longest) > 1e-9 * GAP_NS:  # the time between poses was cut out
        return None
    segments = cut_segments(t_s, gyroscope.values, gyroscope.values, first, lengths)
    means = interval_means(gyroscope.values, at_rest)
    _, density = resting_noise(gyroscope.values, at_rest, gyroscope.rate_hz)
    rest = (at_rest.stop - at_rest.start) / gyroscope.rate_hz
    took = segments.duration_s[:, None]
    both = density * (1 / rest[:-1] + 1 / rest[1:])[:, None] / 4 + np.diff(means, axis=0) ** 2 / 12
    return RestRotations(
        segments=segments,
        first=np.arange(len(at_rest) - 1),
        bias=0.5 * (means[1:] + means[:-1]),
        variance=density * took + both * took**2,
        reason=tuple(
            why_unlinked(t_s, clipped, gyroscope.rate_hz, slice(int(a), int(a + n)))
            for a, n in zip(first, lengths, strict=True)
        ),
    )


def _means(
    accelerometer: TriadSamples, gyroscope: TriadSamples, still: StaticIntervals, at_rest: StaticIntervals
) -> PreparedPoses:
    """Return means and their noise, without names and times."""
    n = len(still)
    if not n:
        raise DetectionError("no rest found. Let the sensor lie still for 2 to 4 s in each attitude.")
    of_gyroscope, gyroscope_variance = None, np.zeros((n, 3))
    if len(gyroscope):
        if np.any(at_rest.stop - at_rest.start < 2):
            raise DetectionError(
                "the gyroscope has no samples in some static intervals of the accelerometer. "
                "Both must be recorded together and stamped by one clock."
            )
        of_gyroscope = interval_means(gyroscope.values, at_rest)
        gyroscope_variance = _variance(gyroscope, at_rest, alike=n)
    nothing = np.full(n, np.nan)
    return PreparedPoses(
        poses=Poses(
            name=tuple(map(str, range(n))),
            accelerometer=interval_means(accelerometer.values, still),
            accelerometer_unit=accelerometer.unit,
            gyroscope=of_gyroscope,
            gyroscope_unit=gyroscope.unit,
            samples=still.stop - still.start,
        ),
        start_s=nothing,
        stop_s=nothing,
        variance=_variance(accelerometer, still),
        gyroscope_variance=gyroscope_variance,
    )


def _variance(samples: TriadSamples, still: StaticIntervals, alike: int = 1) -> Floats:
    """Return the variance of means (n, 3); that of rounding is shared by `alike` of them."""
    density, _ = resting_noise(samples.values, still, samples.rate_hz)
    rounding = alike * rounding_variance(samples.values, still)
    return density / ((still.stop - still.start) / samples.rate_hz)[:, None] + rounding


def _from_pieces(samples: ImuSamples, pieces: tuple[Piece, ...], options: ImuOptions) -> PreparedPoses:
    """Average the resting part of each file."""
    accelerometer, gyroscope = _without_gaps(samples.accelerometer), _without_gaps(samples.gyroscope)
    triads = [triad for triad in (accelerometer, gyroscope) if len(triad)]
    findings = [
        f
        for triad, name in zip(triads, ("accelerometer", "gyroscope"), strict=False)
        for f in check_signal(triad, name)
    ]
    raise_first_problem(findings, tolerated=LEFT_TO_RESTS)
    _refuse_reversed(accelerometer.t_ns, pieces)
    clipped = saturated_samples(accelerometer, options.accelerometer_range)
    intervals, names, left_out = _rest_of_each(triads, clipped, pieces, options)
    if not len(intervals):
        raise DetectionError(
            f"the sensor rests in none of the {len(pieces)} files ({left_out[0][0]}: {left_out[0][1]})."
        )
    t_s = (samples.accelerometer.t_ns - samples.accelerometer.t_ns[0]) * 1e-9
    start_s, stop_s = t_s[intervals.start], t_s[intervals.stop - 1]
    means = _means(accelerometer, gyroscope, intervals, intervals)
    return replace(
        means,
        poses=replace(means.poses, name=names, t_s=0.5 * (start_s + stop_s)),
        start_s=start_s,
        stop_s=stop_s,
        left_out=left_out,
        findings=tuple(findings),
    )


def _refuse_reversed(t_ns: Integers, pieces: tuple[Piece, ...]) -> None:
    for piece in pieces:
        back = np.flatnonzero(np.diff(t_ns[piece.start : piece.stop]) < 0)
        if len(back):
            raise RecordingError(
                f"{piece.name}: time goes backwards after sample {int(back[0]) + 1}. Is the right column the time?"
            )


def _rest_of_each(
    triads: list[TriadSamples], clipped: Booleans, pieces: tuple[Piece, ...], options: ImuOptions
) -> tuple[StaticIntervals, tuple[str, ...], tuple[tuple[str, str], ...]]:
    """Return the longest rest of each file that has one, the names of these files, and why others have none."""
    longest = window_samples(triads[0], options.window_s)
    windows = [min(longest, 2 * max(1, (piece.stop - piece.start) // (2 * _PARTS_OF_PIECE)) + 1) for piece in pieces]
    usable = [k for k, piece in enumerate(pieces) if piece.stop - piece.start >= _FEWEST_SAMPLES]
    statistics = _statistics(triads, [pieces[k] for k in usable], [windows[k] for k in usable])
    statistic = dict(zip(usable, statistics, strict=True))
    multiplier = options.multiplier or _MULTIPLIER
    rests = [StaticIntervals(start=np.empty(0, np.int64), stop=np.empty(0, np.int64)) for _ in pieces]
    for k in usable:
        piece = pieces[k]
        shortest = min(round(_SHORTEST_S * triads[0].rate_hz), (piece.stop - piece.start) // 2)
        still = np.where(clipped[piece.start : piece.stop], np.inf, statistic[k])
        found = runs_below(still, multiplier, max(shortest, 3))
        rests[k] = StaticIntervals(start=found.start + piece.start, stop=found.stop + piece.start)
    reasons = _reasons(triads[0], pieces, rests, clipped)
    chosen = [int(np.argmax(r.stop - r.start)) if len(r) else -1 for r in rests]
    kept = [k for k, reason in enumerate(reasons) if not reason]
    intervals = StaticIntervals(
        start=np.array([rests[k].start[chosen[k]] for k in kept], dtype=np.int64),
        stop=np.array([rests[k].stop[chosen[k]] for k in kept], dtype=np.int64),
    )
    left_out = tuple((pieces[k].name, reason) for k, reason in enumerate(reasons) if reason)
    return intervals, tuple(pieces[k].name for k in kept), left_out


def _statistics(triads: list[TriadSamples], pieces: list[Piece], windows: list[int]) -> list[Floats]:
    """Return s^2 of Eq. (3.9) of each file, relative to what most files show at rest; the larger of the two triads."""
    statistics = [np.zeros(piece.stop - piece.start) for piece in pieces]
    for triad in triads:
        parts = [triad.values[piece.start : piece.stop] for piece in pieces]
        variances = [window_variances(part, window) for part, window in zip(parts, windows, strict=True)]
        levels = [
            resting_variances(variance, part, window)
            for variance, part, window in zip(variances, parts, windows, strict=True)
        ]
        level = np.median(levels, axis=0)
        for k, variance in enumerate(variances):
            statistics[k] = np.maximum(statistics[k], variance_magnitude_squared(variance, level) / 3)
    return statistics


def _reasons(
    accelerometer: TriadSamples, pieces: tuple[Piece, ...], rests: list[StaticIntervals], clipped: Booleans
) -> list[str]:
    """Return why a file gives no pose, or ""; refuse it where most files are whole recordings of several attitudes."""
    means = [interval_means(accelerometer.values, r) for r in rests]
    everything = np.concatenate(means)
    size = float(np.max(np.ptp(everything, axis=0), initial=0.0)) if len(everything) else 0.0
    reasons: list[str] = []
    several = 0
    for piece, rest, mean in zip(pieces, rests, means, strict=True):
        if piece.stop - piece.start < _FEWEST_SAMPLES:
            reasons.append(f"it holds only {piece.stop - piece.start} samples")
        elif not len(rest):
            cut = clipped[piece.start : piece.stop].mean() > 0.1
            reasons.append("the accelerometer is saturated" if cut else "the sensor never rests in it")
        elif len(mean) > 1 and np.ptp(mean, axis=0).max() > _OTHER_ATTITUDE * size:
            several += 1
            reasons.append(f"it holds {len(mean)} rests in different attitudes")
        else:
            reasons.append("")
    if several > 0.5 * len(pieces):
        raise RecordingError(
            f"{several} of {len(pieces)} files hold rests in several attitudes each, such as {pieces[0].name}. "
            "Several files are taken for one pose each; to calibrate from one recording, name it alone."
        )
    return reasons
