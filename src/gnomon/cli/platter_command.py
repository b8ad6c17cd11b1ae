"""The commands about videos of a turning platter."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import tyro

from ..errors import OptionError
from ..simulate.platter_scenario import PlatterScenario
from ..units import parse_rate
from .command_parts import Flat, Switch, output_option


@dataclass(frozen=True, kw_only=True)
class Rate:
    """Measure how fast a platter turns, from a video of it.

    Fix a webcam so that it sees most of the platter, and record for a minute or more at a constant speed. A mark on
    the platter helps, but any print will do.
    """

    video: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="VIDEO")]
    """A video, with a table of the stamps of its frames beside it where there is one (platter.csv of platter.avi)."""
    nominal: Annotated[str | None, tyro.conf.arg(metavar="RATE", help_behavior_hint="")] = None
    """What the rate should be within 10 %, such as 33.33rpm or 2.0rad/s; needed where the picture leaves it open."""
    json: Annotated[bool, Switch] = False
    """Print one JSON document instead of text."""

    def __post_init__(self) -> None:
        if self.nominal is not None and not parse_rate(self.nominal) > 0:
            raise OptionError(f"--nominal {self.nominal}: a platter that does not turn has no rate in a video.")

    @property
    def nominal_rad_s(self) -> float | None:
        """The nominal rate, where it was stated [rad/s]."""
        return None if self.nominal is None else parse_rate(self.nominal)


@dataclass(frozen=True, kw_only=True)
class SimulatePlatterVideo:
    """Make a video of a simulated platter, as a webcam sees it."""

    output: Annotated[Path, output_option("FILE", "(required)")]
    """Video to write: .mkv or .mp4, with the time of each frame, or .avi, which has only a frame rate."""
    seed: int = 0
    """All random numbers follow from it."""
    json: Annotated[bool, Switch] = False
    """Print one JSON document instead of text."""
    scenario: Annotated[PlatterScenario, Flat] = field(default_factory=PlatterScenario)
