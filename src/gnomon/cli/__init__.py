"""The command line: parse, call, print. Whatever it can do, the Python API can do as well.

What else it needs is imported once the program can say what goes wrong.
"""

import gc
import os
import signal
import sys
import threading
import time
import warnings
from collections.abc import Sequence
from contextlib import suppress
from types import FrameType
from typing import TYPE_CHECKING, TextIO

from ..errors import GnomonError, OptionError, system_error_words

if TYPE_CHECKING:
    from .terminal import Terminal

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
    from ..progress import listening_to
    from .command import parse_command
    from .files import recover_interrupted_write, refuse_missing, spared_inputs
    from .terminal import Terminal

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
    from ..findings import printable_text

    terminal.close()
    terminal.warn(f"gnomon: {printable_text(message)}")
    terminal.document({"error": {"kind": kind, "message": message, "exit_code": code}})
    return code


# ---- the program: its outputs and its signals ----


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
