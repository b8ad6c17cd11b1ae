"""The report of a camera-IMU calibration in a real browser: nothing is cut off, coloured wrongly or loaded."""

import pytest

from camera_imu_result import make_camera_imu_result
from gnomon.report import write_report
from headless import CHROMIUM, MEASURE, WHY_NOT, Browser

pytestmark = [pytest.mark.browser, pytest.mark.skipif(CHROMIUM is None, reason=WHY_NOT)]


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    browser = Browser(tmp_path_factory.mktemp("profile"))
    yield browser
    browser.close()


@pytest.fixture(scope="module")
def report(tmp_path_factory):
    path = tmp_path_factory.mktemp("report") / "report.html"
    write_report(make_camera_imu_result(cameras=2, duration_s=20.0, images=True), path)
    return path


FIGURES = 21
"""Rig, four of signals, histograms, four for each camera, field, density, three of motion, biases, correlation."""

CUT_OFF = """(() => [...document.querySelectorAll("svg.plot")].flatMap((plot) => {
  const box = plot.getBoundingClientRect();
  return [...plot.querySelectorAll("text")].filter((text) => {
    const b = text.getBoundingClientRect();
    const aside = Math.max(box.left - b.left, b.right - box.right, box.top - b.top, b.bottom - box.bottom);
    return b.width > 0 && aside > 2;
  }).map((text) => plot.closest("figure").querySelector("h3").innerText + ": " + text.textContent);
}))()"""
"""Texts of figures that lie outside of their figure, where they cannot be read."""

FILLS = """[...document.querySelectorAll("svg.plot .cells path")].map((e) => getComputedStyle(e).fill)"""


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize(("width", "height", "mobile"), [(390, 844, True), (1440, 900, False), (768, 1024, True)])
def test_page_fits_and_is_clean(browser, report, width, height, mobile, scheme):
    browser.open(report, width=width, height=height, mobile=mobile, scheme=scheme)
    seen = browser.evaluate(MEASURE)
    assert browser.problems() == []
    assert seen["inner"] == width
    assert seen["scroll"] <= seen["client"]
    assert seen["title"].startswith("Warn.")
    assert len(seen["plots"]) == FIGURES
    for left, right, tall in seen["plots"]:
        assert left >= 0
        assert right <= width
        assert tall > 100
    assert seen["text"] >= 9
    assert browser.evaluate(CUT_OFF) == []
    dark = seen["paper"] == "rgb(18, 23, 28)"
    assert dark == (scheme == "dark")
    fills = browser.evaluate(FILLS)
    assert len(fills) > 20
    assert set(fills) >= {"rgb(86, 180, 233)" if dark else "rgb(0, 114, 178)"}


def test_everything_can_be_read_without_scripts(browser, report):
    browser.open(report, width=1440, height=900, scripts=False)
    browser.call("Emulation.setScriptExecutionDisabled", value=False)
    assert browser.evaluate("document.querySelectorAll('svg.plot').length") == FIGURES
    assert browser.evaluate("document.querySelectorAll('svg.plot[tabindex]').length") == 0
    assert browser.problems() == []


def test_prints_on_paper_in_light_colours(browser, report):
    browser.open(report, width=1000, height=900, scheme="dark")
    browser.call(
        "Emulation.setEmulatedMedia", media="print", features=[{"name": "prefers-color-scheme", "value": "dark"}]
    )
    assert browser.evaluate("getComputedStyle(document.body).backgroundColor") == "rgb(255, 255, 255)"
    assert browser.evaluate("getComputedStyle(document.querySelector('nav')).display") == "none"
    printed = browser.call("Page.printToPDF", printBackground=True)["data"]
    browser.call("Emulation.setEmulatedMedia", media="")
    assert len(printed) > 100_000
