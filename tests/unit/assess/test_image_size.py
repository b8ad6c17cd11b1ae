"""Lenses that are stated for images of another size, in all of a recording or in a part of it."""

from dataclasses import replace

import numpy as np
import pytest

from gnomon import CameraImuScenario, calibrate_camera_imu, simulate_camera_imu
from gnomon.assess.checks.rig_doctor import check_corners
from gnomon.errors import RecordingError


@pytest.fixture(scope="module")
def simulation():
    return simulate_camera_imu(CameraImuScenario(duration_s=10.0, random_extrinsics=True), 9420)


def with_camera(recording, **changes):
    frames = recording.cameras["cam0"]
    return replace(recording, cameras={"cam0": replace(frames, camera=replace(frames.camera, **changes))})


def told(recording, target):
    return [one.message for one in check_corners(recording, target) if one.code == "image-size"]


@pytest.mark.parametrize(("times", "size"), [(2.0, "1280 x 960"), (4 / 3, "853 x 640"), (0.8, "512 x 384")])
def test_a_lens_for_another_size_is_named_before_the_estimation(simulation, times, size) -> None:
    camera = simulation.recording.cameras["cam0"].camera
    intrinsics = camera.intrinsics.copy()
    intrinsics[-4:-2] *= times
    intrinsics[-2:] = (intrinsics[-2:] + 0.5) * times - 0.5
    resolution = tuple(round(times * pixels) for pixels in camera.resolution)
    recording = with_camera(simulation.recording, intrinsics=intrinsics, resolution=resolution)
    (message,) = told(recording, simulation.target)
    assert f"is stated for images of {size} px" in message
    assert "of images of about 640 x 480 px" in message
    with pytest.raises(RecordingError, match="is stated for images of"):
        calibrate_camera_imu(recording, simulation.target)


@pytest.mark.parametrize(("times", "from_s", "size"), [(0.5, 6.0, "320 x 240"), (2 / 3, 2.5, "427 x 320")])
def test_images_that_change_their_size_are_named(simulation, times, from_s, size) -> None:
    frames = simulation.recording.cameras["cam0"]
    later = (frames.t_ns[frames.frame] - frames.t_ns[0]) * 1e-9 > from_s
    pixels = np.where(later[:, None], (frames.pixels + 0.5) * times - 0.5, frames.pixels)
    recording = replace(simulation.recording, cameras={"cam0": replace(frames, pixels=pixels)})
    (message,) = told(recording, simulation.target)
    assert f"of about {size} px" in message
    assert from_s <= float(message.partition("first ")[2].split()[0]) < from_s + 1
    share = float(message.partition("at least ")[2].split()[0]) / 100
    assert 0.1 < share < 1.05 - from_s / 10  # a small board seen from straight ahead looks alike in both


@pytest.mark.parametrize("wrong", ["nothing", "distortion left out", "distortion mirrored", "focal length"])
def test_other_errors_of_a_lens_are_not_taken_for_it(simulation, wrong) -> None:
    camera = simulation.recording.cameras["cam0"].camera
    changes = {
        "nothing": {},
        "distortion left out": {"distortion": "none", "distortion_coeffs": np.zeros(0)},
        "distortion mirrored": {"distortion_coeffs": -camera.distortion_coeffs},
        "focal length": {"intrinsics": camera.intrinsics * [1.1, 1.1, 1, 1]},
    }[wrong]
    assert told(with_camera(simulation.recording, **changes), simulation.target) == []
