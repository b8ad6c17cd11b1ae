"""A real board whose shape is forgotten: its corners as landmarks of an unknown scene, beside the board's result."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))
sys.path.insert(0, str(Path(__file__).parent))

from test_camera_imu_euroc import EUROC_CAMCHAIN, EUROC_IMU, EUROC_TARGET
from without_a_board import EUROC_PATHS, differences, forget_board, number_anew

import gnomon


@pytest.fixture(scope="module")
def known(real_data, tmp_path_factory):
    """Return cam0 and the IMU of EuRoC's recording, and their calibration with the board."""
    folder = tmp_path_factory.mktemp("stated")
    files = {}
    for name, text in (("cam", EUROC_CAMCHAIN), ("imu", EUROC_IMU), ("target", EUROC_TARGET)):
        files[name] = folder / f"{name}.yaml"
        files[name].write_text(text, encoding="utf-8")
    recording, board = gnomon.read_camera_imu(real_data("euroc-imu-april"), **files)
    alone = replace(recording, cameras={"cam0": recording.cameras["cam0"]})
    return alone, gnomon.calibrate_camera_imu(alone, board, gnomon.CameraImuOptions(model="full")).calibration


@pytest.mark.slow
@pytest.mark.parametrize("numbers", ["kept", "lost"])
def test_pose_and_gyroscope_are_those_of_the_board(known, numbers):
    """Within 3 combined sigmas, where corners keep their numbers and where each gets a new one out of sight."""
    recording, with_board = known
    frames, samples = recording.cameras["cam0"], recording.imus["imu0"]
    number = frames.point if numbers == "kept" else number_anew(frames)
    points, kept = forget_board(replace(frames, point=number), samples)
    seen = replace(
        frames, frame=frames.frame[kept], point=np.unique(number[kept], return_inverse=True)[1],
        pixels=frames.pixels[kept], sigma_px=None,
    )  # fmt: skip
    target, scene = gnomon.Target.landmarks(points), replace(recording, cameras={"cam0": seen})
    found = gnomon.calibrate_camera_imu(scene, target, gnomon.CameraImuOptions(model="full")).calibration
    off = [difference / sigma for path in EUROC_PATHS for sigma, difference in differences(with_board, found, path)]
    assert len(off) == 3 + 3 + 1 + 9
    assert np.abs(off).max() < 3
