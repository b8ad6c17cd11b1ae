"""Arguments -> a command; each is made from the fields of a dataclass, in the file that does its work."""

import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import make_dataclass
from importlib import import_module
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, Union, get_args, get_origin

import tyro
from tyro.constructors import ConstructorRegistry, PrimitiveConstructorSpec, PrimitiveTypeInfo

from .._version import __version__
from ..options import check_ranges
from .command import Command, FromScenario

DESCRIPTION = f"""Calibrate an IMU, alone or with cameras, without mechanical equipment. gnomon {__version__}.

Exit codes: 0 usable, 2 wrong usage, 3 bad input, 4 finished but the verdict says do not use."""
_CONFIG = (tyro.conf.FlagCreatePairsOff, tyro.conf.OmitSubcommandPrefixes)
_CLASSES = {
    "imu": (
        "imu.Imu",
        "Calibrate accelerometer and gyroscope from hand-held recordings, or an accelerometer alone from static poses.",
    ),
    "camera": (
        "camera.CameraCommand",
        "Calibrate the lenses of one camera or several, and their relative poses, from views of a board.",
    ),
    "camera-imu": (
        "camera_imu.CameraImu",
        "Calibrate cameras and an IMU that were waved together in front of a board.",
    ),
    "turntable": (
        "turntable.Turntable",
        "Calibrate a gyroscope from recordings on a turntable, such as a record player.",
    ),
    "rate": ("turntable.Rate", "Measure how fast a platter turns, from a video of it."),
    "magnetometer": (
        "magnetometer.Magnetometer",
        "Calibrate hard and soft iron of a magnetometer from one recording in which it was turned by hand.",
    ),
    "noise": (
        "noise.Noise",
        "Identify the noise of an IMU from a long recording at rest: white noise, bias instability, random walk.",
    ),
    "check": ("check.Check", "Say what a recording holds, what is wrong with it, and how to cure that."),
    "plan": (
        "plan.Plan",
        "Predict how well cameras and an IMU would be calibrated by a recording that is still to be made.",
    ),
    "plan-imu": (
        "plan.PlanImu",
        "Predict how well an IMU would be calibrated by a recording with rests that is still to be made.",
    ),
    "target": (
        "target.PrintTarget",
        "Draw a calibration board as PDF and SVG at true scale, with rulers and its target.yaml.",
    ),
    "show": ("show.Show", "Show a calibration as tables with standard deviations; files of other projects without."),
    "apply": (
        "show.Apply",
        "Turn a recording into specific force and angular rate with a calibration; of any length, in little memory.",
    ),
    "convert": (
        "convert.Convert",
        "Write a calibration, gnomon's or another project's, in another format, and say what that format cannot hold.",
    ),
    "compare": (
        "compare.Compare",
        "Compare calibrations of one rig, made by any program: who agrees, who stands out and in what, and "
        "what repeats.",
    ),
    "simulate": (
        "imu.Simulate",
        "Make a recording of a simulated sensor, and its true calibration beside it (truth.yaml).",
    ),
    "simulate-poses": (
        "poses.SimulatePoses",
        "Make an experiment in which a simulated sensor lies still in one attitude after another, and its truth.",
    ),
    "simulate-turntable": (
        "turntable.SimulateTurntable",
        "Make recordings of a simulated sensor on a turntable, and its true calibration beside them (truth.yaml).",
    ),
    "simulate-platter-video": (
        "turntable.SimulatePlatterVideo",
        "Make a video of a simulated platter, as a webcam sees it.",
    ),
    "simulate-magnetometer": (
        "magnetometer.SimulateMagnetometer",
        "Make a recording of a simulated magnetometer turned by hand, and its true calibration beside it (truth.yaml).",
    ),
    "simulate-noise": (
        "noise.SimulateNoise",
        "Make a long recording of a simulated IMU at rest, with noise of known coefficients.",
    ),
    "simulate-cameras": (
        "camera.SimulateCameras",
        "Make a folder with a recording of simulated cameras in front of a board, and its truth (truth.yaml).",
    ),
    "simulate-camera-imu": (
        "camera_imu.SimulateCameraImu",
        "Make a folder with a recording of simulated cameras and an IMU in front of a board, and its truth "
        "(truth.yaml).",
    ),
    "study": (
        "study.Study",
        "Repeat a published experiment many times with simulated sensors, and say whether its claims hold.",
    ),
    "demo": ("imu.Demo", "Calibrate a simulated recording and compare the result with the truth."),
}
"""Name of a command -> where its class is, and the first sentence of its help, which takes no import to show."""


class _Commands(Mapping[str, type[Command]]):
    """The classes of the commands by name; a file is imported when its command is asked for."""

    def __getitem__(self, name: str) -> type[Command]:
        module, _, cls = _CLASSES[name][0].partition(".")
        return getattr(import_module(f".{module}", __package__), cls)

    def __iter__(self) -> Iterator[str]:
        return iter(_CLASSES)

    def __len__(self) -> int:
        return len(_CLASSES)


COMMANDS: Mapping[str, type[Command]] = _Commands()


def parse(arguments: Sequence[str]) -> Command:
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
    name = arguments[0] if arguments else "--help"
    if name == "--version":
        sys.stdout.write(f"gnomon {__version__}\n")
        raise SystemExit(0)
    if name in _CLASSES:  # only this command's options are looked at, and suggested after a typing error
        command, default = COMMANDS[name], _scenario_default(name, arguments[1:])
        how: dict[str, Any] = {"config": _CONFIG, "registry": _registry()}
        parsed = tyro.cli(command, prog=f"gnomon {name}", args=arguments[1:], default=default, **how)
        check_ranges(parsed)
        return parsed
    named = {key: make_dataclass(key, (), namespace={"__doc__": text}) for key, (_, text) in _CLASSES.items()}
    union: Any = Union[tuple(Annotated[cls, tyro.conf.subcommand(key)] for key, cls in named.items())]  # noqa: UP007
    return tyro.cli(
        union,
        prog="gnomon",
        description=DESCRIPTION,
        args=arguments or ["--help"],
        config=_CONFIG,
        registry=_registry(),
    )


def _scenario_default(name: str, arguments: Sequence[str]) -> Any:
    """Return the command that a scenario file describes, whose options are then the defaults; None without one."""
    command = COMMANDS[name]
    if not issubclass(command, FromScenario):
        return None
    for i, word in enumerate(arguments):
        option, equals, path = word.partition("=")
        file = path if equals else next(iter(arguments[i + 1 :]), "")
        if option == "--scenario" and file:
            return command.with_scenario(Path(file))
    return None


def _registry() -> ConstructorRegistry:
    """Show an optional number as FLOAT, not as {None}|FLOAT."""
    registry = ConstructorRegistry()

    @registry.primitive_rule
    def _optional(info: PrimitiveTypeInfo) -> PrimitiveConstructorSpec[Any] | None:
        kinds = get_args(info.type)
        if get_origin(info.type) not in (Union, UnionType) or len(kinds) != 2 or kinds[1] is not NoneType:
            return None
        kind = kinds[0]
        if kind not in (int, float, str):
            return None
        return PrimitiveConstructorSpec(
            nargs=1,
            metavar=kind.__name__.upper(),
            instance_from_str=lambda words: kind(words[0]),
            is_instance=lambda value: value is None or isinstance(value, kind),
            str_from_instance=lambda value: ["none" if value is None else str(value)],
        )

    return registry
