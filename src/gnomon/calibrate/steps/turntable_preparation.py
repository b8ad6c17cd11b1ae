"""From recordings on a turntable to steady parts of known speed: checked, found, and given their speeds."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ...assess.checks.signals import check_signal, check_stamps
from ...assess.imu.temperature import check_temperature
from ...detect.samples.faults import repair_samples, saturated_samples
from ...detect.samples.steady import block_samples, find_steady, largest_rate
from ...errors import DetectionError, OptionError, RecordingError
from ...estimate.turntable.parts import NO_SPEED, Speeds, TurntableParts, assign_speeds
from ...findings import Finding, make_finding
from ...options import StatedRate, TurntableOptions
from ...recording import Floats, Integers, Recording, TemperatureSamples, TriadSamples
from ...recording.thermometer import temperature_course
from ...results.result import Booleans, StaticIntervals, interval_means
from ...results.temperature_dependence import TemperatureDependence
from ...units import GYROSCOPE_UNITS_RAD_S
from .temperature_while_turned import rose_and_fell, temperature_powers
from .turntable_attitudes import PlatterStream, turntable_parts

_BETWEEN_FILES_S = 60.0
_ALIKE, _ALIKE_NOISE = 0.03, 6.0  # of the fastest motion; of the noise of a block
_FEWEST_AXES = 3
_HARMLESS = {"saturation"}  # parts at the end of the range are named with their speed instead


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
