"""The recipes, one page each: the only place where the rooms meet."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .camera_imu import calibrate_camera_imu
    from .cameras import calibrate_cameras
    from .imu import calibrate_imu
    from .judging import judge
    from .magnetometer import calibrate_magnetometer
    from .noise import identify_noise
    from .planning import plan, read_hardware
    from .platter_rate import rate_from_video
    from .steps.camera_imu_reading import read_camera_imu
    from .steps.camera_reading import read_camera_views
    from .temperature import calibrate_temperature
    from .turntable import calibrate_turntable

_HOMES = {
    "identify_noise": "noise",
    "judge": "judging",
    "plan": "planning",
    "rate_from_video": "platter_rate",
    "read_camera_imu": "steps.camera_imu_reading",
    "read_camera_views": "steps.camera_reading",
    "read_hardware": "planning",
}
"""Where what is not called `calibrate_` and the name of its module stands."""

__all__ = [
    "calibrate_camera_imu",
    "calibrate_cameras",
    "calibrate_imu",
    "calibrate_magnetometer",
    "calibrate_temperature",
    "calibrate_turntable",
    "identify_noise",
    "judge",
    "plan",
    "rate_from_video",
    "read_camera_imu",
    "read_camera_views",
    "read_hardware",
]


def __getattr__(name: str) -> Any:  # each recipe loads only what it needs
    if name not in __all__:
        raise AttributeError(f"module 'gnomon.calibrate' has no attribute '{name}'")
    return getattr(import_module(f".{_HOMES.get(name, name.removeprefix('calibrate_'))}", __name__), name)
