"""The report of a camera calibration in a real browser: nothing is cut off, coloured wrongly or loaded."""

import pytest

from cameras_result import make_cameras_result
from gnomon.report.page import write_report
from headless import CHROMIUM, CUT_OFF, MEASURE, WHY_NOT, Browser

pytestmark = [pytest.mark.browser, pytest.mark.skipif(CHROMIUM is None, reason=WHY_NOT)]

SCREENS = [(390, 844, True), (1440, 900, False), (768, 1024, True)]
FIGURES = {"stereo": 20, "fisheye": 14}
"""Coverage, field, three of views, spread and correlation, rig, agreement, board; of each camera five."""

FIRST_SCREEN = """[...document.querySelectorAll("h1, .numbers dd:not(.note), .findings .cure")]
  .map((e) => e.getBoundingClientRect().bottom)"""


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    browser = Browser(tmp_path_factory.mktemp("profile"))
    yield browser
    browser.close()


@pytest.fixture(scope="module")
def reports(tmp_path_factory):
    folder = tmp_path_factory.mktemp("report")
    write_report(make_cameras_result(), folder / "stereo.html")
    write_report(make_cameras_result(model="ds-none", cameras=1), folder / "fisheye.html")
    return folder


@pytest.mark.parametrize("which", list(FIGURES))
@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize(("width", "height", "mobile"), SCREENS)
def test_page_fits_and_is_clean(browser, reports, which, width, height, mobile, scheme):
    browser.open(reports / f"{which}.html", width=width, height=height, mobile=mobile, scheme=scheme)
    seen = browser.evaluate(MEASURE)
    assert browser.problems() == []
    assert seen["inner"] == width
    assert seen["scroll"] <= seen["client"]
    assert seen["title"].startswith("Warn.")
    assert len(seen["plots"]) == FIGURES[which]
    for left, right, tall in seen["plots"]:
        assert left >= 0
        assert right <= width
        assert tall > 100
    assert seen["text"] >= 9
    assert browser.evaluate(CUT_OFF) == []
    assert (seen["paper"] == "rgb(18, 23, 28)") == (scheme == "dark")


@pytest.mark.parametrize(("width", "height"), [(1440, 900), (390, 844)])
def test_first_screen_answers_whether_it_can_be_trusted(browser, reports, width, height):
    """Verdict, the six numbers and what to do are seen without scrolling; on a phone all but what to do."""
    browser.open(reports / "stereo.html", width=width, height=height, mobile=width < 500)
    bottoms = browser.evaluate(FIRST_SCREEN)
    assert len(bottoms) == 1 + 6 + 1
    assert max(bottoms if width > 500 else bottoms[:-1]) <= height


def test_everything_can_be_read_without_scripts(browser, reports):
    browser.open(reports / "stereo.html", width=1440, height=900, scripts=False)
    browser.call("Emulation.setScriptExecutionDisabled", value=False)
    assert browser.evaluate("document.querySelectorAll('svg.plot').length") == FIGURES["stereo"]
    assert browser.evaluate("document.querySelectorAll('svg.plot[tabindex]').length") == 0
    assert browser.problems() == []


def test_hostile_names_do_not_break_the_page(browser, tmp_path):
    names = ("<script>window.broken = 1</script>&\"'", "a" * 200 + ".bag", "<img src=x onerror=window.broken=1>")
    write_report(make_cameras_result(names=names, used=8, held=2), tmp_path / "report.html")
    browser.open(tmp_path / "report.html", width=390, height=844, mobile=True)
    seen = browser.evaluate(MEASURE)
    assert browser.problems() == []
    assert seen["scroll"] <= seen["client"]
    assert browser.evaluate("typeof window.broken") == "undefined"


def test_prints_on_paper_in_light_colours(browser, reports):
    browser.open(reports / "stereo.html", width=1000, height=900, scheme="dark")
    browser.call(
        "Emulation.setEmulatedMedia", media="print", features=[{"name": "prefers-color-scheme", "value": "dark"}]
    )
    assert browser.evaluate("getComputedStyle(document.body).backgroundColor") == "rgb(255, 255, 255)"
    printed = browser.call("Page.printToPDF", printBackground=True)["data"]
    browser.call("Emulation.setEmulatedMedia", media="")
    assert len(printed) > 100_000


@pytest.mark.parametrize("which", list(FIGURES))
def test_page_one_prints_on_one_sheet_with_its_figures(browser, reports, which):
    browser.open(reports / f"{which}.html", width=1000, height=900)
    assert 0.4 < browser.on_a_sheet() < 1
