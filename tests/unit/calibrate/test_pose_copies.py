"""A pose that is in a table twice, under another name, counts once; poses that were normalised do not."""

import numpy as np
import pytest

import gnomon
from gnomon.calibrate.steps.pose_preparation import prepare_poses
from gnomon.options import ImuOptions
from gnomon.recording import Poses, Recording
from gnomon.simulate import PoseScenario, simulate_poses


def table(means: np.ndarray) -> Recording:
    names = tuple(f"row {k}" for k in range(len(means)))
    poses = Poses(name=names, accelerometer=means, accelerometer_unit="m/s^2", t_s=np.arange(float(len(means))))
    return Recording(imus={}, cameras={}, poses=poses)


@pytest.mark.parametrize(("digits", "copies"), [(15, 2), (2, 0)])
def test_copies_are_left_out_unless_few_digits_make_them_alike(digits: int, copies: int) -> None:
    means = np.round(9.81 * np.random.default_rng(3).normal(size=(12, 3)), digits)
    means[[7, 11]] = means[[2, 2]]
    prepared = prepare_poses(table(means), ImuOptions())
    assert len(prepared.poses) == len(prepared.variance) == len(prepared.start_s) == 12 - copies
    reasons = [("row 7", "the same numbers as row 2"), ("row 11", "the same numbers as row 2")]
    assert list(prepared.left_out) == reasons[:copies]
    assert "row 7" not in prepared.poses.name or not copies


def test_poses_that_were_normalised_are_refused():
    """They are of an ideal sensor, whatever the true one is."""
    simulation = simulate_poses(PoseScenario(sensor="drawn", units="si", attitudes="sphere", poses=24), 5)
    force = simulation.accelerometer
    poses = Poses(
        name=tuple(map(str, range(len(force)))),
        accelerometer=np.round(9.80665 * force / np.linalg.norm(force, axis=1, keepdims=True), 6),
        accelerometer_unit="m/s^2",
        accelerometer_sigma=np.full(force.shape, 2e-3),
    )
    with pytest.raises(gnomon.RecordingError, match="It was normalised"):
        gnomon.calibrate_imu(Recording(imus={}, poses=poses))
