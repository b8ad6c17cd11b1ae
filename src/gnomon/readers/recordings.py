"""What was stated by the user and what was read so far, while a recording of several files is put together."""

import hashlib
from collections import defaultdict
from dataclasses import field, replace
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import OptionError, RecordingError
from ..frozen import value_class
from ..recording import Floats, ImuSamples, Integers, Recording, Source, TriadSamples
from ..recording.dataframes import dataframe_text, is_dataframe
from ..units import Units
from .devices.device_log import is_device_log
from .files import (
    FEWEST_FILES,
    NPZ_MAGIC,
    TextFile,
    accelerometer_and_gyroscope,
    file_source,
    first_bytes,
    known_layout,
    pose_files,
    read_text_file,
    recording_files,
    sample_files,
    several_recordings,
)
from .samples.poses import LARGEST_BYTES, join_pose_tables, read_pose_table
from .samples.recognise import HELP, WITH_RESTS, Recogniser, Unit, accelerometer_is_first, magnetometer_unit
from .samples.table import SampleTable, Triad, read_table


@value_class(eq=True)
class ReadLog:
    """What was stated, and lists that grow: the files, and sentences on what was assumed.

    Attributes
    ----------
    units : of what is read
    cameras_alone : whether IMUs are passed over; images may be numbered then, where nothing says when they were taken
    """

    units: Units
    cameras_alone: bool = False
    sources: list[Source] = field(default_factory=list[Source])
    notes: list[str] = field(default_factory=list[str])

    def note(self, text: str) -> None:
        """Keep a sentence, once."""
        if text not in self.notes:
            self.notes.append(text)


StampedTriad = tuple[Integers, Triad]
Streams = tuple[StampedTriad | None, StampedTriad | None, StampedTriad | None]
"""Accelerometer, gyroscope, magnetometer."""


def read(
    *paths: Any,
    columns: str | None = None,
    rate_hz: float | None = None,
    units: str | Units | None = None,
) -> Recording:
    """Read a recording of samples, or of averaged poses.

    Parameters
    ----------
    paths : a file, a folder, or an accelerometer file and a gyroscope file; text may be gzipped; three files or
        more, or a folder of such, are one pose each. Or a DataFrame of pandas or polars
    columns : what the columns of a text table are, such as "t ax ay az gx gy gz"; _ skips a column
    rate_hz : sample rate of a recording without timestamps [Hz]
    units : "si", "raw" or a list such as "g deg/s us"; recognised from headers and magnitudes where not given

    Raises
    ------
    RecordingError
        If something cannot be read or understood; the message says where, and what to do.
    OptionError
        If an option does not fit the recording.
    """
    for path in paths:
        if not isinstance(path, str | PathLike) and not is_dataframe(path):
            raise OptionError(f"gnomon.read takes paths, or a DataFrame, and was given a {type(path).__name__}.")
    frames = [path for path in paths if not isinstance(path, str | PathLike)]
    if frames:
        if len(paths) > 1:
            raise OptionError("a DataFrame holds a recording; of several things one at a time is read.")
        return _read_dataframe(frames[0], columns, rate_hz, units)
    logged = _read_logged(WITH_RESTS, paths, columns, rate_hz, units)
    if logged is not None:
        return logged
    poses = _read_poses(paths, columns, rate_hz, units)
    if poses is not None:
        return poses
    return read_recognising(WITH_RESTS, *paths, columns=columns, rate_hz=rate_hz, units=units)


def _read_logged(
    recogniser: Recogniser,
    paths: tuple[str | Path, ...],
    columns: str | None,
    rate_hz: float | None,
    units: str | Units | None,
) -> Recording | None:
    """Read what a camera or a phone logged; None where the paths are something else."""
    from .devices.device_log import read_device_log

    log = read_device_log(paths, columns, rate_hz)
    if log is None:
        return None
    notes: list[str] = list(log.notes)
    samples = samples_in_units(
        (log.accelerometer, log.gyroscope, log.magnetometer), _stated(units, None), recogniser, notes
    )
    samples = replace(samples, temperature=log.temperature)
    return Recording(imus={"imu0": samples}, sources=log.sources, assumptions=tuple(notes))


def _read_poses(
    paths: tuple[str | Path, ...], columns: str | None, rate_hz: float | None, units: str | Units | None
) -> Recording | None:
    """Read a table of averaged poses or files of one pose each; None where the paths are neither."""
    several = pose_files(paths)
    if several is not None:
        stated, notes = _stated(units, rate_hz), list[str]()
        _refuse_npz(several)
        if len(paths) == 1 and _are_recordings(several, columns, rate_hz, units):
            raise RecordingError(several_recordings(Path(paths[0]), several))
        texts = [read_text_file(path) for path in several]
        table, pieces, said = join_pose_tables(
            [read_table(text, columns, rate_hz, stated) for text in texts], [path.name for path in several]
        )
        tables, files, magnetometer = without_magnetometer([table], several[:1])
        streams = inertial_streams(tables, files, notes, alone=magnetometer is None)
        samples = samples_in_units((*streams, magnetometer), stated, WITH_RESTS, notes)
        sources = tuple(text.source for text in texts)
        return Recording(imus={"imu0": samples}, sources=sources, assumptions=(*said, *notes), pieces=pieces)
    if rate_hz is not None:
        return None
    files = recording_files(paths)
    if len(files) != 1 or not files[0].is_file() or files[0].stat().st_size > LARGEST_BYTES:
        return None
    if first_bytes(files[0]).startswith(NPZ_MAGIC):
        return None
    return read_pose_table(read_text_file(files[0]), columns, _stated(units, rate_hz))


def _stated(units: str | Units | None, rate_hz: float | None) -> Units:
    """Return the units as stated, and check the rate."""
    if rate_hz is not None and not (rate_hz > 0 and np.isfinite(rate_hz)):
        raise OptionError(f"rate {rate_hz:g} Hz must be greater than zero.")
    return stated_units(units)


def stated_units(units: str | Units | None) -> Units:
    """Return units as they were stated, in words or not at all.

    Raises
    ------
    OptionError
        If a word is no unit.
    """
    return Units.parse(units) if isinstance(units, str) else units or Units()


def read_recognising(
    recogniser: Recogniser,
    *paths: str | Path,
    columns: str | None = None,
    rate_hz: float | None = None,
    units: str | Units | None = None,
) -> Recording:
    """Read a recording like `read`, with what tells the units from the values where nothing states them."""
    logged = _read_logged(recogniser, paths, columns, rate_hz, units)
    if logged is not None:
        return logged
    stated = _stated(units, rate_hz)
    files = recording_files(paths)
    if first_bytes(files[0]).startswith(NPZ_MAGIC):
        return _read_npz(files, columns, rate_hz, stated, recogniser)
    texts = [read_text_file(path) for path in files]
    tables = [read_table(text, columns, rate_hz, stated) for text in texts]
    return _of_tables(recogniser, texts, files, tables, stated)


def _read_dataframe(frame: Any, columns: str | None, rate_hz: float | None, units: str | Units | None) -> Recording:
    """Read a DataFrame as the table that it is."""
    data = dataframe_text(frame)
    source = Source(name="DataFrame", sha256=hashlib.sha256(data).hexdigest())
    text = TextFile(name="DataFrame", data=data, source=source)
    stated = _stated(units, rate_hz)
    table = read_table(text, columns, rate_hz, stated)
    return _of_tables(WITH_RESTS, [text], [Path(text.name)], [table], stated)


def _of_tables(
    recogniser: Recogniser, texts: list[TextFile], files: list[Path], tables: list[SampleTable], stated: Units
) -> Recording:
    notes = [note for table in tables for note in table.notes]
    temperature = next((table.temperature for table in tables if table.temperature is not None), None)
    tables, files, magnetometer = without_magnetometer(tables, files)
    streams = inertial_streams(tables, files, notes, alone=magnetometer is None)
    samples = samples_in_units((*streams, magnetometer), stated, recogniser, notes)
    return Recording(
        imus={"imu0": replace(samples, temperature=temperature)},
        sources=tuple(text.source for text in texts),
        assumptions=tuple(notes),
    )


def _refuse_npz(files: list[Path]) -> None:
    """Refuse NPZ files among files of one pose each."""
    for path in files:
        if path.is_file() and first_bytes(path).startswith(NPZ_MAGIC):
            raise RecordingError(
                f"{path.name}: files of one pose each are read as tables of text, and this is an NPZ file. "
                "Give one NPZ file with all poses in it, or export each pose as CSV."
            )


def _read_npz(
    files: list[Path], columns: str | None, rate_hz: float | None, stated: Units, recogniser: Recogniser
) -> Recording:
    if columns is not None:
        raise OptionError(f"columns are for text tables; {files[0].name} is an NPZ file, whose arrays have names.")
    if len(files) != 1:
        raise OptionError("give one NPZ file; all triads are in it.")
    from .samples.npz import read_npz  # zipfile takes its time

    notes: list[str] = []
    imus: dict[str, ImuSamples] = {}
    tables = read_npz(files[0], rate_hz)
    for imu, parts in tables.items():
        notes += [note for part in parts for note in part.notes]
        streams: dict[str, StampedTriad] = {part.triads[0].quantity: (part.t_ns, part.triads[0]) for part in parts}
        said: list[str] = []
        three = streams.get("accelerometer"), streams.get("gyroscope"), streams.get("magnetometer")
        imus[imu] = replace(samples_in_units(three, stated, recogniser, said), temperature=parts[0].temperature)
        notes += [f"{imu} {note}" if len(tables) > 1 else note for note in said]
    source: Source = file_source(files[0])
    return Recording(imus=imus, sources=(source,), assumptions=tuple(notes))


def without_magnetometer(
    tables: list[SampleTable], files: list[Path]
) -> tuple[list[SampleTable], list[Path], StampedTriad | None]:
    """Return the tables that hold other triads, without the magnetometer; their files; and the magnetometer.

    Raises
    ------
    RecordingError
        If two files hold one.
    """
    found: list[StampedTriad] = []
    others: list[tuple[SampleTable, Path]] = []
    for table, path in zip(tables, files, strict=True):
        found += [(table.t_ns, triad) for triad in table.triads if triad.quantity == "magnetometer"]
        rest = tuple(triad for triad in table.triads if triad.quantity != "magnetometer")
        if rest:
            others.append((table if len(rest) == len(table.triads) else replace(table, triads=rest), path))
    if len(found) > 1:
        raise RecordingError(f"{files[0].name} and {files[1].name}: both hold a magnetometer. Give one of them alone.")
    return [table for table, _ in others], [path for _, path in others], found[0] if found else None


def inertial_streams(
    tables: list[SampleTable], files: list[Path], notes: list[str], *, alone: bool
) -> tuple[StampedTriad | None, StampedTriad | None]:
    """Return accelerometer and gyroscope; with a magnetometer (not alone) either may be missing."""
    if len(tables) == 2:
        return in_two_files(tables, files, notes)
    if not tables:
        return None, None
    (table,) = tables
    if not alone and [triad.quantity for triad in table.triads] == ["gyroscope"]:
        return None, (table.t_ns, table.triads[0])
    return in_one_file(table, files[0].name, notes)


def in_one_file(table: SampleTable, where: str, notes: list[str]) -> tuple[StampedTriad, StampedTriad | None]:
    """Return accelerometer and gyroscope of a table that holds both, or of an accelerometer alone."""
    if len(table.triads) == 1:
        (triad,) = table.triads
        if triad.quantity != "accelerometer":
            if triad.quantity == "unnamed":
                raise RecordingError(
                    f"{where}: found one triad without name, an accelerometer's, a gyroscope's or a magnetometer's. "
                    'Give the other file too, or say what the columns are: --columns "t ax ay az", "t gx gy gz" or '
                    '"t mx my mz" (_ skips a column).'
                )
            raise RecordingError(
                f"{where}: found only a gyroscope, not an accelerometer. Give the other file too, or: {table.advice}"
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


def in_two_files(tables: list[SampleTable], files: list[Path], notes: list[str]) -> tuple[StampedTriad, StampedTriad]:
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


def samples_in_units(streams: Streams, stated: Units, recogniser: Recogniser, notes: list[str]) -> ImuSamples:
    """Make samples with units: stated, else named in the file, else recognised."""
    known, made = defaultdict[str, list[str]](list), dict[str, TriadSamples]()

    def recognised(name: str, t_ns: Integers, values: Floats) -> Unit:
        if name == "gyroscope":
            return recogniser.gyroscope(values, t_ns, _force_at(t_ns, made.get("accelerometer")))
        return (recogniser.accelerometer if name == "accelerometer" else magnetometer_unit)(values)

    for name, stream in zip(("accelerometer", "gyroscope", "magnetometer"), streams, strict=True):
        if stream is None:
            continue
        t_ns, triad = stream
        unit, reason = _known(getattr(stated, name), triad.unit)
        if unit is None:
            found = recognised(name, t_ns, triad.values)
            unit, reason = found.unit, found.reason
        known[reason].append(f"{name} in {unit}")
        made[name] = TriadSamples(t_ns=t_ns, values=triad.values, unit=unit)
    notes += [f"{', '.join(triads)} ({reason})." for reason, triads in known.items()]
    missing = [name for name in ("accelerometer", "gyroscope") if name not in made]
    if missing:
        notes.append(f"no {' and no '.join(missing)} in this recording.")
    return ImuSamples(
        accelerometer=made.get("accelerometer", _nothing("m/s^2")),
        gyroscope=made.get("gyroscope", _nothing("rad/s")),
        magnetometer=made.get("magnetometer"),
    )


def _nothing(unit: str) -> TriadSamples:
    return TriadSamples(t_ns=np.empty(0, np.int64), values=np.empty((0, 3)), unit=unit)


def _known(stated: str | None, named: str | None) -> tuple[str | None, str]:
    return (stated, "as stated") if stated is not None else (named, "as the file says")


def _force_at(t_ns: Integers, accelerometer: TriadSamples | None) -> Floats | None:
    """Return the accelerometer at the gyroscope's timestamps where it is cheap and its zero is known; else None."""
    if accelerometer is None or accelerometer.unit == "count":
        return None
    if np.array_equal(t_ns, accelerometer.t_ns):
        return accelerometer.values
    if (np.diff(accelerometer.t_ns) < 0).any():
        return None
    t, at = accelerometer.t_ns - t_ns[0], t_ns - t_ns[0]
    return np.column_stack([np.interp(at, t, accelerometer.values[:, axis]) for axis in range(3)])


def recordings_in(path: Path) -> list[Path]:
    """Return the recordings that a path means where several are expected: the files of a folder, or the path itself."""
    if not path.is_dir() or known_layout(path) is not None or is_device_log([path]):
        return [path]
    files = sample_files(path)
    return files if len(files) > 1 and accelerometer_and_gyroscope(files) is None else [path]


_WINDOWS, _WINDOW = 200, 50  # samples; half a second at usual rates
_TURNED = 20.0
"""Scatter of a triad between its quieter moments over that within them, from which on its attitude changed: a pose has
1 to 5, a recording with rests some hundred."""


def read_several(
    *paths: str | Path, columns: str | None = None, rate_hz: float | None = None, units: str | Units | None = None
) -> tuple[Recording, ...]:
    """Read one recording or several.

    Two files of one triad each are the accelerometer and the gyroscope of one recording; three files or more that each
    hold one attitude are poses of one recording. Folders, logs that are whole by themselves, and files that hold both
    triads (with three files or more: several attitudes) are recordings of their own.

    Parameters
    ----------
    paths, columns, rate_hz, units : as for `read`

    Raises
    ------
    RecordingError, OptionError
        See `read`; of several recordings the message names the one.
    """
    if not _are_recordings([Path(path) for path in paths], columns, rate_hz, units):
        return (read(*paths, columns=columns, rate_hz=rate_hz, units=units),)
    return tuple(read(path, columns=columns, rate_hz=rate_hz, units=units) for path in paths)


def _are_recordings(paths: list[Path], columns: str | None, rate_hz: float | None, units: str | Units | None) -> bool:
    """Tell whether each of several paths is a recording by itself."""
    if len(paths) < 2:
        return False
    if any(path.is_dir() or is_device_log([path]) for path in paths):
        return True
    if all(first_bytes(path).startswith(NPZ_MAGIC) for path in paths):
        return True
    stated = stated_units(units)
    try:
        tables = [read_table(read_text_file(path), columns, rate_hz, stated) for path in paths]
    except RecordingError:
        return False  # whoever reads them as one recording says what is wrong
    kinds = [sorted(triad.quantity for triad in table.triads if triad.quantity != "magnetometer") for table in tables]
    if len(paths) < FEWEST_FILES:
        return all(len(kind) > 1 for kind in kinds) or all(kind == ["accelerometer"] for kind in kinds)
    return 2 * sum(_turned(table) for table in tables) > len(tables)


def _turned(table: SampleTable) -> bool:
    """Tell whether a table holds several attitudes."""
    return any(_scatter(triad.values) > _TURNED for triad in table.triads if triad.quantity != "magnetometer")


def _scatter(values: Floats) -> float:
    """Return the scatter of the means of the quieter half of windows over that within them."""
    length = min(_WINDOW, max(2, len(values) // 4), len(values))
    start = np.linspace(0, len(values) - length, min(_WINDOWS, len(values) // length)).astype(np.int64)
    part = values[start[:, None] + np.arange(length)]
    means, within = part.mean(axis=1), np.sqrt(part.var(axis=1).sum(axis=1))
    quiet = within <= np.median(within)
    between = float(np.sqrt(means[quiet].var(axis=0).sum()))
    return between / max(float(np.median(within[quiet])), 1e-12 * float(np.abs(values).max(initial=1.0)))
