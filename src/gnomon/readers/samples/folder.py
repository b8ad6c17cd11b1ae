"""Format "folder": a dataset in the layout of EuRoC or Kalibr, a pair of files, or one single file."""

import re
from collections.abc import Sequence
from pathlib import Path

from ...errors import OptionError, RecordingError

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
    """Return the file, or the accelerometer and gyroscope files, that a folder holds.

    Raises
    ------
    RecordingError
        If there is no recording in the folder, or more than one.
    """
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
