"""Whole files and folders or none: what is written here appears under its name only when it is complete.

A single file is written beside its place and renamed (`atomic_file`). Files that belong together are written into a
folder of their own in the folder where they will be (`files_together`); when all are complete, one rename declares them
valid, and from then on they are moved to their places one after the other. A process that is killed before that rename
leaves the old files; one that is killed after it leaves the new ones, of which some wait in `.gnomon-ready` until
`put_in_place` moves them, which the command line does first of all in every folder that it is told. Everything is on
the disk before it is renamed, because of power failures.

What is being written is locked as long as its process lives, so that the next writer can tell what a killed one left
from the work of a process beside it. On Windows an open file cannot be removed or renamed, which tells the same.

Inputs are guarded here, too: none is written over (`spare_inputs`), none is read that is no file (`refuse_special`).
"""

import json
import os
import shutil
import stat
import sys
from collections.abc import Generator, Iterable, Mapping
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from pathlib import Path
from typing import IO

from .errors import OutputError, RecordingError

READY = ".gnomon-ready"
"""Folder of files that are complete and on the way to their places."""
_STAGING = ".gnomon-staging-"
_HELD, _DROPPED = ".in-use", ".dropped"
_OLD = ".old-"
_OURS = (_HELD, _DROPPED)
_RESULTS = frozenset(
    ("calibration.yaml", "report.html", "diagnostics.npz", "trajectory.txt", "results-cam.txt", "results-imucam.txt")
)
_UNFINISHED: set[Path] = set()
"""Files and folders that are being written by this process."""
_SPARED: ContextVar[tuple[Path, ...]] = ContextVar("spared", default=())


# ---- what is read is not written ----


@contextmanager
def spare_inputs(paths: Iterable[Path]) -> Generator[None]:
    """Refuse, meanwhile, to write over any of these files, by whatever name, or over what lies in these folders.

    In a folder, files with the names of results are nobody's input unless they are named themselves.
    """
    before = _SPARED.set(tuple(paths))
    try:
        yield
    finally:
        _SPARED.reset(before)


def refuse_input(target: Path) -> None:
    """Refuse to write to a place where something lies that is read.

    Raises
    ------
    OutputError
        If it is an input, or in a folder that is one.
    """
    if not target.exists():
        return
    for path in _SPARED.get():
        with suppress(OSError):
            named = path.is_file() and target.samefile(path)
            inside = path.is_dir() and target.parent.samefile(path) and target.name not in _RESULTS
            if named or inside:
                raise OutputError(
                    f"{target}: this file is read, and would be replaced. Nothing was changed. Choose another place "
                    "with -o."
                )


# ---- one file ----


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
        refuse_input(target)
        target = target.resolve()
        if target.is_dir():
            raise OutputError(f"{path}: this is a folder. Give the name of a file in it.")
        put_in_place(target.parent)  # else an older file of this name that waits there would replace the new one
        _remove_abandoned(target.parent, f".{target.name}.", ".part")
        temporary = target.with_name(f".{target.name}.{os.urandom(4).hex()}.part")
        _UNFINISHED.add(temporary)
        try:
            with _hold(temporary) as stream:
                yield stream
                stream.flush()
                os.fsync(stream.fileno())
                if sys.platform != "win32":  # under the lock, so that nobody takes it for abandoned
                    temporary.replace(target)
            if sys.platform == "win32":
                temporary.replace(target)
            _on_disk(target.parent)
        except BaseException:
            with suppress(OSError):
                temporary.unlink()
            raise
        finally:
            _UNFINISHED.discard(temporary)
    except OSError as error:
        raise _cannot(path, error) from error


def write_whole(path: str | os.PathLike[str], content: str | bytes) -> None:
    """Write a whole file, text as UTF-8 with line ends as they are.

    Raises
    ------
    OutputError
        If the file cannot be written.
    """
    with atomic_file(path) as stream:
        stream.write(content.encode() if isinstance(content, str) else content)


def drop_unfinished() -> None:
    """Remove what this process is writing, which is about to end at once; other threads of it may still be at work."""
    for path in list(_UNFINISHED):
        with suppress(OSError):
            _remove(path)
            path.parent.rmdir()  # a folder that was made for it alone


def remove_parts(folder: Path, start: str) -> None:
    """Remove what killed processes left in a folder of files whose names begin with `start`."""
    _remove_abandoned(folder, f".{start}", ".part")


# ---- files that belong together ----


@contextmanager
def files_together(folder: str | os.PathLike[str], own: tuple[str, ...] = ()) -> Generator[Path]:
    """Give an empty folder to write into, and at the end move what is in it to `folder`, all or nothing.

    `folder` is made at once, so that a place that cannot be written is known before any work is done. What an earlier
    result left, files and folders that are named in `own`, is replaced, or removed where the new result has none; other
    files stay as they are. If anything goes wrong nothing changes.

    Raises
    ------
    OutputError
        If the folder cannot be made or written, or a folder has the name of a file.
    """
    place = Path(folder)
    for name in own:
        refuse_input(place / name)
    made = [path for path in (place, *place.parents) if not path.exists()]
    staging, held = place / f"{_STAGING}{os.urandom(4).hex()}", None
    _UNFINISHED.add(staging)
    try:
        with suppress(FileNotFoundError):
            held = _begun(place, staging)
        if held is None:  # another process, which failed, removed the folder that it had made
            held = _begun(place, staging)
        yield staging
        _check_places(staging, place)
        dropped = sorted(set(own) - {path.name for path in staging.iterdir()})
        (staging / _DROPPED).write_text(json.dumps(dropped), encoding="utf-8")
        _all_on_disk(staging)
        _declare_valid(staging, place, held)
        put_in_place(place)
    except BaseException as error:
        if held is not None:
            held.close()
        shutil.rmtree(staging, ignore_errors=True)
        if isinstance(error, KeyboardInterrupt):
            put_in_place(place)  # what is declared valid is moved all the same
        _remove_empty(made)
        if isinstance(error, OSError):
            raise (_cannot if held is None else _unchanged)(folder, error) from error
        raise
    finally:
        _UNFINISHED.discard(staging)


def write_together(folder: str | os.PathLike[str], contents: Mapping[str, str | bytes]) -> None:
    """Write files that belong together into a folder, which is made: name -> text or bytes; all of them or none.

    Raises
    ------
    OutputError
        If they cannot be written.
    """
    with files_together(folder) as staging:
        for name, content in contents.items():
            (staging / name).write_bytes(content.encode() if isinstance(content, str) else content)


@contextmanager
def whole_folder(path: str | os.PathLike[str]) -> Generator[Path]:
    """Give a new folder that takes its place at the end, and vanishes if anything goes wrong.

    Raises
    ------
    OutputError
        If there is a file of that name, the folder is not empty, or it cannot be written.
    """
    target = Path(os.path.abspath(path))  # noqa: PTH100 - a link at the end of the path is not followed
    try:
        _check_free(target, path)
        with files_together(target.parent) as staging:
            made = staging / target.name
            made.mkdir()
            yield made
            _check_free(target, path)
    except OSError as error:
        raise _cannot(path, error) from error


def put_in_place(folder: Path) -> None:
    """Move files that are complete to their places, where whoever made them was killed on the way.

    Raises
    ------
    OutputError
        If one of them cannot be moved; it waits on.
    """
    ready = folder / READY
    if not ready.is_dir():
        return
    try:
        with _alone(folder):
            if ready.is_dir():  # else another process was faster
                _move_all(ready, folder)
    except OSError as error:
        if isinstance(error, FileNotFoundError) and not ready.is_dir():
            return  # the same, where folders cannot be locked
        raise OutputError(
            f"{error.filename or folder}: this file cannot be replaced ({error.strerror or error}). If another program "
            f"has it open, close it there. The new one waits in {ready}; any gnomon command on this folder puts it in "
            "its place."
        ) from error


def _begun(place: Path, staging: Path) -> IO[bytes]:
    """Make a folder and an empty one in it, and return the open file by which that one is held."""
    place.mkdir(parents=True, exist_ok=True)
    put_in_place(place)
    with _alone(place):
        _remove_abandoned(place, _STAGING, "")
        staging.mkdir()
        return _hold(staging / _HELD)


def _declare_valid(staging: Path, place: Path, held: IO[bytes]) -> None:
    """Rename a complete staging folder, from which moment its files are the valid ones."""
    with _alone(place):
        held.close()  # on Windows no folder with an open file in it can be renamed
        while (place / READY).is_dir():  # of a process that was killed in between
            _move_all(place / READY, place)
        staging.rename(place / READY)
        _on_disk(place)


def _move_all(ready: Path, folder: Path) -> None:
    """Move what is in `ready` to its places; whatever is done already is passed over, so that it can be done again."""
    for path in sorted(path for path in ready.iterdir() if path.name not in _OURS and not path.name.startswith(_OLD)):
        target = folder / path.name
        if path.is_dir() and target.is_dir() and not target.is_symlink():  # which is not replaced as it is
            _remove(ready / f"{_OLD}{path.name}")
            target.rename(ready / f"{_OLD}{path.name}")
        elif path.is_dir():
            target.unlink(missing_ok=True)
        path.replace(target)
    for name in _names_dropped(ready / _DROPPED):
        _remove(folder / name)
    _on_disk(folder)
    shutil.rmtree(ready)


def _names_dropped(file: Path) -> list[str]:
    try:
        names = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return []
    return [
        str(name) for name in names if name not in {"", ".", ".."} and Path(str(name)).name == str(name)
    ]  # no paths


def _check_places(staging: Path, place: Path) -> None:
    """Refuse to replace a folder by a file: it is somebody else's."""
    for path in staging.iterdir():
        target = place / path.name
        refuse_input(target)
        if not path.is_dir() and target.is_dir():
            raise OutputError(f"{target}: this is a folder. Nothing was changed. Choose another folder with -o.")


def _check_free(target: Path, path: str | os.PathLike[str]) -> None:
    if target.is_symlink() or (target.exists() and not target.is_dir()):
        raise OutputError(f"{path}: there is a file of this name. Choose another place with -o.")
    if target.exists() and any(target.iterdir()):
        raise OutputError(f"{path}: this folder is not empty. Choose another place with -o.")


# ---- what killed processes left ----


def _hold(path: Path) -> IO[bytes]:
    """Open a new file that is locked until it is closed, or its process ends in any way."""
    while True:
        stream = path.open("xb")
        _lock(stream.fileno(), wait=True)
        if os.fstat(stream.fileno()).st_nlink:  # else somebody took it for abandoned before it was locked
            return stream
        stream.close()


def _remove_abandoned(folder: Path, start: str, end: str) -> None:
    """Remove parts and staging folders, by start and end of their names, that no running process holds."""
    with suppress(OSError), os.scandir(folder) as entries:
        found = [Path(entry.path) for entry in entries if entry.name.startswith(start) and entry.name.endswith(end)]
        for path in found:
            if not path.is_dir():
                _let_go(path)
            elif not (path / _HELD).exists() or _let_go(path / _HELD):
                shutil.rmtree(path, ignore_errors=True)


def _let_go(file: Path) -> bool:
    """Remove a file unless a running process holds it, and tell whether it is gone."""
    try:
        if sys.platform == "win32":
            file.unlink()  # fails as long as it is open anywhere
            return True
        with file.open("rb+") as stream:
            if not _lock(stream.fileno()):
                return False
            file.unlink()
    except OSError:
        return False
    return True


if sys.platform == "win32":

    def _lock(descriptor: int, *, wait: bool = False) -> bool:
        return True

    @contextmanager
    def _alone(folder: Path) -> Generator[None]:
        # Folders have no locks there. Two processes that finish in one folder within the same milliseconds may mix
        # their files; each file is still whole.
        yield

    def _on_disk(folder: Path) -> None:
        """Folders cannot be opened there; a rename is in the file system's journal."""

else:
    import fcntl

    def _lock(descriptor: int, *, wait: bool = False) -> bool:
        """Lock an open file or folder; False where another process has locked it, or there are no locks."""
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
        except OSError:
            return False
        return True

    @contextmanager
    def _alone(folder: Path) -> Generator[None]:
        """Let no other process move files in this folder meanwhile."""
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            _lock(descriptor, wait=True)
            yield
        finally:
            os.close(descriptor)

    def _on_disk(folder: Path) -> None:
        """Let the names in a folder survive a power failure, as far as the file system can."""
        with suppress(OSError):
            descriptor = os.open(folder, os.O_RDONLY)
            try:
                os.fsync(descriptor)
            finally:
                os.close(descriptor)


def _all_on_disk(folder: Path) -> None:
    """Let all that is in a folder survive a power failure."""
    for place, _, names in os.walk(folder):
        for name in names:
            with (Path(place) / name).open("rb+") as stream:
                os.fsync(stream.fileno())
        _on_disk(Path(place))


# ---- errors and odds ----


def _cannot(path: str | os.PathLike[str], error: OSError) -> OutputError:
    return OutputError(
        f"{path}: cannot be written ({error.strerror or error}). "
        "Choose another place with -o, or make this folder writable."
    )


def _unchanged(folder: str | os.PathLike[str], error: OSError) -> OutputError:
    return OutputError(f"{folder}: cannot be written ({error.strerror or error}). Nothing was changed.")


def _remove(path: Path) -> None:
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


def _remove_empty(folders: list[Path]) -> None:
    """Remove folders that were made, innermost first, as far as nothing is in them."""
    for path in folders:
        with suppress(OSError):
            path.rmdir()


def refuse_special(path: Path) -> None:
    """Refuse what is neither a file nor a folder: a pipe gives its bytes once, and a device has no end.

    Raises
    ------
    RecordingError
        If it is a pipe, a device or a socket.
    """
    try:
        mode = path.stat().st_mode
    except OSError:  # whoever opens it says what is wrong
        return
    if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
        kind = (
            "a pipe" if stat.S_ISFIFO(mode) else "a device" if stat.S_ISCHR(mode) or stat.S_ISBLK(mode) else "a socket"
        )
        raise RecordingError(
            f"{path}: this is {kind}, and gnomon reads its inputs more than once. Write what comes out of it into a "
            "file, such as zcat a.csv.gz > a.csv, and give that file."
        )
