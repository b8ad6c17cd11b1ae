"""Wild cases converge or are refused in words, and are never answered confidently and wrongly.

`pytest tests/e2e/test_wild.py -m slow -s` judges a thousand cases of each kind and prints a table. The number of cases
is in $GNOMON_WILD, the first seed in $GNOMON_WILD_SEED.
"""

import os

import numpy as np
import pytest

from gnomon.study.runs import Workers
from support.wild_imu import wild_imu
from support.wild_judge import judge, judged, study_wild, table
from support.wild_rig import wild_rig

COUNT = int(os.environ.get("GNOMON_WILD", "1000"))
FIRST = int(os.environ.get("GNOMON_WILD_SEED", "50000"))

IMU = {
    20: "the walk of an axis whose rests all read one number",
    104: "the Allan deviation of a gyroscope that reads one number",
    217: "a bias between two steps of the converter",
    253: "a variance that is negative by rounding",
    20134: "a stated bias that the rests contradict, unsaid",
    20076: "a preset's threshold, where the accelerometer reads one number at rest",
    10074: "milliseconds taken for seconds, a grid without end",
    20601: "a share of two codes, taken for the bias between them",
    20313: "the same, g-sensitivity stated",
    50346: "a tremor, which the simulated converter did not see",
    71636: "steps hidden by the arithmetic of a few outliers",
    70810: "a tremor of about a step, which dwells at its ends",
    20555: "a latitude stated where the Earth stands still",
    70367: "the same, seen in a mirror",
    50121: "samples dropped for their timestamps, though a uniform clock is stated",
    60157: "a uniform clock stated for samples with losses too rare to be warned of",
    60119: "one rest, and a prior that it contradicts",
    60091: "motion between samples, which the integration does not see",
    61012: "the Earth's rate, taken off by a scale that was assumed",
    80390: "a preset whose T_init holds one sample",
    90573: "parts of a recording that determine nothing, compared all the same",
}
"""Seeds of what once was wrong."""

RIG = {
    107: "turned about one axis, frames too rare to tell the angle",
    20027: "a gravity that is nowhere on Earth, unsaid",
    60044: "errors of the IMU that a basic model leaves out, by clusters of time alone",
    60203: "g-sensitivity estimated while the gyroscope's scale was taken for ideal",
    60227: "a board that is not flat, taken for a lens in nine seconds",
}

LONG = {107}
"""Those that take half a minute."""


@pytest.mark.parametrize("seed", IMU, ids=str)
def test_what_was_wrong_of_an_imu_stays_mended(seed):
    found = judged(("imu", seed))
    assert found.outcome != "bad", found


@pytest.mark.first(2)
@pytest.mark.long
@pytest.mark.parametrize("seed", [pytest.param(seed, marks=pytest.mark.slow if seed in LONG else ()) for seed in RIG])
def test_what_was_wrong_of_a_rig_stays_mended(seed):
    found = judged(("camera-imu", seed))
    assert found.outcome != "bad", found


def test_a_confident_wrong_answer_is_called_bad():
    # The judge itself: the same recording, with another truth than it has.
    case = next(case for case in map(wild_imu, range(300, 400)) if judge(case).verdict in {"pass", "warn"})
    gyroscope = case.imus["imu0"].gyroscope
    object.__setattr__(gyroscope, "sensitivity", 1.2 * gyroscope.sensitivity)
    assert judge(case).outcome != "right"


def test_cases_are_varied_and_repeat():
    cases = [wild_imu(seed) for seed in range(5)] + [wild_rig(seed) for seed in range(2)]
    assert len({oddity.name for case in cases for oddity in case.oddities}) > 20
    again = wild_imu(3)
    assert np.array_equal(
        again.recording.imus["imu0"].gyroscope.values, cases[3].recording.imus["imu0"].gyroscope.values
    )


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["imu", "camera-imu"])
def test_no_wild_case_is_answered_confidently_and_wrongly(kind):
    found = study_wild([kind], range(FIRST, FIRST + COUNT), workers=Workers(jobs=os.cpu_count() or 1), progress=print)
    print(table(found))
    bad = [one for one in found if one.outcome == "bad"]
    for one in bad:
        print(one.kind, one.seed, one.verdict, one.why, one.said, *one.odd, sep="\n    ")
    assert not bad
