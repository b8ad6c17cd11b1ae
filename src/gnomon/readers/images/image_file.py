"""One image as a file -> 8 bits of grey, and the hash of a folder of them.

Whether a file is a video, by its content: most files are none by their first bytes, without PyAV being loaded.
"""

import hashlib
from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from ...errors import RecordingError
from ...output import refuse_special
from ...recording.frames import Grey
from ..files import is_mp4_head
from .image_pixels import bit_depth, decode_picture, largest_in_picture

_HEAD = 4096
_TEXT_MAGIC = b"YUV4MPEG2"  # the only video that begins as text
_NO_VIDEO = (
    *(b"\x1f\x8b", b"PK\x03\x04", b"#ROSBAG", b"\x89MCAP", b"SQLite format 3", b"\x93NUMPY", b"%PDF", b"MATLAB 5.0"),
    *(b"ULog\x01", b"\xa3\x95\x80", b"DEVC"),  # of autopilots and a GoPro: to some a stream of MPEG-4
)
_IMAGES = ("image2", "_pipe")


def is_video(path: Path) -> bool:
    """Tell by its content whether a file is a video."""
    try:
        if not path.is_file():
            return False
        with path.open("rb") as file:
            head = file.read(_HEAD)
    except OSError:
        return False
    text = b"\0" not in head and not head.startswith(_TEXT_MAGIC)
    if text or head.startswith(_NO_VIDEO):
        return False
    return is_mp4_head(head) or _opens_as_video(path)


def _opens_as_video(path: Path) -> bool:
    import av  # takes its time
    from av.error import FFmpegError

    try:
        with av.open(str(path)) as container:
            return bool(container.streams.video) and not container.format.name.endswith(_IMAGES)
    except (FFmpegError, OSError, ValueError):
        return False


IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".pgm")
_HASHING = 2  # threads: reading and hashing overlap, and more of them would only fight for the disk
_BATCH = 32  # files that a thread takes at a time
_LOOKED_AT = 32


def is_image_name(name: str) -> bool:
    """Tell by its suffix whether a file is an image; hidden files are none."""
    return name.lower().endswith(IMAGE_SUFFIXES) and not name.startswith(".")


def read_grey(path: Path, where: str, bits: int | None = None) -> Grey:
    """Return an image in 8 bits of grey, its pixels where the sensor had them.

    Colour becomes grey. A mark that the image is to be shown turned (of phones) is not followed: the lens belongs to
    the sensor, and such marks change while a phone is waved.

    Parameters
    ----------
    path : the file
    where : its name for messages
    bits : how many bits images of 16 bits really have; None to tell from this image alone

    Raises
    ------
    RecordingError
        If the file cannot be read, is empty or damaged, or holds no image.
    """
    return decode_picture(_content(path, where), where, bits)


def used_bits(files: Sequence[tuple[Path, str]]) -> int | None:
    """Return how many bits a camera's images of 16 bits really have, from images spread over all; None for 8 bits.

    Parameters
    ----------
    files : each image and its name for messages
    """
    largest = 0
    for path, where in files[:: max(1, len(files) // _LOOKED_AT)]:
        try:
            found = largest_in_picture(_content(path, where), where)
        except RecordingError:  # its frame says so
            continue
        if not found:
            return None
        largest = max(largest, found)
    return bit_depth(largest) if largest else None


def _content(path: Path, where: str) -> bytes:
    refuse_special(path)
    try:
        data = path.read_bytes()
    except OSError as error:
        raise RecordingError(f"{where}: cannot be read ({error.strerror or error}).") from None
    if not data:
        raise RecordingError(f"{where}: the file is empty (0 bytes).")
    return data


def hash_of_images(files: Iterable[tuple[str, Path]]) -> str:
    """Return the SHA-256 over the names and contents of images, in the order of their names.

    Of a file that cannot be read only the name counts; its frame says what is wrong.
    """
    ordered = sorted(files)
    parts = [ordered[start : start + _BATCH] for start in range(0, len(ordered), _BATCH)]
    total = hashlib.sha256()
    with ThreadPoolExecutor(_HASHING) as pool:
        for digested in pool.map(_digested, parts):
            total.update(digested)
    return total.hexdigest()


def _digested(files: list[tuple[str, Path]]) -> bytes:
    """Return the names and the hashes of some files."""
    return b"".join(name.encode(errors="surrogateescape") + b"\0" + _digest(path) for name, path in files)


def _digest(path: Path) -> bytes:
    try:
        refuse_special(path)
        with path.open("rb", buffering=0) as file:
            return hashlib.sha256(file.readall()).digest()
    except (OSError, RecordingError):
        return bytes(32)
