"""What is said of columns that nothing names: their ranges, and what their values may be."""

from collections.abc import Sequence

import numpy as np

from ...recording import Floats
from .recognise import gravity_unit, is_gravity_in_counts
from .text_table import TextLayout, column_rises, is_number

HELP = 'Say what the columns are with --columns, for example --columns "t ax ay az gx gy gz" (_ skips a column).'
TRIAL = ' By their values, try --columns "{}"{}.'
"""What `columns_help` says where the values tell it."""

_NO_COMMAS = "Export with semicolons or tabs between columns, or with decimal points."
_MOST_LISTED = 24
_FEWEST_COUNTED = 4


def columns_help(layout: TextLayout, quantities: Sequence[str] = ()) -> str:
    """Return which columns there are, their ranges in the first rows, and how --columns could name them.

    Parameters
    ----------
    layout : of the table
    quantities : what the header says of each column, as far as it does
    """
    values = _sample_values(layout)
    listed: list[str] = []
    for i, column in enumerate(values.T[:_MOST_LISTED]):
        name = f"{i + 1} ({layout.header[i][:40]})" if layout.header else f"{i + 1}"
        good = column[np.isfinite(column)]
        span = f"{good.min():.6g} to {good.max():.6g}" if len(good) else "no numbers"
        listed.append(f"{name}: {span}{', rises' if column_rises(layout, i) else ''}")
    more = "; ..." if layout.columns > _MOST_LISTED else ""
    words = _likely_columns(layout, values, quantities or ["other"] * layout.columns)
    trial = "" if words is None else TRIAL.format(" ".join(words), "" if "t" in words else " with --rate HZ")
    names = len(layout.preamble[-1].split(",")) if layout.preamble and layout.delimiter == "," else 0
    if names > 1 and layout.columns in {2 * names - 1, 2 * names}:
        trial = f" Above them stand {names} names: are commas decimal points, too? {_NO_COMMAS}"
    return f"Columns in the first rows: {'; '.join(listed)}{more}.{trial} {HELP}"


def column_counts(layout: TextLayout, column: int) -> bool:
    """Tell whether a column goes up by one from row to row, as a sample number does, and milliseconds at 1 kHz."""
    values = _sample_values(layout)[:, column]
    return len(values) >= _FEWEST_COUNTED and values[0] < values[-1] and bool((values[1:] == values[:-1] + 1).all())


def time_help(layout: TextLayout, words: Sequence[str]) -> str:
    """Return what to do about a column that may hold the time though nothing calls it so; empty without one.

    Parameters
    ----------
    layout : of the table
    words : of --columns for what is known, "_" for the others
    """
    rising = [i for i in range(layout.columns) if words[i] == "_" and column_rises(layout, i)]
    for i in sorted(rising, key=lambda i: column_counts(layout, i)):
        name = f"Column {i + 1} ({layout.header[i][:40]})" if layout.header else f"Column {i + 1}"
        if column_counts(layout, i):
            return f" {name} goes up by one from row to row: it numbers the rows, or holds milliseconds at 1000 Hz."
        line = " ".join([*words[:i], "t", *words[i + 1 :]])
        return f' {name} rises: if it holds the time, state --columns "{line}".'
    return ""


def _sample_values(layout: TextLayout) -> Floats:
    def number(token: str) -> float:
        plain = token.strip().strip('"')
        return float(plain.replace(",", ".", 1)) if is_number(plain, layout.decimal_comma) else np.nan

    return np.array([[number(token) for token in row] for row in layout.sample], dtype=np.float64)


def _likely_columns(layout: TextLayout, values: Floats, known: Sequence[str]) -> list[str] | None:
    """Return a word for each column: a time that rises, three that read gravity, three beside them; None without."""
    words = ["_"] * layout.columns
    rising = [i for i in range(layout.columns) if column_rises(layout, i) and len(np.unique(values[:, i])) > 2]
    time = next((i for i in rising if not column_counts(layout, i)), None)  # what counts the rows tells no time
    if time is not None:
        words[time] = "t"
    free = [np.isfinite(column).all() and np.ptp(column) > 0 and i not in rising for i, column in enumerate(values.T)]
    places = [i for i in range(layout.columns - 2) if all(free[i : i + 3])]
    begin = [max((j + 1 for j in range(i) if not free[j]), default=0) for i in places]  # of the columns without a gap
    places = [i for _, i in sorted(((i - j) % 3 > 0, i) for i, j in zip(places, begin, strict=True))]
    first = next(
        (i for i in places if _reads_gravity(values[:, i : i + 3]) and "gyroscope" not in known[i : i + 3]), None
    )
    if first is None:
        return None
    words[first : first + 3] = "ax", "ay", "az"
    named = [i for i in places if all(name == "gyroscope" for name in known[i : i + 3])]
    beside = [i for i in (first + 3, first + 4, first - 3, first - 4) if i in places]  # a thermometer may lie between
    beside.sort(key=lambda i: float(np.abs(np.median(values[:, i : i + 3], axis=0)).max()))  # rates at rest are small
    second = next((i for i in (*named, *beside, *places) if i in places and abs(i - first) >= 3), None)
    if second is not None:
        words[second : second + 3] = "gx", "gy", "gz"
    return words


def _reads_gravity(values: Floats) -> bool:
    norms = np.linalg.norm(values, axis=1)
    middle = float(np.median(norms))
    return gravity_unit(middle) is not None or is_gravity_in_counts(middle)
