"""A recording of cameras and IMUs in front of a board, with Kalibr's files that describe them."""

from collections.abc import Mapping
from os import PathLike
from pathlib import Path

from ...errors import RecordingError
from ...formats.kalibr.camchain import CameraInput
from ...formats.kalibr.target import read_target
from ...formats.sensor_inputs import ImuFiles, imu_paths, read_cameras, read_imus
from ...models.target import Target
from ...recording import CameraFrames, Recording
from ...units import Units
from ..files import file_source
from ..recordings import ReadLog
from .camera_folder import CornerStream, corner_streams, imu_files, recording_folder
from .corner_frames import camera_frames
from .corner_table import read_corner_table, read_frame_stamps
from .imu_stream import read_imu


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
    log = ReadLog(units=Units.parse(units) if isinstance(units, str) else units or Units())
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
