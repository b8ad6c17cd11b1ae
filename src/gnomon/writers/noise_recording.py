"""Long recordings as NPZ files, written block by block; `readers.samples.npz` reads them."""

import zipfile
from collections.abc import Iterable, Mapping
from os import PathLike
from typing import Any

import numpy as np

from ..output import atomic_file
from ..recording import Floats

_EPOCH = (1980, 1, 1, 0, 0, 0)  # the same samples give the same bytes


def save_blocks(
    path: str | PathLike[str], sensors: Mapping[str, tuple[str, Iterable[Floats]]], *, samples: int, rate_hz: float
) -> None:
    """Write sensors with one sample rate and no stamps, as numbers of single precision.

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
