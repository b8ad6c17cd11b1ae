"""Commands as processes that are killed at a step of their writing, or after some time."""

import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

_HOOK = """\
import os, signal, sys

def _watch():
    at, told, number = int(os.environ["KILL_AT"]), os.environ["KILL_LOG"], int(os.environ["KILL_SIGNAL"])
    steps, begun = 0, False
    own = os.getpid()
    making = os.O_WRONLY | os.O_RDWR | os.O_CREAT

    def hook(event, arguments):
        nonlocal steps, begun
        if event == "open":
            if not isinstance(arguments[2], int) or not arguments[2] & making or str(arguments[0]) == told:
                return
        elif event not in {"os.rename", "os.remove", "os.mkdir", "os.rmdir"}:
            return
        if os.getpid() != own:
            return
        steps += 1
        if steps == at:
            os.kill(own, number)
        if at == 0:
            with open(told, "w") as file:
                file.write(str(steps))

    limit = int(os.environ.pop("KILL_LARGEST", "0"))
    if limit:
        import resource

        resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
    if os.environ.pop("KILL_ONE", ""):  # in the command itself, and not in a process that it starts
        sys.addaudithook(hook)

_watch()
"""


class Killer:
    """Runs Python programs, such as `-m gnomon imu ...`, and kills them.

    Parameters
    ----------
    scratch : a folder of its own
    """

    def __init__(self, scratch: Path) -> None:
        self._hooks, self._log = scratch / "hooks", scratch / "steps"
        self._hooks.mkdir(parents=True)
        (self._hooks / "sitecustomize.py").write_text(_HOOK)

    def steps(self, arguments: list[str], cwd: Path) -> int:
        """Run to the end, and return how many files and folders were opened for writing, renamed, made or removed."""
        self._log.unlink(missing_ok=True)
        process = self._started(arguments, cwd, 0, signal.SIGKILL)
        _, err = process.communicate(timeout=600)
        assert process.returncode in {0, 4}, err
        return int(self._log.read_text()) if self._log.exists() else 0

    def killed_at(self, step: int, arguments: list[str], cwd: Path, number: int = signal.SIGKILL) -> tuple[int, str]:
        """Send a signal before a step of the writing; return the exit code, and what was said on standard error."""
        process = self._started(arguments, cwd, step, number)
        _, err = process.communicate(timeout=600)
        return process.returncode, err

    def killed_after(self, seconds: float, arguments: list[str], cwd: Path, number: int = signal.SIGKILL) -> int:
        """Send a signal after some time; return the exit code."""
        process = self._started(arguments, cwd, -1, number)
        try:
            process.communicate(timeout=seconds)
        except subprocess.TimeoutExpired:
            process.send_signal(number)
            process.communicate(timeout=600)
        return process.returncode

    def on_a_full_disk(self, largest: int, arguments: list[str], cwd: Path) -> tuple[int, str]:
        """Run where files cannot grow beyond a size [bytes]; return the exit code, and what standard error was told."""
        process = self._started(arguments, cwd, -1, signal.SIGKILL, KILL_LARGEST=str(largest))
        _, err = process.communicate(timeout=600)
        return process.returncode, err

    def _started(self, arguments: list[str], cwd: Path, step: int, number: int, **more: str) -> "subprocess.Popen[str]":
        environment = {
            **os.environ,
            "PYTHONPATH": os.pathsep.join([str(self._hooks), *filter(None, [os.environ.get("PYTHONPATH", "")])]),
            "PYTHONDONTWRITEBYTECODE": "1",
            "KILL_AT": str(step),
            "KILL_ONE": "yes",
            "KILL_LOG": str(self._log),
            "KILL_SIGNAL": str(int(number)),
            **more,
        }
        return subprocess.Popen(
            [sys.executable, *arguments],
            cwd=cwd,
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
        )


def contents(folder: Path) -> dict[str, bytes]:
    """Return the files in a folder and those below it, by their names there."""
    return {
        path.relative_to(folder).as_posix(): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()
    }


def visible(found: dict[str, bytes]) -> dict[str, bytes]:
    """Return the files without what is being written, whose names begin with a dot."""
    return {name: data for name, data in found.items() if not any(part.startswith(".") for part in name.split("/"))}


def refill(folder: Path, source: Path) -> None:
    """Make a folder a copy of another one."""
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(source, folder)
