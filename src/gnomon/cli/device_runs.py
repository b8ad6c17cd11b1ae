"""The runs of a batch: one recording calibrated as its command would, and the library as the journal of all."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import FormatError, GnomonError, OutputError
from ..fleet.entries import LibraryEntry
from ..frozen import value_class
from .output_folder import spared_inputs
from .terminal import Terminal

if TYPE_CHECKING:
    from ..fleet.library import Library
    from ..study.runs import Records


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
    from .catalogue import parse_command

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
