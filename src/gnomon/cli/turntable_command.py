"""The commands for a gyroscope on a turntable."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import tyro

from ..errors import OptionError
from ..simulate.turntable_scenario import TurntableScenario
from ..triad_options import TurntableOptions
from ..units import Units
from .command_parts import Flat, Switch, output_option
from .use_option import UseOption


@dataclass(frozen=True, kw_only=True)
class Turntable:
    """Calibrate a gyroscope from recordings on a turntable, such as a record player.

    Put the sensor on the platter in eighteen orientations, each face down and each edge with a wedge. In each let the
    platter rest for 5 s, turn for half a minute, and rest again.
    """

    recordings: Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="PATH ...")]
    """One recording of all of it, or one for each orientation or speed; or a folder of these."""
    rate: Annotated[tuple[str, ...], tyro.conf.arg(metavar="RATE ...", help_behavior_hint="(required)")] = ()
    """Speeds of the platter, such as 16rpm, 33.33rpm or 2.0rad/s, or videos of it, which tell the speed. Each steady
    part has the speed nearest to what it shows; FILE=RATE states it for one of several recordings."""
    columns: str | None = None
    """What the columns of a table are, such as "t ax ay az gx gy gz"; _ skips one."""
    sample_rate: float | None = None
    """Sample rate in Hz, for a table without time."""
    units: str | None = None
    """Units of the recordings: "si", "raw" (counts), or a list such as "g deg/s us"; recognised where not given."""
    output: Annotated[Path | None, output_option("DIR")] = None
    """Folder for calibration.yaml, report.html and diagnostics.npz (default: NAME-turntable beside the first
    recording)."""
    use: UseOption = None
    """What it is for: vio, ahrs, gimbal, phone, or a YAML file that states what is needed; the verdict is then for that
    use."""
    report: Annotated[bool, Switch] = True
    """Do not make the report."""
    json: Annotated[bool, Switch] = False
    """Print one JSON document instead of text."""
    options: Annotated[TurntableOptions, Flat] = field(default_factory=TurntableOptions)

    def __post_init__(self) -> None:
        if self.units is not None:
            Units.parse(self.units)
        if not self.rate:
            raise OptionError(
                "--rate is missing: how fast the platter turned, such as --rate 33.33rpm, or a video of it. "
                "Where nobody knows, state about how fast and add --free rate.scale."
            )


@dataclass(frozen=True, kw_only=True)
class SimulateTurntable:
    """Make recordings of a simulated sensor on a turntable, and its true calibration beside them (truth.yaml)."""

    output: Annotated[Path, output_option("DIR", "(required)")]
    """Folder for the recordings."""
    seed: int = 0
    """All random numbers follow from it."""
    video: Annotated[bool, tyro.conf.arg(help_behavior_hint="")] = False
    """Make a video of the platter at each speed, too."""
    json: Annotated[bool, Switch] = False
    """Print one JSON document instead of text."""
    scenario: Annotated[TurntableScenario, Flat] = field(default_factory=TurntableScenario)
