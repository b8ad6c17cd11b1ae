"""The page of a guided capture in a real browser: it shows what the coach says, fits, and asks nobody else."""

import time
from itertools import islice

import pytest

from gnomon.live.camera_session import CameraSession
from gnomon.live.hand import SimulatedHand
from gnomon.live.image_sources import open_image_source
from gnomon.live.session import LiveSession
from gnomon.live.sources import PushSource
from gnomon.options.requirements import USES
from headless import CHROMIUM, WHY_NOT, Browser

pytest.importorskip("uvicorn")
pytestmark = [pytest.mark.browser, pytest.mark.skipif(CHROMIUM is None, reason=WHY_NOT)]

from gnomon.live.server import LivePage  # noqa: E402

SEEN = """(() => ({
  advice: document.getElementById("advice").textContent, faults: document.getElementById("faults").textContent,
  inner: window.innerWidth, scroll: document.documentElement.scrollWidth, address: location.href,
  live: document.getElementById("advice").getAttribute("aria-live"), cookie: document.cookie,
}))()"""
COUNTED = """["3 s more", "2 s more", "Turn it"].map((advice) => {
  showCommon({...state, advice, faults: []}, "");
  return [$("advice").textContent, $("advice").getAttribute("aria-live")]; })"""
ADVICE = """document.getElementById("advice")?.textContent ?? "" """
DRAWN = """["box", "sphere", "trace"].map((id) => {
  const c = document.getElementById(id);
  return c.getContext("2d").getImageData(0, 0, c.width, c.height).data.some((v) => v > 0); })"""


@pytest.mark.parametrize(("width", "mobile", "scheme"), [(390, True, "dark"), (1100, False, "light")])
def test_the_page_shows_what_the_coach_says(tmp_path, width, mobile, scheme):
    session, hand = LiveSession(PushSource(), tmp_path / "rec", USES["ahrs"]), SimulatedHand(1)
    session.source.trouble = "<img src=x onerror=document.title=1>"
    for k, line in enumerate(islice(hand.sample_lines(), 26 * 200)):
        session.take_line(line)
        if k % 100 == 0 and session.look_at_arrivals().phase == "turn":
            break
    page, browser = LivePage(session), Browser(tmp_path / "profile")
    try:
        page.begin_serving()
        browser.call("Emulation.setDeviceMetricsOverride", width=width, height=844, deviceScaleFactor=1, mobile=mobile)
        browser.call("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": scheme}])
        browser.call("Page.navigate", url=page.address)
        end = time.monotonic() + 20
        while "Put it" not in browser.evaluate(ADVICE) and time.monotonic() < end:
            time.sleep(0.2)
        seen = browser.evaluate(SEEN)
        asked = [e["params"]["request"]["url"] for e in browser.events if e["method"] == "Network.requestWillBeSent"]
        assert not [problem for problem in browser.problems() if isinstance(problem, dict)]
        assert all(url.startswith((f"http://127.0.0.1:{page.port}/", "data:")) for url in asked)
        assert "up)" in seen["advice"]
        assert seen["live"] == "polite"
        assert "<img" in seen["faults"], "text stays text"
        assert seen["scroll"] <= seen["inner"] == width
        assert browser.evaluate(DRAWN) == [True, True, True]
        assert page.token not in seen["address"] + seen["cookie"]
        assert browser.evaluate(COUNTED) == [["3 s more", "polite"], ["2 s more", "off"], ["Turn it", "polite"]]
        browser.evaluate('document.getElementById("stop").click() ?? 1')
        assert session.stopped.wait(5.0)
    finally:
        browser.close()
        page.show_result(tmp_path / "none.html")
        session.end_recording()


SEEN_OF_BOARD = """(() => ({
  advice: document.getElementById("advice").textContent, lights: document.getElementById("lights").textContent,
  label: document.getElementById("view").getAttribute("aria-label"),
  bars: document.querySelectorAll("#bars meter").length,
  inner: window.innerWidth, scroll: document.documentElement.scrollWidth,
}))()"""
COLOURED = """(() => { const c = document.getElementById("view");
  const d = c.getContext("2d").getImageData(0, 0, c.width, c.height).data;
  for (let k = 0; k < d.length; k += 4) if (Math.abs(d[k] - d[k + 2]) > 30) return true; return false; })()"""


@pytest.mark.parametrize(("width", "mobile", "scheme"), [(390, True, "dark"), (1100, False, "light")])
def test_the_page_of_a_camera_shows_board_and_coverage(tmp_path, width, mobile, scheme):
    source = open_image_source("simulate:1")
    session = CameraSession(source, tmp_path / "rec", source.target)
    for _, arrival in zip(range(3), source.arriving_images(session.stopped), strict=False):
        session.take_image(arrival)
        session.look_at_arrivals()
    page, browser = LivePage(session), Browser(tmp_path / "profile")
    try:
        page.begin_serving()
        browser.call("Emulation.setDeviceMetricsOverride", width=width, height=844, deviceScaleFactor=1, mobile=mobile)
        browser.call("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": scheme}])
        browser.call("Page.navigate", url=page.address)
        end = time.monotonic() + 20
        while "Move" not in browser.evaluate(ADVICE) and time.monotonic() < end:
            time.sleep(0.2)
        while not browser.evaluate(COLOURED) and time.monotonic() < end:
            time.sleep(0.2)
        seen = browser.evaluate(SEEN_OF_BOARD)
        assert not [problem for problem in browser.problems() if isinstance(problem, dict)]
        assert seen["scroll"] <= seen["inner"] == width
        assert "board: found" in seen["lights"]
        assert "corners found" in seen["label"]
        assert seen["bars"] == 4
        browser.evaluate('document.getElementById("stop").click() ?? 1')
        assert session.stopped.wait(5.0)
    finally:
        browser.close()
        page.show_result(tmp_path / "none.html")
        session.end_recording()
