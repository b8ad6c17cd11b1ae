"""Samples in consecutive blocks, and the units that a reader of blocks takes them for."""

from collections import deque
from collections.abc import Iterator, Sequence

from ...frozen import value_class
from ...recording import Floats, TriadSamples
from ...units import Units
from .recognise import accelerometer_unit

Blocks = Iterator[TriadSamples]

TRIADS = ("accelerometer", "gyroscope", "magnetometer")
"""The sensors of an IMU, in the order in which readers of blocks count them."""


@value_class
class SampleStream:
    """One IMU's samples in consecutive blocks; the blocks of its triads need not have the same timestamps or lengths.

    Attributes
    ----------
    accelerometer, gyroscope, magnetometer : iterators of TriadSamples, to be consumed once, or None
    thermometer : whether the recording has one, whose readings are read as a whole
    """

    accelerometer: Blocks | None = None
    gyroscope: Blocks | None = None
    magnetometer: Blocks | None = None
    thermometer: bool = False


@value_class(eq=True)
class UnitChoice:
    """Units that were stated, and those that are taken where nothing tells otherwise."""

    stated: Units
    expected: Units

    def accelerometer(self, named: str | None, values: Floats) -> str:
        """Return the unit: stated, else named in the file, else shown by gravity in the first values, else expected."""
        if self.stated.accelerometer is not None or named is not None:
            return self.stated.accelerometer or str(named)
        shown = accelerometer_unit(values).unit if len(values) > 1 else "count"
        return shown if shown != "count" else self.expected.accelerometer or "count"

    def gyroscope(self, named: str | None) -> str:
        """Return the unit: stated, else named in the file, else expected."""
        return self.stated.gyroscope or named or self.expected.gyroscope or "count"

    def magnetometer(self, named: str | None) -> str:
        """Return the unit: stated, else named in the file, else expected."""
        return self.stated.magnetometer or named or self.expected.magnetometer or "count"


def shared_blocks(blocks: Iterator[Sequence[TriadSamples]], count: int) -> list[Blocks]:
    """Split blocks that hold so many triads into an iterator for each; what one of them has not yet taken is kept."""
    waiting: list[deque[TriadSamples]] = [deque() for _ in range(count)]

    def side(which: int) -> Blocks:
        while True:
            if not waiting[which]:
                block = next(blocks, None)
                if block is None:
                    return
                for queue, triad in zip(waiting, block, strict=True):
                    queue.append(triad)
            yield waiting[which].popleft()

    return [side(which) for which in range(count)]
