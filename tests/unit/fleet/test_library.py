"""The library: what goes in comes out, once, whoever writes beside, and whichever gnomon made it."""

import os
import shutil
import signal
import socket
import sqlite3
import subprocess
import sys
import time
from contextlib import closing
from dataclasses import fields, replace
from pathlib import Path
from threading import Timer

import numpy as np
import pytest

from fleet_line import NAMES, device
from gnomon.errors import FormatError, OptionError
from gnomon.fleet import library as library_module
from gnomon.fleet import schema
from gnomon.fleet.entries import LibraryEntry, export_table
from gnomon.fleet.library import Library
from gnomon.results.temperature_dependence import TemperatureDependence

TESTS = str(Path(__file__).parents[2])


@pytest.fixture
def place(tmp_path):
    return str(tmp_path / "line.db")


def test_what_goes_in_comes_out_and_once(place):
    entry = device("SN1'; DROP TABLE runs; --", 3, seed=4, temperature_c=23.5)
    with Library(place, create=True) as library:
        assert [library.add(entry), library.add(replace(entry, folder="elsewhere"))] == [True, False]
        assert library.add(replace(entry, serial="SN2"))
        (found,) = library.entries(serial=entry.serial, details=True)
        (short,) = library.entries(serial=entry.serial)
    for field in fields(entry):
        np.testing.assert_array_equal(getattr(found, field.name), getattr(entry, field.name))
    assert short.covariance.shape == (0, 0)
    np.testing.assert_array_equal(short.values, entry.values)


def test_entries_are_in_the_order_of_their_dates(place):
    with Library(place, create=True) as library:
        for day in (5, 2, 9):
            library.add(device("SN1", day, seed=day))
        assert [entry.measured for entry in library.entries(kind="imu")] == ["2026-01-03", "2026-01-06", "2026-01-10"]
        assert not list(library.entries(kind="camera"))


def test_a_table_for_others_has_every_scalar_with_its_sigma(tmp_path):
    parquet = pytest.importorskip("pyarrow.parquet")
    entries = [device("SN1", seed=1), device("=SN2", 3, seed=2, temperature_c=23.5)]
    entries[1] = replace(entries[1], names=(*NAMES[1:], "imu0.gyroscope.bias[9]"))  # other scalars than the first
    assert export_table(entries, tmp_path / "line.parquet") == 2
    read = parquet.read_table(tmp_path / "line.parquet")
    table = read.to_pydict()
    assert table["serial"] == ["SN1", "=SN2"]
    assert table["measured"] == ["2026-01-01", "2026-01-04"]
    assert table["temperature_c"] == [None, 23.5]
    for row, entry in enumerate(entries):
        for name, value, sigma in zip(entry.names, entry.values, entry.sigmas, strict=True):
            assert (table[name][row], table[f"{name}_sigma"][row]) == (value, sigma)
    assert table[NAMES[0]] == [entries[0].values[0], None]
    assert str(read.schema.field(NAMES[0]).type) == "double"


def test_a_run_and_its_calibration_are_kept_together(place):
    with Library(place, create=True) as library:
        library.keep_run("k", "record", device("SN1"))
        library.keep_run("k", "again", device("SN1"))
        library.keep_run("broken", "why", None)
        assert (library.find("k"), library.find("broken"), library.find("other")) == ("again", "why", None)
        assert library.count() == 1


def test_an_older_library_is_brought_up_to_date_and_a_newer_one_refused(place, monkeypatch):
    with Library(place, create=True) as library:
        library.add(device("SN1"))

    def added(connection):
        connection.exec_driver_sql("ALTER TABLE calibrations ADD COLUMN line TEXT DEFAULT ''")

    with monkeypatch.context() as newer:
        newer.setattr(schema, "MIGRATIONS", (*schema.MIGRATIONS, added))
        newer.setattr(library_module, "LATEST", 3)
        with Library(place) as library:
            assert [entry.serial for entry in library.entries()] == ["SN1"]
    with closing(sqlite3.connect(place)) as raw:
        columns = [row[1] for row in raw.execute("PRAGMA table_info(calibrations)")]
    assert "line" in columns
    assert len(schema.MIGRATIONS) == library_module.LATEST
    with pytest.raises(FormatError, match="version 3, and this gnomon knows 2"):
        Library(place)


def test_a_file_is_read_without_sqlalchemy(place):
    with Library(place, create=True) as library:
        library.add(device("SN1"))
    code = f"""
import sys
from gnomon.fleet.library import Library
from gnomon.results.sensors import TemperatureDependence
with Library({place!r}) as library:
    assert library.count() == len(list(library.entries(serial="SN1"))) == 1
assert "sqlalchemy" not in sys.modules
"""
    subprocess.run([sys.executable, "-c", code], check=True)


def test_the_first_version_gets_its_index_of_dates_and_readers_leave_it_alone(place):
    with Library(place, create=True) as library:
        library.add(device("SN1"))
    raw = sqlite3.connect(place)
    raw.executescript("DROP INDEX by_date; UPDATE gnomon_library SET version = 1")
    with pytest.raises(FormatError, match=r"line\.db: this library is of an older gnomon.*gnomon library list"):
        Library(place, read_only=True)
    indices = "SELECT name FROM sqlite_master WHERE type = 'index'"
    assert ("by_date",) not in raw.execute(indices).fetchall()
    Library(place).close()
    assert ("by_date",) in raw.execute(indices).fetchall()
    with Library(place, read_only=True) as library:
        assert [entry.serial for entry in library.entries(newest=1)] == ["SN1"]
    raw.close()


def test_what_is_no_library_is_refused(tmp_path, place):
    with pytest.raises(OptionError, match="no such library"):
        Library(place)
    Path(place).write_text("serial,date\n")
    with pytest.raises(FormatError, match="no library of gnomon"):
        Library(place)
    other = tmp_path / "other.db"
    sqlite3.connect(other).execute("CREATE TABLE runs (key TEXT)").connection.close()
    with pytest.raises(FormatError, match="no library of gnomon"):
        Library(str(other))
    with pytest.raises(OptionError, match=r"postgresql://\.\.\.@127.0.0.1:1/x.*cannot be opened") as refused:
        Library("postgresql://somebody:secret@127.0.0.1:1/x")
    assert "secret" not in str(refused.value)


WRITER = """
import sys
from fleet_line import device
from gnomon.fleet.library import Library
from gnomon.results.sensors import TemperatureDependence
with Library(sys.argv[1], create=True) as library:
    for k in range(int(sys.argv[3])):
        entry = device(f"{sys.argv[2]}-{k}", k, seed=k)
        library.keep_run(f"{sys.argv[2]}-{k}", "done", entry)
        library.keep_run(f"shared-{k}", "done", device("shared", k, seed=k))
        print(k, flush=True)
"""


def writer(place, name, count):
    environment = os.environ | {"PYTHONPATH": TESTS, "OPENBLAS_NUM_THREADS": "1"}
    return subprocess.Popen(
        [sys.executable, "-c", WRITER, place, name, str(count)], env=environment, stdout=subprocess.PIPE, text=True
    )


def two_writers(place, count):
    both = [writer(place, name, count) for name in ("a", "b")]
    assert [process.communicate()[1] or process.returncode for process in both] == [0, 0]
    with Library(place) as library:
        assert library.count() == 3 * count
        assert all(library.find(f"{name}-{k}") for name in ("a", "b", "shared") for k in range(count))


def test_two_writers_at_once(place):
    two_writers(place, 20)


def test_a_new_library_is_opened_while_another_one_writes_its_first_row(place):
    with closing(sqlite3.connect(place, isolation_level=None, check_same_thread=False)) as other:
        other.execute("BEGIN IMMEDIATE")  # before the file has its write-ahead log, where no timeout applies
        Timer(0.3, other.rollback).start()
        with Library(place, create=True) as library:
            assert library.count() == 0


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="needs kill -9")
def test_what_was_reported_done_survives_a_kill(place):
    process = writer(place, "a", 10_000)
    told = [process.stdout.readline() for _ in range(7)]
    process.kill()
    told += process.stdout.readlines()
    process.stdout.close()
    process.wait()
    done = len([line for line in told if line.endswith("\n")])
    with closing(sqlite3.connect(place)) as raw:
        assert raw.execute("PRAGMA integrity_check").fetchone() == ("ok",)
    with Library(place) as library:
        names = {entry.serial for entry in library.entries(details=True)}
        assert {f"a-{k}" for k in range(done)} <= names
        assert all((library.find(f"a-{k}") is not None) == (f"a-{k}" in names) for k in range(done + 2))


@pytest.fixture
def postgresql(tmp_path_factory):
    """URL of a PostgreSQL server of the system's package, which runs for this test."""
    places = [os.environ.get("PATH", ""), *map(str, Path("/usr/lib/postgresql").glob("*/bin"))]  # where Debian has it
    programs = {name: shutil.which(name, path=os.pathsep.join(places)) for name in ("initdb", "postgres", "pg_ctl")}
    if None in programs.values():
        pytest.skip("no PostgreSQL server is installed")
    root = os.geteuid() == 0
    known = subprocess.run(["id", "postgres"], capture_output=True, check=False).returncode == 0
    if root and not (shutil.which("runuser") and known):
        pytest.skip("PostgreSQL refuses to run as root, and there is no user postgres")
    folder = Path("/tmp") / f"gnomon-postgresql-{os.getpid()}"  # a path that another user may enter
    folder.mkdir()
    prefix = []
    if root:
        shutil.chown(folder, "postgres")
        prefix = ["runuser", "-u", "postgres", "--"]
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]

    def run(program, *words):
        subprocess.run([*prefix, programs[program], *words], check=True, capture_output=True, cwd="/")

    run("initdb", "-A", "trust", "-U", "gnomon", str(folder / "data"))
    options = f"-p {port} -c listen_addresses=127.0.0.1 -c unix_socket_directories={folder} -c fsync=off"
    server = subprocess.Popen([*prefix, programs["postgres"], "-D", str(folder / "data"), *options.split()],
                              stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, cwd="/")  # fmt: skip
    url = f"postgresql://gnomon@127.0.0.1:{port}/postgres"
    try:
        for _ in range(100):
            try:
                Library(url).close()
                break
            except OptionError:
                time.sleep(0.1)
        yield url
    finally:
        run("pg_ctl", "-D", str(folder / "data"), "-m", "immediate", "stop")
        server.wait()
        shutil.rmtree(folder)


@pytest.mark.long
def test_a_postgresql_server_keeps_the_same(postgresql):
    two_writers(postgresql, 20)
    with Library(postgresql) as library:
        entry = device("SN1", 3, seed=4, temperature_c=23.5)
        assert library.add(entry)
        assert not library.add(entry)
        (found,) = library.entries(serial="SN1", details=True)
    assert found.names == NAMES
    np.testing.assert_array_equal(found.covariance, entry.covariance)


def test_a_calibration_over_the_temperature_holds_at_its_reference(random_calibration):
    calibration = random_calibration()
    known = TemperatureDependence(reference_degc=21.0, low_degc=0.0, high_degc=40.0, gyroscope_bias=np.ones((1, 3)))
    calibration = calibration.with_temperature("imu0", known, {"gyroscope_bias": np.eye(3)})
    assert LibraryEntry.of_calibration(calibration).temperature_c == 21.0
