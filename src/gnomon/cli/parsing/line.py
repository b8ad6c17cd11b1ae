"""Words of the command line -> a command, by argparse; the options are the fields of the command."""

import re
import shutil
import sys
from argparse import SUPPRESS, Action, ArgumentParser, Namespace, RawDescriptionHelpFormatter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import MISSING
from difflib import get_close_matches
from functools import partial
from typing import Any, NoReturn, Protocol

from ...errors import OptionError
from ...findings import join_names
from .arguments import Entry, Place, build_command, command_entries, read_value

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
