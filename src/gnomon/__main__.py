"""The program `gnomon`, also `python -m gnomon`."""

import sys

if __name__ == "__main__" and not sys.flags.safe_path:
    del sys.path[0]  # python -m puts the working directory there, and with it whatever modules a recording comes with

import os
import signal
from contextlib import suppress
from types import FrameType

_ENDING = ("SIGTERM", "SIGHUP")
"""Signals that end a program unless it does something about them; an interrupt is Python's own business."""


def main() -> None:
    """Run the command line and leave with its exit code."""
    os.environ["PYTHONSAFEPATH"] = "1"  # of every process that is started from here, by whatever library
    # One BLAS thread, before NumPy is there to start more: the problems are small, and threads cost start-up time.
    for library in ("OPENBLAS", "OMP", "MKL"):
        os.environ.setdefault(f"{library}_NUM_THREADS", "1")
    for stream in (sys.stdout, sys.stderr):
        reconfigure = getattr(stream, "reconfigure", None)
        if reconfigure is not None:
            reconfigure(errors="replace")  # a terminal without some character still shows the rest
    try:
        from .cli import main as run

        _tidy_up_when_ended()
        code = run(sys.argv[1:])
        sys.stdout.flush()
    except BrokenPipeError:  # the reader of our output has gone, as with `gnomon show FILE | head`
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        code = 1
    except KeyboardInterrupt:  # before there was anything to tidy up
        sys.stderr.write("gnomon: interrupted.\n")
        code = 130
    sys.exit(code)


def _tidy_up_when_ended() -> None:
    """Let signals that end the program be told to it as an interrupt is, so that nothing is left behind."""
    from .cli import EndedError

    def ended(number: int, _frame: FrameType | None) -> None:
        signal.signal(number, signal.SIG_IGN)  # tidying up is not disturbed
        raise EndedError(number)

    for name in _ENDING:
        number = getattr(signal, name, None)  # Windows has no SIGHUP, and its SIGTERM asks nobody
        if number is not None and signal.getsignal(number) is signal.SIG_DFL:  # nohup ignores one
            with suppress(ValueError):  # not the main thread
                signal.signal(number, ended)


if __name__ == "__main__":
    main()
