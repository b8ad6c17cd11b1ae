"""The commands that plan a recording, as dataclasses from which their options and their help are made."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import tyro

from ..simulate.plans import CameraImuPlan, ImuPlan
from .command_parts import FileOption, Flat, Switch
from .use_option import UseOption


@dataclass(frozen=True, kw_only=True)
class Plan:
    """Predict how well cameras and an IMU would be calibrated by a recording that is still to be made.

    Nothing is recorded: the motion is simulated, and the estimation's own equations tell the standard deviations.
    """

    cam: Annotated[Path | None, tyro.conf.arg(aliases=["--cams"], metavar="FILE", help_behavior_hint="")] = None
    """Kalibr's file of the cameras, or a calibration.yaml (default: one camera of 640 x 480 px)."""
    imu: Annotated[Path | None, FileOption] = None
    """Kalibr's file of the IMU's noise (default: that of a consumer sensor); of several IMUs the first is planned."""
    target: Annotated[Path | None, FileOption] = None
    """Kalibr's file of the board (default: an AprilGrid of 6 x 6 tags of 88 mm)."""
    use: UseOption = None
    """What it is for: vio, ahrs, gimbal, phone, or a YAML file that states what is needed."""
    seed: int = 0
    """Of the path, of which only kind and size are planned."""
    json: Annotated[bool, Switch] = False
    """Print one JSON document instead of text."""
    plan: Annotated[CameraImuPlan, Flat] = field(default_factory=CameraImuPlan)


@dataclass(frozen=True, kw_only=True)
class PlanImu:
    """Predict how well an IMU would be calibrated by a recording with rests that is still to be made."""

    imu: Annotated[Path | None, FileOption] = None
    """Kalibr's file of the IMU's noise (default: that of a consumer sensor)."""
    use: UseOption = None
    """What it is for: vio, ahrs, gimbal, phone, or a YAML file that states what is needed."""
    seed: int = 0
    """Of the attitudes, of which only number and spread are planned."""
    json: Annotated[bool, Switch] = False
    """Print one JSON document instead of text."""
    plan: Annotated[ImuPlan, Flat] = field(default_factory=ImuPlan)
