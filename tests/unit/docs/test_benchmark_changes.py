"""The study of changes in mid-recording with one seed; `python benchmarks/changes.py` is the whole."""

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[3] / "benchmarks"))

import changes

SLOW = pytest.mark.slow


@pytest.mark.parametrize(
    ("fault", "size"),
    [("remount", 1.0), pytest.param("crop", 8.0, marks=SLOW), pytest.param("soft iron", 8.0, marks=SLOW)],
)
def test_a_fault_is_named_and_a_healthy_recording_is_not(fault, size):
    run = changes.FAULTS[fault].run
    faulty = run(fault, 1000, size)
    assert (faulty.named, faulty.missed) == (True, False)
    assert faulty.verdict != "pass"
    kind = next(kind for kind, work in changes.HEALTHY.values() if work is run)
    healthy = run(kind, 1000, 0.0)
    assert (healthy.verdict, healthy.named, healthy.missed) == ("pass", False, False)
