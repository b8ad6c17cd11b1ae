"""Calibration -> files of this and other projects."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .calibration_file import save
    from .camera_imu_files import save_camera_imu_files
    from .conversion import convert
    from .export import Loss

_HOMES = {
    "Loss": "export",
    "convert": "conversion",
    "save": "calibration_file",
    "save_camera_imu_files": "camera_imu_files",
}

__all__ = ["Loss", "convert", "save", "save_camera_imu_files"]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'gnomon.writers' has no attribute '{name}'")
    value = getattr(import_module(f".{_HOMES[name]}", __name__), name)
    globals()[name] = value
    return value
