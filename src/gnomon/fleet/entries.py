"""What the library keeps of a calibration and the calibrations of a line as arrays or one table."""

import csv
import hashlib
import io
import json
from collections.abc import Iterable, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, Self

import numpy as np

from ..errors import OptionError, install_line
from ..frozen import value_class
from ..output import write_whole
from ..recording import Floats
from ..recording.dataframes import make_dataframe
from ..results.calibration import Calibration
from ..results.sensors import calibration_parameters, element_units


@value_class
class LibraryEntry:
    """A calibration, as the library keeps it.

    Attributes
    ----------
    serial, measured, station, operator : what was stated of it; measured is YYYY-MM-DD; "" where it was not
    temperature_c : of the measurement, as stated, by the chip, or at which the numbers hold; nan where nothing tells
    kind : the command that made it, such as "imu"
    verdict, use, version, folder : verdict, what it was judged for, the gnomon that made it, the folder of its result
    gravity : what was taken for gravity [m/s^2]
    inputs : (name, SHA-256) of each file
    findings : codes of its problems and warnings
    needs : (what, sigma, needed, unit, verdict) of each quantity of the use
    names, units : (n,) of the scalars
    values : (n,) [units]
    sigmas : (n,) standard deviations by which it is compared with other devices, gravity's part, which all share, taken
        off [units]; 0 of what was not estimated
    covariance : (k, k) of the k scalars whose published variance is not zero [products of units]; (0, 0) where the
        details were not read
    covered : (k,) their indices
    """

    serial: str
    measured: str
    station: str
    operator: str
    temperature_c: float
    kind: str
    verdict: str
    use: str
    version: str
    folder: str
    gravity: float
    inputs: tuple[tuple[str, str], ...]
    findings: tuple[str, ...]
    needs: tuple[tuple[str, float, float, str, str], ...]
    names: tuple[str, ...]
    units: tuple[str, ...]
    values: Floats
    sigmas: Floats
    covariance: Floats
    covered: tuple[int, ...]

    @classmethod
    def of_calibration(cls, calibration: Calibration, *, serial: str = "", folder: str = "") -> Self:
        """Return what the library keeps of a calibration; `serial` where the calibration states none."""
        stated, assessment = calibration.provenance.options, calibration.assessment
        matrix = calibration.uncertainty.matrix
        covered = np.flatnonzero(np.diag(matrix) > 0)
        known_part = matrix[np.ix_(covered, covered)]
        known = list(calibration_parameters(calibration.imus, calibration.cameras))
        holds_at = [imu.temperature.reference_degc for imu in calibration.imus.values() if imu.temperature is not None]
        return cls(
            serial=stated.get("serial", serial),
            measured=stated.get("date", ""),
            station=stated.get("place", ""),
            operator=stated.get("operator", ""),
            temperature_c=float(stated.get("temperature_c", stated.get("chip_degc", [*holds_at, "nan"][0]))),
            kind=calibration.provenance.method,
            verdict=calibration.verdict,
            use=assessment.trust.use,
            version=calibration.provenance.gnomon_version,
            folder=folder,
            gravity=calibration.gravity.value,
            inputs=tuple((source.name, source.sha256) for source in calibration.provenance.inputs),
            findings=tuple(f.code for f in assessment.findings if f.severity in ("problem", "warning")),
            needs=tuple((n.block, n.sigma, n.needed, n.unit, n.verdict) for n in assessment.trust.needs),
            names=calibration.uncertainty.names,
            units=tuple(unit for path, _ in known for unit in element_units(calibration, path)),
            values=np.concatenate([np.ravel(value) for _, value in known]),
            sigmas=_comparable_sigmas(calibration),
            covariance=np.tril(known_part) + np.tril(known_part, -1).T,  # as its file has it, to the last bit
            covered=tuple(covered.tolist()),
        )

    @property
    def published_sigmas(self) -> Floats:
        """Standard deviations (n,) as published, gravity's part included; 0 where the details were not read."""
        sigmas = np.zeros(len(self.names))
        sigmas[list(self.covered)] = np.sqrt(np.diag(self.covariance))
        return sigmas

    @property
    def key(self) -> str:
        """A hash of what was measured and found, whenever and wherever it is added."""
        facts = [getattr(self, f.name) for f in fields(self) if f.name not in _UNKEYED]
        digest = hashlib.sha256(json.dumps([*facts, str(self.temperature_c)]).encode())
        digest.update(self.values.tobytes() + self.covariance.tobytes())
        return digest.hexdigest()

    @property
    def digests(self) -> frozenset[str]:
        """Hashes of the files that hold measurements, not settings."""
        return frozenset([digest for name, digest in self.inputs if not name[-5:].lower().endswith((".yaml", ".yml"))])


_UNKEYED = frozenset(("folder", "values", "sigmas", "covariance", "covered", "needs", "findings", "temperature_c"))


def _comparable_sigmas(calibration: Calibration) -> Floats:
    """Return standard deviations (n,) without gravity's part, by which all scales of a place are wrong alike.

    A sensitivity S goes as 1 / g, so that this part is S sigma_g / g. Of cameras with an IMU, which see accelerations,
    it may be less; there a hundredth of the variance is left at least.
    """
    least = 1e-2 if calibration.cameras else 1e-6  # of the variance; without cameras all of gravity's part is in it
    variance = np.diag(calibration.uncertainty.matrix).copy()
    relative = calibration.gravity.sigma / calibration.gravity.value
    place = 0
    for path, value in calibration_parameters(calibration.imus, calibration.cameras):
        part = slice(place, place + np.size(value))
        if path.endswith("accelerometer.sensitivity"):
            variance[part] = np.maximum(variance[part] - (np.ravel(value) * relative) ** 2, least * variance[part])
        place = part.stop
    return np.sqrt(variance)


@value_class
class LineTable:
    """Calibrations of one kind as arrays, in the order of their dates.

    Attributes
    ----------
    entries : (n,)
    names, units : (k,) of the scalars that any of them estimated
    values, sigmas : (n, k) [units]; nan where it was not estimated
    """

    entries: tuple[LibraryEntry, ...]
    names: tuple[str, ...]
    units: tuple[str, ...]
    values: Floats
    sigmas: Floats

    def rows(self, kept: Sequence[int] | np.ndarray[Any, Any]) -> Self:
        """Return the same of some rows."""
        return replace(
            self,
            entries=tuple(self.entries[i] for i in np.asarray(kept, dtype=int)),
            values=self.values[kept],
            sigmas=self.sigmas[kept],
        )


def line_table(entries: Sequence[LibraryEntry]) -> LineTable:
    """Return the calibrations of a line as arrays."""
    units: dict[str, str] = {}
    layouts = {entry.names: entry.units for entry in entries}
    for names, own in layouts.items():
        units |= dict(zip(names, own, strict=True))
    column = {name: index for index, name in enumerate(units)}
    values, sigmas = np.full((2, len(entries), len(units)), np.nan)
    rows: dict[tuple[str, ...], list[int]] = {}
    for row, entry in enumerate(entries):
        rows.setdefault(entry.names, []).append(row)
    for names, own in rows.items():
        at = np.ix_(own, [column[name] for name in names])
        read, estimated = (
            np.frombuffer(b"".join(getattr(entries[row], name) for row in own)).reshape(len(own), len(names))
            for name in ("values", "sigmas")
        )
        known = estimated > 0
        values[at] = np.where(known, read, np.nan)
        sigmas[at] = np.where(known, estimated, np.nan)
    used: list[int] = np.flatnonzero(np.isfinite(values).any(axis=0)).tolist()
    names = list(units)
    return LineTable(
        entries=tuple(entries),
        names=tuple(names[k] for k in used),
        units=tuple(units[names[k]] for k in used),
        values=values[:, used],
        sigmas=sigmas[:, used],
    )


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
