"""The IMU in a bag that another program writes, as lines: `sensor_msgs/Imu`, of several topics the first."""

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from ..readers.bags.messages import ImuBlock, imu_block
from ..readers.bags.salvage import MCAP_MAGIC, ROS1_MAGIC, SQLITE_MAGIC, Record, follow_records
from .sources import Arrival

_MAGIC = tuple(magic[:8] for magic in (MCAP_MAGIC, ROS1_MAGIC, SQLITE_MAGIC))
_FIRST = 20  # messages, by which a topic tells which triads it holds
_UNITS = {"accelerometer": "m/s^2", "gyroscope": "rad/s"}


def is_bag(head: bytes) -> bool:
    """Return whether a file that begins so is a bag."""
    return head[:8] in _MAGIC


def bag_lines(path: Path, wait: Callable[[], bool]) -> Iterator[Arrival]:
    """Yield a line for each sample, after the names of its columns.

    Parameters
    ----------
    path : of a ROS 1 bag or an MCAP file
    wait : waits for more, and returns whether to go on

    Raises
    ------
    RecordingError
        If it cannot be read while it is written.
    """
    waiting: dict[str, list[Record]] = {}
    taken: dict[str, list[str]] = {}
    for record in follow_records(path, wait):
        topic = record.channel.topic
        if topic not in taken:
            first = waiting.setdefault(topic, [])
            first.append(record)
            if len(first) < _FIRST:
                continue
            triads = _triads(_block(first))
            free = not any(triad in used for used in taken.values() for triad in triads)
            taken[topic], records = triads if free else [], waiting.pop(topic)
            if taken[topic]:
                yield Arrival(_header(taken[topic]), _stream(taken[topic]))
        else:
            records = [record]
        if triads := taken[topic]:
            yield from (Arrival(line, _stream(triads)) for line in _lines(records, triads))


def _block(records: list[Record]) -> ImuBlock:
    return imu_block([record.data for record in records], records[0].channel.wire or "cdr")


def _triads(block: ImuBlock) -> list[str]:
    """Return which triads messages hold: those that are neither marked as missing nor zero."""
    return [
        name
        for name in _UNITS
        if not getattr(block, f"no_{name}").any() and np.any(np.asarray(getattr(block, name), np.float64))
    ]


def _stream(triads: list[str]) -> str:
    return "" if len(triads) == len(_UNITS) else triads[0]


def _header(triads: list[str]) -> bytes:
    return ",".join(["time [ns]", *(f"{name} {axis} [{_UNITS[name]}]" for name in triads for axis in "xyz")]).encode()


def _lines(records: list[Record], triads: list[str]) -> Iterator[bytes]:
    block = _block(records)
    rows = np.concatenate([getattr(block, name) for name in triads], axis=1)
    for place, t_ns, row in zip(block.place.tolist(), block.t_ns.tolist(), rows.tolist(), strict=True):
        yield f"{t_ns or records[place].received_ns},{','.join(map(repr, row))}".encode()
