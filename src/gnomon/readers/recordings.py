"""Reading recordings: find the format by the content, put the triads together, recognise their units."""

from pathlib import Path

import numpy as np

from ..errors import OptionError, RecordingError
from ..recording import Floats, ImuSamples, Integers, Recording, Source, TriadSamples
from ..units import Units
from .column_roles import HELP
from .files import NPZ_MAGIC, file_source, first_bytes, read_text
from .folder import recording_files
from .recognise import WITH_RESTS, Recogniser, accelerometer_is_first
from .table import Table, Triad, read_table

StampedTriad = tuple[Integers, Triad]


def read(
    *paths: str | Path,
    columns: str | None = None,
    rate_hz: float | None = None,
    units: str | Units | None = None,
) -> Recording:
    """Read a recording.

    Parameters
    ----------
    paths : a file, a folder, or an accelerometer file and a gyroscope file; text may be gzipped
    columns : what the columns of a text table are, such as "t ax ay az gx gy gz"; _ skips a column
    rate_hz : sample rate of a recording without stamps [Hz]
    units : "si", "raw" or a list such as "g deg/s us"; recognised from headers and magnitudes where not given

    Raises
    ------
    RecordingError
        If something cannot be read or understood; the message says where, and what to do.
    OptionError
        If an option does not fit the recording.
    """
    return read_recognising(WITH_RESTS, *paths, columns=columns, rate_hz=rate_hz, units=units)


def read_recognising(
    recogniser: Recogniser,
    *paths: str | Path,
    columns: str | None = None,
    rate_hz: float | None = None,
    units: str | Units | None = None,
) -> Recording:
    """Read a recording like `read`, with what tells the units from the values where nothing states them."""
    stated = Units() if units is None else Units.parse(units) if isinstance(units, str) else units
    if rate_hz is not None and not (rate_hz > 0 and np.isfinite(rate_hz)):
        raise OptionError(f"rate {rate_hz:g} Hz must be greater than zero.")
    files = recording_files(paths)
    if first_bytes(files[0]).startswith(NPZ_MAGIC):
        return _read_npz(files, columns, rate_hz, stated, recogniser)
    texts = [read_text(path) for path in files]
    tables = [read_table(text, columns, rate_hz, stated) for text in texts]
    notes = [note for table in tables for note in table.notes]
    pair = len(files) == 2
    streams = in_two_files(tables, files, notes) if pair else in_one_file(tables[0], files[0].name, notes)
    return Recording(
        imus={"imu0": _samples(*streams, stated, recogniser, notes)},
        sources=tuple(text.source for text in texts),
        assumptions=tuple(notes),
    )


def _read_npz(
    files: list[Path], columns: str | None, rate_hz: float | None, stated: Units, recogniser: Recogniser
) -> Recording:
    if columns is not None:
        raise OptionError(f"columns are for text tables; {files[0].name} is an NPZ file, whose arrays have names.")
    if len(files) != 1:
        raise OptionError("give one NPZ file; both triads are in it.")
    from .npz import read_npz  # zipfile takes its time

    notes: list[str] = []
    imus: dict[str, ImuSamples] = {}
    tables = read_npz(files[0], rate_hz)
    for imu, parts in tables.items():
        notes += [note for part in parts for note in part.notes]
        streams: list[StampedTriad] = [(part.t_ns, part.triads[0]) for part in parts]
        said: list[str] = []
        imus[imu] = _samples(streams[0], streams[1] if len(streams) > 1 else None, stated, recogniser, said)
        notes += [f"{imu} {note}" if len(tables) > 1 else note for note in said]
    source: Source = file_source(files[0])
    return Recording(imus=imus, sources=(source,), assumptions=tuple(notes))


def in_one_file(table: Table, where: str, notes: list[str]) -> tuple[StampedTriad, StampedTriad | None]:
    """Return accelerometer and gyroscope of a table that holds both, or of an accelerometer alone."""
    if len(table.triads) == 1:
        (triad,) = table.triads
        if triad.quantity != "accelerometer":
            sensor = "a triad without name" if triad.quantity == "unnamed" else "only a gyroscope"
            raise RecordingError(
                f"{where}: found {sensor}; an accelerometer is needed. Give the other file too, or: {HELP}"
            )
        return (table.t_ns, triad), None
    first, second = table.triads
    if first.quantity == "unnamed":
        found, reason = accelerometer_is_first(first.values, second.values)
        if found is None:
            raise RecordingError(
                f"{where}: no header, and the values do not tell which three columns are the accelerometer. {HELP}"
            )
        notes.append(f"{where}: the {'first' if found else 'last'} three columns are the accelerometer ({reason}).")
        first, second = (first, second) if found else (second, first)
    return (table.t_ns, first), (table.t_ns, second)


def in_two_files(tables: list[Table], files: list[Path], notes: list[str]) -> tuple[StampedTriad, StampedTriad]:
    """Return accelerometer and gyroscope of two tables: by header, else by file name, else by their values."""
    names = [path.name for path in files]
    for table, name in zip(tables, names, strict=True):
        if len(table.triads) != 1:
            raise RecordingError(f"{name}: found two triads; of two files, each must hold one. Give this file alone.")
    streams: list[StampedTriad] = [(table.t_ns, table.triads[0]) for table in tables]
    quantities = [triad.quantity for _, triad in streams]
    if quantities.count("accelerometer") == 2 or quantities.count("gyroscope") == 2:
        both = "an accelerometer" if quantities[0] == "accelerometer" else "a gyroscope"
        raise RecordingError(f"{names[0]} and {names[1]}: both hold {both}. One of each is needed.")
    if quantities != ["unnamed", "unnamed"]:
        first = quantities[0] == "accelerometer" or quantities[1] == "gyroscope"
        return (streams[0], streams[1]) if first else (streams[1], streams[0])
    hints = ["acc" in name.lower() and "gyr" not in name.lower() for name in names]
    if hints[0] != hints[1]:
        first, reason = hints[0], "by its name"
    else:
        found, reason = accelerometer_is_first(streams[0][1].values, streams[1][1].values)
        first, reason = (True, "given first") if found is None else (found, reason)
    notes.append(f"{names[0 if first else 1]} is the accelerometer ({reason}).")
    return (streams[0], streams[1]) if first else (streams[1], streams[0])


def _samples(
    accel: StampedTriad, gyro: StampedTriad | None, stated: Units, recogniser: Recogniser, notes: list[str]
) -> ImuSamples:
    """Make samples with units: stated, else named in the file, else recognised."""
    unit, reason = _known(stated.accelerometer, accel[1].unit)
    if unit is None:
        found = recogniser.accelerometer(accel[1].values)
        unit, reason = found.unit, found.reason
    notes.append(f"accelerometer in {unit} ({reason}).")
    accelerometer = TriadSamples(t_ns=accel[0], values=accel[1].values, unit=unit)
    if gyro is None:
        notes.append("no gyroscope in this recording.")
        return ImuSamples(
            accelerometer=accelerometer,
            gyroscope=TriadSamples(t_ns=np.empty(0, np.int64), values=np.empty((0, 3)), unit="rad/s"),
        )
    unit, reason = _known(stated.gyroscope, gyro[1].unit)
    if unit is None:
        found = recogniser.gyroscope(gyro[1].values, gyro[0], _force_at(gyro[0], accelerometer))
        unit, reason = found.unit, found.reason
    notes.append(f"gyroscope in {unit} ({reason}).")
    return ImuSamples(
        accelerometer=accelerometer, gyroscope=TriadSamples(t_ns=gyro[0], values=gyro[1].values, unit=unit)
    )


def _known(stated: str | None, named: str | None) -> tuple[str | None, str]:
    return (stated, "as stated") if stated is not None else (named, "as the file says")


def _force_at(t_ns: Integers, accelerometer: TriadSamples) -> Floats | None:
    """Return the accelerometer at the gyroscope's stamps where it is cheap and its zero is known; else None."""
    if accelerometer.unit == "count":
        return None
    if np.array_equal(t_ns, accelerometer.t_ns):
        return accelerometer.values
    if (np.diff(accelerometer.t_ns) < 0).any():
        return None
    t, at = accelerometer.t_ns - t_ns[0], t_ns - t_ns[0]
    return np.column_stack([np.interp(at, t, accelerometer.values[:, axis]) for axis in range(3)])
