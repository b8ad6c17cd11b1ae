"""The help of the program, and of a command from its docstring, its fields and the texts below them."""

import ast
import inspect
import textwrap
from collections.abc import Iterable, Sequence
from dataclasses import MISSING, is_dataclass
from itertools import groupby, pairwise
from typing import NamedTuple

from .._version import __version__
from ..findings import join_names
from .arguments import Entry, LineParser, add_entry, command_entries, help_width
from .command import COMMANDS, GROUPS, SIMULATED


class CommandHelp(NamedTuple):
    """What there is to say about a command.

    Attributes
    ----------
    about : what it does, by paragraphs
    examples : lines to type
    rows : what it takes, each with its meaning and its default, which is empty where there is none
    usage : its line
    """

    about: Sequence[str]
    examples: Sequence[str]
    rows: Sequence[tuple[Entry, str, str]]
    usage: str


def describe_command(command: type, prog: str) -> CommandHelp:
    """Return what there is to say about a command, its own options before those of the classes of its fields."""
    entries = sorted(command_entries(command), key=lambda entry: _rank(entry, command))
    about, _, examples = inspect.cleandoc(command.__doc__ or "").partition("\n\nExamples\n--------\n")
    texts = _field_texts(entry.owner for entry in entries)
    rows = [(entry, entry.argument.help or texts[entry.place[-1]], _default(entry)) for entry in entries]
    short = LineParser(prog)
    for entry in entries:
        if entry.argument.positional or entry.default is MISSING:
            add_entry(short, entry, required=entry.default is MISSING)
    usage = short.format_usage().removeprefix("usage: ").removeprefix(prog).split()
    return CommandHelp(
        about=[" ".join(part.split()) for part in about.split("\n\n")],
        examples=[line.removeprefix("$ ") for line in examples.splitlines()],
        rows=rows,
        usage=" ".join([prog, "[OPTIONS]", *usage]),
    )


def format_help(command: type, prog: str) -> str:
    """Return the help: what the command does, examples, operands, and the options of each class of options."""
    described = describe_command(command, prog)
    width = help_width()
    about = "\n\n".join(textwrap.fill(part, width) for part in described.about)
    examples = "\n".join(["examples:", *(f"  {line}" for line in described.examples)])
    parser = LineParser(prog, described.usage, about, examples)
    for title, rows in groupby(described.rows, key=lambda row: _group_title(row[0], command)):
        group = parser.add_argument_group(title)
        for entry, text, default in rows:
            shown = f"{text} (default: {default})" if default and "default" not in text else text
            add_entry(group, entry, shown.replace("%", "%%"))
    return parser.format_help()


def _rank(entry: Entry, command: type) -> int:
    """Return the place of an entry: operands, the command's own options, those of its fields, those of its bases."""
    if entry.argument.positional:
        return 0
    return 1 if entry.owner is command else 3 if issubclass(command, entry.owner) else 2


def _group_title(entry: Entry, command: type) -> str:
    if entry.argument.positional:
        return "operands"
    return (
        "options" if entry.owner is command else inspect.cleandoc(entry.owner.__doc__ or "").split("\n")[0].rstrip(".")
    )


def _default(entry: Entry) -> str:
    """Return the default of a field as it is typed; nothing where that is no value."""
    default = entry.default
    if isinstance(default, bool) or default in (None, (), MISSING):
        return ""
    values = default if isinstance(default, tuple) else (default,)
    return " ".join(f"{value:g}" if isinstance(value, float) else str(value) for value in values)


def _field_texts(classes: Iterable[type]) -> dict[str, str]:
    """Return the text below each field in the source of classes and their bases."""
    texts: dict[str, str] = {}
    for base in {base: None for cls in classes for base in reversed(cls.__mro__) if is_dataclass(base)}:
        (tree,) = ast.parse(textwrap.dedent(inspect.getsource(base))).body
        assert isinstance(tree, ast.ClassDef)
        for field, below in pairwise(tree.body):
            match field, below:
                case ast.AnnAssign(target=ast.Name(name)), ast.Expr(value=ast.Constant(str(text))):
                    texts[name] = " ".join(text.split())
                case _:
                    pass
    return texts


ABOUT = "Calibrate an IMU, alone or with cameras, without mechanical equipment."
_LAST = "gnomon COMMAND --help shows the options of a command, and examples."
_EXIT_CODES = "Exit codes: 0 usable, 2 wrong usage, 3 bad input, 4 the verdict says no."


def simulate_help() -> str:
    """Return what can be simulated, a line for each kind."""
    kinds = [f"  {name.partition(' ')[2]:<15}{about}" for name, (_, about) in GROUPS["try"].items() if " " in name]
    last = ["examples:", "  gnomon simulate imu -o recording.npz", "  gnomon simulate camera-imu -o rig"]
    last += ["", "gnomon simulate KIND --help shows the options of a kind, and more examples."]
    return "\n".join(["usage: gnomon simulate KIND [OPTIONS]", "", "kinds:", *kinds, "", *last]) + "\n"


def program_help() -> str:
    """Return what can be done, a line for each command."""
    width, indent = help_width(), max(len(name) for name in COMMANDS if " " not in name) + 4
    blocks = ["usage: gnomon COMMAND [OPTIONS]", f"{ABOUT} gnomon {__version__}"]
    for title, group in GROUPS.items():
        lines = [(name, about) for name, (_, about) in group.items() if " " not in name]
        if title == "try":
            lines.insert(1, ("simulate KIND", f"a recording: {join_names(SIMULATED, 'or')}"))
        filled = [
            textwrap.fill(f"  {name:<{indent - 2}}{about}", width, subsequent_indent=" " * indent)
            for name, about in lines
        ]
        blocks.append("\n".join([f"{title}:", *filled]))
    return "\n\n".join([*blocks, _LAST + "\n" + textwrap.fill(_EXIT_CODES, width)]) + "\n"
