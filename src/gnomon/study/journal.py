"""What a study has done, in a file of its folder: an interrupted one goes on from it, a finished one is shown from it.

The first line says which gnomon made it. Each line after it is a checksum, the key of a task, and its outcome as JSON;
they are only ever added. A line that is not whole, as the last one may be after a loss of power, is cut off. The file
holds nothing but data.
"""

import hashlib
import os
import time
import zlib
from collections.abc import Generator
from contextlib import contextmanager
from functools import cache
from importlib.metadata import version
from itertools import count
from pathlib import Path
from typing import IO

from .._version import __version__
from ..errors import OutputError
from ..progress import Progress

JOURNAL = "runs.journal"
"""Name of the file in the folder of a study."""
_MARK = b"gnomon study journal 1"
_SYNC_S = 2.0
"""So much work at most is lost with the power; nothing is when only the program ends."""


class FileJournal:
    """The journal of one study; see `gnomon.study.runs.Journal`.

    Parameters
    ----------
    stream : an open file of records, at its end
    records : what is in it
    """

    def __init__(self, stream: IO[bytes], records: dict[str, str]) -> None:
        self._stream, self._records = stream, records
        self._synced = time.monotonic()

    def __len__(self) -> int:
        """Return how many outcomes there are."""
        return len(self._records)

    @property
    def kept(self) -> str:
        """What there is, in words."""
        return f"{len(self)} runs that are done are kept, and the same command goes on from there."

    def find(self, key: str) -> str | None:
        """Return the record that was kept under a key; None where there is none."""
        return self._records.get(key)

    def keep(self, key: str, record: str) -> None:
        """Keep a record under a key."""
        self._records[key] = record
        self._stream.write(_line(f"{key} {record}"))
        self._stream.flush()
        if time.monotonic() - self._synced > _SYNC_S:
            os.fsync(self._stream.fileno())
            self._synced = time.monotonic()


@contextmanager
def study_journal(folder: Path, study: str, tell: Progress) -> Generator[FileJournal]:
    """Open the journal in the folder of a study; without outcomes in the end, the file goes.

    What another version of gnomon, other sources of it, or another NumPy or SciPy made is not taken over: its file gets
    another name, which `tell` is told.

    Raises
    ------
    OutputError
        If it cannot be written, is not gnomon's, or another process is writing it.
    """
    path = folder / JOURNAL
    head = f"{_MARK.decode()} {study} {_made_by()}"
    try:
        _put_aside(path, head, tell)
        with path.open("a+b") as stream:
            _lock(stream, path)
            journal = FileJournal(stream, _read(stream, head, path))
            try:
                yield journal
            finally:
                stream.close()
                if len(journal) == 0:
                    path.unlink(missing_ok=True)
    except OSError as error:
        raise OutputError(f"{path}: the journal of the study cannot be written ({error.strerror or error}).") from error


def _put_aside(path: Path, head: str, tell: Progress) -> None:
    """Give the journal of another study, or of another gnomon, a name that nothing else has."""
    if not path.exists():
        return
    with path.open("r+b") as stream:
        _lock(stream, path)
        first = stream.readline()
    if not _is_ours(first):
        raise OutputError(f"{path}: this is no journal of gnomon. Move it away, or choose another folder with -o.")
    if not first.endswith(b"\n") or _content(first) == head:
        return
    names = (path.with_name(f"runs.old{number}.journal") for number in count(1))
    kept = next(name for name in names if not name.exists())
    path.rename(kept)
    tell(f"{path.name} is of another study or another gnomon; it is kept as {kept.name}, and the study begins anew")


def _read(stream: IO[bytes], head: str, path: Path) -> dict[str, str]:
    """Return the records of the file by their keys, and cut off what is behind the last whole line."""
    stream.seek(0)
    first = stream.readline()
    if _content(first) != head:
        if first.endswith(b"\n"):
            raise OutputError(f"{path}: another process began a study in this folder. Choose another folder with -o.")
        stream.truncate(0)
        stream.write(_line(head))
        stream.flush()
        return {}
    records: dict[str, str] = {}
    whole = stream.tell()
    for content in map(_content, iter(stream.readline, b"")):
        if content is None:
            break
        key, _, record = content.partition(" ")
        records[key] = record
        whole += len(_line(content))
    stream.truncate(whole)
    return records


def _is_ours(first: bytes) -> bool:
    """Tell whether the first line is that of a journal, or the beginning of one."""
    checksum, space, content = first[:8], first[8:9], first[9:]
    if not first.endswith(b"\n"):
        return not checksum.strip(b"0123456789abcdef") and (_MARK.startswith(content) or content.startswith(_MARK))
    return space == b" " and content.startswith(_MARK)


def _line(content: str) -> bytes:
    raw = content.encode()
    return b"%08x %b\n" % (zlib.crc32(raw), raw)


def _content(line: bytes) -> str | None:
    """Return the content of a line; None where it is not whole."""
    checksum, _, raw = line.partition(b" ")
    if not raw.endswith(b"\n") or checksum != b"%08x" % zlib.crc32(raw[:-1]):
        return None
    return raw[:-1].decode("utf-8", "replace")


def _made_by() -> str:
    """Return what the results depend on besides the study."""
    return f"gnomon {__version__} {_sources()} numpy {version('numpy')} scipy {version('scipy')}"


@cache
def _sources() -> str:
    """Return a hash of gnomon's own sources, which change between versions where someone works on them."""
    package = Path(__file__).parents[1]
    sources = hashlib.sha256()
    for path in sorted(package.rglob("*.py")):
        sources.update(path.relative_to(package).as_posix().encode() + path.read_bytes())
    return sources.hexdigest()[:16]


def _lock(stream: IO[bytes], path: Path) -> None:
    """Keep other processes away where the system can; the lock goes with the process, however it ends."""
    try:
        import fcntl
    except ImportError:  # Windows
        return
    try:
        fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        raise OutputError(
            f"{path}: another process is at work on a study in this folder. Wait for it, or choose another folder "
            "with -o."
        ) from error
    except OSError:  # a file system without locks
        return
