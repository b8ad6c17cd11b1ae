"""A recording of images and IMU samples -> a bag: ROS 1, or ROS 2 in SQLite or MCAP.

ros1    one file, version 2.0
ros2    a folder with metadata.yaml and an SQLite file
mcap    a folder with metadata.yaml and an MCAP file; the MCAP file alone where the name ends with .mcap

ROS 2 bags have metadata of version 8. Images are mono8 and not compressed, so that they read back as they were. An
accelerometer and a gyroscope with timestamps of their own become two topics, .../accel and .../gyro; as sensor_msgs/Imu
has it, -1 as the first number of a covariance says which triad is not there.
"""

import heapq
import shutil
import sqlite3
from collections.abc import Callable, Generator, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np

from ..errors import OutputError, RecordingError
from ..frozen import value_class
from ..output import files_together
from ..progress import Progress, Step
from ..recording import Floats, ImuSamples, Integers, TriadSamples
from ..recording.recording import Arrivals, Frame, Grey, ImageRecording, ImageStream
from ..units import ACCELEROMETER_UNITS_M_S2, GYROSCOPE_UNITS_RAD_S

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore

Form = Literal["ros1", "ros2", "mcap"]
_IMAGE, _IMU = "sensor_msgs/msg/Image", "sensor_msgs/msg/Imu"
_METADATA_VERSION = 8
_TOLD_EVERY = 100  # images
_LATEST_NS = 2**31 * 1_000_000_000  # seconds are 32 bits with a sign
_SECOND_NS = 1_000_000_000


def save_bag(
    recording: ImageRecording,
    path: str | PathLike[str],
    form: Form,
    progress: Progress | None = None,
    notes: list[str] | None = None,
) -> None:
    """Write a recording as a bag; what stands at `path` is only replaced when the bag is complete.

    Parameters
    ----------
    recording : its images are read one after the other; memory does not grow with their number
    path : file, or folder of a ROS 2 bag
    form : "ros1", "ros2" (SQLite) or "mcap"
    progress : called with a sentence now and then
    notes : where sentences on images that could not be read are appended; without it such an image is an error

    Raises
    ------
    OutputError
        If it cannot be written, or a timestamp does not fit the format.
    RecordingError
        If an image cannot be read.
    """
    target = Path(path)
    tell = progress or (lambda _: None)
    single = form == "ros1" or (form == "mcap" and target.suffix == ".mcap")
    _check_target(target, form, single=single)
    try:
        with files_together(target.absolute().parent) as staging:
            making = staging / ".making"
            making.mkdir()
            made = making / (target.stem if single else target.name)  # the writers name their files by this
            with _opened(made, form) as bag:
                _write(recording, bag, form, tell, notes)
            (made / f"{made.name}.mcap" if single and form == "mcap" else made).replace(staging / target.name)
            shutil.rmtree(making)
    except (OSError, sqlite3.Error) as error:
        reason = getattr(error, "strerror", None) or error
        raise OutputError(
            f"{path}: cannot be written ({reason}). Choose another place with -o, or make room there."
        ) from error


def _check_target(target: Path, form: Form, *, single: bool) -> None:
    if single and target.is_dir():
        raise OutputError(f"{target}: this is a folder. Give the name of a file in it.")
    if not single and target.is_file():
        raise OutputError(f"{target}: a ROS 2 bag is a folder, and there is a file of this name. Choose another name.")
    if not single and target.is_dir() and any(target.iterdir()) and not (target / "metadata.yaml").is_file():
        raise OutputError(f"{target}: there are other files in this folder. Choose a new name for the bag.")
    if form == "ros2" and target.suffix in {".db3", ".mcap"}:
        raise OutputError(f"{target}: a ROS 2 bag is a folder. Give a name without {target.suffix}.")


class _Bag(NamedTuple):
    """An open writer, and what turns a message into bytes."""

    writer: Any
    store: "Typestore"
    pack: Callable[[Any, str], Any]


@contextmanager
def _opened(path: Path, form: Form) -> Generator[_Bag]:
    from rosbags.typesys import Stores, get_typestore

    if form == "ros1":
        from rosbags.rosbag1 import Writer as Writer1

        store = get_typestore(Stores.ROS1_NOETIC)
        with Writer1(path) as writer:
            yield _Bag(writer, store, store.serialize_ros1)
        return
    from rosbags.rosbag2 import StoragePlugin
    from rosbags.rosbag2 import Writer as Writer2

    store = get_typestore(Stores.ROS2_HUMBLE)
    plugin = StoragePlugin.MCAP if form == "mcap" else StoragePlugin.SQLITE3
    with Writer2(path, version=_METADATA_VERSION, storage_plugin=plugin) as writer:
        yield _Bag(writer, store, store.serialize_cdr)


@value_class
class _Item:
    """One message: when it was received, its connection, and what makes its bytes when it is its turn."""

    received_ns: int
    link: Any
    message: Callable[[], Any]
    kind: str


def _write(recording: ImageRecording, bag: _Bag, form: Form, tell: Progress, notes: list[str] | None) -> None:
    messages, used = _Messages(bag.store, form), set[str]()
    lines: list[Iterator[_Item]] = []

    def link_of(topic: str, otherwise: str, kind: str) -> Any:
        name = otherwise if topic in used or not topic else topic
        used.add(name)
        return bag.writer.add_connection(name, kind, typestore=bag.store)

    for name, samples in recording.imus.items():
        for topic, triads in _imu_topics(name, samples):
            link = link_of(topic, f"/{name}{topic.removeprefix(samples.topic)}", _IMU)
            lines.append(_imu_items(messages, link, name, triads, recording.imu_arrivals.get(name)))
    total = sum(stream.count for stream in recording.streams.values())
    counter = _Counter(tell, total)
    for name, stream in recording.streams.items():
        link = link_of(stream.topic.removesuffix("/compressed"), f"/{name}/image_raw", _IMAGE)
        lines.append(_image_items(messages, link, name, stream, notes))
    for item in heapq.merge(*lines, key=lambda item: item.received_ns):
        try:
            message = item.message()
        except RecordingError as error:
            if notes is None:
                raise
            notes.append(f"{error} This image was left out.")
            continue
        bag.writer.write(item.link, item.received_ns, bag.pack(message, item.kind))
        if item.kind == _IMAGE:
            counter.count()


@dataclass(slots=True)
class _Counter:
    """Says how many images were written."""

    tell: Progress
    total: int
    done: int = 0

    def count(self) -> None:
        self.done += 1
        if self.done % _TOLD_EVERY == 0:
            self.tell(Step("writing images", self.done, self.total))


def _receipts(arrivals: Arrivals | None) -> Callable[[int], int]:
    """Return what maps a timestamp to its time of receipt; where that is not known or does not fit, to itself."""
    if arrivals is None:
        return lambda t_ns: t_ns
    pairs = zip(arrivals.t_ns.tolist(), arrivals.received_ns.tolist(), strict=True)
    known = {t_ns: received for t_ns, received in pairs if 0 <= received < _LATEST_NS}
    return lambda t_ns: known.get(t_ns, t_ns)


def _image_items(
    messages: "_Messages", link: Any, name: str, stream: ImageStream, notes: list[str] | None
) -> Iterator[_Item]:
    received = _receipts(stream.arrivals)
    for frame in stream.frames([] if notes is None else notes):
        _check_stamp(frame.t_ns, name)

        def message(frame: Frame = frame) -> Any:
            return messages.image(frame.t_ns, name, frame.decode())

        yield _Item(received_ns=received(frame.t_ns), link=link, message=message, kind=_IMAGE)


def _check_stamp(t_ns: int, name: str) -> None:
    """Refuse a timestamp that the format cannot hold."""
    if not 0 <= t_ns < _LATEST_NS:
        raise OutputError(
            f"{name}: a timestamp of {t_ns} ns cannot be written; bags hold times from 1970 to 2038. Write the "
            "recording as an EuRoC folder instead."
        )


class _Triads(NamedTuple):
    """Samples that go into one topic: timestamps, and one triad or both."""

    t_ns: Integers
    accelerometer: Floats | None
    gyroscope: Floats | None


def _imu_topics(name: str, samples: ImuSamples) -> Iterator[tuple[str, _Triads]]:
    topic = samples.topic or f"/{name}"
    accelerometer = _si(samples.accelerometer, ACCELEROMETER_UNITS_M_S2, name)
    gyroscope = _si(samples.gyroscope, GYROSCOPE_UNITS_RAD_S, name)
    t_accelerometer, t_gyroscope = samples.accelerometer.t_ns, samples.gyroscope.t_ns
    if np.array_equal(t_accelerometer, t_gyroscope):
        yield topic, _Triads(t_gyroscope, accelerometer, gyroscope)
        return
    both = len(t_accelerometer) > 0 and len(t_gyroscope) > 0
    if len(t_accelerometer):
        yield f"{topic}/accel" if both else topic, _Triads(t_accelerometer, accelerometer, None)
    if len(t_gyroscope):
        yield f"{topic}/gyro" if both else topic, _Triads(t_gyroscope, None, gyroscope)


def _si(samples: TriadSamples, table: dict[str, float | None], name: str) -> Floats:
    factor = table[samples.unit]
    if factor is None:
        raise OutputError(
            f"{name}: its samples are raw counts; sensor_msgs/Imu holds m/s^2 and rad/s. Convert them first with a "
            "calibration (gnomon apply)."
        )
    return samples.values if factor == 1 else samples.values * factor


def _imu_items(
    messages: "_Messages", link: Any, name: str, triads: _Triads, arrivals: Arrivals | None
) -> Iterator[_Item]:
    received = _receipts(arrivals)
    for i, t_ns in enumerate(triads.t_ns.tolist()):
        _check_stamp(t_ns, name)

        def message(i: int = i, t_ns: int = t_ns) -> Any:
            accelerometer = None if triads.accelerometer is None else triads.accelerometer[i]
            gyroscope = None if triads.gyroscope is None else triads.gyroscope[i]
            return messages.imu(t_ns, name, accelerometer, gyroscope)

        yield _Item(received_ns=received(t_ns), link=link, message=message, kind=_IMU)


class _Messages:
    """Makes message objects."""

    def __init__(self, store: "Typestore", form: Form) -> None:
        self.types = store.types
        self.counter = {"seq": 0} if form == "ros1" else {}
        self.unknown, self.missing = np.zeros(9), np.zeros(9)
        self.missing[0] = -1.0  # "there is no such estimate"
        vector, quaternion = (self.types[f"geometry_msgs/msg/{name}"] for name in ("Vector3", "Quaternion"))
        self.vector, self.zero = vector, vector(x=0.0, y=0.0, z=0.0)
        self.attitude = quaternion(x=0.0, y=0.0, z=0.0, w=1.0)

    def _header(self, t_ns: int, frame_id: str) -> Any:
        stamp = self.types["builtin_interfaces/msg/Time"](sec=t_ns // _SECOND_NS, nanosec=t_ns % _SECOND_NS)
        return self.types["std_msgs/msg/Header"](stamp=stamp, frame_id=frame_id, **self.counter)

    def image(self, t_ns: int, name: str, grey: Grey) -> Any:
        """Return the message of an image (height, width) that was taken at t_ns."""
        height, width = grey.shape
        return self.types[_IMAGE](
            header=self._header(t_ns, name),
            height=height,
            width=width,
            encoding="mono8",
            is_bigendian=0,
            step=width,
            data=np.ascontiguousarray(grey).ravel(),
        )

    def imu(self, t_ns: int, name: str, accelerometer: Floats | None, gyroscope: Floats | None) -> Any:
        """Return the message of a sample: specific force (3,) [m/s^2], angular rate (3,) [rad/s]; None if not there."""
        return self.types[_IMU](
            header=self._header(t_ns, name),
            orientation=self.attitude,
            orientation_covariance=self.missing,
            angular_velocity=self._triad(gyroscope),
            angular_velocity_covariance=self.missing if gyroscope is None else self.unknown,
            linear_acceleration=self._triad(accelerometer),
            linear_acceleration_covariance=self.missing if accelerometer is None else self.unknown,
        )

    def _triad(self, values: Floats | None) -> Any:
        if values is None:
            return self.zero
        x, y, z = values.tolist()
        return self.vector(x=x, y=y, z=z)
