"""The command that simulates cameras without an IMU."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, ClassVar, Literal

from ..simulate.cameras_scenario import CamerasScenario
from .command_parts import FileOption, Flat, FromScenario, Switch, output_option

ImagesAs = Literal["folder", "euroc", "ros1", "ros2", "mcap"]


@dataclass(frozen=True, kw_only=True)
class SimulateCameras(FromScenario):
    """Make a folder with a recording of simulated cameras in front of a board, and its truth (truth.yaml).

    `gnomon camera` takes the folder as it is, or the bag in it.
    """

    scenario_type: ClassVar[type] = CamerasScenario

    output: Annotated[Path, output_option("DIR", "(required)")]
    """Folder for the recording."""
    scenario: Annotated[Path | None, FileOption] = None
    """A scenario.yaml that states the options below; those that are given here as well replace its own."""
    form: ImagesAs = "folder"
    """With --images: images in folders cam0, ... (folder), in EuRoC's layout (euroc), a ROS 1 bag (ros1), a ROS 2 bag
    in SQLite (ros2), or an MCAP file (mcap)."""
    seed: int = 0
    """All random numbers follow from it."""
    json: Annotated[bool, Switch] = False
    """Print one JSON document instead of text."""
    options: Annotated[CamerasScenario, Flat] = field(default_factory=CamerasScenario)
