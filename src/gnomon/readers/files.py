"""Which files the paths of a recording mean, and files as bytes: unpacked where they are gzipped, hashed, told apart.

Format "folder": a dataset in the layout of EuRoC or Kalibr, a pair of files, or one single file.
"""

import hashlib
import io
import re
import struct
import zipfile
import zlib
from collections.abc import Sequence
from pathlib import Path
from tokenize import TokenError

from ..errors import OptionError, RecordingError
from ..frozen import value_class
from ..output import refuse_special
from ..recording import Source

try:
    from lzma import LZMAError
except ImportError:  # Python may be built without it
    LZMAError = zlib.error

ZIP_DAMAGE = (
    *(zipfile.BadZipFile, zlib.error, LZMAError, EOFError, OSError, ValueError, KeyError, TypeError, struct.error),
    *(RuntimeError, OverflowError, SyntaxError, IndexError, TokenError),
)
"""What a damaged zip, or an array in it, ends in; RuntimeError of passwords and of methods that are not known."""


def refuse_zip_bomb(archive: zipfile.ZipFile, where: str) -> None:
    """Refuse a zip by the sizes that it states; no more than those is ever unpacked.

    Raises
    ------
    RecordingError
        If it is small and stands for much.
    """
    members = archive.infolist()
    packed, unpacked = sum(one.compress_size for one in members), sum(one.file_size for one in members)
    if unpacked > largest_unpacked(packed):
        raise bomb_error(where, packed)


_GZIP = b"\x1f\x8b"
_UTF_16 = (b"\xff\xfe", b"\xfe\xff")
MAT_MAGIC = b"MATLAB 5.0 MAT-file"
NPZ_MAGIC = (b"PK\x03\x04", b"PK\x05\x06")
MUCH_BYTES, MOST_TIMES = 256 << 20, 100
"""What is packed may be unpacked to so many bytes, or to so many times its size."""
_MANY_BYTES, _LOOKS, _LOOKED_AT = 1 << 24, 16, 4096
_STILL = (b"heic", b"heix", b"mif1", b"avif")

# Files that people try and that hold no table; the name goes into the message.
_KNOWN_BINARY = {
    b"#ROSBAG": "a ROS 1 bag",
    b"\x89MCAP": "an MCAP file",
    b"SQLite format 3": "an SQLite file (perhaps a ROS 2 bag)",
    MAT_MAGIC: "a MAT file",
    b"MATLAB 7.3": "a MAT file of version 7.3 (in MATLAB, save(..., '-v7') writes one that gnomon reads)",
    b"\x89HDF": "an HDF5 file",
    b"\x93NUMPY": "a single NumPy array; put the arrays into one NPZ file with named keys",
    b"ULog": "a PX4 ULog",
    b"PAR1": "a Parquet file",
    b"%PDF": "a PDF",
    b"\x89PNG": "an image",
    b"\xff\xd8\xff": "an image",
    b"H Product:Blackbox": "a blackbox log, which Betaflight's blackbox_decode and Blackbox Explorer turn into CSV",
}


@value_class(eq=True)
class TextFile:
    """A text file in memory.

    Attributes
    ----------
    name : name without folder, for messages
    data : unpacked bytes
    source : name and hash of the file as it is on the disk
    header : names of the columns where they are known from elsewhere than a line above them, or empty
    notes : what was assumed when it became what it is
    """

    name: str
    data: bytes
    source: Source
    header: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()


def first_bytes(path: Path, count: int = 512) -> bytes:
    """Return the first bytes of a file as they are on the disk.

    Raises
    ------
    RecordingError
        If the file is not there, is a pipe or a device, cannot be opened, or is empty.
    """
    refuse_special(path)
    try:
        with path.open("rb") as file:
            head = file.read(count)
    except FileNotFoundError:
        raise RecordingError(f"{path}: there is no such file. Check the path.") from None
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read ({error.strerror or error}). Check its permissions.") from None
    if not head:
        raise RecordingError(f"{path}: the file is empty (0 bytes). Was the recording copied completely?")
    return head


def read_text_file(path: Path) -> TextFile:
    """Read a text file, gzipped or not; a MAT file as the table that it holds.

    Raises
    ------
    RecordingError
        If the file cannot be read, its gzip stream is broken, or it holds no text.
    """
    head = first_bytes(path)
    if head.startswith(MAT_MAGIC):
        from .matlab import read_mat_table

        return read_mat_table(path)
    if not head.startswith((_GZIP, *_UTF_16)):
        refuse_binary(head, path)  # before all of it is read
        _refuse_holes(path)
    try:
        packed = path.read_bytes()
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read ({error.strerror or error}).") from None
    except MemoryError:
        size = path.stat().st_size >> 20
        raise RecordingError(f"{path}: its {size} MiB do not fit into memory. Cut the recording into parts.") from None
    source = Source(name=path.name, sha256=hashlib.sha256(packed).hexdigest())
    return TextFile(name=path.name, data=plain_text(packed, path), source=source)


def _refuse_holes(path: Path) -> None:
    """Refuse a text file with stretches of zeros, as a copy that broke off leaves them, before all of it is read."""
    size = path.stat().st_size
    if size < _MANY_BYTES:
        return
    with path.open("rb") as file:
        for place in range(1, _LOOKS + 1):
            file.seek((size - _LOOKED_AT) * place // _LOOKS)
            if b"\0" in file.read(_LOOKED_AT):
                raise RecordingError(
                    f"{path}: this file begins as text, and there are zeros around byte {file.tell()} of {size}. Was "
                    "the recording copied completely?"
                )


def plain_text(packed: bytes, path: Path) -> bytes:
    """Return the bytes of a text file as UTF-8 without byte order mark, unpacked if it is gzipped.

    Raises
    ------
    RecordingError
        If its gzip stream is broken, or it holds no text; `path` is what it is called then.
    """
    data = _unpacked(packed, path) if packed.startswith(_GZIP) else packed
    if data.startswith(_UTF_16):
        data = data.decode("utf-16", errors="replace").encode()
    data = data.removeprefix(b"\xef\xbb\xbf")
    if data.isspace() or not data:
        raise RecordingError(f"{path}: the file holds no text. Was the recording copied completely?")
    refuse_binary(data, path)
    return data


def largest_unpacked(size: int) -> int:
    """Return to how many bytes something of `size` bytes may be unpacked.

    The noise of sensors does not shrink to a hundredth; what was made to fill the memory does.
    """
    return max(MUCH_BYTES, MOST_TIMES * size)


def bomb_error(where: str, size: int) -> RecordingError:
    """Return what to say of a file of `size` bytes that would be unpacked to more than `largest_unpacked`."""
    return RecordingError(
        f"{where}: its {size} bytes would be unpacked to more than {largest_unpacked(size) >> 20} MiB, as no recording "
        "of sensors is. If it is one, unpack it yourself and give what comes out."
    )


_BLOCK_BYTES = 1 << 22


def _unpacked(packed: bytes, path: Path) -> bytes:
    from isal.igzip import IGzipFile
    from isal.igzip_lib import IsalError

    broken: type[Exception] = IsalError  # pyright: ignore[reportAssignmentType]  # its stub says Exception
    blocks, size = list[bytes](), 0
    try:
        with IGzipFile(fileobj=io.BytesIO(packed)) as stream:
            while block := stream.read(_BLOCK_BYTES):  # at once it would reserve a hundred times what is needed
                blocks.append(block)
                size += len(block)
                if size > largest_unpacked(len(packed)):
                    raise bomb_error(str(path), len(packed))
        return b"".join(blocks)
    except EOFError:
        raise RecordingError(f"{path}: the gzip stream ends too early; the file is cut off. Copy it again.") from None
    except (OSError, broken) as error:
        raise RecordingError(f"{path}: the gzip stream is damaged ({error}). Copy it again.") from None


def refuse_binary(data: bytes, path: Path) -> None:
    """Stop at the first bytes of a file that is no text, and name what it is where that is known.

    Raises
    ------
    RecordingError
        If the bytes are those of a binary file.
    """
    head = data[:4096]
    for magic, name in _KNOWN_BINARY.items():
        if head.startswith(magic):
            raise RecordingError(
                f"{path}: this is {name}, not a table of numbers. Export the samples as CSV "
                "(time, acceleration, angular rate) or as NPZ."
            )
    if b"\0" in head:
        raise RecordingError(
            f"{path}: this is a binary file of a kind that gnomon does not read. Export the samples as CSV "
            "(time, acceleration, angular rate) or as NPZ."
        )


def is_mp4_head(head: bytes) -> bool:
    """Tell by its first bytes whether a file is of the family of MP4, a video that its index tells how to read."""
    return head[4:8] == b"ftyp" and head[8:12] not in _STILL


def file_source(path: Path) -> Source:
    """Return name and hash of a file without holding it in memory."""
    with path.open("rb") as file:
        return Source(name=path.name, sha256=hashlib.file_digest(file, "sha256").hexdigest())


_LAYOUTS = ("mav0/imu0/data.csv", "imu0/data.csv", "data.csv", "imu0.csv")
_SUFFIXES = (".csv", ".txt", ".log", ".dat", ".tsv", ".mat", ".npz")
_ACCELEROMETER, _GYROSCOPE = re.compile(r"acc", re.IGNORECASE), re.compile(r"gyr", re.IGNORECASE)
_MAGNETOMETER = re.compile(r"magn", re.IGNORECASE)
_CORNERS = re.compile(r"cam\d+_(corners|frames)\.csv")
_CALIBRATION = ("calibration.yaml", "noise.yaml")
_BESIDE_IT = ("diagnostics.npz", "allan.csv", "trajectory.txt", "results-cam.txt", "results-imucam.txt")
"""Files of a result that look like samples."""


def recording_files(paths: Sequence[str | Path]) -> list[Path]:
    """Return the one file, or the accelerometer and gyroscope files, that the paths of a recording mean.

    Raises
    ------
    OptionError
        If there are too few or too many paths.
    RecordingError
        If the path is a folder that does not hold one recording.
    """
    files = [Path(path) for path in paths]
    if len(files) == 1 and files[0].is_dir():
        files = list(_recording_in(files[0]))
    for path in files:
        if path.suffix in (".yaml", ".yml", ".html") or _is_of_a_result(path):
            raise RecordingError(
                f"{path}: this belongs to a calibration and is no recording. Name the recording: a table, a bag, a log "
                "or a folder with one."
            )
    if not 1 <= len(files) <= 2 or (len(files) == 2 and any(path.is_dir() for path in files)):
        raise OptionError(
            f"{len(files)} paths given. Give one file, one folder, or an accelerometer file and a gyroscope file."
        )
    return files


def _recording_in(folder: Path) -> tuple[Path, ...]:
    """Return the file, or the accelerometer and gyroscope files, that a folder holds."""
    known = known_layout(folder)
    if known is not None:
        return (known,)
    files = sample_files(folder)
    pair = accelerometer_and_gyroscope(files)
    if pair is not None:
        return pair
    magnetometer = [path for path in files if _MAGNETOMETER.search(path.name)]
    if len(files) == 2 and len(magnetometer) == 1 and any(_ACCELEROMETER.search(path.name) for path in files):
        return files[0], files[1]
    if len(files) == 1:
        return (files[0],)
    if not files and any(_CORNERS.match(path.name) for path in folder.iterdir()):
        raise RecordingError(
            f"{folder}: this folder holds corners of cameras, for gnomon camera, and no samples of an IMU."
        )
    if not files and any((folder / name).is_file() for name in _CALIBRATION):
        raise RecordingError(
            f"{folder}: this folder holds a result, and no recording. Name the recording that it was made from; "
            f"gnomon show {folder} shows the result."
        )
    if not files:
        raise RecordingError(
            f"{folder}: no recording in this folder. Expected mav0/imu0/data.csv (EuRoC), imu0.csv (Kalibr), a pair of "
            f"files with acc and gyr in their names, or one file ({', '.join(_SUFFIXES)}, also gzipped)."
        )
    raise RecordingError(several_recordings(folder, files))


def several_recordings(folder: Path, files: Sequence[Path]) -> str:
    """Return what is to be said of a folder that holds several recordings."""
    listed = ", ".join(path.name for path in files[:8]) + (", ..." if len(files) > 8 else "")
    return (
        f"{folder}: {len(files)} files may be the recording ({listed}). Name the one to read. gnomon imu and gnomon "
        "temperature take several recordings of one sensor, each of them named."
    )


def known_layout(folder: Path) -> Path | None:
    """Return the file of samples of a folder in the layout of EuRoC or Kalibr, or None."""
    paths = (path for layout in _LAYOUTS for path in (folder / layout, folder / f"{layout}.gz"))
    return next((path for path in paths if path.is_file()), None)


def sample_files(folder: Path) -> list[Path]:
    """Return the files in a folder that may hold samples, by name."""
    return sorted(path for path in folder.iterdir() if path.is_file() and _is_candidate(path))


def accelerometer_and_gyroscope(files: list[Path]) -> tuple[Path, Path] | None:
    """Return the one file with acc and the one with gyr in its name, or None."""
    accelerometer = [path for path in files if _ACCELEROMETER.search(path.name) and not _GYROSCOPE.search(path.name)]
    gyroscope = [path for path in files if _GYROSCOPE.search(path.name) and not _ACCELEROMETER.search(path.name)]
    return (accelerometer[0], gyroscope[0]) if len(accelerometer) == len(gyroscope) == 1 else None


def _is_candidate(path: Path) -> bool:
    name = path.name.lower().removesuffix(".gz")
    return name.endswith(_SUFFIXES) and not (name.startswith(".") or _CORNERS.match(name) or _is_of_a_result(path))


def _is_of_a_result(path: Path) -> bool:
    return path.name in _BESIDE_IT and any(path.with_name(name).is_file() for name in _CALIBRATION)


FEWEST_FILES = 3


def pose_files(paths: Sequence[str | Path]) -> list[Path] | None:
    """Return the files of poses, three or more paths or those in a folder; None where the paths mean something else.

    Files in a folder come in the order of their names, numbers in them counting as numbers: pose2 before pose10.
    """
    files = [Path(path) for path in paths]
    if len(files) == 1 and files[0].is_dir() and known_layout(files[0]) is None:
        found = sample_files(files[0])
        if any(".npz" in path.suffixes for path in found):
            return None
        if len(found) >= FEWEST_FILES and accelerometer_and_gyroscope(found) is None:
            return sorted(found, key=_by_number)
    return files if len(files) >= FEWEST_FILES else None


def _by_number(path: Path) -> list[tuple[int, str]]:
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in re.split(r"(\d+)", path.name.lower())]
