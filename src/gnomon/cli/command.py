"""Which commands there are, and what they share: options, and what a recording does not say about itself."""

import datetime
import re
import sys
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from difflib import get_close_matches
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

from .._version import __version__
from ..errors import OptionError
from ..findings import join_names
from ..options import check_ranges
from ..units import Units
from .arguments import Argument, Place, parse_line

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
        from ..formats.own.dataclass_file import read_options

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


GROUPS: Mapping[str, Mapping[str, tuple[str, str]]] = {
    "calibrate": {
        "imu": ("imu.Imu", "an IMU that was turned by hand and held still; or static poses"),
        "camera-imu": ("camera_imu.CameraImu", "cameras and an IMU, waved in front of a board"),
        "camera": ("camera.CameraCommand", "lenses and relative poses of cameras, from views of a board"),
        "turntable": ("turntable.Turntable", "a gyroscope on a turntable, such as a record player"),
        "magnetometer": ("magnetometer.Magnetometer", "a magnetometer that was turned by hand"),
        "noise": ("noise.Noise", "the noise of an IMU, from a long recording at rest"),
        "temperature": ("temperature.Temperature", "how an IMU changes with its temperature"),
    },
    "prepare": {
        "live": ("live.Live", "record a sensor with guidance on what to do next"),
        "check": ("check.Check", "what a recording holds, and what is wrong with it"),
        "plan": ("plan.Plan", "how well a recording of cameras and an IMU would calibrate them"),
        "plan-imu": ("plan.PlanImu", "how well a recording with rests would calibrate an IMU"),
        "target": ("target.PrintTarget", "draw a calibration board at true scale, to print"),
        "rate": ("turntable.Rate", "how fast a platter turns, from a video"),
    },
    "use": {
        "show": ("show.Show", "a calibration as tables with standard deviations"),
        "certificate": ("show.Certificate", "page one of a result's report as a PDF"),
        "apply": ("show.Apply", "correct a recording with a calibration"),
        "convert": ("convert.Convert", "write a calibration or recording in another format"),
        "compare": ("compare.Compare", "calibrations of one rig, made by any program"),
        "verify": ("verify.Verify", "whether a calibration still holds, by a fresh recording"),
        "batch": ("batch.Batch", "calibrate many devices, a recording each, into a library"),
        "library": ("library.LibraryCommand", "a library of many devices: list, history, chart, report, export"),
    },
    "try": {
        "demo": ("simulated_imu.Demo", "calibrate a simulated recording, and compare it with the truth"),
        "simulate imu": ("simulated_imu.Simulate", "a recording by hand, and its truth"),
        "simulate poses": ("simulated_imu.SimulatePoses", "one static attitude after another"),
        "simulate turntable": ("turntable.SimulateTurntable", "recordings on a turntable"),
        "simulate platter-video": ("turntable.SimulatePlatterVideo", "a video of a turntable"),
        "simulate magnetometer": ("magnetometer.SimulateMagnetometer", "a magnetometer turned by hand"),
        "simulate noise": ("noise.SimulateNoise", "a long recording at rest"),
        "simulate temperature": (
            "temperature.SimulateTemperature",
            "an IMU over its temperature, with its thermometer",
        ),
        "simulate cameras": ("camera.SimulateCameras", "cameras in front of a board"),
        "simulate camera-imu": ("camera_imu.SimulateCameraImu", "cameras and an IMU in front of a board"),
        "simulate room": ("camera_imu.SimulateRoom", "a camera and an IMU in a room, without a board"),
        "study": ("study.Study", "repeat a published experiment many times"),
        "completion": ("completion.Completion", "complete commands and options with the tab key"),
    },
}
"""Name of a command -> where its class is, and what it is about, which takes no import to show."""
_CLASSES = {name: place for group in GROUPS.values() for name, (place, _) in group.items()}
SIMULATED = [name.partition(" ")[2] for name in _CLASSES if " " in name]
"""What can be simulated."""


_MEANT = {
    **dict.fromkeys(("calibrate", "calib", "cal"), "imu, camera-imu, camera, turntable, magnetometer or noise"),
    "accel": "imu", "accelerometer": "imu", "gyro": "imu or turntable", "gyroscope": "imu or turntable",
    "mag": "magnetometer", "compass": "magnetometer", "allan": "noise", "lens": "camera", "intrinsics": "camera",
    "extrinsics": "camera-imu", "stereo": "camera", "board": "target", "record": "live", "read": "check",
    "info": "check", "validate": "verify or check", "export": "convert", "correct": "apply", "diff": "compare",
    "report": "show or certificate", "print": "show", "generate": "simulate",
}  # fmt: skip
"""What other programs and people call it -> the command."""


class _Commands(Mapping[str, type[Command]]):
    """The classes of the commands by name; a file is imported when its command is asked for."""

    def __getitem__(self, name: str) -> type[Command]:
        module, _, cls = _CLASSES[name].partition(".")
        return getattr(import_module(f".commands.{module}", __package__), cls)

    def __iter__(self) -> Iterator[str]:
        return iter(_CLASSES)

    def __len__(self) -> int:
        return len(_CLASSES)


COMMANDS: Mapping[str, type[Command]] = _Commands()


def parse_command(arguments: Sequence[str]) -> Command:
    """Return the command that the arguments ask for.

    Raises
    ------
    SystemExit
        After printing help (0), or what is wrong with the arguments (2).
    OptionError
        If the value of an option makes no sense.
    FormatError
        If a file of options cannot be read.
    """
    words = list(arguments) or ["--help"]
    if words[0] == "help":  # gnomon help imu, as of git
        words = [*words[1:], "--help"]
    if words[0] in ("-V", "--version", "version"):
        from ..kernel import describe_kernel

        sys.stdout.write(f"gnomon {__version__} ({describe_kernel()})\n")
        raise SystemExit(0)
    if words[0] in ("-h", "--help"):
        from .help import program_help

        sys.stdout.write(program_help())
        raise SystemExit(0)
    if words in (["simulate", "--help"], ["simulate", "-h"]):
        from .help import simulate_help

        sys.stdout.write(simulate_help())
        raise SystemExit(0)
    name, words = _split_name(words)
    parsed = parse_line(COMMANDS[name], words, f"gnomon {name}")
    check_ranges(parsed)
    return parsed


def _split_name(words: Sequence[str]) -> tuple[str, Sequence[str]]:
    """Return the name of the command, of one word or two, and the words after it."""
    first, *others = words
    kind = first.removeprefix("simulate-") if first.startswith("simulate-") else ""
    if first == "simulate":
        is_kind = bool(others) and not others[0].startswith("-")
        kind, others = (others[0], others[1:]) if is_kind else ("imu", others)
    if kind in SIMULATED and [*words] != ["simulate"]:
        return f"simulate {kind}", others
    if kind:
        near = [] if kind in SIMULATED else get_close_matches(kind, SIMULATED, 1)
        meant = f" Did you mean {near[0]}?" if near else ""
        raise OptionError(f"gnomon simulate KIND: KIND is one of {join_names(SIMULATED, 'or')}.{meant}")
    if first in _CLASSES:
        return first, others
    if first.startswith("-"):
        near = get_close_matches(first, ["--version", "--help"], 1)
        meant = f"Did you mean {near[0]}?" if near else "Options stand behind it; gnomon COMMAND --help lists them."
        raise OptionError(f"there is no option {first} before the command. {meant}")
    near = get_close_matches(first, _CLASSES, 1, cutoff=0.65)
    meant = _MEANT.get(first.lower()) or next(iter(near), None)
    raise OptionError(
        f"there is no command {first}. {f'Did you mean {meant}?' if meant else 'gnomon --help lists them.'}"
    )
