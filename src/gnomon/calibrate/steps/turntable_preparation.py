"""From recordings on a turntable to steady parts of known speed, cut to whole turns, with what each attitude shows."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from ...assess.checks.signals import check_signal, check_stamps
from ...assess.imu.temperature import check_temperature
from ...detect.samples.faults import repair_samples, saturated_samples
from ...detect.samples.steady import block_means, block_samples, find_steady, largest_rate
from ...errors import DetectionError, OptionError, RecordingError
from ...estimate.multiposition.noise_levels import resting_noise
from ...estimate.turntable.parts import (
    NO_SPEED,
    AxisInSensor,
    Between,
    ForceBlocks,
    Speeds,
    TurntableData,
    TurntableParts,
    assign_speeds,
    axis_in_sensor,
    link_parts,
)
from ...findings import Finding, make_finding
from ...frozen import value_class
from ...options import StatedRate, TurntableOptions
from ...recording import Floats, Integers, Recording, TemperatureSamples, TriadSamples
from ...recording.thermometer import temperature_course
from ...results.result import Booleans, StaticIntervals, interval_means
from ...results.temperature_dependence import TemperatureDependence
from ...units import GYROSCOPE_UNITS_RAD_S
from .temperature_while_turned import rose_and_fell, temperature_powers

_BETWEEN_FILES_S = 60.0
_ALIKE, _ALIKE_NOISE = 0.03, 6.0  # of the fastest motion; of the noise of a block
_FEWEST_AXES = 3
_HARMLESS = {"saturation"}  # parts at the end of the range are named with their speed instead


@value_class
class PlatterStream:
    """One recording.

    Attributes
    ----------
    name : its file, or "recording 1"
    gyroscope, accelerometer : samples; of the accelerometer none where it was not recorded
    saturated : (n,) clipped samples of the gyroscope
    t_s, force_t_s : (n,), (m,) timestamps [s from its start]
    begin_s : when it began [s from the start of the session]
    intervals : steady parts
    clipped : (k,) bool, those at the end of the range
    """

    name: str
    gyroscope: TriadSamples
    accelerometer: TriadSamples
    saturated: Booleans
    t_s: Floats
    force_t_s: Floats
    begin_s: float
    intervals: StaticIntervals
    clipped: Booleans


def prepare_turntable(
    recordings: Sequence[Recording],
    rates: Sequence[StatedRate],
    rate_of: Sequence[StatedRate | None] | None,
    options: TurntableOptions,
) -> TurntableParts:
    """Find the steady parts and what they show.

    Raises
    ------
    OptionError
        If no speed is stated, or all of them are zero.
    RecordingError
        If a recording cannot be used; DetectionError where nothing turns, or not at the stated speeds.
    """
    speeds = _speeds(rates, rate_of)
    streams, findings = _streams(recordings, options)
    unit = streams[0].gyroscope.unit
    recording = np.concatenate([np.full(len(s.intervals), k) for k, s in enumerate(streams)]).astype(np.int64)
    if not len(recording):
        raise DetectionError(
            "no steady part found: the gyroscope never keeps its rate for 2 s. "
            "Let the platter turn for several turns before the sensor is touched again."
        )
    means = np.concatenate([interval_means(s.gyroscope.values, s.intervals) for s in streams])
    clipped = np.concatenate([s.clipped for s in streams])
    _refuse_alike(means, streams)
    allowed = _allowed(recording, speeds, rate_of)
    values = np.array([rate.rate_rad_s for rate in speeds])
    found = assign_speeds(means, values, allowed, GYROSCOPE_UNITS_RAD_S[unit])
    _refuse_unlike(found, speeds, clipped, streams, unit)
    return _with_temperature(turntable_parts(streams, clipped, found, speeds, tuple(findings)), recordings, streams)


def _with_temperature(
    parts: TurntableParts, recordings: Sequence[Recording], streams: Sequence[PlatterStream]
) -> TurntableParts:
    """Return the parts with what the bias may follow of the temperature, where that both rose and fell."""
    each = [next(iter(one.imus.values())).temperature for one in recordings]
    t_ns, values, units = list[Integers](), list[Floats](), set[str]()
    for stream, one in zip(streams, each, strict=True):
        if one is None:
            return parts
        t_ns.append(one.t_ns - stream.gyroscope.t_ns[0] + round(1e9 * stream.begin_s))
        values.append(one.values)
        units.add(one.unit)
    session = TemperatureSamples(t_ns=np.concatenate(t_ns), values=np.concatenate(values), unit=units.pop())
    data, at_rest = parts.data, parts.data.rate == 0
    course = temperature_course(session) if rose_and_fell(session) and not units and at_rest.any() else None
    if course is None:
        return parts
    degc = course.with_rate(np.round(1e9 * data.t_s).astype(np.int64))
    read = degc[:, 0]
    known = TemperatureDependence(
        reference_degc=float(read[at_rest].mean()), low_degc=float(read.min()), high_degc=float(read.max())
    )
    powers = temperature_powers(degc, read[at_rest], course.step_k)
    untold = [] if data.force is None else [
        make_finding("temperature-untold", range=float(np.ptp(read)), attitudes=len(np.unique(data.pose)))
    ]  # fmt: skip
    return replace(parts, data=replace(data, degc=powers), temperature=known, findings=(*parts.findings, *untold))


def _refuse_alike(means: Floats, streams: Sequence[PlatterStream]) -> None:
    """Refuse parts that all show the same, whatever the unit."""
    if len(means) < 2:
        return
    size = largest_rate([stream.gyroscope for stream in streams])
    part = next(stream for stream in streams if len(stream.intervals))
    first = part.gyroscope.values[part.intervals.start[0] : part.intervals.stop[0]]
    noise = float(first.std(axis=0).max()) / np.sqrt(block_samples(part.gyroscope))
    if float(np.ptp(means, axis=0).max()) < max(_ALIKE * size, _ALIKE_NOISE * noise):
        raise DetectionError(
            f"all {len(means)} steady parts show the same rate: the platter never turned, or it never rested and the "
            "sensor always lay alike. Record the turning platter, with the sensor in many orientations."
        )


def _speeds(rates: Sequence[StatedRate], rate_of: Sequence[StatedRate | None] | None) -> tuple[StatedRate, ...]:
    """Return the different speeds that occur, zero last."""
    stated = [*rates, *(rate for rate in rate_of or () if rate is not None)]
    turning = {rate.rate_rad_s: rate for rate in reversed(stated) if rate.rate_rad_s > 0}
    if any(not rate.rate_rad_s >= 0 for rate in stated):
        raise OptionError("the rate of a turntable must not be below zero; its sense is found in the recording.")
    if not turning:
        raise OptionError(
            "a turntable at rest shows the gyroscope's bias and nothing of its scale. "
            "State the speed at which it turned, such as --rate 33.33rpm."
        )
    ordered = sorted(turning.values(), key=lambda rate: rate.rate_rad_s)
    return (*ordered, StatedRate(name="at rest", rate_rad_s=0.0))


def _allowed(
    recording: Integers, speeds: tuple[StatedRate, ...], rate_of: Sequence[StatedRate | None] | None
) -> Booleans:
    """Return which speeds each part may have, (n, g): those of its file where they are stated, and rest."""
    allowed = np.ones((len(recording), len(speeds)), dtype=bool)
    for k, rate in enumerate(rate_of or ()):
        if rate is not None:
            same = [speed.rate_rad_s in (rate.rate_rad_s, 0.0) for speed in speeds]
            allowed[recording == k] = same
    return allowed


def _streams(recordings: Sequence[Recording], options: TurntableOptions) -> tuple[list[PlatterStream], list[Finding]]:
    streams, findings, begin_s = list[PlatterStream](), list[Finding](), 0.0
    for k, recording in enumerate(recordings):
        name = recording.sources[0].name if recording.sources else f"recording {k + 1}"
        if not recording.imus:
            raise RecordingError(f"{name}: it holds no IMU. Give a file with gyroscope samples.")
        imu = next(iter(recording.imus.values()))
        noticed = _noticed(imu.gyroscope, imu.accelerometer, name)
        for finding in noticed:
            if finding.severity == "problem":
                raise RecordingError(str(finding))
        findings += [f for f in noticed if f.severity == "warning" and f.code not in _HARMLESS]
        thermometer = [] if imu.temperature is None else check_temperature(imu.temperature, f"{name} thermometer")
        findings += [f for f in (*recording.findings, *thermometer) if f.severity != "good"]
        gyroscope, accelerometer = repair_samples(imu.gyroscope), imu.accelerometer
        if len(accelerometer) > 1:
            accelerometer = repair_samples(accelerometer)
        origin = int(gyroscope.t_ns[0])
        streams.append(
            PlatterStream(
                name=name,
                gyroscope=gyroscope,
                accelerometer=accelerometer,
                saturated=saturated_samples(gyroscope, options.gyroscope_range),
                t_s=np.asarray((gyroscope.t_ns - origin) * 1e-9, dtype=np.float64),
                force_t_s=np.asarray((accelerometer.t_ns - origin) * 1e-9, dtype=np.float64),
                begin_s=begin_s,
                intervals=StaticIntervals(start=np.empty(0, np.int64), stop=np.empty(0, np.int64)),
                clipped=np.empty(0, bool),
            )
        )
        begin_s += gyroscope.duration_s + _BETWEEN_FILES_S
        findings += [make_finding("assumed", text=text) for text in recording.assumptions]
    if not streams:
        raise RecordingError("no recording given.")
    units = {(s.gyroscope.unit, s.accelerometer.unit if len(s.accelerometer) else "") for s in streams}
    if len(units) > 1:
        found = " and ".join(sorted(" ".join(pair) for pair in units))
        raise RecordingError(f"the recordings differ in their units or triads ({found}). State --units for all.")
    size = largest_rate([s.gyroscope for s in streams])
    steady = [find_steady(s.gyroscope, s.saturated, size) for s in streams]
    return [
        replace(s, intervals=part.intervals, clipped=part.clipped) for s, part in zip(streams, steady, strict=True)
    ], findings


def _noticed(gyroscope: TriadSamples, accelerometer: TriadSamples, name: str) -> list[Finding]:
    if len(gyroscope) < 2:
        return [make_finding("gyroscope-missing/turntable", name=name)]
    findings = [*check_stamps(gyroscope, f"{name} gyroscope"), *check_signal(gyroscope, f"{name} gyroscope")]
    if len(accelerometer) > 1:
        findings += check_signal(accelerometer, f"{name} accelerometer")
    return findings


def _refuse_unlike(
    found: Speeds,
    speeds: tuple[StatedRate, ...],
    clipped: Booleans,
    streams: Sequence[PlatterStream],
    unit: str,
) -> None:
    """Refuse recordings in which nothing turns as stated."""
    values = np.array([rate.rate_rad_s for rate in speeds])
    turning = (found.index != NO_SPEED) & (values[found.index] > 0)
    stated = " and ".join(f"{rate.name} ({rate.rate_rad_s:.4g} rad/s)" for rate in speeds[:-1])
    if clipped.any() and (turning & ~clipped).sum() < _FEWEST_AXES:
        limit = max(float(np.abs(s.gyroscope.values[s.saturated] - found.zero).max(initial=0.0)) for s in streams)
        fastest = max(speeds, key=lambda rate: rate.rate_rad_s)
        known = GYROSCOPE_UNITS_RAD_S[unit]
        degrees = "" if known is None else f" ({np.degrees(limit * known):.0f} deg/s)"
        left = int((turning & ~clipped).sum())
        few = f", in all but {left} of {int((turning | clipped).sum())} steady parts" if left else ""
        raise DetectionError(
            f"the gyroscope is saturated while the platter turns{few}: its readings stop at {limit:.5g} {unit}"
            f"{degrees}, and {fastest.name} is {np.degrees(fastest.rate_rad_s):.0f} deg/s. "
            "Choose a slower speed, or a wider range of the sensor."
        )
    if turning.any():
        return
    moving = found.shown > 0.25 * values[values > 0].min()
    if not moving.any():
        raise DetectionError(
            f"nothing turns in this recording: all {len(found.index)} steady parts show less than "
            f"{found.shown.max():.2g} rad/s, and {stated} was stated. Record while the platter turns."
        )
    shown = float(np.median(found.shown[moving]))
    raise DetectionError(
        f"no steady part turns at {stated}: the gyroscope shows {shown:.4g} rad/s ({shown * 30 / np.pi:.4g} rpm) in "
        f"{unit}. Check the speed, or state the unit of the recording with --units."
    )


_FORCE_BLOCK_S = 0.125


@value_class
class _Cut:
    """Parts of all recordings.

    Attributes
    ----------
    streams : the recordings
    of : (n,) index of each part's recording
    start, stop : (n,) samples of its gyroscope
    rate : (n,) speed [rad/s]; nan where it is none of those stated
    zero : (3,) what the gyroscope shows at rest, about [unit]
    """

    streams: Sequence[PlatterStream]
    of: Integers
    start: Integers
    stop: Integers
    rate: Floats
    zero: Floats

    def where(self, keep: Booleans) -> "_Cut":
        return _Cut(
            streams=self.streams,
            of=self.of[keep],
            start=self.start[keep],
            stop=self.stop[keep],
            rate=self.rate[keep],
            zero=self.zero,
        )

    def stream(self, i: int) -> PlatterStream:
        return self.streams[self.of[i]]

    def values(self, i: int) -> Floats:
        return self.stream(i).gyroscope.values[self.start[i] : self.stop[i]]

    @property
    def means(self) -> Floats:
        return np.array([self.values(i).mean(axis=0) for i in range(len(self.of))]).reshape(-1, 3)

    @property
    def spans_s(self) -> tuple[Floats, Floats]:
        """First and last timestamp of each part [s from the start of its recording]."""
        first = [self.stream(i).t_s[self.start[i]] for i in range(len(self.of))]
        last = [self.stream(i).t_s[self.stop[i] - 1] for i in range(len(self.of))]
        return np.array(first), np.array(last)

    @property
    def names(self) -> tuple[str, ...]:
        """What a person knows each part by."""
        when = [f"{first:.1f} to {last:.1f} s" for first, last in zip(*self.spans_s, strict=True)]
        if len(self.streams) == 1:
            return tuple(when)
        return tuple(f"{self.stream(i).name}, {text}" for i, text in enumerate(when))


def turntable_parts(
    streams: Sequence[PlatterStream],
    clipped: Booleans,
    found: Speeds,
    speeds: tuple[StatedRate, ...],
    findings: tuple[Finding, ...],
) -> TurntableParts:
    """Cut the parts to whole turns, gather what they show, and join those of one attitude.

    Parameters
    ----------
    streams : recordings with their steady parts
    clipped : (n,) bool, parts at the end of the range
    found : speeds of the parts
    speeds : as stated, zero last
    findings : what was noticed
    """
    values = np.array([rate.rate_rad_s for rate in speeds])
    every = _Cut(
        streams=streams,
        of=np.repeat(np.arange(len(streams)), [len(s.intervals) for s in streams]),
        start=np.concatenate([s.intervals.start for s in streams]),
        stop=np.concatenate([s.intervals.stop for s in streams]),
        rate=np.where(found.index == NO_SPEED, np.nan, values[found.index]),
        zero=found.zero,
    )
    every, reasons = _whole_turns(every, clipped, found.shown)
    kept = reasons == ""
    left_out = tuple((every.names[i], str(reasons[i])) for i in np.flatnonzero(~kept))
    cut = every.where(kept)
    noise = _noise(cut)
    means = cut.means
    pose, axes, force = _attitudes(cut, means)
    wander = [_wander(cut, i, means[i], noise) if cut.rate[i] else 0.0 for i in range(len(means))]
    start_s, stop_s = cut.spans_s
    begin_s = np.array([stream.begin_s for stream in streams])[cut.of]
    seconds = (cut.stop - cut.start) / np.array([s.gyroscope.rate_hz for s in streams])[cut.of]
    data = TurntableData(
        measured=means,
        variance=noise / seconds[:, None],
        speed=found.index[kept],
        rates=values,
        rate_sigmas=np.array([stated.sigma_rad_s for stated in speeds]),
        wander=np.array(wander),
        t_s=begin_s + 0.5 * (start_s + stop_s),
        pose=pose,
        force=force,
        axes=axes,
    )
    return TurntableParts(
        data=data,
        names=cut.names,
        start_s=start_s,
        stop_s=stop_s,
        samples=cut.stop - cut.start,
        rates=speeds,
        noise=noise,
        left_out=left_out,
        findings=findings,
        gyroscope_unit=streams[0].gyroscope.unit,
        accelerometer_unit=streams[0].accelerometer.unit if len(streams[0].accelerometer) > 1 else None,
    )


def _whole_turns(cut: _Cut, clipped: Booleans, shown: Floats) -> tuple[_Cut, np.ndarray]:
    """Return the parts, ended so that they hold whole turns, over which wow and the earth's level rate average out.

    With them comes why a part cannot be used, (n,) text, or "".
    """
    reasons, stop = np.full(len(cut.of), "", dtype=object), cut.stop.copy()
    unknown = np.flatnonzero(np.isnan(cut.rate))
    reasons[unknown] = [f"it shows {shown[i]:.4g} rad/s, no stated speed" for i in unknown]
    reasons[clipped] = "the gyroscope is saturated"
    for i in np.flatnonzero((cut.rate > 0) & ~clipped).tolist():
        per_turn = 2 * np.pi / cut.rate[i] * cut.stream(i).gyroscope.rate_hz
        turns = int((cut.stop[i] - cut.start[i]) / per_turn)
        if turns:
            stop[i] = cut.start[i] + round(turns * per_turn)
        else:
            reasons[i] = "it is shorter than one turn"
    whole = _Cut(streams=cut.streams, of=cut.of, start=cut.start, stop=stop, rate=cut.rate, zero=cut.zero)
    return whole, reasons


def _noise(cut: _Cut) -> Floats:
    """Return the density of the gyroscope's noise, (3,) [unit^2 s]: at rest, or while turning where it never rests."""
    at_rest = cut.rate == 0 if (cut.rate == 0).any() else np.ones(len(cut.rate), dtype=bool)
    total, weight = np.zeros(3), 0.0
    for k, stream in enumerate(cut.streams):
        chosen = at_rest & (cut.of == k)
        if chosen.any():
            parts = StaticIntervals(start=cut.start[chosen], stop=cut.stop[chosen])
            samples = float(np.sum(parts.stop - parts.start))
            total += samples * resting_noise(stream.gyroscope.values, parts, stream.gyroscope.rate_hz)[0]
            weight += samples
    return total / max(weight, 1.0)


def _wander(cut: _Cut, i: int, mean: Floats, noise: Floats) -> float:
    """Return the sigma of a part's mean rate as it wanders from turn to turn [rad/s]; 0 where noise explains it."""
    rate, rate_hz = float(cut.rate[i]), cut.stream(i).gyroscope.rate_hz
    per_turn = round(2 * np.pi / rate * rate_hz)
    turns = block_means(cut.values(i), per_turn) if per_turn else np.empty((0, 3))
    if len(turns) < 3:
        return 0.0
    size = float(np.linalg.norm(mean - cut.zero))
    axis = (mean - cut.zero) / size
    by_noise = float(noise @ axis**2) / (per_turn / rate_hz)
    scatter = 0.5 * float(np.mean(np.diff(turns @ axis) ** 2)) - by_noise
    return rate / size * float(np.sqrt(max(scatter, 0.0) / len(turns)))


def _attitudes(cut: _Cut, means: Floats) -> tuple[Integers, tuple[AxisInSensor, ...], Floats | None]:
    """Return the attitude of each part (n,), and what the accelerometer showed in each attitude and in each part."""
    pose, count = np.zeros(len(means), dtype=np.int64), 0
    for k, stream in enumerate(cut.streams):
        mine = np.flatnonzero(cut.of == k)
        if not len(mine):
            continue
        length = block_samples(stream.gyroscope)
        between = [_between(stream, int(cut.stop[i]), int(cut.start[j]), length) for i, j in pairwise(mine.tolist())]
        noise = cut.values(int(mine[0])).std(axis=0) / np.sqrt(length)
        numbers = link_parts(means[mine] - cut.zero, cut.rate[mine], between, cut.zero, noise)
        pose[mine] = count + numbers
        count += int(numbers.max()) + 1
    if any(len(stream.accelerometer) < 2 for stream in cut.streams):
        return pose, (), None
    axes, force = list[AxisInSensor](), np.full((len(means), 3), np.nan)
    for number in range(count):
        parts = np.flatnonzero(pose == number)
        axis, force[parts] = _axis(cut, parts, means[parts])
        axes.append(axis)
    return pose, tuple(axes), force


def _between(stream: PlatterStream, first: int, last: int, length: int) -> Between:
    gap_s = float(np.diff(stream.t_s[first - 1 : last + 1]).max(initial=0.0))
    return Between(means=block_means(stream.gyroscope.values[first:last], length), gap_s=gap_s)


def _axis(cut: _Cut, parts: Integers, means: Floats) -> tuple[AxisInSensor, Floats]:
    """Return the platter's axis in one attitude, and the means of the accelerometer in its parts, (k, 3)."""
    stream = cut.stream(int(parts[0]))
    first, last = int(cut.start[parts[0]]), int(cut.stop[parts[-1]])
    t = stream.t_s[first:last]
    shown, angle = _turning(cut, parts, means, stream.gyroscope.values[first:last], t)
    forces, angles, rates = list[Floats](), list[Floats](), list[Floats]()
    length = max(1, round(_FORCE_BLOCK_S * stream.accelerometer.rate_hz))
    of_parts = np.full((len(parts), 3), np.nan)
    for k, i in enumerate(parts.tolist()):
        ends = stream.t_s[cut.start[i]], stream.t_s[cut.stop[i] - 1]
        a, b = np.searchsorted(stream.force_t_s, ends)
        values = stream.accelerometer.values[a : b + 1]
        if len(values) < 2 * length:
            raise RecordingError(
                f"{stream.name}: the accelerometer has no samples while the gyroscope keeps its rate, "
                f"{ends[0]:.1f} to {ends[1]:.1f} s. Both must be recorded together and stamped by one clock."
            )
        of_parts[k] = values.mean(axis=0)
        phi = np.interp(stream.force_t_s[a : b + 1], t, angle)
        forces.append(block_means(values, length))
        angles.append(block_means(phi[:, None], length)[:, 0])
        rates.append(np.full(len(forces[-1]), shown[k]))
    blocks = ForceBlocks(
        force=np.concatenate(forces),
        angle=np.concatenate(angles),
        rate=np.concatenate(rates),
        block_s=length / stream.accelerometer.rate_hz,
    )
    return axis_in_sensor(blocks), of_parts


def _turning(cut: _Cut, parts: Integers, means: Floats, values: Floats, t_s: Floats) -> tuple[Floats, Floats]:
    """Return the rate of each part [rad/s], 0 at rest, and the angle turned since the first began, (k,) [rad].

    Both by the gyroscope, which takes the fastest part for its stated speed: errors of the other speeds do not matter.
    """
    rate, angle = cut.rate[parts], np.zeros(len(t_s))
    at_rest, fastest = rate == 0, int(np.argmax(rate))
    if at_rest.all():
        return rate, angle
    offset = means[at_rest].mean(axis=0) if at_rest.any() else cut.zero
    axis = means[fastest] - offset
    axis = axis * (rate[fastest] / float(axis @ axis))
    turning = (values - offset) @ axis
    angle[1:] = np.cumsum(0.5 * (turning[1:] + turning[:-1]) * np.diff(t_s))
    return np.where(at_rest, 0.0, (means - offset) @ axis), angle
