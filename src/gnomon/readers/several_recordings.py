"""Several paths: one recording in several files, a pose each, or several recordings; told by what is in them."""

from pathlib import Path

import numpy as np

from ..errors import RecordingError
from ..recording import Floats, Recording
from ..units import Units
from .devices.device_log import is_device_log
from .files import NPZ_MAGIC, first_bytes, read_text
from .recordings import read
from .samples.pose_files import FEWEST_FILES
from .samples.table import Table, read_table

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
    stated = Units() if units is None else Units.parse(units) if isinstance(units, str) else units
    try:
        tables = [read_table(read_text(path), columns, rate_hz, stated) for path in paths]
    except RecordingError:
        return False  # whoever reads them as one recording says what is wrong
    kinds = [sorted(triad.quantity for triad in table.triads if triad.quantity != "magnetometer") for table in tables]
    if len(paths) < FEWEST_FILES:
        return all(len(kind) > 1 for kind in kinds) or all(kind == ["accelerometer"] for kind in kinds)
    return 2 * sum(_turned(table) for table in tables) > len(tables)


def _turned(table: Table) -> bool:
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
