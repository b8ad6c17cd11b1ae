"""What is estimated only to be compared, or to see whether it belongs into the model, never costs the result."""

from dataclasses import replace

import numpy as np
import pytest

from gnomon import (
    CameraImuOptions,
    CameraImuScenario,
    CameraOptions,
    SolveError,
    calibrate_camera_imu,
    calibrate_cameras,
    simulate_camera_imu,
)
from gnomon.report.page import write_report

SMALL = CameraImuScenario(
    duration_s=9.0, motion="normal", imu_rate_hz=100.0, camera_rate_hz=10.0, target_cols=3, target_rows=3
)


@pytest.fixture(scope="module")
def rig():
    return simulate_camera_imu(SMALL, 3)


def fail(*_, **__):
    raise SolveError("no step lowers the cost.")


def findings_of(result):
    return {finding.code: finding for finding in result.calibration.assessment.findings}


def assert_same_numbers(one, other):
    for name, camera in one.calibration.cameras.items():
        np.testing.assert_array_equal(camera.T_cam_body, other.calibration.cameras[name].T_cam_body)


def test_a_basic_model_that_finds_no_minimum_is_left_out_of_the_report(rig, monkeypatch, tmp_path):
    options = CameraImuOptions(model="full", compare=True)
    usual = calibrate_camera_imu(rig.recording, rig.target, replace(options, compare=False))
    solve = calibrate_camera_imu.__globals__["basic_model"].__globals__
    monkeypatch.setitem(solve, "minimise_cost", _failing_after(solve["minimise_cost"], 1))
    result = calibrate_camera_imu(rig.recording, rig.target, options)
    assert_same_numbers(result, usual)
    assert findings_of(result)["comparison-left-out"].severity == "info"
    assert "comparison-left-out" not in findings_of(usual)
    write_report(result, tmp_path / "report.html")
    assert "no comparison with the basic model" in (tmp_path / "report.html").read_text(encoding="utf-8")


def _failing_after(function, calls):
    done = []

    def limited(*args, **keywords):
        done.append(1)
        return function(*args, **keywords) if len(done) <= calls else fail()

    return limited


def test_a_rolling_shutter_that_was_stated_is_compared_with_the_basic_model():
    rolling = simulate_camera_imu(replace(SMALL, line_delay_s=3e-5), 3)
    result = calibrate_camera_imu(rolling.recording, rolling.target, CameraImuOptions(compare=True))
    assert "comparison-left-out" not in findings_of(result)
    assert all(fit.basic is not None for fit in result.diagnostics.signals.values())


@pytest.mark.parametrize("how", ["raises", "does not come to rest"])
def test_a_larger_model_that_fails_leaves_the_model_without_it(how, monkeypatch):
    bent = simulate_camera_imu(replace(SMALL, duration_s=15.0, focal_error=0.01), 3)
    model = calibrate_camera_imu.__globals__["select_model"].__globals__
    usual = calibrate_camera_imu(bent.recording, bent.target)
    assert "lens-found" in findings_of(usual), "the recording asks for the lens"
    solve = model["minimise_cost"]
    restless = lambda *args, **keywords: replace(solve(*args, **keywords), converged=False)  # noqa: E731
    monkeypatch.setitem(model, "minimise_cost", fail if how == "raises" else restless)
    result = calibrate_camera_imu(bent.recording, bent.target)
    found = findings_of(result)
    assert found["step-left-out"].severity == "warning"
    assert "intrinsics" in found["step-left-out"].message
    assert "lens-found" not in found
    assert "not-converged" not in found
    assert result.calibration.assessment.trust.added == ()
    held = CameraImuOptions(fix=("cam0.intrinsics", "cam0.distortion_coeffs"))
    assert_same_numbers(result, calibrate_camera_imu(bent.recording, bent.target, held))


@pytest.mark.parametrize("step", ["camera_board.solve_rig", "camera_views.leave_clusters_out"])
def test_cameras_do_without_a_look_at_the_board_or_at_views_left_out(rig, step, monkeypatch):
    monkeypatch.setattr(f"gnomon.calibrate.steps.{step}", fail)
    result = calibrate_cameras(rig.recording, rig.target, CameraOptions(model=("pinhole-radtan",)))
    assert findings_of(result)["comparison-left-out"].severity == "info"
    assert result.calibration.cameras["cam0"].camera.intrinsics[0] > 0
