"""Cameras in front of a board, as images: which of them are meant, and their corners, found or kept."""

import hashlib
import json
import zipfile
from collections.abc import Mapping
from dataclasses import replace
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..._version import __version__
from ...errors import GnomonError, RecordingError
from ...formats.kalibr.camchain import CameraInput
from ...models.target import Target
from ...output import atomic_file, remove_parts
from ...progress import Progress
from ...readers.files import ZIP_DAMAGE, refuse_false_arrays
from ...recording import CameraFrames, FrameQuality, Source
from ...recording.frames import ImageRecording
from .board_corners import BoardCorners, CameraImages, detect_corners

DETECTORS = 6
"""Version of the detectors within one of gnomon; to be raised whenever corners come out differently."""

PREFIX, SUFFIX = "corners-", ".npz"
_HASH = 16  # digits
_ARRAYS = ("t_ns", "frame", "point", "pixels", "sigma_px", "blur_px", "black", "white")


def cache_file(
    folder: Path, images: tuple[Source, ...], camera: str, topic: str, target: Target, *, lens_known: bool = True
) -> Path:
    """Return the file in which the corners of one camera are kept; a lens helps to number those without codes."""
    size = [target.tag_size_m, target.tag_spacing, target.row_spacing_m, target.col_spacing_m, target.spacing_m]
    board = [target.kind, target.cols, target.rows, *size, target.asymmetric, target.border_bits, target.first_tag]
    if target.kind == "charuco":
        board += [target.marker_size_m, target.square_size_m, target.dictionary, target.legacy]
    if target.kind in {"checkerboard", "circlegrid"} and not lens_known:
        board += ["numbered without the lens"]
    what = json.dumps([__version__, DETECTORS, [source.sha256 for source in images], camera, topic, board])
    return folder / f"{PREFIX}{camera}-{hashlib.sha256(what.encode()).hexdigest()[:_HASH]}{SUFFIX}"


def kept_corners(file: Path, known: CameraInput) -> BoardCorners | None:
    """Return the corners that are kept in a file; None where there is none, or none that can be read."""
    try:
        with file.open("rb") as stream, zipfile.ZipFile(stream) as packed:
            refuse_false_arrays(packed, file.name)
        with file.open("rb") as stream, np.load(stream, allow_pickle=False) as kept:
            arrays = {name: kept[name] for name in _ARRAYS}
            told = json.loads(str(kept["told"]))
        if tuple(told["resolution"]) != known.camera.resolution:
            return None
        return _corners(arrays, told, known)
    except (*ZIP_DAMAGE, GnomonError):
        return None


def _corners(arrays: Mapping[str, NDArray[Any]], told: Mapping[str, Any], known: CameraInput) -> BoardCorners:
    return BoardCorners(
        frames=CameraFrames(
            t_ns=arrays["t_ns"],
            frame=arrays["frame"],
            point=arrays["point"],
            pixels=arrays["pixels"],
            sigma_px=arrays["sigma_px"],
            camera=known.camera,
            T_cam_imu=known.T_cam_imu,
            time_shift_cam_imu_s=known.time_shift_cam_imu_s,
            lens_covariance=known.lens_covariance,
            quality=FrameQuality(
                blur_px=arrays["blur_px"],
                black=arrays["black"],
                white=arrays["white"],
                dropped=dict(told["dropped"]),
            ),
        ),
        notes=tuple(told["notes"]),
    )


def keep_corners(file: Path, corners: BoardCorners) -> None:
    """Keep corners in a file, whose folder is made; what was kept of other images of this camera goes.

    Raises
    ------
    OutputError
        If it cannot be written.
    """
    frames = corners.frames
    quality = frames.quality
    assert quality is not None
    told = {
        "resolution": frames.camera.resolution,
        "dropped": sorted(quality.dropped.items()),
        "notes": corners.notes,
    }
    arrays = {name: getattr(frames, name) for name in _ARRAYS[:5]} | {
        name: getattr(quality, name) for name in _ARRAYS[5:]
    }
    file.parent.mkdir(parents=True, exist_ok=True)
    with atomic_file(file) as stream:
        np.savez(stream, told=np.array(json.dumps(told)), **arrays)  # pyright: ignore[reportArgumentType]
    camera = file.name.removesuffix(SUFFIX).rpartition("-")[0]
    for older in file.parent.glob(f"{camera}-{'[0-9a-f]' * _HASH}{SUFFIX}"):
        if older.name != file.name:
            older.unlink(missing_ok=True)
    remove_parts(file.parent, f"{camera}-")


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


def read_camera_corners(
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
