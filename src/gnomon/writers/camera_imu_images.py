"""The images of a simulated camera -> a folder in EuRoC's layout: data.csv, and data/<stamp>.png."""

from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path

from ..images import Frame, ImageStream
from ..output import whole_folder

_WORKERS, _AHEAD = 2, 8
_TENTHS = 10


def save_simulated_images(stream: ImageStream, place: Path, progress: Callable[[str], None] | None = None) -> Path:
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
            for number, (t_ns, png) in enumerate(_encoded(stream.frames([]))):
                if number % every == 0:
                    tell(f"rendering {place.name}: image {number + 1} of {stream.count}")
                (folder / "data" / f"{t_ns}.png").write_bytes(png)
                table.write(f"{t_ns},{t_ns}.png\n")
    return place / "data.csv"


def _encoded(frames: Iterator[Frame]) -> Iterator[tuple[int, bytes]]:
    """Yield the stamp and the PNG of each frame."""
    waiting: deque[tuple[int, Future[bytes]]] = deque()
    with ThreadPoolExecutor(_WORKERS) as pool:
        for frame in frames:
            waiting.append((frame.t_ns, pool.submit(_png, frame)))
            if len(waiting) >= _AHEAD:
                t_ns, result = waiting.popleft()
                yield t_ns, result.result()
        for t_ns, result in waiting:
            yield t_ns, result.result()


def _png(frame: Frame) -> bytes:
    import cv2

    # Of the strategies that lose nothing the fastest by far, and for grey images the smallest, too.
    how = [cv2.IMWRITE_PNG_COMPRESSION, 1, cv2.IMWRITE_PNG_STRATEGY, cv2.IMWRITE_PNG_STRATEGY_HUFFMAN_ONLY]
    return cv2.imencode(".png", frame.decode(), how)[1].tobytes()
