"""Recordings read block by block, with the same understanding of the files as `read`, in memory that does not grow.

What a text file is (layout, columns, unit of time, which triad is which) is recognised from its beginning, all of it
where it is short. The units of the samples are known beforehand, from the calibration that will be applied; what the
file says, or gravity shows, takes precedence, so that a calibration for other units can be refused.

Samples in consecutive blocks, and the units that a reader of blocks takes them for.
"""

from collections import deque
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from ...errors import OptionError, RecordingError
from ...frozen import value_class
from ...recording import Floats, ImuSamples, Integers, TemperatureSamples, TriadSamples
from ...units import Units
from ..devices.device_log import is_device_log
from ..files import MAT_MAGIC, NPZ_MAGIC, first_bytes, recording_files
from ..recordings import read
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


def stream_of(samples: ImuSamples, block: int = 65_536, triads: Collection[str] = TRIADS) -> SampleStream:
    """Return samples in memory, of the triads that are wanted, as a stream of blocks of at most `block` rows."""

    def blocks(triad: TriadSamples) -> Blocks:
        for i in range(0, len(triad), block):
            yield TriadSamples(t_ns=triad.t_ns[i : i + block], values=triad.values[i : i + block], unit=triad.unit)

    wanted = {name: getattr(samples, name) for name in TRIADS if name in triads}
    there = {name: blocks(triad) for name, triad in wanted.items() if triad is not None and len(triad)}
    return replace(SampleStream(), **there)


def read_thermometer(
    *paths: str | Path,
    units: Units | None = None,
    columns: str | None = None,
    rate_hz: float | None = None,
    imu: str = "imu0",
) -> TemperatureSamples | None:
    """Return the readings of the thermometer of an IMU; the recording is read as a whole, as by `read`."""
    imus = read(*paths, columns=columns, rate_hz=rate_hz, units=units).imus
    return (imus[imu] if imu in imus else next(iter(imus.values()))).temperature


def open_stream(
    *paths: str | Path,
    expected: Units,
    units: Units | None = None,
    columns: str | None = None,
    rate_hz: float | None = None,
    imu: str = "imu0",
    triads: Collection[str] = TRIADS,
    block_bytes: int = 1 << 20,
) -> SampleStream:
    """Open a recording for reading block by block; `paths`, `units`, `columns` and `rate_hz` as in `read`.

    Parameters
    ----------
    expected : units of the triads where neither `units`, nor the file, nor gravity tells them
    imu : which IMU of an NPZ file
    triads : which triads are read, as far as the recording holds them
    block_bytes : size of a block [bytes of the unpacked file]

    Raises
    ------
    RecordingError
        If something cannot be read or understood, at once or when the block is reached.
    OptionError
        If an option does not fit the recording.
    """
    if imu == "imu0" and (is_device_log(paths) or _is_mat(paths)):
        recording = read(*paths, units=units, columns=columns, rate_hz=rate_hz)
        return stream_of(recording.imus[imu], triads=triads)
    choice = UnitChoice(stated=units or Units(), expected=expected)
    files = recording_files(paths)
    if first_bytes(files[0]).startswith(NPZ_MAGIC):
        from .stream_npz import open_npz

        if columns is not None or len(files) != 1:
            raise OptionError(f"{files[0].name} is an NPZ file: give it alone, and without columns.")
        return open_npz(files[0], choice, rate_hz, imu, triads=triads, block_bytes=block_bytes)
    from .stream_text import open_text

    return open_text(files, choice, columns, rate_hz, triads=triads, block_bytes=block_bytes)


def _is_mat(paths: tuple[str | Path, ...]) -> bool:
    path = Path(paths[0])
    return len(paths) == 1 and path.is_file() and first_bytes(path).startswith(MAT_MAGIC)


class BlockRows:
    """The rows of an iterator of blocks, taken in pieces of any length.

    Parameters
    ----------
    blocks, transform : the blocks, and what is made of each
    what, onto : the sensor, and the one to whose timestamps it is brought, for messages
    """

    def __init__(self, blocks: Blocks, transform: Callable[[TriadSamples], TriadSamples], what: str, onto: str) -> None:
        self._blocks, self._transform = blocks, transform
        self.what, self.onto = what, onto
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
            If the timestamps go backwards, so that nothing can be interpolated.
        """
        checked = 0
        while True:
            back = np.flatnonzero(np.diff(self.t_ns[max(checked - 1, 0) :]) < 0)
            if len(back):
                raise RecordingError(
                    f"the {self.what}'s timestamps go backwards, so that its samples cannot be brought to the "
                    f"{self.onto}'s timestamps. `gnomon check` says where; sort or cut the recording."
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
