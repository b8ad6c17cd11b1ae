"""The report of a comparison in a real browser: it fits, nothing is cut off, it asks for nothing."""

from dataclasses import replace

import numpy as np
import pytest

from gnomon.calibrate.comparison import compare
from gnomon.report.comparison import write_comparison_report
from headless import CHROMIUM, CUT_OFF, MEASURE, WHY_NOT, Browser

pytestmark = [pytest.mark.browser, pytest.mark.skipif(CHROMIUM is None, reason=WHY_NOT)]


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    browser = Browser(tmp_path_factory.mktemp("profile"))
    yield browser
    browser.close()


@pytest.fixture(params=[2, 9])
def report(request, random_calibration, tmp_path):
    """Return the report of so many calibrations, drawn from the covariance of one; the last stands out."""
    calibration = random_calibration(1, units=("m/s^2", "rad/s"))
    rng = np.random.default_rng(4)
    size = np.abs(calibration.imus["imu0"].gyroscope.sensitivity).max()
    made = []
    for i in range(request.param):
        imu = calibration.imus["imu0"]
        matrix = imu.gyroscope.sensitivity + 1e-4 * size * rng.normal(size=(3, 3)) * (1 + 90 * (i == request.param - 1))
        made.append(
            replace(calibration, imus={"imu0": replace(imu, gyroscope=replace(imu.gyroscope, sensitivity=matrix))})
        )
    path = tmp_path / "report.html"
    write_comparison_report(compare(*made), path)
    return path


@pytest.mark.parametrize(("width", "height", "mobile"), [(390, 844, True), (1440, 900, False)])
def test_page_fits_and_is_clean(browser, report, width, height, mobile):
    browser.open(report, width=width, height=height, mobile=mobile)
    seen = browser.evaluate(MEASURE)
    assert browser.problems() == []
    assert seen["scroll"] <= seen["client"]
    assert seen["title"].startswith("Fail.")
    assert len(seen["plots"]) == 1
    assert seen["text"] >= 9
    assert browser.evaluate(CUT_OFF) == []
