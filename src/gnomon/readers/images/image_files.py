"""Images and videos as files: which folder or file holds which camera, one image as 8 bits of grey, hashes of many.

Cameras lie in EuRoC's and TUM-VI's layout, Kalibr's, or plain folders. A video is told by its content:
most files are none by their first bytes, without PyAV being loaded.
"""

import hashlib
import os
import re
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from ...errors import RecordingError
from ...frozen import value_class
from ...output import refuse_special
from ...recording import Integers, Source, frozen_array
from ...recording.recording import Frame, Grey, ImageStream
from ..files import is_mp4_head
from ..recordings import ReadLog
from .frame_stamps import (
    FrameTable,
    are_stamps,
    is_frame_table,
    numbered_names,
    read_frame_table,
    stamps_in_names,
    stem_of,
)
from .image_pixels import bit_depth, decode_picture, largest_in_picture

_HEAD = 4096
_TEXT_MAGIC = b"YUV4MPEG2"  # the only video that begins as text
_NO_VIDEO = (
    *(b"\x1f\x8b", b"PK\x03\x04", b"#ROSBAG", b"\x89MCAP", b"SQLite format 3", b"\x93NUMPY", b"%PDF", b"MATLAB 5.0"),
    *(b"ULog\x01", b"\xa3\x95\x80", b"DEVC"),  # of autopilots and a GoPro: to some a stream of MPEG-4
)
_IMAGES = ("image2", "_pipe")


def is_video(path: Path) -> bool:
    """Tell by its content whether a file is a video."""
    try:
        if not path.is_file():
            return False
        with path.open("rb") as file:
            head = file.read(_HEAD)
    except OSError:
        return False
    text = b"\0" not in head and not head.startswith(_TEXT_MAGIC)
    if text or head.startswith(_NO_VIDEO):
        return False
    return is_mp4_head(head) or _opens_as_video(path)


def _opens_as_video(path: Path) -> bool:
    import av  # takes its time
    from av.error import FFmpegError

    try:
        with av.open(str(path)) as container:
            return bool(container.streams.video) and not container.format.name.endswith(_IMAGES)
    except (FFmpegError, OSError, ValueError):
        return False


IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".pgm")
_HASHING = 2  # threads: reading and hashing overlap, and more of them would only fight for the disk
_BATCH = 32  # files that a thread takes at a time
_LOOKED_AT = 32


def is_image_name(name: str) -> bool:
    """Tell by its suffix whether a file is an image; hidden files are none."""
    return name.lower().endswith(IMAGE_SUFFIXES) and not name.startswith(".")


def read_grey(path: Path, where: str, bits: int | None = None) -> Grey:
    """Return an image in 8 bits of grey, its pixels where the sensor had them.

    Colour becomes grey. A mark that the image is to be shown turned (of phones) is not followed: the lens belongs to
    the sensor, and such marks change while a phone is waved.

    Parameters
    ----------
    path : the file
    where : its name for messages
    bits : how many bits images of 16 bits really have; None to tell from this image alone

    Raises
    ------
    RecordingError
        If the file cannot be read, is empty or damaged, or holds no image.
    """
    return decode_picture(_content(path, where), where, bits)


def used_bits(files: Sequence[tuple[Path, str]]) -> int | None:
    """Return how many bits a camera's images of 16 bits really have, from images spread over all; None for 8 bits.

    Parameters
    ----------
    files : each image and its name for messages
    """
    largest = 0
    for path, where in files[:: max(1, len(files) // _LOOKED_AT)]:
        try:
            found = largest_in_picture(_content(path, where), where)
        except RecordingError:  # its frame says so
            continue
        if not found:
            return None
        largest = max(largest, found)
    return bit_depth(largest) if largest else None


def _content(path: Path, where: str) -> bytes:
    refuse_special(path)
    try:
        data = path.read_bytes()
    except OSError as error:
        raise RecordingError(f"{where}: cannot be read ({error.strerror or error}).") from None
    if not data:
        raise RecordingError(f"{where}: the file is empty (0 bytes).")
    return data


def hash_of_images(files: Iterable[tuple[str, Path]]) -> str:
    """Return the SHA-256 over the names and contents of images, in the order of their names.

    Of a file that cannot be read only the name counts; its frame says what is wrong.
    """
    ordered = sorted(files)
    parts = [ordered[start : start + _BATCH] for start in range(0, len(ordered), _BATCH)]
    total = hashlib.sha256()
    with ThreadPoolExecutor(_HASHING) as pool:
        for digested in pool.map(_digested, parts):
            total.update(digested)
    return total.hexdigest()


def _digested(files: list[tuple[str, Path]]) -> bytes:
    """Return the names and the hashes of some files."""
    return b"".join(name.encode(errors="surrogateescape") + b"\0" + _digest(path) for name, path in files)


def _digest(path: Path) -> bytes:
    try:
        refuse_special(path)
        with path.open("rb", buffering=0) as file:
            return hashlib.sha256(file.readall()).digest()
    except (OSError, RecordingError):
        return bytes(32)


_CAMERA = re.compile(r"(?:cam(?:era)?|image)[-_]?0*(\d+)", re.IGNORECASE)
_OF_A_CAMERA = re.compile(r"(cam\d+(?=[-_])|left|right)", re.IGNORECASE)
_PAIR = {"left": "cam0", "right": "cam1"}
_USUAL = {"images", "image", "frames", "cam", "camera", "video"}
_INNER = ("data", "images")
_STAMPS = "frames|(?:frame[-_])?timestamps?|times?|stamps|images?|data"
_TABLE = r"\.(csv|txt|tsv)(\.gz)?"
EXPECTED = (
    "a ROS bag (.bag, .db3, .mcap); a folder with mav0/cam0/data/*.png (EuRoC, TUM-VI), cam0/*.png (Kalibr) or "
    "images/*.png and imu0.csv; or a video with imu0.csv beside it"
)


@value_class(eq=True)
class CameraPlace:
    """Where the images of one camera are: in a folder, or in a video.

    Attributes
    ----------
    folder : of the images, or None
    prefix : with which the names of its images begin, in lower case, where several cameras share the folder
    video : the file, or None
    table : with the timestamps of its frames, or None
    sensor : its sensor.yaml, or None
    label : folder or file as it is called in messages
    """

    label: str
    folder: Path | None = None
    prefix: str = ""
    video: Path | None = None
    table: Path | None = None
    sensor: Path | None = None


def image_names(folder: Path, prefix: str = "") -> Iterator[str]:
    """Yield the names of the images in a folder, in no order."""
    with os.scandir(folder) as entries:
        for entry in entries:
            if is_image_name(entry.name) and entry.name.lower().startswith(prefix) and entry.is_file():
                yield entry.name


def camera_places(root: Path, notes: list[str]) -> dict[str, CameraPlace]:
    """Return the cameras, "cam0", "cam1", ..., of a folder; empty where there are no images and no videos.

    Raises
    ------
    RecordingError
        If several folders or videos may be the camera, and their names do not tell.
    """
    found: dict[str, CameraPlace] = {}
    for name, place in _named(root):
        if name in found:
            notes.append(f"{found[name].label} was left out: {place.label} is {name}, too.")
        found[name] = place
    if not found:
        found = _unnamed(root, notes)
    alone = len(found) == 1
    ordered = sorted(found.items(), key=lambda item: (len(item[0]), item[0]))
    return {name: _with_table(place, name, root, alone=alone) for name, place in ordered}


def has_cameras(root: Path) -> bool:
    """Tell whether there are images or videos in a folder, whatever they are called."""
    if _images_of(root) is not None:
        return True
    inside = [path for path in root.iterdir() if not path.name.startswith(".")]
    if any(path.is_dir() and _images_of(path) is not None for path in inside):
        return True
    folders = [path for path in inside if path.is_dir() and path.name.lower() in _USUAL]
    files = [path for folder in folders for path in folder.iterdir() if not path.name.startswith(".")]
    return any(path.is_file() and is_video(path) for path in (*inside, *files))


def video_place(video: Path) -> CameraPlace:
    """Return the only camera of a recording that is a video."""
    return _with_table(CameraPlace(label=video.name, video=video), "cam0", video.parent, alone=False)


def _named(root: Path) -> Iterator[tuple[str, CameraPlace]]:
    """Yield the cameras whose folders or videos are called after them; of both the folder, which comes last."""
    entries = sorted(path for path in root.iterdir() if not path.name.startswith("."))
    for path in entries:
        match = _CAMERA.fullmatch(path.stem)
        if match and path.is_file() and is_video(path):
            yield f"cam{int(match[1])}", CameraPlace(label=path.name, video=path)
    for path in entries:
        match = _CAMERA.fullmatch(path.name)
        folder = _images_of(path) if match and path.is_dir() else None
        if match and folder is not None:
            yield f"cam{int(match[1])}", _folder_place(folder, path, root)
    pair = {_PAIR[path.name.lower()]: path for path in entries if path.is_dir() and path.name.lower() in _PAIR}
    inside = {name: folder for name, path in pair.items() if (folder := _images_of(path)) is not None}
    if len(inside) == len(_PAIR):
        for name, folder in inside.items():
            yield name, _folder_place(folder, pair[name], root)


def _unnamed(root: Path, notes: list[str]) -> dict[str, CameraPlace]:
    """Return the images of a folder without names of cameras."""
    entries = sorted(path for path in root.iterdir() if not path.name.startswith("."))
    top = [match[1].lower() if (match := _OF_A_CAMERA.match(name)) else "" for name in image_names(root)]
    cameras = set(top)
    if cameras and "" not in cameras and (len(cameras) > 1 or not cameras & set(_PAIR)):
        found = {name: CameraPlace(label=f"{name}*", folder=root, prefix=name) for name in sorted(cameras)}
        return {_PAIR.get(name, name): place for name, place in found.items()}
    places = [CameraPlace(label=f"{root.name}/", folder=root)] if top else []
    inner = [(path, _images_of(path)) for path in entries if path.is_dir()]
    inside = [_folder_place(folder, path, root) for path, folder in inner if folder is not None]
    without = [path for path, images in inner if images is None and path.name.lower() in _USUAL]
    files = [path for folder in (root, *without) for path in sorted(folder.iterdir()) if path.is_file()]
    videos = [
        CameraPlace(label=path.relative_to(root).as_posix(), video=path)
        for path in files
        if not path.name.startswith(".") and is_video(path)
    ]
    usual = [place for place in inside if place.label.rstrip("/").lower() in _USUAL]
    candidates = places or (usual if len(usual) == 1 else inside) or videos
    if len(candidates) > 1:
        listed = ", ".join(place.label for place in candidates[:6]) + (", ..." if len(candidates) > 6 else "")
        raise RecordingError(
            f"{root}: {len(candidates)} of its {'videos' if not inside else 'folders'} may be the camera ({listed}). "
            "Name those that are cameras cam0, cam1, ...; or give the one to read."
        )
    if not candidates:
        return {}
    (place,) = candidates
    if place in inside and place not in usual:
        notes.append(f"the images in {place.label} are those of cam0.")
    return {"cam0": place}


def _images_of(path: Path) -> Path | None:
    """Return the folder in which the images of a camera's folder are: itself, or data/ or images/ in it."""
    for folder in (path, *(path / name for name in _INNER)):
        if folder.is_dir() and next(image_names(folder), None) is not None:
            return folder
    return None


def _folder_place(folder: Path, camera: Path, root: Path) -> CameraPlace:
    sensor = camera / "sensor.yaml"
    label = folder.relative_to(root).as_posix() + "/"
    return CameraPlace(label=label, folder=folder, sensor=sensor if sensor.is_file() else None)


def _with_table(place: CameraPlace, name: str, root: Path, *, alone: bool) -> CameraPlace:
    """Return the place with the table of its timestamps, where there is one."""
    table = next((path for path in _tables(place, name, root, alone=alone) if is_frame_table(path)), None)
    return replace(place, table=table)


def _tables(place: CameraPlace, name: str, root: Path, *, alone: bool) -> Iterator[Path]:
    """Yield files whose names are those of tables of timestamps, the likeliest first."""
    own = re.escape(name if place.video is None else place.video.stem)
    inside = re.compile(rf"(?:{_STAMPS}|{own}){_TABLE}", re.IGNORECASE)
    beside = re.compile(rf"(?:{own}|{name})(?:[-_.](?:{_STAMPS}))?{_TABLE}", re.IGNORECASE)
    folder = place.folder
    if folder is not None and folder != root:
        camera = folder.parent if folder.name in _INNER and folder.parent != root else folder
        for place_of_table in dict.fromkeys((camera, folder)):
            yield from _matching(place_of_table, inside)
    yield from _matching(root, beside)
    if alone:
        yield from _matching(root, inside)


def _matching(folder: Path, pattern: re.Pattern[str]) -> list[Path]:
    with os.scandir(folder) as entries:
        return sorted(Path(entry.path) for entry in entries if pattern.fullmatch(entry.name) and entry.is_file())


def folder_stream(name: str, place: CameraPlace, log: ReadLog) -> ImageStream:
    """Return the stream of the images in a folder, in the order of their timestamps.

    Parameters
    ----------
    name : "cam0", "cam1", ...
    place : where its images are
    log : what was stated; the files that are read, and sentences on what was left out or assumed, are added

    Raises
    ------
    RecordingError
        If nothing tells when the images were taken, none of those that are listed is there, or timestamps are damaged.
    """
    folder = place.folder
    assert folder is not None
    files = sorted(image_names(folder, place.prefix))
    if place.table is None and log.cameras_alone and not are_stamps(files):
        t_ns, note = numbered_names(files, place.label)
        log.note(note)
    elif place.table is None:
        t_ns, note = stamps_in_names(files, log.units.time, place.label)
        log.note(note)
    else:
        table = read_frame_table(place.table, files, log.units.time)
        log.sources.append(replace(table.source, name=f"{name}/{table.source.name}"))
        log.notes.extend(table.notes)
        files, t_ns = _listed(table, files, place, log)
    files, t_ns = _in_order(files, t_ns, place, log)
    digest = hash_of_images((file, folder / file) for file in files)
    log.sources.append(Source(name=f"{name} ({len(files)} image{'s' if len(files) != 1 else ''})", sha256=digest))
    bits = used_bits([(folder / file, _where(place.label, file)) for file in files])
    if bits is not None and bits != 16:
        log.note(f"{place.label}: the images have 16 bits, of which {bits} are used; the upper 8 of these were taken.")
    return ImageStream(frames=partial(_frames, folder, place.label, tuple(files), t_ns, bits), count=len(files))


def _frames(
    folder: Path, label: str, files: tuple[str, ...], t_ns: Integers, bits: int | None, _notes: list[str]
) -> Iterator[Frame]:
    for file, stamp in zip(files, t_ns, strict=True):
        where = _where(label, file)
        yield Frame(t_ns=int(stamp), where=where, decode=partial(read_grey, folder / file, where, bits))


def _where(label: str, file: str) -> str:
    return f"{label}{file}" if label.endswith("/") else file


def _listed(table: FrameTable, files: list[str], place: CameraPlace, log: ReadLog) -> tuple[list[str], Integers]:
    """Return the images that are both listed and there, in the order of the table, and their timestamps."""
    where = table.source.name
    if table.names is None:
        if len(table.t_ns) != len(files):
            raise RecordingError(
                f"{where}: found {len(table.t_ns)} timestamps and {len(files)} images in {place.label}; without names "
                "of "
                'files there must be one for each, in the order of their names. Add a column "filename".'
            )
        log.note(f"{where}: its timestamps were given to the images of {place.label} in the order of their names.")
        return files, table.t_ns
    there = {stem_of(file): file for file in files} | {file: file for file in files}
    found = [there.get(name) or there.get(stem_of(name)) for name in table.names]
    kept = [(file, row) for row, file in enumerate(found) if file is not None]
    if not kept:
        raise RecordingError(
            f"{where}: none of the {len(found)} images that it lists, such as {table.names[0]}, is in {place.label}, "
            f"which holds {files[0]}{', ...' if len(files) > 1 else ''}. Was the folder copied completely?"
        )
    missing = len(found) - len(kept)
    if missing:
        first = next(name for name, file in zip(table.names, found, strict=True) if file is None)
        log.note(f"{where}: {missing} of {len(found)} images that it lists are not in {place.label}, such as {first}.")
    unlisted = len(files) - len({file for file, _ in kept})
    if unlisted:
        log.note(f"{where}: {unlisted} of {len(files)} images in {place.label} are not listed and were left out.")
    return [file for file, _ in kept], table.t_ns[[row for _, row in kept]]


def _in_order(files: list[str], t_ns: Integers, place: CameraPlace, log: ReadLog) -> tuple[list[str], Integers]:
    """Return images in the order of time, one for each timestamp."""
    order = np.argsort(t_ns, kind="stable")
    if place.table is not None and (np.diff(t_ns) < 0).any():
        log.note(f"{place.table.name}: the rows are not in the order of time; they were sorted.")
    new = np.concatenate([[True], np.diff(t_ns[order]) > 0])
    twice = len(order) - int(np.count_nonzero(new))
    if twice > 0.5 * len(order):
        raise RecordingError(
            f"{place.label}: {twice} of {len(order)} images have the same timestamp as another one; the first is "
            f"{t_ns[order[0]]} ns. The timestamps are too coarse, or were not recorded; write them in nanoseconds."
        )
    if twice:
        log.note(f"{place.label}: {twice} of {len(order)} images have the timestamp of another one and were left out.")
    kept = order[new]
    return [files[i] for i in kept], frozen_array(t_ns[kept], np.int64)
