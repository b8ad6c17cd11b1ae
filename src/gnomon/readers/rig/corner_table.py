"""Tables of detected corners, one row a corner: what the columns are, and the rows as they stand.

Two layouts: time, tag, corner of the tag (0 to 3), u, v; or time, number of the corner on the target, u, v.
"""

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...errors import RecordingError
from ...frozen import value_class
from ...recording import Floats, Integers, Source
from ..files import TextFile, read_text_file
from ..samples.column_names import column_name, time_columns
from ..samples.table import guess_time_unit, parse_stamped, stray_timestamp, to_ns
from ..samples.text_table import Column, TextLayout, is_number, line_number, sniff_layout

_HEADERS = '"ts_ns,tag_id,corner_idx,u_px,v_px" or "ts_ns,corner_id,u_px,v_px"'
_ROWS = "time, number of the tag, number of its corner, u, v (or time, number of the corner, u, v)"
_TAG = ("tag", "april", "marker")
_CORNER = ("corner", "point", "landmark", "keypoint", "feature")
_NUMBER_WORDS = {"id", "idx", "index", "number", "no"}
_OTHER_WORDS = {
    *("frame", "image", "img", "n", "num", "count", "std", "sigma", "cov", "covariance", "var", "size", "response"),
    *("obj", "object", "board", "world", "target", "m", "mm", "z"),
}


@value_class(eq=True)
class CornerColumns:
    """Columns of a table of corners.

    Attributes
    ----------
    time : columns of the timestamp and their units, one, or two to be added (seconds and nanoseconds)
    tag : of the tag's number, or None where corners are numbered on the whole target
    corner : of the corner's number
    u, v : of the coordinates
    note : what was assumed, or ""
    """

    time: tuple[tuple[int, str | None], ...]
    tag: int | None
    corner: int
    u: int
    v: int
    note: str = ""


@value_class
class CornerTable:
    """Rows of a table of corners, in the order of the file.

    Attributes
    ----------
    file, layout : where they come from
    t_ns : (m,) int64 [ns]
    tag : (m,) int64 number of the tag, or None where corners are numbered on the whole target
    corner : (m,) int64 number of the corner, of its tag or on the target
    pixels : (m, 2) [px], also what is not a finite number
    notes : what was assumed
    """

    file: TextFile
    layout: TextLayout
    t_ns: Integers
    tag: Integers | None
    corner: Integers
    pixels: Floats
    notes: tuple[str, ...]

    def where(self, row: int) -> str:
        """Return the file and the line of a row, for messages."""
        return f"{self.file.name}, line {line_number(self.file, self.layout, row)}"


def read_corner_table(path: Path, time_unit: str | None = None) -> CornerTable:
    """Read a table of corners.

    Parameters
    ----------
    path : text, gzipped or not
    time_unit : unit of the timestamps where the header does not tell it; guessed if None

    Raises
    ------
    RecordingError
        If the file cannot be read, is no such table, or a row of it is damaged.
    """
    file = read_text_file(path)
    try:
        layout = sniff_layout(file, _ROWS)
    except RecordingError as error:
        raise RecordingError(
            f"{error} If {path.name.partition('_')[0]} never saw the board, leave its file out."
        ) from error
    columns = corner_columns(layout, file.name)
    numbers = [i for i in (columns.tag, columns.corner) if i is not None]
    data, cut = parse_stamped(
        file, layout, [i for i, _ in columns.time], [columns.u, columns.v], numbers, may_be_lost=True
    )
    t_ns, note = _stamps(data, columns.time, time_unit, file.name)
    _refuse_strayed(t_ns, file, layout)
    whole = {i: _whole(data[i], file, layout) for i in numbers}
    return CornerTable(
        file=file,
        layout=layout,
        t_ns=t_ns,
        tag=None if columns.tag is None else whole[columns.tag],
        corner=whole[columns.corner],
        pixels=np.stack([data[columns.u], data[columns.v]], axis=1),
        notes=tuple(text for text in (columns.note, note, cut) if text),
    )


def read_frame_stamps(path: Path, time_unit: str | None = None) -> tuple[Integers, Source, str]:
    """Read the timestamps of all frames of a camera, from a table with one row a frame.

    Returns
    -------
    timestamps (n,) int64 [ns], name and hash of the file, and what was assumed about the unit

    Raises
    ------
    RecordingError
        If the file cannot be read, or no column holds the time.
    """
    file = read_text_file(path)
    layout = sniff_layout(file, "time of a frame, number of corners in it")
    names = [column_name(text) for text in layout.header]
    time = time_columns(names, layout) if names else ((0, None),)
    if not time:
        raise RecordingError(
            f"{file.name}: no column holds the time ({', '.join(layout.header)[:120]}). Name it ts_ns, in nanoseconds."
        )
    data, _ = parse_stamped(file, layout, [i for i, _ in time], [], may_be_lost=True)
    t_ns, note = _stamps(data, time, time_unit, file.name)
    _refuse_strayed(t_ns, file, layout)
    return t_ns, file.source, note


def corner_columns(layout: TextLayout, where: str) -> CornerColumns:
    """Decide what the columns of a table of corners are, by the header, else by what is in them.

    Raises
    ------
    RecordingError
        If neither tells it.
    """
    if not layout.header:
        return _by_content(layout, where)
    time = time_columns([column_name(text) for text in layout.header], layout)
    stamps = {i for i, _ in time}
    words = {i: _words(text[:400]) for i, text in enumerate(layout.header) if i not in stamps}
    found = {
        role: [i for i, spelled in words.items() if _role(spelled) == role]
        for role in ("tag", "corner", "u", "v", "x", "y", "number")
    }
    found["corner"] = found["corner"] or found["number"]
    found["u"], found["v"] = (found["u"], found["v"]) if found["u"] or found["v"] else (found["x"], found["y"])
    alone = all(len(found[role]) == 1 for role in ("corner", "u", "v"))
    if not (time and alone and len(found["tag"]) <= 1):
        raise RecordingError(
            f"{where}: the header does not tell which columns are time, corner, u and v "
            f"({', '.join(layout.header)[:120]}). Expected {_HEADERS}."
        )
    tag = found["tag"][0] if found["tag"] else None
    return CornerColumns(time=time, tag=tag, corner=found["corner"][0], u=found["u"][0], v=found["v"][0])


def _words(text: str) -> list[str]:
    bare = re.sub(r"[\[(][^\])]*[\])]", " ", text)
    words = [word.lower() for word in re.findall(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|\d+", bare)]
    unit = {"px", "pix", "pixel", "pixels"}
    return [word for word in words if word not in unit] or words


def _role(words: list[str]) -> str:
    if _OTHER_WORDS.intersection(words):
        return "other"
    for role, spellings in (("u", {"u"}), ("v", {"v"}), ("x", {"x", "px"}), ("y", {"y", "py"})):
        if spellings.intersection(words):
            return role
    for role, stems in (("corner", _CORNER), ("tag", _TAG)):  # "tag_corner" is the corner of a tag
        if any(word.startswith(stems) for word in words):
            return role
    return "number" if _NUMBER_WORDS.intersection(words) else "other"


def _by_content(layout: TextLayout, where: str) -> CornerColumns:
    """Tell the columns of a table without header: time does not fall, numbers are whole, coordinates are not."""
    count = layout.columns
    rows = [[token.strip('"') for token in row] for row in layout.sample]
    whole = [all(re.fullmatch(r"\d{1,20}", row[i]) for row in rows) for i in range(count)]
    if count in {4, 5} and all(whole[1 : count - 2]) and not all(whole[count - 2 :]):
        times = [float(row[0].replace(",", ".")) for row in rows if is_number(row[0], layout.decimal_comma)]
        of_a_tag = count == 4 or max(int(row[2]) for row in rows) <= 3
        if of_a_tag and times == sorted(times):
            meaning = "time, corner, u, v" if count == 4 else "time, tag, corner of the tag, u, v"
            return CornerColumns(
                time=((0, None),),
                tag=None if count == 4 else 1,
                corner=count - 3,
                u=count - 2,
                v=count - 1,
                note=f"{where}: no header; the columns were taken for {meaning}.",
            )
    raise RecordingError(
        f"{where}: no header, and {layout} do not tell which are time, corner, u and v. Add a first line, {_HEADERS}."
    )


def _stamps(
    data: list[Column], time: tuple[tuple[int, str | None], ...], stated: str | None, where: str
) -> tuple[Integers, str]:
    if len(time) == 2:
        both = [to_ns(data[i], unit or "ns", where) for i, unit in time]
        return both[0] + both[1], ""
    ((column, unit),) = time
    values: NDArray[np.generic] = data[column]
    if unit is not None or stated is not None:
        return to_ns(values, str(unit or stated), where), ""
    changes = np.flatnonzero(values[1:] != values[:-1])
    each = values[np.append(changes, len(values) - 1)]
    try:
        unit, reason = guess_time_unit(each) if len(each) > 1 else ("ns", "nothing tells otherwise")
    except ValueError:
        raise RecordingError(f"{where}: the timestamps are not numbers.") from None
    return to_ns(values, unit, where), f"{where}: time in {unit} ({reason})."


def _refuse_strayed(t_ns: Integers, file: TextFile, layout: TextLayout) -> None:
    row = stray_timestamp(t_ns)
    if row is not None:
        raise RecordingError(
            f"{file.name}, line {line_number(file, layout, row)}: the timestamp {t_ns[row]} ns is more than half a day "
            f"from the middle of the others, {int(np.median(t_ns))} ns. Fix or remove this line."
        )


def _whole(values: Column, file: TextFile, layout: TextLayout) -> Integers:
    """Return the numbers of tags or corners as integers."""
    if values.dtype.kind == "i":
        return values
    with np.errstate(invalid="ignore"):
        numbers = values.astype(np.int64)
    wrong = np.flatnonzero(numbers != values)
    if len(wrong):
        line = line_number(file, layout, int(wrong[0]))
        raise RecordingError(
            f"{file.name}, line {line}: found {values[wrong[0]]:g} as the number of a tag or corner, expected a whole "
            "number. Fix or remove this line."
        )
    return numbers
