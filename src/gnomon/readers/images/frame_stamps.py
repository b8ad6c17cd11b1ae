"""When each image of a camera was taken, by a table beside the images or by their names; frames that are asked for."""

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import RecordingError
from ...frozen import value_class
from ...options import FrameSelection
from ...recording import Integers, Recording, Source
from ...recording.recording import Frame, ImageRecording, ImageStream
from ...units import TIME_UNITS_NS
from ..files import TextFile, read_text_file
from ..samples.column_names import column_name, time_columns
from ..samples.table import TYPICAL_FRAMES_HZ, guess_time_unit, stamp_kind, stray_timestamp, to_ns
from ..samples.text_table import TextLayout, is_number, numbered_rows, sniff_layout

_ROW = "time of a frame, name of its file"
_SPLIT = re.compile(r"(?<!\d)(\d{9,10})[-_](\d{9}|\d{6})$")  # seconds and a fraction with all its zeros
_LAST_NUMBER = re.compile(r"(\d+(?:\.\d+)?)$")
_LARGEST_NUMBER = 1e8  # of views; timestamps since 1970 are larger in any unit
_SECOND_NS = 1_000_000_000
_COUNTER_STEP = 1000  # numbers closer than that, at even steps, count the images
WHAT_TO_WRITE = (
    "Name the images after their timestamps in nanoseconds, such as 1600000000050000000.png, or put a table data.csv "
    'beside them with the first line "timestamp [ns],filename" and a row for each image.'
)


@value_class
class FrameTable:
    """A table of timestamps, in the order of its rows.

    Attributes
    ----------
    t_ns : (n,) int64 [ns]
    names : name of the file of each row, without folder; None where the rows only stand in the order of the frames
    source : the table's file
    notes : what was assumed
    """

    t_ns: Integers
    names: tuple[str, ...] | None
    source: Source
    notes: tuple[str, ...]


def read_frame_table(path: Path, files: Sequence[str] = (), time_unit: str | None = None) -> FrameTable:
    """Read the timestamps of frames.

    Parameters
    ----------
    path : text, gzipped or not, with one row a frame
    files : names of the images, by which a column of file names is recognised; with or without suffix
    time_unit : unit of the timestamps where the header does not tell it; recognised if None

    Raises
    ------
    RecordingError
        If the file cannot be read, no column holds the time, or a timestamp is damaged.
    """
    file = read_text_file(path)
    layout = sniff_layout(file, _ROW)
    named = _name_column(layout, files)
    stamp, unit = _stamp_column(layout, named, file.name)
    texts, names, cut = _columns(file, layout, stamp, named)
    t_ns, note = _in_ns(texts, time_unit or unit, file.name)
    refuse_strayed(t_ns, file.name, [f"row {i + 1}" for i in range(len(t_ns))])
    return FrameTable(
        t_ns=t_ns,
        names=None if named is None else tuple(names),
        source=file.source,
        notes=tuple(text for text in (note, cut) if text),
    )


def is_frame_table(path: Path) -> bool:
    """Tell whether a file can be a table of timestamps: few columns, one of them the time, and no samples of an IMU."""
    try:
        layout = sniff_layout(read_text_file(path), _ROW)
    except RecordingError:
        return False
    if not layout.header:
        return layout.columns <= 3
    quantities = {column_name(text).quantity for text in layout.header}
    few = "time" in quantities or layout.columns <= 3
    return few and not quantities & {"accelerometer", "gyroscope", "unnamed"}


def stamps_in_names(files: Sequence[str], time_unit: str | None, where: str) -> tuple[Integers, str]:
    """Return the timestamps that files are named after, (n,) [ns], in the order of the files, and what was assumed.

    Raises
    ------
    RecordingError
        If the names hold no timestamps; the message says what to write.
    """
    texts: list[str] = []
    for name in files:
        stem = stem_of(name)
        split, last = _SPLIT.search(stem), _LAST_NUMBER.search(stem)
        if last is None:
            raise RecordingError(f"{where}: the name {name} holds no timestamp, and there is no table. {WHAT_TO_WRITE}")
        texts.append(f"{split[1]}.{split[2]}" if split else last[1])
    values = _values(texts)
    ordered = np.sort(values.astype(np.float64))
    if len(files) > 1 and _counts(ordered):
        raise RecordingError(
            f"{where}: the names, {files[0]} to {files[-1]}, number the images, and no table says when they were "
            f"taken. {WHAT_TO_WRITE}"
        )
    unit, reason = (time_unit, "as stated") if time_unit else _unit(ordered)
    t_ns = to_ns(values, unit, where)
    refuse_strayed(t_ns, where, files)
    return t_ns, f"{where}: the names of the images are their timestamps in {unit} ({reason})."


def are_stamps(files: Sequence[str]) -> bool:
    """Tell whether files are named after timestamps, rather than numbered or named otherwise."""
    numbers = numbers_in_names(files)
    return numbers is not None and float(numbers.max()) > _LARGEST_NUMBER


def numbers_in_names(files: Sequence[str]) -> NDArray[np.float64] | None:
    """Return the numbers at the end of the names of files, (n,); None unless each has one of its own."""
    texts: list[str] = []
    for name in files:
        stem = stem_of(name)
        split, last = _SPLIT.search(stem), _LAST_NUMBER.search(stem)
        if last is None:
            return None
        texts.append(f"{split[1]}.{split[2]}" if split else last[1])
    return None if len(set(texts)) < len(texts) else np.array(texts).astype(np.float64)


def numbered_names(files: Sequence[str], where: str) -> tuple[Integers, str]:
    """Return numbers of views in place of timestamps, a second apart, (n,) [ns], and what was assumed.

    The number at the end of a name is that of the view; without numbers their order is.
    """
    numbers = numbers_in_names(files)
    if numbers is None:
        said = f"{where}: the images hold no timestamps, and were numbered in the order of their names."
        return np.arange(len(files), dtype=np.int64) * _SECOND_NS, said
    said = f"{where}: the names of the images number the views; nothing tells when they were taken."
    return np.rint(numbers * _SECOND_NS).astype(np.int64), said


def stem_of(name: str) -> str:
    """Return a file's name without its suffix; a number with a fraction, 12.5, has none."""
    stem, dot, suffix = name.rpartition(".")
    return stem if dot and not suffix.isdigit() else name


def refuse_strayed(t_ns: Integers, where: str, places: Sequence[str]) -> None:
    """Refuse timestamps of which one is more than half a day from the others.

    Raises
    ------
    RecordingError
        If there is such a timestamp; the message names its place.
    """
    far = stray_timestamp(t_ns)
    if far is not None:
        raise RecordingError(
            f"{where}, {places[far]}: the timestamp {t_ns[far]} ns is more than half a day from the middle of the "
            f"others, {int(np.median(t_ns))} ns. Fix or remove it."
        )


def _counts(ordered: NDArray[np.float64]) -> bool:
    """Tell whether numbers count the images rather than the time."""
    steps = np.diff(ordered)
    whole = bool((ordered == np.rint(ordered)).all())
    return whole and bool(np.median(steps) < _COUNTER_STEP) and float(ordered[-1]) < 1e8 and _mostly_even(steps)


def _mostly_even(steps: NDArray[np.float64]) -> bool:
    least = float(steps.min())
    return least > 0 and bool((np.mod(steps, least) == 0).all())


def _name_column(layout: TextLayout, files: Sequence[str]) -> int | None:
    """Return the column whose entries are files that are there, or look like names of images; None if none does."""
    whole, stems = set(files), {stem_of(file) for file in files}
    share: list[float] = []
    for column in range(layout.columns):
        entries = [_base(row[column]) for row in layout.sample]
        there = sum(1.0 if entry in whole else 0.9 if entry in stems else 0.0 for entry in entries)
        share.append(there / max(len(entries), 1))
    best = int(np.argmax(share))
    if share[best] > 0.5:
        return best
    texts = [
        i
        for i in range(layout.columns)
        if all(re.fullmatch(r'.*\.[A-Za-z]\w{1,4}"?', row[i]) is not None for row in layout.sample)
    ]
    return texts[0] if texts else None


def _stamp_column(layout: TextLayout, named: int | None, where: str) -> tuple[int, str | None]:
    """Return the column of the timestamps and its unit, where the header tells it."""
    row = layout.sample[0]
    if layout.header:
        names = [column_name(text) for text in layout.header]
        time = time_columns(names, layout)
        if time:
            return time[0]
    numbers = [i for i in range(layout.columns) if i != named and is_number(row[i], layout.decimal_comma)]
    if numbers:
        return numbers[0], None
    if named is not None and is_number(row[named]):
        return named, None
    raise RecordingError(
        f"{where}: no column holds the time of the frames ({layout}). Expected rows such as: {_ROW}; with the first "
        'line "timestamp [ns],filename".'
    )


def _columns(file: TextFile, layout: TextLayout, stamp: int, named: int | None) -> tuple[list[str], list[str], str]:
    """Return the timestamps as text, the names of files, and a sentence on a last line that was cut off."""
    texts: list[str] = []
    names: list[str] = []
    whole = file.data.endswith((b"\n", b"\r"))
    damaged: RecordingError | None = None
    for line, row in numbered_rows(layout, file.data):
        if damaged is not None:
            raise damaged
        if len(row) == layout.columns and is_number(row[stamp], layout.decimal_comma):
            texts.append(row[stamp].strip('"').replace(",", "."))
            names += [] if named is None else [_base(row[named].encode("latin-1").decode("utf-8", errors="replace"))]
            continue
        found = f'"{row[stamp][:40]}"' if len(row) == layout.columns else f"{len(row)} columns"
        expected = "the time of a frame" if len(row) == layout.columns else f"{layout.columns} as in the other rows"
        damaged = RecordingError(
            f"{file.name}, line {line}: found {found}, expected {expected}. Fix or remove this line."
        )
    if damaged is not None and whole:
        raise damaged
    return texts, names, f"{file.name}: the last line is cut off and was left out." if damaged is not None else ""


def _values(texts: list[str]) -> NDArray[Any]:
    """Return numbers in the type that holds them without loss."""
    kind = stamp_kind(texts)
    return np.array([text.encode() for text in texts]) if kind == "S40" else np.array(texts).astype(kind)


def _in_ns(texts: list[str], unit: str | None, where: str) -> tuple[Integers, str]:
    values = _values(texts)
    if unit is not None:
        return to_ns(values, unit, where), ""
    unit, reason = _unit(np.unique(values.astype(np.float64)))
    return to_ns(values, unit, where), f"{where}: time in {unit} ({reason})."


def _unit(ordered: NDArray[np.float64]) -> tuple[str, str]:
    if len(ordered) > 1:
        return guess_time_unit(ordered, TYPICAL_FRAMES_HZ)
    first = float(ordered[0])  # of Python's own numbers, which become infinite without a warning
    unit = next((unit for unit, factor in TIME_UNITS_NS.items() if 1e18 < first * factor < 4e18), "ns")
    return unit, "there is only one image"


def _base(token: str) -> str:
    return re.split(r"[/\\]", token.strip().strip('"').strip())[-1]


# ---- the frames of a recording that are asked for, as images or as corners ----

_AHEAD = 0.25  # of the time between two images that are taken: timestamps stray round its multiples


def select_images(images: ImageRecording, selection: FrameSelection) -> ImageRecording:
    """Return a recording with the images that are asked for; the samples of its IMUs stay.

    Raises
    ------
    RecordingError
        If a camera has none.
    """
    if selection == FrameSelection():
        return images
    heads = [frame.t_ns for stream in images.streams.values() for frame in islice(stream.frames([]), 1)]
    first_ns = min(heads, default=0)
    streams = {name: _selected(name, stream, selection, first_ns) for name, stream in images.streams.items()}
    return replace(images, streams=streams, assumptions=(*images.assumptions, _told(selection)))


def select_frames(recording: Recording, selection: FrameSelection) -> Recording:
    """Return a recording of corners with the frames that are asked for; see `select_images`."""
    first_ns = min((int(frames.t_ns[0]) for frames in recording.cameras.values() if len(frames.t_ns)), default=0)
    cameras = {}
    for name, frames in recording.cameras.items():
        taken = _taken(selection, first_ns)
        kept = np.array([taken(int(t_ns)) for t_ns in frames.t_ns], dtype=bool)
        if not kept.any():
            raise _none_left(name, selection)
        cameras[name] = frames.where(kept)
    return replace(recording, cameras=cameras, assumptions=(*recording.assumptions, _told(selection)))


def _selected(name: str, stream: ImageStream, selection: FrameSelection, first_ns: int) -> ImageStream:
    def frames(notes: list[str]) -> Iterator[Frame]:
        taken = _taken(selection, first_ns)
        return (frame for frame in stream.frames(notes) if taken(frame.t_ns))

    known = (frame.t_ns for frame in stream.frames([])) if stream.arrivals is None else stream.arrivals.t_ns
    taken = _taken(selection, first_ns)
    count = sum(taken(int(t_ns)) for t_ns in known)
    if not count:
        raise _none_left(name, selection)
    return replace(stream, frames=frames, count=count, selection=_words(selection))


def _taken(selection: FrameSelection, first_ns: int) -> Callable[[int], bool]:
    """Return what tells of one timestamp after the other [ns] whether its frame is taken; it is asked in their order.

    Of cameras that are triggered together the same frames are, also where one has lost some: time since the first frame
    counts, not their number.
    """
    stop_s = np.inf if selection.stop_s is None else selection.stop_s
    last = -1

    def taken(t_ns: int) -> bool:
        nonlocal last
        t_s = (t_ns - first_ns) * 1e-9
        if not selection.start_s <= t_s <= stop_s:
            return False
        if selection.frame_rate_hz is None:
            return True
        number = int((t_s - selection.start_s) * selection.frame_rate_hz + _AHEAD)
        if number == last:
            return False
        last = number
        return True

    return taken


def _told(selection: FrameSelection) -> str:
    return f"of the cameras the frames {_words(selection)} are taken, as stated."


def _none_left(name: str, selection: FrameSelection) -> RecordingError:
    return RecordingError(f"{name} has no frames {_words(selection)}, counted from the first frame of the recording.")


def _words(selection: FrameSelection) -> str:
    stop = "on" if selection.stop_s is None else f"to {selection.stop_s:g} s"
    rate = "" if selection.frame_rate_hz is None else f", {selection.frame_rate_hz:g} a second"
    return f"from {selection.start_s:g} s {stop}{rate}"
