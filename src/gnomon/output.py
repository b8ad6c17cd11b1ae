"""Whole files and folders or none: what is written here appears under its name only when it is complete."""

import os
import shutil
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


@contextmanager
def whole_folder(path: str | os.PathLike[str]) -> Generator[Path]:
    """Give a new folder beside `path` that takes its place at the end, and vanishes if anything goes wrong.

    Raises
    ------
    OutputError
        If there is a file of that name, the folder is not empty, or it cannot be written.
    """
    target = Path(os.path.abspath(path))  # noqa: PTH100 - a link at the end of the path is not followed
    try:
        if target.is_symlink() or (target.exists() and not target.is_dir()):
            raise OutputError(f"{path}: there is a file of this name. Choose another place with -o.")
        if target.exists() and any(target.iterdir()):
            raise OutputError(f"{path}: this folder is not empty. Choose another place with -o.")
        target.parent.mkdir(parents=True, exist_ok=True)
        temporary = target.with_name(f".{target.name}.{os.urandom(4).hex()}.part")
        temporary.mkdir()
        try:
            yield temporary
            if target.exists():
                target.rmdir()
            temporary.replace(target)
        except BaseException:
            shutil.rmtree(temporary, ignore_errors=True)
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
