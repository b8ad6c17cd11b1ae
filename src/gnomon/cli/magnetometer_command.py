"""The commands for a magnetometer."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

from ..simulate import FieldScenario
from ..triad_options import MagnetometerOptions
from .command_parts import Flat, Input, Switch, output_option
from .use_option import UseOption


@dataclass(frozen=True, kw_only=True)
class Magnetometer:
    """Calibrate hard and soft iron of a magnetometer from one recording in which it was turned by hand.

    Turn the sensor slowly through all attitudes, in one place away from iron, for a minute or two. With the
    accelerometer in the recording both come out in one frame.
    """

    recording: Annotated[Input, Flat]
    output: Annotated[Path | None, output_option("DIR")] = None
    """Folder for calibration.yaml, report.html and diagnostics.npz (default: NAME-magnetometer beside the
    recording)."""
    use: UseOption = None
    """What it is for: vio, ahrs, gimbal, phone, or a YAML file that states what is needed; the verdict is then for that
    use."""
    report: Annotated[bool, Switch] = True
    """Do not make the report."""
    json: Annotated[bool, Switch] = False
    """Print one JSON document instead of text."""
    options: Annotated[MagnetometerOptions, Flat] = field(default_factory=MagnetometerOptions)


@dataclass(frozen=True, kw_only=True)
class SimulateMagnetometer:
    """Make a recording of a simulated magnetometer turned by hand, and its true calibration beside it (truth.yaml)."""

    output: Annotated[Path, output_option("FILE", "(required)")]
    """Recording to write, .npz or .csv."""
    seed: int = 0
    """All random numbers follow from it."""
    json: Annotated[bool, Switch] = False
    """Print one JSON document instead of text."""
    scenario: Annotated[FieldScenario, Flat] = field(default_factory=FieldScenario)
