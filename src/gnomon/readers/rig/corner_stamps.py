"""The stamps of a folder with corners, where neither the cameras nor the board are described."""

from collections.abc import Mapping
from dataclasses import dataclass
from os import PathLike
from pathlib import Path

import numpy as np

from ...errors import RecordingError
from ...recording import ImuSamples, Integers, Source
from ...units import Units
from .camera_folder import corner_streams, imu_files, recording_folder
from .corner_table import read_corner_table, read_frame_stamps
from .imu_stream import read_imu


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CornerStamps:
    """Samples, and when frames were taken.

    Attributes
    ----------
    imus : "imu0", ... -> samples
    frames : "cam0", ... -> (n,) stamps of its frames, ascending [ns]
    corners : "cam0", ... -> number of rows with corners
    assumptions : sentences on what was assumed
    """

    imus: Mapping[str, ImuSamples]
    frames: Mapping[str, Integers]
    corners: Mapping[str, int]
    assumptions: tuple[str, ...]


def read_corner_stamps(path: str | PathLike[str], units: str | Units | None = None) -> CornerStamps:
    """Read samples and stamps of a folder with corners.

    Raises
    ------
    RecordingError
        If a table cannot be read.
    OptionError
        If `units` names no unit.
    """
    stated = Units.parse(units) if isinstance(units, str) else units or Units()
    folder = recording_folder(Path(path))
    notes: list[str] = []
    sources: list[Source] = []
    frames: dict[str, Integers] = {}
    corners: dict[str, int] = {}
    for name, stream in corner_streams(folder).items():
        table = read_corner_table(stream.corners, stated.time)
        notes.extend(table.notes)
        all_stamps = table.t_ns
        if stream.frames is not None:
            listed, _, note = read_frame_stamps(stream.frames, stated.time)
            all_stamps = np.concatenate([listed, table.t_ns])
            notes.extend(text for text in (note,) if text)
        frames[name], corners[name] = np.unique(all_stamps), len(table.t_ns)
    try:
        files = imu_files(folder)
    except RecordingError:
        files = {}
    imus = {
        name: read_imu(name, tables, None, units=stated, sources=sources, notes=notes) for name, tables in files.items()
    }
    return CornerStamps(imus=imus, frames=frames, corners=corners, assumptions=tuple(notes))
