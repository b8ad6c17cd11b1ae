"""A library as one table: a row for each calibration, with its facts and each scalar with its sigma."""

import csv
import io
from collections.abc import Iterable
from pathlib import Path

from ..errors import OptionError, install_line
from ..output import write_whole
from ..recording.samples import make_dataframe
from .entries import LibraryEntry

_FACTS = (
    "serial", "measured", "kind", "verdict", "use", "station", "operator", "temperature_c", "version", "gravity",
)  # fmt: skip


def export_table(entries: Iterable[LibraryEntry], path: Path) -> int:
    """Write calibrations as CSV or Parquet, by the ending of the path, and return how many there are.

    A scalar that a calibration did not estimate is empty; sigmas are those by which devices are compared.

    Raises
    ------
    OptionError
        If the ending is another one, or pandas or pyarrow are missing for Parquet.
    OutputError
        If the file cannot be written.
    """
    if path.suffix.lower() not in (".csv", ".parquet"):
        raise OptionError(f"{path}: name a file .csv or .parquet.")
    every = list(entries)
    names = list(dict.fromkeys(name for layout in {entry.names for entry in every} for name in layout))
    columns: dict[str, list[object]] = {fact: [getattr(entry, fact) for entry in every] for fact in _FACTS}
    columns |= {f"{name}{suffix}": [None] * len(every) for name in names for suffix in ("", "_sigma")}
    for row, entry in enumerate(every):
        for name, value, sigma in zip(entry.names, entry.values.tolist(), entry.sigmas.tolist(), strict=True):
            columns[name][row], columns[f"{name}_sigma"][row] = value, sigma
    write_whole(path, _csv(columns) if path.suffix.lower() == ".csv" else _parquet(columns))
    return len(every)


def _csv(columns: dict[str, list[object]]) -> str:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows([_inert(cell) for cell in row] for row in zip(*columns.values(), strict=True))
    return text.getvalue()


def _inert(cell: object) -> object:
    """Return a text that no spreadsheet takes for a formula; a serial number may begin with =."""
    return f"'{cell}" if isinstance(cell, str) and cell[:1] in ("=", "+", "-", "@") else cell


def _parquet(columns: dict[str, list[object]]) -> bytes:
    stream = io.BytesIO()
    try:
        make_dataframe(columns).to_parquet(stream)
    except (ImportError, AttributeError) as error:
        raise OptionError(f"Parquet needs pandas and pyarrow. Run: {install_line('pandas', 'pyarrow')}") from error
    return stream.getvalue()
