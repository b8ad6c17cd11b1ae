"""The command that calibrates the devices of a line, one recording each, and keeps them in a library."""

import shlex
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from ...errors import OptionError, SolveError
from ..arguments import Argument
from ..command import Command, output_option
from ..devices import device_facts, find_recordings, read_device_table, recording_stem
from ..files import check_folder
from ..results import UNUSABLE, USABLE
from ..terminal import Terminal

if TYPE_CHECKING:
    from ...fleet.library import Library
    from ..devices import DeviceOutcome, DeviceTask

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
        from ..devices import RunJournal, calibrate_device

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
        from ..devices import DeviceTask

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
