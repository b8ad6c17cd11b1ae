"""The tables that an app on a phone exported: in a folder, or packed into a zip that is read without unpacking it."""

import zipfile
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path, PurePosixPath
from typing import IO

from ...errors import RecordingError
from ...formats.shared.structured import shorten_text
from ...frozen import value_class
from ...recording import Source
from ..files import (
    NPZ_MAGIC,
    ZIP_DAMAGE,
    TextFile,
    file_source,
    first_bytes,
    plain_text,
    read_text_file,
    refuse_zip_bomb,
)

_MOST_MEMBERS = 10_000
_TABLES = (".csv", ".txt", ".tsv")
_INNER = ("meta",)  # of phyphox


@value_class(eq=True)
class LogFiles:
    """The tables of one recording.

    Attributes
    ----------
    path : the folder, the zip, or the only table
    names : of its tables, as paths in it
    """

    path: Path
    names: tuple[str, ...]

    def named(self, *words: str) -> str | None:
        """Return the first table that is called like one of the words, which are in lower case, without suffix.

        Raises
        ------
        RecordingError
            If several are called so, in different folders.
        """
        for word in words:
            found = [name for name in self.names if table_stem(name) == word]
            if len(found) > 1:
                raise RecordingError(
                    f"{self.path.name}: holds several recordings ({', '.join(found[:4])}). Give the folder of one."
                )
            if found:
                return found[0]
        return None

    def head(self, name: str, count: int = 4096) -> str:
        """Return the beginning of a table as text, or "" where it cannot be read."""
        try:
            with self._opened(name) as data:
                head = data.read(count)
        except (OSError, RecordingError):
            return ""
        return head.removeprefix(b"\xef\xbb\xbf").decode("utf-8", errors="replace")

    def text(self, name: str) -> TextFile:
        """Read a table.

        Raises
        ------
        RecordingError
            If it is too large, damaged or no text.
        """
        if not zipfile_at(self.path):
            return read_text_file(self._place(name))
        with self._opened(name) as data:
            packed = data.read()
        label = PurePosixPath(name).name
        text = plain_text(packed, Path(f"{self.path.name}, {label}"))
        return TextFile(name=label, data=text, source=self.sources([name])[0])

    def sources(self, names: list[str]) -> tuple[Source, ...]:
        """Return what stands for the tables that were read: the zip, or the tables themselves."""
        if zipfile_at(self.path):
            return (file_source(self.path),)
        return tuple(file_source(self._place(name)) for name in names)

    def _place(self, name: str) -> Path:
        return self.path / name if self.path.is_dir() else self.path

    @contextmanager
    def _opened(self, name: str) -> Generator[IO[bytes]]:
        if not zipfile_at(self.path):
            with self._place(name).open("rb") as file:
                yield file
            return
        with zip_errors(self.path, name), zipfile.ZipFile(self.path) as archive, archive.open(name) as member:
            yield member


def log_files(path: Path) -> LogFiles | None:
    """Return the tables in a folder or a zip, or a table alone; None where there are none, or the zip is an NPZ file.

    Raises
    ------
    RecordingError
        If a zip is damaged, or holds files of which none is a table.
    """
    if path.is_dir():
        folders = [path, *(path / name for name in _INNER if (path / name).is_dir())]
        inside = [entry for folder in folders for entry in sorted(folder.iterdir()) if _is_table(entry.name)]
        names = [entry.relative_to(path).as_posix() for entry in inside if entry.is_file()]
    elif zipfile_at(path):
        with zip_errors(path), zipfile.ZipFile(path) as archive:
            members = archive.infolist()
            if len(members) > _MOST_MEMBERS:
                raise RecordingError(f"{path.name}: {len(members)} files in one zip; the log of a phone has a few.")
            refuse_zip_bomb(archive, path.name)
            names = [member.filename for member in members if not member.is_dir()]
        if not names or any(name.endswith(".npy") for name in names):
            return None
        if not any(map(_is_table, names)):
            what = f"holds no table ({', '.join(names[:4])})"
            if any(name.startswith("xl/") for name in names):
                what = "this is a workbook of a spreadsheet program"
            raise RecordingError(f"{path.name}: {what}. Export the recording as CSV.")
    else:
        names = [path.name] if path.is_file() else []
    tables = tuple(name for name in names if _is_table(name))
    return LogFiles(path=path, names=tables) if tables else None


def zipfile_at(path: Path) -> bool:
    """Tell whether a file begins as a zip."""
    try:
        return path.is_file() and path.stat().st_size > 0 and first_bytes(path, 4).startswith(NPZ_MAGIC)
    except (OSError, RecordingError):
        return False


@contextmanager
def zip_errors(path: Path, name: str = "") -> Generator[None]:
    """Turn what goes wrong with a zip into one message."""
    where = f"{path.name}, {PurePosixPath(name).name}" if name else path.name
    try:
        yield
    except RuntimeError as error:  # also of a method of packing that is not known
        raise RecordingError(
            f"{where}: cannot be unpacked ({shorten_text(str(error))}). Unpack it yourself and give the folder."
        ) from None
    except ZIP_DAMAGE as error:
        raise RecordingError(
            f"{where}: the zip is cut off or damaged ({shorten_text(str(error))}). Copy it again."
        ) from None


def table_stem(name: str) -> str:
    """Return what a table is called, in lower case, without folder and suffix."""
    return PurePosixPath(name).stem.lower()


def _is_table(name: str) -> bool:
    hidden = any(part.startswith((".", "__MACOSX")) and part != ".." for part in PurePosixPath(name).parts)
    return name.lower().endswith(_TABLES) and not hidden
