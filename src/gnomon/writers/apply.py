"""A calibration applied to a recording of any length: block by block, with the arithmetic of `ImuCalibration.apply`.

The result is a CSV table of what was calibrated and recorded. It has one row for each gyroscope sample, else for each
accelerometer sample, else for each magnetometer sample. Other triads stand beside it: their own samples where they have
the same timestamps, else interpolated linearly to those of the row; of an accelerometer with a time shift, after that
was added to its timestamps. The specific force beside a rate is the one that the
gyroscope's correction used.
"""

import ctypes
import warnings
from collections.abc import Callable, Iterator
from dataclasses import replace
from os import PathLike
from pathlib import Path

import numpy as np
import orjson

from ..errors import FormatError, RecordingError
from ..kernel import array_out, load_kernel
from ..output import atomic_file
from ..progress import Progress
from ..readers.samples.stream import TRIADS, BlockRows, Blocks, SampleStream, open_stream, read_thermometer
from ..recording import Floats, Integers, TemperatureSamples, TriadSamples
from ..recording.thermometer import TemperatureCourse
from ..results.calibration import ImuCalibration
from ..units import Units

_FORCE, _RATE = ("ax [m/s^2]", "ay [m/s^2]", "az [m/s^2]"), ("wx [rad/s]", "wy [rad/s]", "wz [rad/s]")
_ROWS_AT_ONCE = 8192  # whose texts are in memory together


def _warn(sentence: str) -> None:
    warnings.warn(sentence, stacklevel=3)


def apply_files(
    calibration: ImuCalibration,
    *paths: str | Path,
    output: str | PathLike[str],
    columns: str | None = None,
    rate_hz: float | None = None,
    units: Units | None = None,
    imu: str = "imu0",
    temperature_c: float | None = None,
    strict: bool = False,
    warn: Progress = _warn,
) -> int:
    """Calibrate a recording from file to file and return the number of rows.

    Memory does not grow with its length, but for a calibration that depends on the temperature: the thermometer's
    readings are needed as a whole.

    Parameters
    ----------
    paths, columns, rate_hz : as for `gnomon.read`
    output : CSV with `t_ns`, angular rate [rad/s], specific force [m/s^2] and magnetic field in the body frame, of what
        was calibrated and recorded
    units : as for `gnomon.read`; where nothing tells otherwise they are those of the calibration
    imu : which IMU of an NPZ file
    temperature_c : of the chip throughout [degC], where the calibration depends on it; else its thermometer's readings
    strict : refuse a temperature beyond the range in which the calibration knows it
    warn : called with a sentence where there is such a temperature; a Python warning where not given

    Raises
    ------
    RecordingError
        If the recording cannot be read, or holds none of the sensors that were calibrated.
    FormatError
        If the samples are not in the units for which the calibration was made, the gyroscope's g-sensitivity needs a
        specific force that there is not, or the calibration a temperature.
    OutputError
        If the output cannot be written.
    """
    triads = {name: getattr(calibration, name) for name in TRIADS}
    expected = Units(**{name: None if triad is None else triad.unit for name, triad in triads.items()})
    wanted = [name for name, triad in triads.items() if triad is not None]
    _check_force(calibration)
    stream = open_stream(
        *paths, expected=expected, units=units, columns=columns, rate_hz=rate_hz, imu=imu, triads=wanted
    )

    def thermometer() -> TemperatureSamples | None:
        if temperature_c is not None:
            return TemperatureSamples(t_ns=np.array([0, 1_000_000_000]), values=np.full(2, temperature_c), unit="degC")
        return read_thermometer(*paths, columns=columns, rate_hz=rate_hz, units=units, imu=imu)

    stream, course = _at_reference(calibration, stream, thermometer, strict=strict, warn=warn)
    return write_calibrated(calibration, stream, output, course)


_NEAR_K = 0.5
"""How far beyond the range a temperature still counts as in it."""


def _at_reference(
    calibration: ImuCalibration,
    stream: SampleStream,
    thermometer: Callable[[], TemperatureSamples | None],
    *,
    strict: bool,
    warn: Progress,
) -> tuple[SampleStream, TemperatureCourse | None]:
    """Return a stream as it would be at the reference temperature, and the temperature; None where nothing needs it.

    Parameters
    ----------
    thermometer : called where something does
    """
    found = calibration.temperature
    if found is None or not found.changes:
        return stream, None
    course = calibration.temperature_course(thermometer())
    assert course is not None
    outside = np.mean((course.degc < found.low_degc - _NEAR_K) | (course.degc > found.high_degc + _NEAR_K))
    if outside > 0:
        span = f"{found.low_degc:.1f} to {found.high_degc:.1f} degC"
        told = f"in {100 * outside:.0f} % of the time the chip is beyond the range that is known, {span}"
        if strict:
            raise RecordingError(f"{told}. Leave out --strict to correct it as at the nearer end.")
        warn(f"{told}; corrected as at the nearer end.")

    def corrected(name: str, blocks: Blocks) -> Blocks:
        for block in blocks:
            yield calibration.triad_at_reference(name, block, course)

    there = {name: blocks for name in TRIADS if (blocks := getattr(stream, name)) is not None}
    return replace(SampleStream(), **{name: corrected(name, blocks) for name, blocks in there.items()}), course


def write_calibrated(
    calibration: ImuCalibration,
    stream: SampleStream,
    output: str | PathLike[str],
    course: TemperatureCourse | None = None,
) -> int:
    """Write calibrated samples of a stream, which is at the reference temperature, and return the number of rows.

    Parameters
    ----------
    course : of the temperature; None where nothing depends on it

    Raises
    ------
    RecordingError
        If the stream cannot be read on, holds nothing that was calibrated, or timestamps that must be interpolated go
        backwards.
    FormatError
        If the samples are not in the units for which the calibration was made, or the gyroscope's g-sensitivity needs a
        specific force that there is not.
    OutputError
        If the output cannot be written.
    """
    there = _triads(calibration, stream)
    names = _RATE * ("gyroscope" in there) + _FORCE * ("accelerometer" in there)
    if calibration.magnetometer is not None and "magnetometer" in there:
        names += tuple(f"m{axis} [{calibration.magnetometer.field_unit}]" for axis in "xyz")
    count = 0
    with atomic_file(output) as file:
        file.write((",".join(("t_ns", *names)) + "\n").encode())
        for t_ns, values in calibrated_blocks(calibration, stream, course):
            for first in range(0, len(t_ns), _ROWS_AT_ONCE):
                piece = slice(first, first + _ROWS_AT_ONCE)
                # JSON in place of repr: as exact, and five times as fast
                stamps, rows = (orjson.dumps(part[piece], option=orjson.OPT_SERIALIZE_NUMPY) for part in (t_ns, values))
                file.write(_lines(stamps, rows) if load_kernel() is None else join_columns(stamps, rows))
            count += len(t_ns)
    return count


def join_columns(first: bytes, others: bytes) -> memoryview:
    """Return the lines of a table, of the JSON texts of its first column and of the rows of all others."""
    library = load_kernel()
    assert library is not None
    lines = np.empty(len(first) + len(others), dtype=np.uint8)
    return lines[: library.gnomon_join_columns(ctypes.c_char_p(first), ctypes.c_char_p(others), array_out(lines))].data


def _lines(stamps: bytes, rows: bytes) -> bytes:
    """Return lines of the texts of an array (k,) and of one (k, n)."""
    both = zip(stamps[1:-1].split(b","), rows[2:-2].split(b"],["), strict=True)
    return b"\n".join([*map(b",".join, both), b""])


def calibrated_blocks(
    calibration: ImuCalibration, stream: SampleStream, course: TemperatureCourse | None = None
) -> Iterator[tuple[Integers, Floats]]:
    """Yield timestamps (k,) [ns] and, of what was calibrated and recorded, rate, force and field, (k, 3 n)."""
    there = _triads(calibration, stream)
    first = next(name for name in ("gyroscope", "accelerometer", "magnetometer") if name in there)
    beside = {
        name: _Synchroniser(BlockRows(blocks, _calibrator(calibration, name), name, first))
        for name, blocks in there.items()
        if name != first
    }
    if first != "gyroscope":
        for block in map(_calibrator(calibration, first), there[first]):
            yield block.t_ns, np.column_stack([block.values, *(other.at(block.t_ns) for other in beside.values())])
        return
    gyroscope = calibration.gyroscope
    assert gyroscope is not None
    for block in there[first]:
        _check_unit(gyroscope.unit, block)
        others = {name: other.at(block.t_ns) for name, other in beside.items()}
        acting = others.get("accelerometer", np.zeros((len(block), 3)))
        yield block.t_ns, np.column_stack([calibration.angular_rate(block, acting, course), *others.values()])


def _triads(calibration: ImuCalibration, stream: SampleStream) -> dict[str, Blocks]:
    """Return the triads that were calibrated and recorded, in the order of `TRIADS`."""
    calibrated = [name for name in TRIADS if getattr(calibration, name) is not None]
    there = {name: blocks for name in calibrated if (blocks := getattr(stream, name)) is not None}
    if not there:
        raise RecordingError(
            f"this calibration is of {' and '.join(calibrated)}, and the recording holds none of them. "
            "Give the recording of the same sensor, or name its columns (--columns)."
        )
    _check_force(calibration)
    if calibration.feels_force and "gyroscope" in there and "accelerometer" not in there:
        raise FormatError(
            "the gyroscope's g-sensitivity needs the specific force, and this recording holds no accelerometer. "
            "Record it too, or calibrate with --model basic."
        )
    return there


def _check_force(calibration: ImuCalibration) -> None:
    """Refuse a g-sensitivity without an accelerometer."""
    if calibration.feels_force and calibration.accelerometer is None:
        raise FormatError(
            "the gyroscope's g-sensitivity needs the specific force, and this calibration holds no accelerometer. "
            "Calibrate both together, or the gyroscope with --model basic."
        )


def _calibrator(calibration: ImuCalibration, name: str) -> Callable[[TriadSamples], TriadSamples]:
    """Return what makes specific force or magnetic field of a block of samples."""
    stamps: Callable[[Integers], Integers] = np.asarray
    if name == "accelerometer":
        accelerometer = calibration.required_accelerometer
        unit, si_unit, physical = accelerometer.unit, "m/s^2", accelerometer.specific_force
        stamps = accelerometer.with_gyroscope
    else:
        magnetometer = calibration.magnetometer
        assert magnetometer is not None
        unit, si_unit, physical = magnetometer.unit, magnetometer.field_unit, magnetometer.magnetic_field

    def calibrated(block: TriadSamples) -> TriadSamples:
        _check_unit(unit, block)
        return TriadSamples(t_ns=stamps(block.t_ns), values=physical(block.values), unit=si_unit)

    return calibrated


class _Synchroniser:
    """Brings one triad to the timestamps of consecutive blocks of another, as `calibration.interpolate_triad` does."""

    def __init__(self, rows: BlockRows) -> None:
        self._rows = rows
        self._equal = True  # so far the timestamps were the same
        self._origin: int | None = None
        self._last: int | None = None
        self._support: tuple[Integers, Floats] | None = None  # the last row of equal timestamps

    def at(self, t_ns: Integers) -> Floats:
        """Return the values (k, 3) at timestamps (k,).

        Raises
        ------
        RecordingError
            If timestamps that must be interpolated go backwards.
        """
        rows = self._rows
        rows.fill(len(t_ns))
        if not len(rows.t_ns):
            return np.zeros((len(t_ns), 3))
        if self._origin is None:
            self._origin = int(min(rows.t_ns[0], t_ns[0]))
        if self._equal and np.array_equal(rows.t_ns[: len(t_ns)], t_ns):
            values = rows.values[: len(t_ns)]
            self._support = (t_ns[-1:], values[-1:])
            rows.drop(len(t_ns))
            return values
        if self._equal and self._support is not None:  # the timestamps part company here
            rows.put_back(*self._support)
        self._equal = False
        return self._interpolated(t_ns)

    def _interpolated(self, t_ns: Integers) -> Floats:
        rows, origin = self._rows, self._origin or 0
        if (np.diff(t_ns) < 0).any() or (self._last is not None and t_ns[0] < self._last):
            raise RecordingError(
                f"the {rows.onto}'s timestamps go backwards, so that the {rows.what}'s samples cannot be brought to "
                "them. `gnomon check` says where; sort or cut the recording."
            )
        self._last = int(t_ns[-1])
        rows.reach(self._last)
        at, support = (t_ns - origin) * 1e-9, (rows.t_ns - origin) * 1e-9
        values = np.column_stack([np.interp(at, support, rows.values[:, axis]) for axis in range(3)])
        rows.drop(max(0, int(np.searchsorted(rows.t_ns, self._last, side="right")) - 1))
        return values


def _check_unit(expected: str, block: TriadSamples) -> None:
    if block.unit != expected:
        raise FormatError(
            f"the calibration is for measurements in {expected}, the samples are in {block.unit}. "
            "Read the recording with the units that it had when it was calibrated (--units)."
        )
