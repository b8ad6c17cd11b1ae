"""A recording with those of its frames that are asked for, as images or as corners."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import islice

import numpy as np

from ...errors import RecordingError
from ...options import FrameSelection
from ...recording import Recording
from ...recording.frames import Frame, ImageStream
from ...recording.recording import ImageRecording

_AHEAD = 0.25  # of the time between two images that are taken: timestamps stray round its multiples


def select_images(images: ImageRecording, selection: FrameSelection) -> ImageRecording:
    """Return a recording with the images that are asked for; the samples of its IMUs stay.

    Raises
    ------
    RecordingError
        If a camera has none.
    """
    if selection == FrameSelection():
        return images
    heads = [frame.t_ns for stream in images.streams.values() for frame in islice(stream.frames([]), 1)]
    first_ns = min(heads, default=0)
    streams = {name: _selected(name, stream, selection, first_ns) for name, stream in images.streams.items()}
    return replace(images, streams=streams, assumptions=(*images.assumptions, _told(selection)))


def select_frames(recording: Recording, selection: FrameSelection) -> Recording:
    """Return a recording of corners with the frames that are asked for; see `select_images`."""
    first_ns = min((int(frames.t_ns[0]) for frames in recording.cameras.values() if len(frames.t_ns)), default=0)
    cameras = {}
    for name, frames in recording.cameras.items():
        taken = _taken(selection, first_ns)
        kept = np.array([taken(int(t_ns)) for t_ns in frames.t_ns], dtype=bool)
        if not kept.any():
            raise _none_left(name, selection)
        cameras[name] = frames.where(kept)
    return replace(recording, cameras=cameras, assumptions=(*recording.assumptions, _told(selection)))


def _selected(name: str, stream: ImageStream, selection: FrameSelection, first_ns: int) -> ImageStream:
    def frames(notes: list[str]) -> Iterator[Frame]:
        taken = _taken(selection, first_ns)
        return (frame for frame in stream.frames(notes) if taken(frame.t_ns))

    known = (frame.t_ns for frame in stream.frames([])) if stream.arrivals is None else stream.arrivals.t_ns
    taken = _taken(selection, first_ns)
    count = sum(taken(int(t_ns)) for t_ns in known)
    if not count:
        raise _none_left(name, selection)
    return replace(stream, frames=frames, count=count, selection=_words(selection))


def _taken(selection: FrameSelection, first_ns: int) -> Callable[[int], bool]:
    """Return what tells of one timestamp after the other [ns] whether its frame is taken; it is asked in their order.

    Of cameras that are triggered together the same frames are, also where one has lost some: time since the first frame
    counts, not their number.
    """
    stop_s = np.inf if selection.stop_s is None else selection.stop_s
    last = -1

    def taken(t_ns: int) -> bool:
        nonlocal last
        t_s = (t_ns - first_ns) * 1e-9
        if not selection.start_s <= t_s <= stop_s:
            return False
        if selection.frame_rate_hz is None:
            return True
        number = int((t_s - selection.start_s) * selection.frame_rate_hz + _AHEAD)
        if number == last:
            return False
        last = number
        return True

    return taken


def _told(selection: FrameSelection) -> str:
    return f"of the cameras the frames {_words(selection)} are taken, as stated."


def _none_left(name: str, selection: FrameSelection) -> RecordingError:
    return RecordingError(f"{name} has no frames {_words(selection)}, counted from the first frame of the recording.")


def _words(selection: FrameSelection) -> str:
    stop = "on" if selection.stop_s is None else f"to {selection.stop_s:g} s"
    rate = "" if selection.frame_rate_hz is None else f", {selection.frame_rate_hz:g} a second"
    return f"from {selection.start_s:g} s {stop}{rate}"
