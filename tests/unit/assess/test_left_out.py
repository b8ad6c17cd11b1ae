"""Rests left out: listed by reason with their times; behind each other something changed, unless chance explains it."""

import numpy as np
import pytest

from gnomon.assess.checks.imu_checks import left_out_rests_findings
from gnomon.assess.imu.recording_changes import significant_cluster


@pytest.mark.parametrize(
    ("out", "n", "expected"),
    [
        ((), 40, None),
        ((3, 17, 30), 40, None),
        ((38, 39), 40, None),
        ((37, 38, 39), 40, (37, 39)),
        ((0, 1, 2), 40, (0, 2)),
        ((5, 20, 21, 22), 40, (20, 22)),
        ((35, 36, 38, 39), 40, (35, 39)),  # one of another sensor's agrees by chance
        ((0, 8, 9, 30), 40, None),
    ],
)
def test_rests_left_out_together(out, n, expected):
    assert significant_cluster(np.isin(np.arange(n), out)) == expected


def test_independent_rests_are_rarely_together():
    rng = np.random.default_rng(1)
    found = [significant_cluster(rng.permutation(200) < 15) for _ in range(200)]
    assert sum(one is not None for one in found) < 30


def test_rests_left_out_are_grouped_by_reason_and_runs():
    start_s = 10.0 * np.arange(40)
    reason = [""] * 40
    for k in (3, 4, 5, 20):
        reason[k] = "it turned"
    reason[8] = "saturated"
    [finding] = left_out_rests_findings(start_s, start_s + 4, reason, "imu0: ")
    assert finding.message == (
        "imu0: 5 of 40 static intervals left out: 4 to 6 (30.0 to 54.0 s), 21 (200.0 to 204.0 s): it turned; "
        "9 (80.0 to 84.0 s): saturated."
    )
    assert finding.severity == "warning"


def test_the_list_ends_and_says_how_many_more():
    reason = ["", "touched"] * 20
    [finding] = left_out_rests_findings(np.arange(40.0), np.arange(40.0) + 0.5, reason)
    assert "12 (11.0 to 11.5 s) and 14 more, which the report lists: touched." in finding.message


def test_nothing_left_out_is_not_said():
    assert not left_out_rests_findings(np.arange(3.0), np.arange(3.0), ["", "", ""])
