"""What the commands share: annotations of their options, and what a recording does not say about itself."""

import datetime
import re
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

from ..errors import OptionError
from ..units import Units
from .parsing.arguments import Argument, Place

if TYPE_CHECKING:
    from .terminal import Terminal


Flat = Argument(flat=True)
"""Options of a nested class appear without a prefix."""
Report = Annotated[bool, Argument(help="Do not make the report.")]
Seed = Annotated[int, Argument(help="All random numbers follow from it.")]
Workers = Annotated[
    int | None,
    Argument(help="How many look for the board in the images at once; as many as there are cores where not given."),
]
Cache = Annotated[
    bool,
    Argument(
        help="Do not keep the corners that were found in the result's folder, nor use those that an earlier run kept "
        "there.",
    ),
]
_USE = "What it is for: vio, ahrs, gimbal, phone, or a YAML file that states what is needed"


def use_option(text: str) -> object:
    """Return the annotation of --for; its field is called `use`, since `for` is a word of Python."""
    return Argument(name="for", metavar="USE", help=text)


ForUse = Annotated[str | None, use_option(f"{_USE}; the verdict is then for that use.")]
PlannedUse = Annotated[str | None, use_option(f"{_USE}.")]
CalibrationPath = Annotated[Path, Argument(positional=True, metavar="CALIBRATION")]
FileOption = Argument(metavar="FILE")
ImuFiles = Annotated[tuple[Path, ...], Argument(metavar="FILE", appends=True)]
"""Kalibr's imu.yaml, keyed by the IMUs, or given once for each of them."""
CamFile = Annotated[Path | None, Argument(aliases=("--cams",), metavar="FILE")]
Topics = Annotated[tuple[str, ...], Argument(metavar="NAME=TOPIC")]
"""Options of a bag; `topics_of` reads them."""


def output_option(metavar: str) -> object:
    """Return the annotation of where a command writes."""
    return Argument(aliases=("-o",), metavar=metavar)


@dataclass(frozen=True, kw_only=True)
class Command(ABC):
    """What every command takes.

    A command is a dataclass whose fields are its options, and their help its help.
    """

    json: bool = False
    """Print one JSON document instead of text."""
    quiet: Annotated[bool, Argument(aliases=("-q",))] = False
    """Say nothing of progress."""
    verbose: Annotated[bool, Argument(aliases=("-v",))] = False
    """Say more of progress, such as each iteration."""
    log: Annotated[Path | None, Argument(metavar="FILE")] = None
    """Add everything that is said to this file, with the time."""

    @classmethod
    def base_values(cls, values: Mapping[Place, Any]) -> Mapping[str, Any]:
        """Return values of fields instead of their defaults; they follow from the values that are given."""
        return {}

    def lacking(self) -> list[str]:
        """Return a sentence on each option that this recording needs and that was not given."""
        return []

    @abstractmethod
    def run(self, terminal: "Terminal") -> int:
        """Carry it out, print to the terminal, and return the exit code."""


class FromScenario(Command):
    """A command that simulates what a scenario file states, from which the options on the line differ."""

    scenario_type: ClassVar[type]

    @classmethod
    def base_values(cls, values: Mapping[Place, Any]) -> Mapping[str, Any]:
        """Return the options of the scenario file, where one is given, with a usual lens where its model alone is.

        Raises
        ------
        FormatError
            If the file cannot be read, or states something that is no option.
        """
        from ..formats.own.options_file import read_options  # NumPy is not needed for most lines

        path = values.get(("scenario",))
        base = {"options": read_options(path, cls.scenario_type)} if path else {}
        given = {name: values[place] for name in ("projection", "distortion") if (place := ("options", name)) in values}
        if given and ("options", "distortion_coeffs") not in values:
            start = base.get("options") or cls.scenario_type()
            lens = start.with_usual_lens(**given)
            own = ("options", "intrinsics") in values  # for images as they are
            base["options"] = replace(lens, resolution=start.resolution) if own else lens
        return base


@dataclass(frozen=True, kw_only=True)
class StatedFacts:
    """What a certificate says of the sensor and of who measured; kept with the result."""

    sensor: str | None = None
    """Name of the sensor, for the certificate."""
    serial: str | None = None
    """Its serial number."""
    date: Annotated[str | None, Argument(metavar="YYYY-MM-DD")] = None
    """Date of the measurement; the clock is never asked, so that a second run gives the same bytes."""
    operator: str | None = None
    """Who measured."""
    place: str | None = None
    """Where it was measured."""

    def __post_init__(self) -> None:
        try:
            datetime.date.fromisoformat(self.date or "2000-01-01")
        except ValueError:
            raise OptionError(f"date {self.date!r} is no date. Write it as 2026-03-31.") from None

    @property
    def stated(self) -> dict[str, Any]:
        """The same as a mapping; None for what was not stated."""
        return {field.name: getattr(self, field.name) for field in fields(self)}


@dataclass(frozen=True, kw_only=True)
class CertificateFacts(StatedFacts):
    """The same with the temperature of the measurement."""

    temperature_c: float | None = None
    """Temperature of the measurement in degrees Celsius."""

    def __post_init__(self) -> None:
        if self.temperature_c is not None and not -273.15 <= self.temperature_c < 1e4:
            raise OptionError(f"temperature_c {self.temperature_c} is no temperature in degrees Celsius.")
        super().__post_init__()


@dataclass(frozen=True, kw_only=True)
class TableOptions:
    """What a table does not say about itself."""

    columns: str | None = None
    """What the columns of a table are, such as "t ax ay az gx gy gz"; _ skips one."""

    rate: Annotated[float | None, Argument(aliases=("--rate-hz",))] = None
    """Sample rate in Hz, for a table without time; rate_hz in Python."""

    units: str | None = None
    """Units of the recording: "si", "raw" (counts), or a list such as "g deg/s us"; recognised where not given."""

    def __post_init__(self) -> None:
        if self.units is not None:
            Units.parse(self.units)

    @property
    def table(self) -> dict[str, Any]:
        """The same, as a reader takes it."""
        return {"columns": self.columns, "rate_hz": self.rate, "units": self.units}


@dataclass(frozen=True, kw_only=True)
class Input(TableOptions):
    """A recording, and what it does not say about itself."""

    path: Annotated[Path, Argument(positional=True)]
    """A file or a folder; with two files, that of the accelerometer."""

    gyroscope_path: Annotated[Path | None, Argument(positional=True, metavar="PATH")] = None
    """The file of the gyroscope, where it has its own."""

    @property
    def paths(self) -> tuple[Path, ...]:
        """The one or two paths."""
        return (self.path,) if self.gyroscope_path is None else (self.path, self.gyroscope_path)


@dataclass(frozen=True, kw_only=True)
class PosesInput(TableOptions):
    """A recording, or poses: averaged in a table, or one file each."""

    paths: Annotated[tuple[Path, ...], Argument(positional=True, metavar="PATH")]
    """A file or a folder; several recordings of one sensor, each a file with both triads, or a folder; two files of one
    triad each, accelerometer and gyroscope; three or more of one static pose each, or a folder of them. A short table
    without time holds averaged poses."""

    def __post_init__(self) -> None:
        TableOptions.__post_init__(self)
        if not self.paths:
            raise OptionError("no recording given. Name a file or a folder, such as gnomon imu recording.csv.")


def topics_of(stated: Sequence[str]) -> dict[str, str]:
    """Return the topics of cameras and IMUs by name, from NAME=TOPIC.

    Raises
    ------
    OptionError
        If one is not of this form, or stands twice.

    Examples
    --------
    >>> topics_of(["cam0=/left/image_raw", "imu0=/imu/data"])
    {'cam0': '/left/image_raw', 'imu0': '/imu/data'}
    """
    topics: dict[str, str] = {}
    for text in stated:
        name, equals, topic = text.partition("=")
        if not (equals and topic and re.fullmatch(r"(cam|imu)\d+", name)):
            raise OptionError(f"--topics {text}: expected NAME=TOPIC, such as cam0=/cam0/image_raw or imu0=/imu0.")
        if name in topics:
            raise OptionError(f"--topics {text}: {name} is stated twice.")
        topics[name] = topic
    return topics
