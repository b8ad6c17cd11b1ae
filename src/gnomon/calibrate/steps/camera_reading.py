"""A recording of cameras in front of a board -> their corners, whatever it was recorded as, without lens or IMU.

read target -> open the recording -> find the board in the images -> Recording

A folder that holds corners already, which another program detected, is read as it is. Corners of a checkerboard that
looks the same after half a turn are numbered by the motion in the image, each camera for itself; where that tells
nothing, as between single photographs, `calibrate_cameras` numbers those of several cameras alike.
"""

import hashlib
import json
import zipfile
from collections.abc import Mapping
from dataclasses import replace
from os import PathLike
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..._version import __version__
from ...errors import GnomonError, OptionError, RecordingError
from ...formats.kalibr.camchain import CameraInput
from ...formats.kalibr.target import read_target
from ...formats.sensor_inputs import read_cameras
from ...models.camera import Camera
from ...models.target import Target
from ...output import atomic_file, remove_parts
from ...progress import Progress
from ...readers.files import ZIP_DAMAGE, file_source
from ...readers.images.image_files import camera_places, image_names, read_grey
from ...readers.images.image_recording import open_images
from ...readers.recordings import ReadLog, stated_units
from ...readers.rig.folder import corner_streams, folder_corners, holds_corners, recording_folder
from ...readers.samples.npz import refuse_false_arrays
from ...recording import CameraFrames, FrameQuality, Recording, Source
from ...recording.recording import ImageRecording, ImageStream
from ...units import Units
from .board_corners import BoardCorners, CameraImages, detect_corners

DETECTORS = 6
"""Version of the detectors within one of gnomon; to be raised whenever corners come out differently."""

PREFIX, SUFFIX = "corners-", ".npz"
_HASH = 16  # digits
_ARRAYS = ("t_ns", "frame", "point", "pixels", "sigma_px", "blur_px", "black", "white")
Size = tuple[int, int]
_NO_TOPICS: Mapping[str, str] = MappingProxyType({})
_BESIDE = "camchain.yaml"


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
        which = stream.topic + stream.selection
        file = cache_file(Path(cache), images.sources, name, which, target, lens_known=lens_known)
    kept = None if file is None else kept_corners(file, known)
    if kept is not None and file is not None:
        said = f"{name}: the corners are those that an earlier run found in the same images ({file.name})."
        return BoardCorners(frames=kept.frames, notes=(*kept.notes, said))
    source = CameraImages(name=name, stream=stream, known=known, lens_known=lens_known)
    found = detect_corners(source, target, workers=workers, progress=progress)
    if file is not None:
        keep_corners(file, found)
    return found


def read_camera_views(
    path: str | PathLike[str],
    *,
    target: str | PathLike[str],
    cam: str | PathLike[str] | None = None,
    resolution: Size | None = None,
    units: str | Units | None = None,
    topics: Mapping[str, str] = _NO_TOPICS,
    workers: int | None = None,
    cache: str | PathLike[str] | None = None,
    progress: Progress | None = None,
) -> tuple[Recording, Target]:
    """Read views of a calibration board by one camera or several, and find the board in them.

    Parameters
    ----------
    path : a ROS 1 bag, a ROS 2 bag (sqlite or MCAP), a folder in the layout of EuRoC, TUM-VI or Kalibr, a folder of
        images (of several cameras in folders cam0, cam1, ... or left and right), a video; or a folder with the corners
        of each camera, cam0_corners.csv, cam1_corners.csv, ... An IMU in it is passed over
    target : Kalibr's target.yaml
    cam : Kalibr's camchain.yaml or another project's file of the cameras, where their topics, line delays or image
        sizes are to be taken from it; the lenses are not needed, and not used
    resolution : (width, height) of the images [px], for tables of corners; images tell it themselves
    units : of timestamps in tables, such as "us"; recognised where not given
    topics : "cam0", ... -> topic of a bag; guessed where it is clear
    workers : how many look for the board at once; as many as there are cores where not given
    cache : folder in which the corners are kept, so that the same images need not be looked at again
    progress : called with a sentence from time to time

    Returns
    -------
    recording : frames with their corners, no IMU; the lens of a camera that was not stated is `Camera.nominal`
    target : the board

    Raises
    ------
    FormatError
        If one of the files cannot be read, or is not as it should be.
    RecordingError
        If the recording cannot be read, or the images of a camera differ in size.
    DetectionError
        If the board is in none of the images of a camera.
    OptionError
        If an option does not fit, or the size of the images is needed and not known.
    """
    log = ReadLog(units=stated_units(units), cameras_alone=True)
    board = read_target(target, log.notes)
    log.sources.extend(file_source(Path(file)) for file in (cam, target) if file is not None)
    stated = {} if cam is None else _lenses(read_cameras(cam, log.notes), resolution, Path(cam))
    if Path(path).is_dir() and holds_corners(recording_folder(Path(path))):
        folder = recording_folder(Path(path))
        known = stated or _sized(folder, resolution, log)
        cameras = folder_corners(folder, known, Path(cam).name if cam else "the recording", board, log)
        return _recording(cameras, log), board
    suggested = {name: entry.camera.topic for name, entry in stated.items() if entry.camera.topic}
    images = open_images(path, topics=topics, suggested=suggested, units=log.units, cameras_alone=True)
    log.sources.extend(images.sources)
    log.notes.extend(images.assumptions)
    if cam is None:
        known = {name: _nominal(_size(stream, resolution), stream.topic) for name, stream in images.streams.items()}
    else:
        known = stated_cameras(images, stated, Path(path), Path(cam).name, log.notes)
    tell = progress or (lambda _: None)
    found = {
        name: read_camera_corners(
            images, name, entry, board, lens_known=False, workers=workers, cache=cache, progress=tell
        )
        for name, entry in known.items()
    }
    log.notes.extend(note for corners in found.values() for note in corners.notes)
    return _recording({name: corners.frames for name, corners in found.items()}, log), board


def _recording(cameras: Mapping[str, CameraFrames], log: ReadLog) -> Recording:
    return Recording(imus={}, cameras=cameras, sources=tuple(log.sources), assumptions=tuple(log.notes))


def _lenses(stated: Mapping[str, CameraInput], resolution: Size | None, cam: Path) -> dict[str, CameraInput]:
    """Return the cameras of a file without what an IMU adds."""
    for name, entry in stated.items():
        if resolution not in (None, entry.camera.resolution):
            width, height = entry.camera.resolution
            raise OptionError(
                f"--resolution {resolution[0]} {resolution[1]}, but {cam.name} says {width} x {height} px of {name}. "
                "Leave out the one that is wrong."
            )
    return {name: CameraInput(camera=entry.camera) for name, entry in stated.items()}


def _nominal(size: Size, topic: str = "") -> CameraInput:
    return CameraInput(camera=Camera.nominal(size, topic))


def _size(stream: ImageStream, resolution: Size | None) -> Size:
    """Return the size of the images: as stated, else that of the first that can be read."""
    if resolution is not None:
        return resolution
    for frame in stream.frames([]):
        try:
            height, width = frame.decode().shape
        except RecordingError:
            continue
        return width, height
    return 1, 1  # no image can be read: looking for the board says so


def untold_sizes(path: Path) -> str:
    """Return what to do where tables of corners do not tell how large the images are; nothing where that is told."""
    if not (path.is_dir() and holds_corners(folder := recording_folder(path))):
        return ""
    found = _beside(folder)
    missing = [name for name in corner_streams(folder) if name not in found]
    return (
        ""
        if not missing
        else (
            f"{folder}: tables of corners do not tell how large the images of {' and '.join(missing)} are. Give "
            f"--resolution WIDTH HEIGHT in pixels, or put one image of each, such as {missing[0]}_1.png, or a "
            f"{_BESIDE} into the folder."
        )
    )


def _sized(folder: Path, resolution: Size | None, log: ReadLog) -> dict[str, CameraInput]:
    """Return the cameras of tables of corners by the size of their images: stated, of images or a camchain beside."""
    names = list(corner_streams(folder))
    if resolution is not None:
        return {name: _nominal(resolution) for name in names}
    if untold := untold_sizes(folder):
        raise OptionError(untold)
    found = _beside(folder)
    for name in names:
        (width, height), where = found[name]
        log.note(f"{name}: images of {width} x {height} px, as {where} has it.")
    return {name: _nominal(found[name][0]) for name in names}


def _beside(folder: Path) -> dict[str, tuple[Size, str]]:
    """Return the sizes that images or a camchain in a folder tell, and which of them does."""
    found: dict[str, tuple[Size, str]] = {}
    if (folder / _BESIDE).is_file():
        chain = read_cameras(folder / _BESIDE, [])
        found |= {name: (entry.camera.resolution, _BESIDE) for name, entry in chain.items()}
    try:
        places = camera_places(folder, [])
    except RecordingError:
        return found
    for name, place in places.items():
        image = None if place.folder is None else min(image_names(place.folder, place.prefix))
        if image is not None and place.folder is not None:
            height, width = read_grey(place.folder / image, image).shape
            found[name] = ((width, height), image)
    return found
