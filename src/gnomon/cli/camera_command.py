"""The command for cameras alone."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import tyro

from ..camera_options import CameraOptions
from ..errors import OptionError
from ..models.lens_programs import check_program
from ..units import Units
from .command_parts import FileOption, Flat, Switch, output_option
from .topics import topics_of


@dataclass(frozen=True, kw_only=True)
class CameraCommand:
    """Calibrate the lenses of one camera or several, and where they sit to each other, from views of a board.

    Show the board to the camera in thirty views or more: near and far, tilted by up to 45 degrees to all sides, and in
    every corner of the image; of several cameras as many as possible together. Nothing need be known of the lens.
    """

    recording: tyro.conf.Positional[Path]
    """A folder of images (of several cameras in cam0, cam1, ... or left and right), a ROS 1 or ROS 2 bag, a folder in
    the layout of EuRoC, TUM-VI or Kalibr, a video; or a folder with corners, cam0_corners.csv, cam1_corners.csv, ..."""
    target: Annotated[Path | None, FileOption] = None
    """Kalibr's file of the board (default: target.yaml in the recording's folder)."""
    cam: Annotated[Path | None, tyro.conf.arg(aliases=["--cams"], metavar="FILE", help_behavior_hint="")] = None
    """A camchain.yaml or calibration.yaml whose topics, line delays and image sizes are taken; its lenses are not
    used."""
    resolution: Annotated[tuple[int, int] | None, tyro.conf.arg(metavar="WIDTH HEIGHT", help_behavior_hint="")] = None
    """Size of the images in pixels, for a folder with corners; images tell it themselves."""
    topics: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME=TOPIC ...", help_behavior_hint="")] = ()
    """Topics of a bag, such as cam0=/left/image_raw cam1=/right/image_raw; guessed where it is clear."""
    units: str | None = None
    """Unit of the stamps in tables, such as us; recognised where not given."""
    workers: int | None = None
    """How many look for the board in the images at once; as many as there are cores where not given."""
    cache: Annotated[bool, Switch] = True
    """Do not keep the corners that were found in the result's folder, nor use those that an earlier run kept there."""
    output: Annotated[Path | None, output_option("DIR")] = None
    """Folder for calibration.yaml, report.html, diagnostics.npz and Kalibr's camchain.yaml and results-cam.txt
    (default: NAME-camera beside the recording)."""
    program: Annotated[str | None, tyro.conf.arg(name="for", metavar="PROGRAM", help_behavior_hint="")] = None
    """A program that shall read the result: kalibr, openvins, vins-fusion, orb-slam3, basalt, okvis or ros2; the lens
    model is then chosen among those that it knows."""
    report: Annotated[bool, Switch] = True
    """Do not make the report."""
    json: Annotated[bool, Switch] = False
    """Print one JSON document instead of text."""
    options: Annotated[CameraOptions, Flat] = field(default_factory=CameraOptions)

    def __post_init__(self) -> None:
        if self.program is not None:
            check_program(self.program)
            if self.options.model or self.options.among:
                raise OptionError("--for chooses among a program's lens models. Leave it out, or --model and --among.")
        topics_of(self.topics)
        if self.units is not None:
            Units.parse(self.units)
        if self.workers is not None and self.workers < 1:
            raise OptionError(f"workers {self.workers} must be at least 1.")
        if self.resolution is not None and min(self.resolution) < 1:
            raise OptionError(
                f"resolution {self.resolution[0]} {self.resolution[1]} must be at least 1 pixel each way."
            )
