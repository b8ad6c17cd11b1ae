"""What a device logged with its own app or firmware: by which first bytes or names each kind is recognised.

Every kind has a reader of its own, which returns triads with timestamps of their own, and what was assumed. The IMU of
a ROS bag without its cameras is one as well: `sensor_msgs/Imu`, of several the first, as `camera-imu` would read it.
Apps on phones export tables, into a folder or a zip, which is read without unpacking it.
"""

import re
import zipfile
from collections.abc import Callable, Generator, Sequence
from contextlib import contextmanager
from pathlib import Path, PurePosixPath
from typing import IO

from ...errors import OptionError, RecordingError
from ...formats.shared.structured import shorten_text
from ...frozen import value_class
from ...recording import Integers, Source, TemperatureSamples, TriadSamples
from ..files import (
    NPZ_MAGIC,
    ZIP_DAMAGE,
    TextFile,
    file_source,
    is_mp4_head,
    plain_text,
    read_text_file,
    refuse_zip_bomb,
)
from ..samples.column_names import column_name
from ..samples.table import Triad
from ..samples.text_table import is_number

StampedTriad = tuple[Integers, Triad]

HEAD_BYTES = 65_536
"""Bytes at the beginning of a file by which it is recognised."""


@value_class
class DeviceLog:
    """The IMU of one recording of a camera or a phone; the triads share a clock.

    Attributes
    ----------
    accelerometer, gyroscope, magnetometer : timestamps and samples, or None
    temperature : of the IMU's thermometer, or None
    sources : the files that were read
    notes : what was assumed
    """

    accelerometer: StampedTriad | None = None
    gyroscope: StampedTriad | None = None
    magnetometer: StampedTriad | None = None
    temperature: TemperatureSamples | None = None
    sources: tuple[Source, ...]
    notes: tuple[str, ...]


def is_device_log(paths: Sequence[str | Path]) -> bool:
    """Tell whether paths are what a camera or a phone logged: one path that holds a whole recording."""
    return _reader(paths) is not None


def read_device_log(
    paths: Sequence[str | Path], columns: str | None = None, rate_hz: float | None = None
) -> DeviceLog | None:
    """Read what a camera or a phone logged; None where the paths are something else.

    Raises
    ------
    RecordingError
        If it is such a log, and cannot be read or understood.
    OptionError
        If columns or a rate are stated: such a log says itself what it holds.
    """
    reader = _reader(paths)
    if reader is None:
        return None
    path = Path(paths[0])
    for option, value in (("columns", columns), ("rate", rate_hz)):
        if value is not None:
            raise OptionError(f"{path.name}: this log names its columns and has timestamps. Leave out --{option}.")
    try:
        return reader(path)
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read ({error.strerror or error}). Check its permissions.") from None


def _reader(paths: Sequence[str | Path]) -> Callable[[Path], DeviceLog] | None:
    """Return what reads the one path of a log; None where the paths are something else."""
    if len(paths) != 1:
        return None
    path = Path(paths[0])
    head = file_head(path)
    if head.startswith(GPMF_MAGIC) or is_mp4_head(head):
        from .gpmf import read_gpmf as read
    elif head.startswith(ULOG_MAGIC):
        from .autopilots import read_ulog as read
    elif head.startswith(DATAFLASH_MAGIC) or head.lstrip().startswith(_DATAFLASH_TEXT):
        from .autopilots import read_dataflash as read
    elif is_imu_bag(path):
        read = read_imu_bag
    elif is_phone_log(path):
        from .phones import read_phone_log as read
    elif stated_kind(head):
        from .text_logs import read_stated_log as read
    elif _is_tagged(path, head):
        from .text_logs import read_tagged_log as read
    else:
        return None
    return read


def file_head(path: Path, count: int = HEAD_BYTES) -> bytes:
    """Return the first bytes of a file; none where there is no file, or it cannot be read."""
    try:
        if not path.is_file():
            return b""
        with path.open("rb") as file:
            return file.read(count)
    except OSError:
        return b""


# ---- binary logs ----

GPMF_MAGIC = b"DEVC"
ULOG_MAGIC = b"ULog\x01\x12\x35"
DATAFLASH_MAGIC = b"\xa3\x95\x80"
_DATAFLASH_TEXT = (b"FMT, 128,", b"FMT,128,")
_BAG_MAGIC = (b"#ROSBAG", b"\x89MCAP", b"SQLite format 3")


def is_imu_bag(path: Path) -> bool:
    """Tell whether a path is a ROS 1 bag, an MCAP file, an SQLite file of ROS 2, or the folder of a ROS 2 bag."""
    if path.is_dir():
        return (path / "metadata.yaml").is_file() and (any(path.glob("*.db3*")) or any(path.glob("*.mcap*")))
    return file_head(path, 16).startswith(_BAG_MAGIC)


def read_imu_bag(path: Path) -> DeviceLog:
    """Read the samples of a bag's first IMU.

    Raises
    ------
    RecordingError
        If the bag cannot be read, or no topic is clearly the IMU.
    """
    from ..bags.bag import open_bag  # rosbags takes its time

    recording = open_bag(path, with_cameras=False)
    if not recording.imus:
        raise RecordingError(f"{path.name}: no topic holds samples of an IMU (sensor_msgs/Imu).")
    samples = recording.imus[min(recording.imus)]
    return DeviceLog(
        accelerometer=_stamped(samples.accelerometer, "accelerometer"),
        gyroscope=_stamped(samples.gyroscope, "gyroscope"),
        magnetometer=None,
        temperature=samples.temperature,
        sources=recording.sources,
        notes=recording.assumptions,
    )


def _stamped(samples: TriadSamples, quantity: str) -> StampedTriad | None:
    triad = Triad(quantity=quantity, values=samples.values, unit=samples.unit)
    return (samples.t_ns, triad) if len(samples) else None


# ---- tables that say above them, or by their name, what their numbers mean ----

GYROFLOW_SCALE = re.compile(rb"^([tgam]scale),([-+.\deE]+)\s*$", re.MULTILINE)
RAWIMU = re.compile(
    rb"[#%](RAWIMUS?X?A,[^;\n]*;(?:[0-9a-fA-F]+,\d+,)?(\d{1,5}),(\d{1,6})\.(\d{1,9}),[0-9a-fA-F]+"
    + rb",(-?\d{1,10})" * 6
    + rb")\*([0-9a-fA-F]{8})"
)
_GYROFLOW = re.compile(rb"(?:GYROFLOW|CAMERA) IMU LOG\s")
_E4 = re.compile(rb"(\d{9,10}(?:\.0*)?), *\1, *\1\s*\n(\d{1,3}(?:\.0*)?), *\2, *\2\s*\n(?:-?\d{1,3}, *){2}-?\d{1,3}\s")


def stated_kind(head: bytes) -> str:
    """Return "gyroflow", "e4" (Empatica's) or "rawimu" (NovAtel's) for a table, by its first lines; "" for others."""
    if _GYROFLOW.match(head) and GYROFLOW_SCALE.search(head):
        return "gyroflow"
    return "e4" if _E4.match(head) else "rawimu" if RAWIMU.search(head) else ""


# ---- tables in which each row says which sensor it is of ----

_DELIMITERS = ",;\t"
_INERTIAL = {"accelerometer", "gyroscope"}
_TRIADS = {*_INERTIAL, "magnetometer"}


@value_class
class SensorTags:
    """Which column says the sensor, and of each sensor what stands there."""

    delimiter: str
    column: int
    words: dict[str, str]


def _is_tagged(path: Path, head: bytes) -> bool:
    """Tell whether a column of a text table names accelerometer and gyroscope in turn."""
    if b"\0" in head:
        return False
    if len(head) == HEAD_BYTES:  # rs-convert writes one sensor after the other
        with path.open("rb") as stream:
            stream.seek(max(HEAD_BYTES, path.stat().st_size - HEAD_BYTES))
            head = b"\n".join([head.rpartition(b"\n")[0], stream.read().partition(b"\n")[2]])
    return sensor_tags(head.decode("utf-8", errors="replace").splitlines()) is not None


def sensor_tags(lines: list[str]) -> SensorTags | None:
    """Return where rows say their sensor; of two kinds of rows of a sensor, the one that is not calibrated."""
    delimiter = max(_DELIMITERS, key=lambda mark: sum(line.count(mark) for line in lines[:200]))
    rows = [line.split(delimiter) for line in lines if line[:1] != "#"]
    rows = [row for row in rows if is_number(row[-1])]
    for column in range(max(map(len, rows), default=0) - 3):
        told = {row[column].strip(): None for row in rows if len(row) > column + 3 and row[column][:1].isalpha()}
        words: dict[str, str] = {}
        for word in told:
            quantity = column_name(f"{word} x").quantity
            if len(word) > 1 and quantity in _TRIADS and (quantity not in words or word.lower().startswith("uncal")):
                words[quantity] = word
        if words.keys() >= _INERTIAL:
            return SensorTags(delimiter=delimiter, column=column, words=words)
    return None


# ---- the tables of a phone's app ----

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
    packed : whether the path is a zip
    """

    path: Path
    names: tuple[str, ...]
    packed: bool = False

    def named(self, *words: str) -> str | None:
        """Return the first table that is called like one of the words, which are in lower case, without suffix.

        Raises
        ------
        RecordingError
            If several are called so, in different folders.
        """
        for word in words:
            found = [name for name in self.names if _table_stem(name) == word]
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
        if not self.packed:
            return read_text_file(self._place(name))
        with self._opened(name) as data:
            packed = data.read()
        label = PurePosixPath(name).name
        text = plain_text(packed, Path(f"{self.path.name}, {label}"))
        return TextFile(name=label, data=text, source=self.sources([name])[0])

    def sources(self, names: list[str]) -> tuple[Source, ...]:
        """Return what stands for the tables that were read: the zip, or the tables themselves."""
        if self.packed:
            return (file_source(self.path),)
        return tuple(file_source(self._place(name)) for name in names)

    def _place(self, name: str) -> Path:
        return self.path / name if self.path.is_dir() else self.path

    @contextmanager
    def _opened(self, name: str) -> Generator[IO[bytes]]:
        if not self.packed:
            with self._place(name).open("rb") as file:
                yield file
            return
        with _zip_errors(self.path, name), zipfile.ZipFile(self.path) as archive, archive.open(name) as member:
            yield member


def log_files(path: Path) -> LogFiles | None:
    """Return the tables in a folder or a zip, or a table alone; None where there are none, or the zip is an NPZ file.

    Raises
    ------
    RecordingError
        If a zip is damaged, or holds files of which none is a table.
    """
    packed = file_head(path, 4).startswith(NPZ_MAGIC)
    if path.is_dir():
        folders = [path, *(path / name for name in _INNER if (path / name).is_dir())]
        inside = [entry for folder in folders for entry in sorted(folder.iterdir()) if _is_table(entry.name)]
        names = [entry.relative_to(path).as_posix() for entry in inside if entry.is_file()]
    elif packed:
        names = _names_in_zip(path)
    else:
        names = [path.name] if path.is_file() else []
    tables = tuple(name for name in names if _is_table(name))
    return LogFiles(path=path, names=tables, packed=packed) if tables else None


def _names_in_zip(path: Path) -> list[str]:
    """Return what is in a zip of tables; nothing of an NPZ file."""
    with _zip_errors(path), zipfile.ZipFile(path) as archive:
        members = archive.infolist()
        if len(members) > _MOST_MEMBERS:
            raise RecordingError(f"{path.name}: {len(members)} files in one zip; the log of a phone has a few.")
        refuse_zip_bomb(archive, path.name)
        names = [member.filename for member in members if not member.is_dir()]
    if any(name.endswith(".npy") for name in names):
        return []
    if names and not any(map(_is_table, names)):
        what = f"holds no table ({', '.join(names[:4])})"
        if any(name.startswith("xl/") for name in names):
            what = "this is a workbook of a spreadsheet program"
        raise RecordingError(f"{path.name}: {what}. Export the recording as CSV.")
    return names


@contextmanager
def _zip_errors(path: Path, name: str = "") -> Generator[None]:
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


def _table_stem(name: str) -> str:
    """Return what a table is called, in lower case, without folder and suffix."""
    return PurePosixPath(name).stem.lower()


def _is_table(name: str) -> bool:
    hidden = any(part.startswith((".", "__MACOSX")) and part != ".." for part in PurePosixPath(name).parts)
    return name.lower().endswith(_TABLES) and not hidden


SENSOR_LOGGER_NAMES = {
    "accelerometer": ("accelerometeruncalibrated", "totalacceleration"),
    "gyroscope": ("gyroscopeuncalibrated", "gyroscope"),
    "magnetometer": ("magnetometeruncalibrated", "magnetometer"),
}
"""What Sensor Logger calls its tables, the rawest first."""
_SENSOR_LOGGER_COLUMN = "seconds_elapsed"
_PHYPHOX_TIME = re.compile(r'^"?Time \(s\)"?[,;\t]')
_PHYPHOX_SENSOR = re.compile(
    r'[,;\t]"?(?:linear acceleration|acceleration|gyroscope|magnetic field) x \(', re.IGNORECASE
)
_PHYPHOX_LINEAR = re.compile(r'^"?Time \(s\)"?[,;\t]"?Linear Acceleration x ', re.IGNORECASE)
_PHYPHOX_ACCELERATION = re.compile(r'[,;\t]"?acceleration x \(', re.IGNORECASE)


def is_phone_log(path: Path) -> bool:
    """Tell whether a folder, a zip or a table is what one of the apps wrote; every zip of tables is taken for one."""
    try:
        files = log_files(path)
    except RecordingError:  # opening it says what is wrong
        return path.suffix.lower() != ".npz"
    except OSError:
        return False
    return files is not None and (files.packed or is_sensor_logger(files) or is_phyphox(files))


def is_sensor_logger(files: LogFiles) -> bool:
    """Tell whether tables are those of Sensor Logger: their columns are time, seconds_elapsed, ..."""
    known = {word for words in SENSOR_LOGGER_NAMES.values() for word in words} | {"accelerometer", "gravity"}
    tables = [name for name in files.names if _table_stem(name) in known]
    return any(_SENSOR_LOGGER_COLUMN in files.head(name).split("\n", 1)[0] for name in tables)


def phyphox_tables(files: LogFiles) -> tuple[list[str], list[str]]:
    """Return the tables of phyphox, and those of an acceleration without gravity, apart.

    The first column is called Time (s), another names a sensor.
    """
    heads = {name: files.head(name) for name in files.names}
    tables = [name for name, head in heads.items() if _PHYPHOX_TIME.match(head) and _PHYPHOX_SENSOR.search(head)]
    linear = [name for name in tables if _PHYPHOX_LINEAR.match(heads[name])]
    return [name for name in tables if name not in linear], linear


def is_phyphox(files: LogFiles) -> bool:
    """Tell whether tables are those of phyphox, and not what is read as it stands."""
    tables, linear = phyphox_tables(files)
    if files.packed or not (tables or linear):
        return bool(tables or linear)
    accelerometers = [name for name in tables if _PHYPHOX_ACCELERATION.search(files.head(name))]
    # A table with gravity needs no reader of its own, and several of them are poses.
    return len(accelerometers) <= 1 and (files.path.is_dir() or len(linear) == 1)
