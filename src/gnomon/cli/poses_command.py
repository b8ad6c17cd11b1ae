"""The command that simulates poses."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

from ..simulate import PoseScenario
from .command_parts import Flat, Switch, output_option


@dataclass(frozen=True, kw_only=True)
class SimulatePoses:
    """Make an experiment in which a simulated sensor lies still in one attitude after another, and its truth.

    `gnomon imu` takes the table, the folder or the recording as it is.
    """

    output: Annotated[Path, output_option("PATH", "(required)")]
    """A name that ends in .csv: a table of averaged poses; in .npz: one recording of all samples; any other: a folder
    with a file for each pose. The true calibration, truth.yaml, is written beside it, or into the folder."""
    seed: int = 0
    """All random numbers follow from it."""
    json: Annotated[bool, Switch] = False
    """Print one JSON document instead of text."""
    scenario: Annotated[PoseScenario, Flat] = field(default_factory=PoseScenario)
