"""Static poses: a table of their averages, or a file of samples for each of them.

Format "pose table": text with one row a pose, the averages of a sensor at rest.

    ax ay az                mean of the accelerometer; units in brackets, as "ax [g]"
    gx gy gz                mean of the gyroscope; may be missing
    sigma_ax ... sigma_gz   standard deviation of these means, in their unit; may be missing
    samples                 how many samples each mean is of; may be missing
    t                       when the pose was measured, in seconds or as "t [ms]"; may be missing
    ref_x ref_y ref_z       known specific force along the axes of a jig, in m/s^2 or as "ref_x [g]"; may be missing
    pose                    what the pose is called; may be missing

A header or --columns gives the names, in any common spelling and order. A table of samples has a time or a rate; what
has neither and is short is a table of poses, and so is a short table with one of the columns that only poses have.

Format "pose files": a file for each pose in which the sensor rested, all in one format, joined to one recording.
"""

import re
from itertools import pairwise

import numpy as np

from ...errors import RecordingError
from ...frozen import value_class
from ...recording import Floats, Integers, Piece, Poses, Recording
from ...results.result import Booleans
from ...units import ACCELEROMETER_UNITS_M_S2, STANDARD_GRAVITY_M_S2, TIME_UNITS_NS, Units
from ..files import TextFile
from .column_names import column_name, unit_of
from .printed_lines import lines_as_table
from .recognise import gravity_unit
from .table import RATE_HELP, SampleTable, Triad, preamble_rate
from .text_table import Column, TextLayout, is_printed, numbered_rows, parse_columns, sniff_layout

POSE_HELP = (
    "If its rows are averaged poses, name the columns in a header: ax ay az, and where they are known gx gy gz, "
    "sigma_ax sigma_ay sigma_az, samples, and ref_x ref_y ref_z (specific force along the axes of a jig)."
)

LARGEST_BYTES = 200_000
"""A file that is larger holds samples."""

_MOST_POSES = 300  # rows; a recording of samples has more
_SIGMA = re.compile(r"sigma|stddev|std|sd|sem|uncertainty", re.IGNORECASE)
_REFERENCE = re.compile(r"(?:ref|reference|true|truth|known|jig)(?:[_ .-]?(?:f|a|acc|g|s|force))?[_ .-]?([xyz])", re.I)
_COMPONENT = re.compile(r"s[_ .-]?([xyz])", re.IGNORECASE)  # Angrisano writes s for what acts on the sensor
_SAMPLES = re.compile(r"(?:n|count|counts|samples|n_?samples|number[_ ]of[_ ]samples)", re.IGNORECASE)
_NAME = re.compile(r"(?:pose|poses|name|label|file|attitude|orientation|position|id|no|nr|number)", re.IGNORECASE)
_WHOLE_POSES = {"reference", "accelerometer_sigma", "gyroscope_sigma", "samples"}


@value_class(eq=True)
class PoseColumn:
    """What a column of a table of poses holds.

    Attributes
    ----------
    kind : "accelerometer", "gyroscope", "accelerometer_sigma", "gyroscope_sigma", "reference", "samples", "time",
        "name", or "" for any other
    axis : 0, 1, 2 for x, y, z; 0 for columns without axis
    unit : where the name tells it
    """

    kind: str
    axis: int = 0
    unit: str | None = None


def pose_column(text: str) -> PoseColumn:
    """Understand the name of a column of a table of poses.

    Examples
    --------
    >>> pose_column("sigma_ax [g]")
    PoseColumn(kind='accelerometer_sigma', axis=0, unit='g')
    >>> pose_column("ref_z"), pose_column("samples").kind
    (PoseColumn(kind='reference', axis=2, unit=None), 'samples')
    """
    bracket = re.search(r"[\[(]([^\])]*)[\])]", text)
    bare = (text[: bracket.start()] if bracket else text).strip()
    reference = _REFERENCE.fullmatch(bare) or _COMPONENT.fullmatch(bare)
    if reference is not None:
        unit = unit_of(bracket.group(1), "accelerometer") if bracket else None
        return PoseColumn(kind="reference", axis="xyz".index(reference.group(1).lower()), unit=unit)
    if _SAMPLES.fullmatch(bare):
        return PoseColumn(kind="samples")
    if _NAME.fullmatch(bare):
        return PoseColumn(kind="name")
    sigma = _SIGMA.search(bare) is not None
    named = column_name(_SIGMA.sub(" ", text).strip(" _.-") if sigma else text)
    if named.quantity in ("accelerometer", "gyroscope"):
        kind = f"{named.quantity}_sigma" if sigma else named.quantity
        return PoseColumn(kind=kind, axis=named.axis or 0, unit=named.unit)
    if named.quantity == "time" and not sigma:
        return PoseColumn(kind="time", unit=named.unit)
    return PoseColumn(kind="")


def read_pose_table(file: TextFile, columns: str | None, units: Units) -> Recording | None:
    """Read a table of averaged poses; None where the table holds samples, or something else.

    Parameters
    ----------
    file : the table
    columns : --columns, or None
    units : as stated

    Raises
    ------
    RecordingError
        If it is a table of poses that cannot be used; the message says where.
    """
    file = lines_as_table(file) if is_printed(file.data) else file
    layout = sniff_layout(file)
    names = columns.replace(",", " ").split() if columns is not None else list(layout.header)
    if not names and layout.columns in (3, 6) and _is_short(layout, file) and preamble_rate(layout.preamble) is None:
        raise RecordingError(
            f"{file.name}: no column holds the time, and nothing tells the sample rate. {RATE_HELP} {POSE_HELP}"
        )
    if len(names) != layout.columns or any(column_name(name).quantity == "magnetometer" for name in names):
        return None
    found = [PoseColumn(kind="") if name == "_" else pose_column(name) for name in names]
    if not _is_of_poses(found, layout, file):
        return None
    data, cut = parse_columns(file, layout, [{"": "", "name": "S80"}.get(column.kind, "f8") for column in found])
    poses, notes = _poses(found, data, units, file.name)
    _check(poses, file, layout)
    return Recording(imus={}, sources=(file.source,), assumptions=(*notes, *([cut] if cut else [])), poses=poses)


def _is_of_poses(columns: list[PoseColumn], layout: TextLayout, file: TextFile) -> bool:
    kinds = {column.kind for column in columns}
    if "accelerometer" not in kinds or not _is_short(layout, file):
        return False
    sampled = "time" in kinds or preamble_rate(layout.preamble) is not None
    return bool(kinds & _WHOLE_POSES) if sampled else True


def _is_short(layout: TextLayout, file: TextFile) -> bool:
    return file.data.count(b"\n") - layout.first_line < _MOST_POSES


def _poses(columns: list[PoseColumn], data: list[Column], units: Units, where: str) -> tuple[Poses, list[str]]:
    n = len(data[0])
    triads = {
        kind: _triad(columns, data, kind, where)
        for kind in ("accelerometer", "accelerometer_sigma", "gyroscope", "gyroscope_sigma", "reference")
    }
    accelerometer, stated_unit = triads["accelerometer"]
    gyroscope, gyroscope_unit = triads["gyroscope"]
    assert accelerometer is not None
    notes = [f"{where}: its {n} rows are taken for averaged poses{_why(columns)}."]
    unit, reason = _accelerometer_unit(accelerometer, units.accelerometer, stated_unit)
    notes.append(f"accelerometer in {unit} ({reason}).")
    rate_unit = "rad/s"
    if gyroscope is None:
        notes.append("no gyroscope in these poses.")
    else:
        rate_unit, reason = _gyroscope_unit(gyroscope, units.gyroscope, gyroscope_unit)
        notes.append(f"gyroscope in {rate_unit} ({reason}).")
    force, note = _reference(*triads["reference"])
    notes += note
    single = {
        kind: [i for i, column in enumerate(columns) if column.kind == kind] for kind in ("name", "samples", "time")
    }
    names = tuple(f"row {i + 1}" for i in range(n))
    if single["name"]:
        names = tuple(
            text.decode("utf-8", "replace").strip('" ') or f"row {i + 1}"
            for i, text in enumerate(data[single["name"][0]])
        )
    samples = np.rint(data[single["samples"][0]]).astype(np.int64) if single["samples"] else None
    t_s = None
    if single["time"]:
        at = single["time"][0]
        scale = TIME_UNITS_NS[units.time or columns[at].unit or "s"] * 1e-9
        t_s = (data[at] - data[at][0]) * scale
    return (
        Poses(
            name=names,
            accelerometer=accelerometer,
            accelerometer_unit=unit,
            gyroscope=gyroscope,
            gyroscope_unit=rate_unit,
            accelerometer_sigma=triads["accelerometer_sigma"][0],
            gyroscope_sigma=triads["gyroscope_sigma"][0] if gyroscope is not None else None,
            samples=samples,
            t_s=t_s,
            specific_force=force,
        ),
        notes,
    )


def _why(columns: list[PoseColumn]) -> str:
    if any(column.kind == "time" for column in columns):
        return ", as the columns say"
    return ": there is no column with the time, and no --rate"


def _triad(columns: list[PoseColumn], data: list[Column], kind: str, where: str) -> tuple[Floats | None, str | None]:
    """Return x, y, z of one kind, (n, 3), and the unit that the header tells; None where there is none."""
    found = [[i for i, column in enumerate(columns) if (column.kind, column.axis) == (kind, axis)] for axis in range(3)]
    if not any(found):
        return None, None
    if any(len(axis) != 1 for axis in found):
        listed = ", ".join(f"{name}: {len(axis)}" for name, axis in zip("xyz", found, strict=True))
        what = kind.replace("_", "'s ")
        raise RecordingError(
            f"{where}: a table of poses must name each axis of the {what} once; found {listed} columns. {POSE_HELP}"
        )
    return np.column_stack([data[axis[0]] for axis in found]), columns[found[0][0]].unit


def _accelerometer_unit(values: Floats, stated: str | None, named: str | None) -> tuple[str, str]:
    if stated is not None or named is not None:
        return (stated, "as stated") if stated is not None else (str(named), "as the file says")
    magnitude = float(np.median(np.linalg.norm(values, axis=1)))
    unit = gravity_unit(magnitude)
    if unit is not None:
        return unit, f"its median magnitude is {magnitude:.4g}"
    return "count", f"its median magnitude, {magnitude:.4g}, is gravity in no known unit"


def _gyroscope_unit(values: Floats, stated: str | None, named: str | None) -> tuple[str, str]:
    """Return the unit of a gyroscope at rest, of which the values alone say little."""
    if stated is not None or named is not None:
        return (stated, "as stated") if stated is not None else (str(named), "as the file says")
    largest = float(np.abs(values).max())
    if largest > 30:
        return "count", f"up to {largest:.3g} at rest is no rate; state it with --units if it is"
    unit = "deg/s" if largest > 0.15 else "rad/s"
    return unit, f"guessed: up to {largest:.2g} at rest; state it in the header or with --units"


def _reference(values: Floats | None, named: str | None) -> tuple[Floats | None, list[str]]:
    """Return known components in m/s^2, and what was assumed of them."""
    if values is None:
        return None, []
    length = float(np.median(np.linalg.norm(values, axis=1)))
    if named is None and 0.8 < length < 1.2:
        named, reason = "g", f"their length is {length:.4g}"
    else:
        reason = "as the file says" if named is not None else "as documented"
    unit = named or "m/s^2"
    factor = ACCELEROMETER_UNITS_M_S2.get(unit) or 1.0
    return values * factor, [f"known components of the specific force in {unit} ({reason})."]


def _check(poses: Poses, file: TextFile, layout: TextLayout) -> None:
    """Refuse what no pose can be: a sigma or a count below zero, known components without length."""
    lines = [number for number, _ in numbered_rows(layout, file.data)]

    def refuse(bad: Booleans, what: str) -> None:
        if bad.any():
            at = int(np.argmax(bad))
            where = f"{file.name}, line {lines[at]}" if at < len(lines) else file.name
            raise RecordingError(f"{where} ({poses.name[at]}): {what} Fix or remove this line.")

    for sigma in (poses.accelerometer_sigma, poses.gyroscope_sigma):
        if sigma is not None:
            refuse(np.any(sigma <= 0, axis=1), "the sigma of a mean must be greater than zero.")
    if poses.samples is not None:
        refuse(poses.samples < 1, "a mean is of one sample or more.")
    if poses.specific_force is not None:
        length = np.linalg.norm(poses.specific_force, axis=1)
        usual = float(np.median(length))
        refuse(
            np.abs(length - usual) > 0.1 * max(usual, 1e-9),
            f"the known components differ in length from those of the others ({usual:.4g} m/s^2) by more than 10 %.",
        )
        if not 0.8 < usual / STANDARD_GRAVITY_M_S2 < 1.2:
            raise RecordingError(
                f"{file.name}: the known components ref_x ref_y ref_z have a length of {usual:.4g} m/s^2, expected "
                "about 9.81. State their unit in the header, as ref_x [g], or give them in m/s^2."
            )


# ---- files of one pose each ----

_BETWEEN_NS = 1_000_000_000  # between files whose clocks start anew
_LONGEST_NS = 86_400 * 1_000_000_000


def join_pose_tables(tables: list[SampleTable], names: list[str]) -> tuple[SampleTable, tuple[Piece, ...], list[str]]:
    """Return one table of all files, where each of them is in it, and what was assumed.

    Raises
    ------
    RecordingError
        If the files do not hold the same sensors in the same units.
    """
    like = _kinds(tables[0])
    for table, name in zip(tables, names, strict=True):
        if _kinds(table) != like:
            raise RecordingError(
                f"{name}: found {_listed(_kinds(table))}, but {names[0]} holds {_listed(like)}. Files of poses must "
                "all have the same columns. If they are no poses of one sensor, name the one file to read."
            )
    notes = _notes(tables, names)
    order, t_ns, note = _one_clock([table.t_ns for table in tables])
    tables, names = [tables[k] for k in order], [names[k] for k in order]
    edges = np.cumsum([0, *(len(table.t_ns) for table in tables)])
    triads = tuple(
        Triad(
            quantity=triad.quantity,
            values=np.concatenate([table.triads[k].values for table in tables]),
            unit=triad.unit,
        )
        for k, triad in enumerate(tables[0].triads)
    )
    pieces = tuple(
        Piece(name=name, start=int(a), stop=int(b)) for name, a, b in zip(names, edges[:-1], edges[1:], strict=True)
    )
    return SampleTable(t_ns=t_ns, triads=triads, notes=()), pieces, [*notes, note]


def _kinds(table: SampleTable) -> tuple[tuple[str, str | None], ...]:
    return tuple((triad.quantity, triad.unit) for triad in table.triads)


def _listed(kinds: tuple[tuple[str, str | None], ...]) -> str:
    return " and ".join(f"{quantity} in {unit}" if unit else quantity for quantity, unit in kinds)


def _notes(tables: list[SampleTable], names: list[str]) -> list[str]:
    """Return each note once, however many files it is of."""
    counts: dict[str, list[str]] = {}
    for table, name in zip(tables, names, strict=True):
        for note in table.notes:
            counts.setdefault(note.removeprefix(f"{name}: "), []).append(name)
    return [f"{_files(of, len(names))}: {note}" for note, of in counts.items()]


def _files(names: list[str], total: int) -> str:
    if len(names) == 1:
        return names[0]
    return "all files" if len(names) == total else f"{names[0]} and {len(names) - 1} more"


def _one_clock(stamps: list[Integers]) -> tuple[list[int], Integers, str]:
    """Return the order of the files in time, their timestamps on one clock [ns], and what was assumed."""
    order = sorted(range(len(stamps)), key=lambda k: int(stamps[k][0]))
    ordered = [stamps[k] for k in order]
    follow = all(int(a[-1]) < int(b[0]) for a, b in pairwise(ordered))
    if follow and int(ordered[-1][-1]) - int(ordered[0][0]) < _LONGEST_NS:
        return order, np.concatenate(ordered), f"{len(stamps)} files, one pose each, in the order of their timestamps."
    shifted: list[Integers] = []
    begin = 0
    for t_ns in stamps:
        shifted.append(t_ns - t_ns[0] + begin)
        begin = int(shifted[-1].max()) + _BETWEEN_NS
    return (
        list(range(len(stamps))),
        np.concatenate(shifted),
        f"{len(stamps)} files, one pose each, whose clocks start anew: they are taken to follow each other as given.",
    )
