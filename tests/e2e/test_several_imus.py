"""Two cameras and two IMUs whose clocks have nothing in common: is the truth inside the joint covariance?

`pytest tests/e2e/test_several_imus.py -m slow -s` prints the tables; `GNOMON_STUDY=0.1` takes a tenth of the runs.
"""

import os
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from gnomon import CameraImuOptions, CameraImuScenario, calibrate_camera_imu, simulate_camera_imu
from gnomon.geometry.rotations import rotation_from_rotvec, rotvec_from_rotation
from gnomon.results.sensors import calibration_parameters

OPTIONS = CameraImuOptions(gravity=9.80665, model="full", covariance="ordinary")
RUNS = max(3, round(50 * float(os.environ.get("GNOMON_STUDY", "1"))))
BAND = 3.29  # of 99.9 %

COMMON = {
    "duration_s": 20.0, "cameras": 2, "imus": 2, "camera_rate_hz": 15.0, "target_cols": 4, "target_rows": 4,
}  # fmt: skip
SETS = {
    "unrelated clocks": CameraImuScenario(
        **COMMON,
        imu_clock_offset_s=-1.7e9,
        clock_offset_s=123.0,
        clock_offset_difference_s=-77.0,
        synchronous_cameras=False,
    ),
    "delayed accelerometers": CameraImuScenario(
        **COMMON,
        imu_clock_offset_s=1.6e9,
        clock_offset_s=-40.0,
        further_imu_rate_hz=160.0,
        accelerometer_rate_hz=125.0,
        accelerometer_delay_s=0.006,
        further_accelerometer_delay_s=-0.011,
    ),
}


def errors(result, simulation):
    """Return names, errors and covariance of all scalars that were estimated, biases as their means."""
    calibration, truth = (
        result.calibration,
        dict(calibration_parameters(simulation.truth.imus, simulation.truth.cameras)),
    )
    found = dict(calibration_parameters(calibration.imus, calibration.cameras))
    assert found.keys() == truth.keys()
    error = [
        rotvec_from_rotation(rotation_from_rotvec(truth[path]).T @ rotation_from_rotvec(value))
        if path.endswith("rotation")
        else np.ravel(value - truth[path])
        for path, value in found.items()
    ]
    kept = np.diag(calibration.uncertainty.matrix) > 0
    names = np.array([name.partition("[")[0] for name in calibration.uncertainty.names])
    return names[kept], np.concatenate(error)[kept], calibration.uncertainty.matrix[np.ix_(kept, kept)]


def chi2(error, covariance):
    sigma = np.sqrt(np.diag(covariance))
    z = error / sigma
    return float(z @ np.linalg.solve(covariance / np.outer(sigma, sigma), z))


SHORT = replace(
    SETS["delayed accelerometers"],
    duration_s=10.0,
    imu_rate_hz=100.0,
    further_imu_rate_hz=80.0,
    accelerometer_rate_hz=64.0,
    camera_rate_hz=10.0,
)
"""The same in seconds."""


@cache
def run(scenario, seed):
    simulation = simulate_camera_imu(scenario, seed)
    result = calibrate_camera_imu(simulation.recording, simulation.target, OPTIONS)
    assert result.calibration.assessment.camera_imu.converged
    return errors(result, simulation)


def check(name, scenario, seeds):
    """Compare the errors of recordings with what the covariance says: together, block by block, and one by one."""
    runs = [run(scenario, seed) for seed in seeds]
    labels, count = runs[0][0], len(runs)
    p = len(labels)
    total = float(np.mean([chi2(error, covariance) for _, error, covariance in runs]))
    print(f"\n{name}: {count} recordings, NEES {total:.2f} of {p} +- {BAND * np.sqrt(2 * p / count):.2f}")
    off = {}
    for block in dict.fromkeys(labels):
        at = labels == block
        own = np.mean([chi2(error[at], covariance[np.ix_(at, at)]) for _, error, covariance in runs])
        # chi^2 of few degrees of freedom leans to the right: Wilson and Hilferty's cube root is nearly normal
        freedom = count * at.sum()
        z = (np.cbrt(own / at.sum()) - 1 + 2 / (9 * freedom)) / np.sqrt(2 / (9 * freedom))
        print(f"  {block:36} chi2/p {own / at.sum():.3f}, z {z:5.2f}")
        if abs(z) > BAND + 0.6:  # of some thirty blocks
            off[block] = z
    z = np.array([error / np.sqrt(np.diag(covariance)) for _, error, covariance in runs])
    beyond = int((np.abs(z) > 3).sum())
    print(f"  beyond 3 sigma {beyond} of {z.size}, expected {0.0027 * z.size:.1f}; largest {np.abs(z).max():.2f}")
    assert abs(total - p) < BAND * np.sqrt(2 * p / count)
    assert off == {}
    assert beyond <= 0.0027 * z.size + 4 * np.sqrt(0.0027 * z.size) + 1
    assert np.abs(z).max() < 6
    return runs


@pytest.mark.long
def test_the_truth_lies_inside_the_joint_covariance():
    names, _, covariance = check("ten seconds", SHORT, range(3))[0]
    sigma = np.sqrt(np.diag(covariance))
    assert sigma[names == "imu1.T_imu_body.translation"].max() < 2e-3
    for clock in ("imu1.time_shift_imu", "imu0.accelerometer.time_shift", "imu1.accelerometer.time_shift"):
        assert 0 < sigma[names == clock].item() < 3e-4


@pytest.mark.slow
@pytest.mark.parametrize("name", SETS)
def test_the_truth_lies_inside_the_joint_covariance_of_many(name):
    check(name, SETS[name], range(1000, 1000 + RUNS))
