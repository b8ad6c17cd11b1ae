"""Images go into files as they arrive, before anything else is done with them; `gnomon camera` reads their folder.

Each is a PNG in cam0/, named after its timestamp in ns, and a row of cam0/data.csv. It appears in the folder as a whole
or not at all, and is on the disk a second later.
"""

import os
import time
from contextlib import suppress
from pathlib import Path

from ..recording.images import Grey

_HEADER = b"timestamp [ns],filename\n"
_SYNC_S = 1.0
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
        if not at_once and time.monotonic() - self._synced_s < _SYNC_S:
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
