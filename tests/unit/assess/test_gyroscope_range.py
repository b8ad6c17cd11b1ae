"""A gyroscope whose range or unit changed half-way."""

from dataclasses import replace

import numpy as np
import pytest

import gnomon


def changed_rates(seed: int, factor: float, share: float) -> gnomon.Recording:
    """Return a recording of 24 rests in which the gyroscope's readings are multiplied from a share of it on."""
    recording = gnomon.simulate(gnomon.Scenario(intervals=24, gyroscope_range=1e4), seed=seed)[0]
    imu = recording.imus["imu0"]
    t_s = imu.gyroscope.t_s
    later = t_s > t_s[0] + share * (t_s[-1] - t_s[0])
    rates = replace(imu.gyroscope, values=imu.gyroscope.values * np.where(later, factor, 1.0)[:, None])
    return replace(recording, imus={"imu0": replace(imu, gyroscope=rates)})


@pytest.mark.parametrize(("factor", "share"), [(0.5, 0.6), (2.0, 0.6), (2.0, 0.8), (57.29578, 0.6)])
def test_named_and_failed(factor: float, share: float) -> None:
    calibration = gnomon.calibrate_imu(changed_rates(12, factor, share)).calibration
    assert calibration.verdict == "fail"
    (found,) = (one for one in calibration.assessment.findings if one.code == "gyroscope-range-changed")
    assert calibration.assessment.findings[0] == found  # before what follows from it


@pytest.mark.parametrize("factor", [1.0, 1.1])
def test_no_change_of_range(factor: float) -> None:
    findings = gnomon.calibrate_imu(changed_rates(13, factor, 0.6)).calibration.assessment.findings
    assert "gyroscope-range-changed" not in {one.code for one in findings}


@pytest.mark.parametrize("seed", [34067, 34074])
def test_a_dozen_rests_are_no_change_of_range(seed: int) -> None:
    short = gnomon.Scenario(
        g_sensitivity=3e-4, sensor_seed=seed, intervals=12, t_init_s=6.0, hold_s=(1.9, 2.1), motion_s=(0.8, 1.2)
    )
    assert gnomon.calibrate_imu(gnomon.simulate(short, seed + 5000)[0]).calibration.verdict != "fail"
