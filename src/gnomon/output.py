"""Whole files or none: what is written here appears under its name only when it is complete."""

import os
from collections.abc import Generator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO

from .errors import OutputError


@contextmanager
def atomic_file(path: str | os.PathLike[str]) -> Generator[IO[bytes]]:
    """Open a new file beside `path` that takes its place at the end, and vanishes if anything goes wrong.

    A symbolic link is followed; a pipe or a device is written directly, since it cannot be replaced.

    Raises
    ------
    OutputError
        If the file cannot be written.
    """
    target = Path(path)
    try:
        if target.exists() and not target.is_file() and not target.is_dir():
            with target.open("wb") as stream:
                yield stream
            return
        target = target.resolve()
        if target.is_dir():
            raise OutputError(f"{path}: this is a folder. Give the name of a file in it.")
        temporary = target.with_name(f".{target.name}.{os.urandom(4).hex()}.part")
        descriptor = os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0), 0o666)
        try:
            with os.fdopen(descriptor, "wb") as stream:
                yield stream
            temporary.replace(target)
        except BaseException:
            with suppress(OSError):
                temporary.unlink()
            raise
    except OSError as error:
        raise OutputError(
            f"{path}: cannot be written ({error.strerror or error}). "
            "Choose another place with -o, or make this folder writable."
        ) from error


def write_whole(path: str | os.PathLike[str], content: str | bytes) -> None:
    """Write a whole file, text as UTF-8 with line ends as they are.

    Raises
    ------
    OutputError
        If the file cannot be written.
    """
    with atomic_file(path) as stream:
        stream.write(content.encode() if isinstance(content, str) else content)
