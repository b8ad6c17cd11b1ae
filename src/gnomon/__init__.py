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

# At once: later, the function simulate would be hidden by the room of the same name.
from .simulate import CameraImuScenario, Scenario, simulate, simulate_camera_imu

if TYPE_CHECKING:
    from .assess.doctor import check
    from .calibrate import calibrate_camera_imu, calibrate_imu, read_camera_imu
    from .calibration import (
        AccelerometerCalibration,
        Calibration,
        CameraCalibration,
        Covariance,
        GyroscopeCalibration,
        ImuCalibration,
    )
    from .diagnostics import Result
    from .findings import Finding
    from .models.camera import Camera
    from .models.noise import ImuNoise
    from .models.target import Target
    from .options import CameraImuOptions, ImuOptions
    from .readers import load, read
    from .readers.foreign import ForeignCalibration
    from .readers.foreign_files import load_foreign
    from .recording import CameraFrames, ImuSamples, Recording, TriadSamples
    from .report import write_report
    from .units import Units
    from .writers import Loss, convert, save, save_camera_imu_files

_HOMES = {
    "AccelerometerCalibration": "calibration",
    "Calibration": "calibration",
    "CameraCalibration": "calibration",
    "Covariance": "calibration",
    "Finding": "findings",
    "GyroscopeCalibration": "calibration",
    "ImuCalibration": "calibration",
    "Camera": "models.camera",
    "CameraFrames": "recording",
    "CameraImuOptions": "options",
    "ForeignCalibration": "readers.foreign",
    "ImuNoise": "models.noise",
    "ImuOptions": "options",
    "ImuSamples": "recording",
    "Loss": "writers",
    "Recording": "recording",
    "Result": "diagnostics",
    "Target": "models.target",
    "TriadSamples": "recording",
    "Units": "units",
    "calibrate_camera_imu": "calibrate",
    "calibrate_imu": "calibrate",
    "check": "assess.doctor",
    "convert": "writers",
    "load": "readers",
    "load_foreign": "readers.foreign_files",
    "read": "readers",
    "read_camera_imu": "calibrate",
    "save": "writers",
    "save_camera_imu_files": "writers",
    "write_report": "report",
}

__all__ = [
    "AccelerometerCalibration",
    "Calibration",
    "Camera",
    "CameraCalibration",
    "CameraFrames",
    "CameraImuOptions",
    "CameraImuScenario",
    "Covariance",
    "DetectionError",
    "Finding",
    "ForeignCalibration",
    "FormatError",
    "GnomonError",
    "GyroscopeCalibration",
    "ImuCalibration",
    "ImuNoise",
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
    "Target",
    "TriadSamples",
    "Units",
    "__version__",
    "calibrate_camera_imu",
    "calibrate_imu",
    "check",
    "convert",
    "load",
    "load_foreign",
    "read",
    "read_camera_imu",
    "save",
    "save_camera_imu_files",
    "simulate",
    "simulate_camera_imu",
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
