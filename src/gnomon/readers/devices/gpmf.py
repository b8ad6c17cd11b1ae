"""Format "GPMF": the telemetry of GoPro cameras, in their MP4 files or cut out of them, as an IMU's samples.

The camera stores samples in payloads of about a second, whose limits jitter by some samples, while the sensor samples
evenly, at a rate of its own that drifts slowly. So timestamps are not spread payload by payload: one clock is fitted to
all beginnings, with a rate that may change from minute to minute.
"""

import hashlib
from pathlib import Path

import numpy as np

from ...errors import RecordingError
from ...frozen import value_class
from ...recording import Floats, Integers, Source, TemperatureSamples, measurable_numbers
from ..files import file_source, is_mp4_head
from ..samples.column_names import unit_of
from ..samples.table import Triad
from .device_log import GPMF_MAGIC, DeviceLog, StampedTriad, file_head
from .gpmf_streams import Device, PayloadBlock, Telemetry, in_camera_axes

_LARGEST_BYTES = 1 << 30
_SENSORS = {"ACCL": "accelerometer", "GYRO": "gyroscope", "MAGN": "magnetometer"}
_ADVICE = "Telemetry is in files as the camera wrote them: copy the original MP4, not one that was cut, edited or sent."

# ---- when the samples were taken ----

NOMINAL_PAYLOAD_S = 1.001  # of 30, 60, ... frames at 29.97 frames/s
_KNOT_S = 60.0
_OUTLYING = 5.0
_FEW = 8


@value_class
class PayloadTimes:
    """When the payloads begin, as the container says; none of a raw stream.

    Attributes
    ----------
    start_s : (k,) [s]
    duration_s : (k,) [s]
    """

    start_s: Floats
    duration_s: Floats


@value_class
class Clock:
    """Timestamps of all samples of a stream.

    Attributes
    ----------
    t_ns : (n,) [ns]
    rate_hz : mean rate
    stray_s : by which the farthest beginning of a payload is off that clock [s]
    stamped : whether they come from the camera's timestamps; else from the times of payloads
    lost : samples between payloads that the counts say are missing
    """

    t_ns: Integers
    rate_hz: float
    stray_s: float
    stamped: bool
    lost: int


def sample_clock(blocks: tuple[PayloadBlock, ...], times: PayloadTimes | None, origin_s: float) -> Clock:
    """Fit the clock of a stream.

    Parameters
    ----------
    blocks : its samples; at least one block
    times : of the payloads, or None of a raw stream
    origin_s : where the time begins in the camera's clock of timestamps [s]

    Raises
    ------
    RecordingError
        If the timestamps do not rise.
    """
    key = blocks[0].key
    counts = np.array([len(block.values) for block in blocks])
    first, lost = _first_samples(blocks, counts)
    stamps = [block.stamp_us for block in blocks]
    stamped = None not in stamps and bool((np.diff(np.array(stamps, dtype=np.float64)) > 0).all())
    if stamped:
        at = np.array(stamps, dtype=np.float64) * 1e-6 - origin_s
        index, at = _with_end(first, at, counts, _last_s(blocks, times) if len(blocks) == 1 else None)
    elif times is not None:
        at = np.array([times.start_s[block.payload] for block in blocks])
        index, at = _with_end(first, at, counts, _last_s(blocks, times))
    else:
        at = np.array([block.payload * NOMINAL_PAYLOAD_S for block in blocks])
        index, at = _with_end(first, at, counts, NOMINAL_PAYLOAD_S if len(blocks) < 3 else None)
    samples = np.concatenate([begin + np.arange(count) for begin, count in zip(first, counts, strict=True)])
    t_s, stray_s = _fitted(index.astype(np.float64), at, samples.astype(np.float64))
    span = float(t_s[-1] - t_s[0])
    if not (np.isfinite(t_s).all() and np.abs(t_s).max() < 9e9 and (np.diff(t_s) > 0).all()):
        raise RecordingError(f"{key}: the times of its payloads do not rise.")
    return Clock(
        t_ns=np.rint(t_s * 1e9).astype(np.int64),
        rate_hz=float(samples[-1] - samples[0]) / span if span > 0 else float("nan"),
        stray_s=stray_s,
        stamped=stamped,
        lost=lost,
    )


def _first_samples(blocks: tuple[PayloadBlock, ...], counts: Integers) -> tuple[Integers, int]:
    """Return the number of the first sample of each block, and how many samples are missing between blocks.

    The camera's count is taken where it fits: blocks do not overlap in it.
    """
    running = np.cumsum(counts) - counts
    totals = [block.total for block in blocks]
    if None in totals:
        return running, 0
    counted = np.array(totals, dtype=np.int64) - counts
    missing = np.diff(counted) - counts[:-1]
    if (missing < 0).any():
        return running, 0
    return counted - counted[0], int(missing.sum())


def _last_s(blocks: tuple[PayloadBlock, ...], times: PayloadTimes | None) -> float:
    """Return how long the last payload lasts [s]."""
    duration = NOMINAL_PAYLOAD_S if times is None else float(times.duration_s[blocks[-1].payload])
    return duration if duration > 0 else NOMINAL_PAYLOAD_S


def _with_end(first: Integers, at: Floats, counts: Integers, last_s: float | None) -> tuple[Integers, Floats]:
    """Return the beginnings of payloads, and the end of the last one where that is known."""
    if last_s is None:
        return first, at
    return np.append(first, first[-1] + counts[-1]), np.append(at, at[-1] + last_s)


def _fitted(index: Floats, at: Floats, samples: Floats) -> tuple[Floats, float]:
    """Return the times of samples, and how far the farthest beginning strays, both in seconds.

    A line, or for longer recordings lines that meet at knots a minute apart; single payloads that are off are left out.
    """
    knots = np.linspace(index[0], index[-1], max(2, 1 + min(round(np.ptp(at) / _KNOT_S), len(index) // _FEW)))
    kept = np.ones(len(index), bool)
    coefficients = np.zeros(len(knots))
    for _ in range(3):
        coefficients = np.linalg.lstsq(_hats(index[kept], knots), at[kept], rcond=None)[0]
        off = np.abs(at - _hats(index, knots) @ coefficients)
        limit = _OUTLYING * 1.5 * float(np.median(off)) + 1e-6
        if (off[kept] <= limit).all() or int((off <= limit).sum()) < max(len(knots) + 1, len(index) // 2):
            break
        kept = off <= limit
    times = _hats(samples, knots) @ coefficients
    return times, float(np.abs(at - _hats(index, knots) @ coefficients)[kept].max())


def _hats(index: Floats, knots: Floats) -> Floats:
    """Return the weights of the values at knots in a line from knot to knot, (n, knots); beyond them it goes on."""
    step = knots[1] - knots[0]
    left = np.clip(np.floor((index - knots[0]) / step), 0, len(knots) - 2).astype(np.int64)
    part = (index - knots[left]) / step
    weights = np.zeros((len(index), len(knots)))
    rows = np.arange(len(index))
    weights[rows, left], weights[rows, left + 1] = 1 - part, part
    return weights


_STABILISED_RAD = np.radians(0.2)


def notes_on_clock(clock: Clock, blocks: tuple[PayloadBlock, ...], sensor: str, name: str, *, timed: bool) -> list[str]:
    """Say where the timestamps of a triad come from, how well they are known, and how warm the sensor was.

    Parameters
    ----------
    clock, blocks : of the triad
    sensor, name : the triad and the file, for the sentences
    timed : whether the container states the times of payloads
    """
    count = len(blocks)
    stray = f" (largest deviation {1e3 * clock.stray_s:.2g} ms)" if count > 2 else ""
    if clock.stamped and count > 1:
        how = f"an even clock through the camera's timestamps of {count} payloads{stray}"
    elif timed:
        how = f"spread evenly over {count} payloads of the video, whose samples have no timestamps{stray}"
    else:
        how = f"as if each payload took {NOMINAL_PAYLOAD_S:g} s, which nothing states: off by 1 % or so{stray}"
    notes = [f"{name}: {sensor} at {clock.rate_hz:.5g} Hz, {how}."]
    if clock.lost:
        notes.append(f"{name}: {clock.lost} samples of the {sensor} are missing between payloads, as its count says.")
    degrees = np.array([block.temperature for block in blocks])
    if sensor == "gyroscope" and np.isfinite(degrees).any():
        low, high = float(np.nanmin(degrees)), float(np.nanmax(degrees))
        notes.append(f"{name}: its sensor was at {low:.1f} to {high:.1f} degrees Celsius.")
    return notes


def notes_on_video(device: Device, name: str, *, video: bool) -> list[str]:
    """Say what matters for the images: electronic stabilisation, and the time to read out the sensor."""
    notes: list[str] = []
    turned = [block.values for block in device.of("IORI") if block.values.shape[1] == 4]
    if video and turned:  # quaternions of the image to the body, the real part first
        vector = np.linalg.norm(np.concatenate(turned)[:, 1:], axis=1)
        angle = float(2 * np.arcsin(np.clip(vector.max(), 0, 1)))
        if angle > _STABILISED_RAD:
            notes.append(
                f"{name}: the images were turned by up to {np.degrees(angle):.1f} degrees against the camera (IORI): "
                "stabilisation (HyperSmooth) was on. Images like that fit no IMU; switch it off to calibrate a camera."
            )
    read_out = device.of("SROT")
    if video and read_out:
        ms = float(np.median(np.concatenate([block.values.ravel() for block in read_out])))
        notes.append(f"{name}: rolling shutter; the camera states {ms:.3g} ms to read out the sensor (SROT).")
    return notes


# ---- the recording ----


def has_gpmf(path: Path) -> bool:
    """Tell whether a video holds telemetry of a GoPro."""
    return is_mp4_head(file_head(path, 16)) and bool(_payloads(path, most=1)[0])


def read_gpmf(path: Path) -> DeviceLog:
    """Read the accelerometer and the gyroscope of a GoPro camera, in m/s^2 and rad/s.

    Both are along the axes that GoPro labels x, y, z: seen from behind the camera x points to the left, y out of its
    back towards the viewer, z up. Timestamps of an MP4 are those of its video.

    Raises
    ------
    RecordingError
        If there is no telemetry, it holds no accelerometer or no gyroscope, or it is damaged.
    """
    try:
        return _read(path)
    except RecordingError as error:
        text = str(error)
        named = text.startswith((path.name, str(path)))
        raise RecordingError(text if named else f"{path.name}: {text}") from None


def _read(path: Path) -> DeviceLog:
    telemetry, times, source = _telemetry(path)
    reading = _Reading(path.name, telemetry, times)
    accelerometer, gyroscope = reading.triad("ACCL"), reading.triad("GYRO")
    return DeviceLog(
        accelerometer=accelerometer,
        gyroscope=gyroscope,
        magnetometer=reading.triad("MAGN") if reading.device.of("MAGN") else None,
        temperature=reading.temperature(),
        sources=(source,),
        notes=tuple(reading.notes + notes_on_video(reading.device, path.name, video=times is not None)),
    )


# ---- the file ----


def _telemetry(path: Path) -> tuple[Telemetry, PayloadTimes | None, Source]:
    telemetry = Telemetry()
    if file_head(path, 16).startswith(GPMF_MAGIC):
        if path.stat().st_size > _LARGEST_BYTES:
            raise RecordingError(f"{path.name}: raw telemetry of more than {_LARGEST_BYTES >> 30} GiB is not read.")
        data = path.read_bytes()
        telemetry.add(data)
        return telemetry, None, Source(name=path.name, sha256=hashlib.sha256(data).hexdigest())
    payloads, times = _payloads(path)
    if not payloads:
        raise RecordingError(f"{path.name}: this video holds no telemetry (GPMF) of a GoPro camera. {_ADVICE}")
    for number, data in enumerate(payloads):
        telemetry.add(data, number)
    return telemetry, times, file_source(path)


def _payloads(path: Path, most: int | None = None) -> tuple[list[bytes], PayloadTimes]:
    """Return the payloads of the track of telemetry in an MP4, at most so many, and their times."""
    import av
    from av.error import FFmpegError

    from ..images.video import cannot_open

    payloads: list[bytes] = []
    spans: list[tuple[float, float]] = []
    track, size = None, 0
    try:
        with av.open(str(path)) as container:
            tracks = [stream for stream in container.streams if stream.type == "data"]
            for stream in container.streams:  # spare reading the images, where PyAV can
                if stream.type != "data" and hasattr(stream, "discard"):
                    stream.discard = type(stream.discard).all
            for packet in container.demux(tracks) if tracks else ():
                data = bytes(packet)
                if not data.startswith(GPMF_MAGIC) or track not in {None, packet.stream_index}:
                    continue
                track, size = packet.stream_index, size + len(data)
                base = float(packet.time_base or 0)
                payloads.append(data)
                spans.append(((packet.pts or 0) * base, (packet.duration or 0) * base))
                if len(payloads) == most or size > _LARGEST_BYTES:
                    break
    except (FFmpegError, OSError, ValueError) as error:
        if not payloads:
            raise cannot_open(path, path.name, error) from None
    both = np.array(spans, dtype=np.float64).reshape(-1, 2)
    return payloads, PayloadTimes(start_s=both[:, 0], duration_s=both[:, 1])


# ---- the device and its streams ----


class _Reading:
    """The camera's streams on the way to samples.

    Parameters
    ----------
    name : of the file, for messages
    telemetry, times : what is in it; times of its payloads, or None of a raw stream
    """

    def __init__(self, name: str, telemetry: Telemetry, times: PayloadTimes | None) -> None:
        self.name, self.times = name, times
        self.notes: list[str] = []
        if telemetry.cut:
            self.note("the telemetry is cut off or damaged in places; what is whole was used.")
        self.device = self._camera(telemetry)
        self._origin_s = self._origin()
        self._orientation = self._one_orientation()

    def note(self, text: str) -> None:
        self.notes.append(f"{self.name}: {text}")

    def _camera(self, telemetry: Telemetry) -> Device:
        """Return the device that has both triads."""
        devices = telemetry.devices()
        found = next((device for device in devices if device.of("ACCL") and device.of("GYRO")), None)
        if found is None:
            inside = ", ".join(sorted({block.key for device in devices for block in device.blocks})) or "nothing of it"
            raise RecordingError(
                f"{self.name}: the telemetry holds no accelerometer (ACCL) with a gyroscope (GYRO); found {inside}. "
                "HERO5 and later cameras write both in their ordinary video modes."
            )
        others = [device.name or "one without name" for device in devices if device is not found]
        if others:
            self.note(f"of several devices {found.name or 'the first'} was taken, not {', '.join(others)}.")
        return found

    def _origin(self) -> float:
        """Return where the recording begins in the clock of the camera's timestamps [s]; zero where nothing tells.

        A payload of an MP4 begins with a frame of the video, whose streams (CORI, SHUT) state its timestamp; a raw
        stream begins with its first sample.
        """
        for key in ("CORI", "SHUT", "ACCL") if self.times is not None else ("ACCL",):
            blocks = [block for block in self.device.of(key) if block.stamp_us is not None]
            if blocks:
                start = self.times.start_s if self.times is not None else None
                offsets = [
                    int(block.stamp_us or 0) * 1e-6
                    - (block.payload * NOMINAL_PAYLOAD_S if start is None else float(start[block.payload]))
                    for block in blocks
                ]
                return float(np.median(offsets)) if start is not None else offsets[0]
        return 0.0

    def _one_orientation(self) -> str:
        """Return the axes of both triads as they are stored; "" where that is not known or cannot be."""
        stored = {b.orientation for key in ("ACCL", "GYRO") for b in self.device.of(key) if b.orientation}
        if len(stored) != 1:
            self.note("nothing says clearly how the axes are ordered; x, y, z are the components as they come.")
            return ""
        (orientation,) = stored
        if np.linalg.det(in_camera_axes(np.eye(3), orientation)) < 0:
            self.note(f"axes stored as {orientation} would be left-handed; x, y, z are the components as they come.")
            return ""
        self.note(f"axes as GoPro labels them, x left, y back, z up (stored as {orientation}).")
        return orientation

    def triad(self, key: str) -> StampedTriad | None:
        """Return the samples of a sensor with their timestamps; None of a magnetometer of unknown components."""
        blocks, sensor = self.device.of(key), _SENSORS[key]
        components = sorted({block.values.shape[1] for block in blocks})
        if components != [3]:
            if key == "MAGN":  # four in some models, of which the documentation does not tell what they are
                self.note(f"the magnetometer has {components[-1]} components and was left out.")
                return None
            raise RecordingError(f"{self.name}: the {sensor} must have three components; found {components}.")
        clock = sample_clock(blocks, self.times, self._origin_s)
        values = np.concatenate([block.values for block in blocks])
        if key == "MAGN":
            self.note("how the axes of the magnetometer lie to those of the IMU is not stated.")
        else:
            self.notes += notes_on_clock(clock, blocks, sensor, self.name, timed=self.times is not None)
            values = in_camera_axes(values, self._orientation) if self._orientation else values
        good = measurable_numbers(values).all(axis=1)
        if not good.all():
            self.note(f"{int((~good).sum())} samples of the {sensor} are no numbers and were left out.")
        if int(good.sum()) < 2:
            raise RecordingError(f"{self.name}: found {int(good.sum())} samples of the {sensor}; a recording has many.")
        unit = self._unit(blocks, sensor)
        return clock.t_ns[good], Triad(quantity=sensor, values=values[good], unit=unit)

    def temperature(self) -> TemperatureSamples | None:
        """Return the gyroscope's temperature, once a payload, at the middle of it; None where it is not stated."""
        blocks = self.device.of("GYRO")
        celsius = np.array([block.temperature for block in blocks])
        known = np.isfinite(celsius)
        if not known.any():
            return None
        counts = np.array([len(block.values) for block in blocks])
        middle = np.cumsum(counts) - (counts + 1) // 2
        t_ns = sample_clock(blocks, self.times, self._origin_s).t_ns[middle]
        return TemperatureSamples(t_ns=t_ns[known], values=celsius[known], unit="degC")

    def _unit(self, blocks: tuple[PayloadBlock, ...], sensor: str) -> str | None:
        """Return the unit as the file states it, or None."""
        written = {block.unit for block in blocks}
        units = {unit_of(text, sensor) for text in written}
        if written != {""} and (len(units) > 1 or None in units):
            listed = ", ".join(sorted(written))
            raise RecordingError(
                f'{self.name}: the {sensor} is in "{listed}", which is not one unit that gnomon knows.'
            )
        return units.pop()
