"""Recording -> NPZ or CSV that `gnomon.read` gives back as it was; poses as a table, or each as a file."""

import gzip
import io
import zipfile
from collections.abc import Iterable, Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import IO, Any, cast

import numpy as np
from numpy.typing import NDArray

from ..errors import OptionError
from ..output import atomic_file
from ..recording import Floats, ImuSamples, Poses, Recording, TemperatureSamples, TriadSamples

_CHUNK = 20_000  # rows; bounds the memory
_AXES = "xyz"


def save_recording(recording: Recording, path: str | Path) -> tuple[Path, ...]:
    """Write a recording, and return the files that were written.

    NPZ holds any recording; its keys are documented in `gnomon.readers.samples.npz`. CSV holds one IMU, with the units
    in its header; triads with timestamps of their own have files of their own, whose names end in -acc, -gyr and -mag.

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
    check_suffix(path)
    if path.name.lower().endswith(".npz"):
        with atomic_file(path) as stream:
            np.savez_compressed(stream, **_arrays(recording))  # pyright: ignore[reportArgumentType]
        return (path,)
    if len(recording.imus) != 1:
        raise OptionError(f"{path}: CSV holds one IMU, the recording has {len(recording.imus)}. Write .npz.")
    (imu,) = recording.imus.values()
    return _save_csv(imu, path)


def check_suffix(path: Path) -> None:
    """Check that a recording can be written under this name.

    Raises
    ------
    OptionError
        If its suffix is not one of those.
    """
    if not path.name.lower().endswith((".npz", ".csv", ".csv.gz")):
        raise OptionError(f"{path}: a recording is written as .npz, .csv or .csv.gz. Choose one of these suffixes.")


def _arrays(recording: Recording) -> dict[str, NDArray[Any]]:
    arrays: dict[str, NDArray[Any]] = {}
    for name, imu in recording.imus.items():
        prefix = "" if name == "imu0" else f"{name}."
        shared = np.array_equal(imu.accelerometer.t_ns, imu.gyroscope.t_ns)
        if shared and len(imu.accelerometer):
            arrays[f"{prefix}t_ns"] = imu.accelerometer.t_ns
        for quantity, samples in (
            ("accelerometer", imu.accelerometer),
            ("gyroscope", imu.gyroscope),
            ("magnetometer", imu.magnetometer),
        ):
            if samples is None or not len(samples):
                continue
            arrays[f"{prefix}{quantity}"] = samples.values
            arrays[f"{prefix}unit_{quantity}"] = np.array(samples.unit)
            if not shared or not np.array_equal(samples.t_ns, imu.accelerometer.t_ns):
                arrays[f"{prefix}t_{quantity}_ns"] = samples.t_ns
        if imu.temperature is not None:
            arrays[f"{prefix}temperature"] = imu.temperature.values
            arrays[f"{prefix}t_temperature_ns"] = imu.temperature.t_ns
            arrays[f"{prefix}unit_temperature"] = np.array(imu.temperature.unit)
    return arrays


def _save_csv(imu: ImuSamples, path: Path) -> tuple[Path, ...]:
    """Write triads that share their timestamps into one file, others into files of their own."""
    named = {"-acc": imu.accelerometer, "-gyr": imu.gyroscope, "-mag": imu.magnetometer}
    there = {name: samples for name, samples in named.items() if samples is not None and len(samples)}
    files: dict[str, list[TriadSamples]] = {}
    for name, samples in there.items():
        mate = next((key for key, group in files.items() if np.array_equal(group[0].t_ns, samples.t_ns)), name)
        files.setdefault(mate, []).append(samples)
    suffix = "".join(path.suffixes[-2:]) if path.name.lower().endswith(".gz") else path.suffix
    stem = path.name.removesuffix(suffix)
    letters = {id(samples): name[1] for name, samples in there.items()}
    written: list[Path] = []
    for name, group in files.items():
        one = path if len(files) == 1 else path.with_name(f"{stem}{name}{suffix}")
        _write_table(one, group, "".join(letters[id(samples)] for samples in group), imu.temperature)
        written.append(one)
    return tuple(written)


def _write_table(
    path: Path, triads: Sequence[TriadSamples], letters: str, temperature: TemperatureSamples | None
) -> None:
    """Write a table; a temperature with timestamps of its own is interpolated to those of the samples."""
    with atomic_file(path) as raw:
        # No name and no time in the gzip header: the same recording gives the same bytes.
        packed = path.name.lower().endswith(".gz")
        stream = cast("IO[bytes]", gzip.GzipFile("", "wb", fileobj=raw, mtime=0)) if packed else raw
        text = io.TextIOWrapper(stream, encoding="ascii", newline="")
        names = [f"{letter}{axis} [{t.unit}]" for t, letter in zip(triads, letters, strict=True) for axis in _AXES]
        columns = [triads[0].t_ns, *(t.values[:, axis] for t in triads for axis in range(3))]
        if temperature is not None and len(temperature):
            names.append(f"temperature [{temperature.unit}]")
            columns.append(np.interp(triads[0].t_ns, temperature.t_ns, temperature.values))
        text.write(",".join(["t_ns", *names]) + "\n")
        for first in range(0, len(triads[0]), _CHUNK):
            part = [_texts(column[first : first + _CHUNK]) for column in columns]
            text.writelines(",".join(row) + "\n" for row in zip(*part, strict=True))
        text.flush()
        text.detach()
        if packed:
            stream.close()


def _texts(column: NDArray[Any]) -> list[str]:
    """Return the shortest text of every number that reads back as the same number."""
    if column.dtype.kind == "f" and bool((np.abs(column) < 1e15).all()) and bool((column == np.rint(column)).all()):
        column = column.astype(np.int64)
    return list(map(repr, column.tolist()))


_EPOCH = (1980, 1, 1, 0, 0, 0)  # the same samples give the same bytes


def save_blocks(
    path: str | PathLike[str], sensors: Mapping[str, tuple[str, Iterable[Floats]]], *, samples: int, rate_hz: float
) -> None:
    """Write sensors with one sample rate and no timestamps, as numbers of single precision.

    Parameters
    ----------
    sensors : "accelerometer", "gyroscope" -> unit, and consecutive blocks (n, 3)
    samples : length of each
    rate_hz : sample rate [Hz]

    Raises
    ------
    OutputError
        If the file cannot be written.
    """
    with atomic_file(path) as stream, zipfile.ZipFile(stream, "w", zipfile.ZIP_STORED) as archive:
        _write(archive, "rate_hz", np.array(rate_hz))
        for name, (unit, blocks) in sensors.items():
            _write(archive, f"unit_{name}", np.array(unit))
            with archive.open(zipfile.ZipInfo(f"{name}.npy", _EPOCH), "w", force_zip64=True) as member:
                header = {"descr": "<f4", "fortran_order": False, "shape": (samples, 3)}
                np.lib.format.write_array_header_1_0(member, header)  # pyright: ignore[reportArgumentType]
                for block in blocks:
                    member.write(np.ascontiguousarray(block, "<f4").tobytes())


def _write(archive: zipfile.ZipFile, name: str, array: Any) -> None:
    with archive.open(zipfile.ZipInfo(f"{name}.npy", _EPOCH), "w") as member:
        np.lib.format.write_array(member, array, allow_pickle=False)


def save_poses(poses: Poses, path: str | Path) -> None:
    """Write a table of averaged poses, one row each; the columns are documented in `gnomon.readers.samples.poses`.

    Parameters
    ----------
    poses : the averages
    path : ends in .csv

    Raises
    ------
    OptionError
        If the suffix is another one.
    OutputError
        If the file cannot be written.
    """
    path = Path(path)
    if path.suffix.lower() != ".csv":
        raise OptionError(f"{path}: a table of poses is written as .csv.")
    header, columns = ["pose"], list[list[str]]([[name.replace(",", " ") for name in poses.name]])

    def add(names: list[str], values: Floats | None, unit: str) -> None:
        if values is not None:
            header.extend(f"{name} [{unit}]" for name in names)
            columns.extend([repr(float(x)) for x in column] for column in values.reshape(len(poses), -1).T)

    add(["t"], poses.t_s, "s")
    add([f"a{axis}" for axis in _AXES], poses.accelerometer, poses.accelerometer_unit)
    add([f"sigma_a{axis}" for axis in _AXES], poses.accelerometer_sigma, poses.accelerometer_unit)
    add([f"g{axis}" for axis in _AXES], poses.gyroscope, poses.gyroscope_unit)
    add([f"sigma_g{axis}" for axis in _AXES], poses.gyroscope_sigma, poses.gyroscope_unit)
    add([f"ref_{axis}" for axis in _AXES], poses.specific_force, "m/s^2")
    if poses.samples is not None:
        header.append("samples")
        columns.append([str(int(count)) for count in poses.samples])
    rows = [",".join(row) for row in zip(*columns, strict=True)]
    with atomic_file(path) as stream:
        stream.write(("\n".join([",".join(header), *rows]) + "\n").encode())


def save_pose_files(poses: Sequence[ImuSamples], folder: Path) -> list[Path]:
    """Write the samples of each pose into a file of its own, pose01.csv and so on, and return them.

    Raises
    ------
    OutputError
        If a file cannot be written.
    """
    digits = len(str(len(poses)))
    files: list[Path] = []
    for k, samples in enumerate(poses, start=1):
        files += save_recording(Recording(imus={"imu0": samples}), folder / f"pose{k:0{digits}}.csv")
    return files
