"""Small bags, written with rosbags alone, so that the reader is held against another hand than gnomon's writer."""

from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore

T0 = 1_403_636_579_758_555_392
FORMS = ("ros1", "ros2", "mcap")
NAMES = {"ros1": "rec.bag", "ros2": "rec", "mcap": "rec_mcap"}


@dataclass
class Message:
    """One message: its topic, its type's short name, its header timestamp, when it was received, and its fields."""

    topic: str
    kind: str
    t_ns: int
    fields: dict[str, Any] = field(default_factory=dict)
    received_ns: int | None = None


def image(topic, t_ns, pixels, encoding="mono8", *, step=None, big=0, size=None, received_ns=None) -> Message:
    pixels = np.ascontiguousarray(pixels)
    height, width = size or pixels.shape[:2]
    data = pixels.view(np.uint8).ravel()
    fields = {"height": height, "width": width, "encoding": encoding, "is_bigendian": big, "data": data}
    fields["step"] = data.size // height if step is None else step
    return Message(topic, "Image", t_ns, fields, received_ns)


def compressed(topic, t_ns, data, form="jpeg", received_ns=None) -> Message:
    return Message(topic, "CompressedImage", t_ns, {"format": form, "data": np.frombuffer(data, np.uint8)}, received_ns)


def imu(topic, t_ns, gyro=(0.1, 0.2, 0.3), accel=(0.0, 0.1, 9.8), *, missing=(), frame_id="imu", received_ns=None):
    return Message(
        topic, "Imu", t_ns, {"gyro": gyro, "accel": accel, "missing": missing, "frame_id": frame_id}, received_ns
    )


def other(topic, t_ns, degc=20.0) -> Message:
    return Message(topic, "Temperature", t_ns, {"temperature": degc, "variance": 0.0})


def _object(types, message, form):
    stamp = types["builtin_interfaces/msg/Time"](sec=message.t_ns // 10**9, nanosec=message.t_ns % 10**9)
    fields = dict(message.fields)
    more = {"seq": 7} if form == "ros1" else {}
    header = types["std_msgs/msg/Header"](stamp=stamp, frame_id=fields.pop("frame_id", "cam"), **more)
    if message.kind == "Imu":
        vector, quaternion = types["geometry_msgs/msg/Vector3"], types["geometry_msgs/msg/Quaternion"]
        marks = {name: np.zeros(9) for name in ("gyro", "accel")}
        for name in fields["missing"]:
            marks[name][0] = -1
        fields = {
            "orientation": quaternion(x=0.0, y=0.0, z=0.0, w=1.0),
            "orientation_covariance": np.full(9, 3.0),
            "angular_velocity": vector(*map(float, fields["gyro"])),
            "angular_velocity_covariance": marks["gyro"],
            "linear_acceleration": vector(*map(float, fields["accel"])),
            "linear_acceleration_covariance": marks["accel"],
        }
    return types[f"sensor_msgs/msg/{message.kind}"](header=header, **fields)


@contextmanager
def _writer(path, form, compression):
    if form == "ros1":
        writer = Writer1(path)
    else:
        writer = Writer2(
            path, version=9, storage_plugin=StoragePlugin.MCAP if form == "mcap" else StoragePlugin.SQLITE3
        )
    if compression is not None:
        writer.set_compression(*compression)
    with writer:
        yield writer


_store = cache(get_typestore)


def make_bag(folder: Path, form: str, messages: list[Message], *, name="", compression=None) -> Path:
    """Write messages in their order and return the path of the bag."""
    path = folder / (name or NAMES[form])
    store = _store(Stores.ROS1_NOETIC if form == "ros1" else Stores.ROS2_JAZZY)
    pack = store.serialize_ros1 if form == "ros1" else store.serialize_cdr
    with _writer(path, form, compression) as writer:
        links = {}
        for message in messages:
            kind = f"sensor_msgs/msg/{message.kind}"
            if message.topic not in links:
                links[message.topic] = writer.add_connection(message.topic, kind, typestore=store)
            received = message.t_ns + 2_000_000 if message.received_ns is None else message.received_ns
            writer.write(links[message.topic], received, pack(_object(store.types, message, form), kind))
    return path


def picture(seed=0, shape=(12, 16)) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 256, shape, dtype=np.uint8)


def usual(*, images=3, samples=40, cameras=("/cam0/image_raw",), imus=("/imu0",)) -> list[Message]:
    """Make a recording of images at 20 Hz and samples at 200 Hz, in the order of receipt."""
    made = [
        image(topic, T0 + i * 50_000_000, picture(10 * c + i)) for c, topic in enumerate(cameras) for i in range(images)
    ]
    rng = np.random.default_rng(5)
    for topic in imus:
        made += [imu(topic, T0 + i * 5_000_000, rng.normal(size=3), rng.normal(size=3) + 5) for i in range(samples)]
    return sorted(made, key=lambda message: message.t_ns)
