"""A calibration wherever it lies: a file of gnomon's or of another project, several of them, or a result's folder."""

import re
from collections.abc import Sequence
from os import PathLike
from pathlib import Path

from ...calibration import Calibration
from ...errors import FormatError
from ..projects.foreign import ForeignCalibration
from ..projects.foreign_files import is_own, load_foreign
from .calibration_file import load
from .noise_file import is_noise

OWN_FILE = "calibration.yaml"
_KALIBR = ("camchain-imucam.yaml", "imu.yaml", "results-imucam.txt")
_SUFFIXES = {".yaml", ".yml", ".json", ".txt", ".calib", ".csv", ".params", ".parm", ".param"}
_LARGEST = 4_000_000  # bytes of a calibration file; tables of samples are passed over
_MOST_FILES = 200
_SHOWN = 5  # folders that a message names

AnyPath = str | PathLike[str]


def load_any(*paths: AnyPath) -> Calibration | ForeignCalibration:
    """Read a calibration, gnomon's own or another project's.

    Parameters
    ----------
    paths : a calibration.yaml; files of one calibration of another project; or one folder: gnomon's result, what Kalibr
        wrote of one calibration, or a folder in which everything else that is a calibration file belongs together

    Raises
    ------
    FormatError
        If there is no such file, it cannot be read, is no calibration, or what several say contradicts each other.
    """
    files = [Path(path) for path in paths]
    if len(files) == 1 and files[0].is_dir():
        files = files_of_folder(files[0])
    for path in files:
        if path.is_dir():
            raise FormatError(f"{path}: this is a folder, which cannot be joined with files. Name the files in it.")
        if not path.is_file():
            raise FormatError(f"{path}: there is no such file or folder.")
    own = [path for path in files if is_own(path)]
    if not own:
        return load_foreign(*files)
    if len(files) > 1:
        raise FormatError(f"{own[0]}: gnomon's own calibration is one file and cannot be joined with others.")
    if is_noise(own[0]):
        raise FormatError(f"{own[0]}: this holds noise only. Give a calibration.yaml.")
    return load(own[0])


def files_of_folder(folder: Path) -> list[Path]:
    """Return the files of the one calibration in a folder.

    Raises
    ------
    FormatError
        If there is none, or there are several.
    """
    if (folder / OWN_FILE).is_file():
        return [folder / OWN_FILE]
    for first in _KALIBR[::2]:
        chains = sorted(folder.glob(f"*{first}"))
        if len(chains) > 1:
            raise FormatError(
                f"{folder}: there are several calibrations, {', '.join(path.name for path in chains)}. Name the files "
                f"of one, joined by +, such as {chains[0]}+{folder / chains[0].name.replace(first, _KALIBR[1])}."
            )
        if chains:
            prefix = chains[0].name.removesuffix(first)
            return [path for name in _KALIBR if (path := folder / f"{prefix}{name}").is_file()]
    candidates = _candidates(folder)
    own = [path for path in candidates if _is_own_calibration(path)]
    found = own if len(own) == 1 else [path for path in candidates if _readable(path)]
    if not found:
        inside = sorted(path.name for path in folder.iterdir() if path.is_dir())
        which = f"one of the folders in it ({', '.join(inside[:_SHOWN])})" if inside else "a calibration.yaml"
        raise FormatError(f"{folder}: there is no calibration file in this folder. Name {which}.")
    return found


def _candidates(folder: Path) -> list[Path]:
    files = (path for path in sorted(folder.iterdir()) if path.suffix.lower() in _SUFFIXES and path.is_file())
    return [path for path in files if path.stat().st_size <= _LARGEST][:_MOST_FILES]


def _is_own_calibration(path: Path) -> bool:
    try:
        return is_own(path) and not is_noise(path)
    except FormatError:  # no text
        return False


def _readable(path: Path) -> bool:
    try:
        found = load_foreign(path)
    except FormatError:
        return False
    return bool(found.imus or found.cameras or found.lenses)


_RESULT_OF = re.compile(r"-(gnomon|imu|camera|camera-imu|turntable|magnetometer|noise)$")
"""How the folder of a result ends that is named after its recording and its command."""


def source_names(sources: Sequence[Sequence[AnyPath]]) -> list[str]:
    """Return a short name for each source, by where their paths differ.

    Examples
    --------
    >>> source_names([["run1-camera-imu/calibration.yaml"], ["kalibr/scale-misalignment"]])
    ['run1', 'scale-misalignment']
    >>> source_names([["a/kalibr"], ["b/kalibr"]])
    ['a', 'b']
    """
    whole = [_telling_parts(Path(source[0])) for source in sources]
    short = [[*parts[:-1], _RESULT_OF.sub("", parts[-1]) or parts[-1]] for parts in whole]
    parts = short if len(set(map(tuple, short))) == len(set(map(tuple, whole))) else whole
    names = ["" for _ in parts]
    for i, own in enumerate(parts):
        for length in range(1, len(own) + 1):
            tail = own[-length:]
            if sum(other[-length:] == tail for other in parts) == 1:
                names[i] = tail[0] if sum(tail[0] in other for other in parts) == 1 else "/".join(tail)
                break
        names[i] = names[i] or "/".join(own)
    return names


def _telling_parts(path: Path) -> list[str]:
    """Return the parts of a path that tell a calibration, without what all results are called."""
    parts = [part for part in path.parts if part not in {"/", "\\", ".", ".."}] or [path.absolute().name]
    if len(parts) > 1 and parts[-1] == OWN_FILE:
        parts = parts[:-1]
    return parts
