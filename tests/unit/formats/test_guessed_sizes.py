"""A size of the image that no file states is not told as a fact where calibrations are compared."""

from dataclasses import replace

import numpy as np
import pytest

import gnomon
from gnomon.formats.foreign_files import load_foreign


@pytest.fixture
def kalibr(camera_imu_case, tmp_path):
    """Kalibr's results alone, which hold no size of the image, and gnomon's result, whose lens is another one."""
    result, recording, target = camera_imu_case()
    gnomon.save_camera_imu_files(result, recording, target, tmp_path)
    calibration = result.calibration
    camera = calibration.cameras["cam0"].camera
    moved = replace(camera, intrinsics=camera.intrinsics + np.array([4.0, 4.0, 0.0, 0.0]))
    cameras = {**calibration.cameras, "cam0": replace(calibration.cameras["cam0"], camera=moved)}
    return tmp_path, replace(calibration, cameras=cameras)


def lens_words(comparison):
    return [finding.message for finding in comparison.findings if finding.code == "lenses-differ"]


def test_a_guessed_size_is_no_difference(kalibr):
    place, calibration = kalibr
    alone = load_foreign(place / "results-imucam.txt")
    assert alone.guessed_sizes == set(alone.cameras)
    guessed = alone.cameras["cam0"].camera.resolution
    assert guessed != calibration.cameras["cam0"].camera.resolution
    for pair in ((calibration, alone), (alone, calibration)):
        (words,) = lens_words(gnomon.compare(*pair))
        assert "resolutions" not in words
        assert "{}x{}".format(*guessed) not in words


def test_a_stated_size_is(kalibr):
    place, calibration = kalibr
    chain = load_foreign(place / "camchain-imucam.yaml")
    assert chain.guessed_sizes == frozenset()
    camera = calibration.cameras["cam0"]
    larger = replace(camera, camera=replace(camera.camera, resolution=(1000, 900)))
    (words,) = lens_words(gnomon.compare(replace(calibration, cameras={"cam0": larger}), chain))
    assert "1000x900" in words


def test_a_file_that_states_the_size_tells_it_for_one_that_does_not(kalibr):
    place, _ = kalibr
    both = load_foreign(place / "results-imucam.txt", place / "camchain-imucam.yaml")
    assert both.guessed_sizes == frozenset()
