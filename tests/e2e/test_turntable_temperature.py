"""A gyroscope on a turntable while its temperature rose and fell: what `calibrate_turntable` makes of it."""

from dataclasses import replace

import numpy as np
import pytest

from gnomon import TurntableScenario, calibrate_turntable, simulate_turntable
from gnomon.options import StatedRate
from gnomon.recording import TemperatureSamples

SLOPES = np.array([4e-4, -6e-4, 2e-4])
REFERENCE = 36.0


def calibrated(seed, course, scenario):
    """Return simulation and calibration of a gyroscope whose bias follows the temperature, or the time."""
    simulation = simulate_turntable(scenario, seed)
    gyroscopes = [one.imus["imu0"].gyroscope for one in simulation.recordings]
    lasts = sum(one.duration_s for one in gyroscopes)
    recordings, since = [], 0.0
    for recording, gyroscope in zip(simulation.recordings, gyroscopes, strict=True):
        share = (since + gyroscope.t_s - gyroscope.t_s[0]) / lasts
        since += gyroscope.duration_s
        warm = np.where(share < 0.5, 1 - np.exp(-8 * share), (1 - np.exp(-4)) * np.exp(-8 * (share - 0.5)))
        degc = 30 + 12 * warm
        follows = degc - REFERENCE if course == "temperature" else 12 * share
        moved = replace(gyroscope, values=gyroscope.values + follows[:, None] * SLOPES)
        read = TemperatureSamples(t_ns=gyroscope.t_ns[::20], values=np.round(degc[::20] / 0.05) * 0.05, unit="degC")
        imu = replace(recording.imus["imu0"], gyroscope=moved, temperature=read)
        recordings.append(replace(recording, imus={"imu0": imu}))
    rates = [StatedRate(name="16rpm", rate_rad_s=simulation.rates[0], sigma_rad_s=1e-4 * simulation.rates[0])]
    return simulation.truth, calibrate_turntable(recordings, rates).calibration


@pytest.mark.parametrize(
    "scenario",
    [
        TurntableScenario(steady_s=15.0),
        TurntableScenario(steady_s=15.0, accelerometer=False),
        TurntableScenario(steady_s=15.0, files="each"),
    ],
    ids=["one file", "gyroscope alone", "a file for each"],
)
def test_the_bias_follows_a_temperature_that_rose_and_fell(scenario):
    truth, calibration = calibrated(700, "temperature", scenario)
    found = calibration.imus["imu0"].temperature
    assert found is not None
    sigma = calibration.sigma("imu0.temperature.gyroscope_bias")[0]
    assert np.abs((found.gyroscope_bias[0] - SLOPES) / sigma).max() < 3.5
    assert sigma.max() < 0.25 * np.abs(SLOPES).max()
    at_reference = truth.imus["imu0"].gyroscope.bias + (found.reference_degc - REFERENCE) * SLOPES
    off = calibration.imus["imu0"].gyroscope.bias - at_reference
    assert np.abs(off / calibration.sigma("imu0.gyroscope.bias")).max() < 3.5
    assert [one.code for one in calibration.assessment.findings].count("temperature-slope") == 1


def test_a_drift_with_the_time_is_no_slope():
    assert calibrated(710, "time", TurntableScenario(steady_s=15.0))[1].imus["imu0"].temperature is None
