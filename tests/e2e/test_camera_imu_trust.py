"""Sigmas from clusters of time: right for white noise, and for what the ordinary ones are not.

`pytest tests/e2e/test_camera_imu_trust.py -m slow -s` prints the tables; some minutes on two cores. Fewer runs:
`GNOMON_STUDY=0.1` takes a tenth.
"""

import multiprocessing
import os
import site
import sys
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import cache
from itertools import repeat
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[1]))

from camera_imu_trust import judged, rms_by_block, trusted
from gnomon import CameraImuOptions, CameraImuScenario, calibrate_camera_imu, simulate_camera_imu
from gnomon.estimate.camera_imu.result.publish import recording_trust
from gnomon.estimate.trust.clusters import part_estimates
from gnomon.results.calibration import covariance_names

OPTIONS = CameraImuOptions(gravity=9.80665, model="full")
SHARE = float(os.environ.get("GNOMON_STUDY", "1"))
CASES = [(motion, imu) for motion in ("gentle", "normal") for imu in ("thesis", "consumer")]
EACH = max(2, round(50 * SHARE))


def together(found, of):
    return float(np.sqrt(np.mean(np.concatenate([getattr(one, of) for one in found]) ** 2)))


@cache
def some():
    return tuple(trusted(CameraImuScenario(duration_s=30.0), OPTIONS, seed) for seed in range(6))


@pytest.mark.long
def test_white_noise_leaves_the_sigmas_as_they_are():
    found = some()
    ratio = np.array([one.sigma / one.ordinary for one in found])
    assert ratio.min() > 0.95  # no variance is smaller, but what is published combines several
    assert np.median(ratio) < 1.1
    assert ratio.max() < 2
    assert 0.85 < together(found, "z") < 1.1
    assert not any("model-incomplete" in one.codes or "parts-disagree" in one.codes for one in found)


@pytest.mark.slow
def test_parts_agree_where_nothing_changed():
    found = some()
    assert all(one.splits.splits == ("halves", "thirds") for one in found)
    z = np.sqrt(np.mean([one.splits.z_rms**2 for one in found]))
    assert 0.75 < z < 1.2
    assert all(one.splits.z_rms < one.splits.limit < 1.5 for one in found)
    assert all(one.clusters.count >= 9 and one.clusters.length_s >= 1 for one in found)


def test_a_part_estimated_in_one_step_is_that_part_calibrated_anew(monkeypatch):
    simulation = simulate_camera_imu(CameraImuScenario(duration_s=30.0), seed=3)
    whole = {}

    def kept(result, found):
        whole.setdefault("found", (result, found))
        return recording_trust(result, found)

    monkeypatch.setattr("gnomon.calibrate.camera_imu.recording_trust", kept)
    estimate = calibrate_camera_imu(simulation.recording, simulation.target, OPTIONS)
    result, found = whole["found"]
    stretches = found.by_time.stretches
    steps, _ = part_estimates(stretches, np.floor(2 * np.arange(len(stretches)) / len(stretches)).astype(int))
    foretold = result.jacobian @ found.by_time.scalars @ steps.T
    names = np.array(covariance_names(result.imus, result.cameras))
    for half in (0, 1):
        anew = calibrate_camera_imu(_half(simulation.recording, half), simulation.target, OPTIONS)
        of = judged(anew, estimate.calibration)
        index = [names.tolist().index(name) for name in anew.diagnostics.trust.names]
        compared = np.array([not block.endswith(".bias") for block in of.blocks])
        difference = (of.error - foretold[index, half]) / of.sigma
        assert np.sqrt(np.mean(of.z[compared] ** 2)) > 0.4
        assert np.sqrt(np.mean(difference[compared] ** 2)) < 0.2


def _half(recording, number):
    """Return the first or second half of a recording of one camera and one IMU."""
    frames, samples = recording.cameras["cam0"], recording.imus["imu0"]
    middle = int(frames.t_ns.mean())

    def inside(t_ns, margin_ns):
        return t_ns < middle + margin_ns if number == 0 else t_ns > middle - margin_ns

    def cut(triad):
        keep = inside(triad.t_ns, 300_000_000)
        return replace(triad, t_ns=triad.t_ns[keep], values=triad.values[keep])

    keep = inside(frames.t_ns, 0)
    corners = keep[frames.frame]
    frames = replace(
        frames,
        t_ns=frames.t_ns[keep],
        frame=(np.cumsum(keep) - 1)[frames.frame[corners]],
        point=frames.point[corners],
        pixels=frames.pixels[corners],
    )
    samples = replace(samples, accelerometer=cut(samples.accelerometer), gyroscope=cut(samples.gyroscope))
    return replace(recording, imus={"imu0": samples}, cameras={"cam0": frames})


def runs(cases):
    """Return the runs of all seeds, by two processes."""
    workers = ProcessPoolExecutor(
        max_workers=2,
        mp_context=multiprocessing.get_context("spawn"),
        initializer=site.addsitedir,  # so that they find `trusted`
        initargs=(str(Path(__file__).parents[1]),),
    )
    scenarios = [
        CameraImuScenario(duration_s=40.0, motion=motion, imu=imu) for motion, imu in cases for _ in range(EACH)
    ]
    with workers:
        return list(workers.map(trusted, scenarios, repeat(OPTIONS), range(5000, 5000 + len(scenarios)), chunksize=2))


@pytest.mark.slow
def test_study_of_white_noise():
    found = runs(CASES)
    robust, ordinary = rms_by_block(found, "z"), rms_by_block(found, "z_ordinary")
    whole = together(found, "z"), together(found, "z_ordinary")
    print(f"\n{len(found)} recordings of 40 s: z rms {whole[0]:.3f}, ordinary {whole[1]:.3f}")
    for block, z in robust.items():
        print(f"  {block:34} {z:.3f}   ordinary {ordinary[block]:.3f}")
    pooled = np.sqrt(np.mean([[one.splits.z_rms**2, one.splits.z_rms_ordinary**2] for one in found], axis=0))
    alarms = {code: sum(code in one.codes for one in found) for code in ("model-incomplete", "parts-disagree")}
    print(f"  halves and thirds {pooled[0]:.3f}, ordinary {pooled[1]:.3f}; findings {alarms}")
    tolerance = 0.3 / np.sqrt(len(found) / 20)  # of the sample, beyond the band that is asked for
    assert 0.95 - tolerance / 3 < whole[0] < 1.1
    assert all(0.95 - tolerance < z < 1.1 + tolerance for z in robust.values())
    assert alarms["model-incomplete"] <= 0.01 * len(found)
    assert alarms["parts-disagree"] <= 0.04 * len(found)


@pytest.mark.long
@pytest.mark.parametrize(("swing_s", "told"), [(0.0, False), (3e-3, True)])
def test_stamps_that_wander_with_the_exposure_are_told(swing_s, told):
    """The mean of the time shift is right, but no single image has it."""
    simulation = simulate_camera_imu(CameraImuScenario(duration_s=16.0), seed=3)
    frames = simulation.recording.cameras["cam0"]
    t_s = (frames.t_ns - frames.t_ns[0]) * 1e-9
    late_ns = np.rint(0.5e9 * swing_s * np.sin(2 * np.pi * t_s / 5.0)).astype(np.int64)
    moved = replace(simulation.recording, cameras={"cam0": replace(frames, t_ns=frames.t_ns + late_ns)})
    found = calibrate_camera_imu(moved, simulation.target, CameraImuOptions(compare=False)).calibration
    assert ("time-shift-varies" in {finding.code for finding in found.assessment.findings}) == told
