"""How a field of a command stands on the command line, and lines that are read without a parser's help.

An ordinary line (known options in full, values that fit) is read here in a millisecond. All others, help and mistakes
first of all, are left to tyro, whose import takes longer than many a command.
"""

import sys
from collections.abc import Iterator, Sequence
from dataclasses import MISSING, fields
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, NamedTuple, Union, get_args, get_origin


class Argument(NamedTuple):
    """Annotation of a field that is an option or an operand.

    Attributes
    ----------
    name : instead of the field's
    metavar : what stands for its value in the help
    help : its help, where that is not the text below the field
    hint : what the help says of the default; what it is where None
    aliases : other names, with their dashes
    positional : an operand
    appends : may be given several times, with one value each
    flat : the fields of a class, without a prefix
    """

    name: str | None = None
    metavar: str | None = None
    help: str | None = None
    hint: str | None = None
    aliases: tuple[str, ...] = ()
    positional: bool = False
    appends: bool = False
    flat: bool = False


class _UnusualError(Exception):
    """Not an ordinary line."""


Place = tuple[str, ...]
"""Names of the fields that lead to one."""


class _Entry(NamedTuple):
    """A field that takes words."""

    place: Place
    kind: Any
    argument: Argument
    default: Any


def split_annotation(hint: Any) -> tuple[Any, Argument]:
    """Return the type of a field, and how it stands on the line.

    Examples
    --------
    >>> split_annotation(Annotated[int, Argument(metavar="COUNT")])[0]
    <class 'int'>
    """
    if get_origin(hint) is Annotated:
        kind, *notes = get_args(hint)
        return kind, next((note for note in notes if isinstance(note, Argument)), Argument())
    return hint, Argument()


def read_line(command: type, words: Sequence[str]) -> Any:
    """Return the command that an ordinary line asks for; None where the line is not ordinary.

    Examples
    --------
    >>> from .show import Show
    >>> read_line(Show, ["calibration.yaml", "--form", "kalibr"]).form
    'kalibr'
    >>> read_line(Show, ["calibration.yaml", "--from", "kalibr"]) is None
    True
    """
    entries = list(_entries(command, ()))
    try:
        values = _values(entries, words)
        if any(entry.default is MISSING and entry.place not in values for entry in entries):
            return None
        return _built(command, values, ())
    except Exception:
        return None


def _entries(cls: type, place: Place) -> Iterator[_Entry]:
    for entry in fields(cls):
        kind, argument = split_annotation(entry.type)
        if argument.flat:
            yield from _entries(kind, (*place, entry.name))
        else:
            named = argument._replace(name=argument.name or entry.name.replace("_", "-"))
            yield _Entry((*place, entry.name), kind, named, entry.default)


def _values(entries: Sequence[_Entry], words: Sequence[str]) -> dict[Place, Any]:
    """Return the values that are given, by the place of their field."""
    options = {name: entry for entry in entries if not entry.argument.positional for name in _names(entry)}
    values: dict[Place, Any] = {}
    operands: list[str] = []
    rest = list(words)
    while rest:
        if not _is_option(rest[0]):
            if operands:  # to what those on both sides of an option belong depends on the parser
                raise _UnusualError
            operands, rest = _leading(rest, len(rest))
            continue
        name, equals, first = rest.pop(0).partition("=")
        entry = options[name]
        before = values.get(entry.place, ())
        if before and not entry.argument.appends:
            raise _UnusualError
        if entry.kind is bool:
            value: Any = not entry.default if not equals else _value(bool, [first])
        else:
            given, rest = ([first], rest) if equals else _leading(rest, _most(entry))
            value = _value(entry.kind, given)
        values[entry.place] = (*before, *value) if entry.argument.appends else value
    return values | _operands([entry for entry in entries if entry.argument.positional], operands)


def _is_option(word: str) -> bool:
    return word[:1] == "-" and not (word[1:2].isdigit() or word[1:2] == ".")  # else a negative number


def _leading(words: list[str], most: int) -> tuple[list[str], list[str]]:
    """Split off the words before the next option, so many at most."""
    count = next((i for i, word in enumerate(words) if _is_option(word)), len(words))
    return words[: min(count, most)], words[min(count, most) :]


def _names(entry: _Entry) -> tuple[str, ...]:
    """Return the names of an option; a switch has the one that changes it."""
    no = "no-" if entry.default is True else ""
    return (f"--{no}{entry.argument.name}", *entry.argument.aliases)


def _most(entry: _Entry) -> int:
    """Return how many values an option takes at most."""
    inner = _tuple_of(entry.kind)
    if not inner or entry.argument.appends:
        return 1
    return sys.maxsize if inner[1:] == (...,) else len(inner)


def _tuple_of(kind: Any) -> tuple[Any, ...]:
    """Return the types in that of a tuple, none for other types."""
    (kind, *others) = _without_none(kind)
    return get_args(kind) if not others and get_origin(kind) is tuple else ()


def _without_none(kind: Any) -> list[Any]:
    """Return the types of a union but None's, or the type."""
    return [one for one in get_args(kind) if one is not NoneType] if get_origin(kind) in (Union, UnionType) else [kind]


def _value(kind: Any, words: Sequence[str]) -> Any:
    """Return the value of words, as the type has it."""
    inner = _tuple_of(kind)
    if not inner:
        (word,) = words
        return _one(kind, word)
    if inner[1:] == (...,) and words:
        inner = (inner[0],) * len(words)
    return tuple(_one(each, word) for each, word in zip(inner, words, strict=True))


def _one(kind: Any, word: str) -> Any:
    kinds = _without_none(kind)
    if all(get_origin(one) is Literal for one in kinds):
        return {str(choice): choice for one in kinds for choice in get_args(one)}[word]
    (plain,) = kinds
    if plain not in (str, Path, int, float) or word.lower() == "none":
        raise _UnusualError
    return plain(word)


def _operands(entries: Sequence[_Entry], words: Sequence[str]) -> dict[Place, Any]:
    values: dict[Place, Any] = {}
    for entry in entries:
        count = len(words) if _tuple_of(entry.kind) else 1
        if words:
            values[entry.place] = _value(entry.kind, words[:count])
        words = words[count:]
    if words:
        raise _UnusualError
    return values


def _built(cls: type, values: dict[Place, Any], place: Place) -> Any:
    """Return the command, or an inner class of its options, with the values that are given."""
    given: dict[str, Any] = {}
    for entry in fields(cls):
        here = (*place, entry.name)
        kind, argument = split_annotation(entry.type)
        if argument.flat:
            given[entry.name] = _built(kind, values, here)
        elif here in values:
            given[entry.name] = values[here]
    return cls(**given)
