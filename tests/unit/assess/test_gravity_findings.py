"""What is said of gravity: as it was stated, or that there is no such gravity."""

import pytest

from gnomon.assess.verdict import gravity_findings
from gnomon.results.calibration import UNSTATED_GRAVITY, Gravity


@pytest.mark.parametrize(
    ("value", "severity"), [(9.45, "warning"), (9.759, "warning"), (9.8065, "good"), (9.841, "warning")]
)
def test_gravity_that_is_nowhere_on_earth_is_a_warning(value, severity):
    (finding,) = gravity_findings(Gravity(value=value, sigma=0.0, source="as stated"))
    assert (finding.code, finding.severity) == ("gravity", severity)
    assert f"{value:g}" in finding.message


def test_gravity_that_was_not_stated_is_no_warning():
    (finding,) = gravity_findings(UNSTATED_GRAVITY)
    assert finding.severity == "info"
