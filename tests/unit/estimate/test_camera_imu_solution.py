"""When the batch estimation goes on, and when it gives up."""

from dataclasses import replace

import numpy as np
import pytest

from gnomon import CameraImuOptions, CameraImuScenario, calibrate_camera_imu, simulate_camera_imu
from gnomon.estimate.camera_imu import batch
from gnomon.estimate.camera_imu.gauss_newton import Iteration
from gnomon.estimate.camera_imu.solution import _stalled  # pyright: ignore[reportPrivateUsage]


def taken(costs: list[float], largest: float) -> list[Iteration]:
    return [Iteration(cost=cost, largest_step=largest, damping=0.0, accepted=True) for cost in costs]


@pytest.mark.parametrize(
    ("costs", "stalls"),
    [
        ([1e6] * 10, False),
        ([1e6] * 11, True),
        ([1e6 * 0.999**k for k in range(20)], True),
        ([1e6 * 0.9**k for k in range(20)], False),
    ],
    ids=["too early", "at one height", "hardly falling", "still going down"],
)
def test_steps_that_do_not_shrink_end_only_where_the_cost_does_not_fall(costs, stalls):
    assert _stalled(taken(costs, 150.0)) is stalls


def test_trials_that_were_not_taken_tell_nothing():
    missed = [Iteration(cost=1e6, largest_step=1.0, damping=0.0, accepted=False)] * 20
    assert not _stalled(taken([1e6] * 10, 150.0) + missed)


def test_steps_that_shrink_go_on():
    steps = [Iteration(cost=1e6, largest_step=100.0 * 0.5**k, damping=0.0, accepted=True) for k in range(20)]
    assert not _stalled(steps)


def test_images_delivered_twice_count_once():
    """A driver that delivers every tenth image again, with a timestamp of its own, while the rig moves on."""
    simulation = simulate_camera_imu(CameraImuScenario(duration_s=8.0), 3)
    recording = simulation.recording
    frames = recording.cameras["cam0"]
    parts = {int(k): np.flatnonzero(frames.frame == k) for k in np.unique(frames.frame)}
    sources = {k: parts[k - 1] if k % 10 == 5 and k - 1 in parts else rows for k, rows in parts.items()}
    rows = np.concatenate(list(sources.values()))
    copied = replace(
        frames,
        frame=np.repeat(list(sources), [len(one) for one in sources.values()]),
        point=frames.point[rows],
        pixels=frames.pixels[rows],
        sigma_px=None,
    )
    result = calibrate_camera_imu(
        replace(recording, cameras={"cam0": copied}), simulation.target, CameraImuOptions(gravity=9.80665)
    )
    calibration, path = result.calibration, "cam0.T_cam_imu.translation"
    assert "views-copied" in {finding.code for finding in calibration.assessment.findings}
    truth = simulation.truth.with_origin(calibration.imus["imu0"].origin)
    assert (np.abs(calibration.parameter(path) - truth.parameter(path)) < 4 * calibration.sigma(path)).all()


@pytest.mark.parametrize("walks", [(0.8, True), (1.3, False)], ids=["below the limit", "above it"])
def test_biases_that_bend_less_often_change_nothing_that_counts(walks, monkeypatch):
    """Where walks are as strong as they may be for it, against the noise of the readings."""
    times, tied = walks
    density = {"gyroscope": 1.7e-4, "accelerometer": 2e-3}
    stated = {f"{kind}_random_walk": 4 * times * value for kind, value in density.items()}  # 0.1 / (0.5 * 0.05 s)
    stated |= {f"{kind}_noise_density": value for kind, value in density.items()}
    simulation = simulate_camera_imu(CameraImuScenario(duration_s=8.0, **stated), 5)
    options = CameraImuOptions(gravity=9.80665, model="full", compare=True)
    found = []
    for limit in (batch._STRAYS, 0.0):  # pyright: ignore[reportPrivateUsage]
        monkeypatch.setattr(batch, "_STRAYS", limit)
        found.append(calibrate_camera_imu(simulation.recording, simulation.target, options))
    free = found[1].calibration
    paths = ("imu0.gyroscope.sensitivity", "imu0.accelerometer.sensitivity", "cam0.T_cam_imu.translation")
    sigmas = [np.sqrt(np.diag(one.calibration.uncertainty.matrix)) for one in found]
    some = sigmas[1] > 0
    ratio = sigmas[0][some] / sigmas[1][some]
    assert (ratio != 1.0).any() == tied
    np.testing.assert_allclose(ratio, 1.0, atol=0.01)
    for path in paths:
        off = np.abs(found[0].calibration.parameter(path) - free.parameter(path))
        assert (off <= 0.01 * free.sigma(path)).all()
    for name, track in found[1].diagnostics.biases.items():
        np.testing.assert_allclose(found[0].diagnostics.biases[name].sigma, track.sigma, rtol=0.1)
