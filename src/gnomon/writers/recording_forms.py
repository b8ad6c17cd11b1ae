"""Recordings of images -> a place in a folder, in the form that is asked for."""

from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Literal

from ..progress import Progress
from ..recording.frames import Frame, Grey
from ..recording.recording import ImageRecording
from .bag_recording import save_bag
from .euroc_folder import save_euroc
from .video import save_simulated_images

_WORKERS, _AHEAD = 2, 8

ImageForm = Literal["folder", "euroc", "ros1", "ros2", "mcap"]

PLACES: dict[ImageForm, str] = {"euroc": "mav0", "ros1": "recording.bag", "ros2": "recording", "mcap": "recording.mcap"}
"""What is made in the folder; as "folder", a folder of each camera."""


def save_images(
    recording: ImageRecording, folder: Path, form: ImageForm, progress: Progress | None = None
) -> tuple[Path, ...]:
    """Write images, and what was recorded with them, into a folder; return the files, of images their tables.

    Parameters
    ----------
    recording : in the form "folder" its images alone
    folder : it is there, and has nothing in it of the same names
    form : "folder" (cam0/data.csv and cam0/data/<timestamp>.png), "euroc" (the same in mav0, with sensor.yaml), "ros1",
        "ros2" (SQLite) or "mcap"
    progress : called with a sentence now and then

    Raises
    ------
    OutputError
        If a file cannot be written.
    """
    if form == "folder":
        return tuple(
            save_simulated_images(stream, folder / name, progress) for name, stream in recording.streams.items()
        )
    if form == "euroc":
        made = folder / ".euroc"
        save_euroc(recording, made, progress)
        (made / "mav0").replace(folder / "mav0")
        made.rmdir()
        return tuple(sorted((folder / "mav0").glob("*/*.*")))
    streams = {
        name: replace(stream, frames=partial(_ahead, stream.frames)) for name, stream in recording.streams.items()
    }
    save_bag(replace(recording, streams=streams), folder / PLACES[form], form, progress)
    return (folder / PLACES[form],)


def _ahead(frames: Callable[[list[str]], Iterator[Frame]], notes: list[str]) -> Iterator[Frame]:
    """Yield the frames; a few of the next ones are being decoded meanwhile."""
    waiting: deque[tuple[Frame, Future[Grey]]] = deque()
    with ThreadPoolExecutor(_WORKERS) as pool:
        for frame in frames(notes):
            waiting.append((frame, pool.submit(frame.decode)))
            if len(waiting) >= _AHEAD:
                yield _decoded(*waiting.popleft())
        for pair in waiting:
            yield _decoded(*pair)


def _decoded(frame: Frame, image: "Future[Grey]") -> Frame:
    return Frame(t_ns=frame.t_ns, where=frame.where, decode=image.result)
