"""The program in a terminal: parse, call, print, and say what went wrong. The Python API can do all that it can do.

Results go to standard output, progress and errors to standard error. What a command needs is imported once the program
can say what goes wrong.
"""

import gc
import io
import json
import logging
import math
import os
import shlex
import signal
import sys
import threading
import time
import warnings
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import fields, is_dataclass
from datetime import datetime
from os import PathLike
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any, TextIO

from ..errors import GnomonError, OptionError, OutputError, system_error_words
from ..findings import printable_text
from ..progress import Step, as_step, listening_to

if TYPE_CHECKING:
    from rich.console import RenderableType
    from rich.progress import Progress as Bar

    from ..results.calibration import Calibration

_LOG_HEAD = b"# log of gnomon"
_QUIET_S = 5.0  # between lines on one step, where they go to a file
WIDTH = 80
"""Columns of text that is not printed to a terminal."""
USAGE, BAD_INPUT, BUG, INTERRUPTED = 2, 3, 1, 130
"""Exit codes of work that was not finished; those of finished work are in `results`."""
_INTERRUPTED = "interrupted; no file is half-written."
_ENDING = ("SIGTERM", "SIGHUP")
"""Signals that end a program unless it does something about them; an interrupt is Python's own business."""
_TIDYING_S = 1.5
"""So long the work may take to end by itself; one long step in a library does not ask whether it should."""
_OBJECTS = 100_000
"""New objects after which Python looks for some that hold each other; at its 700, that takes 4 % of a calibration."""
_NARROWEST = 40
"""Columns that the help needs; with fewer, laying it out takes for ever."""


def run_program() -> None:
    """Run the command line and leave with its exit code."""
    os.environ["PYTHONSAFEPATH"] = "1"  # of every process that is started from here, by whatever library
    # One BLAS thread, before NumPy is there to start more: the problems are small, and threads cost start-up time.
    for library in ("OPENBLAS", "OMP", "MKL"):
        os.environ.setdefault(f"{library}_NUM_THREADS", "1")
    gc.set_threshold(_OBJECTS)
    if not sys.warnoptions:  # else they are asked for
        warnings.simplefilter("ignore")  # of libraries, to nobody who can do anything about them
    if os.environ.get("COLUMNS", "").isdigit() and int(os.environ["COLUMNS"]) < _NARROWEST:
        os.environ["COLUMNS"] = str(_NARROWEST)
    _open_streams()
    try:
        _tidy_up_when_ended()
        code = main(sys.argv[1:])
        sys.stdout.flush()
    except BrokenPipeError:  # the reader of our output has gone, as with `gnomon show FILE | head`
        code = 1
    except KeyboardInterrupt as stop:  # before there was anything to tidy up
        _say(f"gnomon: {_INTERRUPTED}")
        code = getattr(stop, "exit_code", 130)  # an EndedError has that of its signal
    except (OSError, ImportError) as error:  # the output is on a full disk, or too few files may be open to begin
        words = system_error_words(error)
        if not words or os.environ.get("GNOMON_DEBUG"):
            raise
        _say(f"gnomon: {words}")
        code = 3
    for stream in (sys.stdout, sys.stderr):
        _let_go(stream)
    gc.freeze()  # else Python looks for such objects again and again while it ends, a seventh of a short command
    sys.exit(code)


def _open_streams() -> None:
    """Let both outputs take all that is written to them, where they are closed, or lack a character."""
    said = sys.stdout is None  # pyright: ignore[reportUnnecessaryComparison] - closed before we began
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))  # noqa: SIM115, PTH123 - until the end
        reconfigure = getattr(getattr(sys, name), "reconfigure", None)
        if reconfigure is not None:
            reconfigure(errors="replace")  # a terminal without some character still shows the rest
    if said:
        _say("gnomon: standard output is closed; what would be printed there is lost.")


def _let_go(stream: TextIO) -> None:
    """Let nothing be written at the end to an output that takes nothing."""
    try:
        stream.flush()
    except (OSError, ValueError):
        with suppress(OSError, ValueError):
            os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def _say(line: str) -> None:
    with suppress(OSError):
        sys.stderr.write(f"{line}\n")
        sys.stderr.flush()


def _tidy_up_when_ended() -> None:
    """Let signals that end the program be told to it as an interrupt is, so that nothing is left behind."""

    def ended(number: int, _frame: FrameType | None) -> None:
        signal.signal(number, signal.SIG_IGN)  # tidying up is not disturbed
        raise EndedError(number)

    for name in _ENDING:
        number = getattr(signal, name, None)  # Windows has no SIGHUP, and its SIGTERM asks nobody
        if number is not None and signal.getsignal(number) is signal.SIG_DFL:  # nohup ignores one
            with suppress(ValueError, OSError):  # not the main thread; no more files may be open
                signal.signal(number, ended)
    with suppress(ValueError, OSError):
        heard, written = os.pipe()
        os.set_blocking(written, False)
        signal.set_wakeup_fd(written, warn_on_full_buffer=False)
        threading.Thread(target=_end_in_time, args=(heard,), daemon=True).start()


def _end_in_time(heard: int) -> None:
    """End the program a while after a signal that asks for it, whatever the main thread is at.

    Parameters
    ----------
    heard : descriptor from which the numbers of signals are read
    """
    numbers = {int(getattr(signal, name)) for name in _ENDING if hasattr(signal, name)}
    while data := os.read(heard, 1):
        if data[0] in numbers:
            time.sleep(_TIDYING_S)
            from ..output import drop_unfinished

            drop_unfinished()
            os.write(2, f"gnomon: {_INTERRUPTED}\n".encode())
            os._exit(128 + data[0])


class EndedError(KeyboardInterrupt):
    """A signal asked the program to end.

    Parameters
    ----------
    number : of the signal
    """

    def __init__(self, number: int) -> None:
        super().__init__()
        self.exit_code = 128 + number


def main(arguments: Sequence[str]) -> int:
    """Run the command that the arguments ask for, and return its exit code.

    0 usable, 2 wrong usage, 3 bad input or a place that cannot be written, 4 finished but the verdict says do not use.
    """
    from .command import parse_command
    from .files import recover_interrupted_write, refuse_missing, spared_inputs

    terminal = Terminal(as_json="--json" in arguments)
    try:
        command = parse_command(arguments)
        terminal = Terminal(as_json=command.json, quiet=command.quiet, verbose=command.verbose, log=command.log)
        recover_interrupted_write(command)
        refuse_missing(command)
        with spared_inputs(command), listening_to(terminal.progress):
            return command.run(terminal)
    except SystemExit:  # help or version was asked for, and printed
        return 0
    except BrokenPipeError:
        raise
    except (Exception, KeyboardInterrupt) as error:
        full = isinstance(error, OSError) and error.filename is None and system_error_words(error)
        if full or os.environ.get("GNOMON_DEBUG"):  # nothing more can be said on that output
            raise
        return _failed(terminal, type(error).__name__, *explain_error(error))
    finally:
        terminal.close()


def explain_error(error: BaseException) -> tuple[str, int]:
    """Return what a person is told about an error, and the exit code."""
    match error:
        case OptionError():
            return str(error), USAGE
        case GnomonError():
            return str(error), BAD_INPUT
        case OSError() | ImportError() if words := system_error_words(error):
            return words, BAD_INPUT
        case MemoryError():
            return "this does not fit into memory. Close other programs, or split the recording.", BAD_INPUT
        case KeyboardInterrupt():
            ended = error if isinstance(error, EndedError) else error.__cause__
            return str(error) or _INTERRUPTED, ended.exit_code if isinstance(ended, EndedError) else INTERRUPTED
        case _:
            what = f"{type(error).__name__}: {error}"
            return f"this is a bug in gnomon ({what}). Please report it, with what GNOMON_DEBUG=1 shows.", BUG


def _failed(terminal: "Terminal", kind: str, message: str, code: int) -> int:
    """Say what went wrong, once, and return the exit code."""
    terminal.close()
    terminal.warn(f"gnomon: {printable_text(message)}")
    terminal.document({"error": {"kind": kind, "message": message, "exit_code": code}})
    return code


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
