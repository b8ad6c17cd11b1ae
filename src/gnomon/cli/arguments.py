"""Words of the command line -> a command, by argparse: how the fields of a command stand on the line."""

import re
import shutil
import sys
from argparse import SUPPRESS, Action, ArgumentParser, Namespace, RawDescriptionHelpFormatter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import MISSING, fields, replace
from difflib import get_close_matches
from functools import partial
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, NamedTuple, NoReturn, Protocol, Union, get_args, get_origin

from ..errors import OptionError
from ..findings import join_names

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


_WIDEST = 100
_NUMBER = r"^-[.\d]"


def help_width() -> int:
    """Return the columns of a help."""
    return min(shutil.get_terminal_size().columns, _WIDEST)


def parse_line(command: Any, words: Sequence[str], prog: str) -> Any:
    """Return the command that the words ask for.

    Raises
    ------
    SystemExit
        After printing the help (0).
    OptionError
        If an option is not known, or a value makes no sense.
    """
    entries = list(command_entries(command))
    if {"-h", "--help"} & {*words}:
        from .help import format_help

        sys.stdout.write(format_help(command, prog))
        raise SystemExit(0)
    values = dict(_values(LineParser(prog=prog), entries, words))
    absent = [
        f"{entry.called} {' | '.join(entry.choices)}" if entry.choices else entry.called
        for entry in entries
        if entry.default is MISSING and entry.place not in values
    ]
    if absent:
        are = "is" if len(absent) == 1 else "are"
        raise OptionError(f"{join_names(absent)} {are} missing. {prog} --help shows the options, and examples.")
    return build_command(command, values, command.base_values(values))


class _TakesArguments(Protocol):
    @property
    def add_argument(self) -> Callable[..., Any]: ...


class LineParser(ArgumentParser):
    """argparse's, whose mistakes are ours, and to which -1e-3 is a number."""

    def __init__(self, prog: str, usage: str | None = None, description: str = "", epilog: str = "") -> None:
        layout = partial(RawDescriptionHelpFormatter, width=help_width(), max_help_position=24)
        super().__init__(prog, usage, description, epilog, formatter_class=layout, add_help=False, allow_abbrev=False)
        self._negative_number_matcher = re.compile(_NUMBER)

    def _get_nargs_pattern(self, action: Action) -> str:
        """Return what may follow an option; from Python 3.13 on another option would be taken for its value."""
        return super()._get_nargs_pattern(action).replace("O", "")

    def error(self, message: str) -> NoReturn:
        """Raise what is wrong with the line."""
        message = re.sub("^the following arguments are required: (.*)", r"\1 is missing", message)
        raise OptionError(f"{message.removeprefix('argument ')}. {self.prog} --help shows the options, and examples.")


def _values(parser: LineParser, entries: Sequence[Entry], words: Sequence[str]) -> Iterator[tuple[Place, Any]]:
    """Yield the values that are given, with the places of their fields."""
    for entry in entries:
        add_entry(parser, entry)
    error = None
    try:
        found, others = parser.parse_known_intermixed_args(words)
    except OptionError as why:
        found, others, error = Namespace(), list[str](), why
    if error or _lacks_operands(found, entries):
        behind = _with_operands_behind(parser.prog, entries, words)
        if behind is not None and not _lacks_operands(behind, entries):
            found, others = behind, []
        elif error:
            raise error
    if others:
        names = [name for entry in entries if not entry.argument.positional for name in entry.names]
        bare = {name.lstrip("-"): name for name in names}
        near = get_close_matches(others[0].partition("=")[0].lstrip("-"), bare, 1)
        option = others[0].startswith("-")
        meant = f"Did you mean {bare[near[0]]}?" if near and option else f"{parser.prog} --help shows the options."
        what = "there is no option" if option else "this is one too many:"
        raise OptionError(f"{what} {others[0]}. {meant}")
    for entry in entries:
        given = getattr(found, _dest(entry), None)
        if given is None:
            continue
        if entry.argument.positional:
            yield entry.place, read_value(entry, given if isinstance(given, list) else [given])
        elif entry.argument.appends:
            yield entry.place, read_value(entry, [word for words in given for word in words])
        else:  # the last counts, as is usual: so a script's options can be overruled
            yield entry.place, not entry.default if entry.kind is bool else read_value(entry, given[-1])


def _lacks_operands(found: Namespace, entries: Sequence[Entry]) -> bool:
    needed = (entry for entry in entries if entry.argument.positional and entry.default is MISSING)
    return not all(hasattr(found, _dest(entry)) for entry in needed)


def _with_operands_behind(prog: str, entries: Sequence[Entry], words: Sequence[str]) -> Namespace | None:
    """Return the values where an option of several values took the operands behind it; None where that is not so."""
    parser = LineParser(prog=prog)
    for entry in entries:
        add_entry(parser, entry, several=False)
    try:
        found, others = parser.parse_known_intermixed_args(words)
    except OptionError:
        return None
    return None if others else found


def _dest(entry: Entry) -> str:
    return ".".join(entry.place)


def add_entry(
    parser: _TakesArguments,
    entry: Entry,
    text: str | None = None,
    *,
    required: bool = False,
    several: bool = True,
) -> None:
    """Add an option or operand to a parser, or to a group of one; an option takes one value, or several at once."""
    keywords: dict[str, Any] = {"default": SUPPRESS, "help": text}
    metavar = tuple(entry.metavar.split()) if " " in entry.metavar else entry.metavar
    count = entry.values_each or "+"
    if entry.argument.positional:
        count = count if required else "?" if count == 1 else "*"
        parser.add_argument(_dest(entry), nargs=count, metavar=metavar, **keywords)
        return
    count = count if several or entry.values_each else 1
    keywords |= {"dest": _dest(entry), "required": required}
    if entry.kind is bool:
        parser.add_argument(*entry.names, action="append_const", const=True, **keywords)
    else:
        parser.add_argument(*entry.names, action="append", nargs=count, metavar=metavar, **keywords)
