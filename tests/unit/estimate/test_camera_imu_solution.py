"""When the batch estimation goes on, and when it gives up."""

from dataclasses import replace

import numpy as np
import pytest

from gnomon import CameraImuOptions, CameraImuScenario, calibrate_camera_imu, simulate_camera_imu
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
