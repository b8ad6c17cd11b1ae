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


def mapped(scenario, seed=5):
    """Return what is true, and landmarks and frames of a rendered recording."""
    simulation = simulate_camera_imu(scenario.rig(), seed)
    images = room_images(scenario, simulation)
    stream, samples = images.streams["cam0"], images.imus["imu0"]
    pictures = list(stream.frames([]))
    decoded = [frame.decode() for frame in pictures]  # once: they are asked for four times
    kept = [replace(frame, decode=lambda image=image: image) for frame, image in zip(pictures, decoded, strict=True)]
    stream = replace(stream, frames=lambda _: iter(kept))
    unstated = CameraInput(camera=replace(stream.camera, line_delay_s=0.0))
    frames, target, findings = map_landmarks("cam0", stream, unstated, samples, lambda _: None)
    return simulation, Recording(imus={"imu0": samples}, cameras={"cam0": frames}, findings=findings), target


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


@pytest.mark.long
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
        mapped(replace(SMALL, motion="static", duration_s=2.0))


def test_painted_walls_are_refused():
    with pytest.raises(DetectionError, match="can be followed"):
        mapped(replace(SMALL, surface="plain", furniture=0, duration_s=1.0))


def test_a_rig_that_never_turned_is_refused():
    with pytest.raises(InitialisationError, match="do not show the same rotation"):
        mapped(replace(SMALL, motion="translation", duration_s=4.0))


def test_too_few_landmarks_are_refused(monkeypatch):
    monkeypatch.setattr(landmark_map, "_chosen_sightings", lambda _: np.arange(3))
    with pytest.raises(DetectionError, match="only 3 landmarks"):
        mapped(replace(SMALL, duration_s=3.0))


def test_of_several_cameras_the_first_is_calibrated_and_the_others_are_told_how(monkeypatch):
    monkeypatch.setattr(landmark_map, "map_landmarks", lambda *_: ("frames", "landmarks", ()))
    images = SimpleNamespace(imus={"imu0": None}, streams={"cam0": None, "cam1": None})
    notes: list[str] = []
    cameras, _, _ = _mapped(images, {"cam0": None, "cam1": None}, print, notes)
    assert list(cameras) == ["cam0"]
    (note,) = notes
    assert "For cam1 give --cam a file of cam1 alone" in note


def test_images_of_another_size_are_refused():
    simulation = simulate_camera_imu(SMALL.rig(), 5)
    images = room_images(SMALL, simulation)
    lens = replace(images.streams["cam0"].camera, resolution=(640, 480))
    with pytest.raises(RecordingError, match="400 x 300"):
        map_landmarks("cam0", images.streams["cam0"], CameraInput(camera=lens), images.imus["imu0"], lambda _: None)
