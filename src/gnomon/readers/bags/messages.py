"""Messages of a bag as bytes -> timestamps, images, and samples of an IMU.

sensor_msgs/Image, CompressedImage and Imu are the same in all versions of ROS. Their bytes are read at their places:
a message object for every sample would take most of the time of reading a bag.

Chunks and messages of bags, unpacked up to a bound: a kilobyte may stand for gigabytes.
"""

import bz2
import struct
import sys
from collections.abc import Callable, Sequence
from functools import cache
from importlib import import_module
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from ...errors import RecordingError
from ...frozen import value_class
from ...recording import Floats, Integers
from ..files import largest_unpacked
from ..images.image_pixels import RawImage


class TooLargeError(Exception):
    """What is packed would become absurdly large."""


def unpack_bytes(name: str, data: bytes) -> bytes:
    """Return what was packed with "bz2", "lz4" or "zstd".

    Raises
    ------
    TooLargeError
        If it would be more than `largest_unpacked`.
    Exception
        Of the library, if it is damaged.
    """
    most, made = largest_unpacked(len(data)), b""
    while data:
        one = _decompressor(name)
        piece = one.decompress(data, most + 1 - len(made))
        made = made + piece if made else piece
        if len(made) > most:
            raise TooLargeError(f"{len(data)} bytes would be unpacked to more than {most >> 20} MiB")
        if not one.eof:
            raise EOFError("what is packed ends too early")
        data = one.unused_data
    return made


def _decompressor(name: str) -> Any:
    if name == "bz2":
        return bz2.BZ2Decompressor()
    if name == "lz4":
        from lz4.frame import LZ4FrameDecompressor

        return LZ4FrameDecompressor()
    if sys.version_info >= (3, 14):
        from compression import zstd
    else:
        from backports import zstd  # comes with rosbags
    return zstd.ZstdDecompressor()


@cache
def bound_rosbags() -> None:
    """Put these functions in the place of those of rosbags, which unpack without a bound."""
    places = (
        ("rosbags.rosbag1.reader", "decompressors", lambda name: lambda data: unpack_bytes(name, data)),
        ("rosbags.rosbag2.storage_mcap", "DECOMPRESSORS", lambda name: lambda data, _: unpack_bytes(name, data)),
    )
    for module, table, made in places:
        known: dict[str, Callable[..., bytes]] = getattr(import_module(module), table, {})
        known.update({name: made(name) for name in known if name in {"bz2", "lz4", "zstd"}})


Wire = Literal["ros1", "cdr"]
"""How a message is laid out: by ROS 1, or as CDR by ROS 2."""

IMAGE, COMPRESSED_IMAGE, IMU = "sensor_msgs/Image", "sensor_msgs/CompressedImage", "sensor_msgs/Imu"
TEMPERATURE = "sensor_msgs/Temperature"

# Both layouts begin with four bytes (ROS 1: a counter, CDR: what kind of CDR it is), then seconds, nanoseconds, and the
# length and characters of frame_id.
_STAMP, _TEXT = 4, 16
_DOUBLES = 37  # orientation 4, its covariance 9, rate 3, covariance 9, force 3, covariance 9
_RATE, _RATE_COVARIANCE, _FORCE, _FORCE_COVARIANCE = 13, 16, 25, 28
_CDR_KINDS = (b"\0\0", b"\0\1")  # big and little endian


class _DamagedError(Exception):
    """The bytes are no message of the type that the bag says they are."""


def _byte_order(data: bytes, wire: Wire) -> str:
    if wire == "ros1":
        return "<"
    if data[:2] not in _CDR_KINDS:
        raise _DamagedError
    return "<" if data[1] else ">"


def stamp_ns(data: bytes, wire: Wire) -> int | None:
    """Return the timestamp of a message that begins with a header [ns]; None where it is too short or damaged."""
    try:
        form = "II" if wire == "ros1" else "iI"
        seconds, nanoseconds = struct.unpack_from(_byte_order(data, wire) + form, data, _STAMP)
    except (struct.error, _DamagedError):
        return None
    return int(seconds) * 1_000_000_000 + int(nanoseconds)


class _Fields:
    """Reads one field of a message after the other, from behind its header on."""

    def __init__(self, data: bytes, wire: Wire) -> None:
        self.data, self.wire, self.at = data, wire, _TEXT - 4
        self.order = _byte_order(data, wire)
        self.text()

    def number(self, form: str, size: int) -> int:
        return int(self.value(form, size))

    def value(self, form: str, size: int) -> float:
        if self.wire == "cdr":
            self.at += -(self.at - 4) % size
        (value,) = struct.unpack_from(f"{self.order}{form}", self.data, self.at)
        self.at += size
        return value

    def bytes(self) -> memoryview:
        length = self.number("I", 4)
        if self.at + length > len(self.data):
            raise _DamagedError
        self.at += length
        return memoryview(self.data)[self.at - length : self.at]

    def text(self) -> str:
        return bytes(self.bytes()).rstrip(b"\0").decode("utf-8", errors="replace")


def temperature_message(data: bytes, wire: Wire) -> float | None:
    """Return what a sensor_msgs/Temperature says [degC]; None where the bytes are no such message."""
    try:
        return _Fields(data, wire).value("d", 8)
    except (struct.error, _DamagedError):
        return None


def image_message(data: bytes, wire: Wire, where: str) -> RawImage:
    """Return the fields of a sensor_msgs/Image; its pixels are not copied.

    Raises
    ------
    RecordingError
        If the bytes are no such message.
    """
    try:
        fields = _Fields(data, wire)
        height, width = fields.number("I", 4), fields.number("I", 4)
        encoding, big_endian, step = fields.text().strip(), fields.number("B", 1), fields.number("I", 4)
        # An image that is cut off says by its sizes what is missing.
        length = fields.number("I", 4)
        pixels = memoryview(data)[fields.at : fields.at + length]
    except (struct.error, _DamagedError):
        raise _no_message(where, IMAGE, data) from None
    return RawImage(height=height, width=width, encoding=encoding, big_endian=bool(big_endian), step=step, data=pixels)


def compressed_message(data: bytes, wire: Wire, where: str) -> tuple[str, memoryview]:
    """Return `format` and the picture file of a sensor_msgs/CompressedImage.

    Raises
    ------
    RecordingError
        If the bytes are no such message.
    """
    try:
        fields = _Fields(data, wire)
        return fields.text(), fields.bytes()
    except (struct.error, _DamagedError):
        raise _no_message(where, COMPRESSED_IMAGE, data) from None


def _no_message(where: str, kind: str, data: bytes) -> RecordingError:
    return RecordingError(f"{where}: {len(data)} bytes that are no {kind}; the message is damaged.")


@value_class
class ImuBlock:
    """Messages of an IMU, one row each.

    Attributes
    ----------
    place : (n,) which of the messages that were given; damaged ones are left out
    t_ns : (n,) header timestamps [ns]
    gyroscope : (n, 3) angular_velocity [rad/s]
    accelerometer : (n, 3) linear_acceleration [m/s^2]
    no_gyroscope, no_accelerometer : (n,) whether the message says so, by -1 as the first number of the covariance
    """

    place: Integers
    t_ns: Integers
    gyroscope: Floats
    accelerometer: Floats
    no_gyroscope: NDArray[np.bool_]
    no_accelerometer: NDArray[np.bool_]


def imu_block(messages: Sequence[bytes], wire: Wire) -> ImuBlock:
    """Return the samples of messages of type sensor_msgs/Imu."""
    stamps = np.empty(len(messages), np.int64)
    numbers = np.empty((len(messages), _DOUBLES))
    shapes = [_shape(data, wire) for data in messages]  # the same for all, unless frame_id changes
    for shape in set(shapes):
        if shape is None:
            continue
        order, start, length = shape
        rows = [row for row, other in enumerate(shapes) if other == shape]
        table = np.frombuffer(b"".join([messages[row] for row in rows]), np.uint8).reshape(len(rows), length)
        numbers[rows] = _columns(table, start, _DOUBLES, f"{order}f8")
        seconds = _columns(table, _STAMP, 1, f"{order}{'u4' if wire == 'ros1' else 'i4'}")
        nanoseconds = _columns(table, _STAMP + 4, 1, f"{order}u4")
        stamps[rows] = seconds[:, 0].astype(np.int64) * 1_000_000_000 + nanoseconds[:, 0].astype(np.int64)
    place = np.array([row for row, shape in enumerate(shapes) if shape is not None], dtype=np.int64)
    stamps, numbers = stamps[place], numbers[place]
    return ImuBlock(
        place=place,
        t_ns=stamps,
        gyroscope=numbers[:, _RATE : _RATE + 3],
        accelerometer=numbers[:, _FORCE : _FORCE + 3],
        no_gyroscope=numbers[:, _RATE_COVARIANCE] == -1,
        no_accelerometer=numbers[:, _FORCE_COVARIANCE] == -1,
    )


def _shape(data: bytes, wire: Wire) -> tuple[str, int, int] | None:
    """Return byte order, place of the first double, and length of a message; None if it is no Imu."""
    try:
        order = _byte_order(data, wire)
        (text,) = struct.unpack_from(f"{order}I", data, _TEXT - 4)
    except (struct.error, _DamagedError):
        return None
    start = _TEXT + int(text)
    if wire == "cdr":
        start += -(start - 4) % 8
    surplus = len(data) - start - 8 * _DOUBLES
    return (order, start, len(data)) if 0 <= surplus < 4 else None  # CDR may be padded to four bytes


def _columns(table: NDArray[np.uint8], start: int, count: int, dtype: str) -> NDArray[Any]:
    size = count * np.dtype(dtype).itemsize
    return np.ascontiguousarray(table[:, start : start + size]).view(dtype)
