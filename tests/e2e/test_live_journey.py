"""The whole way of a guided capture as a person goes it, in a real browser: begin, follow, stop, read the report.

They take a minute each, most of it waiting, and are run by `make study`. GNOMON_SCREENSHOTS names a folder for pictures
of the pages, on two screens in two colour schemes, to be looked at.
"""

import base64
import os
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from gnomon.cli import main
from gnomon.live.hand import SimulatedHand
from gnomon.writers.image_folders import save_video
from headless import CHROMIUM, WHY_NOT, Browser

pytest.importorskip("uvicorn")
pytestmark = [
    pytest.mark.browser,
    pytest.mark.slow,
    pytest.mark.skipif(CHROMIUM is None, reason=WHY_NOT),
    pytest.mark.skipif(sys.platform == "win32", reason="no pseudo-terminals"),
]
SHOTS = os.environ.get("GNOMON_SCREENSHOTS")
ADVICE = """document.getElementById("advice")?.textContent ?? "" """
FAULTS = """document.getElementById("faults")?.textContent ?? "" """


@pytest.fixture
def browser(tmp_path):
    opened = Browser(tmp_path / "profile")
    yield opened
    opened.close()


@pytest.fixture
def deaf():
    """Give a client that asks for the events, and reads none of them."""
    with socket.socket() as client:

        def ask(address):
            host, _, path = address.removeprefix("http://").partition("/")
            client.connect(("127.0.0.1", int(host.partition(":")[2])))
            client.sendall(f"GET /events{path} HTTP/1.1\r\nHost: {host}\r\n\r\n".encode())

        yield ask


@pytest.fixture
def live(tmp_path):
    """Begin `gnomon live`, and give its process and the address of its page."""
    begun, said = [], []

    def begin(*words):
        command = [sys.executable, "-m", "gnomon", "live", *words]
        quiet = {**os.environ, "BROWSER": "true"}  # a program that opens no window
        process = subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, env=quiet, text=True, cwd=tmp_path
        )
        reader = threading.Thread(target=lambda: said.extend(process.stdout), daemon=True)
        begun.append((process, reader))
        while not (line := process.stdout.readline()).startswith("page"):
            assert line, "it ended"
        reader.start()
        return process, line.split()[1]

    yield begin
    for process, reader in begun:
        process.kill()
        process.wait()
        reader.join()
        process.stdout.close()


def shot(browser, name):
    """Take pictures of the page, where somebody wants to look at them."""
    if not SHOTS:
        return
    for width, scheme in ((1440, "light"), (1440, "dark"), (390, "light"), (390, "dark")):
        screen = {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": width < 500}
        browser.call("Emulation.setDeviceMetricsOverride", **screen)
        browser.call("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": scheme}])
        time.sleep(0.8)  # until it is drawn again
        taken = browser.call("Page.captureScreenshot", captureBeyondViewport=width < 500)["data"]
        Path(SHOTS, f"{name}-{width}-{scheme}.png").write_bytes(base64.b64decode(taken))


def wait_until(true, seconds=60.0):
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if true():
            return
        time.sleep(0.1)
    pytest.fail("it did not come to that in time")


def stop_and_read(browser, process, name):
    """Press Stop, and follow to the report."""
    shot(browser, f"{name}-enough")
    browser.evaluate('document.getElementById("stop").click() ?? 1')
    wait_until(lambda: browser.evaluate("location.pathname") == "/report", 120)
    wait_until(lambda: "calibration" in (browser.evaluate("document.body?.innerText") or "").lower())
    shot(browser, f"{name}-report")
    assert process.wait(60) in {0, 1}


class Plug:
    """A pseudo-terminal in the place of a serial port, whose name is a hostile one."""

    def __init__(self, folder):
        self.link = folder / "tty<img src=x onerror=document.title=1>"
        self.plug_in()

    def plug_in(self):
        import tty

        self.master, slave = os.openpty()
        tty.setraw(slave)
        self.link.unlink(missing_ok=True)
        self.link.symlink_to(os.ttyname(slave))
        self.ends = self.master, slave

    def pull(self):
        for end in self.ends:
            os.close(end)

    def send(self, lines):
        os.write(self.master, b"".join(line + b"\n" for line in lines))


def test_a_serial_port_from_the_first_line_to_the_report(tmp_path, browser, live, deaf):
    pytest.importorskip("serial")
    plug, hand, times = Plug(tmp_path), SimulatedHand(4), 2  # times as fast as a hand
    process, address = live("imu", f"serial:{plug.link}@2000000", "--for", "ahrs", "-o", "monday")
    base = address.partition("/?")[0]
    browser.call("Page.navigate", url=f"{base}/")
    wait_until(lambda: "token is missing" in (browser.evaluate("document.body?.innerText") or ""))
    browser.call("Page.navigate", url="data:text/html,other")
    time.sleep(0.3)
    browser.evaluate(
        f"fetch('{address.replace('/?', '/stop?')}', {{method: 'POST', mode: 'no-cors'}}).catch(() => 0) && 1"
    )
    deaf(address)
    browser.call("Page.navigate", url=address)
    lines, began, sent, pulled, seen = hand.sample_lines(), time.monotonic(), 0, False, set()

    def enough():
        nonlocal began, sent, pulled
        due = int((time.monotonic() - began) * times * hand.rate_hz) - sent
        plug.send(next(lines) for _ in range(min(due, 400)))
        sent += min(due, 400)
        if sent > 25 * hand.rate_hz and not pulled:
            pulled, paused = True, time.monotonic()
            plug.pull()
            wait_until(lambda: "is not there" in browser.evaluate(FAULTS), 20)
            assert "<img" in browser.evaluate(FAULTS)
            assert browser.evaluate("document.querySelectorAll('img[src=x]').length") == 0
            plug.plug_in()
            wait_until(lambda: "is not there" not in browser.evaluate(FAULTS), 20)
            plug.send([b"cut"])
            began += time.monotonic() - paused
        state = browser.evaluate("typeof state === 'object' && state ? [state.target, state.phase] : null")
        if state:
            hand.target, phase = state
            if phase not in seen:
                seen.add(phase)
                shot(browser, f"serial-{phase.replace(' ', '-')}")
        return browser.evaluate(ADVICE).startswith("Enough")

    wait_until(enough, 150)
    assert {"first rest", "turn", "enough"} <= seen
    stop_and_read(browser, process, "serial")
    live_result = tmp_path / "monday-imu" / "calibration.yaml"
    assert main(["imu", str(tmp_path / "monday"), "--for", "ahrs", "--no-report", "-o", str(tmp_path / "again")]) == 0
    assert live_result.read_bytes() == (tmp_path / "again" / "calibration.yaml").read_bytes()


def test_a_rendered_video_as_camera_from_the_first_image_to_the_report(tmp_path, browser, live):
    import cv2

    made = tmp_path / "made"
    small = ["--images", "--views", "40", "--rate-hz", "10", "--resolution", "320", "240", "--fill", "0.4", "0.7"]
    lens = ["--intrinsics", "210", "210", "159", "119", "--distortion-coeffs", "-0.1", "0.02", "0", "0"]
    assert main(["simulate", "cameras", "-o", str(made), *small, *lens]) == 0
    film = tmp_path / "film"
    film.mkdir()
    (film / "target.yaml").write_bytes((made / "target.yaml").read_bytes())
    images = [cv2.imread(str(path), cv2.IMREAD_GRAYSCALE) for path in sorted(made.rglob("*.png"))]
    save_video(film / "cam0.mp4", images, np.arange(len(images)) * 250_000_000, rate_hz=4.0)
    process, address = live("camera", f"replay:{film}", "-o", "lens")
    browser.call("Page.navigate", url=address)
    wait_until(lambda: browser.evaluate("typeof state === 'object' && state && state.views > 5"))
    shot(browser, "camera-follow")
    wait_until(lambda: "✓ board: found" in browser.evaluate("document.getElementById('lights').textContent"))
    assert browser.evaluate("picture.naturalWidth") == 320
    wait_until(lambda: "at its end" in browser.evaluate(FAULTS))
    stop_and_read(browser, process, "camera")
    assert (tmp_path / "lens-camera" / "calibration.yaml").is_file()


@pytest.mark.parametrize("words", [("imu", "simulate:3"), ("camera-imu", "simulate:5"), ("camera", "simulate:2")])
def test_the_demonstration_in_real_time(browser, live, words):
    process, address = live(*words, "-o", "first")
    browser.call("Page.navigate", url=address)
    wait_until(lambda: browser.evaluate("typeof state === 'object' && state && state.seconds > 5"))
    shot(browser, f"simulate-{words[0]}")
    wait_until(lambda: browser.evaluate(ADVICE).startswith("Enough"), 180)
    stop_and_read(browser, process, f"simulate-{words[0]}")
