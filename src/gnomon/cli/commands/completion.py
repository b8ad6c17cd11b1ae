"""The command that tells a shell what can stand on the line."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Annotated, Literal

from ..arguments import Argument, command_entries
from ..command import Command
from ..terminal import Terminal

Shell = Literal["bash", "zsh", "fish", "powershell"]

# compinit comes first, and only where the user's own file has not called it.
_ZSH = """\
autoload -Uz compinit bashcompinit
(( $+functions[compdef] )) || compinit
bashcompinit
"""
_BASH = """\
_gnomon() {
    local words command="${COMP_WORDS[1]}" before="${COMP_WORDS[COMP_CWORD-1]}"
    if [ "$command" = simulate ] && [ "$COMP_CWORD" -gt 2 ]; then command="simulate ${COMP_WORDS[2]}"; fi
    if [ "$COMP_CWORD" = 1 ]; then command=""; fi
    case "$command $before" in
LINES
    esac
    COMPREPLY=($(compgen -W "$words" -- "${COMP_WORDS[COMP_CWORD]}"))
}
complete -o default -F _gnomon gnomon
"""
_POWERSHELL = """\
Register-ArgumentCompleter -Native -CommandName gnomon -ScriptBlock {
    param($word, $line, $cursor)
    $known = @{
LINES
    }
    $given = @($line.CommandElements | Select-Object -Skip 1 | ForEach-Object { "$_" })
    if ($word) { $given = @($given | Select-Object -SkipLast 1) }
    $command = if ($given.Count -gt 1 -and $given[0] -eq 'simulate') { "simulate $($given[1])" } else { "$($given[0])" }
    $found = $known["$command $($given[-1])"]
    if (-not $found) { $found = $known[$command] }
    $found -split ' ' | Where-Object { $_ -like "$word*" } |
        ForEach-Object { [System.Management.Automation.CompletionResult]::new($_) }
}
"""


@dataclass(frozen=True, kw_only=True)
class Completion(Command):
    """Print what a shell needs to complete commands, options and choices with the tab key.

    Add it to what the shell reads when it starts.

    Examples
    --------
    $ gnomon completion bash >> ~/.bashrc
    $ gnomon completion zsh >> ~/.zshrc
    $ gnomon completion fish > ~/.config/fish/completions/gnomon.fish
    $ gnomon completion powershell >> $PROFILE
    """

    shell: Annotated[Shell, Argument(positional=True)]
    """The shell."""

    def run(self, terminal: Terminal) -> int:
        """Print the lines, and return the exit code."""
        lines = completion_lines(self.shell)
        terminal.print(lines)
        terminal.document({"shell": self.shell, "lines": lines})
        return 0


def completion_lines(shell: Shell) -> str:
    """Return what a shell reads."""
    known = dict(_known_words())
    if shell == "fish":
        return "\n".join(_fish_lines(known))
    if shell == "powershell":
        rows = [f"        '{place}' = '{words}'" for place, words in known.items()]
        return _POWERSHELL.replace("LINES", "\n".join(rows))
    # What stands after an option is looked at before the options of the command, which come last.
    rows = [f'        {_bash_pattern(place)}) words="{words}" ;;' for place, words in reversed(known.items())]
    script = _BASH.replace("LINES", "\n".join(rows))
    return script if shell == "bash" else f"{_ZSH}{script}"


def _known_words() -> Iterator[tuple[str, str]]:
    """Yield what stands before a word, and the words that can stand there."""
    from ..command import COMMANDS

    kinds = [name.partition(" ")[2] for name in COMMANDS if " " in name]
    yield "", " ".join(dict.fromkeys(name.partition(" ")[0] for name in COMMANDS))
    yield "simulate", " ".join(kinds)
    for name, command in COMMANDS.items():
        entries = list(command_entries(command))
        operands = [choice for entry in entries if entry.argument.positional for choice in entry.choices]
        yield name, " ".join([*operands, *(word for e in entries if not e.argument.positional for word in e.names)])
        for entry in entries:
            if entry.choices and not entry.argument.positional:
                yield f"{name} {entry.called}", " ".join(entry.choices)


def _bash_pattern(place: str) -> str:
    """Return the pattern of a place before the word; what stands between is not looked at."""
    return f'"{place}"' if " --" in place else f'"{place} "*'


def _fish_lines(known: Mapping[str, str]) -> Iterator[str]:
    yield f"complete -c gnomon -n __fish_use_subcommand -f -a '{known['']}'"
    for place, words in known.items():
        command, dashes, option = place.partition(" --")
        seen = "; and ".join(f"__fish_seen_subcommand_from {word}" for word in command.split())
        if dashes:
            yield f"complete -c gnomon -n '{seen}' -l {option} -x -a '{words}'"
        elif place == "simulate":
            yield f"complete -c gnomon -n '{seen}; and not __fish_seen_subcommand_from {words}' -f -a '{words}'"
        elif place:
            yield f"complete -c gnomon -n '{seen}' -a '{words}'"
