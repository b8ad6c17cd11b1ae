"""Recordings of one or of several files.

Format "folder": a dataset in the layout of EuRoC or Kalibr, a pair of files, or one single file.

Format "pose files": a file for each pose in which the sensor rested, all in one format, joined to one recording.
"""

import re
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np

from ...errors import OptionError, RecordingError
from ...recording import Integers, Piece
from .table import SampleTable, Triad

_LAYOUTS = ("mav0/imu0/data.csv", "imu0/data.csv", "data.csv", "imu0.csv")
_SUFFIXES = (".csv", ".txt", ".log", ".dat", ".tsv", ".mat", ".npz")
_ACCELEROMETER, _GYROSCOPE = re.compile(r"acc", re.IGNORECASE), re.compile(r"gyr", re.IGNORECASE)
_MAGNETOMETER = re.compile(r"magn", re.IGNORECASE)
_CORNERS = re.compile(r"cam\d+_(corners|frames)\.csv")
_CALIBRATION = ("calibration.yaml", "noise.yaml")
_BESIDE_IT = ("diagnostics.npz", "allan.csv", "trajectory.txt", "results-cam.txt", "results-imucam.txt")
"""Files of a result that look like samples."""


def recording_files(paths: Sequence[str | Path]) -> list[Path]:
    """Return the one file, or the accelerometer and gyroscope files, that the paths of a recording mean.

    Raises
    ------
    OptionError
        If there are too few or too many paths.
    RecordingError
        If the path is a folder that does not hold one recording.
    """
    files = [Path(path) for path in paths]
    if len(files) == 1 and files[0].is_dir():
        files = list(_recording_in(files[0]))
    for path in files:
        if path.suffix in (".yaml", ".yml", ".html") or _is_of_a_result(path):
            raise RecordingError(
                f"{path}: this belongs to a calibration and is no recording. Name the recording: a table, a bag, a log "
                "or a folder with one."
            )
    if not 1 <= len(files) <= 2 or (len(files) == 2 and any(path.is_dir() for path in files)):
        raise OptionError(
            f"{len(files)} paths given. Give one file, one folder, or an accelerometer file and a gyroscope file."
        )
    return files


def _recording_in(folder: Path) -> tuple[Path, ...]:
    """Return the file, or the accelerometer and gyroscope files, that a folder holds."""
    known = known_layout(folder)
    if known is not None:
        return (known,)
    files = sample_files(folder)
    pair = accelerometer_and_gyroscope(files)
    if pair is not None:
        return pair
    magnetometer = [path for path in files if _MAGNETOMETER.search(path.name)]
    if len(files) == 2 and len(magnetometer) == 1 and any(_ACCELEROMETER.search(path.name) for path in files):
        return files[0], files[1]
    if len(files) == 1:
        return (files[0],)
    if not files and any(_CORNERS.match(path.name) for path in folder.iterdir()):
        raise RecordingError(
            f"{folder}: this folder holds corners of cameras, for gnomon camera, and no samples of an IMU."
        )
    if not files and any((folder / name).is_file() for name in _CALIBRATION):
        raise RecordingError(
            f"{folder}: this folder holds a result, and no recording. Name the recording that it was made from; "
            f"gnomon show {folder} shows the result."
        )
    if not files:
        raise RecordingError(
            f"{folder}: no recording in this folder. Expected mav0/imu0/data.csv (EuRoC), imu0.csv (Kalibr), a pair of "
            f"files with acc and gyr in their names, or one file ({', '.join(_SUFFIXES)}, also gzipped)."
        )
    raise RecordingError(several_recordings(folder, files))


def several_recordings(folder: Path, files: Sequence[Path]) -> str:
    """Return what is to be said of a folder that holds several recordings."""
    listed = ", ".join(path.name for path in files[:8]) + (", ..." if len(files) > 8 else "")
    return (
        f"{folder}: {len(files)} files may be the recording ({listed}). Name the one to read. gnomon imu and gnomon "
        "temperature take several recordings of one sensor, each of them named."
    )


def known_layout(folder: Path) -> Path | None:
    """Return the file of samples of a folder in the layout of EuRoC or Kalibr, or None."""
    paths = (path for layout in _LAYOUTS for path in (folder / layout, folder / f"{layout}.gz"))
    return next((path for path in paths if path.is_file()), None)


def sample_files(folder: Path) -> list[Path]:
    """Return the files in a folder that may hold samples, by name."""
    return sorted(path for path in folder.iterdir() if path.is_file() and _is_candidate(path))


def accelerometer_and_gyroscope(files: list[Path]) -> tuple[Path, Path] | None:
    """Return the one file with acc and the one with gyr in its name, or None."""
    accelerometer = [path for path in files if _ACCELEROMETER.search(path.name) and not _GYROSCOPE.search(path.name)]
    gyroscope = [path for path in files if _GYROSCOPE.search(path.name) and not _ACCELEROMETER.search(path.name)]
    return (accelerometer[0], gyroscope[0]) if len(accelerometer) == len(gyroscope) == 1 else None


def _is_candidate(path: Path) -> bool:
    name = path.name.lower().removesuffix(".gz")
    return name.endswith(_SUFFIXES) and not (name.startswith(".") or _CORNERS.match(name) or _is_of_a_result(path))


def _is_of_a_result(path: Path) -> bool:
    return path.name in _BESIDE_IT and any(path.with_name(name).is_file() for name in _CALIBRATION)


FEWEST_FILES = 3
_BETWEEN_NS = 1_000_000_000  # between files whose clocks start anew
_LONGEST_NS = 86_400 * 1_000_000_000


def pose_files(paths: Sequence[str | Path]) -> list[Path] | None:
    """Return the files of poses, three or more paths or those in a folder; None where the paths mean something else.

    Files in a folder come in the order of their names, numbers in them counting as numbers: pose2 before pose10.
    """
    files = [Path(path) for path in paths]
    if len(files) == 1 and files[0].is_dir() and known_layout(files[0]) is None:
        found = sample_files(files[0])
        if any(".npz" in path.suffixes for path in found):
            return None
        if len(found) >= FEWEST_FILES and accelerometer_and_gyroscope(found) is None:
            return sorted(found, key=_by_number)
    return files if len(files) >= FEWEST_FILES else None


def _by_number(path: Path) -> list[tuple[int, str]]:
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in re.split(r"(\d+)", path.name.lower())]


def join_pose_tables(tables: list[SampleTable], names: list[str]) -> tuple[SampleTable, tuple[Piece, ...], list[str]]:
    """Return one table of all files, where each of them is in it, and what was assumed.

    Raises
    ------
    RecordingError
        If the files do not hold the same sensors in the same units.
    """
    like = _kinds(tables[0])
    for table, name in zip(tables, names, strict=True):
        if _kinds(table) != like:
            raise RecordingError(
                f"{name}: found {_listed(_kinds(table))}, but {names[0]} holds {_listed(like)}. Files of poses must "
                "all have the same columns. If they are no poses of one sensor, name the one file to read."
            )
    notes = _notes(tables, names)
    order, t_ns, note = _one_clock([table.t_ns for table in tables])
    tables, names = [tables[k] for k in order], [names[k] for k in order]
    edges = np.cumsum([0, *(len(table.t_ns) for table in tables)])
    triads = tuple(
        Triad(
            quantity=triad.quantity,
            values=np.concatenate([table.triads[k].values for table in tables]),
            unit=triad.unit,
        )
        for k, triad in enumerate(tables[0].triads)
    )
    pieces = tuple(
        Piece(name=name, start=int(a), stop=int(b)) for name, a, b in zip(names, edges[:-1], edges[1:], strict=True)
    )
    return SampleTable(t_ns=t_ns, triads=triads, notes=()), pieces, [*notes, note]


def _kinds(table: SampleTable) -> tuple[tuple[str, str | None], ...]:
    return tuple((triad.quantity, triad.unit) for triad in table.triads)


def _listed(kinds: tuple[tuple[str, str | None], ...]) -> str:
    return " and ".join(f"{quantity} in {unit}" if unit else quantity for quantity, unit in kinds)


def _notes(tables: list[SampleTable], names: list[str]) -> list[str]:
    """Return each note once, however many files it is of."""
    counts: dict[str, list[str]] = {}
    for table, name in zip(tables, names, strict=True):
        for note in table.notes:
            counts.setdefault(note.removeprefix(f"{name}: "), []).append(name)
    return [f"{_files(of, len(names))}: {note}" for note, of in counts.items()]


def _files(names: list[str], total: int) -> str:
    if len(names) == 1:
        return names[0]
    return "all files" if len(names) == total else f"{names[0]} and {len(names) - 1} more"


def _one_clock(stamps: list[Integers]) -> tuple[list[int], Integers, str]:
    """Return the order of the files in time, their timestamps on one clock [ns], and what was assumed."""
    order = sorted(range(len(stamps)), key=lambda k: int(stamps[k][0]))
    ordered = [stamps[k] for k in order]
    follow = all(int(a[-1]) < int(b[0]) for a, b in pairwise(ordered))
    if follow and int(ordered[-1][-1]) - int(ordered[0][0]) < _LONGEST_NS:
        return order, np.concatenate(ordered), f"{len(stamps)} files, one pose each, in the order of their timestamps."
    shifted: list[Integers] = []
    begin = 0
    for t_ns in stamps:
        shifted.append(t_ns - t_ns[0] + begin)
        begin = int(shifted[-1].max()) + _BETWEEN_NS
    return (
        list(range(len(stamps))),
        np.concatenate(shifted),
        f"{len(stamps)} files, one pose each, whose clocks start anew: they are taken to follow each other as given.",
    )
