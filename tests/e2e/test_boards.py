"""Recordings of every kind of board -> calibration: the truth is where the standard deviations say."""

import pytest

import gnomon
import recorded

BOARDS = {
    "charuco": {"target_type": "charuco", "target_cols": 8, "target_rows": 7, "target_size_m": 0.08},
    "circles": {"target_type": "circlegrid", "target_cols": 7, "target_rows": 6, "target_size_m": 0.08},
    "circles, shifted": {
        "target_type": "circlegrid",
        "target_cols": 4,
        "target_rows": 9,
        "target_size_m": 0.055,
        "target_asymmetric": True,
    },
}


@pytest.mark.first(2)
@pytest.mark.long
@pytest.mark.parametrize("board", BOARDS)
def test_the_truth_is_where_the_standard_deviations_say(board, run, walks, tmp_path):
    source = walks.rendered(**BOARDS[board])
    code, _, err = run("camera-imu", source, "-o", tmp_path, "--no-report", "--gravity", 9.80665)
    assert code == 0, err
    result, truth = gnomon.load(tmp_path / "calibration.yaml"), recorded.truth_of(source)
    assert recorded.most_sigmas(result, truth) < 4.5
    shift = result.cameras["cam0"].time_shift_cam_imu
    assert abs(shift - truth.cameras["cam0"].time_shift_cam_imu) < 50e-6
