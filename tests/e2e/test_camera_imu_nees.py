"""Hundreds of simulated recordings of cameras and an IMU: are the errors what the covariance says, and does none fail?

`pytest tests/e2e/test_camera_imu_nees.py -m slow -s` prints the tables; some minutes on two cores. Fewer runs:
`GNOMON_STUDY=0.1` takes a tenth.
"""

import multiprocessing
import os
import site
import sys
from concurrent.futures import ProcessPoolExecutor
from functools import cache
from itertools import repeat
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[1]))

from camera_imu_truth import cramer_rao_sigma, errors, ratios, run
from gnomon import CameraImuOptions, CameraImuScenario, calibrate_camera_imu, simulate_camera_imu

pytestmark = pytest.mark.slow

OPTIONS = CameraImuOptions(gravity=9.80665, model="full", covariance="ordinary")
PARAMETERS = 33
BAND = 3.29  # of 99.9 %
SHARE = float(os.environ.get("GNOMON_STUDY", "1"))
CASES = [(motion, imu) for motion in ("gentle", "normal") for imu in ("thesis", "consumer")]
EACH = max(2, round(100 * SHARE))
HARD = CameraImuScenario(
    duration_s=40.0,
    random_extrinsics=True,
    time_shift_range_s=5.0,
    gyroscope_bias_range=0.5,
    accelerometer_bias_range=2.0,
    scale_range=0.05,
    dropped_frames=0.3,
    late_frames=0.02,
    shifted_frames=0.02,
)


def calibrated(scenario, seeds):
    """Return the runs of all seeds, by two processes."""
    workers = ProcessPoolExecutor(
        max_workers=2,
        mp_context=multiprocessing.get_context("spawn"),
        initializer=site.addsitedir,  # so that they find `run`
        initargs=(str(Path(__file__).parents[1]),),
    )
    with workers:
        return list(workers.map(run, repeat(scenario), repeat(OPTIONS), seeds, chunksize=4))


@cache
def consistent_runs(motion, imu):
    """Return the runs of one motion with one IMU, each with a path and a noise of its own."""
    scenario = CameraImuScenario(duration_s=40.0, motion=motion, imu=imu)
    return calibrated(scenario, range(1000, 1000 + EACH))


def table(title, runs):
    """Print and return the mean NEES, its band, and the ratio of sigmas of every block."""
    found = [r.errors for r in runs if r.errors is not None]
    nees = float(np.mean([e.nees for e in found]))
    half_width = BAND * np.sqrt(2 * PARAMETERS / len(found))
    by_block = ratios(found)
    iterations = np.mean([r.iterations for r in runs])
    print(f"\n{title}: {len(found)} of {len(runs)} recordings, {iterations:.1f} iterations")
    print(f"  NEES {nees:.2f}, 99.9 % band {PARAMETERS} +- {half_width:.2f}")
    for block, ratio in by_block.items():
        print(f"  {block:28} empirical / predicted sigma {ratio:.3f}")
    return nees, half_width, by_block


@pytest.mark.parametrize(("motion", "imu"), CASES)
def test_errors_are_what_the_covariance_says(motion, imu):
    runs = consistent_runs(motion, imu)
    assert [r.failure for r in runs if r.failure] == []
    assert all(r.converged for r in runs)
    nees, half_width, _ = table(f"{motion}, {imu}", runs)
    assert abs(nees - PARAMETERS) < half_width


def test_errors_of_all_are_what_the_covariance_says():
    runs = [r for motion, imu in CASES for r in consistent_runs(motion, imu)]
    nees, half_width, by_block = table("all", runs)
    assert abs(nees - PARAMETERS) < half_width
    # The time shift alone, one scalar of 400 recordings, leaves its ratio open by 3.5 %: the band is four times that.
    widest = 0.15 if SHARE >= 1 else 0.15 / np.sqrt(SHARE)
    assert all(1 - widest < ratio < 1 + widest for ratio in by_block.values()), by_block
    z = np.array([r.errors.z for r in runs])
    assert np.abs(z.mean(axis=0) * np.sqrt(len(z))).max() < 4.5  # none of 33 is systematically off
    assert np.abs(z).max() < 5.5


def test_hard_recordings_do_not_fail():
    runs = calibrated(HARD, range(2000, 2000 + 2 * EACH))
    table("random rig, late and missing frames", runs)
    print("  verdicts", {v: sum(r.verdict == v for r in runs) for v in ("pass", "warn", "fail", "none")})
    print("  findings", sorted({code for r in runs for code in r.findings}))
    assert [(r.seed, r.failure) for r in runs if r.failure] == []
    assert [r.seed for r in runs if not r.converged or r.verdict == "fail"] == []
    worst = {r.seed: round(float(np.abs(r.errors.z).max()), 1) for r in runs}
    assert max(worst.values()) < 6, {seed: z for seed, z in worst.items() if z >= 6}
    nees = [r.errors.nees for r in runs]
    assert np.mean(nees) < 1.25 * PARAMETERS
    # One of 200 was seen to have 131 (its z stay below 6): about one in a hundred may hide a fault that was not found.
    assert np.mean(np.array(nees) > 3 * PARAMETERS) <= 0.01


@pytest.mark.parametrize(("motion", "imu"), CASES)
def test_sigmas_reach_the_cramer_rao_bound(motion, imu):
    simulation = simulate_camera_imu(CameraImuScenario(duration_s=40.0, motion=motion, imu=imu), seed=1)
    result = calibrate_camera_imu(simulation.recording, simulation.target, OPTIONS)
    bound = cramer_rao_sigma(
        simulation, OPTIONS, result.diagnostics.gravity_plane, result.calibration.imus["imu0"].origin
    )
    found = errors(result, simulation)
    by_name = {name: sigma / bound[name] for name, sigma in zip(found.names, found.sigma, strict=True)}
    print(f"\n{motion}, {imu}: sigma over the bound {min(by_name.values()):.3f} to {max(by_name.values()):.3f}")
    assert len(by_name) == PARAMETERS
    assert all(0.95 < ratio < 1.05 for ratio in by_name.values()), by_name
