"""Where words go: results to standard output, progress and errors to standard error."""

import json
import logging
import math
import shlex
import sys
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import fields, is_dataclass
from os import PathLike
from typing import TYPE_CHECKING, Any

from ..findings import printable_text

if TYPE_CHECKING:
    from rich.console import RenderableType
    from rich.status import Status
    from rich.text import Text

WIDTH = 80
"""Columns of text that is not printed to a terminal."""


class Terminal:
    """One command's standard output and standard error.

    Parameters
    ----------
    as_json : standard output gets one JSON document, and nothing else
    """

    def __init__(self, *, as_json: bool) -> None:
        self.as_json = as_json
        self._status: Status | None = None
        self.next_lines: list[str] = []
        logging.basicConfig(stream=sys.stderr, level=logging.WARNING, format="gnomon: %(message)s")

    def print(self, text: str, style: str = "") -> None:
        """Print a result for a person, in colour on a terminal; nothing when the output is JSON."""
        if self.as_json:
            return
        self.close()
        text = printable_text(text)
        if style and sys.stdout.isatty():
            from rich.console import Console

            Console(highlight=False, markup=False, soft_wrap=True).print(text, style=style)
        else:
            sys.stdout.write(text + "\n")

    def draw(self, thing: "RenderableType") -> None:
        """Print a table; nothing when the output is JSON."""
        if not self.as_json:
            self.close()
            from rich.console import Console

            terminal = sys.stdout.isatty()
            # Names of files, sensors and topics are text, whatever brackets they hold; rich drops control characters.
            Console(file=sys.stdout, width=None if terminal else WIDTH, highlight=False, markup=False).print(thing)

    def propose(self, *words: str | PathLike[str]) -> None:
        """Print which command goes on from here, and keep it for the document.

        Parameters
        ----------
        words : behind gnomon; one in capitals, such as RECORDING, stands for what the user has yet to name
        """
        self.next_lines.append(shlex.join(["gnomon", *map(str, words)]))
        self.print(f"{'next' if len(self.next_lines) == 1 else '':<12} {self.next_lines[-1]}")

    def document(self, content: Mapping[str, Any] | Callable[[], Mapping[str, Any]]) -> None:
        """Print the JSON document, made only where it was asked for, with the commands that go on from here."""
        if self.as_json:
            self.close()
            content = content() if callable(content) else content
            content = {**content, "next": self.next_lines} if self.next_lines else content
            utf8 = (sys.stdout.encoding or "utf-8").lower() == "utf-8"  # elsewhere, as on Windows, letters are escaped
            sys.stdout.write(json.dumps(json_value(content), indent=2, ensure_ascii=not utf8, allow_nan=False) + "\n")

    def progress(self, step: str) -> None:
        """Say which step the work is at: in one changing line on a terminal, else in a line a step."""
        step = printable_text(step)
        if not sys.stderr.isatty():
            self.warn(step)
        elif self._status is not None:
            self._status.update(_unmarked(step))
        else:
            from rich.console import Console

            self._status = Console(stderr=True).status(_unmarked(step))
            self._status.start()

    def warn(self, line: str) -> None:
        """Write a line to standard error, whether anybody takes it or not."""
        with suppress(OSError):
            sys.stderr.write(f"{line}\n")

    def close(self) -> None:
        """Take the changing line away."""
        if self._status is not None:
            self._status.stop()
            self._status = None


def _unmarked(text: str) -> "Text":
    """Return a text in which rich sees no markup."""
    from rich.text import Text

    return Text(text)


def json_value(value: Any) -> Any:
    """Return a value as JSON knows it: lists for arrays, null for what is not a finite number."""
    if is_dataclass(value):
        return {entry.name: json_value(getattr(value, entry.name)) for entry in fields(value)}
    if isinstance(value, Mapping):
        return {str(key): json_value(item) for key, item in value.items()}
    if value is None or isinstance(value, bool | int | str | float):
        return None if isinstance(value, float) and not math.isfinite(value) else value
    if hasattr(value, "tolist"):  # an array or a number of NumPy
        return json_value(value.tolist())
    if isinstance(value, list | tuple):
        return [json_value(item) for item in value]
    return str(value)
