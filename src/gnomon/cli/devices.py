"""Which recordings lie in folders, and of which devices they are: by a table, a file device.yaml, or their names.

The runs of a batch: one recording calibrated as its command would, and the library as the journal of all.
"""

import csv
import datetime
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import FormatError, GnomonError, OptionError, OutputError, RecordingError
from ..fleet.entries import LibraryEntry
from ..frozen import value_class
from .command import CertificateFacts
from .files import ALL_RESULT_FILES, spared_inputs
from .terminal import Terminal

if TYPE_CHECKING:
    from ..fleet.library import Library
    from ..study.runs import Records


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
    from ..formats.own.options_file import read_options

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
    from ..formats.own.calibration_file import load
    from . import explain_error
    from .command import parse_command

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
