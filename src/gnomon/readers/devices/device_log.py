"""What a device logged with its own app or firmware: triads with timestamps of their own, and what was assumed.

The IMU of a ROS bag without its cameras is one as well: `sensor_msgs/Imu`, of several the first, as `camera-imu` would
read it.
"""

from collections.abc import Callable, Sequence
from pathlib import Path

from ...errors import OptionError, RecordingError
from ...frozen import value_class
from ...recording import Integers, Source, TemperatureSamples, TriadSamples
from ..files import first_bytes
from ..samples.table import Triad

_MAGIC = (b"#ROSBAG", b"\x89MCAP", b"SQLite format 3")

StampedTriad = tuple[Integers, Triad]


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
    from .ardupilot_log import is_dataflash, read_dataflash
    from .gpmf import is_gpmf, read_gpmf
    from .phone_log import is_phone_log, read_phone_log
    from .px4_ulog import is_ulog, read_ulog
    from .stated_log import is_stated_log, read_stated_log
    from .tagged_log import is_tagged_log, read_tagged_log

    if len(paths) != 1:
        return None
    path = Path(paths[0])
    readers = (
        (is_gpmf, read_gpmf),
        (is_ulog, read_ulog),
        (is_dataflash, read_dataflash),
        (is_imu_bag, read_imu_bag),
        (is_phone_log, read_phone_log),
        (is_stated_log, read_stated_log),
        (is_tagged_log, read_tagged_log),
    )
    return next((reader for is_such, reader in readers if is_such(path)), None)


def is_imu_bag(path: Path) -> bool:
    """Tell whether a path is a ROS 1 bag, an MCAP file, an SQLite file of ROS 2, or the folder of a ROS 2 bag."""
    if path.is_dir():
        return (path / "metadata.yaml").is_file() and (any(path.glob("*.db3*")) or any(path.glob("*.mcap*")))
    return path.is_file() and path.stat().st_size > 0 and first_bytes(path, 16).startswith(_MAGIC)


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
