"""Which tables of a recording with images hold the samples of its IMUs."""

import re
from pathlib import Path

from ...errors import RecordingError
from ..files import NPZ_MAGIC, first_bytes, read_text
from ..samples.column_roles import roles
from ..samples.text_table import sniff
from .camera_folder import imu_files

_TABLE = re.compile(r".*\.(csv|txt|tsv|dat|log|npz)(\.gz)?", re.IGNORECASE)
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
    return _TABLE.fullmatch(path.name) is not None and not path.name.startswith(".") and path.is_file()


def _triads(path: Path) -> int:
    """Return how many triads of a sensor a table holds; zero where it is something else."""
    try:
        if first_bytes(path).startswith(NPZ_MAGIC):
            return 2 if "imu" in path.name.lower() else 0
        file = read_text(path)
        found = roles(sniff(file), None, file.name)
    except RecordingError:
        return 0
    return sum(triad.quantity != "magnetometer" for triad in found.triads) if found.time else 0
