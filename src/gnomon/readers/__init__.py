"""Bytes -> Recording or Calibration; one file a format."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .own.calibration_file import load
    from .recordings import read

_HOMES = {"load": "own.calibration_file", "read": "recordings"}

__all__ = ["load", "read"]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'gnomon.readers' has no attribute '{name}'")
    value = getattr(import_module(f".{_HOMES[name]}", __name__), name)
    globals()[name] = value
    return value
