"""How the fields of a command stand on the command line."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields, replace
from difflib import get_close_matches
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, NamedTuple, Union, get_args, get_origin

from ...errors import OptionError
from ...findings import join_names

Place = tuple[str, ...]
"""Names of the fields that lead to one."""


class Argument(NamedTuple):
    """Annotation of a field that is an option or an operand.

    Attributes
    ----------
    name : instead of the field's
    metavar : what stands for its value in the help
    help : its help, where that is not the text below the field
    aliases : other names, with their dashes
    positional : an operand
    appends : may be given several times, with one value each
    flat : the fields of a class, without a prefix
    none : whether the word none stands for no value, where there may be none
    """

    name: str | None = None
    metavar: str | None = None
    help: str | None = None
    aliases: tuple[str, ...] = ()
    positional: bool = False
    appends: bool = False
    flat: bool = False
    none: bool = True


class Entry(NamedTuple):
    """A field that takes words.

    Attributes
    ----------
    place : where its value goes
    owner : the class that has the field
    kind : its type
    argument : how it stands on the line
    default : its value where it is not given; MISSING where it must be
    """

    place: Place
    owner: type
    kind: Any
    argument: Argument
    default: Any

    @property
    def names(self) -> tuple[str, ...]:
        """The names of an option, with their dashes; a switch has the one that changes it."""
        no = "no-" if self.default is True else ""
        return (*self.argument.aliases, f"--{no}{self.argument.name}")

    @property
    def values_each(self) -> int | None:
        """How many values it takes each time; None where any number of them."""
        inner = _tuple_of(self.kind)
        if not inner or self.argument.appends:
            return 1
        return None if inner[1:] == (...,) else len(inner)

    @property
    def called(self) -> str:
        """What it is called on the line."""
        if not self.argument.positional:
            return self.names[-1]
        return self.place[-1].upper() if self.choices and not self.argument.metavar else self.metavar

    @property
    def choices(self) -> tuple[str, ...]:
        """The words that it can have; none where they are not numbered."""
        named = (str(one) for kind in self._kinds if get_origin(kind) is Literal for one in get_args(kind))
        return tuple(dict.fromkeys(named))

    @property
    def metavar(self) -> str:
        """What stands for a value in the help."""
        if self.argument.metavar or self.kind is bool:
            return self.argument.metavar or ""
        words = {float: "NUMBER", int: "INTEGER", str: "TEXT", Path: "PATH"}
        return f"{{{','.join(self.choices)}}}" if self.choices else words[self._kinds[0]]

    @property
    def _kinds(self) -> list[Any]:
        """The types of one value."""
        kind = self.kind
        while inner := _tuple_of(kind):
            kind = inner[0]
        return _without_none(kind)


def command_entries(cls: type, place: Place = ()) -> Iterator[Entry]:
    """Yield what a command takes, in the order of its fields."""
    for entry in fields(cls):
        kind, argument = _split_annotation(entry.type)
        if argument.flat:
            yield from command_entries(kind, (*place, entry.name))
        else:
            named = argument._replace(name=argument.name or entry.name.replace("_", "-"))
            yield Entry((*place, entry.name), _owner(cls, entry.name), kind, named, entry.default)


def _owner(cls: type, name: str) -> type:
    """Return the class that states a field."""
    return next(base for base in reversed(cls.__mro__) if name in getattr(base, "__dataclass_fields__", ()))


def _split_annotation(hint: Any) -> tuple[Any, Argument]:
    """Return the type of a field, and how it stands on the line."""
    if get_origin(hint) is Annotated:
        kind, *notes = get_args(hint)
        return kind, next((note for note in notes if isinstance(note, Argument)), Argument())
    return hint, Argument()


def read_value(entry: Entry, words: Sequence[str]) -> Any:
    """Return the value of words, as the type of a field has it.

    Raises
    ------
    OptionError
        If a word is not of the kind.
    """
    inner = _tuple_of(entry.kind)
    if not inner:
        return _word_value(entry, entry.kind, words[0])
    rows = _tuple_of(inner[0])
    if rows:
        if len(words) % len(rows):
            raise OptionError(f"{entry.called}: found {len(words)} values, expected {len(rows)} for each.")
        return tuple(
            tuple(_word_value(entry, kind, word) for kind, word in zip(rows, row, strict=True))
            for row in zip(*[iter(words)] * len(rows), strict=True)
        )
    kinds = (inner[0],) * len(words) if inner[1:] == (...,) else inner
    return tuple(_word_value(entry, kind, word) for kind, word in zip(kinds, words, strict=True))


def _word_value(entry: Entry, kind: Any, word: str) -> Any:
    (plain, *others) = _without_none(kind)
    if entry.argument.none and NoneType in get_args(kind) and word.lower() == "none":
        return None
    if get_origin(plain) is Literal:
        choices = {str(choice): choice for one in (plain, *others) for choice in get_args(one)}
        if word in choices:
            return choices[word]
        near = get_close_matches(word, [*choices], 1)
        expected = join_names([*choices], "or") + (f" (did you mean {near[0]}?)" if near else "")
    else:
        try:
            return plain(word)
        except ValueError:
            expected = {float: "a number", int: "a whole number"}[plain]
    raise OptionError(f"{entry.called} {word}: expected {expected}.")


def _tuple_of(kind: Any) -> tuple[Any, ...]:
    """Return the types in that of a tuple, none for other types."""
    (kind, *others) = _without_none(kind)
    return get_args(kind) if not others and get_origin(kind) is tuple else ()


def _without_none(kind: Any) -> list[Any]:
    """Return the types of a union but None's, or the type."""
    return [one for one in get_args(kind) if one is not NoneType] if get_origin(kind) in (Union, UnionType) else [kind]


def build_command(cls: type, values: Mapping[Place, Any], base: Mapping[str, Any], place: Place = ()) -> Any:
    """Return a command, or an inner class of its options.

    Parameters
    ----------
    cls : of the command
    values : what is given, by the place of its field
    base : values of fields instead of their defaults
    place : of the inner class
    """
    given = dict(base)
    for entry in fields(cls):
        here = (*place, entry.name)
        kind, argument = _split_annotation(entry.type)
        if argument.flat:
            inner = {path[len(here)]: value for path, value in values.items() if path[: len(here)] == here}
            given[entry.name] = (
                replace(base[entry.name], **inner) if entry.name in base else build_command(kind, values, {}, here)
            )
        elif here in values:
            given[entry.name] = values[here]
    return cls(**given)
