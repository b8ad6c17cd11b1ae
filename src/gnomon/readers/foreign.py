"""What other projects' calibration files tell: the sensors, and seldom more."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

import numpy as np

from ..calibration import ImuCalibration
from ..recording import Floats


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ForeignCalibration:
    """Sensors read from another project's files.

    Attributes
    ----------
    imus : mapping from "imu0", "imu1", ... to ImuCalibration
    frame : body frame, "accel-x", "accel-z" or "user"
    sigmas : parameter path -> standard deviations in the parameter's shape; empty where the format has none
    notes : sentences on what the file does not say and what was taken instead
    """

    imus: Mapping[str, ImuCalibration]
    frame: str
    sigmas: Mapping[str, Floats] = field(default_factory=dict[str, Floats])
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "imus", MappingProxyType(dict(self.imus)))
        object.__setattr__(self, "sigmas", MappingProxyType(dict(self.sigmas)))


def recognised_frame(imus: Mapping[str, ImuCalibration]) -> str:
    """Return the frame in which every accelerometer's sensitivity is triangular as that frame asks, else "user"."""
    matrices = [imu.accelerometer.sensitivity for imu in imus.values()]
    for frame, strict in (("accel-x", np.triu), ("accel-z", np.tril)):
        off = -1 if frame == "accel-z" else 1
        if all(np.abs(strict(S, off)).max() <= 1e-9 * np.abs(S).max() for S in matrices):
            return frame
    return "user"
