"""Samples that are missing without timestamps show as steps of twice the length in smooth motion."""

from dataclasses import replace

import numpy as np
import pytest

import gnomon
from gnomon.assess.checks.imu_checks import check_lost_samples


@pytest.fixture(scope="module")
def gyroscope():
    scenario = gnomon.Scenario(intervals=16, t_init_s=20.0)
    return gnomon.simulate(scenario, 1)[0].imus["imu0"].gyroscope


def without(samples, share, seed=0, *, stamped=False):
    kept = np.random.default_rng(seed).random(len(samples)) >= share
    t_ns = samples.t_ns[kept] if stamped else samples.t_ns[: kept.sum()]
    return replace(samples, values=samples.values[kept], t_ns=t_ns)


@pytest.mark.parametrize("share", [0.02, 0.05])
def test_lost_samples_are_noticed_and_counted(gyroscope, share) -> None:
    (finding,) = check_lost_samples(without(gyroscope, share), "gyroscope")
    assert (finding.code, finding.severity) == ("samples-skipped", "warning")
    found = float(finding.message.split("about ")[1].split(" %")[0])
    assert found == pytest.approx(100 * share, rel=0.6)


def test_whole_recordings_stamped_ones_and_rough_motion_are_let_be(gyroscope) -> None:
    assert check_lost_samples(gyroscope, "gyroscope") == []
    assert check_lost_samples(without(gyroscope, 0.02, stamped=True), "gyroscope") == []
    rough = replace(gyroscope, values=np.random.default_rng(1).standard_normal(gyroscope.values.shape))
    assert check_lost_samples(rough, "gyroscope") == []
    held = replace(gyroscope, values=np.repeat(gyroscope.values[::2], 2, axis=0)[: len(gyroscope)])
    assert check_lost_samples(held, "gyroscope") == []


@pytest.mark.parametrize("name", ["mikov-mpu9150-multipos/imu0.log"])
def test_real_recordings_are_let_be(real_data, name) -> None:
    recording = gnomon.read(real_data(name), rate_hz=100.0)
    assert check_lost_samples(recording.imus["imu0"].gyroscope, "gyroscope") == []
