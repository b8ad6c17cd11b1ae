"""Images -> a video whose frames have their own times, by PyAV.

Images -> PNG files, a few of them encoded at the same time.
"""

from collections.abc import Iterable, Iterator
from fractions import Fraction
from os import PathLike
from pathlib import Path
from typing import Any

import av
from av.codec.codec import UnknownCodecError
from av.error import FFmpegError

from ..errors import OptionError, OutputError, RecordingError
from ..output import atomic_file, whole_folder
from ..processes import results_ahead
from ..progress import Progress, Step
from ..recording import Integers
from ..recording.frames import Frame, Grey, ImageStream


def encode_frames(frames: Iterable[Frame]) -> Iterator[tuple[int, bytes | RecordingError]]:
    """Yield the timestamp [ns] and the PNG of each frame, or what is wrong with it; none is kept."""
    return results_ahead(lambda frame: (frame.t_ns, _png(frame)), frames)


def _png(frame: Frame) -> bytes | RecordingError:
    import cv2

    try:
        image = frame.decode()
    except RecordingError as error:
        return error
    # Of the strategies that lose nothing the fastest by far, and for grey images the smallest, too.
    how = [cv2.IMWRITE_PNG_COMPRESSION, 1, cv2.IMWRITE_PNG_STRATEGY, cv2.IMWRITE_PNG_STRATEGY_HUFFMAN_ONLY]
    return cv2.imencode(".png", image, how)[1].tobytes()


_TENTHS = 10


def save_simulated_images(stream: ImageStream, place: Path, progress: Progress | None = None) -> Path:
    """Write the images of a camera into a folder that is not there yet, and return their table.

    Parameters
    ----------
    stream : the images; a few of them are rendered at the same time, and none is kept
    place : the folder, named after the camera
    progress : called with a sentence now and then

    Raises
    ------
    OutputError
        If the folder is not empty, or cannot be written.
    """
    tell = progress or (lambda _: None)
    every = max(1, stream.count // _TENTHS)
    with whole_folder(place) as folder:
        (folder / "data").mkdir()
        with (folder / "data.csv").open("w", encoding="ascii", newline="") as table:
            table.write("#timestamp [ns],filename\n")
            for number, (t_ns, png) in enumerate(encode_frames(stream.frames([]))):
                if number % every == 0:
                    tell(Step(f"rendering images of {place.name}", number + 1, stream.count))
                if isinstance(png, RecordingError):
                    raise png
                (folder / "data" / f"{t_ns}.png").write_bytes(png)
                table.write(f"{t_ns},{t_ns}.png\n")
    return place / "data.csv"


_TICK = Fraction(1, 60_000)
"""MPEG-4 has no more than 65535 ticks in a second; Matroska rounds to 1 ms."""
_FORMATS = {"mp4": "mp4", "mov": "mov", "mkv": "matroska", "avi": "avi"}
_FIXED = {"avi"}
"""Containers that have a frame rate, and no times."""


def save_video(
    path: str | PathLike[str], images: Iterable[Grey], t_ns: Integers, *, codec: str = "mpeg4", rate_hz: float = 15.0
) -> int:
    """Write images as a video; Matroska and MP4 keep the times of the frames, AVI has only a rate.

    Parameters
    ----------
    path : its suffix, .mp4, .mov, .mkv or .avi, says the container
    images : (height, width) in 8 bits of grey, all of one size
    t_ns : (n,) timestamps, ascending, counted from the first [ns]
    codec : of PyAV, such as "mpeg4", "mjpeg", or "ffv1", which loses nothing
    rate_hz : what the container states as its frame rate

    Returns
    -------
    count : of the frames that were written

    Raises
    ------
    OptionError
        If the suffix is of no container that is known.
    OutputError
        If the file cannot be written.
    """
    suffix = str(path).rpartition(".")[2].lower()
    if suffix not in _FORMATS:
        raise OptionError(f"{path}: a video is written as .{', .'.join(_FORMATS)}; found .{suffix}.")
    rate = Fraction(rate_hz).limit_denominator(1001)
    tick = 1 / rate if suffix in _FIXED else _TICK
    lossless = codec == "ffv1"
    layout = "gray" if lossless else "yuvj420p" if codec == "mjpeg" else "yuv420p"
    count = 0
    try:
        with atomic_file(path) as file, av.open(file, "w", format=_FORMATS[suffix]) as container:
            stream: Any = container.add_stream(codec, rate=rate)
            stream.pix_fmt = layout
            if not lossless:
                stream.bit_rate = 4_000_000
            stream.codec_context.time_base = stream.time_base = tick
            for stamp, image in zip((t_ns - t_ns[0]).tolist(), images, strict=False):
                if count == 0:
                    stream.height, stream.width = image.shape
                frame = av.VideoFrame.from_ndarray(image, format="gray").reformat(format=layout)
                frame.pts = count if suffix in _FIXED else round(stamp * 1e-9 / tick)
                frame.time_base = tick
                container.mux(stream.encode(frame))
                count += 1
            container.mux(stream.encode(None))
    except UnknownCodecError:
        raise OptionError(f"{path}: PyAV has no codec {codec}.") from None
    except FFmpegError as error:
        raise OutputError(f"{path}: the video cannot be written ({error.strerror or error}).") from None
    return count
