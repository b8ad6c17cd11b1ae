"""Recordings whose accelerometer reads gravity as another number from an instant on, or shakes in a part."""

from dataclasses import replace

import numpy as np
import pytest

from gnomon.assess.checks.imu_checks import find_imu_rests
from gnomon.detect.samples.faults import find_range_change
from gnomon.detect.samples.rests import RestDetection
from gnomon.recording import Floats, ImuSamples
from gnomon.results.result import StaticIntervals
from gnomon.simulate.imu import simulate_imu
from gnomon.simulate.scenarios.recorded import Scenario
from support.healthy import healthy_imu

RESTS = 24


@pytest.fixture(scope="module")
def imu() -> ImuSamples:
    scenario = Scenario(intervals=RESTS, t_init_s=10.0, hold_s=(2.0, 2.5), motion_s=(1.0, 1.5), rate_hz=50.0)
    return simulate_imu(scenario, 71)[0].imus["imu0"]


def detected(imu: ImuSamples, values: Floats) -> RestDetection:
    found = find_imu_rests(replace(imu, accelerometer=replace(imu.accelerometer, values=values)))
    assert found is not None
    return found


def after(imu: ImuSamples, share: float) -> Floats:
    """Return which samples come after a share of the recording, (n, 1)."""
    t_s = imu.accelerometer.t_s
    return (t_s > share * t_s[-1])[:, None]


@pytest.mark.parametrize("factor", [0.25, 0.5, 1.4, 2.0, 8.0, 1 / 9.80665, 9.80665])
@pytest.mark.parametrize("share", [0.45, 0.85])
def test_a_changed_range_is_found_and_every_rest_counted(imu, factor, share) -> None:
    found = detected(imu, imu.accelerometer.values * np.where(after(imu, share), factor, 1.0))
    change = found.range_change
    assert change is not None
    assert change.factor == pytest.approx(factor, rel=0.1)
    t_s = imu.accelerometer.t_s
    assert t_s[change.last] < share * t_s[-1] + 2.5
    assert t_s[change.first] > share * t_s[-1] - 2.5
    rests = found.chosen.rests
    assert RESTS - 2 <= len(rests) <= RESTS + 1
    inside = (rests.kept.start >= change.kept[0]) & (rests.kept.stop <= change.kept[1])
    assert (rests.used == inside).all()
    assert {why for why in rests.reason if why} == {"the accelerometer reads gravity as another number there"}


def test_the_side_that_reads_gravity_is_kept_where_it_has_enough_rests() -> None:
    starts = np.arange(40) * 100
    rests = StaticIntervals(start=starts, stop=starts + 50)
    read = np.where(np.arange(40) < 15, 9.8, 19.6)
    kept = [find_range_change(read, rests, 4000, gravity, 10) for gravity in (9.8, 19.6, None)]
    assert [change is not None and change.kept[0] == 0 for change in kept] == [True, False, False]
    few = find_range_change(read, rests, 4000, 9.8, 16)
    assert few is not None
    assert few.kept[0] > 0
    assert find_range_change(np.full(40, 9.8), rests, 4000, 9.8, 10) is None


@pytest.mark.parametrize("rms", [0.1, 2.0])
def test_rests_that_shake_more_are_counted_as_not_used(imu, rms) -> None:
    noise = np.random.default_rng(1).normal(0, rms, imu.accelerometer.values.shape)
    rests = detected(imu, imu.accelerometer.values + after(imu, 0.7) * noise).chosen.rests
    assert RESTS - 2 <= len(rests) <= RESTS
    late = imu.accelerometer.t_s[rests.kept.start] > 0.7 * imu.accelerometer.t_s[-1]
    assert late.sum() >= 5
    assert [why == "it shakes more than the rests that are used" for why in rests.reason] == late.tolist()


@pytest.mark.parametrize("seed", range(900, 906))
def test_nothing_is_added_to_healthy_recordings(seed) -> None:
    found = find_imu_rests(simulate_imu(healthy_imu(seed), seed)[0].imus["imu0"])
    assert found is not None
    assert found.range_change is None
    assert found.chosen.rests.used.all()
