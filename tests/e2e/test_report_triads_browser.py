"""The report of a calibration from magnitudes in a real browser: it fits every screen, and no texts overlap."""

import pytest

import triad_result
from gnomon.report.page import write_report
from headless import CHROMIUM, MEASURE, WHY_NOT, Browser

pytestmark = [pytest.mark.browser, pytest.mark.skipif(CHROMIUM is None, reason=WHY_NOT)]

OVERLAPS = """(() => {
  const found = [];
  for (const plot of document.querySelectorAll("svg.plot")) {
    const seen = [...plot.querySelectorAll("text")].map((t) => [t.textContent, t.getBoundingClientRect()]);
    const texts = seen.filter(([, b]) => b.width > 0);
    texts.forEach(([one, a], i) => texts.slice(0, i).forEach(([other, b]) => {
      const across = Math.min(a.right, b.right) - Math.max(a.left, b.left);
      const down = Math.min(a.bottom, b.bottom) - Math.max(a.top, b.top);
      if (across > 1 && down > 0.3 * Math.min(a.height, b.height)) found.push(`${one} | ${other}`);
    }));
  }
  return found;
})()"""
"""Pairs of texts in figures that cover each other; boxes of texts reach above and below their letters."""


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    browser = Browser(tmp_path_factory.mktemp("profile"))
    yield browser
    browser.close()


@pytest.mark.parametrize("kind", list(triad_result.RESULTS))
def test_page_fits_and_no_texts_overlap(browser, tmp_path, kind):
    path = tmp_path / "report.html"
    write_report(triad_result.RESULTS[kind](), path)
    for width, height, mobile, scheme in (
        (390, 844, True, "light"),
        (768, 1024, True, "dark"),
        (1440, 900, False, "light"),
    ):
        browser.open(path, width=width, height=height, mobile=mobile, scheme=scheme)
        seen = browser.evaluate(MEASURE)
        assert browser.problems() == []
        assert seen["scroll"] <= seen["client"]
        assert seen["plots"]
        for left, right, tall in seen["plots"]:
            assert left >= 0
            assert right <= width
            assert tall > 90
        assert seen["text"] >= 9
        assert not any("var" in stroke for stroke in seen["strokes"])
        assert browser.evaluate(OVERLAPS) == []
    assert 0.4 < browser.on_a_sheet() < 1
