"""Simulated recordings as images: the board is where the simulation says, and the folder reads back."""

from dataclasses import replace

import numpy as np
import pytest

from gnomon import CameraImuScenario, simulate_camera_imu
from gnomon.cli import main
from gnomon.detect.boards.aprilgrid import detect_aprilgrid
from gnomon.detect.boards.checkerboard import detect_checkerboard
from gnomon.readers.images.image_recording import open_images
from gnomon.simulate.images.board_images import simulated_images
from gnomon.writers.simulated_cameras import save_camera_imu_recording

BASE = CameraImuScenario(duration_s=1.0, camera_rate_hz=5.0, images=True, exposure_s=0.005, image_noise=1.0)
LENSES = {
    "rolling shutter": {"line_delay_s": 3e-5},
    "omni": {
        "projection": "omni",
        "intrinsics": (1.2, 800.0, 800.0, 320.0, 240.0),
        "distortion_coeffs": (-0.05, 0.02, 0.0, 0.0),
    },
    "double sphere": {
        "projection": "ds",
        "intrinsics": (-0.2, 0.55, 300.0, 300.0, 320.0, 240.0),
        "distortion": "none",
        "distortion_coeffs": (),
        "distance_m": 0.5,
    },
    "two cameras, larger board": {"cameras": 2, "target_scale": 1.05, "clock_offset_s": 5.0},
    "clutter": {"image_clutter": True},
    "checkerboard": {"target_type": "checkerboard", "target_cols": 7, "target_size_m": 0.06},
}


@pytest.mark.parametrize("lens", LENSES)
def test_corners_are_detected_where_they_truly_are(lens):
    simulation = simulate_camera_imu(replace(BASE, **LENSES[lens]), seed=3)
    detect = detect_checkerboard if lens == "checkerboard" else detect_aprilgrid
    for name, stream in simulated_images(simulation).streams.items():
        recorded, truth = simulation.recording.cameras[name], simulation.frames[name]
        errors = []
        for k, frame in enumerate(stream.frames([])):
            assert frame.t_ns == recorded.t_ns[k]
            view = detect(frame.decode(), simulation.target)
            rows = recorded.frame == k
            _, mine, true = np.intersect1d(view.point, recorded.point[rows], return_indices=True)
            errors.append(view.pixels[mine] - truth.pixels[rows][true])
        errors = np.concatenate(errors)
        assert len(errors) > 0.95 * len(recorded.point)
        assert np.sqrt(np.mean(errors**2)) < 0.01  # a shift of the timestamps by 1 ms would be 0.3 px and more
        assert np.abs(errors.mean(axis=0)).max() < 0.002


def test_a_folder_of_images_reads_back_and_is_replaced_by_the_next(tmp_path, capsys):
    options = ["--duration-s", "1", "--camera-rate-hz", "6", "--images", "--blur-px", "0.8", "--seed", "4"]
    folder = tmp_path / "walk"
    assert main(["simulate", "camera-imu", "-o", str(folder), "--cameras", "2", *options]) == 0
    assert "6 frames of cam0" in capsys.readouterr().out
    assert not list(folder.glob("*corners*"))
    scenario = replace(
        BASE, duration_s=1.0, camera_rate_hz=6.0, exposure_s=0.004, image_noise=2.0, blur_px=0.8, cameras=2
    )
    expected = simulated_images(simulate_camera_imu(scenario, seed=4)).streams
    recording = open_images(folder)
    assert set(recording.streams) == {"cam0", "cam1"}
    for name, stream in recording.streams.items():
        pairs = zip(stream.frames([]), expected[name].frames([]), strict=True)
        for written, rendered in pairs:
            assert written.t_ns == rendered.t_ns
            np.testing.assert_array_equal(written.decode(), rendered.decode())
    assert len(recording.imus["imu0"].gyroscope.t_ns) == 201

    assert main(["simulate", "camera-imu", "-o", str(folder), *options[:2], "--images", "--camera-rate-hz", "3"]) == 0
    assert not (folder / "cam1").exists()
    assert len(list((folder / "cam0" / "data").iterdir())) == 3
    assert main(["simulate", "camera-imu", "-o", str(folder), *options[:4]]) == 0
    assert not (folder / "cam0").exists()
    assert (folder / "cam0_corners.csv.gz").exists()


def test_images_of_a_person_are_not_replaced(tmp_path, capsys):
    (tmp_path / "cam0" / "data").mkdir(parents=True)
    assert main(["simulate", "camera-imu", "-o", str(tmp_path), "--duration-s", "1", "--images"]) == 3
    assert "not simulated" in capsys.readouterr().err
    assert (tmp_path / "cam0" / "data").is_dir()


def test_saving_again_into_the_same_folder_gives_the_same_bytes(tmp_path):
    simulation = simulate_camera_imu(BASE, seed=1)
    bytes_of = {}
    for run in range(2):
        save_camera_imu_recording(simulation, tmp_path)
        bytes_of[run] = {path.name: path.read_bytes() for path in sorted(tmp_path.rglob("*")) if path.is_file()}
    assert bytes_of[0] == bytes_of[1]
    assert sum(name.endswith(".png") for name in bytes_of[0]) == 5
