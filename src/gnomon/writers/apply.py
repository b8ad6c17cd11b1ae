"""A calibration applied to a recording of any length: block by block, with the arithmetic of `ImuCalibration.apply`.

The result is a CSV table with one row for each gyroscope sample, and beside it the specific force that the gyroscope's
correction used: the accelerometer's own samples where both triads share their stamps, else interpolated linearly to the
gyroscope's stamps. Without a gyroscope there is a row for each accelerometer sample.
"""

from collections.abc import Iterator
from os import PathLike
from pathlib import Path

import numpy as np

from ..calibration import ImuCalibration
from ..errors import FormatError, RecordingError
from ..output import atomic_file
from ..readers.sample_stream import SampleStream
from ..readers.stream import Rows, open_stream, stream_of
from ..recording import Floats, Integers, Recording, TriadSamples
from ..units import Units

_FORCE, _RATE = ("ax [m/s^2]", "ay [m/s^2]", "az [m/s^2]"), ("wx [rad/s]", "wy [rad/s]", "wz [rad/s]")


def apply_files(
    calibration: ImuCalibration,
    *paths: str | Path,
    output: str | PathLike[str],
    columns: str | None = None,
    rate_hz: float | None = None,
    units: Units | None = None,
    imu: str = "imu0",
) -> int:
    """Calibrate a recording from file to file and return the number of rows; memory does not grow with its length.

    Parameters
    ----------
    paths, columns, rate_hz : as for `gnomon.read`
    output : CSV with `t_ns`, angular rate [rad/s] and specific force [m/s^2] in the body frame
    units : as for `gnomon.read`; where nothing tells otherwise they are those of the calibration
    imu : which IMU of an NPZ file

    Raises
    ------
    RecordingError
        If the recording cannot be read.
    FormatError
        If the samples are not in the units for which the calibration was made.
    OutputError
        If the output cannot be written.
    """
    gyroscope = calibration.gyroscope
    expected = Units(
        accelerometer=calibration.accelerometer.unit,  # pyright: ignore[reportArgumentType]
        gyroscope=None if gyroscope is None else gyroscope.unit,  # pyright: ignore[reportArgumentType]
    )
    stream = open_stream(*paths, expected=expected, units=units, columns=columns, rate_hz=rate_hz, imu=imu)
    return write_calibrated(calibration, stream, output)


def apply_recording(
    calibration: ImuCalibration, recording: Recording, output: str | PathLike[str], imu: str = "imu0"
) -> int:
    """Calibrate a recording in memory into a CSV file and return the number of rows; see `apply_files`.

    Raises
    ------
    RecordingError
        If the recording holds no such IMU.
    FormatError
        If the samples are not in the units for which the calibration was made.
    OutputError
        If the output cannot be written.
    """
    if imu not in recording.imus:
        raise RecordingError(f"no {imu} in this recording. Found: {', '.join(recording.imus)}.")
    return write_calibrated(calibration, stream_of(recording.imus[imu]), output)


def write_calibrated(calibration: ImuCalibration, stream: SampleStream, output: str | PathLike[str]) -> int:
    """Write calibrated samples of a stream and return the number of rows.

    Raises
    ------
    RecordingError
        If the stream cannot be read on, or stamps that must be interpolated go backwards.
    FormatError
        If the samples are not in the units for which the calibration was made.
    OutputError
        If the output cannot be written.
    """
    with_rate = calibration.gyroscope is not None and stream.gyroscope is not None
    count = 0
    with atomic_file(output) as file:
        file.write((",".join(("t_ns", *(_RATE if with_rate else ()), *_FORCE)) + "\n").encode())
        for t_ns, values in calibrated_blocks(calibration, stream):
            columns = [t_ns.tolist(), *values.T.tolist()]
            file.write("".join(",".join(map(repr, row)) + "\n" for row in zip(*columns, strict=True)).encode())
            count += len(t_ns)
    return count


def calibrated_blocks(calibration: ImuCalibration, stream: SampleStream) -> Iterator[tuple[Integers, Floats]]:
    """Yield stamps (k,) [ns] with rate and force (k, 6) [rad/s, m/s^2], or force (k, 3) alone without a gyroscope."""

    def force(block: TriadSamples) -> TriadSamples:
        if block.unit != calibration.accelerometer.unit:
            raise _other_unit(calibration.accelerometer.unit, block.unit)
        return TriadSamples(
            t_ns=block.t_ns, values=calibration.accelerometer.specific_force(block.values), unit="m/s^2"
        )

    gyroscope = calibration.gyroscope
    if gyroscope is None or stream.gyroscope is None:
        for block in map(force, stream.accelerometer):
            yield block.t_ns, block.values
        return
    at_gyroscope = _Synchroniser(Rows(stream.accelerometer, force))
    for block in stream.gyroscope:
        if block.unit != gyroscope.unit:
            raise _other_unit(gyroscope.unit, block.unit)
        acting = at_gyroscope.force(block.t_ns)
        yield block.t_ns, np.column_stack([gyroscope.angular_rate(block.values, acting), acting])


class _Synchroniser:
    """Brings specific force to the stamps of consecutive gyroscope blocks, as `calibration.interpolate_triad` does."""

    def __init__(self, rows: Rows) -> None:
        self._rows = rows
        self._equal = True  # so far the stamps were the same
        self._origin: int | None = None
        self._last: int | None = None
        self._support: tuple[Integers, Floats] | None = None  # the last row of equal stamps

    def force(self, t_ns: Integers) -> Floats:
        """Return specific force (k, 3) at stamps (k,).

        Raises
        ------
        RecordingError
            If stamps that must be interpolated go backwards.
        """
        rows = self._rows
        rows.fill(len(t_ns))
        if not len(rows.t_ns):
            return np.zeros((len(t_ns), 3))
        if self._origin is None:
            self._origin = int(min(rows.t_ns[0], t_ns[0]))
        if self._equal and np.array_equal(rows.t_ns[: len(t_ns)], t_ns):
            force = rows.values[: len(t_ns)]
            self._support = (t_ns[-1:], force[-1:])
            rows.drop(len(t_ns))
            return force
        if self._equal and self._support is not None:  # the stamps part company here
            rows.put_back(*self._support)
        self._equal = False
        return self._interpolated(t_ns)

    def _interpolated(self, t_ns: Integers) -> Floats:
        rows, origin = self._rows, self._origin or 0
        if (np.diff(t_ns) < 0).any() or (self._last is not None and t_ns[0] < self._last):
            raise RecordingError(
                "the gyroscope's stamps go backwards, so that the accelerometer's samples cannot be brought to them. "
                "`gnomon check` says where; sort or cut the recording."
            )
        self._last = int(t_ns[-1])
        rows.reach(self._last)
        at, support = (t_ns - origin) * 1e-9, (rows.t_ns - origin) * 1e-9
        force = np.column_stack([np.interp(at, support, rows.values[:, axis]) for axis in range(3)])
        rows.drop(max(0, int(np.searchsorted(rows.t_ns, self._last, side="right")) - 1))
        return force


def _other_unit(expected: str, found: str) -> FormatError:
    return FormatError(
        f"the calibration is for measurements in {expected}, the samples are in {found}. "
        "Read the recording with the units that it had when it was calibrated (--units)."
    )
