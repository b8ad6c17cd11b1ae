"""Simulated recordings with known truth: are the errors what the covariance says?

`pytest tests/e2e/test_nees.py -m slow -s` prints the table of the whole study.
"""

from dataclasses import replace

import numpy as np
import pytest

import gnomon
from gnomon.results.calibration import calibration_parameters

SCENARIO = gnomon.Scenario(g_sensitivity=1e-4, earth_rate_latitude=45.0)
OPTIONS = gnomon.ImuOptions(gravity=9.80665, latitude=45.0, model="g-sensitivity")
BLOCKS = {
    "accelerometer sensitivity": slice(0, 6),
    "accelerometer bias": slice(6, 9),
    "gyroscope sensitivity": slice(9, 18),
    "gyroscope bias": slice(18, 21),
    "gyroscope g-sensitivity": slice(21, 30),
}
PARAMETERS = 30
BAND = 3.29  # of 99.9 %


def calibrated(seed, scenario):
    """Return errors (30,) and their covariance (30, 30) of one recording."""
    recording, truth = gnomon.simulate(scenario, seed)
    calibration = gnomon.calibrate_imu(recording, OPTIONS).calibration
    assessment = calibration.assessment
    assert not any(finding.code == "not-converged" for finding in assessment.findings)
    # By its own limit parts disagree in one healthy recording of a hundred.
    warned = {finding.code for finding in assessment.findings if finding.severity == "warning"}
    assert warned <= {"parts-disagree"} or scenario != SCENARIO
    assert calibration.verdict != "fail"
    assert assessment.intervals_used >= scenario.intervals - 1  # five sigma happen once in fifty recordings
    pairs = zip(calibration_parameters(calibration.imus), calibration_parameters(truth.imus), strict=True)
    errors = np.concatenate([(found - true).ravel() for (_, found), (_, true) in pairs])
    covariance = calibration.uncertainty.matrix
    free = np.diag(covariance) > 0
    assert free.sum() == PARAMETERS
    assert np.abs(errors[~free]).max() < 1e-12
    return errors[free], covariance[np.ix_(free, free)]


def study(seeds, scenario=SCENARIO):
    """Return the NEES (n,) and the errors in units of their sigma (n, 30)."""
    nees, scaled = [], []
    for seed in seeds:
        errors, covariance = calibrated(seed, scenario)
        sigma = np.sqrt(np.diag(covariance))
        scaled.append(errors / sigma)
        nees.append(scaled[-1] @ np.linalg.solve(covariance / np.outer(sigma, sigma), scaled[-1]))
    return np.array(nees), np.array(scaled)


def assert_consistent(nees, scaled, widest):
    n = len(nees)
    half_width = BAND * np.sqrt(2 * PARAMETERS / n)
    ratios = {name: float(np.sqrt(np.mean(scaled[:, part] ** 2))) for name, part in BLOCKS.items()}
    print(f"\n{n} recordings: NEES {nees.mean():.2f}, 99.9 % band {PARAMETERS} +- {half_width:.2f}")
    for name, ratio in ratios.items():
        print(f"  {name:28} empirical / predicted sigma {ratio:.3f}")
    assert abs(nees.mean() - PARAMETERS) < half_width
    assert all(1 - widest < ratio < 1 + widest for ratio in ratios.values()), ratios
    bias = np.abs(scaled.mean(axis=0)) * np.sqrt(n)
    assert bias.max() < 4.5  # none of thirty is systematically off


@pytest.mark.long
def test_covariance_is_honest():
    # Three elements of 24 recordings leave a ratio of sigmas open by 8 %; the band is four times that.
    assert_consistent(*study(range(24)), widest=0.33)


@pytest.mark.slow
def test_covariance_is_honest_in_200_recordings():
    assert_consistent(*study(range(100, 300)), widest=0.2)


@pytest.mark.slow
@pytest.mark.parametrize(
    "changes",
    [
        {"rate_hz": 200.0, "gyroscope_rate_hz": 80.0},
        {"units": "raw"},
        {"stamp_resolution_s": 1e-3, "stamp_jitter_s": 2e-4, "dropped": 0.01},
        {"intervals": 20, "t_init_s": 20.0},
        {"accelerometer_noise_density": 7e-3, "gyroscope_noise_density": 4.3e-3},
        {"gyroscope_noise_density": 4.3e-5},
        {"gyroscope_bias_walk": 2e-5},
    ],
    ids=str,
)
def test_covariance_is_near_honest_elsewhere(changes):
    nees, scaled = study(range(40), replace(SCENARIO, **changes))
    ratios = {name: round(float(np.sqrt(np.mean(scaled[:, part] ** 2))), 2) for name, part in BLOCKS.items()}
    print(f"\n{changes}: NEES {nees.mean():.1f}, {ratios}")
    # The worst is a gyroscope ten times quieter than the default, where the horizontal part of the earth's rate, which
    # is taken as random from interval to interval, is larger than the noise: NEES 40, g-sensitivity 1.3.
    assert nees.mean() < 1.5 * PARAMETERS
    assert all(0.7 < ratio < 1.4 for ratio in ratios.values())
