"""Where results go: the folder of a result, replaced as a whole."""

import os
import re
from collections.abc import Generator, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, suppress
from dataclasses import fields, is_dataclass
from itertools import takewhile
from pathlib import Path
from typing import Any

from ..errors import OutputError
from ..output import files_together, put_in_place, refuse_input, spare_inputs

RESULT_FILES = ("calibration.yaml", "report.html", "diagnostics.npz")
"""gnomon's own files in the folder of a result."""
CAMERA_FILES = (*RESULT_FILES, "camchain.yaml", "results-cam.txt")
"""The same of a calibration of cameras; the last two are Kalibr's."""
CAMERA_IMU_FILES = (*RESULT_FILES, "trajectory.txt", "camchain-imucam.yaml", "imu.yaml", "results-imucam.txt")
"""The same of a camera-IMU calibration; the last three are Kalibr's."""
NOISE_FILES = ("noise.yaml", "imu.yaml", "allan.csv", "report.html")
"""The same of noise that was identified."""
ALL_RESULT_FILES = frozenset((*CAMERA_FILES, *CAMERA_IMU_FILES, *NOISE_FILES))
DEMO_RECORDING = "recording.npz"
_TELLING = {
    "comparison.csv": "compare",
    "comparison.json": "compare",
    "verification.json": "verify",
    "study.html": "study",
    "runs.journal": "study",
}
"""File -> the command that alone makes it in the folder of a result."""
_RESULTS = ("calibration.yaml", "noise.yaml")
_METHOD = re.compile(r"(?m)^provenance:\n(?:[ #].*\n)*? +method: *['\"]?([a-z][a-z-]*)")
_COMMANDS = {"cameras": "camera"}
"""Method in a result's provenance -> its command, where that is called otherwise."""
SCENARIO, TRUTH = "scenario.yaml", "truth.yaml"
_TEXTS = ("calibrations", "cam", "prior", "rate", "use")
"""Fields of commands and of their options that may name files, or a folder with a calibration."""
_FILES = (".yaml", ".yml", ".json", ".html", ".csv", ".txt", ".npz", ".pdf", ".zip")
"""Endings that nobody gives to a folder."""


def default_folder(paths: Sequence[Path], command: str) -> Path:
    """Return the folder for what a command makes of a recording: its name with that of the command, beside it.

    Examples
    --------
    >>> default_folder((Path("flight.csv"),), "imu").name
    'flight-imu'
    >>> default_folder((Path("xsens_acc.mat.gz"), Path("xsens_gyro.mat.gz")), "noise").name
    'xsens-noise'
    >>> default_folder(tuple(Path(f"pose{k}.csv") for k in range(1, 4)), "imu").name
    'pose-imu'
    """
    first = Path(os.path.abspath(paths[0]))  # noqa: PTH100 - without following links: beside what was named
    names = [first.name if path.is_dir() else _stem(path.name) for path in paths]
    common = _common_start(names) if len(names) > 1 else ""
    shared = common.rstrip("-_. ")  # a word of its own, not the first letter of accelerometer and angular rate
    if len(names) > 2:  # one file a pose
        return first.with_name(f"{shared.rstrip('0') or 'poses'}-{command}")
    return first.with_name(f"{shared if shared != common and shared else names[0]}-{command}")


def joined_folder(paths: Sequence[Path], command: str) -> Path:
    """Return the folder for the result of several recordings, which is not that of any one of them.

    Examples
    --------
    >>> joined_folder((Path("run_1.csv"), Path("run_2.csv")), "imu").name
    'run-joined-imu'
    >>> joined_folder((Path("mon"), Path("tue")), "imu").name
    'mon-joined-imu'
    """
    first = Path(os.path.abspath(paths[0]))  # noqa: PTH100 - as above
    names = [first.name if path.is_dir() else _stem(path.name) for path in paths]
    return first.with_name(f"{_common_start(names).rstrip('-_. 0') or names[0]}-joined-{command}")


def _stem(name: str) -> str:
    stem = name.removesuffix(".gz")
    return stem.rsplit(".", 1)[0] or stem


def _common_start(names: list[str]) -> str:
    shared = [letters[0] for letters in takewhile(lambda letters: len(set(letters)) == 1, zip(*names, strict=False))]
    return "".join(shared)


def result_folder(folder: Path, command: str = "", own: tuple[str, ...] = RESULT_FILES) -> AbstractContextManager[Path]:
    """Give an empty folder to write a result into, which is moved to `folder` at the end; see `files_together`.

    Parameters
    ----------
    command : whose result it is, such as "camera-imu"; "" for what is no result, such as a simulated recording
    own : files of a result, which take the place of those of an earlier one

    Raises
    ------
    OutputError
        If a file is where the folder should be, or it holds the result of another command, besides what
        `files_together` raises.
    """
    check_folder(folder)
    if command:
        _check_owner(folder, command, own)
    return files_together(folder, own)


def _check_owner(folder: Path, command: str, own: tuple[str, ...]) -> None:
    """Refuse a folder whose result is of another command, or in which a file of nobody's would be replaced."""
    owner = owner_of(folder)
    if command == "demo" and owner == "imu" and (folder / TRUTH).is_file():
        owner = command  # gnomon imu keeps no truth beside its result
    other = default_folder((folder,), command)
    if owner not in ("", command):
        raise OutputError(
            f"{folder}: this folder holds a result of gnomon {owner}, and one folder holds the result of one command. "
            f"Choose another folder with -o, such as {other.name}."
        )
    there = [name for name in own if (folder / name).exists()]
    if there and not owner:
        raise OutputError(
            f"{folder}: the result would replace {', '.join(there)}, which gnomon {command} did not make as far as can "
            f"be told. Choose another folder with -o, such as {other.name}, or remove {_them(there)} first."
        )


def truth_name(folder: Path, recordings: Sequence[str]) -> str:
    """Return what the truth of simulated recordings is called in a folder, in which another one's truth may lie.

    Parameters
    ----------
    recordings : names of their files; the first one names the truth where another one's is there

    Examples
    --------
    >>> truth_name(Path("nowhere"), ["recording.npz"])
    'truth.yaml'
    """
    own = f"{_stem(recordings[0])}-{TRUTH}"
    again = any((folder / name).exists() for name in recordings) and not (folder / own).exists()
    return TRUTH if again or not (folder / TRUTH).exists() else own


def _them(names: list[str]) -> str:
    return "it" if len(names) == 1 else "them"


def owner_of(folder: Path) -> str:
    """Return the command whose result a folder holds, "" where it holds none that can be told."""
    for name, command in _TELLING.items():
        if (folder / name).is_file():
            return command
    for name in _RESULTS:
        if (folder / name).is_file():
            found = _METHOD.search((folder / name).read_text(encoding="utf-8", errors="replace"))
            return _COMMANDS.get(found[1], found[1]) if found else ""
    return ""


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


def recover_interrupted_write(command: object) -> None:
    """Put files in their places that a killed process left on the way, in the folders that a command names."""
    for path in set(_paths(command)):
        for folder in (path, path.parent):
            with suppress(OSError, OutputError):  # who writes there is told; who reads has no need to
                put_in_place(folder)


@contextmanager
def spared_inputs(command: object) -> Generator[None]:
    """Let nothing be written over what a command reads, and refuse pipes and devices, which can be read only once.

    Raises
    ------
    RecordingError
        If an input is a pipe or a device.
    OutputError
        If the file to write is an input, or lies in a folder that is one.
    """
    from ..output import refuse_special

    inputs = _inputs(command)
    for path in inputs:
        refuse_special(path)
    output: Path | None = getattr(command, "output", None)
    with spare_inputs(inputs):
        if output is not None and output.is_file():
            refuse_input(output)
            read = [path.resolve() for path in inputs if path.is_dir()]
            if not set(read).isdisjoint(output.resolve().parents):
                raise OutputError(
                    f"{output}: there is a file of this name in a folder that is read. Nothing was changed. Choose "
                    "another place with -o."
                )
        yield


def _inputs(command: object) -> list[Path]:
    """Return the files and folders that a command reads, those in texts (--prior, --for) too."""
    if not is_dataclass(command):
        return []
    given = [getattr(command, entry.name) for entry in fields(command) if entry.name != "output"]
    options = getattr(command, "options", None)
    texts: list[Any] = [getattr(holder, name, None) or () for holder in (command, options) for name in _TEXTS]
    words = [str(word) for text in texts for word in (text if isinstance(text, tuple) else (text,))]  # pyright: ignore
    named = [Path(part) for word in words for part in (word, *re.split(r"[=+]", word)) if part]
    folders = [path / "calibration.yaml" for path in named]
    return [*(path for node in given for path in _paths(node)), *filter(_exists, (*named, *folders))]


def _exists(path: Path) -> bool:
    try:
        return path.exists()
    except (OSError, ValueError):  # a text that is no path
        return False


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
