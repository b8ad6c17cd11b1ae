"""The command that repeats the documents' experiments."""

from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import Annotated

import tyro

from ..errors import OptionError
from .command_parts import Switch, output_option
from .studies import STUDIES


@dataclass(frozen=True, kw_only=True)
class Study:
    """Repeat the experiment of a document many times with simulated sensors, and say whether its claims hold.

    A study that was interrupted goes on where it was when the same command is given again. Without a name, list the
    studies and what they cost.
    """

    name: Annotated[
        str | None,
        tyro.conf.Positional,
        tyro.conf.arg(metavar=f"[{{{','.join(STUDIES)}}}]", help_behavior_hint=""),
    ] = None
    """tedaldi: document A's simulations. krebs: document B's. angrisano: document C's experiment."""
    output: Annotated[Path | None, output_option("DIR")] = None
    """Folder for study.html and the tables as CSV (default: gnomon-study-NAME)."""
    runs: int | None = None
    """How many runs of each kind (the list says what is counted); as many as the document's numbers need where not
    given."""
    jobs: int = 1
    """Processes that share them; the result does not depend on it."""
    scheduler: Annotated[str | None, tyro.conf.arg(metavar="ADDRESS", help_behavior_hint="")] = None
    """Let the workers of an existing Dask cluster do them, such as tcp://host:8786; needs gnomon[dask]."""
    seed: int = 0
    """All random numbers follow from it."""
    json: Annotated[bool, Switch] = False
    """Print one JSON document instead of text."""

    def __post_init__(self) -> None:
        if self.name is not None and self.name not in STUDIES:
            near = get_close_matches(self.name, STUDIES, 1)
            meant = f"Did you mean {near[0]}?" if near else f"There are: {', '.join(STUDIES)}."
            raise OptionError(f"there is no study {self.name}. {meant}")
        if self.runs is not None and self.runs < 2:
            raise OptionError(f"runs {self.runs} must be at least 2, since one has no scatter.")
        if self.jobs < 1:
            raise OptionError(f"jobs {self.jobs} must be at least 1.")
        if self.jobs > 1 and self.scheduler is not None:
            raise OptionError("the workers of --scheduler do all the work. Leave out --jobs.")
        if self.scheduler is not None and not self.scheduler.strip():
            raise OptionError("--scheduler is empty. Give the address that the scheduler prints, tcp://host:8786.")
