"""Where words go: results to standard output, progress and errors to standard error."""

import io
import json
import logging
import math
import shlex
import sys
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import fields, is_dataclass
from datetime import datetime
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import OutputError
from ..findings import printable_text
from ..progress import Step, as_step

if TYPE_CHECKING:
    from rich.console import RenderableType
    from rich.progress import Progress as Bar

    from ..results.calibration import Calibration

_LOG_HEAD = b"# log of gnomon"
_QUIET_S = 5.0  # between lines on one step, where they go to a file
WIDTH = 80
"""Columns of text that is not printed to a terminal."""


class Terminal:
    """One command's standard output and standard error.

    Parameters
    ----------
    as_json : standard output gets one JSON document, and nothing else
    quiet : nothing is told of progress
    verbose : details of progress are told, too
    log : file to which everything that is told is added, with the time

    Raises
    ------
    OutputError
        If the log cannot be written, or is a file of something else.
    """

    def __init__(
        self, *, as_json: bool = False, quiet: bool = False, verbose: bool = False, log: Path | None = None
    ) -> None:
        self.as_json = as_json
        self.next_lines: list[str] = []
        self.written: Calibration | None = None
        self._quiet, self._verbose = quiet, verbose
        self._log = log
        if log is not None:
            _begin_log(log)
        self._bar: Bar | None = None
        self._stage, self._began_s, self._told_s, self._first = "", 0.0, 0.0, 0
        logging.basicConfig(stream=sys.stderr, level=logging.WARNING, format="gnomon: %(message)s")

    def print(self, text: str, style: str = "") -> None:
        """Print a result for a person, in colour on a terminal; nothing when the output is JSON."""
        text = printable_text(text)
        self._keep(text)
        if self.as_json:
            return
        self.close()
        if style and sys.stdout.isatty():
            from rich.console import Console

            Console(highlight=False, markup=False, soft_wrap=True).print(text, style=style)
        else:
            sys.stdout.write(text + "\n")

    def draw(self, thing: "RenderableType") -> None:
        """Print a table; nothing when the output is JSON."""
        if self.as_json and self._log is None:
            return
        from rich.console import Console

        # Names of files, sensors and topics are text, whatever brackets they hold; rich drops control characters.
        if self._log is not None:
            drawn = io.StringIO()
            Console(file=drawn, width=WIDTH, highlight=False, markup=False).print(thing)
            self._keep(drawn.getvalue())
        if not self.as_json:
            self.close()
            width = None if sys.stdout.isatty() else WIDTH
            Console(file=sys.stdout, width=width, highlight=False, markup=False).print(thing)

    def propose(self, *words: str | PathLike[str]) -> None:
        """Print which command goes on from here, and keep it for the document.

        Parameters
        ----------
        words : behind gnomon; one in capitals, such as RECORDING, stands for what the user has yet to name
        """
        self.next_lines.append(shlex.join(["gnomon", *map(str, words)]))
        self.print(f"{'next' if len(self.next_lines) == 1 else '':<12} {self.next_lines[-1]}")

    def document(self, content: Mapping[str, Any] | Callable[[], Mapping[str, Any]]) -> None:
        """Print the JSON document, made only where it was asked for, with the commands that go on from here."""
        if self.as_json:
            self.close()
            content = content() if callable(content) else content
            content = {**content, "next": self.next_lines} if self.next_lines else content
            utf8 = (sys.stdout.encoding or "utf-8").lower() == "utf-8"  # elsewhere, as on Windows, letters are escaped
            sys.stdout.write(json.dumps(json_value(content), indent=2, ensure_ascii=not utf8, allow_nan=False) + "\n")

    def progress(self, sentence: str) -> None:
        """Say which step the work is at, and how long it may still take; in one changing line on a terminal."""
        step = as_step(printable_text(sentence)) if type(sentence) is str else as_step(sentence)
        if step.detail:  # beside the stage that goes on
            self._keep(printable_text(step))
            if self._verbose and not self._quiet:
                self.close()
                self._write(printable_text(step))
            return
        begins = step.stage != self._stage or step.done < self._first
        if begins:
            self._stage, self._first, self._began_s = step.stage, step.done, time.monotonic()
        if begins or not step.of:
            self._keep(printable_text(step))
        if self._quiet:
            return
        if sys.stderr.isatty():
            self._show(step, begins=begins)
        elif begins or not step.of or step.done == step.of or time.monotonic() - self._told_s > _QUIET_S:
            self._told_s = time.monotonic()
            self._write(printable_text(step) + self._left(step))

    def warn(self, line: str) -> None:
        """Write a line to standard error, whether anybody takes it or not."""
        self._keep(line)
        self._write(line)

    def close(self) -> None:
        """Take the changing line away."""
        if self._bar is not None:
            self._bar.stop()
            self._bar = None

    def _write(self, line: str) -> None:
        with suppress(OSError):
            sys.stderr.write(f"{line}\n")

    def _keep(self, text: str) -> None:
        """Add a text to the log."""
        if self._log is not None:
            now = datetime.now().astimezone().isoformat(timespec="seconds")
            with suppress(OSError), self._log.open("a", encoding="utf-8") as log:
                log.write(f"{now} {text}\n")

    def _show(self, step: Step, *, begins: bool) -> None:
        """Show a step in the changing line, with a bar where it has parts that are counted."""
        if begins:
            self.close()
        if self._bar is None:
            from rich.console import Console
            from rich.progress import (
                BarColumn,
                MofNCompleteColumn,
                Progress,
                SpinnerColumn,
                TextColumn,
                TimeRemainingColumn,
            )

            counted = (BarColumn(), MofNCompleteColumn(), TimeRemainingColumn()) if step.of else ()
            columns = SpinnerColumn(), TextColumn("{task.description}", markup=False), *counted
            self._bar = Progress(*columns, console=Console(stderr=True), transient=True)
            self._bar.add_task(printable_text(step.stage), total=step.of, completed=step.done)
            self._bar.start()
        self._bar.update(self._bar.task_ids[0], completed=step.done)

    def _left(self, step: Step) -> str:
        """Return how long a step may still take; nothing where that is soon, or cannot be told."""
        done = step.done - self._first
        seconds = (time.monotonic() - self._began_s) * (step.of - step.done) / done if step.of and done > 0 else 0.0
        if seconds < 1:
            return ""
        return f", {seconds:.0f} s left" if seconds < 100 else f", {seconds / 60:.0f} min left"


def _begin_log(path: Path) -> None:
    """Write the first line of a log where it is new, and leave alone what is no log."""
    try:
        with path.open("a+b") as file:
            file.seek(0)
            head = file.read(len(_LOG_HEAD))
            if not head:
                file.write(_LOG_HEAD + b"\n")
    except OSError as error:
        raise OutputError(f"--log {path}: cannot be written ({error.strerror}). Name another place.") from None
    if head not in (b"", _LOG_HEAD):
        raise OutputError(f"--log {path}: this file is not a log of gnomon. Name another.")


def json_value(value: Any) -> Any:
    """Return a value as JSON knows it: lists for arrays, null for what is not a finite number."""
    if is_dataclass(value):
        return {entry.name: json_value(getattr(value, entry.name)) for entry in fields(value)}
    if isinstance(value, Mapping):
        return {str(key): json_value(item) for key, item in value.items()}
    if value is None or isinstance(value, bool | int | str | float):
        return None if isinstance(value, float) and not math.isfinite(value) else value
    if hasattr(value, "tolist"):  # an array or a number of NumPy
        return json_value(value.tolist())
    if isinstance(value, list | tuple):
        return [json_value(item) for item in value]
    return str(value)
