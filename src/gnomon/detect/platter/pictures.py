"""Images of a turning platter -> small pictures of even exposure, all that is kept of a video."""

from collections.abc import Callable
from dataclasses import dataclass
from math import sqrt

import cv2
import numpy as np
from numpy.typing import NDArray

from ...errors import RecordingError
from ...images import ImageStream
from ...recording import Floats, frozen_array

Pictures = NDArray[np.float32]
Progress = Callable[[str], None]

_CELLS = 1200
_STEPS = 256.0  # of a grey level, that the means of cells are kept in
_MOST_FRAMES = 20_000
_STILL_SHARE = 0.5  # of the cells, which vary least, tell the exposure
_SAY_EVERY = 300


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PictureSeries:
    """A video as grey means over cells of its images.

    Attributes
    ----------
    t_s : (n,) timestamps, counted from the first [s]
    cells : (n, rows * cols) grey levels, exposure evened out
    shape : rows, cols
    notes : sentences on what could not be read
    """

    t_s: Floats
    cells: Pictures
    shape: tuple[int, int]
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "t_s", frozen_array(self.t_s))


def read_pictures(stream: ImageStream, progress: Progress | None = None) -> PictureSeries:
    """Reduce the images of a stream to some thousand grey means each.

    Raises
    ------
    RecordingError
        If fewer than two images can be decoded.
    """
    notes: list[str] = []
    t_ns: list[int] = []
    rows: list[NDArray[np.uint16]] = []
    shape: tuple[int, int] | None = None
    damaged = 0
    for number, frame in enumerate(stream.frames(notes)):
        if number >= _MOST_FRAMES:
            notes.append(f"only the first {_MOST_FRAMES} frames were used.")
            break
        if progress is not None and number % _SAY_EVERY == 0:
            progress(f"looking at the images: {number}" + (f" of {stream.count}" if stream.count else ""))
        try:
            image = frame.decode()
        except RecordingError:
            damaged += 1
            continue
        shape = shape or _grid(image.shape[0], image.shape[1])
        small = cv2.resize(image.astype(np.float32), shape[::-1], interpolation=cv2.INTER_AREA)
        rows.append(np.rint(small * _STEPS).astype(np.uint16).ravel())
        t_ns.append(frame.t_ns)
    if damaged:
        notes.append(f"{damaged} damaged frame{'s were' if damaged > 1 else ' was'} left out.")
    if len(rows) < 2 or shape is None:
        said = f" ({' '.join(notes)})" if notes else ""
        raise RecordingError(f"{len(rows)} images of the video can be read{said}; a rate needs many turns.")
    stamps = np.array(t_ns, dtype=np.int64)
    cells = np.stack(rows).astype(np.float32) / np.float32(_STEPS)
    return PictureSeries(t_s=(stamps - stamps[0]) * 1e-9, cells=_evenly_exposed(cells), shape=shape, notes=tuple(notes))


def _grid(height: int, width: int) -> tuple[int, int]:
    side = max(1.0, sqrt(height * width / _CELLS))
    return max(1, round(height / side)), max(1, round(width / side))


def _evenly_exposed(cells: Pictures) -> Pictures:
    """Undo gain and offset of each picture, by the cells that vary least."""
    mean = cells.mean(axis=0)
    spread = cells.std(axis=0)
    still = np.argsort(spread)[: max(8, int(_STILL_SHARE * len(spread)))]
    seen = cells[:, still]
    level = mean[still].mean()
    contrast = mean[still] - level
    noise = float(np.mean(spread[still] ** 2)) * 10 + 1e-3  # a share of gain that noise explains is left alone
    own = seen.mean(axis=1)
    gain = (seen @ contrast + noise) / (contrast @ contrast + noise)
    gain = np.clip(gain, 0.2, 5.0)
    return (cells - own[:, None]) / gain[:, None] + level
