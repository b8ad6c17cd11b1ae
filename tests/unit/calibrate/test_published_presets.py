"""Tedaldi as published: what the presets need of T_init is told in words."""

import pytest

from gnomon import Calibration, ImuOptions, Scenario, calibrate_imu, simulate
from gnomon.errors import DetectionError
from gnomon.recording import Recording


@pytest.fixture(scope="module")
def simulated() -> tuple[Recording, Calibration]:
    return simulate(Scenario(intervals=12, t_init_s=20.0), seed=1)


@pytest.fixture(scope="module")
def turned(simulated: tuple[Recording, Calibration]) -> Recording:
    return simulated[0]


@pytest.mark.parametrize(("t_init_s", "samples"), [(0.02, 2), (0.3, 30), (0.49, 49)])
def test_t_init_shorter_than_half_a_window_is_refused(turned: Recording, t_init_s: float, samples: int) -> None:
    options = ImuOptions(preset="tedaldi2014", t_init_s=t_init_s, window_s=1.0)
    with pytest.raises(DetectionError, match=rf"only {samples}\d? samples lie in T_init.*State a longer --t-init-s"):
        calibrate_imu(turned, options)


def test_t_init_longer_than_half_a_window_is_enough(simulated: tuple[Recording, Calibration]) -> None:
    recording, truth = simulated
    calibration = calibrate_imu(recording, ImuOptions(preset="tedaldi2014", t_init_s=0.6, window_s=1.0)).calibration
    found, true = (c.in_frame("accel-x").imus["imu0"].accelerometer for c in (calibration, truth))
    assert found is not None
    assert true is not None
    assert found.bias == pytest.approx(true.bias, abs=0.01)


def test_a_recording_shorter_than_t_init_is_refused(turned: Recording) -> None:
    with pytest.raises(DetectionError, match=r"is shorter than T_init = 5000 s of this preset"):
        calibrate_imu(turned, ImuOptions(preset="tedaldi2014", t_init_s=5000.0))
