"""The commands on noise, as dataclasses from which their options and their help are made."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

from ..options import NoiseOptions
from ..simulate.noise_scenario import NoiseScenario
from .command_parts import Flat, Input, Switch, output_option


@dataclass(frozen=True, kw_only=True)
class Noise:
    """Identify the noise of an IMU from a long recording at rest: white noise, bias instability, random walk.

    Let the sensor lie where nothing can move it, at an even temperature, for 3 hours or longer.
    """

    recording: Annotated[Input, Flat]
    output: Annotated[Path | None, output_option("DIR")] = None
    """Folder for noise.yaml, Kalibr's imu.yaml, allan.csv and report.html (default: NAME-noise beside the
    recording)."""
    report: Annotated[bool, Switch] = True
    """Do not make the report."""
    json: Annotated[bool, Switch] = False
    """Print one JSON document instead of text."""
    options: Annotated[NoiseOptions, Flat] = field(default_factory=NoiseOptions)


@dataclass(frozen=True, kw_only=True)
class SimulateNoise:
    """Make a long recording of a simulated IMU at rest, with noise of known coefficients."""

    output: Annotated[Path, output_option("FILE", "(required)")]
    """Recording to write, .npz."""
    seed: int = 0
    """All random numbers follow from it."""
    json: Annotated[bool, Switch] = False
    """Print one JSON document instead of text."""
    scenario: Annotated[NoiseScenario, Flat] = field(default_factory=NoiseScenario)
