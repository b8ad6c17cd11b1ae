"""Simulated recordings in every form: folder, EuRoC, ROS bags, MCAP; with their truth, of every board."""

import shutil

import numpy as np
import pytest

import gnomon
from gnomon import CameraImuScenario, simulate_camera_imu
from gnomon.cli import main
from gnomon.detect.boards.worker import make_detector
from gnomon.readers.images.image_recording import open_images
from gnomon.simulate.cameras import CamerasScenario, simulate_cameras
from gnomon.simulate.images.board_images import rendered_cameras, simulated_images

FORMS = {"folder": ".", "euroc": ".", "ros1": "recording.bag", "ros2": "recording", "mcap": "recording.mcap"}
LENS = {"resolution": (320, 240), "intrinsics": (195.0, 194.0, 161.2, 118.5)}
"""Of small images: what is written and read back does not depend on their size."""
SMALL = ["--resolution", "320", "240", "--intrinsics", *map(str, LENS["intrinsics"])]
BOARDS = {
    "aprilgrid": (),
    "checkerboard": ("--target-cols", "7", "--target-size-m", "0.06"),
    "circlegrid": ("--target-cols", "4", "--target-rows", "9", "--target-size-m", "0.05", "--target-asymmetric"),
    "charuco": ("--target-cols", "7", "--target-rows", "6", "--target-size-m", "0.07"),
}


def same_images(recording, expected):
    assert set(recording.streams) == set(expected.streams)
    for name, stream in recording.streams.items():
        for written, rendered in zip(stream.frames([]), expected.streams[name].frames([]), strict=True):
            assert written.t_ns == rendered.t_ns
            np.testing.assert_array_equal(written.decode(), rendered.decode())


@pytest.mark.parametrize("form", FORMS)
def test_cameras_and_an_imu_read_back_from_every_form(tmp_path, form, capsys):
    folder = tmp_path / "walk"
    options = ["--images", "--duration-s", "1", "--camera-rate-hz", "3", "--exposure-s", "0", "--seed", "4", *SMALL]
    assert main(["simulate", "camera-imu", "-o", str(folder), "--form", form, *options]) == 0
    scenario = CameraImuScenario(duration_s=1.0, camera_rate_hz=3.0, images=True, exposure_s=0.0, **LENS)
    simulation = simulate_camera_imu(scenario, seed=4)
    recording = open_images(folder / FORMS[form])
    same_images(recording, simulated_images(simulation))
    expected, found = simulation.recording.imus["imu0"], recording.imus["imu0"]
    np.testing.assert_array_equal(found.gyroscope.t_ns, expected.gyroscope.t_ns)
    np.testing.assert_array_equal(found.accelerometer.values, expected.accelerometer.values)
    truth = gnomon.load(folder / "truth.yaml")
    assert truth.cameras["cam0"].time_shift_cam_imu == simulation.truth.cameras["cam0"].time_shift_cam_imu
    capsys.readouterr()


@pytest.mark.first(2)
@pytest.mark.long
@pytest.mark.parametrize("form", FORMS)
def test_cameras_alone_read_back_from_every_form(tmp_path, form, capsys):
    folder = tmp_path / "views"
    options = ["--images", "--views", "3", "--cameras", "2", "--seed", "4", *SMALL]
    assert main(["simulate", "cameras", "-o", str(folder), "--form", form, *options]) == 0
    simulation = simulate_cameras(CamerasScenario(images=True, views=3, cameras=2, **LENS), seed=4)
    same_images(open_images(folder / FORMS[form], cameras_alone=True), rendered_cameras(simulation))
    truth = gnomon.load(folder / "truth.yaml")
    assert truth.frame == "cam0"
    np.testing.assert_array_equal(truth.cameras["cam1"].T_cam_body, simulation.truth.cameras["cam1"].T_cam_body)
    # another form takes its place, and the scenario says all but the seed
    scenario = shutil.copy(folder / "scenario.yaml", tmp_path)  # what is read is never written over
    again = [str(folder), "--scenario", str(scenario), "--seed", "5"]
    assert main(["simulate", "cameras", "-o", *again, "--form", "mcap" if form != "mcap" else "ros1"]) == 0
    assert len(list(folder.iterdir())) == 4
    capsys.readouterr()


@pytest.mark.parametrize("board", BOARDS)
def test_every_board_is_found_where_it_is(tmp_path, board):
    words = dict(zip(BOARDS[board][::2], BOARDS[board][1::2], strict=False))
    numbers = {name[2:].replace("-", "_"): float(value) for name, value in words.items() if not value.startswith("--")}
    changed = {name: int(value) if value >= 1 else value for name, value in numbers.items()}
    scenario = CamerasScenario(
        images=True, views=4, fill=(0.35, 0.55), spread=0.5, target_type=board,
        target_asymmetric="--target-asymmetric" in BOARDS[board],
        board_bow_m=(0.002, 0.0), board_aspect=1e-3, target_scale=1.01, **changed,
    )  # fmt: skip
    simulation = simulate_cameras(scenario, seed=2)
    (stream,) = rendered_cameras(simulation).streams.values()
    frames, truth, detect = (
        simulation.recording.cameras["cam0"],
        simulation.corners["cam0"],
        make_detector(simulation.target),
    )
    errors = []
    for k, frame in enumerate(stream.frames([])):
        view = detect(frame.decode())
        rows = frames.frame == k
        _, mine, true = np.intersect1d(view.point, frames.point[rows], return_indices=True)
        errors.append(view.pixels[mine] - truth.pixels[rows][true])
    errors = np.concatenate(errors)
    assert len(errors) >= 0.95 * len(frames.point)  # the board with its rim is inside the image
    assert np.sqrt(np.mean(errors**2)) < (0.05 if board == "circlegrid" else 0.03)


def test_a_form_is_one_of_images(tmp_path, capsys):
    for command in ("simulate-cameras", "simulate-camera-imu"):
        assert main([command, "-o", str(tmp_path / "x"), "--form", "mcap"]) == 2
        assert "--images" in capsys.readouterr().err
    assert not (tmp_path / "x").exists()
