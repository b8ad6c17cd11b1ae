"""The IMU of a ROS bag without its cameras: `sensor_msgs/Imu`, of several the first, as `camera-imu` would read it."""

from pathlib import Path

from ...errors import RecordingError
from ...recording import TriadSamples
from ..files import first_bytes
from ..samples.table import Triad
from .device_log import DeviceLog, StampedTriad

_MAGIC = (b"#ROSBAG", b"\x89MCAP", b"SQLite format 3")


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
