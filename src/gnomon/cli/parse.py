"""Arguments -> a command."""

import sys
from collections.abc import Sequence
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, Union, get_args, get_origin

import tyro
from tyro.constructors import ConstructorRegistry, PrimitiveConstructorSpec, PrimitiveTypeInfo

from .._version import __version__
from ..ranges import check_ranges
from .command_parts import FromScenario
from .commands import COMMANDS, Command

DESCRIPTION = f"""Calibrate an IMU, alone or with cameras, without mechanical equipment. gnomon {__version__}.

Exit codes: 0 usable, 2 wrong usage, 3 bad input, 4 finished but the verdict says do not use."""

_CONFIG = (tyro.conf.FlagCreatePairsOff, tyro.conf.OmitSubcommandPrefixes)


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
    if name in COMMANDS:  # only this command's options are looked at, and suggested after a typing error
        command: Any = COMMANDS[name]
        parsed: Command = tyro.cli(
            command,
            prog=f"gnomon {name}",
            args=arguments[1:],
            default=_scenario_default(name, arguments[1:]),
            config=_CONFIG,
            registry=_registry(),
        )
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
