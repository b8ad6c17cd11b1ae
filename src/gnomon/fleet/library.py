"""The library of a fleet: every calibration of every device, in one SQLite file or in PostgreSQL.

Each is kept with its parameters and their full covariance, the hashes of its inputs, the software that made it,
station, operator and temperature. A calibration is in it once, however often it is added. All writing is in
transactions, and a writer waits for another one; so a process may be killed at any moment.
"""

import hashlib
import json
import re
import sqlite3
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from functools import cached_property
from pathlib import Path
from time import monotonic, sleep
from typing import TYPE_CHECKING, Any, Self

import numpy as np
import orjson

from ..errors import FormatError, OptionError, OutputError, install_line
from ..recording import Floats
from .entries import LibraryEntry

if TYPE_CHECKING:
    from sqlalchemy import Connection, Engine

    Ask = Callable[[str, Sequence[object]], Any]
    """Sends a question of plain SQL, with ? for values, and returns its rows."""

LATEST = 2
"""Version of the tables, which is the number of steps in `schema.MIGRATIONS`."""

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
        self._place, self._read_only = place, read_only
        self._file = Path(place.removeprefix("sqlite:///")) if _is_file(place) else None
        if self._file is not None:
            _check_file(self._file, create=create)
            if self._file.is_file() and self._version() == LATEST:
                return  # and SQLAlchemy, which takes longer to import than most questions, is not asked for
        try:
            self._bring_up_to_date(without_password(place), read_only=read_only)
        except BaseException:
            self.close()
            raise

    def _bring_up_to_date(self, place: str, *, read_only: bool) -> None:
        from .schema import migrate_schema, needs_migration

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
        return self._asked("SELECT record FROM runs WHERE key = ?", key)

    def keep_run(self, key: str, record: str, entry: LibraryEntry | None) -> None:
        """Keep the record of a run and its calibration, both or neither."""
        from .schema import RUNS

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
        columns = [f'calibrations."{name}"' for name in _COLUMNS] + (["covariance", "needs"] if details else [])
        tables = f"calibrations {'JOIN details ON details.calibration = calibrations.id' if details else ''}"
        which, values = _only(serial, kind)
        if newest is not None:
            latest = f"SELECT id FROM calibrations{which} ORDER BY measured DESC, id DESC LIMIT ?"
            which, values = f" WHERE id IN ({latest})", (*values, newest)
        with self._reading() as ask:
            layouts = {
                number: (tuple(json.loads(names)), tuple(json.loads(units)))
                for number, names, units in ask("SELECT id, names, units FROM layouts", ())
            }
            query = f"SELECT {', '.join(columns)} FROM {tables}{which} ORDER BY measured, id"
            for row in ask(query, values):
                yield _entry(row, layouts)

    def serials(
        self, *, containing: str = "", kind: str | None = None, skip: int = 0, most: int
    ) -> list[tuple[str, int]]:
        """Return serial numbers in their order, and how many calibrations each has; see `entries`."""
        which, values = _only(None, kind)
        if containing:
            which += f" {'AND' if which else 'WHERE'} serial LIKE ? ESCAPE '/'"
            values = (*values, "%{}%".format(re.sub("[/%_]", r"/\g<0>", containing)))
        query = f"SELECT serial, count(*) FROM calibrations{which} GROUP BY serial ORDER BY serial LIMIT ? OFFSET ?"
        with self._reading() as ask:
            return [*map(tuple, ask(query, (*values, most, skip)))]

    def state(self) -> int:
        """Return a number that grows whenever a calibration is added."""
        return self._asked("SELECT coalesce(max(id), 0) FROM calibrations")

    def count(self) -> int:
        """Return how many calibrations there are."""
        return self._asked("SELECT count(*) FROM calibrations")

    def close(self) -> None:
        """Close the connections."""
        if "_engine" in self.__dict__:
            self._engine.dispose()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @cached_property
    def _engine(self) -> "Engine":
        place = self._place if self._file is None else f"sqlite:///{self._file}"
        return _connected(place, read_only=self._read_only)

    def _version(self) -> int | None:
        """Return the version that a file of SQLite states; None where it states none."""
        try:
            return self._asked("SELECT version FROM gnomon_library")
        except sqlite3.Error:
            return None

    def _asked(self, query: str, *values: object) -> Any:
        """Return the one value that answers a question; None where there is none."""
        with self._reading() as ask:
            return next(iter([*ask(query, values)]), (None,))[0]

    @contextmanager
    def _reading(self) -> "Generator[Ask]":
        """Give what asks the database, in one transaction: SQLite directly, others through SQLAlchemy."""
        if self._file is not None:
            with closing(sqlite3.connect(self._file)) as raw:
                _prepare_sqlite(raw, None)
                raw.execute("PRAGMA query_only = ON")
                raw.execute("BEGIN")
                yield raw.execute
        else:
            with self._engine.connect() as connection:
                streamed = connection.execution_options(yield_per=_PART)
                mark = "?" if connection.dialect.paramstyle == "qmark" else "%s"
                yield lambda query, values: streamed.exec_driver_sql(query.replace("?", mark), tuple(values))

    @contextmanager
    def _writing(self) -> Generator["Connection"]:
        from sqlalchemy.exc import DBAPIError

        try:
            with self._engine.execution_options(writes=True).begin() as connection:
                yield connection
        except DBAPIError as error:
            raise OutputError(f"{self._engine.url}: the library cannot be written ({error.orig}).") from error


def _only(serial: str | Sequence[str] | None, kind: str | None) -> tuple[str, tuple[object, ...]]:
    """Return the condition on calibrations of these serial numbers and this kind, and its values; None for all."""
    serials = [serial] if isinstance(serial, str) else serial
    given = [("kind", [kind] if kind is not None else None), ("serial", serials)]
    wanted = {name: values for name, values in given if values is not None}
    conditions = [f"{name} IN ({', '.join('?' * len(values)) or 'NULL'})" for name, values in wanted.items()]
    return "".join(f" {'AND' if k else 'WHERE'} {condition}" for k, condition in enumerate(conditions)), tuple(
        value for values in wanted.values() for value in values
    )


def _insert(connection: "Connection", entry: LibraryEntry) -> bool:
    """Insert a calibration where it is not there yet, within the transaction of a writer."""
    from sqlalchemy import select

    from .schema import CALIBRATIONS, DETAILS, LAYOUTS

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


def _is_file(place: str) -> bool:
    return "://" not in place or (place.startswith("sqlite:///") and "?" not in place)


def _check_file(path: Path, *, create: bool) -> None:
    """Refuse a path where no library is, and none may be made, or where another file is."""
    if not path.is_file():
        if create:
            return
        raise OptionError(f"{path}: there is no such library. gnomon batch or gnomon library import makes one.")
    with path.open("rb") as file:
        if file.read(16) not in (b"", b"SQLite format 3\0"):
            raise FormatError(f"{path}: this file is no library of gnomon. Name another.")


def _connected(place: str, *, read_only: bool) -> "Engine":
    try:
        from sqlalchemy import create_engine, event, make_url
        from sqlalchemy.exc import ArgumentError, SQLAlchemyError
    except ImportError as error:
        raise OptionError(f"a library needs SQLAlchemy. Run: {install_line('gnomon[fleet]')}") from error
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
        except sqlite3.OperationalError:
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
