"""The command that calibrates the devices of a line, one recording each, and keeps them in a library.

Which recordings lie in folders, and of which devices they are: by a table, a file device.yaml, or their names. A run
calibrates one recording as its command would; the library is the journal of all.
"""

import csv
import datetime
import re
import shlex
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from ...errors import FormatError, GnomonError, OptionError, OutputError, RecordingError, SolveError
from ...fleet.entries import LibraryEntry
from ...frozen import value_class
from ..arguments import Argument
from ..command import CertificateFacts, Command, output_option
from ..files import ALL_RESULT_FILES, check_folder, spared_inputs
from ..results import UNUSABLE, USABLE
from ..terminal import Terminal

if TYPE_CHECKING:
    from ...fleet.library import Library
    from ...study.runs import Records

LIBRARY = "library.db"
Kind = Literal["imu", "camera-imu", "camera", "magnetometer"]
_SHOWN = 20
"""Broken recordings that are printed, at most."""


@dataclass(frozen=True, kw_only=True)
class Batch(Command):
    """Calibrate many devices, one recording each, and keep every result in a library.

    Each file or folder in a FOLDER is the recording of one device. Its serial number and date are those of the table
    --devices, of a file device.yaml in the recording's folder, or in its name, such as SN0042_2026-03-31.csv. A
    recording that cannot be calibrated does not stop the others. What was interrupted goes on when the same command is
    given again. Exit code 4 where a device failed or a recording was broken.

    Examples
    --------
    $ gnomon batch monday tuesday --kind imu --for ahrs --jobs 4
    $ gnomon batch rigs --kind camera-imu --library postgresql://host/line
    """

    folders: Annotated[tuple[Path, ...], Argument(positional=True, metavar="FOLDER")]
    """Folders of recordings."""
    kind: Kind
    """The command that calibrates each of them."""
    library: Annotated[str | None, Argument(metavar="FILE|URL")] = None
    """The library: an SQLite file, which is made where there is none, or a URL such as postgresql://host/name (default:
    library.db in the folder of the results). Needs gnomon[fleet]."""
    output: Annotated[Path | None, output_option("DIR")] = None
    """Folder with the folder of each result (default: FOLDER-batch beside the first)."""
    use: Annotated[str | None, Argument(name="for", metavar="USE")] = None
    """What the devices are for, as of the command that calibrates; the verdicts are then for that use."""
    devices: Annotated[Path | None, Argument(metavar="FILE")] = None
    """Table (CSV) with a column recording, the name of a file or folder, and any of sensor, serial, date, operator,
    place (the station) and temperature_c."""
    options: str = ""
    """Further options of that command, for every recording, as one text in quotation marks."""
    reports: bool = False
    """Make the report of each device, too."""
    jobs: int = 1
    """Processes that share the recordings; the results do not depend on it."""
    scheduler: Annotated[str | None, Argument(metavar="ADDRESS")] = None
    """Let the workers of an existing Dask cluster do them, such as tcp://host:8786, which see the same folders; needs
    gnomon[dask]."""

    def run(self, terminal: Terminal) -> int:
        """Calibrate what is not done yet, and return the exit code."""
        from ...fleet.library import Library
        from ...study.runs import Records, Workers, carry_out

        recordings = find_recordings(self.folders, self.devices)
        place = Path(self.folders[0].absolute())
        folder = self.output or place.with_name(f"{place.name}-batch")
        check_folder(folder)
        tasks = self._tasks(recordings, folder)
        folder.mkdir(parents=True, exist_ok=True)
        with Library(self.library or str(folder / LIBRARY), create=True) as library:
            journal = RunJournal(library, Records(calibrate_device, tasks))
            workers = Workers(jobs=self.jobs, scheduler=self.scheduler or "", journal=journal)
            try:
                done = carry_out(
                    calibrate_device, tasks, workers=workers, progress=terminal.progress, name="calibrating devices"
                )
            except (KeyboardInterrupt, SolveError) as stop:
                kept = "What is done is kept; the same command goes on from there."
                if isinstance(stop, SolveError):
                    raise SolveError(f"{stop} {kept}") from stop
                raise KeyboardInterrupt(f"interrupted. {kept}") from stop
            return self._print(done, folder, library, terminal)

    def _tasks(self, recordings: list[Path], folder: Path) -> "list[DeviceTask]":
        from ..._version import __version__
        from ..command import parse_command

        table = read_device_table(self.devices) if self.devices else {}
        try:
            extra = shlex.split(self.options)
        except ValueError as error:
            raise OptionError(f"--options {self.options!r}: {error}. Close every quotation mark.") from None
        extra += [*(["--for", self.use] if self.use else []), *([] if self.reports else ["--no-report"])]
        extra += ["--workers", "1"] if self.kind.startswith("camera") else []
        taken: set[str] = set()
        tasks: list[DeviceTask] = []
        for path in recordings:
            stem = recording_stem(path)
            name = next(n for k in range(len(recordings)) if (n := f"{stem}-{k + 1}" if k else stem) not in taken)
            taken.add(name)
            result = str((folder / name).absolute())
            facts = device_facts(path, table).stated
            words = [f"--{key.replace('_', '-')}={value}" for key, value in facts.items() if value is not None]
            line = (self.kind, str(path.absolute()), "-o", result, *words, *extra)
            state = f"{__version__} {_state_of(path)}"
            tasks.append(DeviceTask(line=line, folder=result, serial=str(facts["serial"]), state=state))
        parse_command(tasks[0].line)  # else each of them would say what is wrong with --options
        return tasks

    def _print(self, done: "list[DeviceOutcome]", folder: Path, library: "Library", terminal: Terminal) -> int:
        counts = {verdict: sum(one.verdict == verdict for one in done) for verdict in ("pass", "warn", "fail")}
        broken = [one for one in done if one.problem]
        told = ", ".join(f"{count} {verdict}" for verdict, count in counts.items())
        terminal.print(f"{len(done)} recordings: {told}, {len(broken)} broken")
        for one in broken[:_SHOWN]:
            terminal.print(f"  {one.serial}: {one.problem}")
        if len(broken) > _SHOWN:
            terminal.print(f"  and {len(broken) - _SHOWN} more; --json lists them all")
        place = self.library or str(folder / LIBRARY)
        terminal.print(f"\nresults      {folder}\nlibrary      {place}, {library.count()} calibrations")
        terminal.propose("library", "report", "line.html", "--library", place)
        code = UNUSABLE if broken or counts["fail"] else USABLE
        rows = [
            {"serial": one.serial, "folder": one.folder, "verdict": one.verdict, "problem": one.problem} for one in done
        ]
        terminal.document({"exit_code": code, "counts": {**counts, "broken": len(broken)}, "devices": rows})
        return code


def _state_of(path: Path) -> str:
    """Return sizes and times of the files of a recording."""
    files = [path] if path.is_file() else sorted(file for file in path.rglob("*") if file.is_file())
    return " ".join(f"{file.stat().st_size}:{file.stat().st_mtime_ns}" for file in files)


DEVICE = "device.yaml"
"""File in the folder of a recording that states the facts of a certificate."""
_OTHERS = (".yaml", ".yml", ".json", ".html", ".pdf", ".md", ".db", ".db-wal", ".db-shm", ".log")
_DATE = re.compile(r"(?<!\d)((?:19|20)\d\d)([-_.]?)(\d\d)\2(\d\d)(?:[T_-]?\d\d[-:_]?\d\d(?:[-:_]?\d\d)?Z?)?(?!\d)")
_ALIASES = {"station": "place", "device": "serial", "temperature": "temperature_c"}
_COLUMNS = tuple(field.name for field in fields(CertificateFacts))


def find_recordings(folders: Iterable[Path], table: Path | None) -> list[Path]:
    """Return the recordings in folders: each file and each folder in one of them, but settings, results and the table.

    Raises
    ------
    RecordingError
        If there is no such folder, or no recording in any of them.
    """
    found: list[Path] = []
    for folder in folders:
        if folder.is_file():
            raise RecordingError(f"{folder}: this is a file. Name the folder with the recordings, one a device.")
        if not folder.is_dir():
            raise RecordingError(f"{folder}: there is no such folder. Name folders of recordings, one a device.")
        for path in sorted(folder.iterdir()):
            result = path.is_dir() and any((path / name).is_file() for name in ALL_RESULT_FILES - {"imu.yaml"})
            others = path.is_file() and (path.suffix.lower() in _OTHERS or path.name in ALL_RESULT_FILES)
            listed = table is not None and table.exists() and path.samefile(table)
            if not (path.name.startswith(".") or result or others or listed):
                found.append(path)
    if not found:
        raise RecordingError("no recording in these folders: each file or folder in them is the recording of a device.")
    return found


def device_facts(recording: Path, table: Mapping[str, CertificateFacts]) -> CertificateFacts:
    """Return what is known of a recording's device: by the table, else by device.yaml in its folder, else by its name.

    Raises
    ------
    FormatError
        If device.yaml cannot be read.
    """
    from ...formats.own.dataclass_file import read_options

    stem = recording_stem(recording)
    named = table.get(recording.name) or table.get(stem)
    if named is None and (recording / DEVICE).is_file():
        named = read_options(recording / DEVICE, CertificateFacts)
    serial, date = serial_and_date(stem)
    if named is None:
        return CertificateFacts(serial=serial, date=date)
    return replace(named, serial=named.serial or serial, date=named.date or date)


def recording_stem(recording: Path) -> str:
    """Return the name of a recording without its endings."""
    name = recording.name.removesuffix(".gz")
    return name if recording.is_dir() or "." not in name[1:] else name.rsplit(".", 1)[0]


def serial_and_date(stem: str) -> tuple[str, str | None]:
    """Return serial number and date of a recording by its name: the date as it is found, and what is left.

    Examples
    --------
    >>> serial_and_date("SN0042_2026-03-31"), serial_and_date("20260331T101500-A7"), serial_and_date("A7")
    (('SN0042', '2026-03-31'), ('A7', '2026-03-31'), ('A7', None))
    """
    for match in _DATE.finditer(stem):
        date = f"{match[1]}-{match[3]}-{match[4]}"
        try:
            datetime.date.fromisoformat(date)
        except ValueError:
            continue
        left = "_".join(
            part for part in (stem[: match.start()].strip("-_. "), stem[match.end() :].strip("-_. ")) if part
        )
        return (left, date) if left else (stem, None)
    return stem, None


def read_device_table(path: Path) -> dict[str, CertificateFacts]:
    """Read a table of devices: a column `recording`, and any of those that a certificate states.

    Raises
    ------
    FormatError
        If it cannot be read, or a column is unknown.
    """
    try:
        with path.open(newline="", encoding="utf-8-sig") as stream:
            rows = list(csv.reader(stream))
    except (OSError, ValueError, csv.Error) as error:
        raise FormatError(f"{path}: this table cannot be read ({error}).") from error
    head = [_ALIASES.get(name, name) for name in map(str.strip, rows[0] if rows else [])]
    unknown = [name for name in head if name not in ("recording", *_COLUMNS)]
    if "recording" not in head or unknown:
        raise FormatError(
            f"{path}: expected a head with recording and any of {', '.join(_COLUMNS)}; found {', '.join(head)}."
        )
    return {row["recording"]: _facts(row, path) for row in _records(head, rows[1:], path)}


def _records(head: Sequence[str], rows: Iterable[Sequence[str]], path: Path) -> Iterable[dict[str, str]]:
    for number, row in enumerate(rows, 2):
        if not any(row):
            continue
        if len(row) != len(head):
            raise FormatError(f"{path}, line {number}: {len(row)} columns, where the head has {len(head)}.")
        yield {name: cell.strip() for name, cell in zip(head, row, strict=True) if cell.strip() or name == "recording"}


def _facts(row: Mapping[str, str], path: Path) -> CertificateFacts:
    stated = {name: text for name, text in row.items() if name in _COLUMNS and name != "temperature_c"}
    try:
        warm = float(row["temperature_c"]) if "temperature_c" in row else None
        return CertificateFacts(**stated, temperature_c=warm)
    except (OptionError, ValueError) as error:
        raise FormatError(f"{path}, {row['recording']}: {error}") from error


@value_class(eq=True)
class DeviceTask:
    """One recording to calibrate.

    Attributes
    ----------
    line : the words of the command that does it, such as ("imu", "SN1.csv", "-o", "out/SN1", "--serial", "SN1")
    folder : for its result
    serial : of the device
    state : what tells the recording from a later one of its name, and this gnomon from a later one
    """

    line: tuple[str, ...]
    folder: str
    serial: str
    state: str


@value_class(eq=True)
class DeviceOutcome:
    """What became of a recording.

    Attributes
    ----------
    serial, folder : of its task
    verdict : of its calibration; "" where there is none
    problem : why there is none
    lasting : whether the same would happen again
    entry : its calibration, where the library has still to take it
    """

    serial: str
    folder: str
    verdict: str = ""
    problem: str = ""
    lasting: bool = True
    entry: LibraryEntry | None = None


def calibrate_device(task: DeviceTask) -> DeviceOutcome:
    """Calibrate one recording as its command would, and return what became of it."""
    from ...formats.own.calibration_file import load
    from ..command import parse_command
    from ..terminal import explain_error

    try:
        command = parse_command(task.line)
        terminal = _Mute()
        with spared_inputs(command):
            command.run(terminal)
        calibration = terminal.written or load(Path(task.folder) / "calibration.yaml")
    except Exception as error:
        lasting = isinstance(error, GnomonError) and not isinstance(error, OutputError)
        return DeviceOutcome(serial=task.serial, folder=task.folder, problem=explain_error(error)[0], lasting=lasting)
    entry = LibraryEntry.of_calibration(calibration, serial=task.serial, folder=task.folder)
    return DeviceOutcome(serial=task.serial, folder=task.folder, verdict=calibration.verdict, entry=entry)


class _Mute(Terminal):
    """A terminal that nobody looks at."""

    def __init__(self) -> None:
        super().__init__(as_json=True, quiet=True)

    def document(self, content: Any) -> None:
        """Print nothing."""


class RunJournal:
    """The library as the journal of a batch: a run and its calibration are kept in one transaction."""

    def __init__(self, library: "Library", records: "Records[DeviceOutcome]") -> None:
        self._library, self._records = library, records

    def find(self, key: str) -> str | None:
        """Return the record of a run that is done, and whose result is still there."""
        record = self._library.find(key)
        read = None if record is None else self._records.read(record)
        there = read and (read[0].problem or (Path(read[0].folder) / "calibration.yaml").is_file())
        return record if there else None

    def keep(self, key: str, record: str) -> None:
        """Keep what became of a recording, unless it may go better another time."""
        read = self._records.read(record)
        if read is None:
            raise FormatError("the outcome of a recording cannot be read again. This is a bug in gnomon.")
        if read[0].lasting:
            without = self._records.written(replace(read[0], entry=None))
            self._library.keep_run(key, without, read[0].entry)
