"""The tables of a library, and the steps that bring an older one up to date."""

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from ..errors import FormatError, OptionError, install_line

try:
    from sqlalchemy import Column, Float, ForeignKey, Index, Integer, LargeBinary, MetaData, String, Table, Text
    from sqlalchemy import inspect as inspect_database
except ImportError as error:
    raise OptionError(f"a library needs SQLAlchemy. Run: {install_line('gnomon[fleet]')}") from error

if TYPE_CHECKING:
    from sqlalchemy import Connection

_META = MetaData()
VERSION = Table("gnomon_library", _META, Column("version", Integer, nullable=False))
LAYOUTS = Table(
    "layouts",
    _META,
    Column("id", Integer, primary_key=True),
    Column("digest", String(64), unique=True, nullable=False),
    Column("names", Text, nullable=False),
    Column("units", Text, nullable=False),
)
"""Names and units of scalars, which are the same for many calibrations; JSON."""
CALIBRATIONS = Table(
    "calibrations",
    _META,
    Column("id", Integer, primary_key=True),
    Column("key", String(64), unique=True, nullable=False),
    *(
        Column(name, Text, nullable=False)
        for name in ("serial", "measured", "station", "operator", "kind", "verdict", "use", "version", "folder")
    ),
    Column("temperature_c", Float(53)),
    Column("gravity", Float(53), nullable=False),
    Column("inputs", Text, nullable=False),
    Column("findings", Text, nullable=False),
    Column("layout", ForeignKey(LAYOUTS.c.id), nullable=False),
    Column("values", LargeBinary, nullable=False),
    Column("sigmas", LargeBinary, nullable=False),
    Index("by_serial", "serial", "measured"),
    BY_DATE := Index("by_date", "measured", "id"),
)
DETAILS = Table(
    "details",
    _META,
    Column("calibration", ForeignKey(CALIBRATIONS.c.id), primary_key=True),
    Column("covariance", LargeBinary, nullable=False),
    Column("needs", Text, nullable=False),
)
"""What few are asked for: indices of the scalars and the lower triangle of their covariance; what the use needs."""
RUNS = Table("runs", _META, Column("key", String(64), primary_key=True), Column("record", Text, nullable=False))
"""What `batch` has done."""


def _make_tables(connection: "Connection") -> None:
    _META.create_all(connection)


def _index_dates(connection: "Connection") -> None:
    BY_DATE.create(connection, checkfirst=True)  # a new library has it from its first step


MIGRATIONS: Sequence[Callable[["Connection"], None]] = (_make_tables, _index_dates)
"""Step k makes version k + 1 of version k; a library states the version that it has."""


def needs_migration(connection: "Connection", place: str) -> bool:
    """Tell whether a library is older than this gnomon, or not made yet; nothing is written.

    Raises
    ------
    FormatError
        If a newer gnomon made it, or the database is something else's.
    """
    version = _version(connection)
    if version == 0 and set(inspect_database(connection).get_table_names()) & set(_META.tables) - {VERSION.name}:
        raise FormatError(f"{place}: this database is no library of gnomon. Name another.")
    if version > len(MIGRATIONS):
        raise FormatError(
            f"{place}: this library has version {version}, and this gnomon knows {len(MIGRATIONS)}. Update gnomon."
        )
    return version < len(MIGRATIONS)


def migrate_schema(connection: "Connection") -> None:
    """Bring a library up to date within the transaction of a writer, unless another one just did."""
    version = _version(connection)
    if version >= len(MIGRATIONS):
        return
    for step in MIGRATIONS[version:]:
        step(connection)
    connection.execute(VERSION.delete())
    connection.execute(VERSION.insert().values(version=len(MIGRATIONS)))


def _version(connection: "Connection") -> int:
    """Return the version of a library, 0 where there is none."""
    known = VERSION.name in inspect_database(connection).get_table_names()
    return (connection.scalar(VERSION.select()) or 0) if known else 0
