"""The recipes, one page each: the only place where the rooms meet."""

from .imu import calibrate_imu

__all__ = ["calibrate_imu"]
