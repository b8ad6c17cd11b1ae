"""A calibration of several IMUs on a terminal and in a report: poses, clocks and signals of each, with sigmas."""

from dataclasses import replace

import numpy as np
import pytest

from camera_imu_result import make_camera_imu_result
from gnomon.cli.camera_summary import imu_pose_lines
from gnomon.cli.results import parameter_lines
from gnomon.geometry.rotations import rotation_from_rotvec
from gnomon.report.camera_imu.page import camera_imu_page
from gnomon.report.rig_parameters import placed_imu_groups
from gnomon.results.calibration import Covariance
from gnomon.results.sensors import covariance_names
from gnomon.writers.kalibr_files import residual_statistics

POSE = np.eye(4)
POSE[:3, :3] = rotation_from_rotvec(np.array([0.0, 0.0, np.pi / 2 + 0.01]))
POSE[:3, 3] = [0.02, -0.1, 0.005]
SIGMAS = {
    "imu1.T_imu_body.rotation": np.array([1e-4, 2e-4, 3e-4]),
    "imu1.T_imu_body.translation": np.array([5e-4, 6e-4, 7e-4]),
    "imu1.time_shift_imu": 2e-6,
    "imu0.accelerometer.time_shift": 3e-6,
}


@pytest.fixture(scope="module")
def result():
    """Two IMUs: the second one 90 degrees about z from the first, on a clock that is 44 s off."""
    one = make_camera_imu_result(cameras=2)
    calibration, diagnostics = one.calibration, one.diagnostics
    body = calibration.imus["imu0"]
    first = replace(body, accelerometer=replace(body.accelerometer, time_shift_s=-0.0021))
    imus = {"imu0": first, "imu1": replace(body, T_imu_body=POSE, time_shift_s=44.25)}
    names = covariance_names(imus, calibration.cameras)
    sigma = np.array([_sigma(calibration, name) for name in names])
    uncertainty = Covariance(names=names, matrix=np.diag(sigma**2))
    signals = diagnostics.signals | {
        name.replace("imu0", "imu1"): replace(fit, t_s=fit.t_s + 1e-3) for name, fit in diagnostics.signals.items()
    }
    biases = diagnostics.biases | {name.replace("imu0", "imu1"): bias for name, bias in diagnostics.biases.items()}
    return replace(
        one,
        calibration=replace(calibration, imus=imus, uncertainty=uncertainty),
        diagnostics=replace(diagnostics, signals=signals, biases=biases),
    )


def _sigma(calibration, name):
    path, _, index = name.partition("[")
    if path in SIGMAS:
        return float(np.atleast_1d(SIGMAS[path])[int(index[:-1] or 0) if index else 0])
    known = dict(zip(calibration.uncertainty.names, np.sqrt(np.diag(calibration.uncertainty.matrix)), strict=True))
    return known[name.replace("imu1", "imu0")]


def test_the_terminal_says_pose_and_clock_of_each(result):
    text = "\n".join(imu_pose_lines(result.calibration))
    assert "imu1 T_imu_body (p_imu1 = T_imu_body p_imu0)" in text
    assert "20.00 +- 0.50   -100.00 +- 0.60   5.00 +- 0.70 mm" in text
    assert "44250.0000 +- 0.0020 ms (t_imu0 = t_imu1 + shift)" in text
    assert "+- 0.0057 0.011 0.017 deg" in text
    assert "  imu0 accelerometer\n    time shift       -2.1000 +- 0.0030 ms (t_gyr = t_acc + shift)" in text
    lines = "\n".join(parameter_lines(result.calibration))  # and nothing of them among the matrices
    assert "imu1 gyroscope sensitivity" in lines
    assert "T_imu_body" not in lines
    assert "time_shift" not in lines
    assert max(map(len, text.splitlines())) <= 80


def test_the_report_shows_pose_clock_and_signals_of_each(result):
    page = camera_imu_page(result.calibration, result.diagnostics)
    section = next(s for s in page.sections if s.anchor == "cameras")
    assert section.title == "Cameras and IMUs"
    titles = [getattr(block, "title", "") for block in section.blocks]
    assert "imu1" in titles
    assert "T_imu_body of imu1: p_imu1 = T_imu_body p_imu0, in metres" in titles
    rig = next(block for block in page.front if getattr(block, "title", "") == "The rig")
    assert "imu0, imu1, cam0, cam1" in rig.svg
    fits = next(s for s in page.sections if s.anchor == "fit")
    assert {"imu0", "imu1"} <= {word for b in fits.blocks for word in getattr(b, "title", "").split()}
    keys = {number.label: number for number in page.key_numbers}
    assert keys["Time shift of imu1"].value.startswith("44250.0000 ± 0.0020")


def test_the_groups_of_a_placed_imu_are_told_as_a_person_measures(result):
    groups = {group.title: group for group in placed_imu_groups(result.calibration, "imu1")}
    assert groups["Attitude"].note == "turned against imu1 x, y, z along −y, +x, +z of imu0"
    position = [float(row.value.replace("−", "-")) for row in groups["Position"].rows]
    np.testing.assert_allclose(position, -1e3 * POSE[:3, :3].T @ POSE[:3, 3], atol=0.05)
    assert float(groups["Attitude"].rows[2].value) == pytest.approx(np.degrees(0.01), abs=1e-3)
    clock = placed_imu_groups(result.calibration, "imu0")
    assert [group.title for group in clock] == ["Time"]
    assert clock[0].rows[0].reads_as == "t_gyroscope = t_accelerometer + time shift"


def test_residuals_of_every_imu_go_into_kalibr_s_results(result):
    assert {"imu0.gyroscope", "imu1.gyroscope", "imu1.accelerometer"} <= set(residual_statistics(result.diagnostics))
