"""The images of one camera as files in a folder, with their stamps in a table or in their names."""

from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from ...errors import RecordingError
from ...images import Frame, ImageStream
from ...recording import Integers, Source, frozen_array
from ..read_log import ReadLog
from .camera_places import CameraPlace, image_names
from .frame_stamps import FrameTable, are_stamps, numbered_names, read_frame_table, stamps_in_names, stem_of
from .image_file import hash_of_images, read_grey, used_bits


def folder_stream(name: str, place: CameraPlace, log: ReadLog) -> ImageStream:
    """Return the stream of the images in a folder, in the order of their stamps.

    Parameters
    ----------
    name : "cam0", "cam1", ...
    place : where its images are
    log : what was stated; the files that are read, and sentences on what was left out or assumed, are added

    Raises
    ------
    RecordingError
        If nothing tells when the images were taken, none of those that are listed is there, or stamps are damaged.
    """
    folder = place.folder
    assert folder is not None
    files = sorted(image_names(folder, place.prefix))
    if place.table is None and log.cameras_alone and not are_stamps(files):
        t_ns, note = numbered_names(files, place.label)
        log.note(note)
    elif place.table is None:
        t_ns, note = stamps_in_names(files, log.units.time, place.label)
        log.note(note)
    else:
        table = read_frame_table(place.table, files, log.units.time)
        log.sources.append(replace(table.source, name=f"{name}/{table.source.name}"))
        log.notes.extend(table.notes)
        files, t_ns = _listed(table, files, place, log)
    files, t_ns = _in_order(files, t_ns, place, log)
    digest = hash_of_images((file, folder / file) for file in files)
    log.sources.append(Source(name=f"{name} ({len(files)} image{'s' if len(files) != 1 else ''})", sha256=digest))
    bits = used_bits([(folder / file, _where(place.label, file)) for file in files])
    if bits is not None and bits != 16:
        log.note(f"{place.label}: the images have 16 bits, of which {bits} are used; the upper 8 of these were taken.")
    return ImageStream(frames=partial(_frames, folder, place.label, tuple(files), t_ns, bits), count=len(files))


def _frames(
    folder: Path, label: str, files: tuple[str, ...], t_ns: Integers, bits: int | None, _notes: list[str]
) -> Iterator[Frame]:
    for file, stamp in zip(files, t_ns, strict=True):
        where = _where(label, file)
        yield Frame(t_ns=int(stamp), where=where, decode=partial(read_grey, folder / file, where, bits))


def _where(label: str, file: str) -> str:
    return f"{label}{file}" if label.endswith("/") else file


def _listed(table: FrameTable, files: list[str], place: CameraPlace, log: ReadLog) -> tuple[list[str], Integers]:
    """Return the images that are both listed and there, in the order of the table, and their stamps."""
    where = table.source.name
    if table.names is None:
        if len(table.t_ns) != len(files):
            raise RecordingError(
                f"{where}: found {len(table.t_ns)} stamps and {len(files)} images in {place.label}; without names of "
                'files there must be one for each, in the order of their names. Add a column "filename".'
            )
        log.note(f"{where}: its stamps were given to the images of {place.label} in the order of their names.")
        return files, table.t_ns
    there = {stem_of(file): file for file in files} | {file: file for file in files}
    found = [there.get(name) or there.get(stem_of(name)) for name in table.names]
    kept = [(file, row) for row, file in enumerate(found) if file is not None]
    if not kept:
        raise RecordingError(
            f"{where}: none of the {len(found)} images that it lists, such as {table.names[0]}, is in {place.label}, "
            f"which holds {files[0]}{', ...' if len(files) > 1 else ''}. Was the folder copied completely?"
        )
    missing = len(found) - len(kept)
    if missing:
        first = next(name for name, file in zip(table.names, found, strict=True) if file is None)
        log.note(f"{where}: {missing} of {len(found)} images that it lists are not in {place.label}, such as {first}.")
    unlisted = len(files) - len({file for file, _ in kept})
    if unlisted:
        log.note(f"{where}: {unlisted} of {len(files)} images in {place.label} are not listed and were left out.")
    return [file for file, _ in kept], table.t_ns[[row for _, row in kept]]


def _in_order(files: list[str], t_ns: Integers, place: CameraPlace, log: ReadLog) -> tuple[list[str], Integers]:
    """Return images in the order of time, one for each stamp."""
    order = np.argsort(t_ns, kind="stable")
    if place.table is not None and (np.diff(t_ns) < 0).any():
        log.note(f"{place.table.name}: the rows are not in the order of time; they were sorted.")
    new = np.concatenate([[True], np.diff(t_ns[order]) > 0])
    twice = len(order) - int(np.count_nonzero(new))
    if twice > 0.5 * len(order):
        raise RecordingError(
            f"{place.label}: {twice} of {len(order)} images have the same stamp as another one; the first is "
            f"{t_ns[order[0]]} ns. The stamps are too coarse, or were not recorded; write them in nanoseconds."
        )
    if twice:
        log.note(f"{place.label}: {twice} of {len(order)} images have the stamp of another one and were left out.")
    kept = order[new]
    return [files[i] for i in kept], frozen_array(t_ns[kept], np.int64)
