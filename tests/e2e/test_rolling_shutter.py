"""Line delays that nobody stated: found and said where the recording proves them, left alone where there is none."""

import numpy as np
import pytest

from gnomon import CameraImuOptions, CameraImuScenario, calibrate_camera_imu, simulate_camera_imu


def calibrated(delay_s, motion="normal", seed=1, **options):
    scenario = CameraImuScenario(
        duration_s=20.0, motion=motion, pixel_noise_px=0.1, line_delay_s=delay_s, known_line_delay=False
    )
    simulation = simulate_camera_imu(scenario, seed)
    return simulation, calibrate_camera_imu(
        simulation.recording, simulation.target, CameraImuOptions(**options)
    ).calibration


def shutters(calibration):
    return [finding for finding in calibration.assessment.findings if finding.code == "rolling-shutter"]


@pytest.mark.long
@pytest.mark.parametrize("motion", ["normal", pytest.param("shaky", marks=pytest.mark.slow)])
def test_an_unstated_line_delay_is_found_and_said(motion):
    simulation, found = calibrated(25e-6, motion)
    lens, sigma = found.cameras["cam0"].camera, float(found.sigma("cam0.line_delay"))
    assert abs(lens.line_delay_s - 25e-6) < min(1e-6, 4 * sigma)
    (finding,) = shutters(found)
    assert finding.severity == "info"
    assert "us a row" not in finding.consequence
    assert "estimated jointly: 2" in finding.consequence
    assert "line delay" in found.assessment.trust.added
    assert not any("line_delay" in str(text) for text in found.provenance.options.get("free", ()))
    shift = simulation.truth.cameras["cam0"].time_shift_cam_imu
    assert abs(found.cameras["cam0"].time_shift_cam_imu - shift) < 1e-4


@pytest.mark.slow
def test_a_line_delay_that_is_held_at_zero_is_warned_of():
    _, found = calibrated(25e-6, fix=("cam0.line_delay",))
    (finding,) = shutters(found)
    assert finding.severity == "warning"
    assert "line delay" not in found.assessment.trust.added
    assert float(found.sigma("cam0.line_delay")) == 0


@pytest.mark.parametrize("motion", ["normal", "shaky"])
def test_a_global_shutter_stays_one(motion):
    _, found = calibrated(0.0, motion, seed=2)
    assert not shutters(found)
    assert found.cameras["cam0"].camera.line_delay_s == 0
    assert np.isclose(float(found.sigma("cam0.line_delay")), 0)


@pytest.mark.long
def test_a_line_delay_that_is_stated_rightly_is_not_warned_of():
    simulation, found = calibrated(25e-6, line_delay=25e-6)
    assert not shutters(found)
    assert found.cameras["cam0"].camera.line_delay_s == 25e-6
    shift = simulation.truth.cameras["cam0"].time_shift_cam_imu
    assert abs(found.cameras["cam0"].time_shift_cam_imu - shift) < 5 * float(found.sigma("cam0.time_shift_cam_imu"))


@pytest.mark.long
def test_a_line_delay_that_is_stated_of_a_global_shutter_is_warned_of():
    _, found = calibrated(0.0, line_delay=10e-6)
    (finding,) = shutters(found)
    assert finding.severity == "warning"
    assert "cam0 has a global shutter" in finding.message
    assert "10 us a row were stated" in finding.message
    assert "--free cam0.line_delay" in finding.cure
