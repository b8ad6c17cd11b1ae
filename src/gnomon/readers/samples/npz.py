"""Format "npz": NumPy arrays with the keys below. `gnomon simulate` writes it, too.

    accelerometer          (n, 3)  as measured; may be missing where there is a magnetometer
    gyroscope              (m, 3)  as measured; may be missing
    magnetometer           (k, 3)  as measured; may be missing
    t_ns or t_s            (n,)    timestamps of all triads [ns, integer] or [s]
    t_accelerometer_ns, t_gyroscope_ns, t_magnetometer_ns (or _s)    where the triads have timestamps of their own
    t_temperature_ns (or _s)    the same of the thermometer
    temperature            (j,)    of the thermometer; may be missing
    rate_hz                ()      instead of timestamps
    unit_accelerometer     "m/s^2", "g", "mg" or "count"; recognised where it is missing
    unit_gyroscope         "rad/s", "deg/s", "mdeg/s" or "count"; recognised where it is missing
    unit_temperature       "degC", "K", "degF", "count" or such as "MPU-6050 count"; recognised where it is missing
    unit_magnetometer      "uT", "nT", "T", "gauss", "mgauss" or "count"; recognised where it is missing

Keys of a second IMU begin with "imu1.", such as "imu1.accelerometer", and so on; "imu0." may be left out.

Files of others whose arrays are named after a sensor, such as acc_g and t_acc_g, are read too
(`readers.samples.npz`).
"""

import io
import os
import warnings
import zipfile
from collections.abc import Collection, Mapping
from dataclasses import replace
from io import BufferedReader
from math import prod
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import RecordingError
from ...formats.shared.structured import shorten_text
from ...frozen import value_class
from ...progress import tell_read
from ...recording import Floats, Integers, TemperatureSamples, measurable_numbers
from ...units import ACCELEROMETER_UNITS_M_S2, GYROSCOPE_UNITS_RAD_S, MAGNETOMETER_UNITS_UT, TEMPERATURE_UNITS_DEGC
from ..files import ZIP_DAMAGE, refuse_zip_bomb
from .column_names import column_name
from .table import SampleTable, Triad, guess_time_unit, temperature_samples, to_ns, uniform_stamps

_STAMPS = ("t", "time", "times", "timestamp", "timestamps", "stamp", "stamps", "ts")
_PREFIXES = ("t", "time", "timestamp", "ts")
_BUFFER_BYTES = 1 << 20


@value_class(eq=True)
class SensorArray:
    """One array of samples: its key, its unit where the name tells it, and the key of its timestamps, or None."""

    key: str
    unit: str | None
    stamps: str | None


def sensor_arrays(keys: Collection[str]) -> dict[str, SensorArray]:
    """Return the sensors that the names of arrays tell, "accelerometer", "gyroscope", "magnetometer" -> array.

    A sensor that two arrays seem to be is none of them.

    Examples
    --------
    >>> sensor_arrays(["mag_gauss", "t_mag_gauss", "temp_c"])["magnetometer"]
    SensorArray(key='mag_gauss', unit='gauss', stamps='t_mag_gauss')
    """
    found: dict[str, list[SensorArray]] = {}
    for key in keys:
        if key.split("_", 1)[0].lower() in _STAMPS:
            continue
        head, _, tail = key.partition("_")
        name = column_name(f"{head}_x_{tail}")  # "acc_g" is named like its columns, "acc_x_g"
        if name.axis is not None and name.quantity in {"accelerometer", "gyroscope", "magnetometer"}:
            array = SensorArray(key=key, unit=name.unit, stamps=_stamps_of_columns(key, head, keys))
            found.setdefault(name.quantity, []).append(array)
    return {quantity: arrays[0] for quantity, arrays in found.items() if len(arrays) == 1}


def _stamps_of_columns(key: str, sensor: str, keys: Collection[str]) -> str | None:
    own = [f"{prefix}_{name}" for name in (key, sensor) for prefix in _PREFIXES]
    own += [f"{name}_{prefix}" for name in (key, sensor) for prefix in _PREFIXES]
    return next((name for name in (*own, *_STAMPS) if name in keys), None)


_UNITS = {
    "accelerometer": ACCELEROMETER_UNITS_M_S2,
    "gyroscope": GYROSCOPE_UNITS_RAD_S,
    "magnetometer": MAGNETOMETER_UNITS_UT,
}


def read_npz(path: Path, rate_hz: float | None) -> dict[str, list[SampleTable]]:
    """Read the IMUs of an NPZ file, each as tables of one triad.

    Raises
    ------
    RecordingError
        If the file is damaged, a key is missing, or an array has a wrong shape, NaN or infinity.
    """
    try:
        with path.open("rb") as file, zipfile.ZipFile(file) as packed:
            refuse_false_arrays(packed, path.name)
        with BufferedReader(ToldFile(path), _BUFFER_BYTES) as file, np.load(file, allow_pickle=False) as archive:
            wanted = {"accelerometer", "gyroscope", "magnetometer"}
            names = sorted({_imu(key) for key in archive.files if key.split(".")[-1] in wanted})
            found = {} if names else sensor_arrays(archive.files)
            if wanted.intersection(found):
                tables = [_read_named(archive, *item, path.name, rate_hz) for item in found.items()]
                return {"imu0": _with_named_temperature(archive, tables, path.name)}
            if not names:
                raise RecordingError(
                    f"{path.name}: no array named accelerometer; found {', '.join(archive.files)[:200] or 'nothing'}. "
                    "Save with the keys t_ns (or t_s), accelerometer, gyroscope, magnetometer."
                )
            return {name: _read_imu(archive, name, path.name, rate_hz) for name in names}
    except ZIP_DAMAGE as error:
        raise RecordingError(
            f"{path.name}: the NPZ file is damaged or holds Python objects ({shorten_text(str(error))})."
        ) from None


def _imu(key: str) -> str:
    return key.rpartition(".")[0] or "imu0"


def _read_named(
    archive: Mapping[str, Any], quantity: str, array: SensorArray, where: str, rate_hz: float | None
) -> SampleTable:
    """Read an array of somebody else's file that names its sensor."""
    values = _values(archive[array.key], f"{where}, {array.key}")
    note = f"{where}: {array.key} is the {quantity} (by its name"
    if array.stamps is None and rate_hz is None:
        raise RecordingError(f"{where}: no timestamps for {array.key} (such as t_{array.key}). State --rate.")
    if array.stamps is None or rate_hz is not None:
        t_ns = uniform_stamps(len(values), 0.0 if rate_hz is None else rate_hz)
        note += f"); {rate_hz:g} Hz as stated."
    else:
        stamps = np.squeeze(archive[array.stamps])
        if stamps.ndim != 1 or stamps.dtype.kind not in "fiu" or len(stamps) != len(values):
            raise RecordingError(
                f"{where}: {len(values)} samples in {array.key}, but timestamps {array.stamps} of shape {stamps.shape} "
                f"and type {stamps.dtype}."
            )
        unit, reason = guess_time_unit(stamps)
        t_ns = to_ns(stamps, unit, where)
        note += f"), with the timestamps {array.stamps} in {unit} ({reason})."
    t_ns.flags.writeable = False
    return SampleTable(t_ns=t_ns, triads=(Triad(quantity=quantity, values=values, unit=array.unit),), notes=(note,))


def _with_named_temperature(archive: Mapping[str, Any], tables: list[SampleTable], where: str) -> list[SampleTable]:
    """Return tables with the thermometer whose array and timestamps are named, "temp_c" and "t_temp_c"."""
    named = [
        key
        for key in archive
        if key.split("_", 1)[0].lower() not in _STAMPS and column_name(key).quantity == "temperature"
    ]
    for key in named[:1]:
        values, stamps = np.squeeze(archive[key]), _stamps_of_columns(key, key.partition("_")[0], list(archive))
        t_ns = tables[0].t_ns
        if stamps is not None:
            own = np.squeeze(archive[stamps])
            t_ns = to_ns(own, guess_time_unit(own)[0], where)
        try:
            temperature, note = _temperature(values, t_ns, None, where)
        except RecordingError as error:  # nobody says that it is the IMU's
            return [replace(tables[0], notes=(*tables[0].notes, f"{key} was left out: {error}")), *tables[1:]]
        if (unit := column_name(key).unit) is not None:
            temperature, note = temperature_samples(t_ns, temperature.values, unit)
        notes = (*tables[0].notes, f"{where}: {', '.join(named)}; {key} is the thermometer.", note)
        tables = [replace(tables[0], temperature=temperature, notes=notes), *tables[1:]]
    return tables


def _read_imu(archive: Mapping[str, Any], imu: str, where: str, rate_hz: float | None) -> list[SampleTable]:
    def get(name: str) -> NDArray[Any] | None:
        plain = archive.get(name) if imu == "imu0" else None
        return archive.get(f"{imu}.{name}", plain)

    shared: dict[int, Integers] = {}
    tables: list[SampleTable] = []
    for quantity, units in _UNITS.items():
        raw = get(quantity)
        if raw is None:
            continue
        values = _values(raw, f"{where}, {imu}, {quantity}")
        unit = get(f"unit_{quantity}")
        if unit is not None and str(unit) not in units:
            known = ", ".join(units)
            raise RecordingError(f'{where}: unit_{quantity} is "{unit}", expected one of {known}.')
        own = get(f"t_{quantity}_ns"), get(f"t_{quantity}_s")
        notes: list[str] = []
        t_ns = _stamps(own[0], own[1], where)
        if t_ns is None and len(values) in shared:
            t_ns = shared[len(values)]
        elif t_ns is None:
            t_ns = _stamps(get("t_ns"), get("t_s"), where)
        if t_ns is None:
            rate = rate_hz if rate_hz is not None else get("rate_hz")
            if rate is None:
                raise RecordingError(
                    f"{where}: no timestamps (t_ns, t_s) for the {quantity} and no rate_hz. State --rate."
                )
            t_ns = uniform_stamps(len(values), float(rate))
            notes.append(f"{where}: no timestamps for the {quantity}; {float(rate):g} Hz as stated.")
        if len(t_ns) != len(values):
            raise RecordingError(f"{where}: {len(values)} samples of the {quantity}, but {len(t_ns)} timestamps.")
        t_ns.flags.writeable = False
        shared[len(values)] = t_ns
        triad = Triad(quantity=quantity, values=values, unit=None if unit is None else str(unit))
        tables.append(SampleTable(t_ns=t_ns, triads=(triad,), notes=tuple(notes)))
    warmth = get("temperature")
    if warmth is not None and tables:
        t_ns = _stamps(get("t_temperature_ns"), get("t_temperature_s"), where)
        t_ns = shared.get(len(warmth)) if t_ns is None else t_ns
        temperature, note = _temperature(warmth, t_ns, get("unit_temperature"), where)
        tables[0] = replace(tables[0], temperature=temperature, notes=(*tables[0].notes, note))
    return tables


def _temperature(
    values: NDArray[Any], t_ns: Integers | None, unit: NDArray[Any] | None, where: str
) -> tuple[TemperatureSamples, str]:
    numbers = values.dtype.kind in "fiu" and values.ndim == 1 and bool(measurable_numbers(values).all())
    if not numbers or not len(values) or t_ns is None or len(t_ns) != len(values):
        raise RecordingError(
            f"{where}: temperature has shape {values.shape} and type {values.dtype}; expected (n,) numbers, with "
            "timestamps t_temperature_ns, or those of a triad of as many samples."
        )
    if unit is not None and str(unit) not in TEMPERATURE_UNITS_DEGC:
        raise RecordingError(
            f'{where}: unit_temperature is "{unit}", expected one of {", ".join(TEMPERATURE_UNITS_DEGC)}.'
        )
    return temperature_samples(t_ns, values.astype(np.float64), None if unit is None else str(unit))


def _values(raw: NDArray[Any], where: str) -> Floats:
    if raw.ndim != 2 or raw.shape[1] != 3 or raw.dtype.kind not in "fiu":
        raise RecordingError(f"{where}: expected numbers of shape (n, 3), found {raw.dtype} of shape {raw.shape}.")
    if len(raw) < 2:
        raise RecordingError(f"{where}: found {len(raw)} samples; a recording has many.")
    values: Floats = np.ascontiguousarray(raw, dtype=np.float64)
    good: NDArray[np.bool_] = measurable_numbers(values).all(axis=1)  # pyright: ignore[reportAssignmentType]
    if not good.all():
        raise RecordingError(
            f"{where}: sample {int(np.argmin(good))} is NaN or infinite ({int((~good).sum())} of {len(good)} are). "
            "Remove these samples; gnomon treats the gap as such."
        )
    values.flags.writeable = False
    return values


def _stamps(ns: NDArray[Any] | None, seconds: NDArray[Any] | None, where: str) -> Integers | None:
    stamps, unit = (ns, "ns") if ns is not None else (seconds, "s")
    if stamps is None:
        return None
    if stamps.ndim != 1 or stamps.dtype.kind not in "fiu":
        raise RecordingError(f"{where}: timestamps must be numbers (n,), found {stamps.dtype} of shape {stamps.shape}.")
    return to_ns(stamps, unit, where)


Header = tuple[tuple[int, ...], bool, np.dtype[Any]]
"""Shape, whether in Fortran order, and type of an array."""


def refuse_false_arrays(archive: zipfile.ZipFile, where: str) -> None:
    """Refuse an NPZ file that is a bomb, or has an array whose header states more numbers than follow it.

    Raises
    ------
    RecordingError
        If it is one.
    """
    refuse_zip_bomb(archive, where)
    for member in archive.infolist():
        if not member.filename.endswith(".npy"):
            continue
        with archive.open(member) as file:
            shape, _, dtype = array_header(file)
        if prod(shape) * max(dtype.itemsize, 1) > member.file_size or min(shape, default=0) < 0:
            raise RecordingError(
                f"{where}: the header of {member.filename[:80]} states the shape {str(shape)[:80]}, which is more than "
                f"its {member.file_size} bytes. Copy the file again."
            )


class ToldFile(io.FileIO):
    """A file that tells how much of it is read, wherever it is read; what stands around it buffers."""

    _done = 0

    def readinto(self, buffer: Any, /) -> int | None:
        """Read into a buffer, as a file does."""
        count = super().readinto(buffer)
        self._done += count or 0
        tell_read(Path(os.fsdecode(self.name)).name, self._done, os.fstat(self.fileno()).st_size)
        return count


def array_header(member: Any) -> Header:
    """Return what stands in front of an array.

    Raises
    ------
    ValueError
        If it is no header of NumPy.
    """
    version = np.lib.format.read_magic(member)
    read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    with warnings.catch_warnings():  # NumPy warns of headers in the spelling of Python 2
        warnings.simplefilter("ignore")
        shape, fortran, dtype = read(member)
    return shape, fortran, dtype
