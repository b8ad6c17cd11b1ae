"""What options name: other calibrations of the sensor, the use that is judged for, files beside a recording."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from ..errors import OptionError, RecordingError
from ..models.lens_names import PROGRAMS
from .arguments import command_entries
from .command import Command, StatedFacts

if TYPE_CHECKING:
    from ..assess.comparison.comparison import Comparison
    from ..assess.comparison.verification import Verification
    from ..models.noise import ImuNoise
    from ..options.requirements import Use
    from ..recording import Recording, Source
    from ..results.calibration import Calibration
    from ..results.result import Result

Certified = TypeVar("Certified", "Calibration", "Comparison", "Verification")


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


def judged_result(result: "Result", use: "Use | None") -> "Result":
    """Return a result whose calibration is judged for a use, where one is stated."""
    if use is None:
        return result
    from ..calibrate.judging import judge

    return replace(result, calibration=judge(result.calibration, use))


def result_with_reading(result: "Result", table: Mapping[str, Any]) -> "Result":
    """Return a result whose calibration remembers what was stated of its recording, such as how it was read."""
    stated = {name: str(value) for name, value in table.items() if value is not None}
    calibration = result.calibration
    provenance = replace(calibration.provenance, options={**calibration.provenance.options, **stated})
    return replace(result, calibration=replace(calibration, provenance=provenance))


def with_statements(found: Certified, facts: StatedFacts, paths: Iterable[Path] = ()) -> Certified:
    """Return it with what a certificate says: what was stated, and the files of the calibrations."""
    from ..formats.own.calibration_text import calibration_at
    from ..readers.files import file_source

    stated = {name: str(value) for name, value in facts.stated.items() if value is not None}
    inputs = list(found.provenance.inputs)
    for path in paths:
        file = Path(calibration_at(path))
        if file.is_file():
            called = f"{file.absolute().parent.name}/{file.name}" if file.name == "calibration.yaml" else file.name
            inputs.append(replace(file_source(file), name=called))
    made = found.provenance
    return replace(found, provenance=replace(made, inputs=tuple(inputs), options={**made.options, **stated}))


def remembered_reading(calibration: "Calibration", paths: Sequence[Path]) -> dict[str, Any]:
    """Return how a calibration's recording was read, for tables without a header, which say as little as that one did.

    Nothing is returned for other recordings, which tell themselves what their columns are.
    """
    from ..readers.files import first_bytes
    from ..readers.samples.text_table import has_header

    options = calibration.provenance.options
    known: dict[str, Any] = {name: options[name] for name in ("columns", "rate_hz", "units") if name in options}
    if not known or not all(path.is_file() for path in paths):
        return {}
    try:
        if any(has_header(path.name, first_bytes(path, _HEAD_BYTES)) for path in paths):
            return {}
    except RecordingError:  # no table of text
        return {}
    return known | ({"rate_hz": float(known["rate_hz"])} if "rate_hz" in known else {})


_HEAD_BYTES = 65_536
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
        for entry in command_entries(type(command))
        if entry.place[-1] not in ("output", "log")
        for path in _paths_stated(entry.place[-1], reduce(getattr, entry.place, command))
        if not path.exists()
    ]
    lacking = command.lacking()
    if absent:
        what = "there is no such file or folder"
        said = f"{absent[0]}: {what}" if len(absent) == 1 else f"{what}: {', '.join(absent)}"
        lacking.insert(0, f"{said}. Check the path.")
    if lacking:
        raise (RecordingError if absent else OptionError)(" ".join(lacking))


def _paths_stated(name: str, value: Any) -> Iterator[Path]:
    """Yield the files and folders that the value of an option names."""
    for one in value if isinstance(value, tuple) else (value,):
        if isinstance(one, Path) and (name, one) != ("target", Path("none")):
            yield one
        elif isinstance(one, str) and name.startswith("calibration"):
            yield from (path for _, paths in sources_of((one,)) for path in paths)
        elif isinstance(one, str) and name in _NAMING and one.lower().endswith(_ENDINGS):
            yield Path(one if Path(one).exists() else one.rpartition("=")[2])
