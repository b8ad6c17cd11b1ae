"""What arrives goes into files before anything else is done with it; `gnomon imu` reads their folder.

Each line stands behind the computer's clock, as serial monitors print it (`2026-11-23 12:34:56.789012 -> `), so that
the stamps of the device and of the computer are both kept. It is handed to the operating system at once, and to the
disk every second. What no reader could use goes to a file of its own.

Images are kept likewise, in a folder that `gnomon camera` reads. Each is a PNG in cam0/, named after its timestamp in
ns, and a row of cam0/data.csv. It appears in the folder as a whole or not at all, and is on the disk a second later.
"""

import os
import threading
import time
from contextlib import suppress
from pathlib import Path

from ..errors import OutputError
from ..recording.recording import Grey

DAMAGED = "damaged.bin"
"""File of what arrived damaged; readers pass it over."""
_SYNC_S = 1.0
_LONGEST_LINE = 4096
_PRINTABLE = bytes(set(range(0x20, 0x7F)) | {0x09} | set(range(0x80, 0x100)))


class Recorder:
    """Adds lines to the files of a folder.

    Parameters
    ----------
    folder : is made; it must hold nothing yet
    name : of the file with the samples, before its ending

    Raises
    ------
    OutputError
        If the folder holds something, or cannot be written.
    """

    def __init__(self, folder: Path, name: str = "samples") -> None:
        try:
            folder.mkdir(parents=True, exist_ok=True)
            there = next(folder.iterdir(), None)
        except OSError as error:
            raise OutputError(f"{folder}: cannot record here ({error.strerror or error}).") from None
        if there is not None:
            raise OutputError(
                f"{folder}: this folder holds {there.name} already, and a recording is never written over. Name "
                "another one with -o."
            )
        self.folder, self._name = folder, name
        self.written = self.damaged = 0
        self._files: dict[str, int] = {}
        self._lock = threading.Lock()
        self._second, self._front = -1, b""
        self._synced_s = time.monotonic()

    def record_line(self, line: bytes, stream: str = "", host_ns: int | None = None) -> bytes:
        """Write a line that belongs to a stream, and return it as it stands in the file.

        Parameters
        ----------
        line : without its end
        stream : such as "accelerometer"; "" where a line holds all
        host_ns : when it arrived [ns since 1970]; now where it is None
        """
        whole = self._stamp(time.time_ns() if host_ns is None else host_ns) + line + b"\n"
        with self._lock:
            self.written += 1
            os.write(self._file(f"{self._file_of(stream)}.log"), whole)
        return whole

    def _file_of(self, stream: str) -> str:
        """Return the name of the file of a stream; those of a named IMU stand behind its name."""
        return self._name if not stream else stream if self._name == "samples" else f"{self._name}-{stream}"

    def record_damaged(self, line: bytes) -> None:
        """Write what is no line of a recording."""
        with self._lock:
            self.damaged += 1
            os.write(self._file(DAMAGED), line[:_LONGEST_LINE] + b"\n")

    def sync_files(self, *, at_once: bool = False) -> None:
        """Have everything on the disk, if a second passed since that was so; others may write meanwhile."""
        if not at_once and time.monotonic() - self._synced_s < _SYNC_S:
            return
        self._synced_s = time.monotonic()
        for file in list(self._files.values()):
            os.fsync(file)

    def close_files(self) -> None:
        """Have everything on the disk, and close the files."""
        with self._lock:
            self.sync_files(at_once=True)
            for file in self._files.values():
                os.close(file)
            self._files = {}

    def _file(self, name: str) -> int:
        if name not in self._files:
            self._files[name] = os.open(self.folder / name, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644)
        return self._files[name]

    def _stamp(self, host_ns: int) -> bytes:
        second, rest = divmod(host_ns, 1_000_000_000)
        if second != self._second:
            self._second = second
            self._front = time.strftime("%Y-%m-%d %H:%M:%S", time.gmtime(second)).encode()
        return b"%s.%06d -> " % (self._front, rest // 1000)


def is_printable(line: bytes) -> bool:
    """Return whether a line may be text: no control characters, and not longer than a sample is."""
    return len(line) < _LONGEST_LINE and not line.translate(None, _PRINTABLE)


_HEADER = b"timestamp [ns],filename\n"
_IMAGES_SYNC_S = 1.0
_FASTEST = 1  # of PNG's compressions


class ImageRecorder:
    """Adds images to the folders of their cameras.

    Parameters
    ----------
    folder : is there
    """

    def __init__(self, folder: Path) -> None:
        self.folder, self.written = folder, 0
        self._tables: dict[str, int] = {}
        self._waiting: list[Path] = []
        self._synced_s = time.monotonic()

    def record_image(self, t_ns: int, image: Grey, camera: str = "cam0") -> None:
        """Write an image.

        Parameters
        ----------
        t_ns : when it was taken [ns]
        image : (height, width)
        camera : its name
        """
        import cv2

        content = cv2.imencode(".png", image, [cv2.IMWRITE_PNG_COMPRESSION, _FASTEST])[1]
        table, path = self._table(camera), self.folder / camera / f"{t_ns}.png"
        part = path.with_name(f".{path.name}.part")
        part.write_bytes(content.data)
        part.replace(path)
        os.write(table, f"{t_ns},{path.name}\n".encode())
        self._waiting.append(path)
        self.written += 1

    def sync_files(self, *, at_once: bool = False) -> None:
        """Have everything on the disk, if a second passed since that was so; others may write meanwhile."""
        if not at_once and time.monotonic() - self._synced_s < _IMAGES_SYNC_S:
            return
        self._synced_s = time.monotonic()
        waiting, self._waiting = self._waiting, []
        folders = {path.parent for path in waiting}
        for path in (*waiting, *folders):
            with suppress(PermissionError):  # of folders, where the system knows no such thing
                file = os.open(path, os.O_RDONLY)
                os.fsync(file)
                os.close(file)
        for table in list(self._tables.values()):
            os.fsync(table)

    def close_files(self) -> None:
        """Have everything on the disk, and close the tables."""
        self.sync_files(at_once=True)
        for table in self._tables.values():
            os.close(table)
        self._tables = {}

    def _table(self, camera: str) -> int:
        if camera not in self._tables:
            folder = self.folder / camera
            folder.mkdir(exist_ok=True)
            table = os.open(folder / "data.csv", os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644)
            self._tables[camera] = table
            os.write(table, _HEADER)
        return self._tables[camera]
