"""What can go wrong, as one tree.

GnomonError
├── RecordingError        a recording cannot be read or used
│   └── DetectionError    it was read, but what the method needs is not in it
├── OptionError           an option, alone or with another one, makes no sense
├── InitialisationError   no starting point could be found
├── SolveError            an estimate could not be computed
├── FormatError           a calibration or another structured file is not as its format says
└── OutputError           a result cannot be written where it was asked for

A message says what, where (file, line, time), what was found against what was expected, and the next step.
Non-convergence and weak observability are statuses on a result, not errors.
"""

import errno
import os
import sys

_FULL = (errno.ENOSPC, errno.EIO, errno.EFBIG, errno.EDQUOT, errno.EBADF, errno.EROFS)
_FEW = (errno.EMFILE, errno.ENFILE)


def system_error_words(error: BaseException) -> str:
    """Return what the system did not allow, in words; "" where an error is not of that kind.

    Libraries wrap such an error in others.
    """
    cause: BaseException | None = error
    while cause is not None and not isinstance(cause, OSError):
        cause = cause.__cause__ or cause.__context__
    number = cause.errno if isinstance(cause, OSError) else None
    if number in _FEW or os.strerror(errno.EMFILE) in str(error):
        return "too few files may be open at once. Raise the limit, such as with: ulimit -n 256"
    if number in _FULL:
        return f"the output cannot be written ({os.strerror(number or 0)}). Files that are there are whole."
    return ""


def install_line(*packages: str) -> str:
    """Return the command that installs packages, or an extra of gnomon, for the Python that runs.

    It fits a checkout, a wheel, and an environment without pip as uv makes them, in any shell.
    """
    from importlib.metadata import PackageNotFoundError, version
    from importlib.util import find_spec

    python = f'"{sys.executable}"' if " " in sys.executable else sys.executable
    try:
        version("gnomon")
    except PackageNotFoundError:  # it runs from the source; the name alone would ask an index for it
        packages = tuple(name.replace("gnomon[", ".[") for name in packages)
    program = f"{python} -m pip install" if find_spec("pip") else f"uv pip install --python {python}"
    return " ".join((program, *(f'"{name}"' if "[" in name else name for name in packages)))


class GnomonError(Exception):
    """Root of all errors that gnomon raises on purpose."""


class RecordingError(GnomonError):
    """A recording cannot be read or used."""


class DetectionError(RecordingError):
    """A recording was read, but what the method needs was not found in it."""


class OptionError(GnomonError, ValueError):
    """An option, alone or together with another one, makes no sense."""


class InitialisationError(GnomonError):
    """No starting point for an estimate could be found."""


class SolveError(GnomonError):
    """An estimate could not be computed."""


class FormatError(GnomonError):
    """A structured file is not as its format says."""


class OutputError(GnomonError):
    """A result cannot be written where it was asked for."""
