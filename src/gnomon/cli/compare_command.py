"""The command that compares calibrations."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from ..errors import OptionError
from .command_parts import Switch, output_option


@dataclass(frozen=True, kw_only=True)
class Compare:
    """Compare calibrations of one rig, made by any program: who agrees, who stands out and in what, and what repeats.

    Exit code 4 where two calibrations differ by more than the sigmas of both allow.
    """

    calibrations: Annotated[
        tuple[str, ...], tyro.conf.Positional, tyro.conf.arg(metavar="[NAME=]PATH[+PATH...] ...", help_behavior_hint="")
    ]
    """At least two: a calibration.yaml or a result's folder; files of other projects, several of one calibration joined
    by + (such as camchain-imucam.yaml+imu.yaml), or the folder that holds them: Kalibr's, OpenVINS', Basalt's,
    imucal's, imu_tk's. NAME= says what it is called (default: the part of the path that tells it from the others)."""
    rename: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME.OLD=NEW ...", help_behavior_hint="")] = ()
    """Sensors that are called otherwise in one of them, such as kalibr.cam1=cam0; else they are matched by name."""
    output: Annotated[Path | None, output_option("DIR")] = None
    """Folder for report.html and comparison.csv (default: NAME-compare beside the first of them)."""
    report: Annotated[bool, Switch] = True
    """Do not make the report, nor the table."""
    json: Annotated[bool, Switch] = False
    """Print one JSON document instead of text."""

    def __post_init__(self) -> None:
        for text in self.rename:
            left, equals, new = text.partition("=")
            if not (equals and new and all(left.rpartition("."))):
                raise OptionError(f"--rename {text}: expected NAME.OLD=NEW, such as kalibr.cam1=cam0.")


def renames_of(texts: tuple[str, ...]) -> dict[str, dict[str, str]]:
    """Return calibration's name -> old name of a sensor -> new name.

    Examples
    --------
    >>> renames_of(("kalibr.cam1=cam0",))
    {'kalibr': {'cam1': 'cam0'}}
    """
    found: dict[str, dict[str, str]] = {}
    for text in texts:
        left, _, new = text.partition("=")
        name, _, old = left.rpartition(".")
        found.setdefault(name, {})[old] = new
    return found


def sources_of(texts: tuple[str, ...]) -> list[tuple[str, list[Path]]]:
    """Return the name, or "", and the paths of each calibration; a path that is there is taken as it stands.

    Examples
    --------
    >>> sources_of(("kalibr=run-camchain.yaml+run-imu.yaml",))
    [('kalibr', [PosixPath('run-camchain.yaml'), PosixPath('run-imu.yaml')])]
    """
    found: list[tuple[str, list[Path]]] = []
    for text in texts:
        name, equals, rest = text.partition("=")
        if Path(text).exists() or not equals or "/" in name:
            name, rest = "", text
        if not rest:
            raise OptionError(f"{text}: expected a path behind the name, such as first=monday-imu.")
        parts = [rest] if Path(rest).exists() else [part for part in rest.split("+") if part]
        found.append((name, [Path(part) for part in parts]))
    return found
