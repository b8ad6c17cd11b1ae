"""What a person may choose; the command line is made from these classes."""

from .cameras import (
    BOARDS,
    COVARIANCES,
    BoardModel,
    CameraImuOptions,
    CameraOptions,
    CovarianceKind,
    FrameSelection,
    stated_prior,
)
from .imu import ImuOptions, MagnetometerOptions, NoiseOptions, Preset, StatedRate, TurntableOptions, default_rate_sigma
from .ranges import check_ranges, option_range

__all__ = [
    "BOARDS",
    "COVARIANCES",
    "BoardModel",
    "CameraImuOptions",
    "CameraOptions",
    "CovarianceKind",
    "FrameSelection",
    "ImuOptions",
    "MagnetometerOptions",
    "NoiseOptions",
    "Preset",
    "StatedRate",
    "TurntableOptions",
    "check_ranges",
    "default_rate_sigma",
    "option_range",
    "stated_prior",
]
