"""The library of a fleet: every calibration of every device, in one SQLite file or in PostgreSQL.

Each is kept with its parameters and their full covariance, the hashes of its inputs, the software that made it,
station, operator and temperature. A calibration is in it once, however often it is added. All writing is in
transactions, and a writer waits for another one; so a process may be killed at any moment.
"""

import hashlib
import json
from collections.abc import Generator, Iterator, Mapping, Sequence
from contextlib import contextmanager
from sqlite3 import OperationalError
from time import monotonic, sleep
from typing import TYPE_CHECKING, Any, Self

import numpy as np
import orjson

from ..errors import FormatError, OptionError, OutputError, install_line
from ..recording import Floats
from .entries import LibraryEntry
from .schema import CALIBRATIONS, DETAILS, LAYOUTS, RUNS, migrate_schema, needs_migration

if TYPE_CHECKING:
    from sqlalchemy import Connection, Engine, Select

_WAIT_S = 30.0
"""How long a writer waits for another one of the same SQLite file."""
_LOCK = 0x676E6F6D6F6E  # of writers in PostgreSQL: "gnomon"
_PART = 1000  # rows that are fetched at once


class Library:
    """An open library.

    Parameters
    ----------
    place : path of an SQLite file, which is made where there is none, or a URL such as postgresql://host/name
    create : whether a new one may be made
    read_only : whether the database is told to refuse every change

    Raises
    ------
    OptionError
        If SQLAlchemy is missing, or the database cannot be reached.
    FormatError
        If it is no library, a newer gnomon's, or an older one's and must not be changed.
    """

    def __init__(self, place: str, *, create: bool = False, read_only: bool = False) -> None:
        self._engine = _connected(place, create=create, read_only=read_only)
        try:
            self._bring_up_to_date(without_password(place), read_only=read_only)
        except BaseException:
            self.close()
            raise

    def _bring_up_to_date(self, place: str, *, read_only: bool) -> None:
        with self._engine.connect() as connection:
            outdated = needs_migration(connection, place)
        if outdated and read_only:
            raise FormatError(
                f"{place}: this library is of an older gnomon, and is opened for reading alone. Bring it up to date: "
                f"gnomon library list --library {place}"
            )
        if outdated:
            with self._writing() as connection:
                migrate_schema(connection)

    def add(self, *entries: LibraryEntry) -> int:
        """Add calibrations, all or none, and return how many are new.

        Raises
        ------
        OutputError
            If the database cannot be written.
        """
        with self._writing() as connection:
            return sum(_insert(connection, entry) for entry in entries)

    def find(self, key: str) -> str | None:
        """Return the record of a run that is done (`gnomon.study.runs.Journal`)."""
        from sqlalchemy import select

        with self._engine.connect() as connection:
            return connection.scalar(select(RUNS.c.record).where(RUNS.c.key == key))

    def keep_run(self, key: str, record: str, entry: LibraryEntry | None) -> None:
        """Keep the record of a run and its calibration, both or neither."""
        with self._writing() as connection:
            if entry is not None:
                _insert(connection, entry)
            connection.execute(RUNS.delete().where(RUNS.c.key == key))
            connection.execute(RUNS.insert().values(key=key, record=record))

    def entries(
        self,
        *,
        serial: str | Sequence[str] | None = None,
        kind: str | None = None,
        details: bool = False,
        newest: int | None = None,
    ) -> Iterator[LibraryEntry]:
        """Yield the calibrations in the order of their dates, those of one day as they were added.

        Parameters
        ----------
        serial, kind : only those; None for all
        details : whether covariance and needs are read
        newest : how many of them at most, the last ones
        """
        from sqlalchemy import select

        joined = CALIBRATIONS.join(DETAILS) if details else CALIBRATIONS
        columns = [CALIBRATIONS.c[name] for name in _COLUMNS]
        columns += [DETAILS.c.covariance, DETAILS.c.needs] if details else []
        order = (CALIBRATIONS.c.measured, CALIBRATIONS.c.id)
        query = _only(select(*columns).select_from(joined), serial, kind)
        if newest is not None:
            last = _only(select(CALIBRATIONS.c.id), serial, kind).order_by(*(c.desc() for c in order)).limit(newest)
            query = query.where(CALIBRATIONS.c.id.in_(last))
        query = query.order_by(*order)
        with self._engine.connect() as connection:
            layouts = {
                row.id: (tuple(json.loads(row.names)), tuple(json.loads(row.units)))
                for row in connection.execute(select(LAYOUTS))
            }
            for row in connection.execution_options(yield_per=_PART).execute(query):
                yield _entry(row, layouts)

    def serials(
        self, *, containing: str = "", kind: str | None = None, skip: int = 0, most: int
    ) -> list[tuple[str, int]]:
        """Return serial numbers in their order, and how many calibrations each has; see `entries`."""
        from sqlalchemy import func, select

        serial = CALIBRATIONS.c.serial
        query = _only(select(serial, func.count().label("calibrations")), None, kind).group_by(serial).order_by(serial)
        query = query.where(serial.contains(containing, autoescape=True)) if containing else query
        with self._engine.connect() as connection:
            return [(row[0], row.calibrations) for row in connection.execute(query.offset(skip).limit(most))]

    def state(self) -> int:
        """Return a number that grows whenever a calibration is added."""
        from sqlalchemy import func, select

        with self._engine.connect() as connection:
            return connection.scalar(select(func.max(CALIBRATIONS.c.id))) or 0

    def count(self) -> int:
        """Return how many calibrations there are."""
        from sqlalchemy import func, select

        with self._engine.connect() as connection:
            return connection.scalar(select(func.count()).select_from(CALIBRATIONS)) or 0

    def close(self) -> None:
        """Close the connections."""
        self._engine.dispose()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @contextmanager
    def _writing(self) -> Generator["Connection"]:
        from sqlalchemy.exc import DBAPIError

        try:
            with self._engine.execution_options(writes=True).begin() as connection:
                yield connection
        except DBAPIError as error:
            raise OutputError(f"{self._engine.url}: the library cannot be written ({error.orig}).") from error


def _only(query: "Select[*tuple[Any, ...]]", serial: str | Sequence[str] | None, kind: str | None) -> Any:
    """Return a query of the calibrations of these serial numbers and this kind; None for all."""
    if serial is not None:
        query = query.where(CALIBRATIONS.c.serial.in_([serial] if isinstance(serial, str) else serial))
    return query if kind is None else query.where(CALIBRATIONS.c.kind == kind)


def _insert(connection: "Connection", entry: LibraryEntry) -> bool:
    """Insert a calibration where it is not there yet, within the transaction of a writer."""
    from sqlalchemy import select

    key = entry.key
    if connection.scalar(select(CALIBRATIONS.c.id).where(CALIBRATIONS.c.key == key)) is not None:
        return False
    named = json.dumps([entry.names, entry.units])
    digest = hashlib.sha256(named.encode()).hexdigest()
    layout = connection.scalar(select(LAYOUTS.c.id).where(LAYOUTS.c.digest == digest))
    if layout is None:
        new = LAYOUTS.insert().values(digest=digest, names=json.dumps(entry.names), units=json.dumps(entry.units))
        (layout,) = connection.execute(new).inserted_primary_key or (None,)
    row = {name: getattr(entry, name) for name in _PLAIN} | {
        "key": key,
        "layout": layout,
        "temperature_c": entry.temperature_c if np.isfinite(entry.temperature_c) else None,
        "inputs": json.dumps(entry.inputs),
        "findings": json.dumps(entry.findings),
        "values": entry.values.tobytes(),
        "sigmas": entry.sigmas.tobytes(),
    }
    (number,) = connection.execute(CALIBRATIONS.insert().values(row)).inserted_primary_key or (None,)
    lower = entry.covariance[np.tril_indices(len(entry.covered))].tobytes()
    packed = np.array([len(entry.covered), *entry.covered], dtype="<i4").tobytes() + lower
    connection.execute(DETAILS.insert().values(calibration=number, covariance=packed, needs=json.dumps(entry.needs)))
    return True


_PLAIN = (
    "serial", "measured", "station", "operator", "kind", "verdict", "use", "version", "folder", "gravity",
)  # fmt: skip


_COLUMNS = (*_PLAIN, "temperature_c", "inputs", "findings", "layout", "values", "sigmas")


def _entry(row: Sequence[Any], layouts: Mapping[int, tuple[tuple[str, ...], tuple[str, ...]]]) -> LibraryEntry:
    """Return the calibration of a row of _COLUMNS and, where they were read, the details."""
    serial, measured, station, operator, kind, verdict, use, version, folder, gravity = row[:10]
    temperature_c, inputs, findings, layout, values, sigmas = row[10:16]
    names, units = layouts[layout]
    covered, covariance = _unpacked(row[16]) if len(row) > 16 else _NO_DETAILS
    return LibraryEntry(
        serial=serial,
        measured=measured,
        station=station,
        operator=operator,
        temperature_c=float("nan") if temperature_c is None else temperature_c,
        kind=kind,
        verdict=verdict,
        use=use,
        version=version,
        folder=folder,
        gravity=gravity,
        inputs=tuple([(name, digest) for name, digest in orjson.loads(inputs)]),
        findings=() if findings == "[]" else tuple(orjson.loads(findings)),
        needs=tuple((*need,) for need in orjson.loads(row[17])) if len(row) > 16 else (),
        names=names,
        units=units,
        values=np.frombuffer(values),
        sigmas=np.frombuffer(sigmas),
        covariance=covariance,
        covered=covered,
    )


_NO_DETAILS: tuple[tuple[int, ...], Floats] = ((), np.empty((0, 0)))


def _unpacked(packed: bytes) -> tuple[tuple[int, ...], Floats]:
    count = int(np.frombuffer(packed, "<i4", 1)[0])
    covered = tuple(np.frombuffer(packed, "<i4", count, 4).tolist())
    matrix = np.zeros((count, count))
    matrix[np.tril_indices(count)] = np.frombuffer(packed, "<f8", offset=4 + 4 * count)
    return covered, matrix + np.tril(matrix, -1).T


def _connected(place: str, *, create: bool, read_only: bool) -> "Engine":
    try:
        from sqlalchemy import create_engine, event, make_url
        from sqlalchemy.exc import ArgumentError, SQLAlchemyError
    except ImportError as error:
        raise OptionError(f"a library needs SQLAlchemy. Run: {install_line('gnomon[fleet]')}") from error
    from pathlib import Path

    if "://" not in place:
        if not create and not Path(place).is_file():
            raise OptionError(f"{place}: there is no such library. gnomon batch or gnomon library import makes one.")
        if Path(place).is_file():
            with Path(place).open("rb") as file:
                if file.read(16) not in (b"", b"SQLite format 3\0"):
                    raise FormatError(f"{place}: this file is no library of gnomon. Name another.")
        place = f"sqlite:///{place}"
    try:
        url = make_url(place)
        url = url.set(drivername="postgresql+psycopg") if url.drivername in ("postgresql", "postgres") else url
        engine = create_engine(url, execution_options={"read_only": read_only})
        if url.get_backend_name() == "sqlite":
            event.listen(engine, "connect", _prepare_sqlite)
            if read_only:
                event.listen(engine, "connect", lambda raw, _: raw.execute("PRAGMA query_only = ON"))
        event.listen(engine, "begin", _begin)
        engine.connect().close()
    except ImportError as error:
        raise OptionError(f"{place}: its driver is missing ({error}). Run: {install_line('gnomon[fleet]')}") from error
    except (ArgumentError, SQLAlchemyError) as error:
        reason = str(getattr(error, "orig", None) or error).strip().splitlines()[0]
        raise OptionError(f"--library {without_password(place)}: it cannot be opened ({reason}).") from error
    return engine


def without_password(place: str) -> str:
    """Return a path or URL of a library, without user and password."""
    head, at, tail = place.rpartition("@")
    return f"{head.partition('://')[0]}://...@{tail}" if at and "://" in head else place


def _prepare_sqlite(connection: Any, _record: object) -> None:
    """Leave transactions to SQLAlchemy; readers do not wait for a writer, and a writer waits for another one."""
    connection.isolation_level = None
    connection.execute(f"PRAGMA busy_timeout = {int(1000 * _WAIT_S)}")
    _keep_write_ahead_log(connection)
    connection.execute("PRAGMA synchronous = FULL")
    connection.execute("PRAGMA foreign_keys = ON")


def _keep_write_ahead_log(connection: Any) -> None:
    """Change a new file to a write-ahead log; two that do so at once are told "locked" whatever the timeout is."""
    deadline = monotonic() + _WAIT_S
    while True:
        try:
            connection.execute("PRAGMA journal_mode = WAL")
        except OperationalError:
            if monotonic() > deadline:
                raise
            sleep(0.01)
        else:
            return


def _begin(connection: "Connection") -> None:
    """Begin a transaction; who writes waits until no other one does, since it looks before it adds."""
    writes = connection.get_execution_options().get("writes", False)
    if connection.dialect.name == "sqlite":
        connection.exec_driver_sql("BEGIN IMMEDIATE" if writes else "BEGIN")
    elif connection.get_execution_options().get("read_only"):
        connection.exec_driver_sql("SET TRANSACTION READ ONLY")
    elif writes and connection.dialect.name == "postgresql":
        connection.exec_driver_sql(f"SELECT pg_advisory_xact_lock({_LOCK})")
