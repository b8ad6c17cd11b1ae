"""The command line: parse, call, print. Whatever it can do, the Python API can do as well."""

import os
from collections.abc import Sequence

from ..errors import GnomonError, OptionError, system_error_words
from ..findings import printable_text
from ..progress import listening_to
from .command import parse_command
from .inputs import refuse_missing
from .output_folder import recover_interrupted_write, spared_inputs
from .terminal import Terminal

USAGE, BAD_INPUT, BUG, INTERRUPTED = 2, 3, 1, 130
"""Exit codes of work that was not finished; those of finished work are in `results`."""
_INTERRUPTED = "interrupted; no file is half-written."


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


def _failed(terminal: Terminal, kind: str, message: str, code: int) -> int:
    """Say what went wrong, once, and return the exit code."""
    terminal.close()
    terminal.warn(f"gnomon: {printable_text(message)}")
    terminal.document({"error": {"kind": kind, "message": message, "exit_code": code}})
    return code
