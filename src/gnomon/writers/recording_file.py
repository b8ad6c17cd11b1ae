"""Recording -> NPZ or CSV that `gnomon.read` gives back as it was."""

import gzip
import io
from collections.abc import Sequence
from pathlib import Path
from typing import IO, Any, cast

import numpy as np
from numpy.typing import NDArray

from ..errors import OptionError
from ..output import atomic_file
from ..recording import ImuSamples, Recording, TriadSamples

_CHUNK = 20_000  # rows; bounds the memory
_AXES = "xyz"


def save_recording(recording: Recording, path: str | Path) -> tuple[Path, ...]:
    """Write a recording, and return the files that were written.

    NPZ holds any recording; its keys are documented in `gnomon.readers.npz`. CSV holds one IMU, with the units in its
    header; where the triads have stamps of their own it is a pair of files, whose names end in -acc and -gyr.

    Parameters
    ----------
    recording : one or more IMUs
    path : its suffix says the format: .npz, .csv or .csv.gz

    Raises
    ------
    OptionError
        If the suffix is another one, or CSV is asked for several IMUs.
    OutputError
        If a file cannot be written.
    """
    path = Path(path)
    name = path.name.lower()
    if name.endswith(".npz"):
        with atomic_file(path) as stream:
            np.savez_compressed(stream, **_arrays(recording))  # pyright: ignore[reportArgumentType]
        return (path,)
    if not name.endswith((".csv", ".csv.gz")):
        raise OptionError(f"{path}: a recording is written as .npz, .csv or .csv.gz. Choose one of these suffixes.")
    if len(recording.imus) != 1:
        raise OptionError(f"{path}: CSV holds one IMU, the recording has {len(recording.imus)}. Write .npz.")
    (imu,) = recording.imus.values()
    return _save_csv(imu, path)


def _arrays(recording: Recording) -> dict[str, NDArray[Any]]:
    arrays: dict[str, NDArray[Any]] = {}
    for name, imu in recording.imus.items():
        prefix = "" if name == "imu0" else f"{name}."
        shared = np.array_equal(imu.accelerometer.t_ns, imu.gyroscope.t_ns)
        if shared:
            arrays[f"{prefix}t_ns"] = imu.accelerometer.t_ns
        for quantity, samples in (("accelerometer", imu.accelerometer), ("gyroscope", imu.gyroscope)):
            if not len(samples):
                continue
            arrays[f"{prefix}{quantity}"] = samples.values
            arrays[f"{prefix}unit_{quantity}"] = np.array(samples.unit)
            if not shared:
                arrays[f"{prefix}t_{quantity}_ns"] = samples.t_ns
    return arrays


def _save_csv(imu: ImuSamples, path: Path) -> tuple[Path, ...]:
    accelerometer, gyroscope = imu.accelerometer, imu.gyroscope
    if not len(gyroscope):
        _write_table(path, (accelerometer,), "a")
        return (path,)
    if np.array_equal(accelerometer.t_ns, gyroscope.t_ns):
        _write_table(path, (accelerometer, gyroscope), "ag")
        return (path,)
    suffix = "".join(path.suffixes[-2:]) if path.name.lower().endswith(".gz") else path.suffix
    stem = path.name.removesuffix(suffix)
    pair = path.with_name(f"{stem}-acc{suffix}"), path.with_name(f"{stem}-gyr{suffix}")
    _write_table(pair[0], (accelerometer,), "a")
    _write_table(pair[1], (gyroscope,), "g")
    return pair


def _write_table(path: Path, triads: Sequence[TriadSamples], letters: str) -> None:
    with atomic_file(path) as raw:
        # No name and no time in the gzip header: the same recording gives the same bytes.
        packed = path.name.lower().endswith(".gz")
        stream = cast("IO[bytes]", gzip.GzipFile("", "wb", fileobj=raw, mtime=0)) if packed else raw
        text = io.TextIOWrapper(stream, encoding="ascii", newline="")
        names = [f"{letter}{axis} [{t.unit}]" for t, letter in zip(triads, letters, strict=True) for axis in _AXES]
        text.write(",".join(["t_ns", *names]) + "\n")
        for first in range(0, len(triads[0]), _CHUNK):
            part = slice(first, first + _CHUNK)
            columns = [triads[0].t_ns[part], *(t.values[part, axis] for t in triads for axis in range(3))]
            text.writelines(",".join(row) + "\n" for row in zip(*map(_texts, columns), strict=True))
        text.flush()
        text.detach()
        if packed:
            stream.close()


def _texts(column: NDArray[Any]) -> list[str]:
    """Return the shortest text of every number that reads back as the same number."""
    if column.dtype.kind == "f" and bool((np.abs(column) < 1e15).all()) and bool((column == np.rint(column)).all()):
        column = column.astype(np.int64)
    return list(map(repr, column.tolist()))
