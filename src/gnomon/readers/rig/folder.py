"""A folder of cameras and IMUs: which files are which stream, the samples, and what was recorded before a board.

Streams are told by the names of their files, tables of samples by their content, too. Samples are given in SI units and
in the order of time. Where corners were detected already, the folder is read as a recording: with Kalibr's files that
describe cameras, IMUs and board, or of its timestamps alone.
"""

import re
from collections.abc import Mapping
from dataclasses import replace
from os import PathLike
from pathlib import Path

import numpy as np

from ...errors import RecordingError
from ...formats.kalibr.camchain import CameraInput
from ...formats.kalibr.imu import ImuInput
from ...formats.kalibr.target import read_target
from ...formats.sensor_inputs import ImuFiles, imu_paths, read_cameras, read_imus
from ...frozen import value_class
from ...models.target import Target
from ...recording import CameraFrames, ImuSamples, Integers, Recording, Source, TriadSamples
from ...units import ACCELEROMETER_UNITS_M_S2, GYROSCOPE_UNITS_RAD_S, Units
from ..files import NPZ_MAGIC, file_source, first_bytes, read_text_file
from ..recordings import ReadLog, read_recognising, stated_units
from ..samples.column_names import column_roles
from ..samples.recognise import HELP, IN_MOTION, TRIAL
from ..samples.table import RATE_HELP, stray_timestamp
from ..samples.text_table import sniff_layout
from .corner_table import camera_frames, read_corner_table, read_frame_stamps

_TABLE = r"\.(csv|txt|tsv|dat)(\.gz)?"
_CORNERS = re.compile(rf"(cam\d+)[-_/]corners{_TABLE}", re.IGNORECASE)
_FRAMES = re.compile(rf"(cam\d+)[-_/]frames{_TABLE}", re.IGNORECASE)
_IMU = re.compile(rf"(imu\d*)(/data)?({_TABLE}|\.log|\.npz)", re.IGNORECASE)
_TRIADS = tuple(re.compile(rf"(imu\d*)[-_/]{word}[a-z]*({_TABLE}|\.log)", re.IGNORECASE) for word in ("acc", "gyr"))
_EXPECTED = "cam0_corners.csv (ts_ns,tag_id,corner_idx,u_px,v_px), cam1_corners.csv, ... and imu0.csv, also gzipped"


@value_class(eq=True)
class CornerStream:
    """Files of one camera whose corners were detected beforehand.

    Attributes
    ----------
    corners : table with one row a corner
    frames : table with one row a frame, also of frames without corners; None where there is none
    """

    corners: Path
    frames: Path | None


def corner_streams(folder: Path) -> dict[str, CornerStream]:
    """Return the cameras, "cam0", "cam1", ..., whose corners are in a folder.

    Raises
    ------
    RecordingError
        If there are none.
    """
    corners, frames = _matching(folder, _CORNERS, r"cam\d+"), _matching(folder, _FRAMES, r"cam\d+")
    if corners:
        return {name: CornerStream(corners=path, frames=frames.get(name)) for name, path in corners.items()}
    raise RecordingError(f"{folder}: no corners of a camera in this folder. Expected {_EXPECTED}.")


def holds_corners(folder: Path) -> bool:
    """Tell whether a folder holds tables of corners that were detected beforehand."""
    return bool(_matching(folder, _CORNERS, r"cam\d+"))


def imu_files(folder: Path) -> dict[str, tuple[Path, ...]]:
    """Return the IMUs, "imu0", "imu1", ..., whose samples are in a folder.

    Returns
    -------
    name -> its table; or those of accelerometer and gyroscope, such as imu0-acc.csv and imu0-gyr.csv

    Raises
    ------
    RecordingError
        If there are none.
    """
    found = _imu_files(folder)
    if not found:
        raise RecordingError(f"{folder}: no samples of an IMU in this folder. Expected {_EXPECTED}.")
    return found


def folder_holds_imu(folder: Path) -> bool:
    """Tell whether a folder of corners holds samples of an IMU, too."""
    return bool(_imu_files(folder))


def _imu_files(folder: Path) -> dict[str, tuple[Path, ...]]:
    whole, accelerometer, gyroscope = (_matching(folder, pattern, r"imu\d*") for pattern in (_IMU, *_TRIADS))
    pairs = {name: (accelerometer[name], gyroscope[name]) for name in accelerometer if name in gyroscope}
    found = pairs | {name: (path,) for name, path in whole.items()}
    named = {("imu0" if name == "imu" else name): files for name, files in found.items()}
    return dict(sorted(named.items(), key=lambda item: (len(item[0]), item[0])))


def recording_folder(path: Path) -> Path:
    """Return the folder of a recording; of EuRoC's layout the folder mav0 in it.

    Raises
    ------
    RecordingError
        If it is no folder.
    """
    if path.is_dir():
        return path / "mav0" if (path / "mav0").is_dir() else path
    problem = (
        "this is a file, and the recording of a camera and an IMU is a folder" if path.exists() else "no such folder"
    )
    raise RecordingError(f"{path}: {problem}. Expected a folder with {_EXPECTED}.")


def _matching(folder: Path, pattern: re.Pattern[str], inside: str = "") -> dict[str, Path]:
    """Return name -> file, in the order of their numbers; of the same stream twice the shorter name, unpacked.

    Folders whose names match `inside` are looked into; those of images may hold very many files.
    """
    found: dict[str, Path] = {}
    for path in sorted(folder.iterdir()):
        inner = [path]
        if path.is_dir():
            looked_into = re.fullmatch(inside, path.name, re.IGNORECASE) is not None
            inner = sorted(path.glob("*")) + sorted(path.glob("data/*")) if looked_into else []
        for file in inner:
            match = pattern.fullmatch(file.relative_to(folder).as_posix())
            if match and file.is_file():
                found.setdefault(match[1].lower(), file)
    return dict(sorted(found.items(), key=lambda item: (len(item[0]), item[0])))


_IMU_TABLE = re.compile(r".*\.(csv|txt|tsv|dat|log|npz)(\.gz)?", re.IGNORECASE)
_PAIR = (re.compile(r"acc", re.IGNORECASE), re.compile(r"gyr", re.IGNORECASE))
EXPECTED = "imu0.csv or imu0/data.csv, with the first line ts_ns,wx,wy,wz,ax,ay,az"


def imu_tables(root: Path, others: set[Path]) -> dict[str, tuple[Path, ...]]:
    """Return the tables of each IMU, "imu0", "imu1", ..., of a folder: by their names, else by their content.

    Parameters
    ----------
    root : the folder
    others : tables in it that are something else

    Returns
    -------
    name -> one table, or those of accelerometer and gyroscope; empty where there are none

    Raises
    ------
    RecordingError
        If several tables may be the IMU's.
    """
    named = _named(root)
    if named:
        return named
    tables = [path for path in sorted(root.iterdir()) if _is_table(path) and path not in others]
    return _pair(tables) or _only([path for path in tables if _triads(path) == 2], root)


def imu_tables_beside(video: Path, others: set[Path]) -> dict[str, tuple[Path, ...]]:
    """Return the tables of each IMU beside a video: called imu0, imu1, ..., or after the video.

    Raises
    ------
    RecordingError
        If several tables may be the IMU's.
    """
    own = [
        path
        for path in sorted(video.parent.iterdir())
        if path.name.startswith(video.stem) and _is_table(path) and path not in others
    ]
    both = [path for path in own if _triads(path) == 2]
    return _pair(own) or _only(both, video.parent) or _named(video.parent)


def _pair(tables: list[Path]) -> dict[str, tuple[Path, ...]]:
    """Return the tables of accelerometer and gyroscope, where there is just one of each."""
    pair = [[path for path in tables if word.search(path.name) and _triads(path) == 1] for word in _PAIR]
    if [len(files) for files in pair] == [1, 1] and pair[0] != pair[1]:
        return {"imu0": (pair[0][0], pair[1][0])}
    return {}


def _named(root: Path) -> dict[str, tuple[Path, ...]]:
    try:
        return imu_files(root)
    except RecordingError:
        return {}


def _only(found: list[Path], root: Path) -> dict[str, tuple[Path, ...]]:
    if len(found) > 1:
        listed = ", ".join(path.name for path in found[:6]) + (", ..." if len(found) > 6 else "")
        raise RecordingError(f"{root}: {len(found)} tables may be the IMU's ({listed}). Name the right one imu0.csv.")
    return {"imu0": (found[0],)} if found else {}


def _is_table(path: Path) -> bool:
    return _IMU_TABLE.fullmatch(path.name) is not None and not path.name.startswith(".") and path.is_file()


def _triads(path: Path) -> int:
    """Return how many triads of a sensor a table holds; zero where it is something else."""
    try:
        if first_bytes(path).startswith(NPZ_MAGIC):
            return 2 if "imu" in path.name.lower() else 0
        file = read_text_file(path)
        found = column_roles(sniff_layout(file), None, file.name)
    except RecordingError:
        return 0
    return sum(triad.quantity != "magnetometer" for triad in found.triads) if found.time else 0


# ---- the samples of an IMU ----

_RATE_TOLERANCE = 0.05
_HEADER = "Name the columns in the first line, such as ts_ns,wx,wy,wz,ax,ay,az (ts_ns in nanoseconds)."


def read_imu(
    name: str,
    files: tuple[Path, ...],
    known: ImuInput | None,
    *,
    units: Units,
    sources: list[Source],
    notes: list[str],
) -> ImuSamples:
    """Read the samples of one IMU that moved all the time.

    Parameters
    ----------
    name : "imu0", "imu1", ...
    files : its table, or those of accelerometer and gyroscope
    known : what is stated of it, or None
    units : as stated; recognised where they are not
    sources : where the files that were read are appended
    notes : where sentences on what was assumed are appended

    Returns
    -------
    both triads in m/s^2 and rad/s, in the order of time

    Raises
    ------
    RecordingError
        If the samples cannot be read, are raw counts, lack a triad, or their clock was set anew.
    """
    try:
        recording = read_recognising(IN_MOTION, *files, units=units)
    except RecordingError as error:  # there are no options here for tables that say too little
        text = re.sub(TRIAL.format('[^"]*', "[^.]*"), "", _in_place(str(error), files))
        raise RecordingError(
            text.partition(RATE_HELP)[0].replace(HELP, _HEADER) + (_HEADER if RATE_HELP in text else "")
        ) from None
    sources.extend(replace(source, name=_in_place(source.name, files)) for source in recording.sources)
    said = [_in_place(note, files) for note in recording.assumptions]
    notes.extend(note if name == "imu0" else f"{name}: {note}" for note in said)
    samples = recording.imus["imu0"]
    file = _in_place(files[0].name, files)
    if not len(samples.gyroscope):
        raise RecordingError(f"{file}: found no gyroscope; both triads of the IMU are needed.")
    accelerometer = in_order(_si(samples.accelerometer, "accelerometer", file, notes), name, notes)
    gyroscope = in_order(_si(samples.gyroscope, "gyroscope", _in_place(files[-1].name, files), notes), name, notes)
    if known is None:
        return ImuSamples(accelerometer=accelerometer, gyroscope=gyroscope)
    stated, found = known.update_rate_hz, gyroscope.rate_hz
    if stated is not None and abs(found / stated - 1) > _RATE_TOLERANCE:
        notes.append(
            f"{name}: its samples come at {found:.4g} Hz, not at the stated update_rate of {stated:g} Hz; "
            "the noise densities do not depend on it."
        )
    return with_stated(ImuSamples(accelerometer=accelerometer, gyroscope=gyroscope), known)


def with_stated(samples: ImuSamples, known: ImuInput) -> ImuSamples:
    """Return samples with what is stated of their IMU; the topic of a bag stays."""
    return replace(
        samples,
        noise=known.noise,
        topic=samples.topic or known.topic,
        T_imu_body=known.T_imu_body,
        time_shift_s=known.time_shift_s,
    )


def _in_place(text: str, files: tuple[Path, ...]) -> str:
    """Return a text that begins with the name of a file, with the folder before it that tells whose data.csv it is."""
    named = next((file for file in files if text.startswith(file.name)), None)
    return text if named is None or named.stem != "data" else f"{named.parent.name}/{text}"


def _si(samples: TriadSamples, sensor: str, file: str, notes: list[str]) -> TriadSamples:
    """Return samples in m/s^2 or rad/s."""
    table = ACCELEROMETER_UNITS_M_S2 if sensor == "accelerometer" else GYROSCOPE_UNITS_RAD_S
    si = next(iter(table))
    factor = table[samples.unit]
    if factor is None:
        raise RecordingError(
            f"{file}: the {sensor} is in raw counts, but m/s^2 and rad/s are needed here. If it is in another "
            'unit, state it, for example --units "g deg/s". If these are counts, calibrate the IMU alone first '
            "(gnomon imu) and convert the samples with that (gnomon apply)."
        )
    if factor == 1:
        return replace(samples, unit=si)
    notes.append(f"{file}: the {sensor} was converted from {samples.unit} to {si}.")
    return replace(samples, values=samples.values * factor, unit=si)


def in_order(samples: TriadSamples, name: str, notes: list[str]) -> TriadSamples:
    """Return samples in the order of time; of those that share a timestamp the order of the file stays.

    Parameters
    ----------
    samples : one triad
    name : of the IMU, for messages
    notes : where a sentence on samples that were sorted is appended, once for both triads

    Raises
    ------
    RecordingError
        If a timestamp is far from all others, or the clock was set anew.
    """
    far = stray_timestamp(samples.t_ns)
    if far is not None:
        raise RecordingError(
            f"{name}: the timestamp of sample {far}, {samples.t_ns[far]} ns, is more than half a day from the middle "
            f"of the others, {int(np.median(samples.t_ns))} ns. Fix or remove this sample."
        )
    steps = np.diff(samples.t_ns)
    backward = np.flatnonzero(steps < 0)
    if not len(backward):
        return samples
    order = np.argsort(samples.t_ns, kind="stable")
    # Samples that were only out of order make few breaks; two times that ran side by side make one at every sample.
    if np.count_nonzero(np.diff(order) != 1) > 3 * len(backward):
        first = int(backward[0])
        raise RecordingError(
            f"{name}: the timestamps jump back by {-steps[first] * 1e-9:.6g} s after sample {first} and then run "
            "through times that were there before. The clock was set anew: cut the recording there."
        )
    note = f"{name}: the timestamps go back at {len(backward)} of {len(samples)} samples, which were sorted."
    if note not in notes:  # both triads mostly share their timestamps
        notes.append(note)
    return replace(samples, t_ns=samples.t_ns[order], values=samples.values[order])


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
