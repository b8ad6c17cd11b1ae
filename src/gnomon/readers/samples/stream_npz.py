"""NPZ files block by block: the arrays in them are read like files, compressed or not; keys as in `samples.npz`."""

import zipfile
from collections.abc import Collection, Iterator
from contextlib import ExitStack
from itertools import count, islice
from math import prod
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import RecordingError
from ...formats.shared.structured import shorten_text
from ...frozen import value_class
from ...progress import tell_read
from ...recording import Integers, TriadSamples, measurable_numbers
from ...units import ACCELEROMETER_UNITS_M_S2, GYROSCOPE_UNITS_RAD_S, MAGNETOMETER_UNITS_UT
from ..files import ZIP_DAMAGE
from .npz import SensorArray, array_header, refuse_false_arrays, sensor_arrays
from .stream import TRIADS, Blocks, SampleStream, UnitChoice
from .table import guess_time_unit, to_ns, uniform_stamps

_SAMPLE_BYTES = 56
"""Of two triads at one timestamp."""

_UNITS = {
    "accelerometer": ACCELEROMETER_UNITS_M_S2,
    "gyroscope": GYROSCOPE_UNITS_RAD_S,
    "magnetometer": MAGNETOMETER_UNITS_UT,
}
_FIRST_ROWS = 100_000  # from which the unit of the accelerometer is recognised


def open_npz(
    path: Path, choice: UnitChoice, rate_hz: float | None, imu: str, *, triads: Collection[str], block_bytes: int
) -> SampleStream:
    """Open one IMU of an NPZ file; `triads` are those that are wanted.

    Raises
    ------
    RecordingError
        If a key is missing, or the file is damaged.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            refuse_false_arrays(archive, path.name)
            keys = {name.removesuffix(".npy") for name in archive.namelist()}
            rate = _rate(archive, keys, imu) if rate_hz is None else rate_hz
            arrays = _arrays(archive, keys, imu)
            if not arrays:
                listed = ", ".join(sorted(keys))[:200]
                raise RecordingError(f"{path.name}: no array named accelerometer for {imu}; found {listed}.")
            units = {array.stamps: _clock_unit(archive, array) for array in arrays.values()}
            rows = max(1, block_bytes // 24)
            clocks = {key: _Clock(path, key, unit, rows) for key, unit in units.items() if key is not None}
            streams = {
                name: _Triad(
                    path=path,
                    key=array.key,
                    clock=None if array.stamps is None else clocks[array.stamps],
                    rate_hz=rate,
                    unit=_chosen(archive, choice, name, array),
                    rows=rows,
                )
                for name, array in arrays.items()
                if name in triads
            }
    except ZIP_DAMAGE as error:
        raise _damaged(path, error) from None
    warm = _key(keys, imu, "temperature") is not None
    return SampleStream(**{name: triad.blocks() for name, triad in streams.items()}, thermometer=warm)


def _arrays(archive: zipfile.ZipFile, keys: set[str], imu: str) -> dict[str, SensorArray]:
    """Return the triads of an IMU, by gnomon's own keys, else by the sensors that the names of arrays tell."""
    own = {name: key for name in TRIADS if (key := _key(keys, imu, name)) is not None}
    if not own:
        return sensor_arrays(sorted(keys)) if imu == "imu0" else {}
    clocks: dict[int, str] = {}  # arrays of one length share their timestamps where they have none of their own
    found: dict[str, SensorArray] = {}
    for name, key in own.items():
        length = (_shape(archive, key) or (0,))[0]
        clock = _clock(keys, imu, name, shared=False) or clocks.get(length) or _clock(keys, imu, name)
        if clock is not None:
            clocks.setdefault(length, clock)
        unit = _unit(archive, _key(keys, imu, f"unit_{name}"), _UNITS[name])
        found[name] = SensorArray(key=key, unit=unit, stamps=clock)
    return found


def _clock_unit(archive: zipfile.ZipFile, array: SensorArray) -> str:
    """Return the unit of the timestamps: as their key says, else by their size."""
    if array.stamps is None or array.stamps.endswith(("_ns", "_s")):
        return "ns" if str(array.stamps).endswith("_ns") else "s"
    return guess_time_unit(next(_array(archive, array.stamps, _FIRST_ROWS), np.empty(0)))[0]


def _chosen(archive: zipfile.ZipFile, choice: UnitChoice, name: str, array: SensorArray) -> str:
    if name == "accelerometer":
        first = iter(()) if array.unit or choice.stated.accelerometer else _array(archive, array.key, _FIRST_ROWS)
        return choice.accelerometer(array.unit, next(first, np.empty((0, 3))))
    return choice.gyroscope(array.unit) if name == "gyroscope" else choice.magnetometer(array.unit)


class _Clock:
    """Timestamps of a file in blocks; triads that are read in turns unpack each of them once."""

    def __init__(self, path: Path, key: str, unit: str, rows: int) -> None:
        self.key = key
        self._path, self._unit, self._rows = path, unit, rows
        self._last, self._number = np.empty(0, np.int64), -1

    def blocks(self, archive: zipfile.ZipFile) -> Iterator[Integers]:
        """Yield the timestamps [ns]."""
        own, taken = _array(archive, self.key, self._rows), 0
        for number in count():
            if number != self._number:
                self._last = to_ns(next(islice(own, number - taken, None)), self._unit, self._path.name)
                self._number, taken = number, number + 1
            yield self._last


@value_class
class _Triad:
    """One triad of an NPZ file; rows is the length of a block."""

    path: Path
    key: str
    clock: _Clock | None
    rate_hz: float | None
    unit: str
    rows: int

    def __post_init__(self) -> None:
        if self.clock is None and self.rate_hz is None:
            name = self.path.name
            raise RecordingError(f"{name}: no timestamps (t_ns, t_s) for {self.key} and no rate_hz. State --rate.")

    def blocks(self) -> Blocks:
        """Yield the samples; the file stays open as long."""
        try:
            with zipfile.ZipFile(self.path) as archive:
                yield from self._blocks(archive)
        except ZIP_DAMAGE as error:
            raise _damaged(self.path, error) from None

    def _blocks(self, archive: zipfile.ZipFile) -> Blocks:
        shape = _shape(archive, self.key)
        if len(shape) != 2 or shape[1] != 3:
            raise RecordingError(f"{self.path.name}: {self.key} has shape {shape}, expected (n, 3).")
        if self.clock is not None and _shape(archive, self.clock.key) != shape[:1]:
            stamps = _shape(archive, self.clock.key)
            raise RecordingError(
                f"{self.path.name}: {shape[0]} samples of {self.key}, but timestamps of shape {stamps}."
            )
        clock = None if self.clock is None else self.clock.blocks(archive)
        done = 0
        for raw in _array(archive, self.key, self.rows):
            values = np.ascontiguousarray(raw, dtype=np.float64)
            good = measurable_numbers(values).all(axis=1)
            if not good.all():
                raise RecordingError(
                    f"{self.path.name}, {self.key}: sample {done + int(np.argmin(good))} is NaN or infinite. "
                    "Remove such samples; gnomon treats the gap as such."
                )
            if clock is None:
                t_ns = uniform_stamps(len(raw), 0.0 if self.rate_hz is None else self.rate_hz, done)
            else:
                t_ns = next(clock)
            yield TriadSamples(t_ns=t_ns, values=values, unit=self.unit)
            done += len(raw)
            tell_read(self.path.name, done * _SAMPLE_BYTES, shape[0] * _SAMPLE_BYTES)


def _array(archive: zipfile.ZipFile, key: str, rows: int) -> Iterator[NDArray[Any]]:
    """Yield an array of the archive in blocks of rows; of one in Fortran order, each column is read on its own."""
    with ExitStack() as stack:

        def opened(skip: int = 0) -> Any:
            member = stack.enter_context(archive.open(f"{key}.npy"))
            header = array_header(member)
            member.seek(skip, 1)
            return member, header

        member, (shape, fortran, dtype) = opened()
        if dtype.kind not in "fiu":
            raise RecordingError(f"{archive.filename}: {key} holds {dtype}, expected numbers.")
        columns = prod(shape[1:])
        if columns not in {1, 3}:
            raise RecordingError(
                f"{archive.filename}: {key} has the shape {shape}, expected (n, 3), or (n,) of timestamps."
            )
        members = [member]
        if fortran and columns > 1:
            members += [opened(i * shape[0] * dtype.itemsize)[0] for i in range(1, columns)]
        for start in range(0, shape[0], rows):
            count = min(rows, shape[0] - start)
            wide = count * (1 if len(members) > 1 else columns)
            parts = [np.frombuffer(one.read(wide * dtype.itemsize), dtype) for one in members]
            yield np.column_stack(parts) if len(parts) > 1 else parts[0].reshape(count, *shape[1:])


def _shape(archive: zipfile.ZipFile, key: str) -> tuple[int, ...]:
    with archive.open(f"{key}.npy") as member:
        return array_header(member)[0]


def _rate(archive: zipfile.ZipFile, keys: set[str], imu: str) -> float | None:
    key = _key(keys, imu, "rate_hz")
    if key is None:
        return None
    with archive.open(f"{key}.npy") as member:
        return float(np.lib.format.read_array(member, allow_pickle=False))


def _unit(archive: zipfile.ZipFile, key: str | None, known: dict[str, float | None]) -> str | None:
    if key is None:
        return None
    with archive.open(f"{key}.npy") as member:
        unit = str(np.lib.format.read_array(member, allow_pickle=False))
    if unit not in known:
        raise RecordingError(f'{archive.filename}: {key} is "{unit}", expected one of {", ".join(known)}.')
    return unit


def _key(keys: set[str], imu: str, name: str) -> str | None:
    """Return the key of an array; "imu0." may be left out."""
    full = f"{imu}.{name}"
    if full in keys:
        return full
    return name if imu == "imu0" and name in keys else None


def _clock(keys: set[str], imu: str, quantity: str, *, shared: bool = True) -> str | None:
    names = [f"t_{quantity}_ns", f"t_{quantity}_s", *(["t_ns", "t_s"] if shared else [])]
    return next((key for name in names if (key := _key(keys, imu, name)) is not None), None)


def _damaged(path: Path, error: Exception) -> RecordingError:
    return RecordingError(f"{path.name}: the NPZ file is damaged or holds Python objects ({shorten_text(str(error))}).")
