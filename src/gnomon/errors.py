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
