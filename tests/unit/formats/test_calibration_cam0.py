"""Calibrations of cameras alone: gnomon's own file, what other formats take of them, and what needs an IMU."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

import gnomon
from cameras_example import LENSES, cameras_calibration
from gnomon.errors import FormatError, OptionError, OutputError
from gnomon.formats.conversion import FORMATS, export_texts
from gnomon.formats.own.calibration_text import calibration_text
from gnomon.formats.sensor_inputs import read_cameras, read_rig
from gnomon.formats.shared.entries import baseline_of
from gnomon.geometry.rotations import rotation_from_rotvec
from gnomon.results.sensors import covariance_names
from gnomon.results.trust import UncertaintySummary
from gnomon.writers.tables import form_tables, summary_table

GOLDEN = Path(__file__).parents[2] / "golden"


def saved(calibration, folder):
    path = folder / "calibration.yaml"
    gnomon.save(calibration, path)
    return path


@pytest.mark.parametrize("cameras", [1, 2, 3])
def test_file_reads_back_bit_by_bit(tmp_path, cameras):
    calibration = cameras_calibration(3, cameras)
    path = saved(calibration, tmp_path)
    found = gnomon.load(path)
    assert calibration_text(found) == path.read_text()
    assert np.array_equal(found.uncertainty.matrix, calibration.uncertainty.matrix)
    assert found.uncertainty.names == calibration.uncertainty.names
    assert (found.imus, found.frame, found.gravity) == ({}, "cam0", calibration.gravity)
    for name, camera in calibration.cameras.items():
        again = found.cameras[name]
        assert np.array_equal(again.T_cam_body, camera.T_cam_body)
        assert np.array_equal(again.camera.parameters, camera.camera.parameters)
        assert (again.body, again.camera.model) == ("cam0", camera.camera.model)
        assert again.camera.line_delay_s == camera.camera.line_delay_s
    fit, expected = found.assessment.cameras, calibration.assessment.cameras
    assert fit.models == expected.models
    assert fit.holdout_rms_px["cam0"] == expected.holdout_rms_px["cam0"]
    assert all(np.isnan(fit.holdout_rms_px[name]) for name in list(expected.models)[1:])
    assert (fit.bow_m, fit.board_added) == (expected.bow_m, ("target.bow",))
    assert np.isnan(fit.print_scale)


def test_golden_file():
    """A file that gnomon 0.3 wrote stays readable, and is written as it was."""
    golden = GOLDEN / "calibration-gnomon-1.4.yaml"
    assert calibration_text(gnomon.load(golden)) == golden.read_text(encoding="utf-8")


def test_file_says_nothing_of_an_imu(tmp_path):
    text = saved(cameras_calibration(), tmp_path).read_text()
    head = text.partition("\nschema")[0]
    assert "schema: gnomon/1.4\n" in text
    assert "inertial" not in head
    assert "gravity" not in text
    assert "T_cam_imu" not in text
    assert not {"imus", "gravity"} & set(yaml.safe_load(text))
    assert "time_shift" not in text
    assert "T_cam_cam0" not in yaml.safe_load(text)["cameras"]["cam0"]


def test_names_of_the_scalars():
    calibration = cameras_calibration(0, 2)
    assert calibration.uncertainty.names == covariance_names({}, calibration.cameras)
    assert [name for name in calibration.uncertainty.names if name.startswith("cam1.T")] == [
        *(f"cam1.T_cam_cam0.rotation[{i}]" for i in range(3)),
        *(f"cam1.T_cam_cam0.translation[{i}]" for i in range(3)),
    ]
    assert not any("cam0.T_" in name or "delay" in name or "shift" in name for name in calibration.uncertainty.names)
    with pytest.raises(OptionError, match="cameras alone"):
        _ = calibration.cameras["cam1"].T_cam_imu


DAMAGE = {
    "an IMU's key": (("body_frame: cam0", "body_frame: cam0\ngravity: 9.8"), r"gravity: unknown key"),
    "older schema": (("gnomon/1.4", "gnomon/1.3"), r"imus is missing|gravity is missing"),
    "a pose of cam0": (("  cam0:\n", "  cam0:\n    T_cam_cam0: 1\n"), r"cameras\.cam0\.T_cam_cam0: unknown key"),
    "another sigma": (("T_cam_cam0_translation_sigma: [", "T_cam_cam0_translation_sigma: [9.0, "), "translation_sigma"),
    "no rotation": (("[0.0, 0.0, 0.0, 1.0]", "[0.0, 0.0, 0.0, 2.0]"), r"cameras\.cam1\.T_cam_cam0: the last row"),
    "a count as text": (("views_used: 60", "views_used: sixty"), r"views_used: found text"),
    "no camera": (("cameras:\n  cam0:", "cameras: {}\nx:\n  cam0:"), "x: unknown key"),
}


@pytest.mark.parametrize(("change", "message"), DAMAGE.values(), ids=DAMAGE)
def test_damaged_files(tmp_path, change, message):
    path = saved(cameras_calibration(0, 2), tmp_path)
    text = path.read_text()
    assert change[0] in text
    path.write_text(text.replace(*change, 1))
    with pytest.raises(FormatError, match=message):
        gnomon.load(path)


def test_parameters_that_are_no_numbers_are_not_written(tmp_path):
    calibration = cameras_calibration(0, 2)
    camera = calibration.cameras["cam1"]
    T = camera.T_cam_body.copy()
    T[0, 3] = np.nan
    broken = replace(calibration, cameras={**calibration.cameras, "cam1": replace(camera, T_cam_body=T)})
    with pytest.raises(OutputError, match=r"cam1\.T_cam_cam0\.translation is not a finite number"):
        saved(broken, tmp_path)


# ---- what can be done with it ----


def test_baseline_and_its_covariance_by_moving_both_cameras():
    calibration = cameras_calibration(5, 3)
    found = baseline_of(calibration, "cam1", "cam2")
    rng = np.random.default_rng(0)
    covariance = calibration.covariance(
        *(f"cam{i}.T_cam_cam0.{part}" for i in (1, 2) for part in ("rotation", "translation"))
    )
    draws = rng.multivariate_normal(np.zeros(12), covariance, 4000)
    one, other = (calibration.cameras[f"cam{i}"].T_cam_body for i in (1, 2))
    moved = []
    for draw in draws:
        A, B = one.copy(), other.copy()
        A[:3, :3] = A[:3, :3] @ rotation_from_rotvec(draw[:3])
        A[:3, 3] += draw[3:6]
        B[:3, :3] = B[:3, :3] @ rotation_from_rotvec(draw[6:9])
        B[:3, 3] += draw[9:]
        T = B @ np.linalg.inv(A)
        turn = found.T[:3, :3].T @ T[:3, :3]
        rotation = 0.5 * np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
        moved.append(np.r_[rotation, T[:3, 3] - found.T[:3, 3], np.linalg.norm(T[:3, 3]) - found.distance])
    shown = np.cov(np.array(moved).T)
    sigma = np.sqrt(np.diag(found.covariance))
    assert np.allclose(np.sqrt(np.diag(shown))[:6], sigma, rtol=0.05)
    assert np.allclose(shown[:6, :6] / np.outer(sigma, sigma), found.covariance / np.outer(sigma, sigma), atol=0.08)
    assert np.isclose(np.sqrt(shown[6, 6]), found.distance_sigma, rtol=0.05)


HOLDS = {"kalibr", "ros2", "json", "csv"}


@pytest.mark.parametrize("to", sorted(set(FORMATS) - HOLDS))
def test_formats_of_an_imu_refuse(to):
    with pytest.raises(OptionError, match=rf"^{to} describes an IMU, and this calibration is of cameras alone"):
        export_texts(cameras_calibration(), to)


def test_kalibrs_camchain(tmp_path):
    calibration = cameras_calibration(2, 3)
    gnomon.convert(calibration, "kalibr", tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["camchain.yaml"]
    chain = yaml.safe_load((tmp_path / "camchain.yaml").read_text())
    assert set(chain["cam0"]) == {
        "cam_overlaps", "camera_model", "distortion_coeffs", "distortion_model", "intrinsics", "resolution", "rostopic"
    }  # fmt: skip
    assert [chain[name]["cam_overlaps"] for name in chain] == [[1], [0, 2], [1]]
    T = [calibration.cameras[name].T_cam_body for name in chain]
    assert np.allclose(chain["cam2"]["T_cn_cnm1"], T[2] @ np.linalg.inv(T[1]), atol=1e-14)
    lenses = read_cameras(tmp_path / "camchain.yaml", [])
    assert {name: lens.camera.model for name, lens in lenses.items()} == {k: v.model for k, v in LENSES.items()}


def test_csv_and_json_read_back(tmp_path):
    calibration = cameras_calibration(2, 3)
    for to in ("csv", "json"):
        gnomon.convert(calibration, to, tmp_path)
    assert calibration_text(gnomon.load(tmp_path / "calibration.json")) == calibration_text(calibration)
    table = gnomon.load_foreign(tmp_path / "calibration.csv")
    assert table.frame == "cam0"
    for name, camera in calibration.cameras.items():
        assert np.allclose(table.cameras[name].T_cam_body, camera.T_cam_body, atol=1e-14)
        assert np.array_equal(table.cameras[name].camera.parameters, camera.camera.parameters)
        assert table.cameras[name].camera.line_delay_s == camera.camera.line_delay_s
    assert np.array_equal(table.sigmas["cam1.T_cam_cam0.rotation"], calibration.sigma("cam1.T_cam_cam0.rotation"))


def test_ros2_camera_info_of_one_camera_needs_no_transforms():
    assert list(export_texts(cameras_calibration(0, 1), "ros2").files) == ["cam0_camera_info.yaml"]
    files = export_texts(cameras_calibration(0, 2), "ros2").files
    assert files["static_transforms.launch.yaml"].count("--child-frame-id") == 1
    assert "--frame-id cam0 --child-frame-id cam1" in files["static_transforms.launch.yaml"]


def test_tables_of_it():
    calibration = cameras_calibration(0, 2)
    rows = {row.name: row.value for row in summary_table(calibration).rows}
    assert rows["cam0, views used"] == "60 of 90"
    assert rows["board, bow"] == "0.410 ± 0.030"
    assert "gravity" not in rows
    for form in ("sensitivity", "kalibr", "tedaldi"):
        first, second = form_tables(calibration, form)
        assert [row.name for row in first.rows] == ["fu", "fv", "pu", "pv", "k1", "k2", "p1", "p2"]
        assert [row.name for row in second.rows][9:15] == ["t_x", "t_y", "t_z", "p_x", "p_y", "p_z"]
        assert "p_cam0" in second.note


def test_uses_are_those_of_an_imu():
    calibration = cameras_calibration()
    assert gnomon.judge(calibration, "general") is calibration
    with pytest.raises(OptionError, match="is of cameras alone"):
        gnomon.judge(calibration, "vio")


def test_frames_of_an_imu_are_refused():
    calibration = cameras_calibration()
    with pytest.raises(OptionError, match="cameras alone: its body is cam0"):
        calibration.in_frame("accel-x")
    assert calibration.with_origin("y").cameras["cam1"] is calibration.cameras["cam1"]


def test_two_of_them_agree(tmp_path):
    one, other = cameras_calibration(0, 2), cameras_calibration(0, 2, findings=False)
    other = replace(other, assessment=replace(other.assessment, trust=UncertaintySummary()))
    found = gnomon.compare(one, other)
    assert found.verdict == "pass"
    assert {block.path for block in found.blocks} >= {"cam0.lens", "cam1.lens"}


# ---- what camera-imu takes of it ----


def test_what_camera_imu_is_told(tmp_path):
    calibration = cameras_calibration(1, 2)
    path = saved(calibration, tmp_path)
    cameras, rig = read_cameras(path, []), read_rig(path)
    for name, camera in cameras.items():
        assert camera.T_cam_imu is None
        assert camera.time_shift_cam_imu_s is None
        expected = calibration.covariance(f"{name}.intrinsics", f"{name}.distortion_coeffs")
        assert np.array_equal(camera.lens_covariance, expected)
    assert list(rig.T_cam_cam0) == ["cam1"]
    assert np.array_equal(rig.T_cam_cam0["cam1"], calibration.cameras["cam1"].T_cam_body)
    assert np.array_equal(rig.covariance, calibration.uncertainty.matrix)
    alone = rig.of({"cam1"})  # without cam0 the pose says nothing
    assert not alone.T_cam_cam0
    assert all(name.startswith("cam1.") and "T_cam" not in name for name in alone.names)


def test_other_files_tell_of_no_rig(tmp_path, camera_calibration):
    gnomon.convert(cameras_calibration(), "kalibr", tmp_path)
    assert read_rig(tmp_path / "camchain.yaml") is None
    assert read_rig(saved(camera_calibration(0), tmp_path)) is None
