"""gnomon: calibrate an IMU, alone or with cameras, without mechanical equipment.

Everything public is here; names are imported when they are first used, so that `import gnomon` costs nothing.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from ._version import __version__
from .errors import (
    DetectionError,
    FormatError,
    GnomonError,
    InitialisationError,
    OptionError,
    OutputError,
    RecordingError,
    SolveError,
)
from .simulate import Scenario, simulate  # at once: later, the function would be hidden by the room of the same name

if TYPE_CHECKING:
    from .assess.doctor import check
    from .calibrate import calibrate_imu
    from .calibration import (
        AccelerometerCalibration,
        Calibration,
        Covariance,
        GyroscopeCalibration,
        ImuCalibration,
    )
    from .diagnostics import Result
    from .findings import Finding
    from .options import ImuOptions
    from .readers import load, read
    from .recording import ImuSamples, Recording, TriadSamples
    from .report import write_report
    from .units import Units
    from .writers import Loss, convert, save

_HOMES = {
    "AccelerometerCalibration": "calibration",
    "Calibration": "calibration",
    "Covariance": "calibration",
    "Finding": "findings",
    "GyroscopeCalibration": "calibration",
    "ImuCalibration": "calibration",
    "ImuOptions": "options",
    "ImuSamples": "recording",
    "Loss": "writers",
    "Recording": "recording",
    "Result": "diagnostics",
    "TriadSamples": "recording",
    "Units": "units",
    "calibrate_imu": "calibrate",
    "check": "assess.doctor",
    "convert": "writers",
    "load": "readers",
    "read": "readers",
    "save": "writers",
    "write_report": "report",
}

__all__ = [
    "AccelerometerCalibration",
    "Calibration",
    "Covariance",
    "DetectionError",
    "Finding",
    "FormatError",
    "GnomonError",
    "GyroscopeCalibration",
    "ImuCalibration",
    "ImuOptions",
    "ImuSamples",
    "InitialisationError",
    "Loss",
    "OptionError",
    "OutputError",
    "Recording",
    "RecordingError",
    "Result",
    "Scenario",
    "SolveError",
    "TriadSamples",
    "Units",
    "__version__",
    "calibrate_imu",
    "check",
    "convert",
    "load",
    "read",
    "save",
    "simulate",
    "write_report",
]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'gnomon' has no attribute '{name}'")
    value = getattr(import_module(f".{_HOMES[name]}", __name__), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return __all__
