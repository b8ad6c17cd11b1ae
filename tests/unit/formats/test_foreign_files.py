"""Calibration files of other projects: every sample is read, to its last digit, and what is wrong is refused."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
import yaml

from gnomon.errors import FormatError
from gnomon.formats.foreign_files import is_own, load_foreign
from gnomon.formats.own.calibration_text import calibration_text
from gnomon.geometry.rotations import rotation_from_quaternion
from gnomon.recording.samples import ImuNoise
from gnomon.writers.tables import foreign_document, foreign_tables

FULL = "rendered-camimu/a-aprilgrid-full/kalibr/scale-misalignment-size-effect"
KALIBR = [
    "a-aprilgrid-full/kalibr/calibrated",
    "a-aprilgrid-full/kalibr/scale-misalignment",
    "a-aprilgrid-full/kalibr/scale-misalignment-size-effect",
    "a-aprilgrid-full/kalibr/sm_sigma0.1",
    "b-aprilgrid-ideal-imu/kalibr/calibrated",
    "d-checkerboard-ideal-imu/kalibr/cal",
]
OPENVINS = ["euroc_mav", "kaist_vio", "rpng_sim", "rs_d455", "tum_vi", "uzhfpv_indoor_45"]
BASALT = ["euroc_ds", "euroc_eucm", "tumvi_512_ds"]


def raw_yaml(path: Path):
    return yaml.safe_load(re.sub(r"(?m)^%.*$", "", path.read_text()))


def apart(first, second) -> float:
    return float(np.abs(np.asarray(first) - np.asarray(second)).max())


# ---- the samples ----


def test_every_sample_is_read(real_data):
    files = [path for path in real_data("kalibr-format-samples").glob("*/*") if path.suffix in {".yaml", ".json"}]
    rendered = real_data("rendered-camimu")
    files += [*rendered.glob("*/kalibr/*/data-*"), *rendered.glob("*/*.yaml")]
    assert len(files) == 15 + 18 + 12
    for path in files:
        found = load_foreign(path)
        assert found.imus or found.cameras or found.lenses or found.imu_data or found.target is not None
        tables = foreign_tables(found)
        assert not any("fixed" in row.value or "sigma" in row.value for table in tables for row in table.rows)
        json.loads(json.dumps(foreign_document(found), allow_nan=False))


@pytest.mark.parametrize("folder", KALIBR)
def test_kalibrs_results(real_data, folder):
    place = real_data("rendered-camimu") / folder
    found = load_foreign(
        *(place / f"data-{name}" for name in ("results-imucam.txt", "camchain-imucam.yaml", "imu.yaml"))
    )
    chain, stated = raw_yaml(place / "data-camchain-imucam.yaml")["cam0"], raw_yaml(place / "data-imu.yaml")["imu0"]
    camera = found.cameras["cam0"]
    assert apart(camera.T_cam_imu, chain["T_cam_imu"]) < 1e-15  # of the yaml file, not the eight digits of the other
    assert camera.time_shift_cam_imu == chain["timeshift_cam_imu"]
    assert camera.camera.intrinsics.tolist() == chain["intrinsics"]
    assert camera.camera.resolution == tuple(chain["resolution"])
    data = found.imu_data["imu0"]
    assert data.noise == ImuNoise(**{key: stated[key] for key in ImuNoise.__slots__})
    assert (data.update_rate_hz, data.topic, data.time_offset_s) == (200.0, "/imu0", 0.0)
    assert np.array_equal(data.T_imu_body, np.eye(4))
    imu = found.imus["imu0"]
    if stated["model"] == "calibrated":
        assert np.array_equal(imu.gyroscope.sensitivity, np.eye(3))
        assert data.lever_arms_m is None
    else:
        gyro = {key: np.array(value) for key, value in stated["gyroscopes"].items()}
        assert np.array_equal(imu.accelerometer.sensitivity, stated["accelerometers"]["M"])
        assert apart(imu.gyroscope.sensitivity, gyro["M"] @ gyro["C_gyro_i"]) < 1e-15
        assert apart(imu.gyroscope.g_sensitivity, gyro["A"] @ gyro["C_gyro_i"]) < 1e-18
    if "rx_i" in stated.get("accelerometers", {}):
        arms = [stated["accelerometers"][key] for key in ("rx_i", "ry_i", "rz_i")]
        assert data.lever_arms_m.tolist() == arms
    target = load_foreign(place.parents[1] / "target.yaml").target
    assert found.target.describe() == target.describe()
    assert apart(found.target.points, target.points) < 1e-15
    assert np.linalg.norm(found.gravity_target) == pytest.approx(9.80655, abs=1e-5)
    assert list(found.residuals) == ["cam0", "imu0.gyroscope", "imu0.accelerometer"]
    assert found.notes == ("Kalibr's file holds no bias; taken: zero.",)


def test_numbers_of_one_results_file(real_data):
    found = load_foreign(real_data(f"{FULL}/data-results-imucam.txt"))
    assert found.gravity_target.tolist() == [0.20389953, -9.79086929, -0.51548653]
    assert found.cameras["cam0"].time_shift_cam_imu == 0.007005771199616974
    assert found.cameras["cam0"].T_cam_imu[:3, 3].tolist() == [0.10324981, -0.01462212, -0.00985047]
    assert found.cameras["cam0"].camera.resolution == (645, 474)  # twice the principal point, as the note says
    assert any("does not state the resolution" in note for note in found.notes)
    assert found.imus["imu0"].accelerometer.sensitivity[2].tolist() == [-0.00190121, 0.00355858, 0.99910948]
    assert found.imu_data["imu0"].lever_arms_m[1].tolist() == [0.00046254, 0.00068666, 0.0003236]
    gyro = found.residuals["imu0.gyroscope"]
    assert (gyro.normalised.median, gyro.plain.std) == (1.0879846452884898, 0.0005911525046736871)
    assert found.residuals["cam0"].plain.mean == 0.05956354086023075
    assert found.imu_data["imu0"].noise.gyroscope_random_walk == 2e-5
    full = load_foreign(real_data(f"{FULL}/data-imu.yaml")).imus["imu0"].gyroscope
    assert apart(found.imus["imu0"].gyroscope.sensitivity, full.sensitivity) < 3e-8  # eight digits


@pytest.mark.parametrize("name", OPENVINS)
def test_openvins_chains(real_data, name):
    place = real_data(f"kalibr-format-samples/openvins_{name}")
    found = load_foreign(place / "kalibr_imu_chain.yaml", place / "kalibr_imucam_chain.yaml")
    for key, stated in raw_yaml(place / "kalibr_imucam_chain.yaml").items():
        camera = found.cameras[key]
        direct = stated["T_cam_imu"] if "T_cam_imu" in stated else np.linalg.inv(stated["T_imu_cam"])
        assert apart(camera.T_cam_imu, direct) < 2e-12
        assert camera.time_shift_cam_imu == stated.get("timeshift_cam_imu", 0.0)
        assert camera.camera.parameters.tolist() == stated["intrinsics"] + stated["distortion_coeffs"]
        assert camera.camera.topic == stated["rostopic"]
        assert camera.camera.model == f"pinhole-{stated['distortion_model']}"
    imu = raw_yaml(place / "kalibr_imu_chain.yaml")["imu0"]
    assert found.imu_data["imu0"].noise.accelerometer_noise_density == imu["accelerometer_noise_density"]
    assert found.imu_data["imu0"].update_rate_hz == imu["update_rate"]
    assert np.array_equal(found.imus["imu0"].gyroscope.sensitivity, np.eye(3))
    assert found.frame == "accel-x"
    assert "OpenVINS" in found.format


@pytest.mark.parametrize("name", BASALT)
def test_basalt(real_data, name):
    path = real_data("kalibr-format-samples") / "basalt" / f"{name}_calib.json"
    found, stated = load_foreign(path), json.loads(path.read_text())["value0"]
    for i, (pose, lens) in enumerate(zip(stated["T_imu_cam"], stated["intrinsics"], strict=True)):
        camera = found.cameras[f"cam{i}"]
        T_imu_cam = np.eye(4)
        T_imu_cam[:3, :3] = rotation_from_quaternion(np.array([pose[k] for k in ("qw", "qx", "qy", "qz")]))
        T_imu_cam[:3, 3] = [pose[k] for k in ("px", "py", "pz")]
        assert apart(camera.T_cam_imu @ T_imu_cam, np.eye(4)) < 1e-12
        assert dict(zip(camera.camera.parameter_symbols, camera.camera.parameters.tolist(), strict=True)) == {
            {"fx": "fu", "fy": "fv", "cx": "pu", "cy": "pv"}.get(key, key): value
            for key, value in lens["intrinsics"].items()
        }
        assert camera.camera.model == f"{lens['camera_type']}-none"
        assert camera.camera.resolution == tuple(stated["resolution"][i])
        assert camera.time_shift_cam_imu == 0
    imu = found.imus["imu0"]
    assert imu.accelerometer.bias.tolist() == stated["calib_accel_bias"][:3]
    assert imu.gyroscope.bias.tolist() == stated["calib_gyro_bias"][:3]
    assert np.array_equal(imu.accelerometer.sensitivity, np.eye(3))
    assert found.imu_data["imu0"].noise == ImuNoise(
        accelerometer_noise_density=0.016,
        accelerometer_random_walk=0.001,
        gyroscope_noise_density=0.000282,
        gyroscope_random_walk=0.0001,
    )
    assert found.imu_data["imu0"].update_rate_hz == 200


@pytest.mark.parametrize(("basalt", "openvins"), [("tumvi_512_ds", "tum_vi"), ("euroc_ds", "euroc_mav")])
def test_two_projects_agree_on_the_same_rig(real_data, basalt, openvins):
    """The published poses of one rig, found by different people: only with the directions right are they alike."""
    samples = real_data("kalibr-format-samples")
    one = load_foreign(samples / "basalt" / f"{basalt}_calib.json").cameras
    other = load_foreign(samples / f"openvins_{openvins}" / "kalibr_imucam_chain.yaml").cameras
    for name in ("cam0", "cam1"):
        turn = one[name].T_cam_imu[:3, :3] @ other[name].T_cam_imu[:3, :3].T
        assert np.arccos((np.trace(turn) - 1) / 2) < np.radians(1)
        assert apart(one[name].T_cam_imu[:3, 3], other[name].T_cam_imu[:3, 3]) < 0.01


# ---- what they mean ----


def write(path, value):
    path.write_text(value if isinstance(value, str) else yaml.safe_dump(value))
    return path


def basalt_file(tmp_path, **changes):
    document = {
        "T_imu_cam": [{"px": 0.1, "py": 0.2, "pz": 0.3, "qx": 0.0, "qy": 0.0, "qz": 0.6, "qw": 0.8}],
        "intrinsics": [{"camera_type": "pinhole", "intrinsics": {"fx": 400, "fy": 401, "cx": 320, "cy": 240}}],
        "resolution": [[640, 480]],
        "calib_accel_bias": [0.1, -0.2, 0.3, 0.01, 0.02, 0.03, 0.04, 0.05, 0.06],
        "calib_gyro_bias": [0.01, 0.02, 0.03, *np.linspace(-0.04, 0.04, 9).tolist()],
        "imu_update_rate": 200,
        "accel_noise_std": 0.016,
        "gyro_noise_std": [1e-4, 2e-4, 3e-4],
        "accel_bias_std": [0.001] * 3,
        "gyro_bias_std": [0.0001] * 3,
        "cam_time_offset_ns": -14_800_000,
    }
    document = {key: value for key, value in {**document, **changes}.items() if value is not None}
    path = tmp_path / "calibration.json"
    path.write_text(json.dumps({"value0": document}))
    return path


def test_basalts_lists_are_columns(tmp_path):
    found = load_foreign(basalt_file(tmp_path))
    a, y = np.array([1.0, -2, 3]), np.array([0.5, 0.7, -0.3])
    S = np.array([[0.01, 0, 0], [0.02, 0.04, 0], [0.03, 0.05, 0.06]])
    imu = found.imus["imu0"]
    force = a + S @ a - [0.1, -0.2, 0.3]
    assert apart(imu.accelerometer.specific_force(a[None])[0], force) < 1e-14
    S_g = np.linspace(-0.04, 0.04, 9).reshape(3, 3).T
    rate = y + S_g @ y - [0.01, 0.02, 0.03]
    assert apart(imu.gyroscope.angular_rate(y[None], force[None])[0], rate) < 1e-14
    assert found.cameras["cam0"].time_shift_cam_imu == -0.0148
    # The camera is at (0.1, 0.2, 0.3) in the IMU's frame.
    assert apart(found.cameras["cam0"].T_cam_imu @ [0.1, 0.2, 0.3, 1], [0, 0, 0, 1]) < 1e-15
    assert apart(found.cameras["cam0"].T_cam_imu[:3, 0], [0.28, -0.96, 0]) < 1e-15  # turned by +73.7 deg about z
    noise = found.imu_data["imu0"].noise
    assert noise.accelerometer_noise_density == 0.016
    assert noise.gyroscope_noise_density == pytest.approx(np.sqrt(14 / 3) * 1e-4)
    assert any("gyro_noise_std differs from axis to axis" in note for note in found.notes)


def project_by_hand(kind, p, point):
    """Basalt's own equations."""
    x, y, z = point
    r = np.hypot(x, y)
    if kind == "ucm":
        scale = 1 / (p["alpha"] * np.sqrt(r * r + z * z) + (1 - p["alpha"]) * z)
    elif kind == "kb4":
        t = np.arctan2(r, z)
        scale = (t + p["k1"] * t**3 + p["k2"] * t**5 + p["k3"] * t**7 + p["k4"] * t**9) / r
    elif kind == "pinhole-radtan8":
        u, v = x / z, y / z
        s = u * u + v * v
        d = 1 + p["k1"] * s + p["k2"] * s * s
        return (
            p["fx"] * (u * d + 2 * p["p1"] * u * v + p["p2"] * (s + 2 * u * u)) + p["cx"],
            p["fy"] * (v * d + 2 * p["p2"] * u * v + p["p1"] * (s + 2 * v * v)) + p["cy"],
        )
    else:
        scale = 1 / z
    return p["fx"] * x * scale + p["cx"], p["fy"] * y * scale + p["cy"]


@pytest.mark.parametrize(
    ("kind", "own", "model"),
    [
        ("pinhole", {}, "pinhole-none"),
        ("ucm", {"alpha": 0.55}, "omni-none"),
        ("kb4", {"k1": 0.01, "k2": -0.02, "k3": 0.005, "k4": -0.001}, "pinhole-equidistant"),
        ("pinhole-radtan8", {"k1": -0.28, "k2": 0.07, "p1": 2e-4, "p2": -1e-4, "k3": 0, "k4": 0, "k5": 0, "k6": 0},
         "pinhole-radtan"),
    ],
)  # fmt: skip
def test_basalts_cameras_see_the_same(tmp_path, kind, own, model):
    parameters = {"fx": 400.0, "fy": 401.0, "cx": 320.0, "cy": 240.0, **own}
    lens = [{"camera_type": kind, "intrinsics": parameters}]
    camera = load_foreign(basalt_file(tmp_path, intrinsics=lens)).cameras["cam0"].camera
    assert camera.model == model
    points = np.random.default_rng(0).uniform([-0.5, -0.4, 0.8], [0.5, 0.4, 1.5], (20, 3))
    expected = [project_by_hand(kind, parameters, point) for point in points]
    assert apart(camera.project(points).pixels, expected) < 1e-11


OPENVINS_IMU = {
    "imu0": {
        "model": "kalibr",
        "Tw": [[1.002, 0, 0], [0.003, 0.999, 0], [-0.002, -0.004, 1.001]],
        "R_IMUtoGYRO": [[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]],
        "Ta": [[1.001, 0, 0], [0.005, 1.0008, 0], [-0.0017, 0.0026, 0.9986]],
        "R_IMUtoACC": np.eye(3).tolist(),
        "Tg": [[0.01, 0.02, 0.03], [0.04, 0.05, 0.06], [0.07, 0.08, 0.09]],
    }
}


def openvins_corrected(imu, accel, gyro, upper):
    """OpenVINS' own arithmetic: it keeps one triangle of the inverse."""
    keep = np.triu if upper else np.tril
    Da, Dw = (keep(np.linalg.inv(imu[key])) for key in ("Ta", "Tw"))
    force = np.transpose(imu["R_IMUtoACC"]) @ Da @ accel
    return force, np.transpose(imu["R_IMUtoGYRO"]) @ Dw @ (gyro - np.array(imu["Tg"]) @ force)


@pytest.mark.parametrize("model", ["kalibr", "calibrated", "rpng"])
@pytest.mark.parametrize("full", [False, True])
def test_openvins_imu_means_what_openvins_does(tmp_path, model, full):
    imu = {**OPENVINS_IMU["imu0"], "model": model}
    if model == "rpng":  # upper triangular, and the accelerometer is turned
        imu |= {key: np.transpose(imu[key]).tolist() for key in ("Ta", "Tw")}
        imu |= {"R_IMUtoACC": imu["R_IMUtoGYRO"], "R_IMUtoGYRO": np.eye(3).tolist()}
    if full:
        imu |= {key: (np.array(imu[key]) + 0.01).tolist() for key in ("Ta", "Tw")}
    found = load_foreign(write(tmp_path / "imu.yaml", {"imu0": imu}))
    accel, gyro = np.array([1.0, -2, 9]), np.array([0.3, 0.1, -2])
    force, rate = openvins_corrected(imu, accel, gyro, model == "rpng")
    calibrated = found.imus["imu0"]
    assert apart(calibrated.accelerometer.specific_force(accel[None])[0], force) < 1e-13
    assert apart(calibrated.gyroscope.angular_rate(gyro[None], force[None])[0], rate) < 1e-13
    assert full == any("OpenVINS passes over" in note for note in found.notes)
    assert found.frame == ("user" if model == "rpng" else "accel-x")


def test_openvins_keys_that_are_missing_are_noted(tmp_path):
    imu = {key: value for key, value in OPENVINS_IMU["imu0"].items() if key not in {"Tg", "R_IMUtoACC"}}
    found = load_foreign(write(tmp_path / "imu.yaml", {"imu0": imu}))
    assert not found.imus["imu0"].gyroscope.g_sensitivity.any()
    assert any("Tg, R_IMUtoACC of imu0 are missing" in note for note in found.notes)
    assert found.imu_data["imu0"].noise is None


def test_kalibrs_imu_without_its_model_and_with_more_of_everything(tmp_path):
    accel = {"M": np.diag([1.0, 2, 3]).tolist(), "rz_i": [1, 2, 3], "colour": "red"}
    gyro = {"M": np.eye(3).tolist(), "A": np.zeros((3, 3)).tolist(), "C_gyro_i": np.eye(3).ravel().tolist(), "x": 1}
    imu = {"accelerometers": accel, "gyroscopes": gyro, "wheel": 1, "gyroscope_noise_density": 1e-4}
    found = load_foreign(write(tmp_path / "imu.yaml", {"imu0": imu, "imu1": {**imu, "T_i_b": np.eye(4).tolist()}}))
    assert np.array_equal(found.imus["imu1"].accelerometer.sensitivity, np.diag([1, 2, 3]))
    assert found.imu_data["imu0"].lever_arms_m.tolist() == [[0, 0, 0], [0, 0, 0], [1, 2, 3]]
    assert found.imu_data["imu0"].T_imu_body is None
    for word in ("imu0.wheel", "imu0.accelerometers.colour", "imu1.gyroscopes.x", "the noise of imu0 is incomplete"):
        assert any(word in note for note in found.notes), word


def test_noise_alone_is_no_sensor_model(real_data):
    found = load_foreign(real_data("rendered-camimu/a-aprilgrid-full/imu.yaml"))
    assert not found.imus
    assert found.imu_data["imu0"].noise.accelerometer_random_walk == 0.0012


def test_lenses_without_a_pose(real_data):
    found = load_foreign(real_data("rendered-camimu/a-aprilgrid-full/camchain.yaml"))
    assert not found.cameras
    assert found.lenses["cam0"].intrinsics.tolist() == [460.0, 458.5, 322.4, 237.1]
    table = foreign_tables(found)[-1]
    assert [row.value for row in table.rows[:2]] == ["460", "458.5"]
    assert table.rows[-1].value == "640 x 480"


# ---- wrong files ----


def changed(node, keys, value):
    copy = json.loads(json.dumps(node))
    place = copy
    for key in keys[:-1]:
        place = place[key]
    place[keys[-1]] = value
    return copy


KALIBR_IMU = {
    "imu0": {
        "model": "scale-misalignment",
        "accelerometers": {"M": [[1.0, 0, 0], [0.01, 1.0, 0], [0.02, 0.03, 1.0]]},
        "gyroscopes": {"M": np.eye(3).tolist(), "A": np.zeros((3, 3)).tolist(), "C_gyro_i": np.eye(3).tolist()},
    }
}


@pytest.mark.parametrize(
    ("keys", "value", "message"),
    [
        (("model",), "other", r'imu0\.model: found "other"'),
        (("accelerometers", "M"), np.transpose(KALIBR_IMU["imu0"]["accelerometers"]["M"]).tolist(),
         r"imu0\.accelerometers\.M: Kalibr's M is lower triangular, this is upper.*It seems to be transposed"),
        (("accelerometers", "M"), np.zeros((3, 3)).tolist(), r"imu0\.accelerometers\.M: this matrix is singular"),
        (("accelerometers", "M"), [[1, 0, 0], [0, 1, 0]], r"found 2 rows, expected 3"),
        (("accelerometers", "M"), [[1, 0, 0], [0, "one", 0], [0, 0, 1]], r'M\[1\]\[1\]: found the text "one"'),
        (("accelerometers",), {}, r"the key M is missing"),
        (("accelerometers",), None, r"imu0\.accelerometers: found nothing, expected keys and values"),
        (("gyroscopes", "C_gyro_i"), np.diag([1, 1, -1]).tolist(), r"C_gyro_i: this is mirrored"),
        (("gyroscopes", "C_gyro_i"), (2 * np.eye(3)).tolist(), r"C_gyro_i: this is no rotation matrix"),
        (("gyroscopes", "A"), "none", r"gyroscopes\.A: found text, expected a list"),
        (("T_i_b",), np.transpose([[1, 0, 0, 1], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]).tolist(),
         r"T_i_b: the last row.*It seems to be transposed"),
        (("update_rate",), "fast", r'update_rate: found the text "fast"'),
    ],
)  # fmt: skip
def test_bad_imu_of_kalibrs(tmp_path, keys, value, message):
    path = write(tmp_path / "imu.yaml", changed(KALIBR_IMU, ("imu0", *keys), value))
    with pytest.raises(FormatError, match=message) as caught:
        load_foreign(path)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize(
    ("keys", "value", "message"),
    [
        (("model",), "other", r'imu0\.model: found "other"'),
        (("Tw",), np.zeros((3, 3)).tolist(), r"imu0\.Tw: this matrix is singular"),
        (("R_IMUtoGYRO",), np.diag([1, -1, 1]).tolist(), r"R_IMUtoGYRO: this is mirrored"),
        (("Tg",), [1, 2, 3], r"Tg: found 3 rows|Tg\[0\]: found 1, expected a list"),
    ],
)
def test_bad_imu_of_openvins(tmp_path, keys, value, message):
    with pytest.raises(FormatError, match=message):
        load_foreign(write(tmp_path / "imu.yaml", changed(OPENVINS_IMU, ("imu0", *keys), value)))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"calib_accel_bias": [0] * 12}, r"value0\.calib_accel_bias: found 12 numbers, expected 9"),
        ({"calib_gyro_bias": ["x"] * 12}, r'calib_gyro_bias\[0\]: found the text "x"'),
        ({"calib_accel_bias": [0, 0, 0, -1, 0, 0, 0, 0, 0]}, r"the three axes do not measure three directions"),
        ({"resolution": [[640, 480], [640, 480]]}, r"found 1 poses .*, 1 intrinsics and 2 resolutions"),
        ({"resolution": None}, r"the key resolution is missing"),
        ({"intrinsics": [{"camera_type": "fisheye", "intrinsics": {}}]}, r'camera_type: found "fisheye"'),
        ({"intrinsics": [{"camera_type": "ds", "intrinsics": {"fx": 1, "fy": 1, "cx": 1, "cy": 1, "xi": 0}}]},
         r"the key alpha is missing"),
        ({"intrinsics": [{"camera_type": "ucm", "intrinsics": {"fx": 1, "fy": 1, "cx": 1, "cy": 1, "alpha": 1}}]},
         r"alpha 1 of ucm is out of range"),
        ({"T_imu_cam": [{"px": 0, "py": 0, "pz": 0, "qx": 0, "qy": 0, "qz": 0, "qw": 0}]}, r"has length 0, expected 1"),
        ({"T_imu_cam": [{"px": 0, "py": 0, "qx": 0, "qy": 0, "qz": 0, "qw": 1}]}, r"the key pz is missing"),
        ({"T_imu_cam": None}, r"no calibration file that gnomon knows"),
    ],
)  # fmt: skip
def test_bad_basalt(tmp_path, changes, message):
    path = basalt_file(tmp_path, **changes)
    with pytest.raises(FormatError, match=message) as caught:
        load_foreign(path)
    assert str(path) in str(caught.value)


def test_radtan_of_eight_coefficients(tmp_path):
    own = dict.fromkeys(("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"), 0.1)
    lens = [{"camera_type": "pinhole-radtan8", "intrinsics": {"fx": 400, "fy": 400, "cx": 320, "cy": 240, **own}}]
    with pytest.raises(FormatError, match="k4 to k6 are not all zero"):
        load_foreign(basalt_file(tmp_path, intrinsics=lens))


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("", "no calibration file that gnomon knows. Readable are Kalibr's camchain.yaml"),
        ("hello\n", "no calibration file"),
        ("a: 1\nb: 2\n", "no calibration file"),
        ('{"a": 1}', "no calibration file"),
        ("{", "line 1: this is not JSON"),
        ("1 2 3\n", "no calibration file"),
        ("a: [1\n", "this is not YAML"),
        ("t,x,y\n1,2,3\n", "no calibration file"),
        ("Calibration results\n===\nT_ci:  (imu0 to cam0): \n[[1 2\n", "line 4: expected an array of 16 numbers"),
    ],
)
def test_other_files(tmp_path, content, message):
    path = write(tmp_path / "file", content)
    with pytest.raises(FormatError, match=message) as caught:
        load_foreign(path)
    assert str(path) in str(caught.value)


def test_binary_and_missing_files(tmp_path):
    (tmp_path / "x").write_bytes(b"\x89PNG\x00\xff\xfe")
    for path, message in (
        (tmp_path / "x", "no text file"),
        (tmp_path / "y", "there is no such file"),
        (tmp_path, "this is a folder"),
    ):
        with pytest.raises(FormatError, match=message):
            load_foreign(path)


def test_gnomons_own_file_is_told_apart(tmp_path, camera_calibration):
    path = write(tmp_path / "calibration.yaml", calibration_text(camera_calibration()))
    assert is_own(path)
    with pytest.raises(FormatError, match=r"this is gnomon's own calibration. Read it with gnomon\.load"):
        load_foreign(path)
    assert not is_own(write(tmp_path / "imu.yaml", KALIBR_IMU))


def test_two_files_of_one_sensor(tmp_path):
    one, other = write(tmp_path / "a.yaml", KALIBR_IMU), write(tmp_path / "b.yaml", KALIBR_IMU)
    with pytest.raises(FormatError, match=r"b\.yaml and .*a\.yaml both describe imu0. Give one of them"):
        load_foreign(one, other)


def broken(text):
    yield text.replace("[ 0.99757817 -0.05971287 -0.03566738 -0.00985047]", "[ 0.99757817 -0.05971287]"), "16 numbers"
    yield text.replace("0.007005771199616974\n", "soon\n"), r"found 'soon', expected a number"
    yield text.replace("  Camera model: pinhole\n", ""), "the configuration of cam0 is missing"
    yield text.replace("Camera model: pinhole", "Camera model: fish"), 'camera_model: found "fish"'
    mirrored = text.replace("-0.05858028 -0.99776975  0.03199804  0.103", "0.05858028 0.99776975 -0.03199804  0.103")
    yield mirrored, "mirrored"
    yield (
        text.replace("[[ 0.99984417  0.01765321  0.00000648]", "[[ 1.99984417  0.01765321  0.00000648]"),
        "no rotation",
    )
    yield text.replace("Update rate: 200.0", "Update rate: often"), "found 'often', expected a number"


@pytest.mark.parametrize("case", range(7))
def test_broken_results(real_data, tmp_path, case):
    text = real_data(f"{FULL}/data-results-imucam.txt").read_text()
    changed_text, message = list(broken(text))[case]
    assert changed_text != text
    with pytest.raises(FormatError, match=message):
        load_foreign(write(tmp_path / "results-imucam.txt", changed_text))


def test_results_that_end_early(real_data, tmp_path):
    """Whatever line a file is cut off at: it is read as far as it goes, or refused with a word, never a traceback."""
    lines = real_data(f"{FULL}/data-results-imucam.txt").read_text().splitlines()
    refused = []
    for count in range(1, len(lines)):
        try:
            load_foreign(write(tmp_path / "results-imucam.txt", "\n".join(lines[:count])))
        except FormatError as error:
            refused.append(str(error))
    assert 10 < len(refused) < len(lines) - 10
    assert all("results-imucam.txt" in message for message in refused)
