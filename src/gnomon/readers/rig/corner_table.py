"""Tables of detected corners, one row a corner: what the columns are, the rows, and the frames of the camera.

Two layouts: time, tag, corner of the tag (0 to 3), u, v; or time, number of the corner on the target, u, v.
"""

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...errors import RecordingError
from ...formats.kalibr.camchain import CameraInput
from ...frozen import value_class
from ...models.target import Target
from ...recording import CameraFrames, Floats, Integers, Source
from ..files import TextFile, read_text_file
from ..samples.column_names import column_name, time_columns
from ..samples.table import guess_time_unit, parse_stamped, stray_timestamp, to_ns
from ..samples.text_table import Column, TextLayout, is_number, line_number, sniff_layout

Booleans = NDArray[np.bool_]

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


_BORDER_PX = 1.0  # a corner is found from pixels around it, and may come to lie a little outside the image
_NORMALISED = 2.0  # no image is so small
_SAME_PX = 1.0

_DETECTOR_SCALE_SIGMA = 3e-4
"""Of detectors that are not known: with corners of Kalibr's the focal length comes out 0.035 % short (rendered images,
whose lens is known)."""


def camera_frames(
    table: CornerTable, all_stamps: Integers | None, known: CameraInput, target: Target, notes: list[str]
) -> CameraFrames:
    """Return what a camera saw of the target.

    Corners that are not finite numbers, lie outside the image or stand twice in a frame are left out with a note.

    Parameters
    ----------
    table : its corners
    all_stamps : (n,) int64 timestamps of all its frames [ns], or None where only frames with corners are known
    known : lens, intrinsics and guesses
    target : the board
    notes : where sentences on what was left out are appended

    Raises
    ------
    RecordingError
        If corners are not on the target, or most of them cannot be used.
    """
    keep: NDArray[np.intp] = _finite(table, notes)
    point = _points(table, keep, target)
    pixels = table.pixels[keep]
    inside = _inside(table, pixels, known.camera.resolution, notes)
    keep, point, pixels = keep[inside], point[inside], pixels[inside]
    t_ns = table.t_ns[keep]
    stamps = _frame_stamps(table, t_ns, all_stamps, notes)
    frame = np.searchsorted(stamps, t_ns)
    order = _each_once(table, frame * len(target.points) + point, pixels, notes)
    if order is not None:
        frame, point, pixels = frame[order], point[order], pixels[order]
    return CameraFrames(
        t_ns=stamps,
        frame=frame,
        point=point,
        pixels=pixels,
        camera=known.camera,
        T_cam_imu=known.T_cam_imu,
        time_shift_cam_imu_s=known.time_shift_cam_imu_s,
        lens_covariance=known.lens_covariance,
        detector_scale_sigma=_DETECTOR_SCALE_SIGMA,
    )


def _finite(table: CornerTable, notes: list[str]) -> NDArray[np.intp]:
    """Return the rows whose coordinates are numbers."""
    finite = np.isfinite(table.pixels[:, 0]) & np.isfinite(table.pixels[:, 1])
    lost = len(finite) - int(np.count_nonzero(finite))
    if lost > 0.5 * len(finite):
        raise RecordingError(
            f"{table.where(int(np.argmin(finite)))}: NaN or infinity instead of pixels, as in {lost} of "
            f"{len(finite)} rows. Write one row for each corner that was detected, and none for the others."
        )
    if lost:
        notes.append(_left_out(table, lost, "NaN or infinity instead of pixels"))
    return np.flatnonzero(finite)


def _left_out(table: CornerTable, count: int, why: str) -> str:
    return f"{table.file.name}: left out {count} of {len(table.corner)} corners ({why})."


def _points(table: CornerTable, keep: NDArray[np.intp], target: Target) -> Integers:
    """Return the number on the target of each corner."""
    corner = table.corner[keep]
    if table.tag is None:
        last = len(target.points) - 1
        _refuse_unknown(table, keep, (corner < 0) | (corner > last), lambda i: f"corner {table.corner[i]}", target)
        return corner
    if target.kind != "aprilgrid":
        raise RecordingError(
            f"{table.file.name}: these are the corners of tags, but the target is a {target.kind}. "
            "Give the target.yaml of the AprilGrid that was seen."
        )
    tag = table.tag[keep]
    tags = len(target.points) // 4
    wrong = (tag < 0) | (tag >= tags) | (corner < 0) | (corner > 3)
    numbers = table.tag
    _refuse_unknown(table, keep, wrong, lambda i: f"corner {table.corner[i]} of tag {numbers[i]}", target)
    return target.point_of_tag_corner(tag, corner)


def _refuse_unknown(
    table: CornerTable, keep: NDArray[np.intp], wrong: Booleans, name: Callable[[int], str], target: Target
) -> None:
    if not wrong.any():
        return
    rows = keep[wrong]
    found = list(dict.fromkeys(name(int(i)) for i in rows[:1000]))
    listed = ", ".join(found[:4]) + (", ..." if len(found) > 4 else "")
    points = len(target.points)
    holds = f"corners 0 to {points - 1}"
    if table.tag is not None:
        holds = f"tags 0 to {points // 4 - 1} with corners 0 to 3"
    raise RecordingError(
        f"{table.where(int(rows[0]))}: {found[0]} is not on the target ({target.describe()}), which holds {holds}. "
        f"{len(rows)} of {len(table.corner)} rows name such corners: {listed}. Is this the target.yaml of the board "
        "that was seen?"
    )


def _inside(table: CornerTable, pixels: Floats, resolution: tuple[int, int], notes: list[str]) -> Booleans:
    """Return which corners are inside the image, or on its border."""
    if len(pixels) and float(np.abs(pixels).max()) < _NORMALISED:
        raise RecordingError(
            f"{table.file.name}: all coordinates lie between {pixels.min():.3g} and {pixels.max():.3g}. Expected "
            "pixels; these seem to be normalised. Write them as they were detected in the image."
        )
    width, height = resolution
    low, high = -0.5 - _BORDER_PX, np.array([width, height]) - 0.5 + _BORDER_PX
    inside = (pixels[:, 0] > low) & (pixels[:, 0] < high[0]) & (pixels[:, 1] > low) & (pixels[:, 1] < high[1])
    outside = len(inside) - int(np.count_nonzero(inside))
    if outside > 0.5 * len(inside):
        raise RecordingError(
            f"{table.file.name}: {outside} of {len(inside)} corners lie outside the image of {width} x {height} px; "
            f"u runs from {pixels[:, 0].min():.0f} to {pixels[:, 0].max():.0f}, v from {pixels[:, 1].min():.0f} to "
            f"{pixels[:, 1].max():.0f}. Resolution and intrinsics seem to be those of another camera or image size."
        )
    if outside:
        notes.append(_left_out(table, outside, f"outside the image of {width} x {height} px"))
    return inside


def _frame_stamps(table: CornerTable, t_ns: Integers, all_stamps: Integers | None, notes: list[str]) -> Integers:
    """Return the timestamps of all frames in order."""
    if (table.t_ns[1:] < table.t_ns[:-1]).any():
        notes.append(f"{table.file.name}: the rows are not in the order of time; they were sorted.")
    with_corners = np.unique(t_ns)
    if all_stamps is None:
        return np.unique(table.t_ns)
    stamps = np.union1d(all_stamps, with_corners)
    unlisted = len(stamps) - len(np.unique(all_stamps))
    if unlisted:
        notes.append(
            f"{table.file.name}: {unlisted} of {len(with_corners)} frames are missing in the list of all frames; "
            "they were added."
        )
    return stamps


def _each_once(table: CornerTable, key: Integers, pixels: Floats, notes: list[str]) -> NDArray[np.intp] | None:
    """Return the order of time, each corner of a frame once, the first that stands in the file; None if it is so."""
    if (key[1:] > key[:-1]).all():
        return None
    order = np.argsort(key, kind="stable")
    same = np.concatenate([[False], key[order[1:]] == key[order[:-1]]])
    count = int(np.count_nonzero(same))
    if not count:
        return order
    apart = np.linalg.norm(pixels[order[1:]] - pixels[order[:-1]], axis=1)[same[1:]]
    if count > 0.5 * len(key) and float(np.median(apart)) > _SAME_PX:
        raise RecordingError(
            f"{table.file.name}: most corners stand several times at one timestamp, at different places "
            f"({count} of {len(key)} rows). The timestamps are too coarse to tell the frames apart; write them in "
            "nanoseconds."
        )
    notes.append(_left_out(table, count, "the same corner is in the frame already"))
    return order[~same]
