"""Kalibr's input files: what is read from them, what is passed over, and how what is wrong is refused."""

import re
from dataclasses import asdict

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from gnomon.errors import FormatError
from gnomon.formats.kalibr.camchain import read_camchain
from gnomon.formats.kalibr.imu import read_imu_input
from gnomon.formats.kalibr.target import read_target
from gnomon.geometry.rotations import rotation_from_rotvec

CAM = {
    "camera_model": "pinhole",
    "intrinsics": [460, 458.5, 322.4, 237.1],
    "distortion_model": "radtan",
    "distortion_coeffs": [-0.28, 0.075, 0.0002, -0.00015],
    "resolution": [640, 480],
}
NOISE = {
    "accelerometer_noise_density": 0.0039,
    "accelerometer_random_walk": 0.0012,
    "gyroscope_noise_density": 8.73e-5,
    "gyroscope_random_walk": 2e-5,
}
APRIL = {"target_type": "aprilgrid", "tagCols": 6, "tagRows": 6, "tagSize": 0.088, "tagSpacing": 0.3}


def transformation(rotvec=(0.3, -1.2, 0.7), translation=(0.1, -0.015, -0.01)):
    T = np.eye(4)
    T[:3, :3] = rotation_from_rotvec(np.array(rotvec))
    T[:3, 3] = translation
    return T


def apart(first, second) -> float:
    return float(np.abs(first - second).max())


@pytest.fixture
def write(tmp_path):
    def make(content, name="file.yaml"):
        path = tmp_path / name
        path.write_text(content if isinstance(content, str) else yaml.safe_dump(content))
        return path

    return make


@pytest.fixture
def camera(write):
    """Return a function that reads one camera whose keys are changed; a key that is None is left out."""

    def make(notes=None, **changes):
        keys = {key: value for key, value in {**CAM, **changes}.items() if value is not None}
        return read_camchain(write({"cam0": keys}, "camchain.yaml"), notes)["cam0"]

    return make


@pytest.fixture
def board(write):
    def make(content=APRIL, notes=None, **changes):
        keys = {key: value for key, value in {**content, **changes}.items() if value is not None}
        return read_target(write(keys, "target.yaml"), notes)

    return make


# ---- the samples ----


@pytest.mark.parametrize(
    ("folder", "cameras", "distortion"),
    [
        ("openvins_euroc_mav", 2, "radtan"),
        ("openvins_kaist_vio", 2, "radtan"),
        ("openvins_rpng_sim", 4, "radtan"),
        ("openvins_rs_d455", 1, "radtan"),
        ("openvins_tum_vi", 2, "equidistant"),
        ("openvins_uzhfpv_indoor_45", 2, "equidistant"),
    ],
)
def test_openvins_files(real_data, folder, cameras, distortion) -> None:
    notes: list[str] = []
    path = real_data(f"kalibr-format-samples/{folder}")
    chain = read_camchain(path / "kalibr_imucam_chain.yaml", notes)
    assert list(chain) == [f"cam{i}" for i in range(cameras)]
    assert {item.camera.distortion for item in chain.values()} == {distortion}
    for item in chain.values():
        assert item.T_cam_imu is not None
        assert apart(item.T_cam_imu[:3, :3] @ item.T_cam_imu[:3, :3].T, np.eye(3)) < 1e-12
    assert notes == []
    imu = read_imu_input(path / "kalibr_imu_chain.yaml", notes)["imu0"]
    assert imu.update_rate_hz in {100, 200, 400, 500}
    assert imu.topic.startswith("/")
    assert len(notes) == 1
    assert "Tw" in notes[0]


def test_openvins_inverse_is_kalibrs_direction(real_data) -> None:
    chain = read_camchain(real_data("kalibr-format-samples/openvins_euroc_mav") / "kalibr_imucam_chain.yaml")
    T = chain["cam0"].T_cam_imu
    assert np.linalg.inv(T)[:3, 3] == pytest.approx([-0.0216401454975, -0.064676986768, 0.00981073058949])
    assert chain["cam0"].time_shift_cam_imu_s is None


def test_stated_time_shift(real_data) -> None:
    chain = read_camchain(real_data("kalibr-format-samples/openvins_uzhfpv_indoor_45") / "kalibr_imucam_chain.yaml")
    assert chain["cam0"].time_shift_cam_imu_s == -0.01484888826656275


def test_rendered_inputs_and_kalibrs_outputs(real_data) -> None:
    folder = real_data("rendered-camimu")
    chains = [*folder.glob("*/camchain.yaml"), *folder.glob("*/kalibr/*/data-camchain-imucam.yaml")]
    noises = [*folder.glob("*/imu.yaml"), *folder.glob("*/kalibr/*/data-imu.yaml")]
    assert len(chains) == len(noises) == 9
    for path in chains:
        item = read_camchain(path)["cam0"]
        assert item.camera.intrinsics.tolist() == CAM["intrinsics"]
        assert item.camera.topic == "/cam0/image_raw"
        assert (item.T_cam_imu is None) == (path.name == "camchain.yaml")
        assert (item.time_shift_cam_imu_s is None) == (path.name == "camchain.yaml")
    for path in noises:
        notes: list[str] = []
        assert read_imu_input(path, notes)["imu0"].noise.gyroscope_noise_density == 8.73e-5
        assert bool(notes) == ("accelerometers" in path.read_text())
    for path in folder.glob("*/target.yaml"):
        target, rows = read_target(path), (path.parent / "target_points.csv").read_text().split()[1:]
        stated = np.array([[float(x) for x in row.split(",")] for row in rows])
        assert apart(target.points, stated[:, 1:]) < 1e-6


# ---- camchain.yaml ----


@pytest.mark.parametrize(
    ("model", "intrinsics", "expected"),
    [
        ("Pinhole", [460, 458.5, 322.4, 237.1], "pinhole"),
        ("omni", [1.2, 460, 458.5, 322.4, 237.1], "omni"),
        ("MEI", [1.2, 460, 458.5, 322.4, 237.1], "omni"),
        ("eucm", [0.6, 1.1, 460, 458.5, 322.4, 237.1], "eucm"),
        ("ds", [-0.2, 0.6, 460, 458.5, 322.4, 237.1], "ds"),
        ("double_sphere", [-0.2, 0.6, 460, 458.5, 322.4, 237.1], "ds"),
        ("double-sphere", [-0.2, 0.6, 460, 458.5, 322.4, 237.1], "ds"),
    ],
)
def test_names_of_projections(camera, model, intrinsics, expected) -> None:
    item = camera(camera_model=model, intrinsics=intrinsics)
    assert item.camera.projection == expected
    assert item.camera.intrinsics.tolist() == intrinsics


@pytest.mark.parametrize(
    ("name", "coeffs", "expected"),
    [
        ("plumb_bob", [0.1, 0, 0, 0], "radtan"),
        ("radial-tangential", [0.1, 0, 0, 0], "radtan"),
        ("RadTan", [0.1, 0, 0, 0], "radtan"),
        ("equi", [0.1, 0, 0, 0], "equidistant"),
        ("Equidistant", [0.1, 0, 0, 0], "equidistant"),
        ("FOV", [0.9], "fov"),
        ("none", [], "none"),
        ("none", None, "none"),
        ("None", [0, 0, 0, 0], "none"),
    ],
)
def test_names_of_distortions(camera, name, coeffs, expected) -> None:
    item = camera(distortion_model=name, distortion_coeffs=coeffs)
    assert item.camera.distortion == expected
    assert item.camera.distortion_coeffs.tolist() == (coeffs or [] if expected != "none" else [])


def test_both_models_in_one_word(camera) -> None:
    item = camera(camera_model="pinhole-equi", distortion_model=None)
    assert (item.camera.projection, item.camera.distortion) == ("pinhole", "equidistant")


def test_double_sphere_needs_no_distortion(camera) -> None:
    item = camera(
        camera_model="ds", intrinsics=[-0.2, 0.6, 460, 458, 322, 237], distortion_model=None, distortion_coeffs=None
    )
    assert item.camera.distortion == "none"


def test_fifth_coefficient_of_plumb_bob(camera) -> None:
    notes: list[str] = []
    item = camera(notes, distortion_model="plumb_bob", distortion_coeffs=[-0.28, 0.075, 0.0002, -0.00015, 0])
    assert item.camera.distortion_coeffs.tolist() == CAM["distortion_coeffs"]
    assert "cam0.distortion_coeffs" in notes[0]
    with pytest.raises(FormatError, match=r"cam0\.distortion_coeffs: found 5 coefficients, of which 0\.01 is k3"):
        camera(distortion_coeffs=[-0.28, 0.075, 0.0002, -0.00015, 0.01])


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"camera_model": None}, r"cam0: the key camera_model is missing"),
        ({"camera_model": "fisheye"}, r'cam0\.camera_model: found "fisheye", expected one of pinhole, omni, eucm, ds'),
        ({"camera_model": None, "cameraModel": "pinhole"}, r"Found cameraModel: was camera_model meant\?"),
        ({"intrinsics": None}, r"the key intrinsics is missing\. Expected fu fv pu pv of pinhole"),
        ({"intrinsics": [460, 458, 322]}, r"cam0\.intrinsics: found 3 numbers, expected 4 for pinhole: fu fv pu pv"),
        ({"intrinsics": [460, "x", 322, 237]}, r'cam0\.intrinsics\[1\]: found the text "x", expected a number'),
        ({"intrinsics": [-460, 458, 322, 237]}, r"cam0\.intrinsics: found focal lengths -460 and 458"),
        ({"intrinsics": [460, float("nan"), 322, 237]}, r"cam0\.intrinsics\[1\]: found nan, expected a finite number"),
        ({"camera_model": "omni"}, r"found 4 numbers, expected 5 for omni: xi fu fv pu pv"),
        ({"distortion_model": None}, r"cam0: the key distortion_model is missing"),
        ({"distortion_model": "rational"}, r'found "rational", expected one of none, radtan, equidistant, fov'),
        ({"distortion_coeffs": None}, r"the key distortion_coeffs is missing\. Expected k1 k2 p1 p2 of radtan"),
        ({"distortion_coeffs": [0.1, 0.2]}, r"cam0\.distortion_coeffs: found 2 numbers, expected 4 for radtan"),
        ({"distortion_model": "none"}, r"found coefficients, but distortion_model is none"),
        ({"resolution": None}, r"the key resolution is missing\. Expected \[width, height\]"),
        ({"resolution": [640]}, r"cam0\.resolution: found \[640\], expected \[width, height\] in pixels"),
        ({"resolution": [640, 0]}, r"expected \[width, height\] in pixels"),
        ({"resolution": [640.5, 480]}, r"cam0\.resolution\[0\]: found 640\.5, expected a whole number"),
        ({"line_delay": 0.02}, r"cam0\.line_delay: found 0\.02 s from one row to the next, which is 9\.6 s"),
        ({"timeshift_cam_imu": "soon"}, r'cam0\.timeshift_cam_imu: found the text "soon", expected a number'),
        ({"timeshift_cam_imu": 1e30}, r"cam0\.timeshift_cam_imu: found 1e\+30 s, expected t_imu - t_cam"),
        ({"camera_model": "ds", "intrinsics": [-0.2, 3, 460, 458, 322, 237]}, r"cam0: .*alpha"),
    ],
)
def test_bad_camera(camera, changes, message) -> None:
    with pytest.raises(FormatError, match=message) as caught:
        camera(**changes)
    assert "camchain.yaml" in str(caught.value)


def test_rolling_shutter(camera) -> None:
    assert camera(line_delay=2e-5).camera.line_delay_s == 2e-5
    assert camera().camera.line_delay_s == 0


def test_unknown_keys_are_passed_over_with_a_note(write) -> None:
    notes: list[str] = []
    chain = {"cam0": {**CAM, "cam_overlaps": [], "rostopic": "/cam0", "colour": "red"}, "date": "today"}
    assert read_camchain(write(chain, "camchain.yaml"), notes)["cam0"].camera.topic == "/cam0"
    assert notes == ["camchain.yaml: date was passed over.", "camchain.yaml: cam0.colour was passed over."]


def test_principal_point_outside_the_image_is_noted(camera) -> None:
    notes: list[str] = []
    camera(notes, resolution=[320, 240])
    assert "principal point of cam0, 322.4 237.1, lies outside the image of 320 x 240 px" in notes[0]


def test_one_camera_without_its_name(write) -> None:
    assert list(read_camchain(write(CAM))) == ["cam0"]


def test_order_of_cameras_is_that_of_their_numbers(write) -> None:
    assert list(read_camchain(write({"cam10": CAM, "cam2": CAM, "cam0": CAM}))) == ["cam0", "cam2", "cam10"]


@pytest.mark.parametrize(
    ("content", "hint"),
    [
        (APRIL, "a target, which belongs to --target"),
        (NOISE, "the noise of an IMU, which belongs to --imu"),
        ({"imu0": NOISE}, "the noise of an IMU, which belongs to --imu"),
        ({}, "the key cam0 is missing"),
    ],
)
def test_another_file_in_the_place_of_the_cameras(write, content, hint) -> None:
    with pytest.raises(FormatError, match=re.escape(hint)):
        read_camchain(write(content))


def test_no_mapping_and_no_file(write, tmp_path) -> None:
    for content in ("", "- 1\n", "just text\n"):
        with pytest.raises(FormatError, match="expected keys and values"):
            read_camchain(write(content))
    with pytest.raises(FormatError, match=r"nowhere\.yaml: there is no such file"):
        read_camchain(tmp_path / "nowhere.yaml")
    with pytest.raises(FormatError, match="stands here twice"):
        read_camchain(write("cam0:\n  resolution: [1, 2]\n  resolution: [1, 2]\n"))


# ---- extrinsics ----


def test_guess_in_either_direction(camera) -> None:
    T = transformation()
    assert apart(camera(T_cam_imu=T.tolist()).T_cam_imu, T) < 1e-12
    assert apart(camera(T_cam_imu=T.ravel().tolist()).T_cam_imu, T) < 1e-12
    assert apart(camera(T_imu_cam=np.linalg.inv(T).tolist()).T_cam_imu, T) < 1e-12
    assert apart(camera(T_cam_imu=T.tolist(), T_imu_cam=np.linalg.inv(T).tolist()).T_cam_imu, T) < 1e-12
    with pytest.raises(FormatError, match=r"cam0\.T_imu_cam: this is not the inverse of T_cam_imu"):
        camera(T_cam_imu=T.tolist(), T_imu_cam=T.tolist())


def test_rounded_rotation_is_made_exact(camera) -> None:
    T = transformation()
    found = camera(T_cam_imu=np.round(T, 3).tolist()).T_cam_imu
    assert apart(found, T) < 1e-3
    assert apart(found[:3, :3] @ found[:3, :3].T, np.eye(3)) < 1e-14


@pytest.mark.parametrize("key", ["T_cam_imu", "T_imu_cam"])
@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda T: T.T, r"the last row of the matrix is .*It seems to be transposed"),
        (lambda T: T @ np.diag([1, 1, -1, 1]), r"mirrored \(determinant -1\)"),
        (lambda T: T * 1.1, r"the last row of the matrix is \[0\.0, 0\.0, 0\.0, 1\.1\], expected \[0, 0, 0, 1\]"),
        (lambda T: T @ np.diag([1.1, 1.1, 1.1, 1]), r"no rotation matrix: .* miss that by 0\.21"),
        (lambda T: np.zeros((4, 4)), r"the last row"),
        (lambda T: T + 1e30 * (np.eye(4) - np.diag([0, 0, 0, 1])), r"no rotation matrix"),
        (lambda T: T + 1e3 * np.eye(4)[:, :1] * np.eye(4)[3], r"found the translation .* metre"),
        (lambda T: T[:3], r"found 3 rows, expected 4"),
        (lambda T: T[:, :3], r"\[0\]: found 3 numbers, expected 4"),
    ],
)
def test_no_rigid_transformation(camera, key, change, message) -> None:
    with pytest.raises(FormatError, match=rf"cam0\.{key}.*{message}"):
        camera(**{key: change(transformation()).tolist()})


def test_guess_is_carried_along_the_chain(write) -> None:
    T, link = transformation(), transformation((0.01, 0.02, 0), (-0.11, 0, 0))
    first = {**CAM, "T_cam_imu": T.tolist(), "timeshift_cam_imu": 0.007}
    others = {**CAM, "T_cn_cnm1": link.tolist()}
    chain = read_camchain(write({"cam0": first, "cam1": others, "cam2": others}))
    assert apart(chain["cam1"].T_cam_imu, link @ T) < 1e-12
    assert apart(chain["cam2"].T_cam_imu, link @ link @ T) < 1e-12
    assert [chain[name].time_shift_cam_imu_s for name in chain] == [0.007, None, None]
    assert read_camchain(write({"cam0": CAM, "cam1": others}))["cam1"].T_cam_imu is None


def test_chain_that_contradicts_the_extrinsics_is_noted(write) -> None:
    T, link = transformation(), transformation((0.01, 0.02, 0), (-0.11, 0, 0))
    own = {**CAM, "T_cam_imu": T.tolist()}
    notes: list[str] = []
    chain = read_camchain(write({"cam0": own, "cam1": {**own, "T_cn_cnm1": link.tolist()}}), notes)
    assert apart(chain["cam1"].T_cam_imu, T) < 1e-12
    assert "T_cam_imu and T_cn_cnm1 of cam1 contradict" in notes[0]
    notes.clear()
    read_camchain(write({"cam0": {**CAM, "T_cn_cnm1": link.tolist()}}, "camchain.yaml"), notes)
    assert notes == ["camchain.yaml: cam0.T_cn_cnm1 was passed over."]


@given(rotvec=st.tuples(*[st.floats(-3, 3)] * 3), translation=st.tuples(*[st.floats(-5, 5)] * 3))
def test_any_rigid_transformation_survives_the_file(tmp_path_factory, rotvec, translation) -> None:
    T = transformation(rotvec, translation)
    path = tmp_path_factory.mktemp("chain") / "camchain.yaml"
    path.write_text(yaml.safe_dump({"cam0": {**CAM, "T_imu_cam": np.linalg.inv(T).tolist()}}))
    assert apart(read_camchain(path)["cam0"].T_cam_imu, T) < 1e-9


# ---- imu.yaml ----


def test_flat_and_keyed_imu(write) -> None:
    flat = read_imu_input(write({**NOISE, "update_rate": 200, "rostopic": "/imu0"}))
    keyed = read_imu_input(write({"imu0": {**NOISE, "update_rate": 200.0, "rostopic": "/imu0"}}))
    assert flat.keys() == keyed.keys()
    assert asdict(flat["imu0"]) == asdict(keyed["imu0"])
    assert flat["imu0"].noise.accelerometer_random_walk == 0.0012
    assert (flat["imu0"].update_rate_hz, flat["imu0"].topic) == (200.0, "/imu0")


def test_numbers_that_yaml_takes_for_text(write) -> None:
    text = "".join(f"{key}: 2e-3\n" for key in NOISE)
    assert read_imu_input(write(text))["imu0"].noise.gyroscope_noise_density == 2e-3


def test_several_imus_and_euroc_sensor_file(write) -> None:
    notes: list[str] = []
    found = read_imu_input(write({"imu0": NOISE, "imu1": {**NOISE, "rate_hz": 100}}), notes)
    assert [item.update_rate_hz for item in found.values()] == [None, 100]
    assert notes == []
    found = read_imu_input(write({"sensor_type": "imu", "T_BS": {"rows": 4}, "rate_hz": 200, **NOISE}), notes)
    assert found["imu0"].update_rate_hz == 200
    assert notes == ["file.yaml: T_BS, sensor_type were passed over."]


def test_what_an_imu_file_holds_besides(write) -> None:
    notes: list[str] = []
    extra = {"time_offset": 0.003, "model": "scale-misalignment", "gyroscopes": {"M": 1}, "T_i_b": [], "wheel": 1}
    read_imu_input(write({"imu0": {**NOISE, **extra}}, "imu.yaml"), notes)
    assert notes == [
        "imu.yaml: the sensor model in it (gyroscopes) was passed over; it is estimated anew.",
        "imu.yaml: imu0.time_offset was passed over.",
        "imu.yaml: imu0.wheel was passed over.",
    ]


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (
            {k: v for k, v in NOISE.items() if "gyroscope_random" not in k} | {"x": 1},
            "gyroscope_random_walk is missing",
        ),
        ({**NOISE, "gyroscope_random_walk": 0}, "gyroscope_random_walk: found 0, expected a number greater than zero"),
        ({**NOISE, "gyroscope_random_walk": -1}, "found -1, expected a number greater than zero"),
        ({**NOISE, "gyroscope_random_walk": "high"}, 'found the text "high", expected a number'),
        ({**NOISE, "gyroscope_random_walk": float("inf")}, "found inf, expected a finite number"),
        ({**NOISE, "update_rate": 0}, "update_rate: found 0"),
        (
            {"imu0": {"rostopic": "/imu0"}},
            "imu0: the key accelerometer_noise_density is missing. Expected a number in m/s",
        ),
        (APRIL, "This seems to be a target, which belongs to --target"),
        ({"cam0": CAM}, "This seems to be a chain of cameras, which belongs to --cam"),
    ],
)
def test_bad_imu(write, content, message) -> None:
    with pytest.raises(FormatError, match=re.escape(message)):
        read_imu_input(write(content))


# ---- target.yaml ----


@pytest.mark.parametrize("kind", ["aprilgrid", "Aprilgrid", "april_grid", "APRILGRID"])
def test_aprilgrid(board, kind) -> None:
    notes: list[str] = []
    target = board(notes=notes, target_type=kind, tagCols=7, tagRows=6.0, codeOffset=0)
    assert (target.kind, target.tags, len(target.points)) == ("aprilgrid", 42, 168)
    assert target.points[1, 0] == 0.088
    assert notes == []


def test_checkerboard_and_circles(board) -> None:
    keys = {"target_type": "checkerboard", "targetCols": 7, "targetRows": 6}
    target = board(keys, rowSpacingMeters=0.08, colSpacingMeters=0.09)
    assert target.points[[1, 7]].tolist() == [[0, 0.09, 0], [0.08, 0, 0]]
    keys = {"target_type": "circlegrid", "targetCols": 4, "targetRows": 11, "spacingMeters": 0.02}
    assert not board(keys).asymmetric
    assert not board(keys, asymmetricGrid=0).asymmetric
    assert board(keys, asymmetricGrid=True).asymmetric
    with pytest.raises(FormatError, match="asymmetricGrid: found 'maybe', expected true or false"):
        board(keys, asymmetricGrid="maybe")


def test_odd_but_possible_targets_are_noted(board) -> None:
    notes: list[str] = []
    board(notes=notes, tagSpacing=0.0264, colour="black", tagFamily="tag25h9")
    assert len(notes) == 3
    assert "tagFamily is tag25h9; in images, only tags of 36h11 are found" in notes[0]
    assert "tagSpacing 0.0264 is unusual" in notes[1]
    assert notes[2] == "target.yaml: colour was passed over."


@pytest.mark.parametrize("key", ["codeOffset", "firstTag"])
def test_plain_tags_and_the_first_id(board, key) -> None:
    notes: list[str] = []
    target = board(notes=notes, tagBorderBits=1, tagFamily="tag36h11", **{key: 12})
    assert (target.border_bits, target.first_tag) == (1, 12)
    assert notes == []
    assert (board().border_bits, board().first_tag) == (2, 0)
    assert board(codeOffset=0, tagBorderBits=2.0).border_bits == 2
    for changes, message in (
        ({"tagBorderBits": 3}, "tagBorderBits: found 3, expected 1"),
        ({"codeOffset": -1}, "codeOffset: found -1, expected one id from 0"),
        ({"codeOffset": 3, "firstTag": 4}, "firstTag: found 4, expected one id"),
    ):
        with pytest.raises(FormatError, match=message):
            board(**changes)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"target_type": None}, "the key target_type is missing. Expected one of aprilgrid, checkerboard, circlegrid"),
        ({"target_type": "marker wall"}, 'target_type: found "marker wall", expected one of aprilgrid'),
        ({"target_type": 6}, "target_type: found 6, expected text"),
        ({"tagCols": None}, "the key tagCols is missing. Expected a count"),
        ({"tagCols": 6.5}, "tagCols: found 6.5, expected a whole number"),
        ({"tagCols": 0}, "tagCols: found 0, expected a count from 1 to 1000"),
        ({"tagRows": 10**9}, "tagRows: found 1000000000, expected a count from 1 to 1000"),
        ({"tagSize": 88}, "tagSize: found 88 m, which no board has. The unit is the metre"),
        ({"tagSize": 0}, "tagSize: found 0, expected a number greater than zero"),
        ({"tagSize": "0,088"}, 'tagSize: found the text "0,088", expected a number'),
        ({"tagSpacing": -0.3}, "tagSpacing: found -0.3, expected a number greater than zero"),
        ({"target_type": "checkerboard"}, "the key targetCols is missing"),
        ({"tagSize": None, "tag_size": 0.088}, "Found tag_size: was tagSize meant?"),
    ],
)
def test_bad_target(board, changes, message) -> None:
    with pytest.raises(FormatError, match=re.escape(message)) as caught:
        board(**changes)
    assert "target.yaml" in str(caught.value)


def test_too_small_a_board_is_refused(board) -> None:
    keys = {"target_type": "checkerboard", "targetCols": 1, "targetRows": 6}
    with pytest.raises(FormatError, match=r"target\.yaml: cols 1 of the checkerboard"):
        board(keys, rowSpacingMeters=0.08, colSpacingMeters=0.08)


@pytest.mark.parametrize(("content", "hint"), [({"cam0": CAM}, "--cam"), (NOISE, "--imu")])
def test_another_file_in_the_place_of_the_target(write, content, hint) -> None:
    with pytest.raises(FormatError, match=f"which belongs to {hint}"):
        read_target(write(content))
