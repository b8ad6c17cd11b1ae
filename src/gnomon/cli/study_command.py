"""The command that repeats the documents' experiments."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from ..errors import OptionError
from .command_parts import Switch, output_option

StudyName = Literal["angrisano"]


@dataclass(frozen=True, kw_only=True)
class Study:
    """Repeat the experiment of a document many times with simulated sensors, and say whether its claims hold."""

    name: Annotated[StudyName, tyro.conf.Positional]
    """angrisano: document C, the accelerometer from magnitudes: its sigmas, and the starts from which it converges."""
    output: Annotated[Path | None, output_option("DIR")] = None
    """Folder for study.html and the tables as CSV (default: gnomon-study-NAME)."""
    runs: int | None = None
    """How many experiments of each kind; as many as the document's numbers need where not given."""
    jobs: int = 1
    """Processes that share them; the result does not depend on it."""
    seed: int = 0
    """All random numbers follow from it."""
    json: Annotated[bool, Switch] = False
    """Print one JSON document instead of text."""

    def __post_init__(self) -> None:
        if self.runs is not None and self.runs < 2:
            raise OptionError(f"runs {self.runs} must be at least 2, since one has no scatter.")
        if self.jobs < 1:
            raise OptionError(f"jobs {self.jobs} must be at least 1.")
