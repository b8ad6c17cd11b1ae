"""The option --for: what a calibration is judged for."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from ..errors import OptionError
from ..models.lens_programs import PROGRAMS

if TYPE_CHECKING:
    from ..diagnostics import Result
    from ..requirements import Use

UseOption = Annotated[str | None, tyro.conf.arg(name="for", metavar="USE", help_behavior_hint="")]
"""A built-in use, or a file; the field is called `use`, since `for` is a word of Python."""


def read_use_option(use: str | None) -> "Use | None":
    """Return what a use needs; None where none is stated. Called before the work, so that typing errors cost none.

    Raises
    ------
    OptionError
        If there is no such use; FormatError where its file is not as it should be.
    """
    if use is None:
        return None
    if use in PROGRAMS and not Path(use).exists():
        raise OptionError(
            f"--for {use}: this is a program, and here a use is stated, such as vio. gnomon camera --for {use} chooses "
            f"lenses that it reads, gnomon convert --to {use} writes its files."
        )
    from ..calibrate.judging import stated_use

    return stated_use(use)


def judged_result(result: "Result", use: "Use | None") -> "Result":
    """Return a result whose calibration is judged for a use, where one is stated."""
    if use is None:
        return result
    from ..calibrate.judging import judge

    return replace(result, calibration=judge(result.calibration, use))
