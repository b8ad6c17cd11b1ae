"""The images of one camera as a video: anything that PyAV opens, frame by frame, at the times that the video states."""

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import Any

import av
import numpy as np
from av.container import InputContainer
from av.error import FFmpegError

from ...errors import RecordingError
from ...frozen import value_class
from ...recording import Integers
from ...recording.recording import Frame, Grey, ImageStream
from ..files import file_source, is_mp4_head
from ..recordings import ReadLog
from .frame_stamps import FrameTable, read_frame_table
from .image_files import CameraPlace

_MOST_PIXELS = 1 << 26  # twice those of 8K
_HEAD = 4096
_LUMA_FIRST = {"gray", "nv12", "nv21", "nv16", "nv24", "yuva420p", "yuva422p", "yuva444p"} | {
    f"yuv{full}{sampling}p" for full in ("", "j") for sampling in (410, 411, 420, 422, 440, 444)
}
"""Pixel formats whose first plane is the luma in 8 bits."""
_MUCH_S = 0.5  # a video that ends this much earlier than it says was cut off


@value_class(eq=True)
class _Facts:
    """What a video says of itself.

    Attributes
    ----------
    pts : (n,) times of its packets, each of one frame, ascending; empty where the file states none
    packets : their number
    stated_frames : how many there should be, or zero
    stated_s : how long it should last, or zero
    step : usual time from frame to frame [s], or None
    rotation : by which it is to be shown turned [deg]
    size : width, height [px]
    """

    pts: Integers
    packets: int
    stated_frames: int
    stated_s: float
    step: Fraction | None
    rotation: int
    size: tuple[int, int]


def video_stream(name: str, place: CameraPlace, log: ReadLog) -> ImageStream:
    """Return the stream of the frames of a video, in the order in which they are shown.

    Timestamps come from a table beside it with a row a frame, or are those of the video, which mostly count from its
    beginning: unless the video holds its telemetry, their clock has nothing to do with that of an IMU.

    Parameters
    ----------
    name : "cam0", "cam1", ...
    place : the video and the table of its timestamps
    log : what was stated; the files that are read, and sentences on what was assumed, are added

    Raises
    ------
    RecordingError
        If it cannot be opened, has no frames, or the table has not as many rows as the video has frames.
    """
    path = place.video
    assert path is not None
    facts = _facts(path, place.label)
    if facts.rotation % 360:
        log.note(
            f"{place.label}: it is to be shown turned by {facts.rotation % 360} degrees, which was not done: the "
            f"images are used as the sensor recorded them, {facts.size[0]} x {facts.size[1]} px."
        )
    table = None
    if place.table is not None:
        table = read_frame_table(place.table, (), log.units.time)
        log.sources.append(replace(table.source, name=f"{name}/{table.source.name}"))
        log.notes.extend(table.notes)
        _check_rows(table, facts, place)
    else:
        log.note(
            f"{place.label}: the frames have the times of the video; the shift to the clock of the IMU is searched for."
        )
    log.sources.append(file_source(path))
    stamps = None if table is None else table.t_ns
    return ImageStream(frames=partial(_frames, path, place.label, facts, stamps), count=facts.packets)


def _check_rows(table: FrameTable, facts: _Facts, place: CameraPlace) -> None:
    rows = len(table.t_ns)
    whole = max(facts.packets, facts.stated_frames)
    if rows not in {facts.packets, whole}:
        raise RecordingError(
            f"{table.source.name}: found {rows} timestamps for the {facts.packets} frames of {place.label}; each frame "
            "needs one, in the order in which they are shown. Which frames were dropped cannot be known."
        )


def _opened(path: Path, label: str) -> InputContainer:
    try:
        container = av.open(str(path))
    except (FFmpegError, OSError, ValueError) as error:
        raise cannot_open(path, label, error) from None
    if not container.streams.video:
        container.close()
        raise RecordingError(f"{label}: there are no images in this video file.")
    width, height = container.streams.video[0].width, container.streams.video[0].height
    if width * height > _MOST_PIXELS:
        container.close()
        raise RecordingError(
            f"{label}: its frames are said to have {width} x {height} pixels, more than any video camera has. Was it "
            "copied completely?"
        )
    return container


def cannot_open(path: Path, label: str, error: Exception) -> RecordingError:
    """Return what to say of a video that FFmpeg does not open."""
    with path.open("rb") as file:
        head = file.read(_HEAD)
    if is_mp4_head(head):
        return RecordingError(
            f"{label}: the video is cut off or damaged: its index, which mostly stands at the end, is missing. "
            "Copy it again, or repair it from a whole video of the same device."
        )
    return RecordingError(f"{label}: the video cannot be opened ({_said(error)}).")


def _said(error: Exception) -> str:
    return str(getattr(error, "strerror", None) or error)


def _facts(path: Path, label: str) -> _Facts:
    """Look at the packets of the video, which is fast, and at its first frame."""
    packets = 0
    times: list[int] = []
    with _opened(path, label) as container:
        stream = container.streams.video[0]
        rate = stream.average_rate or stream.guessed_rate
        stated, lasts = stream.frames, (container.duration or 0) / av.time_base
        with suppress(FFmpegError):  # the frames say what is wrong, when they are read
            for packet in container.demux(stream):
                packets += packet.size > 0
                if packet.size > 0 and packet.pts is not None:
                    times.append(packet.pts)
    step = Fraction(1) / rate if rate else None
    first = next(_decoded(path, label, []), None)
    if first is None:
        raise RecordingError(f"{label}: not one image of this video can be read. Was it copied completely?")
    pts = np.unique(np.array(times, dtype=np.int64))
    return _Facts(
        pts=pts if len(pts) == packets else np.empty(0, np.int64),
        packets=packets,
        stated_frames=stated,
        stated_s=lasts,
        step=step,
        rotation=int(getattr(first, "rotation", 0) or 0),
        size=(first.width, first.height),
    )


def _frames(path: Path, label: str, facts: _Facts, stamps: Integers | None, notes: list[str]) -> Iterator[Frame]:
    """Yield the frames of a video that can be decoded, at least in part."""
    shown, backward, last, whole, end_s = 0, 0, None, True, 0.0
    for frame in _decoded(path, label, notes):
        index, shown = _index(frame, shown, facts), shown + 1
        if stamps is not None and index >= len(stamps):
            break
        t_ns = _stamp(frame, index, facts, label) if stamps is None else int(stamps[index])
        if last is not None and t_ns <= last:
            backward += 1
            continue
        last, end_s = t_ns, frame.time or 0.0
        # What is damaged spreads to all frames that are told by their differences, until a whole one comes.
        whole = not frame.is_corrupt and (whole or bool(frame.key_frame))
        where = f"{label}, frame {index}"
        yield Frame(t_ns=t_ns, where=where, decode=partial(_grey, frame, where, whole=whole))
    if backward:
        notes.append(f"{label}: the time does not rise at {backward} of {shown} frames, which were left out.")
    if facts.stated_frames > shown and (facts.stated_frames - shown) * float(facts.step or 1) > _MUCH_S:
        notes.append(
            f"{label}: found {shown} of the {facts.stated_frames} frames that the video should have; it was cut off or "
            "damaged. What is there was used."
        )
    elif not facts.stated_frames and facts.stated_s > end_s + _MUCH_S + 3 * float(facts.step or 0):
        notes.append(
            f"{label}: the video ends after {end_s:.1f} s, but should last {facts.stated_s:.1f} s; it was cut off. "
            "What is there was used."
        )


def _index(frame: av.VideoFrame, shown: int, facts: _Facts) -> int:
    """Return the number of a frame in the video, also where others before it could not be decoded."""
    return int(np.searchsorted(facts.pts, frame.pts)) if len(facts.pts) and frame.pts is not None else shown


def _decoded(path: Path, label: str, notes: list[str]) -> Iterator[av.VideoFrame]:
    """Yield the frames as the decoder gives them; what it cannot decode is passed over with a note."""
    broken = 0
    with _opened(path, label) as container:
        stream = container.streams.video[0]
        stream.thread_type = "AUTO"
        packets = container.demux(stream)
        while True:
            try:
                packet = next(packets, None)
            except FFmpegError as error:
                notes.append(f"{label}: the file is damaged ({_said(error)}); what comes before was used.")
                break
            if packet is None:
                break
            try:
                yield from packet.decode()
            except FFmpegError:
                broken += 1
    if broken:
        said = "1 frame is damaged and was" if broken == 1 else f"{broken} frames are damaged and were"
        notes.append(f"{label}: {said} left out.")


def _stamp(frame: av.VideoFrame, index: int, facts: _Facts, label: str) -> int:
    """Return the time at which a frame is shown [ns]."""
    if frame.pts is not None and frame.time_base is not None:
        return round(frame.pts * frame.time_base * 1_000_000_000)
    if facts.step is None:
        raise RecordingError(
            f"{label}: the video says neither when its frames were taken nor their rate. Put a table of timestamps "
            f"beside it, {Path(label).stem}.csv, with a row for each frame."
        )
    return round(index * facts.step * 1_000_000_000)


def _grey(frame: av.VideoFrame, where: str, *, whole: bool) -> Grey:
    """Return the luma of a frame; that of most videos needs no conversion."""
    if not whole:
        raise RecordingError(f"{where}: the image is damaged.")
    if frame.format.name in _LUMA_FIRST:
        plane: Any = frame.planes[0]
        if plane.line_size >= frame.width:
            rows = np.frombuffer(plane, np.uint8).reshape(-1, plane.line_size)
            return np.ascontiguousarray(rows[: frame.height, : frame.width])
    try:
        return frame.to_ndarray(format="gray").astype(np.uint8, copy=False)
    except (FFmpegError, ValueError) as error:
        raise RecordingError(
            f"{where}: pixels in the format {frame.format.name} cannot be made grey ({_said(error)})."
        ) from None
