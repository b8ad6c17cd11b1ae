"""Where results go: the folder of a result, replaced as a whole."""

import os
from collections.abc import Iterator
from contextlib import AbstractContextManager, suppress
from dataclasses import fields, is_dataclass
from itertools import takewhile
from pathlib import Path

from ..errors import OutputError
from ..output import files_together, put_in_place

RESULT_FILES = ("calibration.yaml", "report.html", "diagnostics.npz")
"""gnomon's own files in the folder of a result."""

CAMERA_FILES = (*RESULT_FILES, "camchain.yaml", "results-cam.txt")
"""The same of a calibration of cameras; the last two are Kalibr's."""

CAMERA_IMU_FILES = (*RESULT_FILES, "trajectory.txt", "camchain-imucam.yaml", "imu.yaml", "results-imucam.txt")
"""The same of a camera-IMU calibration; the last three are Kalibr's."""

_FILES = (".yaml", ".yml", ".json", ".html", ".csv", ".txt", ".npz", ".pdf", ".zip")
"""Endings that nobody gives to a folder."""


def default_folder(paths: tuple[Path, ...]) -> Path:
    """Return the folder for the result of a recording: its name with -gnomon, beside it.

    Examples
    --------
    >>> default_folder((Path("flight.csv"),)).name
    'flight-gnomon'
    >>> default_folder((Path("xsens_acc.mat.gz"), Path("xsens_gyro.mat.gz"))).name
    'xsens-gnomon'
    >>> default_folder(tuple(Path(f"pose{k}.csv") for k in range(1, 4))).name
    'pose-gnomon'
    """
    first = Path(os.path.abspath(paths[0]))  # noqa: PTH100 - without following links: beside what was named
    names = [first.name if path.is_dir() else _stem(path.name) for path in paths]
    common = _common_start(names) if len(names) > 1 else ""
    shared = common.rstrip("-_. ")  # a word of its own, not the first letter of accelerometer and angular rate
    if len(names) > 2:  # one file a pose
        return first.with_name(f"{shared.rstrip('0') or 'poses'}-gnomon")
    return first.with_name(f"{shared if shared != common and shared else names[0]}-gnomon")


def _stem(name: str) -> str:
    stem = name.removesuffix(".gz")
    return stem.rsplit(".", 1)[0] or stem


def _common_start(names: list[str]) -> str:
    shared = [letters[0] for letters in takewhile(lambda letters: len(set(letters)) == 1, zip(*names, strict=False))]
    return "".join(shared)


def result_folder(folder: Path, own: tuple[str, ...] = RESULT_FILES) -> AbstractContextManager[Path]:
    """Give an empty folder to write a result into, which is moved to `folder` at the end; see `files_together`.

    Raises
    ------
    OutputError
        If a file is where the folder should be, besides what `files_together` raises.
    """
    check_folder(folder)
    return files_together(folder, own)


def check_folder(folder: Path) -> None:
    """Check that files can go into a folder of this name.

    Raises
    ------
    OutputError
        If there is a file of its name, or of that of a folder around it, or the name is new and one of a file.
    """
    there = next((path for path in (folder, *folder.parents) if path.exists()), folder)
    if there.exists() and not there.is_dir():
        raise OutputError(
            f"{there}: this is a file, and several files are written here, which need a folder. Name a folder with -o; "
            "it is made where there is none."
        )
    if not folder.exists() and folder.suffix.lower() in _FILES:
        raise OutputError(
            f"{folder}: several files are written here, which need a folder, and this is the name of a file. Name a "
            f"folder with -o, such as {folder.with_suffix('')}."
        )


def finish_moves(command: object) -> None:
    """Put files in their places that a killed process left on the way, in the folders that a command names."""
    for path in set(_paths(command)):
        for folder in (path, path.parent):
            with suppress(OSError, OutputError):  # who writes there is told; who reads has no need to
                put_in_place(folder)


def _paths(node: object) -> Iterator[Path]:
    """Yield the paths in a command's fields."""
    if isinstance(node, Path):
        yield node
    elif isinstance(node, tuple):
        for item in node:  # pyright: ignore[reportUnknownVariableType]
            yield from _paths(item)  # pyright: ignore[reportUnknownArgumentType]
    elif is_dataclass(node):
        for entry in fields(node):
            yield from _paths(getattr(node, entry.name))
