"""How far a study is: runs done and time left, as a bar on a terminal, else in some lines."""

import sys
import time
from typing import TYPE_CHECKING

from .terminal import Terminal

if TYPE_CHECKING:
    from rich.progress import Progress, TaskID

_TOLD = 20  # lines at most, where there is no terminal


class StudyCount:
    """Shows how many runs are done; what `progress` says between takes the place of the bar.

    Parameters
    ----------
    terminal : where it is shown
    stages : names of the runs that a study does one after the other
    """

    def __init__(self, terminal: Terminal, stages: tuple[str, ...] = ()) -> None:
        self._terminal, self._stages = terminal, stages
        self._name, self._began, self._first = "", 0.0, 0
        self._bar: Progress | None = None
        self._task: TaskID | None = None

    def progress(self, step: str) -> None:
        """Say which step the work is at."""
        self.close()
        self._terminal.progress(step)

    def __call__(self, name: str, done: int, total: int) -> None:
        """Show that so many runs of that name are done."""
        if name != self._name or done <= self._first:
            self.close()
            self._name, self._began, self._first = name, time.monotonic(), done
            self._begin(self._titled(name), done, total)
        if self._bar is not None and self._task is not None:
            self._bar.update(self._task, completed=done)
            if done == total:
                self.close()
        elif done * _TOLD // total > (done - 1) * _TOLD // total:
            sys.stderr.write(f"{self._titled(name)} {done} of {total}{self._left(done, total)}\n")

    def close(self) -> None:
        """Take the bar away."""
        self._name = ""
        if self._bar is not None:
            self._bar.stop()
            self._bar = self._task = None

    def _titled(self, name: str) -> str:
        if name not in self._stages or len(self._stages) == 1:
            return name
        return f"stage {self._stages.index(name) + 1} of {len(self._stages)}: {name}"

    def _begin(self, title: str, done: int, total: int) -> None:
        if not sys.stderr.isatty():
            return
        from rich.console import Console
        from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

        self._terminal.close()
        columns = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn()
        self._bar = Progress(*columns, console=Console(stderr=True), transient=True)
        self._task = self._bar.add_task(title, total=total, completed=done)
        self._bar.start()

    def _left(self, done: int, total: int) -> str:
        seconds = (time.monotonic() - self._began) * (total - done) / max(done - self._first, 1)
        if done == total or seconds < 1:
            return ""
        of_what = " of this stage" if self._name in self._stages[:-1] else ""
        return f", {seconds:.0f} s{of_what} left" if seconds < 100 else f", {seconds / 60:.0f} min{of_what} left"
