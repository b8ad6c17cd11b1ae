"""Bags read from their first byte to their last, without an index: what there is of a file that ends early.

ROS 1 bags (https://wiki.ros.org/Bags/Format/2.0) and MCAP files (https://mcap.dev/spec) are records in a row, some of
them in compressed chunks; the messages of an SQLite file lie in the order in which they were written.
"""

import sqlite3
import struct
import sys
from collections.abc import Callable, Collection, Iterator
from contextlib import closing, suppress
from dataclasses import dataclass
from functools import partial
from io import BytesIO
from pathlib import Path
from typing import BinaryIO, NamedTuple

from ...errors import RecordingError
from ...frozen import value_class
from .messages import IMU, Wire, unpack_bytes

ROS1_MAGIC, MCAP_MAGIC, SQLITE_MAGIC = b"#ROSBAG V2.0\n", b"\x89MCAP0\r\n", b"SQLite format 3\0"
_ROS1_MESSAGE, _ROS1_HEADER, _ROS1_CHUNK, _ROS1_CONNECTION = 2, 3, 5, 7
_ROS1_OPS = range(2, 8)
_LONGEST_HEADER = 1 << 20
_LARGEST_REST = 1 << 28  # a chunk that is cut off is read into memory up to here; beyond, its length is wrong
_MCAP_FOOTER, _MCAP_SCHEMA, _MCAP_CHANNEL, _MCAP_MESSAGE, _MCAP_CHUNK = 2, 3, 4, 5, 6
WIRES: dict[str, Wire] = {"cdr": "cdr", "ros1": "ros1"}


@value_class(eq=True)
class Channel:
    """A topic of a bag: its name, the type of its messages, and how they are laid out; None where that is unknown."""

    topic: str
    kind: str
    wire: Wire | None


Wanted = Callable[[Channel], bool]
"""Whether the bytes of a channel's messages are wanted."""


class Record(NamedTuple):
    """A message, and when the recorder received it [ns]."""

    channel: Channel
    received_ns: int
    data: bytes


@dataclass(slots=True, kw_only=True)
class Outcome:
    """How the reading of one file ended.

    Attributes
    ----------
    complete : whether the recorder closed the file and nothing is missing
    damaged : number of chunks that were left out
    read, size : bytes that were passed, of how many
    """

    complete: bool = False
    damaged: int = 0
    read: int = 0
    size: int = 0


class _EndError(Exception):
    """There are fewer bytes than a record says, or they are no record."""


class _Bytes:
    """A file, or a chunk in memory, that is read in order."""

    def __init__(self, file: BinaryIO, size: int) -> None:
        self.file, self.left = file, size

    def take(self, count: int) -> bytes:
        if count > self.left:
            raise _EndError
        data = self.file.read(count)
        if len(data) != count:
            raise _EndError
        self.left -= count
        return data

    def skip(self, count: int) -> None:
        if count > self.left:
            raise _EndError
        self.file.seek(count, 1)
        self.left -= count

    def number(self, size: int) -> int:
        return int.from_bytes(self.take(size), "little")

    def text(self) -> str:
        return self.take(self.number(4)).decode("utf-8", errors="replace")


def kind_of_type(name: str) -> str:
    """Return the name of a type as ROS 1 writes it: sensor_msgs/Imu."""
    return name.replace("/msg/", "/")


def read_records(path: Path, wanted: Collection[str] | None, outcome: Outcome) -> Iterator[Record]:
    """Yield the messages of a file in its order; of topics that are not wanted, without their bytes.

    Parameters
    ----------
    path : a ROS 1 bag, an MCAP file or an SQLite file of ROS 2
    wanted : topics; None for none of them
    outcome : is filled in

    Raises
    ------
    RecordingError
        If a chunk is compressed in an unknown way, or the file is of none of these kinds.
    """
    outcome.size = path.stat().st_size
    keep = frozenset(wanted or ())
    with path.open("rb") as file:
        head = file.read(16)
        if head.startswith(SQLITE_MAGIC):
            yield from _sqlite(path, keep, outcome)
            return
        walk = _Ros1Walk if head.startswith(ROS1_MAGIC) else _McapWalk if head.startswith(MCAP_MAGIC) else None
        if walk is None:
            raise RecordingError(f"{path}: no ROS 1 bag, no MCAP file and no ROS 2 bag in SQLite.")
        start = len(ROS1_MAGIC if walk is _Ros1Walk else MCAP_MAGIC)
        file.seek(start)
        source = _Bytes(file, outcome.size - start)
        try:
            yield from walk(path.name, lambda channel: channel.topic in keep, outcome).records(source)
        except _EndError:
            outcome.complete = False
        outcome.read = outcome.size - source.left


def follow_records(path: Path, wait: Callable[[], bool]) -> Iterator[Record]:
    """Yield the messages of a file that another program writes meanwhile, those of IMUs with their bytes.

    Parameters
    ----------
    path : a ROS 1 bag or an MCAP file
    wait : waits for more, and returns whether to go on

    Raises
    ------
    RecordingError
        If a chunk is compressed in an unknown way, or nobody else may read the file meanwhile.
    """
    with path.open("rb") as file, suppress(_EndError):
        source = _GrowingBytes(file, wait)
        head = source.take(len(MCAP_MAGIC))
        if SQLITE_MAGIC.startswith(head):
            raise RecordingError(
                f"{path}: a bag in SQLite is locked while it is read, which could stop its recorder. Record it as MCAP "
                "(ros2 bag record --storage mcap), or calibrate it when it is complete."
            )
        if head != MCAP_MAGIC:
            source.take(len(ROS1_MAGIC) - len(head))
        walk = _McapWalk if head == MCAP_MAGIC else _Ros1Walk
        yield from walk(path.name, lambda channel: channel.kind == IMU, Outcome()).records(source)


class _GrowingBytes(_Bytes):
    """A file that another program writes."""

    def __init__(self, file: BinaryIO, wait: Callable[[], bool]) -> None:
        super().__init__(file, sys.maxsize)
        self.wait = wait

    def take(self, count: int) -> bytes:
        data = self.file.read(count)
        while len(data) < count:
            if not self.wait():
                raise _EndError
            data += self.file.read(count - len(data))
        return data

    def skip(self, count: int) -> None:
        self.file.seek(count, 1)


class _Ros1Walk:
    """The records of a ROS 1 bag."""

    def __init__(self, where: str, wanted: Wanted, outcome: Outcome) -> None:
        self.where, self.wanted, self.outcome = where, wanted, outcome
        self.channels: dict[int, Channel] = {}

    def records(self, source: _Bytes, *, chunk: bool = False) -> Iterator[Record]:
        """Yield the messages from the first byte on, of a whole file or of a chunk of it."""
        while source.left:
            fields = _ros1_fields(source)
            length, op = source.number(4), _ros1_number(fields, "op")
            if op not in _ROS1_OPS or (chunk and op == _ROS1_CHUNK):
                raise _EndError
            if op == _ROS1_CHUNK:
                yield from self._chunk(source, fields.get("compression", b"none").decode("latin-1"), length)
            elif op == _ROS1_MESSAGE:
                channel = self.channels.get(_ros1_number(fields, "conn"))
                time = _ros1_number(fields, "time")  # seconds in its lower half, nanoseconds in its upper one
                received = (time & 0xFFFFFFFF) * 1_000_000_000 + (time >> 32)
                yield from _record(source, length, channel, received, self.wanted)
            elif op == _ROS1_CONNECTION:
                self._connect(fields, source.take(length))
            else:
                self.outcome.complete |= op == _ROS1_HEADER and _ros1_number(fields, "index_pos") > 0
                source.skip(length)

    def _connect(self, fields: dict[str, bytes], data: bytes) -> None:
        more = _ros1_named(data)
        topic = "/".join(part for part in fields.get("topic", b"").decode("utf-8", "replace").split("/") if part)
        self.channels[_ros1_number(fields, "conn")] = Channel(
            topic=f"/{topic}" if fields.get("topic", b"").startswith(b"/") else topic,
            kind=kind_of_type(more.get("type", b"").decode("utf-8", "replace")),
            wire="ros1",
        )

    def _chunk(self, source: _Bytes, compression: str, length: int) -> Iterator[Record]:
        yield from _chunk(self, source, "" if compression == "none" else compression, length)


def _ros1_fields(source: _Bytes) -> dict[str, bytes]:
    length = source.number(4)
    if not 0 < length < _LONGEST_HEADER:
        raise _EndError
    return _ros1_named(source.take(length))


def _ros1_named(data: bytes) -> dict[str, bytes]:
    found: dict[str, bytes] = {}
    fields = _Bytes(BytesIO(data), len(data))
    while fields.left:
        name, equals, value = fields.take(fields.number(4)).partition(b"=")
        if not equals:
            raise _EndError
        found[name.decode("latin-1")] = value
    return found


def _ros1_number(fields: dict[str, bytes], name: str) -> int:
    if name not in fields:
        raise _EndError
    return int.from_bytes(fields[name], "little")


class _McapWalk:
    """The records of an MCAP file."""

    def __init__(self, where: str, wanted: Wanted, outcome: Outcome) -> None:
        self.where, self.wanted, self.outcome = where, wanted, outcome
        self.kinds: dict[int, str] = {}
        self.channels: dict[int, Channel] = {}

    def records(self, source: _Bytes, *, chunk: bool = False) -> Iterator[Record]:
        """Yield the messages from the first byte on, of a whole file or of a chunk of it."""
        while source.left and not self.outcome.complete:
            op, length = source.number(1), source.number(8)
            if op == _MCAP_CHUNK and not chunk:
                yield from self._chunk(source, length)
            elif op == _MCAP_MESSAGE:
                channel, _, received, _ = struct.unpack("<HIqq", source.take(22))
                yield from _record(source, length - 22, self.channels.get(channel), received, self.wanted)
            elif op in {_MCAP_SCHEMA, _MCAP_CHANNEL}:
                self._describe(op, source.take(length))
            elif op == 0 or (chunk and op == _MCAP_CHUNK):
                raise _EndError
            else:
                self.outcome.complete = op == _MCAP_FOOTER and not chunk
                source.skip(length)

    def _describe(self, op: int, data: bytes) -> None:
        fields = _Bytes(BytesIO(data), len(data))
        number = fields.number(2)
        if op == _MCAP_SCHEMA:
            self.kinds[number] = kind_of_type(fields.text())
            return
        kind = self.kinds.get(fields.number(2), "")
        topic, wire = fields.text(), WIRES.get(fields.text())
        self.channels[number] = Channel(topic=topic, kind=kind, wire=wire)

    def _chunk(self, source: _Bytes, length: int) -> Iterator[Record]:
        source.skip(28)  # span of time, size, checksum
        size = source.number(4)
        compression = source.take(size).decode("latin-1")
        stated, held = source.number(8), length - 28 - 4 - size - 8
        if stated > held:
            raise _EndError
        yield from _chunk(self, source, compression, stated)
        source.skip(held - stated)


def _record(source: _Bytes, length: int, channel: Channel | None, received_ns: int, wanted: Wanted) -> Iterator[Record]:
    if length < 0:
        raise _EndError
    if channel is None or not wanted(channel):
        source.skip(length)
        data = b""
    else:
        data = source.take(length)
    if channel is not None:
        yield Record(channel, received_ns, data)


def _chunk(walk: "_Ros1Walk | _McapWalk", source: _Bytes, compression: str, length: int) -> Iterator[Record]:
    """Yield the messages of a chunk; of one that is cut off, those that are whole."""
    unpack = _decompressor(compression, walk.where)
    cut_off = length > source.left
    if cut_off and source.left > _LARGEST_REST:
        raise _EndError
    packed = source.take(min(length, source.left))
    try:
        data = unpack(packed)
    except Exception:  # each library has errors of its own
        data = b""
        walk.outcome.damaged += not cut_off
    try:
        yield from walk.records(_Bytes(BytesIO(data), len(data)), chunk=True)
    except _EndError:
        walk.outcome.damaged += not cut_off
    if cut_off:
        raise _EndError


def _decompressor(name: str, where: str) -> Callable[[bytes], bytes]:
    if name == "":
        return bytes
    if name in {"bz2", "lz4", "zstd"}:
        return partial(unpack_bytes, name)
    raise RecordingError(
        f'{where}: its chunks are compressed with "{name}", which gnomon does not know; it reads bz2, lz4, zstd and '
        "uncompressed ones. Unpack it with the tool that packed it (rosbag decompress, mcap convert)."
    )


def unpack_zstd(data: bytes) -> bytes:
    """Unpack what was compressed with zstd."""
    return unpack_bytes("zstd", data)


def _sqlite(path: Path, wanted: frozenset[str], outcome: Outcome) -> Iterator[Record]:
    """Yield the messages of an SQLite file of ROS 2 as far as its pages are there."""
    uri = f"{path.absolute().as_uri()}?mode=ro&immutable=1"
    try:
        with closing(sqlite3.connect(uri, uri=True)) as base:
            base.execute("PRAGMA writable_schema = ON")  # else a file that is cut off would not be looked into at all
            channels = {
                number: Channel(topic=str(topic), kind=kind_of_type(str(kind)), wire=WIRES.get(wire))
                for number, topic, kind, wire in base.execute("SELECT id, name, type, serialization_format FROM topics")
            }
            keep = [number for number, channel in channels.items() if channel.topic in wanted]
            data = f"CASE WHEN topic_id IN ({','.join(map(str, keep))}) THEN data END" if keep else "NULL"
            rows = base.execute(f"SELECT topic_id, timestamp, {data} FROM messages NOT INDEXED")
            yield from (
                Record(channels[number], received, packed or b"")
                for number, received, packed in rows
                if number in channels and isinstance(received, int) and isinstance(packed, bytes | None)
            )
        outcome.complete, outcome.read = True, outcome.size
    except sqlite3.Error as error:
        if "no such table" in str(error):
            raise RecordingError(f"{path}: an SQLite file without ROS 2's tables of topics and messages.") from None
