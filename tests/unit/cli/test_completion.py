"""Shells are told what can stand on the line."""

import json
import os
import shutil
import subprocess

import pytest

from gnomon.cli import main
from gnomon.cli.command import COMMANDS
from gnomon.cli.commands.completion import completion_lines

needs_bash = pytest.mark.skipif(not shutil.which("bash"), reason="there is no bash")


def completed(*words):
    """Return what bash completes the last word to."""
    given = " ".join(f"'{word}'" for word in ("gnomon", *words))
    program = f"COMP_WORDS=({given}); COMP_CWORD={len(words)}; _gnomon; printf '%s\\n' \"${{COMPREPLY[@]}}\""
    script = completion_lines("bash") + "\n" + program
    return subprocess.run(["bash", "-c", script], capture_output=True, text=True, check=True).stdout.split()


@needs_bash
@pytest.mark.parametrize(
    ("words", "found"),
    [
        (("cam",), {"camera", "camera-imu"}),
        (("simulate", "p"), {"poses", "platter-video"}),
        (("imu", "--mod"), {"--model"}),
        (("imu", "a.csv", "--model", ""), {"auto", "basic", "g-sensitivity", "static"}),
        (("simulate", "cameras", "--cam"), {"--cameras"}),
        (("completion", "b"), {"bash"}),
        (("imu", "rec"), set()),
    ],
)
def test_bash_completes(words, found):
    assert set(completed(*words)) == found


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish", "powershell"])
def test_every_shell_knows_every_command(shell, capsys):
    assert main(["completion", shell, "--json"]) == 0
    lines = json.loads(capsys.readouterr().out)["lines"]
    assert {word for name in COMMANDS for word in name.split() if word not in lines} == set()
    for opening, closing in ("()", "{}", "[]"):
        assert shell == "bash" or shell == "zsh" or lines.count(opening) == lines.count(closing)


@pytest.mark.parametrize(("shell", "check"), [("zsh", "-n"), ("fish", "--no-execute")])
def test_the_shell_itself_reads_it(shell, check, tmp_path):
    if not shutil.which(shell):
        pytest.skip(f"there is no {shell}")
    (tmp_path / "lines").write_text(completion_lines(shell))
    subprocess.run([shell, check, str(tmp_path / "lines")], check=True)


@pytest.mark.parametrize("before", ["", "autoload -Uz compinit; compinit -D -u\n"])
def test_zsh_takes_it_whether_completion_was_begun_or_not(before, tmp_path):
    if not shutil.which("zsh"):
        pytest.skip("there is no zsh")
    (tmp_path / ".zshrc").write_text(before + completion_lines("zsh"))
    words = ["zsh", "-i", "-c", "print $_comps[gnomon]"]
    environment = {"ZDOTDIR": str(tmp_path), "HOME": str(tmp_path), "PATH": os.environ["PATH"], "TERM": "dumb"}
    done = subprocess.run(words, env=environment, capture_output=True, text=True, check=True, stdin=subprocess.DEVNULL)
    assert "_gnomon" in done.stdout
    assert "not found" not in done.stderr
