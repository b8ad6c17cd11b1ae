"""Format "pose files": a file for each pose in which the sensor rested, all in one format, joined to one recording."""

import re
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np

from ...errors import RecordingError
from ...recording import Integers, Piece
from .folder import accelerometer_and_gyroscope, known_layout, sample_files
from .table import SampleTable, Triad

FEWEST_FILES = 3
_BETWEEN_NS = 1_000_000_000  # between files whose clocks start anew
_LONGEST_NS = 86_400 * 1_000_000_000


def pose_files(paths: Sequence[str | Path]) -> list[Path] | None:
    """Return the files of poses, three or more paths or those in a folder; None where the paths mean something else.

    Files in a folder come in the order of their names, numbers in them counting as numbers: pose2 before pose10.
    """
    files = [Path(path) for path in paths]
    if len(files) == 1 and files[0].is_dir() and known_layout(files[0]) is None:
        found = sample_files(files[0])
        if any(".npz" in path.suffixes for path in found):
            return None
        if len(found) >= FEWEST_FILES and accelerometer_and_gyroscope(found) is None:
            return sorted(found, key=_by_number)
    return files if len(files) >= FEWEST_FILES else None


def _by_number(path: Path) -> list[tuple[int, str]]:
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in re.split(r"(\d+)", path.name.lower())]


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
