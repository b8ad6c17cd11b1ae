"""The report of a camera-IMU calibration in a real browser: nothing is cut off, coloured wrongly or loaded."""

import base64
import re

import numpy as np
import pytest

from camera_imu_result import make_camera_imu_result
from gnomon.report.page import write_report
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


def drag(browser, start, by):
    """Drag the mouse from a place of the window by so much."""
    browser.call("Input.dispatchMouseEvent", type="mousePressed", x=start[0], y=start[1], button="left", clickCount=1)
    x, y = start[0] + by[0], start[1] + by[1]
    browser.call("Input.dispatchMouseEvent", type="mouseMoved", x=x, y=y, button="left", buttons=1)
    browser.call("Input.dispatchMouseEvent", type="mouseReleased", x=x, y=y, button="left", clickCount=1)


SPACE = """(() => {
  const svg = document.querySelector("[data-space]").closest("svg");
  svg.closest("details")?.setAttribute("open", "");
  svg.scrollIntoView({ block: "center", behavior: "instant" });
  const box = svg.getBoundingClientRect();
  const path = svg.querySelector("[data-depth]"), label = svg.querySelector("[data-place] text");
  return { place: [box.left + box.width / 2, box.top + box.height / 2], width: box.width, d: path.getAttribute("d"),
           depth: path.dataset.depth, middle: svg.querySelector("[data-space]").dataset.space,
           label: label.getBoundingClientRect().left };
})()"""


def points(d):
    numbers = np.array(re.findall(r"-?[\d.]+", d), dtype=float)
    return numbers.reshape(-1, 2)


def test_a_view_of_space_is_turned_by_the_mouse_and_the_keys_and_comes_back(browser, report):
    browser.open(report, width=1440, height=900)
    before = browser.evaluate(SPACE)
    drag(browser, before["place"], (80, 0))
    after = browser.evaluate(SPACE)
    # A drag by a quarter of the figure turns by one radian about the upright of the page.
    angle = 4 * 80 / before["width"]
    middle = np.array(before["middle"].split(), dtype=float)
    flat, depth = points(before["d"]) - middle, np.array(before["depth"].split(), dtype=float)
    expected = np.stack([np.cos(angle) * flat[:, 0] + np.sin(angle) * depth, flat[:, 1]], axis=1)
    assert points(after["d"]) - middle == pytest.approx(expected, abs=0.05)
    assert after["label"] != before["label"]
    for key in ("ArrowUp", "0"):
        browser.evaluate(
            "document.querySelector('[data-space]').closest('svg')"
            f".dispatchEvent(new KeyboardEvent('keydown', {{key: '{key}'}}))"
        )
        turned = browser.evaluate(SPACE)
        assert (turned["d"] == after["d"]) is False
    assert points(turned["d"]) == pytest.approx(points(before["d"]), abs=0.02)
    assert browser.problems() == []


def test_figures_over_time_are_zoomed_together(browser, report):
    browser.open(report, width=1440, height=900)
    windows = browser.evaluate("""(() => {
      const timed = [...new Set([...document.querySelectorAll("[data-time]")].map((g) => g.closest("svg")))];
      const seen = (svg) => {
        const [left, , width, , low, high] = svg.querySelector("[data-time]").dataset.panel.split(" ").map(Number);
        const [x, , w] = svg.getAttribute("viewBox").split(" ").map(Number);
        const at = (u) => low + (high - low) * (u - left) / width;
        return [at(x), at(x + w)];
      };
      const apart = [...document.querySelectorAll("svg.plot")].find((svg) => !timed.includes(svg));
      const before = apart.getAttribute("viewBox");
      for (let k = 0; k < 6; k++) timed[0].dispatchEvent(new KeyboardEvent("keydown", { key: "+" }));
      for (let k = 0; k < 3; k++) timed[0].dispatchEvent(new KeyboardEvent("keydown", { key: "ArrowRight" }));
      const still = apart.getAttribute("viewBox") === before;
      const zoomed = timed.map(seen);
      timed[0].dispatchEvent(new KeyboardEvent("keydown", { key: "0" }));
      const home = timed.every((svg) => !svg.classList.contains("zoomed"));
      return { zoomed, home, still };
    })()""")
    assert len(windows["zoomed"]) >= 6
    led = windows["zoomed"][0]
    assert led[1] - led[0] < 5.0
    whole = [window for window in windows["zoomed"] if abs(window[0] - led[0]) + abs(window[1] - led[1]) < 0.05]
    assert len(whole) >= 5  # but for the sections, which show a few seconds only
    assert windows["home"]
    assert windows["still"]
    assert browser.problems() == []


def test_the_printed_page_is_whole_and_not_too_wide(browser, report):
    browser.open(report, width=1440, height=900)
    printed = browser.call("Page.printToPDF", preferCSSPageSize=True, paperWidth=8.27, paperHeight=11.69)
    pdf = base64.b64decode(printed["data"])
    assert pdf.startswith(b"%PDF")
    pages = len(re.findall(rb"/Type\s*/Page\b", pdf))
    browser.evaluate("document.querySelectorAll('details').forEach((d) => { d.open = true; })")
    unfolded = base64.b64decode(browser.call("Page.printToPDF", preferCSSPageSize=True)["data"])
    assert pages <= 4  # the certificate, and what is unfolded
    assert len(re.findall(rb"/Type\s*/Page\b", unfolded)) > pages
    browser.call("Emulation.setEmulatedMedia", media="print")
    paper = browser.evaluate(
        "[getComputedStyle(document.body).backgroundColor, getComputedStyle(document.querySelector('nav')).display]"
    )
    browser.call("Emulation.setEmulatedMedia", media="")
    assert paper == ["rgb(255, 255, 255)", "none"]
    assert 0.5 < browser.on_a_sheet() < 1


CONTRAST = """(() => {
  document.querySelectorAll("details").forEach((folded) => { folded.open = true; });
  const rgb = (text) => text.match(/[\\d.]+/g).map(Number);
  const light = (c) => c.slice(0, 3).map((v) => v / 255)
    .map((v) => v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4)
    .reduce((sum, v, i) => sum + v * [0.2126, 0.7152, 0.0722][i], 0);
  const ground = (e) => {
    for (; e; e = e.parentElement) {
      const c = rgb(getComputedStyle(e).backgroundColor);
      if (c.length < 4 || c[3] === 1) return c;
    }
    return [255, 255, 255];
  };
  const bad = [];
  const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  for (let node; (node = walker.nextNode());) {
    const e = node.parentElement;
    if (!node.textContent.trim() || !e.checkVisibility() || e.closest("script, style")) continue;
    const style = getComputedStyle(e);
    const ink = rgb(e.closest("svg") ? style.fill : style.color), paper = ground(e);
    const [a, b] = [light(ink), light(paper)].sort((x, y) => y - x);
    const size = parseFloat(style.fontSize), large = size >= 24 || (size >= 18.66 && Number(style.fontWeight) >= 600);
    const contrast = (a + 0.05) / (b + 0.05);
    if (contrast < (large ? 3 : 4.5)) bad.push([node.textContent.trim().slice(0, 40), contrast]);
  }
  return bad;
})()"""
"""Texts whose contrast is below that of WCAG 2.1 AA (success criterion 1.4.3)."""


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_every_text_has_contrast_enough(browser, report, scheme):
    browser.open(report, width=1440, height=900, scheme=scheme)
    assert browser.evaluate(CONTRAST) == []


def test_the_keyboard_reaches_all_that_can_be_used(browser, report):
    browser.open(report, width=1440, height=900)
    reached = set()
    for _ in range(200):
        browser.call("Input.dispatchKeyEvent", type="keyDown", key="Tab", code="Tab", windowsVirtualKeyCode=9)
        browser.call("Input.dispatchKeyEvent", type="keyUp", key="Tab", code="Tab", windowsVirtualKeyCode=9)
        name = browser.evaluate(
            "(() => { const e = document.activeElement; if (e === document.body) return ''; e.dataset.reached = 1;"
            " const seen = getComputedStyle(e).outlineStyle !== 'none';"
            " return seen ? e.localName : 'unseen ' + e.outerHTML.slice(0, 80); })()"
        )
        if not name:
            break
        reached.add(name)
    assert {"a", "summary", "svg"} <= reached
    assert not any(name.startswith("unseen") for name in reached)
    left = "a[href], summary, svg.plot[tabindex]"
    missed = browser.evaluate(
        f"[...document.querySelectorAll('{left}')].filter((e) => e.checkVisibility() && !e.dataset.reached).length"
    )
    assert missed == 0
    # A fold opens by its key.
    browser.evaluate("document.querySelector('summary').focus()")
    browser.call(
        "Input.dispatchKeyEvent", type="keyDown", key="Enter", code="Enter", windowsVirtualKeyCode=13, text="\r"
    )
    assert browser.evaluate("document.querySelector('summary').parentElement.open") is True
