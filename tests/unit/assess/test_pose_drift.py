"""An accelerometer that drifts while poses are recorded: told where the attitudes tell it, else in the sigmas."""

import numpy as np
import pytest

import gnomon
from gnomon.options import ImuOptions
from gnomon.recording import Poses, Recording
from gnomon.simulate import PoseScenario, simulate_poses

NAMES = "imu0.accelerometer.sensitivity", "imu0.accelerometer.bias"
SCENARIO = PoseScenario(sensor="drawn", units="si")
SORTED = PoseScenario(sensor="drawn", units="si", attitudes="sphere", poses=24)
ANGRISANO = PoseScenario(sensor="drawn", units="si", attitudes="angrisano18")
LATERAL = 0.05 * np.array([0.8, -0.5, 0.3])


def stepped(tau, at=0.1):
    """Return a step of one with a mean of zero."""
    return (tau > at) - np.mean(tau > at)


def calibrated(scenario, seed, drift, *, timed=True, order=None, way=lambda tau: tau):
    """Return the errors in sigmas, the findings, and the calibration; drift is (3,) from the first pose to the last."""
    simulation = simulate_poses(scenario, seed)
    n = len(simulation.poses)
    order = np.arange(n) if order is None else order
    tau = np.linspace(-0.5, 0.5, n)
    values = simulation.accelerometer[order] + way(tau)[:, None] * np.asarray(drift)
    poses = Poses(
        name=tuple(map(str, range(n))),
        accelerometer=values,
        accelerometer_unit="m/s^2",
        accelerometer_sigma=np.full((n, 3), 2e-3),
        t_s=simulation.t_s if timed else None,
    )
    result = gnomon.calibrate_imu(Recording(imus={}, poses=poses), ImuOptions(gravity=9.80665, frame="accel-z"))
    found = result.calibration
    sigma = np.concatenate([found.sigma(name).ravel() for name in NAMES])
    error = np.concatenate([(found.parameter(name) - simulation.truth.parameter(name)).ravel() for name in NAMES])
    return error[sigma > 0] / sigma[sigma > 0], {f.code: f for f in found.assessment.findings}, found


@pytest.mark.parametrize("timed", [True, False])
@pytest.mark.parametrize("seed", [0, 1])
def test_a_steady_drift_is_estimated_along(seed, timed) -> None:
    drift = np.array([0.05, -0.03, 0.04])
    scaled, findings, found = calibrated(SCENARIO, seed, drift, timed=timed)
    assert np.abs(scaled).max() < 4
    assert findings["accelerometer-drift"].severity == "warning"
    assert found.verdict != "pass"


def test_poses_without_drift_are_not_warned_of_and_lose_little() -> None:
    scaled, findings, found = calibrated(SCENARIO, 2, np.zeros(3))
    assert np.abs(scaled).max() < 4
    assert "accelerometer-drift" not in findings
    assert "drift-not-told" not in findings
    assert found.verdict == "pass"
    assert found.sigma(NAMES[1]).max() < 3e-3


@pytest.mark.parametrize("size", [0.0, 0.03])
def test_where_the_order_resembles_time_a_drift_is_in_the_sigmas(size) -> None:
    scaled, findings, found = calibrated(SORTED, 1, np.full(3, size))
    assert np.abs(scaled).max() < 4
    assert findings["drift-not-told"].severity == "warning"
    assert found.verdict == "warn"
    mixed = np.random.default_rng(0).permutation(24)
    better = calibrated(SORTED, 1, np.full(3, size), order=mixed)[2]
    share = 0.5 if size == 0 else 1.0  # a drift that shows need not be even
    assert better.sigma(NAMES[0]).max() < share * found.sigma(NAMES[0]).max()


def test_a_step_that_looks_like_a_drift_is_in_the_sigmas() -> None:
    worst = [
        np.abs(calibrated(SCENARIO, seed, [0.015, -0.01, 0.01], way=stepped)[0]).max() for seed in (0, 4, 6, 7, 11)
    ]
    assert max(worst) < 4


@pytest.mark.parametrize("at", [-0.26, -0.1])
def test_a_step_that_looks_like_poses_that_are_off_is_named_and_counted(at) -> None:
    """Left out as outliers, they leave poses that agree with each other: 9 sigma off in a result that passed."""
    scaled, findings, _ = calibrated(ANGRISANO, 82027, LATERAL, way=lambda tau: stepped(tau, at))
    assert np.abs(scaled).max() < 4
    assert findings["accelerometer-step"].severity == "warning"


def test_one_pose_that_is_off_is_no_step() -> None:
    scaled, findings, found = calibrated(ANGRISANO, 1, LATERAL, way=lambda tau: np.abs(tau - 0.03) < 0.01)
    assert np.abs(scaled).max() < 4
    assert "accelerometer-step" not in findings
    assert found.verdict == "pass"
    assert found.assessment.intervals_used == 17
