"""Pages of a library: who may see them, what they show, and what they refuse."""

import html
import re
import signal
import sqlite3
import subprocess
import sys
import time
from contextlib import closing
from dataclasses import replace
from http.client import HTTPConnection
from urllib.parse import quote
from urllib.request import urlopen

import numpy as np
import pytest

pytest.importorskip("uvicorn")

from fleet_line import NAMES, device, healthy_line
from gnomon.errors import OutputError
from gnomon.fleet.library import Library
from gnomon.report.library import LibraryPages, LibraryServer

SCRIPT = "<script>alert(1)</script>"
INJECTION = "SN1' OR '1'='1"
ODD = ("100%_off", "../../etc/passwd", '"><img src=x onerror=alert(1)>')
ODD += ("javascript:alert(1)", "\u202eevil", "a/b?c#d&e")
SERIALS = (SCRIPT, INJECTION, *ODD)


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    place = tmp_path_factory.mktemp("serve") / "line.db"
    line = healthy_line(120, 3, again=10)
    odd = [device(serial, 90 + k, seed=9000 + k, station=SCRIPT) for k, serial in enumerate(SERIALS)]
    odd += [replace(odd[0], measured="2026-12-01", findings=(SCRIPT,), kind="camera", inputs=((SCRIPT, "0" * 64),))]
    with Library(str(place), create=True) as library:
        library.add(*line, *odd)
    return place


@pytest.fixture(scope="module")
def server(place):
    with Library(str(place), read_only=True) as library:
        server = LibraryServer(LibraryPages(library, SCRIPT))
        server.begin_serving()
        end = time.monotonic() + 5
        while not server._server.started and time.monotonic() < end:
            time.sleep(0.01)
        yield server
        server.end_serving()


def answer(server, path, method="GET", token=True, **headers):
    connection = HTTPConnection("127.0.0.1", server.port, timeout=10)
    full = f"{path}{'&' if '?' in path else '?'}token={server.token}" if token else path
    connection.request(method, full, headers=headers)
    found = connection.getresponse()
    text = found.read().decode()
    connection.close()
    return found.status, text, dict(found.getheaders())


def test_the_pages_show_devices_a_device_and_a_chart(server):
    status, text, headers = answer(server, "/")
    assert status == 200
    assert text.count('<a href="device?serial=') == 50
    assert "default-src 'none'" in headers["content-security-policy"]
    assert "script-src" not in headers["content-security-policy"]
    seen, page = [], text
    while True:
        seen += [html.unescape(one) for one in re.findall(r'<a href="device\?serial=[^"]*">(.*?)</a>', page)]
        following = re.search(r'<a href="\./(\?[^"]*)">next</a>', page)
        if not following:
            break
        page = answer(server, f"/{html.unescape(following[1])}")[1]
    assert len(seen) == len(set(seen)) == 120 + len(SERIALS)
    assert answer(server, "/?serial=SN0004")[1].count('<a href="device?') == 10
    status, text, _ = answer(server, "/device?serial=SN00004")
    assert status == 200
    assert text.count("<td>imu</td>") == 2
    assert all(name in text for name in NAMES)
    status, text, _ = answer(server, f"/chart?name={quote(NAMES[4])}")
    assert status == 200
    assert "limits of individuals" in text
    assert answer(server, "/chart")[1].count('<a href="chart?name=') == 12
    assert answer(server, "/page.css")[0] == 200


def test_what_is_added_is_seen(tmp_path):
    place = str(tmp_path / "line.db")
    with Library(place, create=True) as library, Library(place, read_only=True) as reader:
        pages = LibraryPages(reader, place)
        assert b"None." in pages.page("devices")
        assert b"Parameters" in pages.page("chart")
        library.add(device("SN77"))
        assert b"SN77" in pages.page("devices")
        assert b"Parameters" in pages.page("chart", NAMES[0])  # one device has no spread


@pytest.mark.parametrize("path", ["/", "/device?serial=SN00004", "/chart", "/page.css", "/nothing"])
def test_nothing_is_told_without_the_token(server, path):
    asked = f"{path}{'&' if '?' in path else '?'}"
    assert answer(server, path, token=False)[0] == 403
    assert answer(server, f"{asked}token=wrong", token=False)[0] == 403
    assert answer(server, path, token=False, Cookie=f"gnomon-{server.port}={server.token[:-1]}")[0] == 403
    assert answer(server, path, Host="evil.example")[0] == 400
    assert answer(server, path, Origin="http://evil.example")[0] == 403
    assert answer(server, path, token=False, Cookie=f"gnomon-{server.port}={server.token}")[0] in (200, 404)


@pytest.mark.parametrize("serial", SERIALS)
def test_serial_numbers_are_text_whatever_they_are(server, serial):
    for path in (f"/?serial={quote(serial, safe='')}", f"/device?serial={quote(serial, safe='')}"):
        status, text, _ = answer(server, path)
        assert status == 200
        assert "<script" not in text.lower()
        assert "<img" not in text
        assert 'href="javascript:' not in text
        assert "\u202e" not in text  # it would turn the text round
    assert text.count("<h1>") == 1
    listed = answer(server, f"/?serial={quote(serial, safe='')}")[1]
    assert listed.count('<a href="device?') == 1  # itself alone: neither % nor ' mean more than themselves
    (link,) = re.findall(r'<a href="(device\?serial=[^"]*)"', listed)
    assert answer(server, "/" + html.unescape(link))[0] == 200


@pytest.mark.parametrize(
    "path",
    [
        *("/../line.db", "/%2e%2e/%2e%2e/etc/passwd", "//etc/passwd", "/page.css/../../line.db", "/line.db"),
        *("/..%5c..%5cline.db", "/device/../../line.db", "/static/page.css", "/page.css%00.html"),
    ],
)
def test_no_other_file_is_served(server, path):
    status, text, _ = answer(server, path)
    assert status == 404
    assert "SQLite format" not in text


@pytest.mark.parametrize(
    ("path", "status"),
    [
        (f"/?serial={'x' * 65}", 400),
        (f"/device?serial={'x' * 5000}", 400),
        (f"/chart?name={'x' * 5000}", 400),
        ("/?page=0", 400),
        ("/?page=-1", 400),
        ("/?page=99999999999999999999", 400),
        ("/?page=1e3", 400),
        ("/?page=٣", 400),
        ("/?page=1;DROP", 400),
        ("/device?serial=%00", 400),
        ("/device?serial=%ff", 404),
        ("/device", 404),
        ("/device?serial=SN0000_", 404),
        ("/device?serial=SN1%27%3B%20DROP%20TABLE%20calibrations%3B--", 404),
        ("/device?serial=%27%20UNION%20SELECT%20*%20FROM%20runs--", 404),
        ("/chart?name=1%20OR%201=1", 404),
        ("/?page=1000000", 200),
        (f"/?x={'y' * 10_000}", 414),
    ],
)
def test_huge_and_crooked_queries_are_refused(server, path, status):
    assert answer(server, quote(path, safe="/?=&%*;'"))[0] == status


@pytest.mark.parametrize("method", ["POST", "PUT", "DELETE", "PATCH"])
@pytest.mark.parametrize("path", ["/", "/device?serial=SN00004", "/chart"])
def test_there_is_no_way_to_write(server, method, path):
    assert answer(server, path, method)[0] == 405


def test_the_command_serves_until_it_is_interrupted(place):
    heeding = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler); "  # not so in background jobs
    main = f"from gnomon.cli import main; raise SystemExit(main({['library', 'serve', '--library', str(place)]}))"
    words = [sys.executable, "-c", heeding + main]
    process = subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        address = process.stdout.readline().split()[-1]
        with urlopen(address, timeout=10) as page:
            assert b"SN00004" in page.read()
        process.send_signal(signal.SIGINT)
        _, said = process.communicate(timeout=10)
    finally:
        process.kill()
        process.communicate()
    assert (process.returncode, said) == (0, "")


def test_a_library_that_is_read_refuses_every_change(place):
    with closing(sqlite3.connect(place)) as connection:
        (before,) = connection.execute("SELECT count(*) FROM calibrations").fetchone()
    with Library(str(place), read_only=True) as library:
        with pytest.raises(OutputError, match="cannot be written"):
            library.add(device("SN9999"))
        assert library.count() == before


def test_the_newest_of_a_library_come_in_their_order(place):
    with Library(str(place)) as library:
        every = [(entry.measured, entry.serial) for entry in library.entries()]
        newest = [(entry.measured, entry.serial) for entry in library.entries(newest=7)]
        of_device = list(library.entries(serial="SN00004", newest=1, details=True))
    assert newest == every[-7:]
    assert len(of_device) == 1
    np.testing.assert_allclose(of_device[0].published_sigmas, np.sqrt(np.diag(of_device[0].covariance)))
