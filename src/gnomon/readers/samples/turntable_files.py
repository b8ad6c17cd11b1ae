"""Recordings on a turntable: one file, or one for each orientation or speed; the gyroscope may be alone."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ...errors import OptionError, RecordingError
from ...recording import ImuSamples, Recording, TriadSamples
from ...units import Units
from ..files import (
    NPZ_MAGIC,
    accelerometer_and_gyroscope,
    first_bytes,
    known_layout,
    pose_files,
    read_text_file,
    recording_files,
    sample_files,
)
from ..recordings import read_recognising, stated_units, without_magnetometer
from .recognise import WITH_RESTS
from .table import RATE_HELP, read_table


def turntable_files(paths: Sequence[str | Path]) -> tuple[tuple[Path, ...], ...]:
    """Return the files of each recording that paths mean: files, a folder of files, or one file for each triad.

    Raises
    ------
    OptionError
        If there is no path.
    RecordingError
        If a path does not exist, or a folder holds no file.
    """
    files = [Path(path) for path in paths]
    if not files:
        raise OptionError("no recording given. Name one file, several, or a folder.")
    for path in files:
        if not path.exists():
            raise RecordingError(f"{path}: there is no such file or folder. Check the path.")
    several = pose_files(files)
    if several is None and len(files) == 1 and files[0].is_dir():
        several = sample_files(files[0]) if known_layout(files[0]) is None else None
    several = several or files  # a folder without samples says so itself
    if len(several) == 1:
        return (tuple(recording_files(several)),)
    if any(path.is_dir() for path in several):
        raise OptionError("give one folder, or files.")
    pair = accelerometer_and_gyroscope(several) if len(several) == 2 else None
    return (pair,) if pair is not None else tuple((path,) for path in several)


def read_turntable(
    *paths: str | Path,
    columns: str | None = None,
    rate_hz: float | None = None,
    units: str | Units | None = None,
) -> Recording:
    """Read one recording, of which the gyroscope may be alone; see `gnomon.read` for the options.

    Parameters
    ----------
    paths : one file, a folder with one, or an accelerometer's and a gyroscope's

    Raises
    ------
    RecordingError
        If it cannot be read, or holds no gyroscope.
    OptionError
        If an option does not fit the recording.
    """
    files = recording_files(paths)
    try:
        alone = _gyroscope_alone(files[0], columns, rate_hz, units) if len(files) == 1 else None
        found = alone or read_recognising(WITH_RESTS, *files, columns=columns, rate_hz=rate_hz, units=units)
    except RecordingError as error:  # there --rate is the platter's
        raise type(error)(str(error).replace(RATE_HELP, RATE_HELP.replace("--rate", "--sample-rate"))) from None
    if not any(len(imu.gyroscope) for imu in found.imus.values()):
        raise RecordingError(
            f"{files[0].name}: no gyroscope in this recording. Give a file with the gyroscope, or say which columns "
            'are its own: --columns "t gx gy gz" (_ skips one).'
        )
    return found


def _gyroscope_alone(
    path: Path, columns: str | None, rate_hz: float | None, units: str | Units | None
) -> Recording | None:
    """Return the recording of a table that holds a gyroscope and no accelerometer; None of any other file."""
    if first_bytes(path).startswith(NPZ_MAGIC):
        return None
    stated = stated_units(units)
    if rate_hz is not None and not (rate_hz > 0 and np.isfinite(rate_hz)):
        raise OptionError(f"sample rate {rate_hz:g} Hz must be greater than zero.")
    text = read_text_file(path)
    table = read_table(text, columns, rate_hz, stated)
    tables, _, _ = without_magnetometer([table], [path])
    if not tables or len(tables[0].triads) != 1 or tables[0].triads[0].quantity == "accelerometer":
        return None
    (triad,) = tables[0].triads
    notes = [*table.notes]
    if triad.quantity == "unnamed":
        notes.append(f"{path.name}: its three columns are the gyroscope, as there is no other triad.")
    unit, reason = stated.gyroscope or triad.unit, "as stated" if stated.gyroscope else "as the file says"
    if unit is None:
        found = WITH_RESTS.gyroscope(triad.values, table.t_ns, None)
        unit, reason = found.unit, found.reason
    notes.append(f"gyroscope in {unit} ({reason}).")
    return Recording(
        imus={
            "imu0": ImuSamples(
                accelerometer=TriadSamples(t_ns=np.empty(0, np.int64), values=np.empty((0, 3)), unit="m/s^2"),
                gyroscope=TriadSamples(t_ns=table.t_ns, values=triad.values, unit=unit),
            )
        },
        sources=(text.source,),
        assumptions=tuple(notes),
    )
