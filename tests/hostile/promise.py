"""What is promised for every file that is read, whoever made it, and how one input is held against it.

A reader returns a value or raises a GnomonError with a message. It never ends in another exception or in a warning,
takes seconds at most, reserves memory in proportion to the file, writes nothing, and starts no process and no
connection. docs/files.md says the same to users.
"""

import signal
import sys
import time
import traceback
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gnomon.errors import GnomonError

FLOOR_BYTES, PER_BYTE = 64 << 20, 50
"""Memory that reading a file may take: the floor, and for each byte of the file."""
LIMIT_S = 10.0
"""CPU time for one small file [s]."""
_LONGEST_MESSAGE = 4000
_OUTSIDE = ("socket.connect", "socket.bind", "subprocess.Popen", "os.system", "os.exec", "os.posix_spawn", "os.fork")
_CHANGES = ("os.remove", "os.rename", "os.mkdir", "os.rmdir", "os.link", "os.symlink", "os.chmod", "os.truncate")
_UNPICKLED = ("pickle.find_class",)
_SYSTEM = ("/proc", "/sys", "/dev", "/usr", "/lib", "/etc/localtime", sys.prefix, sys.base_prefix)


class BrokenPromiseError(AssertionError):
    """An input for which a reader does not keep what is promised."""


class _SlowError(BaseException):
    """Raised by the alarm; no `except Exception` catches it."""


@dataclass(frozen=True, kw_only=True)
class Target:
    """One way by which a file of somebody else comes into gnomon.

    Attributes
    ----------
    name : of the target, for the command line and for the names of tests
    file : the file that is damaged, as a path in the folder
    seeds : returns contents of valid files
    read : what a user reaches it by; takes the folder
    beside : writes the other files of the folder
    form : "yaml", "json", "text" or "bytes"; what damages are tried
    floor_bytes : memory that may be taken however small the file is
    per_byte : memory that may be taken for each byte of the file
    """

    name: str
    file: str
    seeds: Callable[[], list[bytes]]
    read: Callable[[Path], Any]
    beside: Callable[[Path], None] = lambda _: None
    form: str = "bytes"
    floor_bytes: int = FLOOR_BYTES
    per_byte: int = PER_BYTE

    def prepare(self, folder: Path) -> Path:
        """Write the files beside the one that is damaged, and return the folder."""
        folder.mkdir(parents=True, exist_ok=True)
        (folder / self.file).parent.mkdir(parents=True, exist_ok=True)
        self.beside(folder)
        return folder


# ---- what happens outside of the reader ----


class _Watch:
    """Listens to what Python audits: files, processes, connections. A hook cannot be taken away again, so it is one."""

    folder: Path | None = None
    found: list[str]

    def __init__(self) -> None:
        self.found = []
        sys.addaudithook(self)

    def __call__(self, event: str, args: tuple[Any, ...]) -> None:
        if self.folder is None:
            return
        if event in _OUTSIDE or event in _UNPICKLED:
            self.found.append(f"{event}{args!r:.200}")
        elif event in _CHANGES or event == "open":
            self._file(event, args)

    def _file(self, event: str, args: tuple[Any, ...]) -> None:
        path, mode = args[0], args[1] if len(args) > 1 else ""
        if isinstance(path, int) or str(path) == str(_CLEAR):
            return
        text = path.decode(errors="replace") if isinstance(path, bytes) else str(path)
        if Path(text).parent.name == "__pycache__":  # a module is imported for the first time; that is the interpreter
            return
        writes = event != "open" or (isinstance(mode, str) and any(letter in mode for letter in "wax+"))
        inside = Path(text).absolute().resolve().is_relative_to(self.folder.resolve()) if self.folder else True
        if writes and text != "/dev/null":
            self.found.append(f"{event} of {text} for writing")
        elif not inside and not text.startswith(_SYSTEM) and not text.endswith((".py", ".pyc", ".so", ".pyi")):
            self.found.append(f"{event} of {text}, which is outside of the folder")


_WATCH: list[_Watch] = []
_STATUS, _CLEAR = Path("/proc/self/status"), Path("/proc/self/clear_refs")


@contextmanager
def watched(folder: Path) -> Iterator[list[str]]:
    """Yield the list of what is done that must not be, in the eyes of Python's audit events."""
    if not _WATCH:
        _WATCH.append(_Watch())
    watch = _WATCH[0]
    watch.found = []
    watch.folder = folder
    try:
        yield watch.found
    finally:
        watch.folder = None


@contextmanager
def alarmed(seconds: float) -> Iterator[None]:
    """Stop what takes longer, in CPU time; where the system has no such alarm, or a fuzzer uses it, only measure."""
    begun = time.process_time()
    timer = getattr(signal, "ITIMER_PROF", None)
    if timer is not None:

        def late(*_: Any) -> None:
            raise _SlowError

        before = signal.signal(signal.SIGPROF, late)
        signal.setitimer(timer, seconds)
    try:
        yield
    except _SlowError:
        message = f"takes longer than {seconds:g} s:\n{''.join(traceback.format_exc().splitlines(keepends=True)[-16:])}"
        raise BrokenPromiseError(message) from None
    finally:
        if timer is not None:
            signal.setitimer(timer, 0)
            signal.signal(signal.SIGPROF, before)
    if time.process_time() - begun > seconds:
        raise BrokenPromiseError(f"takes {time.process_time() - begun:.1f} s, more than {seconds:g} s")


# ---- memory ----


def _resident(key: str) -> int:
    for line in _STATUS.read_text(encoding="ascii").splitlines():
        if line.startswith(key):
            return int(line.split()[1]) << 10
    return 0


def can_measure_memory() -> bool:
    """Tell whether the system tells the largest memory that was in use since it was last asked; Linux does."""
    try:
        _CLEAR.write_text("5", encoding="ascii")
    except OSError:
        return False
    return _resident("VmHWM") > 0


@contextmanager
def measured_memory(target: Target, size: int) -> Iterator[None]:
    """Measure the memory that is taken, whichever library takes it, and hold it against what is allowed."""
    if not can_measure_memory():
        yield
        return
    before = _resident("VmRSS")
    yield
    taken, allowed = _resident("VmHWM") - before, target.floor_bytes + target.per_byte * size
    if taken > allowed:
        raise BrokenPromiseError(f"takes {taken >> 20} MiB for a file of {size} bytes, allowed are {allowed >> 20}")


@contextmanager
def address_space(spare: int = 2 << 30) -> Iterator[None]:
    """Let the process reserve only so much more: what asks for absurd sizes ends in MemoryError instead of hope."""
    try:
        import resource
    except ImportError:  # not on this system
        yield
        return
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    now = _resident("VmSize") if _STATUS.exists() else 0
    wanted = now + spare
    if not now or (hard != resource.RLIM_INFINITY and wanted > hard):
        yield
        return
    resource.setrlimit(resource.RLIMIT_AS, (wanted, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))


# ---- one input ----


def keep(target: Target, folder: Path, data: bytes, *, memory: bool = True, alarm: bool = True) -> GnomonError | None:
    """Read one input and return what it was refused with, or None where it was read.

    Parameters
    ----------
    folder : as `Target.prepare` returned it
    data : content of the file
    memory : whether memory is measured
    alarm : whether the reading is stopped when it takes too long; in the main thread only

    Raises
    ------
    BrokenPromiseError
        If the reader does anything else than return a value or refuse the file in words.
    """
    (folder / target.file).write_bytes(data)
    with watched(folder) as done:
        refused = _read(target, folder, len(data), memory=memory, alarm=alarm)
    if done:
        raise BrokenPromiseError(f"{target.name}: {'; '.join(done[:4])}")
    return refused


def _read(target: Target, folder: Path, size: int, *, memory: bool, alarm: bool) -> GnomonError | None:
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            with (
                measured_memory(target, size) if memory else _nothing(),
                alarmed(LIMIT_S) if alarm else _nothing(),
            ):
                target.read(folder)
    except GnomonError as error:
        _check_message(target, error)
        return error
    except BrokenPromiseError as error:
        raise BrokenPromiseError(f"{target.name}: {error}") from None
    except BaseException as error:
        if isinstance(error, KeyboardInterrupt | SystemExit):
            raise
        raise BrokenPromiseError(f"{target.name}: {type(error).__name__}: {error!s:.500}") from error
    return None


def _check_message(target: Target, error: GnomonError) -> None:
    text = str(error)
    if not text.strip():
        raise BrokenPromiseError(f"{target.name}: {type(error).__name__} without a message")
    if len(text) > _LONGEST_MESSAGE:
        raise BrokenPromiseError(f"{target.name}: a message of {len(text)} characters: {text[:200]}")
    if "Traceback (most recent" in text:
        raise BrokenPromiseError(f"{target.name}: a traceback in a message")


@contextmanager
def _nothing() -> Iterator[None]:
    yield
