"""Images -> PNG files, a few of them encoded at the same time."""

from collections.abc import Iterable, Iterator
from pathlib import Path

from ..ahead import results_ahead
from ..errors import RecordingError
from ..output import whole_folder
from ..progress import Progress, Step
from ..recording.images import Frame, ImageStream


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
