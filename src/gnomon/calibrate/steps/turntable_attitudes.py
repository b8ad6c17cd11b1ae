"""Steady parts on a turntable, cut to whole turns, with what gyroscope and accelerometer show in each attitude."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from ...detect.samples.static_intervals import resting_noise
from ...detect.samples.steady import block_means, block_samples
from ...errors import RecordingError
from ...estimate.turntable.parts import (
    NO_SPEED,
    AxisInSensor,
    Between,
    ForceBlocks,
    Speeds,
    TurntableData,
    TurntableParts,
    axis_in_sensor,
    link_parts,
)
from ...findings import Finding
from ...frozen import value_class
from ...options import StatedRate
from ...recording import Floats, Integers, TriadSamples
from ...results.result import Booleans, StaticIntervals

_FORCE_BLOCK_S = 0.125


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
