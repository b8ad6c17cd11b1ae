"""Samples in consecutive blocks, and the units that a reader of blocks takes them for."""

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass

from ..recording import Floats, ImuSamples, TriadSamples
from ..units import Units
from .recognise import accelerometer_unit

Blocks = Iterator[TriadSamples]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SampleStream:
    """One IMU's samples in consecutive blocks; the blocks of the two triads need not have the same stamps or lengths.

    Attributes
    ----------
    accelerometer, gyroscope : iterators of TriadSamples, to be consumed once; the gyroscope's may be None
    """

    accelerometer: Blocks
    gyroscope: Blocks | None


@dataclass(frozen=True, slots=True, kw_only=True)
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


def shared_blocks(blocks: Iterator[ImuSamples]) -> SampleStream:
    """Split blocks that hold both triads into two iterators; what one of them has not yet taken is kept for it."""
    waiting: tuple[deque[TriadSamples], deque[TriadSamples]] = (deque(), deque())

    def side(which: int) -> Blocks:
        while True:
            if not waiting[which]:
                block = next(blocks, None)
                if block is None:
                    return
                waiting[0].append(block.accelerometer)
                waiting[1].append(block.gyroscope)
            yield waiting[which].popleft()

    return SampleStream(accelerometer=side(0), gyroscope=side(1))
