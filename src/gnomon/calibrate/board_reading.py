"""Cameras in front of a board, as images: which of them are meant, and their corners, found or kept."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from os import PathLike
from pathlib import Path

from ..errors import RecordingError
from ..images import ImageRecording
from ..models.target import Target
from ..readers.rig.kalibr_camchain import CameraInput
from .board_corners import BoardCorners, CameraImages, detect_corners
from .corner_cache import cache_file, keep_corners, kept_corners

Progress = Callable[[str], None]


def stated_cameras(
    images: ImageRecording, stated: Mapping[str, CameraInput], path: Path, cam: str, notes: list[str]
) -> dict[str, CameraInput]:
    """Return the cameras that have images and are stated, with the topic that was read.

    Parameters
    ----------
    images : of the recording
    stated : cameras of a file, named `cam`
    path : of the recording, for messages
    notes : where sentences on what was left out are appended

    Raises
    ------
    RecordingError
        If there are none.
    """
    both = [name for name in stated if name in images.streams]
    if not both:
        raise RecordingError(
            f"{path}: there are images of {', '.join(images.streams)}, but {cam} describes {', '.join(stated)}. "
            "Rename one of them."
        )
    notes.extend(f"{name} of {cam} has no images here and was left out." for name in stated if name not in both)
    notes.extend(
        f"the images of {name} were left out: {cam} does not describe it."
        for name in images.streams
        if name not in both
    )
    return {name: _with_topic(stated[name], images.streams[name].topic) for name in both}


def _with_topic(known: CameraInput, topic: str) -> CameraInput:
    """Return what is known of a camera with the topic that was read, whatever the file of the cameras says."""
    return replace(known, camera=replace(known.camera, topic=topic)) if topic else known


def corners_of_camera(
    images: ImageRecording,
    name: str,
    known: CameraInput,
    target: Target,
    *,
    lens_known: bool = True,
    workers: int | None,
    cache: str | PathLike[str] | None,
    progress: Progress,
) -> BoardCorners:
    """Return the corners of one camera: as they are kept, else as they are found, and keep them then.

    Parameters
    ----------
    images : of the recording
    name, known : of the camera
    target : the board
    lens_known : whether what is known is its lens, rather than a stand-in of the right size
    workers, progress : as for `detect_corners`
    cache : folder in which the corners are kept
    """
    stream = images.streams[name]
    file = None
    if cache is not None:
        file = cache_file(Path(cache), images.sources, name, stream.topic, target, lens_known=lens_known)
    kept = None if file is None else kept_corners(file, known)
    if kept is not None and file is not None:
        said = f"{name}: the corners are those that an earlier run found in the same images ({file.name})."
        return BoardCorners(frames=kept.frames, notes=(*kept.notes, said))
    source = CameraImages(name=name, stream=stream, known=known, lens_known=lens_known)
    found = detect_corners(source, target, workers=workers, progress=progress)
    if file is not None:
        keep_corners(file, found)
    return found
