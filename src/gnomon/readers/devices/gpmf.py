"""Format "GPMF": the telemetry of GoPro cameras, in their MP4 files or cut out of them, as an IMU's samples."""

import hashlib
from pathlib import Path

import numpy as np

from ...errors import RecordingError
from ...recording import Source, TemperatureSamples, measurable_numbers
from ..files import file_source, is_mp4_head
from ..samples.column_names import unit_of
from ..samples.table import Triad
from .device_log import DeviceLog, StampedTriad
from .gpmf_clock import NOMINAL_PAYLOAD_S, PayloadTimes, notes_on_clock, notes_on_video, sample_clock
from .gpmf_streams import Device, PayloadBlock, Telemetry, in_camera_axes

_MAGIC = b"DEVC"
_LARGEST_BYTES = 1 << 30
_SENSORS = {"ACCL": "accelerometer", "GYRO": "gyroscope", "MAGN": "magnetometer"}
_ADVICE = "Telemetry is in files as the camera wrote them: copy the original MP4, not one that was cut, edited or sent."


def is_gpmf(path: Path) -> bool:
    """Tell whether a file is an MP4, which only GPMF makes an IMU's recording, or raw GPMF."""
    head = _head(path)
    return head.startswith(_MAGIC) or is_mp4_head(head)


def has_gpmf(path: Path) -> bool:
    """Tell whether a video holds telemetry of a GoPro."""
    return is_mp4_head(_head(path)) and bool(_payloads(path, most=1)[0])


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


def _head(path: Path) -> bytes:
    try:
        if not path.is_file():
            return b""
        with path.open("rb") as file:
            return file.read(16)
    except OSError:
        return b""


def _telemetry(path: Path) -> tuple[Telemetry, PayloadTimes | None, Source]:
    telemetry = Telemetry()
    if _head(path).startswith(_MAGIC):
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
                if not data.startswith(_MAGIC) or track not in {None, packet.stream_index}:
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
