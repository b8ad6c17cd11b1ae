"""The report in a real browser: no script error, no sideways scrolling, figures to be seen, zoom that zooms."""

import re
from itertools import combinations

import pytest

from gnomon.report.page import write_report
from headless import CHROMIUM, MEASURE, WHY_NOT, Browser

NUMBER = re.compile(r"\u2212?[\d.]+(e\d+)?")

pytestmark = [pytest.mark.browser, pytest.mark.skipif(CHROMIUM is None, reason=WHY_NOT)]


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    browser = Browser(tmp_path_factory.mktemp("profile"))
    yield browser
    browser.close()


@pytest.fixture
def report(make_result, tmp_path):
    path = tmp_path / "report.html"
    write_report(make_result(), path)
    return path


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize(("width", "height", "mobile"), [(390, 844, True), (1440, 900, False), (768, 1024, True)])
def test_page_fits_and_is_clean(browser, report, width, height, mobile, scheme):
    browser.open(report, width=width, height=height, mobile=mobile, scheme=scheme)
    seen = browser.evaluate(MEASURE)
    assert browser.problems() == []
    assert seen["inner"] == width
    assert seen["scroll"] <= seen["client"]
    assert seen["title"].startswith("Warn.")
    assert len(seen["plots"]) == 6
    for left, right, tall in seen["plots"]:
        assert left >= 0
        assert right <= width
        assert tall > 100
    assert seen["text"] >= 9
    dark = seen["paper"] == "rgb(18, 23, 28)"
    assert dark == (scheme == "dark")
    # Every placeholder became a colour of the page.
    assert not any("var" in stroke for stroke in seen["strokes"])
    assert len(seen["strokes"]) > 5


@pytest.mark.parametrize("gyroscope", [True, False])
def test_hostile_and_long_names_do_not_break_the_page(browser, make_result, tmp_path, gyroscope):
    names = ("<script>window.broken = 1</script>&\"'", "a" * 200 + ".csv", "<img src=x onerror=window.broken=1>")
    path = tmp_path / "report.html"
    write_report(make_result(names=names, unit='<g id="x">&"', gyroscope=gyroscope, verdict="fail"), path)
    browser.open(path, width=390, height=844, mobile=True)
    seen = browser.evaluate(MEASURE)
    assert browser.problems() == []
    assert seen["scroll"] <= seen["client"]
    assert browser.evaluate("typeof window.broken") == "undefined"
    assert '<g id="x">&"' in browser.evaluate(
        "[...document.querySelectorAll('svg.plot')].map(plot => plot.textContent).join(' ')"
    )


def test_wheel_zooms_a_clicked_figure_and_double_click_resets(browser, report):
    browser.open(report, width=1440, height=900)
    browser.evaluate("document.documentElement.style.scrollBehavior = 'auto'")
    browser.evaluate("document.querySelector('svg.plot').scrollIntoView({block: 'center'})")
    box = browser.evaluate(
        "(() => { const b = document.querySelector('svg.plot').getBoundingClientRect();"
        " return [b.left + b.width / 4, b.top + b.height / 2]; })()"
    )
    view = "document.querySelector('svg.plot').getAttribute('viewBox').split(' ').map(Number)"
    home = browser.evaluate(view)

    def mouse(kind, x, y, **more):
        browser.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, **more)

    mouse("mousePressed", *box, button="left", clickCount=1)
    mouse("mouseReleased", *box, button="left", clickCount=1)
    mouse("mouseWheel", *box, deltaX=0, deltaY=-500)
    zoomed = browser.evaluate(view)
    assert zoomed[2] < 0.6 * home[2]
    # The point under the pointer stays where it is.
    assert zoomed[0] + zoomed[2] / 4 == pytest.approx(home[2] / 4, abs=1)
    mouse("mousePressed", *box, button="left", clickCount=1)
    mouse("mouseMoved", box[0] - 60, box[1], button="left", buttons=1)
    mouse("mouseReleased", box[0] - 60, box[1], button="left", clickCount=1)
    assert browser.evaluate(view)[0] > zoomed[0] + 10
    for count in (1, 2):
        mouse("mousePressed", *box, button="left", clickCount=count)
        mouse("mouseReleased", *box, button="left", clickCount=count)
    assert browser.evaluate(view) == home
    assert browser.problems() == []


def test_everything_can_be_read_without_scripts(browser, report):
    browser.open(report, width=1440, height=900, scripts=False)
    seen = browser.call("Page.captureScreenshot", format="png")
    assert len(seen["data"]) > 10_000
    browser.call("Emulation.setScriptExecutionDisabled", value=False)
    assert browser.evaluate("document.querySelectorAll('svg.plot').length") == 6
    # The script makes figures focusable; here it never ran.
    assert browser.evaluate("document.querySelectorAll('svg.plot[tabindex]').length") == 0


def test_values_stand_under_the_pointer_and_at_the_edges_of_a_zoomed_figure(browser, report):
    browser.open(report, width=1440, height=900)
    browser.evaluate("document.documentElement.style.scrollBehavior = 'auto'")
    told = browser.evaluate("""(() => {
      const group = [...document.querySelectorAll("[data-panel]")].find((g) => g.dataset.panel.split(" ")[7] === "1"
        && g.dataset.panel.split(" ")[6] === "0" && g.closest("figure").checkVisibility());
      const svg = group.closest("svg");
      svg.scrollIntoView({block: "center"});
      const [left, top, width, height, low, high] = group.dataset.panel.split(" ").map(Number);
      const box = svg.getBoundingClientRect(), home = svg.getAttribute("viewBox").split(" ").map(Number);
      const event = { clientX: box.left + (left + width / 2) / home[2] * box.width,
                      clientY: box.top + (top + height / 2) / home[3] * box.height };
      svg.dispatchEvent(new PointerEvent("pointermove", event));
      const value = svg.nextElementSibling.textContent;
      for (let k = 0; k < 3; k++) svg.dispatchEvent(new KeyboardEvent("keydown", { key: "+" }));
      const ticks = [...svg.querySelectorAll(".ticks text")].map((t) => t.textContent.replace("\\u2212", "-"));
      svg.dispatchEvent(new KeyboardEvent("keydown", { key: "0" }));
      return { value, middle: (low + high) / 2, span: high - low, low, high, ticks,
               after: svg.querySelectorAll(".ticks text").length };
    })()""")
    assert float(told["value"].split()[1].replace("\u2212", "-")) == pytest.approx(
        told["middle"], abs=2e-3 * abs(told["span"])
    )
    numbers = [float(tick) for tick in told["ticks"] if NUMBER.fullmatch(tick.replace("-", "\u2212"))]
    assert len(numbers) >= 4
    assert any(told["low"] < number < told["high"] for number in numbers)
    assert told["after"] == 0
    assert browser.problems() == []


@pytest.mark.parametrize(("width", "height", "mobile"), [(390, 844, True), (1440, 900, False)])
def test_ticks_of_zoomed_figures_are_round_and_apart_and_their_names_stay(browser, report, width, height, mobile):
    browser.open(report, width=width, height=height, mobile=mobile)
    figures = browser.evaluate("""[...document.querySelectorAll("svg.plot")].filter((svg) => svg.checkVisibility()
      && svg.querySelector("[data-panel]")).map((svg) => {
        const names = [...svg.querySelectorAll("text")].map((t) => t.textContent).filter((name) => name.includes("["));
        for (let k = 0; k < 4; k++) svg.dispatchEvent(new KeyboardEvent("keydown", { key: "+" }));
        const texts = [...svg.querySelectorAll(".ticks text")].map((t) => {
          const box = t.getBoundingClientRect();
          return [t.textContent, box.left, box.top, box.right, box.bottom];
        });
        svg.dispatchEvent(new KeyboardEvent("keydown", { key: "0" }));
        return { names, texts };
      })""")
    assert figures
    named = 0
    for figure in figures:
        labels = [text for text, *_ in figure["texts"]]
        for number in filter(NUMBER.fullmatch, labels):
            assert len(number.strip("\u22120.").replace(".", "").rstrip("0")) <= 3, number
        named += any(map(NUMBER.fullmatch, labels)) and bool(set(labels) & set(figure["names"]))
        for (one, *a), (other, *b) in combinations(figure["texts"], 2):
            assert a[2] <= b[0] + 1 or b[2] <= a[0] + 1 or a[3] <= b[1] + 3 or b[3] <= a[1] + 3, (one, other)
    assert named
    assert browser.problems() == []


def test_page_one_prints_on_one_sheet_with_its_figures(browser, report):
    browser.open(report, width=1000, height=900)
    assert 0.5 < browser.on_a_sheet() < 1
