"""Where results go: the folder of a result, replaced as a whole."""

import os
import shutil
import tempfile
from collections.abc import Generator
from contextlib import contextmanager, suppress
from itertools import takewhile
from pathlib import Path

from ..errors import OutputError

RESULT_FILES = ("calibration.yaml", "report.html", "diagnostics.npz")
"""gnomon's own files in the folder of a result."""

CAMERA_FILES = (*RESULT_FILES, "camchain.yaml", "results-cam.txt")
"""The same of a calibration of cameras; the last two are Kalibr's."""

CAMERA_IMU_FILES = (*RESULT_FILES, "trajectory.txt", "camchain-imucam.yaml", "imu.yaml", "results-imucam.txt")
"""The same of a camera-IMU calibration; the last three are Kalibr's."""


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


@contextmanager
def result_folder(folder: Path, own: tuple[str, ...] = RESULT_FILES) -> Generator[Path]:
    """Give an empty folder to write into, and at the end move what is in it to `folder`.

    `folder` is made at once, so that a place that cannot be written is known before any work is done. What an earlier
    result left, files and folders that are named in `own`, is replaced, or removed where the new result has none; other
    files stay as they are. If anything goes wrong nothing changes.

    Raises
    ------
    OutputError
        If the folder cannot be made or written.
    """
    made = _missing(folder)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        staging = Path(tempfile.mkdtemp(prefix=".gnomon-", dir=folder))
    except OSError as error:
        _remove_empty(made)
        raise OutputError(
            f"{folder}: results cannot be written there ({error.strerror or error}). Choose another folder with -o."
        ) from error
    try:
        yield staging
        complete = sorted(staging.iterdir())
        for path in complete:
            if path.is_dir():
                _remove(folder / path.name)  # a folder cannot be replaced while there is something in it
            path.replace(folder / path.name)
        for name in set(own) - {path.name for path in complete}:
            _remove(folder / name)
    except BaseException as error:
        shutil.rmtree(staging, ignore_errors=True)
        _remove_empty(made)
        if isinstance(error, OSError):
            raise OutputError(
                f"{folder}: results cannot be written there ({error.strerror or error}). Nothing was changed."
            ) from error
        raise
    staging.rmdir()


def _remove(path: Path) -> None:
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


def _missing(folder: Path) -> list[Path]:
    """Return the folders that have to be made, innermost first."""
    return [path for path in (folder, *folder.parents) if not path.exists()]


def _remove_empty(folders: list[Path]) -> None:
    for path in folders:
        with suppress(OSError):
            path.rmdir()
