"""Simulated camera-IMU recordings as folders: read back as they were, truth and scenario beside them."""

from dataclasses import replace

import numpy as np
import pytest

from gnomon import CameraImuScenario, FormatError, OutputError, Scenario, load, read_camera_imu, simulate_camera_imu
from gnomon.formats.own.dataclass_file import options_text, read_options
from gnomon.writers.simulated_cameras import save_camera_imu_recording

BASE = CameraImuScenario(duration_s=3.0, random_extrinsics=True, motion="shaky", distance_m=0.6)
RICH = replace(
    BASE, cameras=2, line_delay_s=2e-5, dropped_frames=0.2, clock_offset_s=-77.25, imu_gaps_s=((1.0, 0.25), (2.0, 0.5)),
    time_shift_range_s=1.0, earth_rate_latitude=47.5, trajectory_seed=3, imu="thesis",
)  # fmt: skip
BOARDS = (
    {},
    {"target_type": "checkerboard", "target_cols": 7, "target_size_m": 0.05},
    {"target_type": "circlegrid", "target_cols": 4, "target_rows": 9, "target_size_m": 0.03, "target_asymmetric": True},
)


def read_back(folder):
    return read_camera_imu(
        folder, cam=folder / "camchain.yaml", imu=folder / "imu.yaml", target=folder / "target.yaml"
    )  # fmt: skip


@pytest.mark.parametrize("scenario", [RICH, *(replace(BASE, **board) for board in BOARDS)])
def test_a_recording_reads_back_bit_by_bit(scenario, tmp_path):
    simulation = simulate_camera_imu(scenario, seed=2)
    files = save_camera_imu_recording(simulation, tmp_path / "new" / "folder")
    assert all(path.is_file() for path in files)
    recording, target = read_back(tmp_path / "new" / "folder")
    np.testing.assert_array_equal(target.points, simulation.target.points)
    assert set(recording.cameras) == set(simulation.recording.cameras)
    for name, frames in simulation.recording.cameras.items():
        assert len(frames.point) > 500
        for field in ("t_ns", "frame", "point", "pixels"):
            np.testing.assert_array_equal(getattr(recording.cameras[name], field), getattr(frames, field))
        camera = recording.cameras[name].camera
        np.testing.assert_array_equal(camera.parameters, frames.camera.parameters)
        assert (camera.model, camera.resolution, camera.line_delay_s, camera.topic) == (
            frames.camera.model, frames.camera.resolution, frames.camera.line_delay_s, frames.camera.topic,
        )  # fmt: skip
        assert recording.cameras[name].T_cam_imu is None
    mine, theirs = simulation.recording.imus["imu0"], recording.imus["imu0"]
    for triad in ("accelerometer", "gyroscope"):
        np.testing.assert_array_equal(getattr(theirs, triad).t_ns, getattr(mine, triad).t_ns)
        np.testing.assert_array_equal(getattr(theirs, triad).values, getattr(mine, triad).values)
    assert (theirs.noise, theirs.topic) == (mine.noise, mine.topic)


def test_truth_path_and_scenario_stand_beside_it(tmp_path):
    simulation = simulate_camera_imu(RICH, seed=2)
    save_camera_imu_recording(simulation, tmp_path)
    truth = load(tmp_path / "truth.yaml")
    for path in ("imu0.gyroscope.sensitivity", "cam1.T_cam_imu.translation", "cam0.time_shift_cam_imu"):
        np.testing.assert_allclose(truth.parameter(path), simulation.truth.parameter(path), rtol=0, atol=1e-15)
    rows = np.loadtxt(tmp_path / "groundtruth.txt")
    np.testing.assert_allclose(rows[:, 1:4], simulation.trajectory.p_target_imu, atol=1e-9)
    x, y, z, w = rows[100, 4:]  # x axis of the IMU in the target's frame
    axis = [1 - 2 * (y * y + z * z), 2 * (x * y + z * w), 2 * (x * z - y * w)]
    np.testing.assert_allclose(simulation.trajectory.R_target_imu[100, :, 0], axis, atol=1e-11)
    assert read_options(tmp_path / "scenario.yaml", CameraImuScenario) == RICH
    assert "seed 2" in (tmp_path / "scenario.yaml").read_text()


def test_a_second_run_writes_the_same_bytes_and_leaves_no_camera_behind(tmp_path):
    first = save_camera_imu_recording(simulate_camera_imu(RICH, seed=2), tmp_path)
    before = [path.read_bytes() for path in first]
    again = save_camera_imu_recording(simulate_camera_imu(RICH, seed=2), tmp_path)
    assert [path.read_bytes() for path in again] == before
    save_camera_imu_recording(simulate_camera_imu(replace(RICH, cameras=1), seed=2), tmp_path)
    assert not list(tmp_path.glob("cam1*"))
    assert list(read_back(tmp_path)[0].cameras) == ["cam0"]


def test_a_place_that_cannot_be_written_is_said(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="cannot be made"):
        save_camera_imu_recording(simulate_camera_imu(BASE), tmp_path / "file" / "folder")


@pytest.mark.parametrize("options", [CameraImuScenario(), RICH, Scenario(), Scenario(hold_s=(1.0, 2.0), intervals=12)])
def test_options_read_back_as_they_were(options, tmp_path):
    path = tmp_path / "options.yaml"
    path.write_text(options_text(options))
    assert read_options(path, type(options)) == options


def test_what_a_scenario_file_does_not_say_keeps_its_default(tmp_path):
    path = tmp_path / "scenario.yaml"
    path.write_text("duration_s: 90\nmotion: gentle\nimu_gaps_s: [[1, 2]]\nline_delay_s: 2e-5\n")
    expected = replace(
        CameraImuScenario(), duration_s=90.0, motion="gentle", imu_gaps_s=((1.0, 2.0),), line_delay_s=2e-5
    )
    assert read_options(path, CameraImuScenario) == expected


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("duration: 90", r"scenario.yaml: duration: unknown key. Did you mean duration_s\?"),
        ("duration_s: long", 'duration_s: found the text "long", expected a number'),
        ("motion: gentel", r'motion: found "gentel". Did you mean gentle\?'),
        ("cameras: 3", "cameras: found 3, expected 1 or 2"),
        ("cameras: [1]", "cameras: found a list, expected a whole number"),
        ("known_line_delay: 1", "known_line_delay: found 1, expected true or false"),
        ("resolution: [640]", "resolution: found 1 values, expected 2"),
        ("resolution: [640, 480.5]", r"resolution\[1\]: found 480.5, expected a whole number"),
        ("imu_gaps_s: [[1, 2, 3]]", r"imu_gaps_s\[0\]: found 3 values, expected 2"),
        ("imu_gaps_s: 1", "imu_gaps_s: found 1, expected a list"),
        ("time_shift_s: null", "time_shift_s: found nothing, expected a number"),
        ("duration_s: -1", "scenario.yaml: duration_s -1 is out of range. Give a number from 0.001"),
        ("- 1", "found a list, expected keys and values"),
    ],
)
def test_errors_in_a_scenario_file_name_the_key(text, message, tmp_path):
    path = tmp_path / "scenario.yaml"
    path.write_text(text)
    with pytest.raises(FormatError, match=message):
        read_options(path, CameraImuScenario)
