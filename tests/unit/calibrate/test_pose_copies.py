"""A pose that is in a table twice, under another name, counts once."""

import numpy as np
import pytest

from gnomon.calibrate.steps.pose_preparation import prepare_poses
from gnomon.options import ImuOptions
from gnomon.recording import Poses, Recording


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
