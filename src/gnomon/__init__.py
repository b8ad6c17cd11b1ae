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
from .simulate import simulate

if TYPE_CHECKING:
    from .assess.checks.doctor import check
    from .assess.comparison.comparison import Comparison
    from .assess.comparison.verification import Verification
    from .calibrate.camera_imu import calibrate_camera_imu
    from .calibrate.cameras import calibrate_cameras
    from .calibrate.comparison import compare
    from .calibrate.imu import calibrate_imu
    from .calibrate.judging import judge
    from .calibrate.magnetometer import calibrate_magnetometer
    from .calibrate.noise import identify_noise
    from .calibrate.planning import PlanResult, plan, read_hardware
    from .calibrate.platter_rate import rate_from_video
    from .calibrate.steps.camera_imu_reading import read_camera_imu
    from .calibrate.steps.camera_reading import read_camera_views
    from .calibrate.temperature import calibrate_temperature
    from .calibrate.turntable import calibrate_turntable
    from .calibrate.verification import verify
    from .detect.platter.rate import PlatterRate
    from .findings import Finding
    from .formats.conversion import convert
    from .formats.foreign import ForeignCalibration
    from .formats.foreign_files import load_foreign
    from .formats.own.calibration_file import load
    from .formats.own.calibration_text import save
    from .formats.own.noise_file import load_noise, save_noise
    from .formats.shared.losses import Loss
    from .models.camera import Camera
    from .models.target import Target
    from .options import (
        CameraImuOptions,
        CameraOptions,
        FrameSelection,
        ImuOptions,
        MagnetometerOptions,
        NoiseOptions,
        StatedRate,
        TurntableOptions,
    )
    from .options.requirements import Use
    from .readers.recordings import read
    from .readers.samples.turntable_files import read_turntable
    from .recording import CameraFrames, ImuSamples, Poses, Recording, TriadSamples
    from .recording.samples import ImuNoise
    from .report.comparison import write_comparison_report, write_verification_report
    from .report.noise import write_noise_report
    from .report.page import write_report
    from .results.calibration import (
        AccelerometerCalibration,
        Calibration,
        CameraCalibration,
        Covariance,
        GyroscopeCalibration,
        ImuCalibration,
        MagnetometerCalibration,
    )
    from .results.result import Result
    from .results.sensor_noise import NoiseResult, SensorNoise
    from .simulate import (
        CameraImuPlan,
        CameraImuScenario,
        CamerasScenario,
        FieldScenario,
        ImuPlan,
        PoseScenario,
        Scenario,
        TurntableScenario,
        simulate_camera_imu,
        simulate_cameras,
        simulate_magnetometer,
        simulate_poses,
        simulate_turntable,
    )
    from .units import Units
    from .writers.kalibr_files import save_camera_files, save_camera_imu_files

_HOMES = {
    name: home
    for home, names in {
        "assess.checks.doctor": "check",
        "assess.comparison.comparison": "Comparison",
        "assess.comparison.verification": "Verification",
        "calibrate.camera_imu": "calibrate_camera_imu",
        "calibrate.cameras": "calibrate_cameras",
        "calibrate.comparison": "compare",
        "calibrate.imu": "calibrate_imu",
        "calibrate.judging": "judge",
        "calibrate.magnetometer": "calibrate_magnetometer",
        "calibrate.noise": "identify_noise",
        "calibrate.planning": "PlanResult plan read_hardware",
        "calibrate.platter_rate": "rate_from_video",
        "calibrate.steps.camera_imu_reading": "read_camera_imu",
        "calibrate.steps.camera_reading": "read_camera_views",
        "calibrate.temperature": "calibrate_temperature",
        "calibrate.turntable": "calibrate_turntable",
        "calibrate.verification": "verify",
        "detect.platter.rate": "PlatterRate",
        "findings": "Finding",
        "formats.conversion": "convert",
        "formats.foreign": "ForeignCalibration",
        "formats.foreign_files": "load_foreign",
        "formats.own.calibration_file": "load",
        "formats.own.calibration_text": "save",
        "formats.own.noise_file": "load_noise save_noise",
        "formats.shared.losses": "Loss",
        "models.camera": "Camera",
        "models.target": "Target",
        "options": (
            "CameraImuOptions CameraOptions FrameSelection ImuOptions MagnetometerOptions NoiseOptions StatedRate "
            "TurntableOptions"
        ),
        "options.requirements": "Use",
        "readers.recordings": "read",
        "readers.samples.turntable_files": "read_turntable",
        "recording": "CameraFrames ImuSamples Poses Recording TriadSamples",
        "recording.samples": "ImuNoise",
        "report.comparison": "write_comparison_report write_verification_report",
        "report.noise": "write_noise_report",
        "report.page": "write_report",
        "results.calibration": (
            "AccelerometerCalibration Calibration CameraCalibration Covariance GyroscopeCalibration "
            "ImuCalibration MagnetometerCalibration"
        ),
        "results.result": "Result",
        "results.sensor_noise": "NoiseResult SensorNoise",
        "simulate": (
            "CameraImuPlan CameraImuScenario CamerasScenario FieldScenario ImuPlan PoseScenario Scenario "
            "TurntableScenario simulate_camera_imu simulate_cameras simulate_magnetometer simulate_poses "
            "simulate_turntable"
        ),
        "units": "Units",
        "writers.kalibr_files": "save_camera_files save_camera_imu_files",
    }.items()
    for name in names.split()
}

__all__ = [
    "AccelerometerCalibration",
    "Calibration",
    "Camera",
    "CameraCalibration",
    "CameraFrames",
    "CameraImuOptions",
    "CameraImuPlan",
    "CameraImuScenario",
    "CameraOptions",
    "CamerasScenario",
    "Comparison",
    "Covariance",
    "DetectionError",
    "FieldScenario",
    "Finding",
    "ForeignCalibration",
    "FormatError",
    "FrameSelection",
    "GnomonError",
    "GyroscopeCalibration",
    "ImuCalibration",
    "ImuNoise",
    "ImuOptions",
    "ImuPlan",
    "ImuSamples",
    "InitialisationError",
    "Loss",
    "MagnetometerCalibration",
    "MagnetometerOptions",
    "NoiseOptions",
    "NoiseResult",
    "OptionError",
    "OutputError",
    "PlanResult",
    "PlatterRate",
    "PoseScenario",
    "Poses",
    "Recording",
    "RecordingError",
    "Result",
    "Scenario",
    "SensorNoise",
    "SolveError",
    "StatedRate",
    "Target",
    "TriadSamples",
    "TurntableOptions",
    "TurntableScenario",
    "Units",
    "Use",
    "Verification",
    "__version__",
    "calibrate_camera_imu",
    "calibrate_cameras",
    "calibrate_imu",
    "calibrate_magnetometer",
    "calibrate_temperature",
    "calibrate_turntable",
    "check",
    "compare",
    "convert",
    "identify_noise",
    "judge",
    "load",
    "load_foreign",
    "load_noise",
    "plan",
    "rate_from_video",
    "read",
    "read_camera_imu",
    "read_camera_views",
    "read_hardware",
    "read_turntable",
    "save",
    "save_camera_files",
    "save_camera_imu_files",
    "save_noise",
    "simulate",
    "simulate_camera_imu",
    "simulate_cameras",
    "simulate_magnetometer",
    "simulate_poses",
    "simulate_turntable",
    "verify",
    "write_comparison_report",
    "write_noise_report",
    "write_report",
    "write_verification_report",
]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'gnomon' has no attribute '{name}'")
    value = getattr(import_module(f".{_HOMES[name]}", __name__), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return __all__
