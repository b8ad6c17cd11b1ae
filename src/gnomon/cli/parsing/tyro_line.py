"""The lines that are not ordinary: help, mistakes and what is written unusually, by tyro."""

from collections.abc import Sequence
from dataclasses import fields
from inspect import get_annotations
from types import NoneType, UnionType
from typing import Annotated, Any, Union, get_args, get_origin

import tyro
from tyro.constructors import ConstructorRegistry, PrimitiveConstructorSpec, PrimitiveTypeInfo

from .arguments import Argument, split_annotation

_CONFIG = (tyro.conf.FlagCreatePairsOff, tyro.conf.OmitSubcommandPrefixes)


def parse_line(command: Any, words: Sequence[str], *, prog: str, default: Any = None) -> Any:
    """Return the command that the words ask for.

    Raises
    ------
    SystemExit
        After printing help (0), or what is wrong with the words (2).
    """
    _annotate(command)
    return tyro.cli(command, prog=prog, args=words, default=default, config=_CONFIG, registry=_registry())


def _annotate(cls: type) -> None:
    """Turn the annotations of a command's fields, and of those of its options, into tyro's."""
    for entry in fields(cls):
        kind, argument = split_annotation(entry.type)
        if argument.flat:
            _annotate(kind)
    for base in (one for one in cls.__mro__ if "__dataclass_fields__" in one.__dict__):
        base.__annotations__ = {name: _translated(hint) for name, hint in get_annotations(base).items()}


def _translated(hint: Any) -> Any:
    if get_origin(hint) is not Annotated:
        return hint
    kind, *notes = get_args(hint)
    return Annotated[(kind, *(each for note in notes for each in _notes(note)))]


def _notes(note: Any) -> tuple[Any, ...]:
    """Return tyro's annotations for ours."""
    if not isinstance(note, Argument):
        return (note,)
    stated = tyro.conf.arg(
        name="" if note.flat else note.name,
        metavar=note.metavar,
        help=note.help,
        help_behavior_hint=note.hint,
        aliases=note.aliases or None,
    )
    positional = (get_args(tyro.conf.Positional[int])[1],) if note.positional else ()
    return (*positional, *((get_args(tyro.conf.UseAppendAction[int])[1],) if note.appends else ()), stated)


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
