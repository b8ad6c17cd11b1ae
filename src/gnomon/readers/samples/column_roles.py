"""Which columns of a table are stamps and which are which sensor: stated, named in the header, or by their number."""

from dataclasses import dataclass

import numpy as np

from ...errors import OptionError, RecordingError
from .column_names import OTHER, ColumnName, column_name
from .text_table import Layout, is_number

HELP = 'Say what the columns are with --columns, for example --columns "t ax ay az gx gy gz" (_ skips a column).'


@dataclass(frozen=True, slots=True, kw_only=True)
class TriadColumns:
    """Columns x, y, z of one triad; quantity "unnamed" where only the values can tell which sensor it is."""

    quantity: str
    columns: tuple[int, int, int]
    unit: str | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Roles:
    """Columns that are used.

    Attributes
    ----------
    time : columns of the stamp and their units: none, one, or two to be added (seconds and nanoseconds)
    triads : one or two, and the magnetometer behind them, or it alone
    notes : what was assumed
    """

    time: tuple[tuple[int, str | None], ...]
    triads: tuple[TriadColumns, ...]
    notes: tuple[str, ...] = ()


def roles(layout: Layout, stated: str | None, where: str) -> Roles:
    """Decide which columns are used.

    Parameters
    ----------
    layout : of the table
    stated : --columns, or None
    where : file, for messages

    Raises
    ------
    OptionError
        If `stated` does not fit the table.
    RecordingError
        If neither header nor the number of columns tells what they are.
    """
    if stated is not None:
        return _stated(layout, stated, where)
    if layout.header:
        names = [column_name(text) for text in layout.header]
        if any(name.quantity not in {"time", "other"} for name in names):
            return _named(names, layout, where, "the header")
        raise RecordingError(
            f"{where}: the header names no accelerometer, gyroscope or magnetometer "
            f"({', '.join(layout.header)[:120]}). {HELP}"
        )
    return _by_number(layout, where)


def _stated(layout: Layout, stated: str, where: str) -> Roles:
    words = stated.replace(",", " ").split()
    if len(words) != layout.columns:
        raise OptionError(
            f'columns "{stated}" names {len(words)} columns, {where} has {layout.columns} ({layout}). '
            "Name every column; _ skips one."
        )
    names = [OTHER if word == "_" else column_name(word) for word in words]
    unknown = [word for word, name in zip(words, names, strict=True) if name is OTHER and word != "_"]
    if unknown:
        raise OptionError(
            f'columns "{stated}": "{unknown[0]}" is not known. '
            "Write t, ax, ay, az, gx, gy, gz, mx, my, mz, or _ to skip a column."
        )
    return _named(names, layout, where, "--columns")


def _named(names: list[ColumnName], layout: Layout, where: str, origin: str) -> Roles:
    triads: list[TriadColumns] = []
    for quantity in ("accelerometer", "gyroscope", "unnamed", "magnetometer"):
        axes = {axis: [i for i, n in enumerate(names) if (n.quantity, n.axis) == (quantity, axis)] for axis in range(3)}
        axes = {axis: _with_gravity(columns, layout.header) for axis, columns in axes.items()}
        found = sum(len(columns) for columns in axes.values())
        if not found:
            continue
        if any(len(columns) != 1 for columns in axes.values()):
            if quantity == "magnetometer" and triads:  # what is wanted may well be without it
                continue
            listed = ", ".join(f"{'xyz'[axis]}: {len(columns)}" for axis, columns in axes.items())
            sensor = "triad" if quantity == "unnamed" else quantity
            raise RecordingError(
                f"{where}: {origin} must name each axis of the {sensor} once; found {listed} columns. {HELP}"
            )
        columns = (axes[0][0], axes[1][0], axes[2][0])
        triads.append(TriadColumns(quantity=quantity, columns=columns, unit=names[columns[0]].unit))
    inertial = any(triad.quantity in {"accelerometer", "gyroscope"} for triad in triads)
    named = [triad for triad in triads if triad.quantity != "unnamed"] if inertial else triads
    if not triads:
        raise RecordingError(f"{where}: {origin} names no accelerometer, no gyroscope and no magnetometer. {HELP}")
    return Roles(time=time_columns(names, layout), triads=tuple(named))


def _with_gravity(columns: list[int], header: tuple[str, ...]) -> list[int]:
    """Return, of several columns for one axis, those that are not said to be without gravity, as apps on phones do.

    AndroSensor has LINEAR ACCELERATION beside ACCELEROMETER, Physics Toolbox ax (linear) beside gFx (in g).
    """
    if len(columns) < 2 or not header:
        return columns
    in_g = [i for i in columns if header[i].startswith("gF")]
    return in_g or [i for i in columns if "linear" not in header[i].lower()] or columns


def time_columns(names: list[ColumnName], layout: Layout) -> tuple[tuple[int, str | None], ...]:
    """Choose among the columns that may be stamps those that hold numbers; a header stamp beats the time of arrival."""
    row = layout.sample[0]
    found = [i for i, name in enumerate(names) if name.quantity == "time" and is_number(row[i], layout.decimal_comma)]
    if not found:
        return ()
    texts = [layout.header[i].lower() if layout.header else "" for i in found]
    seconds = [
        i
        for i, text in zip(found, texts, strict=True)
        if text.rstrip("s").endswith("sec") and "nsec" not in text and "nano" not in text
    ]
    nanoseconds = [i for i, text in zip(found, texts, strict=True) if text.rstrip("s").endswith(("nsec", "nanosec"))]
    if len(seconds) == len(nanoseconds) == 1:
        return ((seconds[0], "s"), (nanoseconds[0], "ns"))
    best = next((i for i, text in zip(found, texts, strict=True) if "header" in text and "stamp" in text), found[0])
    return ((best, names[best].unit),)


def _by_number(layout: Layout, where: str) -> Roles:
    """Two triads, with time in front or without time; or one triad (of a pair of files)."""
    count = layout.columns
    if count in {3, 6}:
        return Roles(time=(), triads=_triads(0, count))
    if count in {4, 7} and _rises(layout):
        return Roles(
            time=((0, None),),
            triads=_triads(1, count),
            notes=(f"{where}: no header; the first column rises steadily and was taken for the time.",),
        )
    if count in {4, 7} and _rises(layout, count - 1):
        return Roles(
            time=((count - 1, None),),
            triads=_triads(0, count - 1),
            notes=(f"{where}: no header; the last column rises steadily and was taken for the time.",),
        )
    why = (
        "of which neither the first nor the last is a time (it does not rise)"
        if count in {4, 7}
        else "without names that gnomon knows"
    )
    raise RecordingError(f"{where}: found {layout}, {why}. {HELP}")


def _triads(first: int, count: int) -> tuple[TriadColumns, ...]:
    return tuple(TriadColumns(quantity="unnamed", columns=(i, i + 1, i + 2)) for i in range(first, count, 3))


def _rises(layout: Layout, column: int = 0) -> bool:
    """Tell whether a column mostly rises: stamps may stand still or jump back, samples go up and down."""
    tokens = [row[column].strip('"') for row in layout.sample if is_number(row[column], layout.decimal_comma)]
    numbers = np.array([float(token.replace(",", ".")) for token in tokens])
    with np.errstate(invalid="ignore"):  # infinity less infinity
        steps = np.diff(numbers)
    return len(steps) > 0 and float((steps >= 0).mean()) > 0.9 and numbers[-1] > numbers[0]
