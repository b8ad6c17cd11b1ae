"""The files of a command: those that its line names, those beside a recording, and the folder of its result."""

import os
import re
from collections.abc import Generator, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, suppress
from dataclasses import dataclass, replace
from functools import reduce
from itertools import takewhile
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import OptionError, OutputError, RecordingError
from ..models.lens_names import PROGRAMS
from ..output import files_together, put_in_place, refuse_input, refuse_special, spare_inputs
from .arguments import Entry, command_entries
from .command import Command

if TYPE_CHECKING:
    from ..options.requirements import Use
    from ..recording import Recording, Source
    from ..recording.samples import ImuNoise
    from ..results.calibration import Calibration


RESULT_FILES = ("calibration.yaml", "report.html", "diagnostics.npz")
"""gnomon's own files in the folder of a result."""
CAMERA_FILES = (*RESULT_FILES, "camchain.yaml", "results-cam.txt")
"""The same of a calibration of cameras; the last two are Kalibr's."""
CAMERA_IMU_FILES = (*RESULT_FILES, "trajectory.txt", "camchain-imucam.yaml", "imu.yaml", "results-imucam.txt")
"""The same of a camera-IMU calibration; the last three are Kalibr's."""
NOISE_FILES = ("noise.yaml", "imu.yaml", "allan.csv", "report.html")
"""The same of noise that was identified."""
ALL_RESULT_FILES = frozenset((*CAMERA_FILES, *CAMERA_IMU_FILES, *NOISE_FILES))
DEMO_RECORDING, TRUTH = "recording.npz", "truth.yaml"
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
_TEXTS = ("calibrations", "cam", "prior", "rate", "use")
"""Fields of commands and of their options that may name files, or a folder with a calibration."""
_FILES = (".yaml", ".yml", ".json", ".html", ".csv", ".txt", ".npz", ".pdf", ".zip")
"""Endings that nobody gives to a folder."""


def default_folder(paths: Sequence[Path], command: str, *, joined: bool = False) -> Path:
    """Return the folder for what a command makes of a recording: its name with that of the command, beside it.

    Parameters
    ----------
    joined : whether the paths are several recordings; their result is not that of any one of them

    Examples
    --------
    >>> default_folder((Path("flight.csv"),), "imu").name
    'flight-imu'
    >>> default_folder((Path("xsens_acc.mat.gz"), Path("xsens_gyro.mat.gz")), "noise").name
    'xsens-noise'
    >>> default_folder(tuple(Path(f"pose{k}.csv") for k in range(1, 4)), "imu").name
    'pose-imu'
    >>> default_folder((Path("run_1.csv"), Path("run_2.csv")), "imu", joined=True).name
    'run-joined-imu'
    >>> default_folder((Path("mon"), Path("tue")), "imu", joined=True).name
    'mon-joined-imu'
    """
    first = Path(os.path.abspath(paths[0]))  # noqa: PTH100 - without following links: beside what was named
    names = [first.name if path.is_dir() else file_stem(path.name) for path in paths]
    common = _common_start(names) if len(names) > 1 else ""
    shared = common.rstrip("-_. ")  # a word of its own, not the first letter of accelerometer and angular rate
    if joined:
        name = f"{common.rstrip('-_. 0') or names[0]}-joined"
    elif len(names) > 2:  # one file a pose
        name = shared.rstrip("0") or "poses"
    else:
        name = shared if shared != common and shared else names[0]
    return first.with_name(f"{name}-{command}")


def file_stem(name: str) -> str:
    """Return the name of a file without its ending, and without .gz."""
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


@dataclass(frozen=True, kw_only=True)
class PriorFiles:
    """What the files of --prior say.

    Attributes
    ----------
    stated : what was no file: NAME=SIGMA
    calibrations : of the sensor
    noise : of the IMU, or None
    sources : the files
    """

    stated: tuple[str, ...]
    calibrations: "tuple[Calibration, ...]" = ()
    noise: "ImuNoise | None" = None
    sources: "tuple[Source, ...]" = ()

    def known_of(self, recording: "Recording") -> "Recording":
        """Return the recording with the IMU's noise, and with the files among its sources."""
        known = self.noted_in(recording)
        return replace(known, sources=(*known.sources, *self.sources))

    def noted_in(self, recording: "Recording") -> "Recording":
        """Return the recording with the IMU's noise, where a file states it."""
        if self.noise is None:
            return recording
        imus = {name: replace(samples, noise=self.noise) for name, samples in recording.imus.items()}
        return replace(recording, imus=imus)


def read_priors(prior: tuple[str, ...]) -> PriorFiles:
    """Read the files among the values of --prior.

    Raises
    ------
    OptionError
        If a value is neither NAME=SIGMA nor a file, or two files state the noise.
    FormatError
        If a file cannot be read.
    """
    stated = tuple(text for text in prior if "=" in text and not Path(text).exists())
    files = [Path(text) for text in prior if text not in stated]
    if not files:
        return PriorFiles(stated=stated)
    from ..formats.own.calibration_file import load
    from ..readers.files import file_source

    calibrations: list[Calibration] = []
    noises: list[ImuNoise] = []
    for path in files:
        if not path.is_file():
            raise OptionError(
                f"--prior {path}: there is no such file. Give a calibration.yaml, a noise.yaml, Kalibr's imu.yaml, or "
                "NAME=SIGMA, such as imu0.gyroscope.bias=0.01."
            )
        noise = _noise(path)
        if noise is not None:
            noises.append(noise)
            continue
        calibrations.append(load(path))
        if not calibrations[-1].imus:
            raise OptionError(
                f"--prior {path}: this calibration is of cameras alone. Give it to gnomon camera-imu as --cam."
            )
    if len(noises) > 1:
        raise OptionError("--prior states the noise of the IMU in two files. Keep one of them.")
    return PriorFiles(
        stated=stated,
        calibrations=tuple(calibrations),
        noise=noises[0] if noises else None,
        sources=tuple(file_source(path) for path in files),
    )


def _noise(path: Path) -> "ImuNoise | None":
    """Return the noise that a file states, or None where it is no such file."""
    from ..formats.foreign_files import is_own
    from ..formats.own.calibration_text import is_noise
    from ..formats.own.noise_file import load_noise

    if is_noise(path):
        return load_noise(path).imu_noise()
    if is_own(path):
        return None
    from ..formats.sensor_inputs import read_imus

    return next(iter(read_imus(path, []).values())).noise


def read_use_option(use: str | None) -> "Use | None":
    """Return what a use needs; None where none is stated. Called before the work, so that typing errors cost none.

    Raises
    ------
    OptionError
        If there is no such use; FormatError where its file is not as it should be.
    """
    if use is None:
        return None
    if use in PROGRAMS and not Path(use).exists():
        raise OptionError(
            f"--for {use}: this is a program, and here a use is stated, such as vio. gnomon camera --for {use} chooses "
            f"lenses that it reads, gnomon convert --to {use} writes its files."
        )
    from ..calibrate.judging import stated_use

    return stated_use(use)


_BESIDE = {"cam": "camchain.yaml", "imu": "imu.yaml", "target": "target.yaml"}
"""Option -> Kalibr's file that is taken from the recording's folder."""
_INSIDE = {"cam": ("calibration.yaml", "camchain.yaml"), "imu": ("imu.yaml",), "target": ("target.yaml",)}
"""Option -> what is meant of a folder that it names, such as that of a result."""


def files_beside(
    recording: Path, stated: Mapping[str, Path | tuple[Path, ...] | None]
) -> tuple[dict[str, Any], tuple[str, ...]]:
    """Return Kalibr's files by the option that names them, as stated or beside a recording, and what was taken.

    Parameters
    ----------
    stated : option, such as "cam" -> its value
    """
    folder = recording if recording.is_dir() else recording.parent
    files: dict[str, Any] = {option: _file_inside(option, path) or None for option, path in stated.items()}
    taken = [option for option, path in files.items() if path is None and (folder / _BESIDE[option]).is_file()]
    files |= {option: folder / _BESIDE[option] for option in taken}
    *first, last = [_BESIDE[option] for option in taken] or [""]
    names = f"{', '.join(first)} and {last}" if first else last
    are = "is" if len(taken) == 1 else "are"
    return files, (f"{names} in the recording's folder {are} used.",) if taken else ()


def _file_inside(option: str, stated: Path | tuple[Path, ...] | None) -> Path | tuple[Path, ...] | None:
    """Return a file for each folder that an option names and that has one."""
    if isinstance(stated, tuple):
        return tuple(_meant_by(option, path) for path in stated)
    return stated and _meant_by(option, stated)


def _meant_by(option: str, path: Path) -> Path:
    return next((path / name for name in _INSIDE[option] if (path / name).is_file()), path)


def refuse_overwriting(folder: Path, recording: Path, inputs: Mapping[str, Any], files: tuple[str, ...]) -> None:
    """Refuse a folder in which the result, some `files`, would take the place of an input: both know an imu.yaml.

    Raises
    ------
    OptionError
        If the folder is that of the recording, or a file of the result would be one of the inputs.
    """
    place = folder.resolve()
    if recording.is_dir() and place == recording.resolve():
        raise OptionError(
            f"{folder}: this is the recording's folder, whose {files[-2]} the result would replace. "
            "Choose another folder with -o."
        )
    for option, file in inputs.items():
        for path in file if isinstance(file, tuple) else (file,) if file else ():
            if path.resolve() in {place / name for name in files}:
                raise OptionError(
                    f"{path}: the result would replace this file of --{option}. Choose another folder with -o."
                )


_MAKERS = {
    "cam": "gnomon camera makes one",
    "imu": "gnomon noise makes one",
    "target": "gnomon target makes one",
    "calibration": "gnomon imu and the other commands that calibrate make one",
}
"""Field of a command -> which command makes the file that it names."""
_NAMING, _ENDINGS = ("prior", "use", "rate", "datasheet"), (".yaml", ".yml", ".json", ".mkv", ".avi", ".mp4", ".mov")
"""Fields that may name files, and what then tells that they do."""


def sources_of(texts: tuple[str, ...]) -> list[tuple[str, list[Path]]]:
    """Return the name, or "", and the paths of each calibration; a path that is there is taken as it stands.

    Examples
    --------
    >>> sources_of(("kalibr=run-camchain.yaml+run-imu.yaml",))
    [('kalibr', [PosixPath('run-camchain.yaml'), PosixPath('run-imu.yaml')])]
    """
    found: list[tuple[str, list[Path]]] = []
    for text in texts:
        name, equals, rest = text.partition("=")
        if Path(text).exists() or not equals or "/" in name:
            name, rest = "", text
        if not rest:
            raise OptionError(f"{text}: expected a path behind the name, such as first=monday-imu.")
        parts = [rest] if Path(rest).exists() else [part for part in rest.split("+") if part]
        found.append((name, [Path(part) for part in parts]))
    return found


def _stated_values(command: Command) -> Iterator[tuple[Entry, Any]]:
    """Yield what is stated on the line, one value after the other, with the field that has it."""
    for entry in command_entries(type(command)):
        value = reduce(getattr, entry.place, command)
        for one in value if isinstance(value, tuple) else (value,):  # pyright: ignore[reportUnknownVariableType]
            yield entry, one


def refuse_missing(command: Command) -> None:
    """Refuse a command of which files are not there, or options not given: all of them are named at once.

    Raises
    ------
    RecordingError
        If a file or folder is not there.
    OptionError
        If an option is missing that the recording needs.
    """
    absent = [
        f"{'' if entry.argument.positional else f'{entry.called} '}{path}"
        + (f" ({_MAKERS[entry.place[-1]]})" if entry.place[-1] in _MAKERS else "")
        for entry, value in _stated_values(command)
        if entry.place[-1] not in ("output", "log")
        for path in _paths_named(entry.place[-1], value)
        if not path.exists()
    ]
    lacking = command.lacking()
    if absent:
        what = "there is no such file or folder"
        said = f"{absent[0]}: {what}" if len(absent) == 1 else f"{what}: {', '.join(absent)}"
        lacking.insert(0, f"{said}. Check the path.")
    if lacking:
        raise (RecordingError if absent else OptionError)(" ".join(lacking))


def _paths_named(name: str, value: Any) -> Iterator[Path]:
    """Yield the files and folders that a value of an option names."""
    if isinstance(value, Path) and (name, value) != ("target", Path("none")):
        yield value
    elif isinstance(value, str) and name.startswith("calibration"):
        yield from (path for _, paths in sources_of((value,)) for path in paths)
    elif isinstance(value, str) and name in _NAMING and value.lower().endswith(_ENDINGS):
        yield Path(value if Path(value).exists() else value.rpartition("=")[2])


def recover_interrupted_write(command: Command) -> None:
    """Put files in their places that a killed process left on the way, in the folders that a command names."""
    for path in {value for _, value in _stated_values(command) if isinstance(value, Path)}:
        for folder in (path, path.parent):
            with suppress(OSError, OutputError):  # who writes there is told; who reads has no need to
                put_in_place(folder)


@contextmanager
def spared_inputs(command: Command) -> Generator[None]:
    """Let nothing be written over what a command reads, and refuse pipes and devices, which can be read only once.

    Raises
    ------
    RecordingError
        If an input is a pipe or a device.
    OutputError
        If the file to write is an input, or lies in a folder that is one.
    """
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


def _inputs(command: Command) -> list[Path]:
    """Return the files and folders that a command reads, those in texts (--prior, --for) too."""
    read = [(entry.place[-1], value) for entry, value in _stated_values(command) if entry.place[-1] != "output"]
    words = [str(value) for name, value in read if name in _TEXTS and isinstance(value, str | Path)]
    named = [Path(part) for word in words for part in (word, *re.split(r"[=+]", word)) if part]
    folders = [path / "calibration.yaml" for path in named]
    return [*(value for _, value in read if isinstance(value, Path)), *filter(_exists, (*named, *folders))]


def _exists(path: Path) -> bool:
    try:
        return path.exists()
    except (OSError, ValueError):  # a text that is no path
        return False
