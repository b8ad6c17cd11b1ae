"""The recipes, one page each: the only place where the rooms meet."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .camera_imu import calibrate_camera_imu
    from .camera_imu_reading import read_camera_imu
    from .imu import calibrate_imu

_HOMES = {"calibrate_camera_imu": "camera_imu", "calibrate_imu": "imu", "read_camera_imu": "camera_imu_reading"}

__all__ = ["calibrate_camera_imu", "calibrate_imu", "read_camera_imu"]


def __getattr__(name: str) -> Any:  # each recipe loads only what it needs
    if name not in _HOMES:
        raise AttributeError(f"module 'gnomon.calibrate' has no attribute '{name}'")
    return getattr(import_module(f".{_HOMES[name]}", __name__), name)
