"""Calibrations of several IMUs in other formats: poses and clocks in the files or in a loss, read back, shown."""

import re
from dataclasses import replace

import numpy as np
import pytest

from gnomon import CameraImuScenario, convert, simulate_camera_imu
from gnomon.formats.conversion import FORMATS, export_texts
from gnomon.formats.foreign import as_calibration
from gnomon.formats.foreign_files import load_foreign
from gnomon.formats.shared.losses import StatedImu
from gnomon.results.calibration import Covariance
from gnomon.writers.kalibr_files import KalibrResults
from gnomon.writers.tables import form_tables

SCENARIO = CameraImuScenario(duration_s=1.0, imus=3, cameras=2, accelerometer_delay_s=0.002, imu_clock_offset_s=-7.0)
ESTIMATORS = ("openvins", "vins-fusion", "orb-slam3", "basalt", "okvis")
SENSORS = ("imu_tk", "px4", "ardupilot", "imucal", "c-header")


@pytest.fixture(scope="module")
def simulation():
    return simulate_camera_imu(SCENARIO, seed=3)


@pytest.fixture(scope="module")
def calibration(simulation):
    """The truth, as uncertain as somebody may think."""
    names = simulation.truth.uncertainty.names
    root = 1e-4 * np.random.default_rng(1).standard_normal((len(names), len(names)))
    return replace(simulation.truth, uncertainty=Covariance(names=names, matrix=root @ root.T))


def stated(simulation):
    return {
        name: StatedImu(noise=samples.noise, update_rate_hz=200.0, topic=samples.topic)
        for name, samples in simulation.recording.imus.items()
    }


def test_kalibr_s_files_hold_pose_and_clock_of_every_imu(calibration, simulation, tmp_path):
    losses = convert(calibration, "kalibr", tmp_path, imu=stated(simulation))
    found = as_calibration(load_foreign(tmp_path / "imu.yaml"))
    assert found.imus["imu0"].T_imu_body is None
    for name, imu in calibration.imus.items():
        if name != "imu0":
            np.testing.assert_allclose(found.imus[name].T_imu_body, imu.T_imu_body, atol=1e-15)
            assert found.imus[name].time_shift_s == imu.time_shift_s
        np.testing.assert_allclose(found.imus[name].gyroscope.sensitivity, imu.gyroscope.sensitivity, atol=1e-12)
    text = (tmp_path / "imu.yaml").read_text()
    assert "t_imu0 = t_imu + time_offset" in text
    assert not [loss for loss in losses if "pose" in loss.what]
    assert sum("time shift of the accelerometer" in loss.what for loss in losses) == 3


def test_kalibr_s_results_print_pose_and_clock_of_every_imu(calibration, simulation, tmp_path):
    results = KalibrResults(
        calibration=calibration, target=simulation.target, residuals={}, gravity_target=simulation.gravity_target,
        imus=stated(simulation),
    ).text()  # fmt: skip
    (tmp_path / "results-imucam.txt").write_text(results)
    assert re.findall(r"T_ib \(imu0 to (imu\d)\)", results) == ["imu0", "imu1", "imu2"]
    found = as_calibration(load_foreign(tmp_path / "results-imucam.txt"))
    for name in ("imu1", "imu2"):
        np.testing.assert_allclose(found.imus[name].T_imu_body, calibration.imus[name].T_imu_body, atol=1e-8)
        assert found.imus[name].time_shift_s == calibration.imus[name].time_shift_s
    assert found.imus["imu0"].T_imu_body is None


def test_the_table_holds_them_with_their_sigmas(calibration, tmp_path):
    convert(calibration, "csv", tmp_path)
    foreign = load_foreign(tmp_path / "calibration.csv")
    found = as_calibration(foreign)
    for path in ("imu1.T_imu_body.rotation", "imu2.T_imu_body.translation", "imu1.time_shift_imu",
                 "imu0.accelerometer.time_shift"):  # fmt: skip
        np.testing.assert_allclose(found.parameter(path), calibration.parameter(path), atol=1e-15)
        np.testing.assert_allclose(found.sigma(path), calibration.sigma(path), rtol=1e-12)
    text = (tmp_path / "calibration.csv").read_text()
    assert '"imu1.T_imu_body.rotation[0]"' in text
    assert "t_imu0 = t_imu + time_shift_imu" in text


@pytest.mark.parametrize("to", ESTIMATORS)
def test_programs_of_one_imu_get_the_first_and_say_so(to, calibration, simulation):
    losses = export_texts(calibration, to, imu=stated(simulation)).losses
    left_out = [loss for loss in losses if loss.what in ("imu1", "imu2")]
    assert len(left_out) == 2
    assert all("knows one IMU; only imu0 is in the file" in loss.why for loss in left_out)
    assert any(loss.what == "time shift of the accelerometer of imu0" and "-2 ms" in loss.size for loss in losses)


@pytest.mark.parametrize("to", SENSORS)
def test_formats_of_sensors_lose_the_poses_in_words(to, calibration):
    found = {loss.what: loss for loss in export_texts(calibration, to).losses}
    loss = found["pose and clock of imu1"]
    mm = 1e3 * np.linalg.norm(calibration.imus["imu1"].T_imu_body[:3, 3])
    assert f"{mm:.3g} mm" in loss.size
    assert "+7004 ms" in loss.size
    assert "time shift of the accelerometer of imu0" in found


def test_ros_2_gets_a_transform_of_every_sensor(calibration, tmp_path):
    losses = convert(calibration, "ros2", tmp_path)
    found = load_foreign(tmp_path / "static_transforms.launch.yaml")
    np.testing.assert_allclose(found.imu_data["imu2"].T_imu_body, calibration.imus["imu2"].T_imu_body, atol=1e-12)
    assert set(found.cameras) == {"cam0", "cam1"}
    assert any(loss.what == "time shift of imu1" and "+7004 ms" in loss.size for loss in losses)


def test_every_format_says_what_it_does_with_several_imus(calibration, simulation):
    for to in FORMATS:
        texts = export_texts(calibration, to, imu=stated(simulation))
        words = " ".join((*texts.files, *texts.files.values(), *(loss.what for loss in texts.losses)))
        assert "imu1" in words or "IMU1" in words or "INS_ACC2" in words or "CAL_ACC1" in words, to


def test_tables_show_pose_and_clock_with_sigmas_that_follow_from_the_covariance(calibration):
    tables = {table.title: table for table in form_tables(calibration)}
    rows = {row.name: row for row in tables["imu1, pose and clock, body frame accel-x"].rows}
    assert rows["time_shift_imu"].unit == "ms"
    assert rows["time_shift_imu"].value.startswith("7004.")
    rng = np.random.default_rng(2)
    paths = ("imu1.T_imu_body.rotation", "imu1.T_imu_body.translation")
    draws = rng.multivariate_normal(np.zeros(6), calibration.covariance(*paths), 20_000)
    T = calibration.imus["imu1"].T_imu_body
    turned = np.cross(draws[:, :3], np.eye(3)[0])  # first order: R (I + [d]x), of which the first column
    spread = (T[:3, :3] @ turned.T).std(axis=1)
    shown = [float(rows[name].value.split("±")[1].split(")")[0]) for name in ("R_xx", "R_yx", "R_zx")]
    np.testing.assert_allclose(shown, spread, rtol=0.05)
    accelerometer = {row.name: row for row in tables["imu0 accelerometer, body frame accel-x"].rows}
    assert accelerometer["time_shift"].value.startswith("-2.0")
