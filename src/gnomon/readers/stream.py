"""Recordings read block by block, with the same understanding of the files as `read`, in memory that does not grow.

What a text file is (layout, columns, unit of time, which triad is which) is recognised from its beginning, all of it
where it is short. The units of the samples are known beforehand, from the calibration that will be applied; what the
file says, or gravity shows, takes precedence, so that a calibration for other units can be refused.
"""

from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..errors import OptionError, RecordingError
from ..recording import Floats, ImuSamples, Integers, TriadSamples
from ..units import Units
from .files import NPZ_MAGIC, first_bytes
from .folder import find_recording
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


def stream_of(samples: ImuSamples, block: int = 65_536) -> SampleStream:
    """Return samples in memory as a stream of blocks of at most `block` rows."""

    def blocks(triad: TriadSamples) -> Blocks:
        for i in range(0, len(triad), block):
            yield TriadSamples(t_ns=triad.t_ns[i : i + block], values=triad.values[i : i + block], unit=triad.unit)

    gyroscope = blocks(samples.gyroscope) if len(samples.gyroscope) else None
    return SampleStream(accelerometer=blocks(samples.accelerometer), gyroscope=gyroscope)


def open_stream(
    *paths: str | Path,
    expected: Units,
    units: Units | None = None,
    columns: str | None = None,
    rate_hz: float | None = None,
    imu: str = "imu0",
    block_bytes: int = 1 << 20,
) -> SampleStream:
    """Open a recording for reading block by block; `paths`, `units`, `columns` and `rate_hz` as in `read`.

    Parameters
    ----------
    expected : units of accelerometer and gyroscope where neither `units`, nor the file, nor gravity tells them
    imu : which IMU of an NPZ file
    block_bytes : size of a block [bytes of the unpacked file]

    Raises
    ------
    RecordingError
        If something cannot be read or understood, at once or when the block is reached.
    OptionError
        If an option does not fit the recording.
    """
    choice = UnitChoice(stated=units or Units(), expected=expected)
    files = [Path(path) for path in paths]
    if len(files) == 1 and files[0].is_dir():
        files = list(find_recording(files[0]))
    if not 1 <= len(files) <= 2 or (len(files) == 2 and any(path.is_dir() for path in files)):
        raise OptionError(
            f"{len(files)} paths given. Give one file, one folder, or an accelerometer file and a gyroscope file."
        )
    if first_bytes(files[0]).startswith(NPZ_MAGIC):
        from .stream_npz import open_npz

        if columns is not None or len(files) != 1:
            raise OptionError(f"{files[0].name} is an NPZ file: give it alone, and without columns.")
        return open_npz(files[0], choice, rate_hz, imu, block_bytes)
    from .stream_text import open_text

    return open_text(files, choice, columns, rate_hz, block_bytes)


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


class Rows:
    """The rows of an iterator of blocks, taken in pieces of any length."""

    def __init__(self, blocks: Blocks, transform: Callable[[TriadSamples], TriadSamples]) -> None:
        self._blocks, self._transform = blocks, transform
        self.t_ns = np.empty(0, np.int64)
        self.values = np.empty((0, 3))

    def _pull(self) -> bool:
        block = next(self._blocks, None)
        if block is None:
            return False
        block = self._transform(block)
        self.t_ns = np.concatenate([self.t_ns, block.t_ns])
        self.values = np.concatenate([self.values, block.values])
        return True

    def fill(self, count: int) -> None:
        """Hold at least `count` rows, if there are so many."""
        while len(self.t_ns) < count and self._pull():
            pass

    def reach(self, t_ns: int) -> None:
        """Hold a row later than `t_ns`, if there is one.

        Raises
        ------
        RecordingError
            If the stamps go backwards, so that nothing can be interpolated.
        """
        checked = 0
        while True:
            back = np.flatnonzero(np.diff(self.t_ns[max(checked - 1, 0) :]) < 0)
            if len(back):
                raise RecordingError(
                    "the accelerometer's stamps go backwards, so that its samples cannot be brought to the gyroscope's "
                    "stamps. `gnomon check` says where; sort or cut the recording."
                )
            checked = len(self.t_ns)
            if (checked and self.t_ns[-1] > t_ns) or not self._pull():
                return

    def put_back(self, t_ns: Integers, values: Floats) -> None:
        """Put rows in front again."""
        self.t_ns, self.values = np.concatenate([t_ns, self.t_ns]), np.concatenate([values, self.values])

    def drop(self, count: int) -> None:
        """Forget the first `count` rows."""
        self.t_ns, self.values = self.t_ns[count:], self.values[count:]
