"""The page: who may see it, and what it does with those who may not."""

import hashlib
import http.client
import json
import ssl
import time
from io import StringIO

import numpy as np
import pytest

pytest.importorskip("uvicorn")

from gnomon.live.server import LivePage
from gnomon.live.session import LiveSession
from gnomon.live.sources import PushSource
from gnomon.options.requirements import USES


@pytest.fixture
def page(tmp_path):
    session = LiveSession(PushSource(), tmp_path / "rec", USES["ahrs"])
    page = LivePage(session)
    page.begin_serving()
    end = time.monotonic() + 5
    while not page._server.started and time.monotonic() < end:
        time.sleep(0.01)
    yield page
    page.show_result(tmp_path / "none.html")
    session.end_recording()


def answer(page, path, method="GET", body=None, token=True, **headers):
    connection = http.client.HTTPConnection("127.0.0.1", page.port, timeout=5)
    full = f"{path}{'&' if '?' in path else '?'}token={page.token}" if token else path
    connection.request(method, full, body=body, headers=headers)
    found = connection.getresponse()
    text = found.read() if path != "/events" or found.status != 200 else found.readline()
    connection.close()
    return found.status, text, dict(found.getheaders())


def test_the_page_asks_nothing_of_others(page):
    status, text, headers = answer(page, "/")
    assert status == 200
    assert b"http:" not in text
    assert b"https:" not in text
    assert "default-src 'none'" in headers["content-security-policy"]
    assert "HttpOnly" in headers["set-cookie"]
    assert {answer(page, path)[0] for path in ("/live.js", "/imu.js", "/live.css")} == {200}
    assert answer(page, "/picture")[0] == answer(page, "/camera.js")[0] == 404
    assert answer(page, "/live.js", token=False, Cookie=f"gnomon-{page.port}={page.token}")[0] == 200


@pytest.mark.parametrize("path", ["/", "/live.js", "/events", "/report", "/nothing"])
def test_nothing_is_told_without_the_token(page, path):
    assert answer(page, path, token=False)[0] == 403
    assert answer(page, f"{path}?token=wrong", token=False)[0] == 403
    assert answer(page, path, token=False, Cookie=f"gnomon-{page.port}=\xe9")[0] == 403


@pytest.mark.parametrize("path", ["/stop", "/push"])
def test_nobody_else_stops_or_sends(page, path):
    assert answer(page, path, "POST", token=False)[0] == 403
    assert answer(page, path, "POST", Origin="http://evil.example")[0] == 403
    assert answer(page, path, "POST", Origin="null")[0] == 403
    assert answer(page, path, "POST", Host="evil.example")[0] == 400
    assert answer(page, path)[0] == 405
    assert not page.session.stopped.is_set()


@pytest.mark.parametrize("path", ["/../pyproject.toml", "/%2e%2e/%2e%2e/etc/passwd", "//etc/passwd", "/report/../../x"])
def test_no_other_file_is_served(page, path):
    status, text, _ = answer(page, path)
    assert status == 404
    assert b"root:" not in text


def test_pushes_are_taken_and_bounded(page):
    entry = {"name": "gyroscope", "time": 5, "values": {"x": 1, "y": 2, "z": 3}}
    assert answer(page, "/push", "POST", json.dumps({"payload": [entry]}))[:2] == (200, b"1 samples")
    assert answer(page, "/push", "POST", b"no")[0] == 400
    assert answer(page, "/push", "POST", b"x" * (5 << 20))[0] == 413


def test_stop_from_the_page_ends_the_recording(page):
    assert answer(page, "/stop", "POST", Origin=f"http://127.0.0.1:{page.port}")[0] == 200
    assert page.session.stopped.is_set()


def test_a_phone_is_shown_the_way_where_it_may_come(page, tmp_path):
    assert answer(page, "/code.svg")[0] == 404, "without --lan"
    session = LiveSession(PushSource(), tmp_path / "lan", USES["ahrs"])
    seen = LivePage(session, lan=True)
    seen.begin_serving()
    status, text, headers = answer(seen, "/code.svg")
    assert status == 200
    assert b"<svg" in text
    assert headers["content-type"] == "image/svg+xml"
    assert answer(seen, "/code.svg", token=False)[0] == 403
    assert seen._for_phone == seen.push_address
    seen.show_result(tmp_path / "none.html")
    session.end_recording()


def test_over_tls_the_certificate_is_of_this_address_and_its_fingerprint_told(tmp_path):
    pytest.importorskip("cryptography")
    session = LiveSession(PushSource(), tmp_path / "tls", USES["ahrs"])
    page = LivePage(session, tls=True)
    page.begin_serving()
    shown = ssl.get_server_certificate(("127.0.0.1", page.port))
    digest = hashlib.sha256(ssl.PEM_cert_to_DER_cert(shown)).hexdigest().upper()
    assert page.fingerprint.replace(":", "") == digest
    trusting = ssl.create_default_context(cadata=shown)
    connection = http.client.HTTPSConnection("127.0.0.1", page.port, timeout=5, context=trusting)
    connection.request("GET", f"/?token={page.token}", headers={"Origin": f"https://127.0.0.1:{page.port}"})
    found = connection.getresponse()
    assert found.status == 200
    assert "Secure" in found.headers["set-cookie"]
    connection.close()
    connection.request("GET", f"/?token={page.token}", headers={"Origin": f"http://127.0.0.1:{page.port}"})
    assert connection.getresponse().status == 403
    connection.close()
    assert page.address.startswith("https://")
    page.show_result(tmp_path / "none.html")
    session.end_recording()


def test_events_tell_the_state(page):
    assert answer(page, "/events")[1] == b"event: state\n"


def test_the_address_is_drawn_as_a_code_that_a_camera_reads(page):
    segno, cv2 = pytest.importorskip("segno"), pytest.importorskip("cv2")
    drawn, expected = StringIO(), StringIO()
    page.draw_address(drawn)
    code = segno.make(page.push_address, error="l")
    code.terminal(expected, compact=True)
    assert drawn.getvalue() == expected.getvalue() != ""
    image = np.array([[255 * (not dark) for dark in row] for row in code.matrix_iter(scale=6)], np.uint8)
    assert cv2.QRCodeDetector().detectAndDecode(image)[0] == page.push_address
