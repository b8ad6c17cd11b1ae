"""Images -> PNG files, a few of them encoded at the same time."""

from collections import deque
from collections.abc import Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor

from ..errors import RecordingError
from ..images import Frame

_WORKERS, _AHEAD = 2, 8


def encoded(frames: Iterable[Frame]) -> Iterator[tuple[int, bytes | RecordingError]]:
    """Yield the stamp [ns] and the PNG of each frame, or what is wrong with it; none is kept."""
    waiting: deque[tuple[int, Future[bytes | RecordingError]]] = deque()
    with ThreadPoolExecutor(_WORKERS) as pool:
        for frame in frames:
            waiting.append((frame.t_ns, pool.submit(_png, frame)))
            if len(waiting) >= _AHEAD:
                t_ns, result = waiting.popleft()
                yield t_ns, result.result()
        for t_ns, result in waiting:
            yield t_ns, result.result()


def _png(frame: Frame) -> bytes | RecordingError:
    import cv2

    try:
        image = frame.decode()
    except RecordingError as error:
        return error
    # Of the strategies that lose nothing the fastest by far, and for grey images the smallest, too.
    how = [cv2.IMWRITE_PNG_COMPRESSION, 1, cv2.IMWRITE_PNG_STRATEGY, cv2.IMWRITE_PNG_STRATEGY_HUFFMAN_ONLY]
    return cv2.imencode(".png", image, how)[1].tobytes()
