"""Cameras in a calibration: names, sigmas, change of the body frame, and gnomon's own file."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import gnomon
from gnomon.errors import FormatError, OptionError, OutputError
from gnomon.formats.own.calibration_text import calibration_text
from gnomon.geometry.rotations import right_jacobian, rotation_from_rotvec, rotvec_from_rotation
from gnomon.results.calibration import CameraCalibration
from gnomon.results.moved import moved_into_frame
from gnomon.results.sensors import calibration_parameters, covariance_names, element_names

GOLDEN = Path(__file__).parents[2] / "golden"
CAMERA_PATHS = (
    "T_cam_imu.rotation", "T_cam_imu.translation", "time_shift_cam_imu", "line_delay", "intrinsics",
    "distortion_coeffs",
)  # fmt: skip


def test_names_come_in_the_order_of_the_parameters(camera_calibration):
    calibration = camera_calibration(cameras=2)
    names = covariance_names(calibration.imus, calibration.cameras)
    alone = covariance_names(calibration.imus)
    assert names[: len(alone)] == alone
    assert names[len(alone) : len(alone) + 16] == (
        *(f"cam0.T_cam_imu.rotation[{i}]" for i in range(3)),
        *(f"cam0.T_cam_imu.translation[{i}]" for i in range(3)),
        "cam0.time_shift_cam_imu",
        "cam0.line_delay",
        *(f"cam0.intrinsics[{i}]" for i in range(4)),
        *(f"cam0.distortion_coeffs[{i}]" for i in range(4)),
    )
    assert [name for name in names if name.startswith("cam1")][-1] == "cam1.intrinsics[5]"  # it has no distortion
    assert element_names("cam0.line_delay", ()) == ("cam0.line_delay",)


def test_parameters_of_a_camera(camera_calibration):
    calibration = camera_calibration(3)
    camera = calibration.cameras["cam1"]
    rotation = rotation_from_rotvec(calibration.parameter("cam1.T_cam_imu.rotation"))
    assert np.allclose(rotation, camera.T_cam_imu[:3, :3], atol=1e-14)
    assert np.array_equal(calibration.parameter("cam1.T_cam_imu.translation"), camera.T_cam_imu[:3, 3])
    assert calibration.parameter("cam1.time_shift_cam_imu").shape == ()
    assert calibration.parameter("cam1.line_delay") == 2.5e-5
    assert calibration.parameter("cam1.distortion_coeffs").shape == (0,)
    assert calibration.sigma("cam1.distortion_coeffs").shape == (0,)
    row = calibration.uncertainty.names.index("cam1.time_shift_cam_imu")
    assert calibration.sigma("cam1.time_shift_cam_imu") == np.sqrt(calibration.uncertainty.matrix[row, row])
    assert np.all(calibration.sigma("cam0.intrinsics") == 0)
    joint = calibration.covariance("cam0.T_cam_imu.rotation", "imu0.gyroscope.bias", "cam1.time_shift_cam_imu")
    assert joint.shape == (7, 7)
    assert (
        joint[0, 6]
        == calibration.uncertainty.matrix[calibration.uncertainty.names.index("cam0.T_cam_imu.rotation[0]"), row]
    )
    with pytest.raises(OptionError, match=r"cam1\.distortion_coeffs"):
        calibration.parameter("cam0.T_cam_imu")
    assert "cam0.T_cam_imu.rotation" in calibration._repr_html_()


@pytest.mark.parametrize("frame", ["accel-x", "accel-z"])
def test_a_change_of_frame_takes_the_cameras_along(camera_calibration, frame):
    """What a camera sees of a point does not depend on how the body's axes are named."""
    calibration = camera_calibration(1, frame="user")
    moved = calibration.in_frame(frame)
    old, new = calibration.imus["imu0"].accelerometer, moved.imus["imu0"].accelerometer
    turn = np.linalg.solve(new.sensitivity, old.sensitivity)  # f_new = Q f_old
    point = np.array([0.3, -0.2, 1.7])
    for name, camera in calibration.cameras.items():
        seen = camera.T_cam_imu[:3, :3] @ point + camera.T_cam_imu[:3, 3]
        T = moved.cameras[name].T_cam_imu
        assert np.allclose(T[:3, :3] @ turn @ point + T[:3, 3], seen, atol=1e-13)
        assert np.array_equal(T[:, 3], camera.T_cam_imu[:, 3])
        assert moved.cameras[name].camera is camera.camera


def scalars(imus, cameras):
    """All scalars; a camera's rotation as its rotation vector."""
    return np.concatenate([value.ravel() for _, value in calibration_parameters(imus, cameras)])


def perturbed(calibration, x):
    """The sensors off by x in every scalar; a camera's rotation by a small rotation on the right."""
    imus, cameras = {}, {}
    values = {}
    start = 0
    for path, value in calibration_parameters(calibration.imus, calibration.cameras):
        values[path] = x[start : start + value.size].reshape(value.shape)
        start += value.size
    for name, imu in calibration.imus.items():
        triads = {}
        for triad in ("accelerometer", "gyroscope"):
            fields = ("sensitivity", "bias", "g_sensitivity")[: 3 if triad == "gyroscope" else 2]
            sensor = getattr(imu, triad)
            triads[triad] = replace(sensor, **{f: getattr(sensor, f) + values[f"{name}.{triad}.{f}"] for f in fields})
        imus[name] = replace(imu, **triads)
    for name, camera in calibration.cameras.items():
        T = camera.T_cam_imu.copy()
        T[:3, :3] = T[:3, :3] @ rotation_from_rotvec(values[f"{name}.T_cam_imu.rotation"])
        T[:3, 3] += values[f"{name}.T_cam_imu.translation"]
        cameras[name] = CameraCalibration(
            T_cam_body=T,
            time_shift_cam_imu=camera.time_shift_cam_imu + values[f"{name}.time_shift_cam_imu"].item(),
            camera=camera.camera,
        )
    return imus, cameras


@pytest.mark.parametrize("frame", ["accel-x", "accel-z"])
@pytest.mark.parametrize("start", ["accel-x", "accel-z", "user"])
def test_jacobian_of_a_change_of_frame_against_differences(camera_calibration, frame, start):
    calibration = camera_calibration(5, frame=start)
    imu = calibration.imus["imu0"]
    # Everything of order one, so that one step fits all.
    scale = [np.abs(t.sensitivity).max() for t in (imu.accelerometer, imu.gyroscope)]
    tame = replace(
        imu,
        accelerometer=replace(imu.accelerometer, sensitivity=imu.accelerometer.sensitivity / scale[0], bias=np.ones(3)),
        gyroscope=replace(imu.gyroscope, sensitivity=imu.gyroscope.sensitivity / scale[1], bias=np.ones(3)),
    )
    calibration = replace(calibration, imus={"imu0": tame})
    at = moved_into_frame(calibration.imus, calibration.cameras, frame)
    names = covariance_names(calibration.imus, calibration.cameras)
    step = 1e-6
    for column, name in enumerate(names):
        if "line_delay" in name or "intrinsics" in name or "distortion" in name:
            continue
        ends = []
        for sign in (1, -1):
            x = np.zeros(len(names))
            x[column] = sign * step
            moved = moved_into_frame(*perturbed(calibration, x), frame)
            values = scalars(moved.imus, moved.cameras)
            row = len(covariance_names(calibration.imus))
            for camera in at.cameras:
                turn = at.cameras[camera].T_cam_imu[:3, :3].T @ moved.cameras[camera].T_cam_imu[:3, :3]
                values[row : row + 3] = rotvec_from_rotation(turn)
                row += len(covariance_names({}, {camera: at.cameras[camera]}))
            ends.append(values)
        difference = (ends[0] - ends[1]) / (2 * step)
        assert np.abs(at.jacobian[:, column] - difference).max() < 1e-8, name


def test_there_and_back(camera_calibration):
    calibration = camera_calibration(7)
    back = calibration.in_frame("accel-z").in_frame("accel-x")
    for name, camera in calibration.cameras.items():
        assert np.allclose(back.cameras[name].T_cam_imu, camera.T_cam_imu, atol=1e-13)
    size = np.sqrt(np.diag(calibration.uncertainty.matrix))
    unit = np.where(size > 0, size, 1.0)
    assert np.abs((back.uncertainty.matrix - calibration.uncertainty.matrix) / np.outer(unit, unit)).max() < 1e-9
    there = calibration.in_frame("accel-z")
    assert not np.allclose(
        there.sigma("cam0.T_cam_imu.rotation"), calibration.sigma("cam0.T_cam_imu.rotation"), rtol=1e-3
    )


def test_sigma_is_that_of_a_small_rotation_on_the_right(camera_calibration):
    """Against the covariance of the rotation vector, which follows by the right Jacobian."""
    calibration = camera_calibration(8)
    draws = np.random.default_rng(0).multivariate_normal(
        np.zeros(3), calibration.covariance("cam0.T_cam_imu.rotation"), 4000
    )
    R = calibration.cameras["cam0"].T_cam_imu[:3, :3]
    vectors = rotvec_from_rotation(R @ rotation_from_rotvec(draws))
    centre = calibration.parameter("cam0.T_cam_imu.rotation")
    assert np.allclose((vectors - centre) @ right_jacobian(centre).T, draws, atol=1e-6)


# --- gnomon's own file ---


@pytest.mark.parametrize("frame", ["accel-x", "accel-z", "user"])
def test_file_reads_back_bit_by_bit(camera_calibration, tmp_path, frame):
    for seed in range(3):
        saved = camera_calibration(seed, cameras=4, frame=frame)
        gnomon.save(saved, tmp_path / "a.yaml")
        read = gnomon.load(tmp_path / "a.yaml")
        assert tuple(read.cameras) == ("cam0", "cam1", "cam2", "cam3")
        for name, camera in saved.cameras.items():
            other = read.cameras[name]
            assert np.array_equal(other.T_cam_imu, camera.T_cam_imu)
            assert other.time_shift_cam_imu == camera.time_shift_cam_imu
            lens, found = camera.camera, other.camera
            assert (found.projection, found.distortion) == (lens.projection, lens.distortion)
            assert (found.resolution, found.topic) == (lens.resolution, lens.topic)
            for path in CAMERA_PATHS:
                assert np.array_equal(read.parameter(f"{name}.{path}"), saved.parameter(f"{name}.{path}"))
        assert np.array_equal(np.tril(read.uncertainty.matrix), np.tril(saved.uncertainty.matrix))
        fit, expected = read.assessment.camera_imu, saved.assessment.camera_imu
        for name in type(expected).__slots__:
            assert getattr(fit, name) == getattr(expected, name)
        assert np.isnan(read.assessment.holdout.accelerometer_rms)
        assert read.assessment.held_by_prior == saved.assessment.held_by_prior
        gnomon.save(read, tmp_path / "b.yaml")
        assert (tmp_path / "a.yaml").read_bytes() == (tmp_path / "b.yaml").read_bytes()


def test_schema_is_newer_only_with_cameras(camera_calibration, random_calibration):
    assert "schema: gnomon/1.1\n" in calibration_text(camera_calibration())
    text = calibration_text(random_calibration())
    assert "schema: gnomon/1\n" in text
    assert "camera" not in text.replace("cameras: {}", "")


def test_golden_file(camera_calibration, tmp_path):
    """A file that this version wrote is read, and written again, by every later one."""
    golden = GOLDEN / "calibration-gnomon-1.1.yaml"
    calibration = gnomon.load(golden)
    assert calibration_text(calibration) == golden.read_text(encoding="utf-8")
    assert calibration.cameras["cam0"].camera.model == "pinhole-radtan"
    assert calibration.cameras["cam1"].camera.line_delay_s == 2.5e-5
    assert calibration.assessment.camera_imu.corners_used["cam1"] == 41022
    assert calibration.sigma("cam0.time_shift_cam_imu") > 0


def test_comments_state_the_conventions(camera_calibration):
    header = calibration_text(camera_calibration()).split("schema:")[0]
    for words in (
        "p_cam = T_cam_imu p_imu", "t_imu = t_cam + time_shift_cam_imu", "Pixel (0, 0)", "small rotation about the",
        "[fu, fv, pu,", "in m.", "in s.",
    ):  # fmt: skip
        assert words in header


def changed(text, pattern, replacement):
    new, count = re.subn(pattern, replacement, text, count=1, flags=re.MULTILINE)
    assert count == 1, pattern
    return new


@pytest.mark.parametrize(
    ("pattern", "replacement", "expected"),
    [
        (r"^schema: gnomon/1\.1$", "schema: gnomon/1", r"cameras\.cam0: unknown key"),
        (r"^schema: gnomon/1\.1$", "schema: gnomon/1.99", r"reads up to gnomon/1\.\d"),
        (r"^    camera_model: pinhole", "    camera_model: pinhol", r"cam0\.camera_model: .*Did you mean pinhole"),
        (r"^    camera_model: pinhole", "    camera_modl: pinhole", r"Did you mean camera_model\?"),
        (r"^    intrinsics: \[[^,]*, ", "    intrinsics: [", r"cameras\.cam0: .*pinhole"),
        (r"^    intrinsics: \[[^,]*", "    intrinsics: [-4.0", r"cameras\.cam0: focal length"),
        (r"^    distortion_coeffs: \[[^,]*", "    distortion_coeffs: [.nan", r"distortion_coeffs\[0\]: .*finite"),
        (r"^    resolution: .*", "    resolution: [640]", r"resolution: found 1 numbers, expected width and height"),
        (r"^    rostopic: .*", "    rostopic: 3", r"rostopic: found 3, expected text"),
        (r"^      - \[0\.0, 0\.0, 0\.0, 1\.0\]", "      - [0.0, 0.0, 0.1, 1.0]", r"T_cam_imu: the last row"),
        (r"T_cam_imu:\n      - \[[^,]*", "T_cam_imu:\n      - [5.0", r"cam0\.T_cam_imu: .*no rotation"),
        (r"T_cam_imu:\n      - .*\n", "T_cam_imu:\n", r"cam0\.T_cam_imu: found 3 rows, expected 4"),
        (r"time_shift_cam_imu_sigma: .*", "time_shift_cam_imu_sigma: 1.5", r"imu_sigma: this contradicts"),
        (r"T_cam_imu_rotation_sigma: \[[^,]*", "T_cam_imu_rotation_sigma: [7.0", r"rotation_sigma: this contradicts"),
        (r"- cam0\.line_delay", "- cam0.delay", r"covariance\.names: entry \d+ is cam0\.delay"),
        (r"converged: true", "converged: perhaps", r"camera_imu\.converged: found 'perhaps', expected true or false"),
        (r"^      cam1:\n        frames", "      cam7:\n        frames", r"camera_imu\.cameras\.cam7: unknown key"),
        (r"^        corners_used: .*\n", "", r"the key corners_used is missing"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_said(camera_calibration, tmp_path, pattern, replacement, expected):
    path = tmp_path / "c.yaml"
    path.write_text(changed(calibration_text(camera_calibration()), pattern, replacement), encoding="utf-8")
    with pytest.raises(FormatError, match=expected) as caught:
        gnomon.load(path)
    assert str(path) in str(caught.value)


def test_mirrored_camera_is_refused(camera_calibration, tmp_path):
    calibration = camera_calibration()
    camera = calibration.cameras["cam0"]
    T = camera.T_cam_imu.copy()
    T[:, 0] = -T[:, 0]
    text = calibration_text(
        replace(calibration, cameras={**calibration.cameras, "cam0": replace(camera, T_cam_body=T)})
    )
    (tmp_path / "c.yaml").write_text(text)
    with pytest.raises(FormatError, match="no rotation matrix"):
        gnomon.load(tmp_path / "c.yaml")


def test_sigmas_may_be_left_out(camera_calibration, tmp_path):
    saved = camera_calibration()
    text = re.sub(r"^    \w+_sigma: .*\n", "", calibration_text(saved), flags=re.MULTILINE)
    (tmp_path / "c.yaml").write_text(text)
    assert gnomon.load(tmp_path / "c.yaml").sigma("cam0.line_delay") == saved.sigma("cam0.line_delay")


def test_useless_numbers_are_not_saved(camera_calibration, tmp_path):
    calibration = camera_calibration()
    camera = replace(calibration.cameras["cam1"], time_shift_cam_imu=float("nan"))
    with pytest.raises(OutputError, match=r"cam1\.time_shift_cam_imu is not a finite number"):
        gnomon.save(replace(calibration, cameras={**calibration.cameras, "cam1": camera}), tmp_path / "c.yaml")
    assert list(tmp_path.iterdir()) == []


def test_unknown_rms_survives(camera_calibration, tmp_path):
    calibration = camera_calibration()
    fit = replace(calibration.assessment.camera_imu, reprojection_rms_px={"cam0": 0.1, "cam1": float("nan")})
    calibration = replace(calibration, assessment=replace(calibration.assessment, camera_imu=fit))
    gnomon.save(calibration, tmp_path / "c.yaml")
    assert np.isnan(gnomon.load(tmp_path / "c.yaml").assessment.camera_imu.reprojection_rms_px["cam1"])
