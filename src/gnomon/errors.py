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
