"""The images of a simulated camera -> a folder in EuRoC's layout: data.csv, and data/<stamp>.png."""

from collections.abc import Callable
from pathlib import Path

from ..errors import RecordingError
from ..images import ImageStream
from ..output import whole_folder
from .png_files import encoded

_TENTHS = 10


def save_simulated_images(stream: ImageStream, place: Path, progress: Callable[[str], None] | None = None) -> Path:
    """Write the images of a camera into a folder that is not there yet, and return their table.

    Parameters
    ----------
    stream : the images; a few of them are rendered at the same time, and none is kept
    place : the folder, named after the camera
    progress : called with a sentence now and then

    Raises
    ------
    OutputError
        If the folder is not empty, or cannot be written.
    """
    tell = progress or (lambda _: None)
    every = max(1, stream.count // _TENTHS)
    with whole_folder(place) as folder:
        (folder / "data").mkdir()
        with (folder / "data.csv").open("w", encoding="ascii", newline="") as table:
            table.write("#timestamp [ns],filename\n")
            for number, (t_ns, png) in enumerate(encoded(stream.frames([]))):
                if number % every == 0:
                    tell(f"rendering {place.name}: image {number + 1} of {stream.count}")
                if isinstance(png, RecordingError):
                    raise png
                (folder / "data" / f"{t_ns}.png").write_bytes(png)
                table.write(f"{t_ns},{t_ns}.png\n")
    return place / "data.csv"
