"""Arguments -> a command; each is made from the fields of a dataclass, in the file that does its work."""

import sys
from collections.abc import Iterator, Mapping, Sequence
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
    "imu": "imu.Imu",
    "camera": "camera.CameraCommand",
    "camera-imu": "camera_imu.CameraImu",
    "turntable": "turntable.Turntable",
    "rate": "turntable.Rate",
    "magnetometer": "magnetometer.Magnetometer",
    "noise": "noise.Noise",
    "check": "check.Check",
    "plan": "plan.Plan",
    "plan-imu": "plan.PlanImu",
    "target": "target.PrintTarget",
    "show": "show.Show",
    "apply": "show.Apply",
    "convert": "convert.Convert",
    "compare": "compare.Compare",
    "simulate": "imu.Simulate",
    "simulate-poses": "poses.SimulatePoses",
    "simulate-turntable": "turntable.SimulateTurntable",
    "simulate-platter-video": "turntable.SimulatePlatterVideo",
    "simulate-magnetometer": "magnetometer.SimulateMagnetometer",
    "simulate-noise": "noise.SimulateNoise",
    "simulate-cameras": "camera.SimulateCameras",
    "simulate-camera-imu": "camera_imu.SimulateCameraImu",
    "study": "study.Study",
    "demo": "imu.Demo",
}
"""Name of a command -> where its class is."""


class _Commands(Mapping[str, type[Command]]):
    """The classes of the commands by name; a file is imported when its command is asked for."""

    def __getitem__(self, name: str) -> type[Command]:
        module, _, cls = _CLASSES[name].partition(".")
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
    union: Any = Union[tuple(Annotated[COMMANDS[key], tyro.conf.subcommand(key)] for key in COMMANDS)]  # noqa: UP007
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
