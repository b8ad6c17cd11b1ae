"""The command that looks into a library of many devices."""

import gc
import sys
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from ...errors import GnomonError, OptionError
from ..arguments import Argument
from ..command import Command
from ..results import UNUSABLE, USABLE, print_findings
from ..terminal import Terminal, json_value

if TYPE_CHECKING:
    from ...fleet.entries import LibraryEntry
    from ...fleet.library import Library
    from ...fleet.line import LineAssessment

_SHOWN = 40
"""Rows of a list that are printed, at most."""
_WORDS = {
    "list": (0, 0, "nothing more"),
    "show": (1, 1, "a serial number"),
    "history": (1, 1, "a serial number"),
    "chart": (0, 1, "the name of a parameter, or nothing"),
    "report": (1, 1, "the file to write, such as line.html"),
    "export": (1, 1, "the file to write, such as line.csv"),
    "import": (1, 10_000, "folders with results"),
    "serve": (0, 0, "nothing more"),
}
_CHARTED = """
spread: of the devices; repeated: of one device from one measurement to the next (- where too few were measured twice).
limits of one: of the chart of individuals; EWMA: the newest weighted average, and its limits."""
_FACTS = ("measured", "kind", "verdict", "use", "station", "operator", "temperature_c", "version", "folder")


@dataclass(frozen=True, kw_only=True)
class LibraryCommand(Command):
    """Look into the library that `gnomon batch` fills.

    list: the devices. show SERIAL: the newest calibration of a device. history SERIAL: all of them, and what changed.
    chart PARAMETER: mean, spread and control limits of a number over all devices; without PARAMETER of all numbers.
    report FILE: one page on the whole line, with all that was noticed (exit code 4 where it is a problem). export FILE:
    all calibrations as a table, .csv or .parquet. import FOLDER...: add the results in these folders. serve: pages of
    devices and charts, read-only, for a browser on this computer; Ctrl-C ends it. Needs gnomon[serve].

    Examples
    --------
    $ gnomon library list --library line.db
    $ gnomon library history SN0042 --library line.db
    $ gnomon library report line.html --library line.db
    """

    action: Annotated[
        Literal["list", "show", "history", "chart", "report", "export", "import", "serve"], Argument(positional=True)
    ]
    """What to do."""
    words: Annotated[tuple[str, ...], Argument(positional=True, metavar="WORD")] = ()
    """A serial number, a file, or folders, as said above."""
    library: Annotated[str, Argument(metavar="FILE|URL")] = "library.db"
    """The library: an SQLite file or a URL such as postgresql://host/name. Needs gnomon[fleet]."""
    kind: str | None = None
    """Only calibrations that this command made, such as imu."""
    port: int = 0
    """Where `serve` serves its pages (default: a free port)."""
    lan: bool = False
    """Let other devices of the network see the pages of `serve`, with the token, unencrypted."""

    def run(self, terminal: Terminal) -> int:
        """Do it, and return the exit code."""
        from ...fleet.library import Library

        least, most, what = _WORDS[self.action]
        if not least <= len(self.words) <= most:
            raise OptionError(f"gnomon library {self.action} takes {what}.")
        actions: dict[str, Callable[[Library, Terminal], dict[str, Any]]] = {
            "list": self._list,
            "show": self._show,
            "history": self._history,
            "chart": self._chart,
            "report": self._report,
            "export": self._export,
            "import": self._import,
            "serve": self._serve,
        }
        importing, serving = self.action == "import", self.action == "serve"
        with Library(self.library, create=importing, read_only=serving) as library:
            document = actions[self.action](library, terminal)
        terminal.document(document)
        return int(document.get("exit_code", USABLE))

    def _list(self, library: "Library", terminal: Terminal) -> dict[str, Any]:
        devices: dict[str, list[LibraryEntry]] = {}
        for entry in library.entries(kind=self.kind):
            devices.setdefault(entry.serial, []).append(entry)
        rows = [(s, str(len(all_)), *_cells(all_[-1], ("measured", "kind", "verdict", "station"))) for s, all_ in
                devices.items()]  # fmt: skip
        _print_rows(("serial", "results", "last", "kind", "verdict", "station"), rows, terminal)
        return {"devices": {s: {"results": len(all_), **_facts(all_[-1])} for s, all_ in devices.items()}}

    def _of_serial(self, library: "Library", *, details: bool = False) -> "list[LibraryEntry]":
        found = list(library.entries(serial=self.words[0], kind=self.kind, details=details))
        if not found:
            raise OptionError(f"no calibration of {self.words[0]!r} in {self.library}. gnomon library list shows all.")
        return found

    def _show(self, library: "Library", terminal: Terminal) -> dict[str, Any]:
        from ...report.numbers import with_sigma

        entry = self._of_serial(library, details=True)[-1]
        for name in _FACTS:
            terminal.print(f"{name:<14} {_cells(entry, (name,))[0] or 'not stated'}")
        numbers = zip(entry.names, entry.values.tolist(), entry.published_sigmas.tolist(), entry.units, strict=True)
        rows = [(name, *with_sigma(value, sigma), unit) for name, value, sigma, unit in numbers]
        terminal.print("")
        _print_rows(("parameter", "estimate", "sigma", "unit"), rows, terminal)
        return json_value(entry)

    def _history(self, library: "Library", terminal: Terminal) -> dict[str, Any]:
        from ...fleet.statistics import largest_change

        entries = self._of_serial(library)
        rows: list[tuple[str, ...]] = []
        changes: list[dict[str, Any]] = []
        for before, entry in zip([None, *entries], entries, strict=False):
            change = None if before is None else largest_change(before, entry)
            words = "" if change is None else f"{change.name} {change.size:+.3g} {change.unit}, z {change.z:.1f}"
            rows.append((*_cells(entry, ("measured", "kind", "verdict", "station", "temperature_c")), words))
            changes.append({**_facts(entry), "change": change})
        _print_rows(("date", "kind", "verdict", "station", "deg C", "largest change"), rows, terminal)
        terminal.print("\nz: the change over its sigma, of both results alone; biases change at every switching-on.")
        return {"serial": self.words[0], "calibrations": changes}

    def _line(self, library: "Library", terminal: Terminal, *, details: bool) -> "LineAssessment":
        from ...fleet.entries import line_table
        from ...fleet.line import assess_line

        terminal.progress("reading the library")
        gc.disable()  # a hundred thousand results hold no circles, and would be searched for some again and again
        entries = list(library.entries(kind=self.kind, details=details))
        if not entries:
            raise OptionError(f"{self.library}: there is no calibration in it.")
        terminal.progress("comparing the results")
        return assess_line(line_table(entries))

    def _chart(self, library: "Library", terminal: Terminal) -> dict[str, Any]:
        from ...fleet.charts import chart_summary

        line = self._line(library, terminal, details=False)
        names = self.words or line.table.names
        unknown = next((name for name in names if name not in line.table.names), None)
        if unknown is not None:
            raise OptionError(f"no parameter {unknown} in this library. Known: {', '.join(line.table.names)}.")
        charts = [chart_summary(line, name) for name in names]
        head = ("parameter", "devices", "mean", "spread", "repeated", "limits of one", "EWMA", "limits of it", "unit")
        _print_rows(head, [chart.cells for chart in charts], terminal, most=len(charts))
        terminal.print(_CHARTED)
        print_findings(line.findings, terminal)
        return {"charts": charts, "findings": line.findings}

    def _report(self, library: "Library", terminal: Terminal) -> dict[str, Any]:
        from ...report.library import write_line_report

        line = self._line(library, terminal, details=True)
        terminal.progress("drawing the report")
        path = Path(self.words[0])
        write_line_report(line, path)
        terminal.print(f"{len(line.first)} devices, {len(line.table.entries)} results, {len(line.findings)} findings")
        print_findings(line.findings, terminal)
        terminal.print(f"\nreport       {path}")
        problem = any(finding.severity == "problem" for finding in line.findings)
        code = UNUSABLE if problem else USABLE
        return {"devices": len(line.first), "findings": line.findings, "file": str(path), "exit_code": code}

    def _export(self, library: "Library", terminal: Terminal) -> dict[str, Any]:
        from ...fleet.entries import export_table

        path = Path(self.words[0])
        count = export_table(library.entries(kind=self.kind), path)
        terminal.print(f"{count} calibrations  {path}")
        return {"calibrations": count, "file": str(path)}

    def _serve(self, library: "Library", terminal: Terminal) -> dict[str, Any]:
        from ...fleet.library import without_password
        from ...report.library import LibraryPages, LibraryServer

        pages = LibraryPages(library, without_password(self.library), self.kind)
        pages.prepare()
        server = LibraryServer(pages, port=self.port, lan=self.lan)
        terminal.print(f"pages        {server.address_of()}\n\nCtrl-C ends it.")
        sys.stdout.flush()  # a program may read where the pages are
        server.serve_until_interrupted()
        return {}

    def _import(self, library: "Library", terminal: Terminal) -> dict[str, Any]:
        from ...fleet.entries import LibraryEntry
        from ...formats.own.calibration_file import load
        from .batch import serial_and_date

        added, broken = 0, dict[str, str]()
        paths = [path for folder in map(Path, self.words) for path in sorted(folder.rglob("calibration.yaml"))]
        if not paths:
            raise OptionError(f"no calibration.yaml in {', '.join(self.words)}.")
        for count, path in enumerate(paths, 1):
            terminal.progress(f"adding results: {count} of {len(paths)}")
            try:
                calibration = load(path)
            except GnomonError as error:
                broken[str(path)] = str(error)
                continue
            serial, _ = serial_and_date(path.parent.name)
            entry = LibraryEntry.of_calibration(calibration, serial=serial, folder=str(path.parent.absolute()))
            added += library.add(entry)
        terminal.print(
            f"{added} calibrations added, {len(paths) - added - len(broken)} were there, {len(broken)} broken"
        )
        for path, problem in list(broken.items())[:_SHOWN]:
            terminal.print(f"  {path}: {problem}")
        return {"added": added, "broken": broken, "calibrations": library.count()}


def _facts(entry: "LibraryEntry") -> dict[str, Any]:
    return {name: getattr(entry, name) for name in _FACTS}


def _cells(entry: "LibraryEntry", names: Iterable[str]) -> tuple[str, ...]:
    values = [getattr(entry, name) for name in names]
    return tuple("" if value != value else str(value) for value in values)  # noqa: PLR0124 - a temperature may be nan


def _print_rows(head: Sequence[str], rows: Sequence[Sequence[str]], terminal: Terminal, *, most: int = _SHOWN) -> None:
    shown = [head, *rows[:most]]
    widths = [max(map(len, column)) for column in zip(*shown, strict=True)]
    for row in shown:
        terminal.print("  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip())
    if len(rows) > most:
        terminal.print(f"and {len(rows) - most} more; --json lists them all")
