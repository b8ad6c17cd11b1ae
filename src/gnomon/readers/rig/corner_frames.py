"""The timestamps of a folder with corners, where neither the cameras nor the board are described.

A recording of cameras and IMUs in front of a board, with Kalibr's files that describe them.
"""

from collections.abc import Callable, Mapping
from os import PathLike
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...errors import RecordingError
from ...formats.kalibr.camchain import CameraInput
from ...formats.kalibr.target import read_target
from ...formats.sensor_inputs import ImuFiles, imu_paths, read_cameras, read_imus
from ...frozen import value_class
from ...models.target import Target
from ...recording import CameraFrames, Floats, ImuSamples, Integers, Recording, Source
from ...units import Units
from ..files import file_source
from ..recordings import ReadLog, stated_units
from .corner_table import CornerTable, read_corner_table, read_frame_stamps
from .streams import CornerStream, corner_streams, imu_files, read_imu, recording_folder


@value_class
class CornerStamps:
    """Samples, and when frames were taken.

    Attributes
    ----------
    imus : "imu0", ... -> samples
    frames : "cam0", ... -> (n,) timestamps of its frames, ascending [ns]
    corners : "cam0", ... -> number of rows with corners
    assumptions : sentences on what was assumed
    """

    imus: Mapping[str, ImuSamples]
    frames: Mapping[str, Integers]
    corners: Mapping[str, int]
    assumptions: tuple[str, ...]


def read_corner_stamps(path: str | PathLike[str], units: str | Units | None = None) -> CornerStamps:
    """Read samples and timestamps of a folder with corners.

    Raises
    ------
    RecordingError
        If a table cannot be read.
    OptionError
        If `units` names no unit.
    """
    stated = stated_units(units)
    folder = recording_folder(Path(path))
    notes: list[str] = []
    sources: list[Source] = []
    frames: dict[str, Integers] = {}
    corners: dict[str, int] = {}
    for name, stream in corner_streams(folder).items():
        table = read_corner_table(stream.corners, stated.time)
        notes.extend(table.notes)
        all_stamps = table.t_ns
        if stream.frames is not None:
            listed, _, note = read_frame_stamps(stream.frames, stated.time)
            all_stamps = np.concatenate([listed, table.t_ns])
            notes.extend(text for text in (note,) if text)
        frames[name], corners[name] = np.unique(all_stamps), len(table.t_ns)
    try:
        files = imu_files(folder)
    except RecordingError:
        files = {}
    imus = {
        name: read_imu(name, tables, None, units=stated, sources=sources, notes=notes) for name, tables in files.items()
    }
    return CornerStamps(imus=imus, frames=frames, corners=corners, assumptions=tuple(notes))


Booleans = NDArray[np.bool_]

_BORDER_PX = 1.0  # a corner is found from pixels around it, and may come to lie a little outside the image
_NORMALISED = 2.0  # no image is so small
_SAME_PX = 1.0

_DETECTOR_SCALE_SIGMA = 3e-4
"""Of detectors that are not known: with corners of Kalibr's the focal length comes out 0.035 % short (rendered images,
whose lens is known)."""


def camera_frames(
    table: CornerTable, all_stamps: Integers | None, known: CameraInput, target: Target, notes: list[str]
) -> CameraFrames:
    """Return what a camera saw of the target.

    Corners that are not finite numbers, lie outside the image or stand twice in a frame are left out with a note.

    Parameters
    ----------
    table : its corners
    all_stamps : (n,) int64 timestamps of all its frames [ns], or None where only frames with corners are known
    known : lens, intrinsics and guesses
    target : the board
    notes : where sentences on what was left out are appended

    Raises
    ------
    RecordingError
        If corners are not on the target, or most of them cannot be used.
    """
    keep: NDArray[np.intp] = _finite(table, notes)
    point = _points(table, keep, target)
    pixels = table.pixels[keep]
    inside = _inside(table, pixels, known.camera.resolution, notes)
    keep, point, pixels = keep[inside], point[inside], pixels[inside]
    t_ns = table.t_ns[keep]
    stamps = _frame_stamps(table, t_ns, all_stamps, notes)
    frame = np.searchsorted(stamps, t_ns)
    order = _each_once(table, frame * len(target.points) + point, pixels, notes)
    if order is not None:
        frame, point, pixels = frame[order], point[order], pixels[order]
    return CameraFrames(
        t_ns=stamps,
        frame=frame,
        point=point,
        pixels=pixels,
        camera=known.camera,
        T_cam_imu=known.T_cam_imu,
        time_shift_cam_imu_s=known.time_shift_cam_imu_s,
        lens_covariance=known.lens_covariance,
        detector_scale_sigma=_DETECTOR_SCALE_SIGMA,
    )


def _finite(table: CornerTable, notes: list[str]) -> NDArray[np.intp]:
    """Return the rows whose coordinates are numbers."""
    finite = np.isfinite(table.pixels[:, 0]) & np.isfinite(table.pixels[:, 1])
    lost = len(finite) - int(np.count_nonzero(finite))
    if lost > 0.5 * len(finite):
        raise RecordingError(
            f"{table.where(int(np.argmin(finite)))}: NaN or infinity instead of pixels, as in {lost} of "
            f"{len(finite)} rows. Write one row for each corner that was detected, and none for the others."
        )
    if lost:
        notes.append(_left_out(table, lost, "NaN or infinity instead of pixels"))
    return np.flatnonzero(finite)


def _left_out(table: CornerTable, count: int, why: str) -> str:
    return f"{table.file.name}: left out {count} of {len(table.corner)} corners ({why})."


def _points(table: CornerTable, keep: NDArray[np.intp], target: Target) -> Integers:
    """Return the number on the target of each corner."""
    corner = table.corner[keep]
    if table.tag is None:
        last = len(target.points) - 1
        _refuse_unknown(table, keep, (corner < 0) | (corner > last), lambda i: f"corner {table.corner[i]}", target)
        return corner
    if target.kind != "aprilgrid":
        raise RecordingError(
            f"{table.file.name}: these are the corners of tags, but the target is a {target.kind}. "
            "Give the target.yaml of the AprilGrid that was seen."
        )
    tag = table.tag[keep]
    tags = len(target.points) // 4
    wrong = (tag < 0) | (tag >= tags) | (corner < 0) | (corner > 3)
    numbers = table.tag
    _refuse_unknown(table, keep, wrong, lambda i: f"corner {table.corner[i]} of tag {numbers[i]}", target)
    return target.point_of_tag_corner(tag, corner)


def _refuse_unknown(
    table: CornerTable, keep: NDArray[np.intp], wrong: Booleans, name: Callable[[int], str], target: Target
) -> None:
    if not wrong.any():
        return
    rows = keep[wrong]
    found = list(dict.fromkeys(name(int(i)) for i in rows[:1000]))
    listed = ", ".join(found[:4]) + (", ..." if len(found) > 4 else "")
    points = len(target.points)
    holds = f"corners 0 to {points - 1}"
    if table.tag is not None:
        holds = f"tags 0 to {points // 4 - 1} with corners 0 to 3"
    raise RecordingError(
        f"{table.where(int(rows[0]))}: {found[0]} is not on the target ({target.describe()}), which holds {holds}. "
        f"{len(rows)} of {len(table.corner)} rows name such corners: {listed}. Is this the target.yaml of the board "
        "that was seen?"
    )


def _inside(table: CornerTable, pixels: Floats, resolution: tuple[int, int], notes: list[str]) -> Booleans:
    """Return which corners are inside the image, or on its border."""
    if len(pixels) and float(np.abs(pixels).max()) < _NORMALISED:
        raise RecordingError(
            f"{table.file.name}: all coordinates lie between {pixels.min():.3g} and {pixels.max():.3g}. Expected "
            "pixels; these seem to be normalised. Write them as they were detected in the image."
        )
    width, height = resolution
    low, high = -0.5 - _BORDER_PX, np.array([width, height]) - 0.5 + _BORDER_PX
    inside = (pixels[:, 0] > low) & (pixels[:, 0] < high[0]) & (pixels[:, 1] > low) & (pixels[:, 1] < high[1])
    outside = len(inside) - int(np.count_nonzero(inside))
    if outside > 0.5 * len(inside):
        raise RecordingError(
            f"{table.file.name}: {outside} of {len(inside)} corners lie outside the image of {width} x {height} px; "
            f"u runs from {pixels[:, 0].min():.0f} to {pixels[:, 0].max():.0f}, v from {pixels[:, 1].min():.0f} to "
            f"{pixels[:, 1].max():.0f}. Resolution and intrinsics seem to be those of another camera or image size."
        )
    if outside:
        notes.append(_left_out(table, outside, f"outside the image of {width} x {height} px"))
    return inside


def _frame_stamps(table: CornerTable, t_ns: Integers, all_stamps: Integers | None, notes: list[str]) -> Integers:
    """Return the timestamps of all frames in order."""
    if (table.t_ns[1:] < table.t_ns[:-1]).any():
        notes.append(f"{table.file.name}: the rows are not in the order of time; they were sorted.")
    with_corners = np.unique(t_ns)
    if all_stamps is None:
        return np.unique(table.t_ns)
    stamps = np.union1d(all_stamps, with_corners)
    unlisted = len(stamps) - len(np.unique(all_stamps))
    if unlisted:
        notes.append(
            f"{table.file.name}: {unlisted} of {len(with_corners)} frames are missing in the list of all frames; "
            "they were added."
        )
    return stamps


def _each_once(table: CornerTable, key: Integers, pixels: Floats, notes: list[str]) -> NDArray[np.intp] | None:
    """Return the order of time, each corner of a frame once, the first that stands in the file; None if it is so."""
    if (key[1:] > key[:-1]).all():
        return None
    order = np.argsort(key, kind="stable")
    same = np.concatenate([[False], key[order[1:]] == key[order[:-1]]])
    count = int(np.count_nonzero(same))
    if not count:
        return order
    apart = np.linalg.norm(pixels[order[1:]] - pixels[order[:-1]], axis=1)[same[1:]]
    if count > 0.5 * len(key) and float(np.median(apart)) > _SAME_PX:
        raise RecordingError(
            f"{table.file.name}: most corners stand several times at one timestamp, at different places "
            f"({count} of {len(key)} rows). The timestamps are too coarse to tell the frames apart; write them in "
            "nanoseconds."
        )
    notes.append(_left_out(table, count, "the same corner is in the frame already"))
    return order[~same]


def read_corner_recording(
    path: str | PathLike[str],
    *,
    cam: str | PathLike[str],
    imu: ImuFiles | None,
    target: str | PathLike[str],
    units: str | Units | None = None,
) -> tuple[Recording, Target]:
    """Read a recording of cameras and IMUs in front of a calibration board.

    Parameters
    ----------
    path : folder with the corners of each camera, cam0_corners.csv, cam1_corners.csv, ..., and the samples of each
        IMU, imu0.csv, ...; all may be gzipped
    cam : Kalibr's camchain.yaml, or another file that `formats.sensor_inputs.read_cameras` reads
    imu : Kalibr's imu.yaml, or what else `formats.sensor_inputs.read_imus` reads; None where the noise of the IMUs
        is not known
    target : Kalibr's target.yaml
    units : of the IMU's samples, as for `gnomon.read`

    Returns
    -------
    recording : samples in m/s^2 and rad/s, frames with their corners
    target : the board

    Raises
    ------
    FormatError
        If one of Kalibr's files cannot be read, or is not as it should be.
    RecordingError
        If the recording cannot be read, or does not fit Kalibr's files; the message says where, and what to do.
    OptionError
        If `units` names no unit.
    """
    log = ReadLog(units=stated_units(units))
    board = read_target(target, log.notes)
    known = read_cameras(cam, log.notes)
    noise, stated = read_imus(imu, log.notes), imu_paths(imu)
    log.sources.extend(file_source(Path(file)) for file in (cam, *stated, target))
    folder = recording_folder(Path(path))
    imus = {
        name: read_imu(name, tables, noise.get(name), units=log.units, sources=log.sources, notes=log.notes)
        for name, tables in imu_files(folder).items()
    }
    log.notes.extend(
        f"{name} of {', '.join(file.name for file in stated)} has no samples here."
        for name in noise
        if name not in imus
    )
    cameras = folder_corners(folder, known, Path(cam).name, board, log)
    recording = Recording(imus=imus, cameras=cameras, sources=tuple(log.sources), assumptions=tuple(log.notes))
    return recording, board


def folder_corners(
    folder: Path, known: Mapping[str, CameraInput], cam: str, target: Target, log: ReadLog
) -> dict[str, CameraFrames]:
    """Return the cameras of a folder of tables of corners.

    Parameters
    ----------
    folder : as `recording_folder` returns it
    known : lens and image size of each camera
    cam : what says so, for messages
    target : the board
    log : units that were stated; the files that are read, and sentences on what was assumed, are added

    Raises
    ------
    RecordingError
        If the tables cannot be read, or do not fit the target or the cameras.
    """
    streams = corner_streams(folder)
    names = _in_both(streams, known, folder, cam, log)
    return {name: _frames(streams[name], known[name], target, log) for name in names}


def _in_both(
    streams: Mapping[str, CornerStream], known: Mapping[str, CameraInput], folder: Path, cam: str, log: ReadLog
) -> list[str]:
    """Return the cameras that have corners and intrinsics."""
    both = [name for name in known if name in streams]
    if not both:
        raise RecordingError(
            f"{folder}: there are corners of {', '.join(streams)}, but {cam} describes {', '.join(known)}. "
            "Rename one of them."
        )
    for name in known:
        if name not in streams:
            log.notes.append(f"{name} of {cam} has no corners here and was left out.")
    for name, stream in streams.items():
        if name not in known:
            log.notes.append(f"{stream.corners.name} was left out: {cam} does not describe {name}.")
    return both


def _frames(stream: CornerStream, known: CameraInput, target: Target, log: ReadLog) -> CameraFrames:
    table = read_corner_table(stream.corners, log.units.time)
    log.sources.append(table.file.source)
    log.notes.extend(table.notes)
    all_stamps = None
    if stream.frames is not None:
        all_stamps, source, note = read_frame_stamps(stream.frames, log.units.time)
        log.sources.append(source)
        log.notes.extend(text for text in (note,) if text)
    return camera_frames(table, all_stamps, known, target, log.notes)
