"""Cameras and an IMU calibrated in a rendered room, without a board; and rooms in which that is refused."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import gnomon
from gnomon.calibrate.steps import landmark_map
from gnomon.calibrate.steps.camera_imu_reading import _mapped
from gnomon.calibrate.steps.landmark_map import map_landmarks
from gnomon.errors import DetectionError, InitialisationError, RecordingError
from gnomon.formats.kalibr.camchain import CameraInput
from gnomon.recording import Recording
from gnomon.simulate import RoomScenario, simulate_camera_imu
from gnomon.simulate.images.room_images import room_images

SMALL = RoomScenario(
    duration_s=12.0, resolution=(400, 300), intrinsics=(290.0, 289.0, 201.4, 148.1), camera_rate_hz=15.0, exposure_s=0.0
)


def decoded_once(stream):
    """Return images that are rendered once: they are asked for four times."""
    pictures = list(stream.frames([]))
    decoded = [frame.decode() for frame in pictures]
    kept = [replace(frame, decode=lambda image=image: image) for frame, image in zip(pictures, decoded, strict=True)]
    return replace(stream, frames=lambda _: iter(kept))


def mapped(scenario, seed=5):
    """Return what is true, and landmarks and frames of a rendered recording."""
    simulation = simulate_camera_imu(scenario.rig(), seed)
    images = room_images(scenario, simulation)
    samples = images.imus["imu0"]
    streams = {name: decoded_once(stream) for name, stream in images.streams.items()}
    cameras = simulation.truth.cameras
    near = np.array([[1.0, 0.01, 0.0, 0.003], [-0.01, 1.0, 0.005, 0.0], [0.0, -0.005, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
    unstated = {
        name: CameraInput(
            camera=replace(camera.camera, line_delay_s=0.0),
            T_cam_cam0=near @ camera.T_cam_imu @ np.linalg.inv(cameras["cam0"].T_cam_imu)
            if name != "cam0"
            else np.eye(4),
        )
        for name, camera in cameras.items()
    }
    frames, target, findings = map_landmarks(streams, unstated, samples, lambda _: None)
    return simulation, Recording(imus={"imu0": samples}, cameras=frames, findings=findings), target


@pytest.mark.long
def test_a_room_calibrates_as_a_board_does():
    simulation, recording, target = mapped(SMALL)
    assert target.kind == "landmarks"
    assert not recording.findings
    result = gnomon.calibrate_camera_imu(recording, target)
    calibration, truth = result.calibration, simulation.truth.cameras["cam0"]
    assert calibration.verdict != "fail"
    found = calibration.cameras["cam0"]
    sigma = dict(zip(calibration.uncertainty.names, np.sqrt(np.diag(calibration.uncertainty.matrix)), strict=True))
    for axis in range(3):
        own = sigma[f"cam0.T_cam_imu.translation[{axis}]"]
        assert own < 2e-3
        assert abs(found.T_cam_imu[axis, 3] - truth.T_cam_imu[axis, 3]) < 4 * own
    shift = abs(found.time_shift_cam_imu - truth.time_shift_cam_imu)
    assert shift < 4 * sigma["cam0.time_shift_cam_imu"] < 4e-4
    assert "scene-size" in {finding.code for finding in calibration.assessment.findings}


@pytest.mark.slow
def test_a_rolling_shutter_that_nobody_stated_is_found_by_the_landmarks():
    simulation, recording, target = mapped(replace(SMALL, line_delay_s=4e-5))
    calibration = gnomon.calibrate_camera_imu(recording, target).calibration
    (told,) = [finding for finding in calibration.assessment.findings if finding.code == "rolling-shutter"]
    assert told.subject == "cam0.line_delay"
    found = calibration.cameras["cam0"]
    assert found.camera.line_delay_s == pytest.approx(4e-5, abs=4 * calibration.sigma("cam0.line_delay"))
    shift = found.time_shift_cam_imu - simulation.truth.cameras["cam0"].time_shift_cam_imu
    assert abs(shift) < 4 * calibration.sigma("cam0.time_shift_cam_imu") < 4e-4


def test_a_rig_at_rest_is_refused():
    with pytest.raises(DetectionError, match="hardly anything moves"):
        mapped(replace(SMALL, motion="static", duration_s=1.0))


def test_painted_walls_are_refused():
    with pytest.raises(DetectionError, match="can be followed"):
        mapped(replace(SMALL, surface="plain", furniture=0, duration_s=1.0))


def test_a_rig_that_never_turned_is_refused():
    with pytest.raises(InitialisationError, match="do not show the same rotation"):
        mapped(replace(SMALL, motion="translation", duration_s=2.0))


def test_a_rig_that_hardly_moved_is_refused():
    with pytest.raises(InitialisationError, match="hardly moved from its place"):
        mapped(replace(SMALL, motion="slow", duration_s=2.0))


def test_too_few_landmarks_are_refused(monkeypatch):
    monkeypatch.setattr(landmark_map, "_chosen_sightings", lambda _: np.arange(3))
    with pytest.raises(DetectionError, match="only 3 landmarks"):
        mapped(replace(SMALL, duration_s=1.5))


@pytest.mark.long
def test_a_second_camera_finds_the_landmarks_of_the_first():
    simulation, recording, target = mapped(replace(SMALL, cameras=2, duration_s=7.0, camera_rate_hz=12.0))
    calibration = gnomon.calibrate_camera_imu(recording, target).calibration
    assert calibration.verdict != "fail"
    for name, truth in simulation.truth.cameras.items():
        found, sigma = calibration.cameras[name], calibration.sigma(f"{name}.T_cam_imu.translation")
        assert (sigma < 3e-3).all()
        assert (abs(found.T_cam_imu - truth.T_cam_imu)[:3, 3] < 4 * sigma).all()
        shift = abs(found.time_shift_cam_imu - truth.time_shift_cam_imu)
        assert shift < 4 * calibration.sigma(f"{name}.time_shift_cam_imu") < 4e-4


def test_a_camera_whose_pose_nothing_states_is_left_out(monkeypatch):
    monkeypatch.setattr(landmark_map, "map_landmarks", lambda _, cameras, *__: (list(cameras), "landmarks", ()))
    images = SimpleNamespace(imus={"imu0": None}, streams={})
    unplaced, placed = CameraInput(camera=None), CameraInput(camera=None, T_cam_cam0=np.eye(4))
    notes: list[str] = []
    assert _mapped(images, {"cam0": placed, "cam1": unplaced, "cam2": placed}, print, notes)[0] == ["cam0", "cam2"]
    (note,) = notes
    assert note.startswith("the images of cam1 were left out")


@pytest.mark.parametrize(("low", "limits"), [(43, 0), (40, 1), (20, 2)])
def test_landmarks_that_come_and_go_are_those_of_blurred_images(low, limits):
    frame = np.concatenate([np.full(50 if k % 2 else low, k) for k in range(3, 40)])  # none in the first images
    share = landmark_map.coming_and_going(SimpleNamespace(frame=frame))
    assert sum(share > limit for limit in landmark_map._COMING) == limits


def test_images_of_another_size_are_refused():
    simulation = simulate_camera_imu(SMALL.rig(), 5)
    images = room_images(SMALL, simulation)
    lens = replace(images.streams["cam0"].camera, resolution=(640, 480))
    with pytest.raises(RecordingError, match="400 x 300"):
        map_landmarks(images.streams, {"cam0": CameraInput(camera=lens)}, images.imus["imu0"], lambda _: None)
