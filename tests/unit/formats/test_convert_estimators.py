"""Files for OpenVINS, Basalt and Kalibr: read back they are the same rig, through every one of them and back."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
import yaml

import gnomon
from gnomon.formats.basalt import basalt_text
from gnomon.formats.conversion import export_texts
from gnomon.formats.foreign_files import load_foreign
from gnomon.formats.kalibr.imu import StatedImu
from gnomon.formats.openvins import imu_chain_text
from gnomon.formats.shared.losses import formats_of
from gnomon.models.camera import Camera
from gnomon.recording.samples import ImuNoise
from gnomon.results.calibration import Assessment, Calibration, Covariance, Gravity, Provenance
from gnomon.results.sensors import covariance_names

NOISE = ImuNoise(
    accelerometer_noise_density=0.0039,
    accelerometer_random_walk=0.0012,
    gyroscope_noise_density=8.73e-5,
    gyroscope_random_walk=2e-5,
)
STATED = StatedImu(noise=NOISE, update_rate_hz=200.0, topic="/imu0")
SI = ("m/s^2", "rad/s")
WIDE = Camera(
    projection="pinhole", intrinsics=[275.5, 274.25, 315.9, 242.7], distortion="equidistant",
    distortion_coeffs=[-0.012, 0.022, -0.0137, 0.0027], resolution=(640, 480), topic="/wide",
)  # fmt: skip
LENSES = {
    "radtan": Camera(
        projection="pinhole", intrinsics=[460.1, 458.5, 322.4, 237.1], distortion="radtan",
        distortion_coeffs=[-0.28, 0.075, 2e-4, -1.5e-4], resolution=(640, 480), topic="/left",
    ),
    "equidistant": WIDE,
    "none": replace(WIDE, distortion="none", distortion_coeffs=np.empty(0)),
    "ds": Camera(
        projection="ds", intrinsics=[-0.2, 0.55, 290.25, 291.5, 319.0, 241.0], distortion="none",
        distortion_coeffs=[], resolution=(640, 480),
    ),
    "eucm": Camera(
        projection="eucm", intrinsics=[0.6, 1.1, 230.5, 231.25, 320.0, 240.0], distortion="none",
        distortion_coeffs=[], resolution=(640, 480),
    ),
    "omni": Camera(
        projection="omni", intrinsics=[0.9, 540.5, 536.25, 321.0, 239.0], distortion="none",
        distortion_coeffs=[], resolution=(640, 480),
    ),
}  # fmt: skip


def said(losses):
    return " | ".join(str(loss) for loss in losses)


def close(found, expected, tolerance=1e-12):
    assert np.abs(found - expected).max() <= tolerance * max(np.abs(expected).max(), 1e-300)


@pytest.fixture
def rig(camera_calibration):
    """Make a random calibration with the lenses that are named, near the identity where samples are in SI units."""

    def make(seed, *lenses, **changes):
        calibration = camera_calibration(seed, cameras=len(lenses), **changes)
        cameras = {
            name: replace(camera, camera=LENSES[lens], time_shift_cam_imu=round(camera.time_shift_cam_imu, 9))
            for (name, camera), lens in zip(calibration.cameras.items(), lenses, strict=True)
        }
        return calibration_of(calibration.imus, cameras, calibration.frame)

    return make


def calibration_of(imus, cameras, frame="accel-x"):
    names = covariance_names(imus, cameras)
    return Calibration(
        imus=imus, cameras=cameras, frame=frame, gravity=Gravity(value=9.81, sigma=0.0, source="given"),
        uncertainty=Covariance(names=names, matrix=np.zeros((len(names),) * 2)),
        assessment=Assessment(verdict="pass", findings=(), model="full"),
        provenance=Provenance(gnomon_version="0", method="camera-imu"),
    )  # fmt: skip


def through(calibration, form, folder):
    """Write a calibration and read it back."""
    losses = gnomon.convert(calibration, form, folder)
    return load_foreign(*sorted(folder.iterdir())), losses


def same_cameras(found, expected, *, shift=0.0, none="none"):
    assert list(found) == list(expected)
    for name, camera in expected.items():
        close(found[name].T_cam_imu, camera.T_cam_imu)
        assert abs(found[name].time_shift_cam_imu - camera.time_shift_cam_imu) <= shift
        close(found[name].camera.intrinsics, camera.camera.intrinsics)
        if camera.camera.distortion == "none":
            assert found[name].camera.distortion == none
            assert not found[name].camera.distortion_coeffs.any()
        else:
            assert found[name].camera.model == camera.camera.model
            assert np.array_equal(found[name].camera.distortion_coeffs, camera.camera.distortion_coeffs)
        assert found[name].camera.resolution == camera.camera.resolution


# ---- one after the other ----


@pytest.mark.parametrize("seed", range(5))
def test_openvins(rig, tmp_path, seed):
    calibration = rig(seed, "radtan", "equidistant", "none", units=SI, frame="accel-z" if seed % 2 else "accel-x")
    found, losses = through(calibration, "openvins", tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["kalibr_imu_chain.yaml", "kalibr_imucam_chain.yaml"]
    expected = calibration.in_frame("accel-x")
    imu, original = found.imus["imu0"], expected.imus["imu0"]
    close(imu.accelerometer.sensitivity, original.accelerometer.sensitivity)
    close(imu.gyroscope.sensitivity, original.gyroscope.sensitivity)
    close(imu.gyroscope.g_sensitivity, original.gyroscope.g_sensitivity)
    assert found.frame == "accel-x"
    same_cameras(found.cameras, expected.cameras, none="radtan")
    for words in (
        "accelerometer bias of imu0",
        "noise and rate",
        "time shifts (the others differ",
        "distortion of cam2",
    ):
        assert words in said(losses)
    assert ("body frame of imu0" in said(losses)) == (calibration.frame != "accel-x")


def test_openvins_says_what_its_letters_mean(rig):
    texts = export_texts(rig(1, "radtan", units=SI), "openvins").files
    for text in texts.values():
        assert text.startswith("%YAML:1.0\n")
    assert "p_cam = T_cam_imu p_imu [m], t_imu = t_cam + timeshift_cam_imu [s]" in texts["kalibr_imucam_chain.yaml"]
    imu = texts["kalibr_imu_chain.yaml"]
    assert "Tw R_IMUtoGYRO w + Tg f + bias" in imu
    assert "OpenVINS also needs accelerometer_noise_density" in imu
    full = imu_chain_text(rig(1, "radtan", units=SI).imus["imu0"], STATED)
    assert "also needs" not in full
    entry = yaml.safe_load(full.replace("%YAML:1.0", ""))["imu0"]
    assert set(entry) == {
        "T_i_b", "time_offset", "model", "Ta", "R_IMUtoACC", "Tw", "R_IMUtoGYRO", "Tg", "update_rate", "rostopic",
        *ImuNoise.__slots__,
    }  # fmt: skip
    assert entry["model"] == "kalibr"


def test_opencv_reads_what_openvins_will(rig, tmp_path):
    """OpenVINS reads its files by OpenCV, which takes less than YAML allows."""
    cv2 = pytest.importorskip("cv2")
    calibration = rig(2, "radtan", "equidistant", units=SI)
    gnomon.convert(calibration, "openvins", tmp_path)

    def matrix(node):
        return np.array([[node.at(i).at(j).real() for j in range(node.at(i).size())] for i in range(node.size())])

    storage = cv2.FileStorage(str(tmp_path / "kalibr_imucam_chain.yaml"), cv2.FILE_STORAGE_READ)
    for name, camera in calibration.cameras.items():
        node = storage.getNode(name)
        assert np.array_equal(matrix(node.getNode("T_cam_imu")), camera.T_cam_imu)
        assert node.getNode("timeshift_cam_imu").real() == camera.time_shift_cam_imu
        assert node.getNode("distortion_model").string() == camera.camera.distortion
        values = node.getNode("intrinsics")
        assert [values.at(i).real() for i in range(4)] == camera.camera.intrinsics.tolist()
        assert node.getNode("rostopic").string() == camera.camera.topic
    storage.release()
    storage = cv2.FileStorage(str(tmp_path / "kalibr_imu_chain.yaml"), cv2.FILE_STORAGE_READ)
    node = storage.getNode("imu0")
    assert node.getNode("model").string() == "kalibr"
    assert np.array_equal(matrix(node.getNode("Ta")), calibration.imus["imu0"].accelerometer.sensitivity)
    assert np.array_equal(matrix(node.getNode("Tg")), calibration.imus["imu0"].gyroscope.g_sensitivity)
    storage.release()


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("lens", LENSES)
def test_basalt(rig, tmp_path, seed, lens):
    calibration = rig(seed, lens, units=SI, frame="accel-z" if seed % 2 else "accel-x")
    found, losses = through(calibration, "basalt", tmp_path)
    expected = calibration.in_frame("accel-x")
    for triad in ("accelerometer", "gyroscope"):
        one, other = getattr(found.imus["imu0"], triad), getattr(expected.imus["imu0"], triad)
        close(one.sensitivity, other.sensitivity)
        close(one.bias, other.bias)
    assert not found.imus["imu0"].gyroscope.g_sensitivity.any()
    same_cameras(found.cameras, expected.cameras, shift=1e-15)
    assert "g-sensitivity of imu0 (up to" in said(losses)
    assert ("newer versions of Basalt" in said(losses)) == (lens == "radtan")
    document = json.loads((tmp_path / "calibration.json").read_text())["value0"]
    assert isinstance(document["cam_time_offset_ns"], int)
    assert "p_imu = T_imu_cam p_cam" in document["comment"]
    assert "t_imu = t_cam + cam_time_offset_ns" in document["comment"]
    keys = {
        "T_imu_cam",
        "intrinsics",
        "resolution",
        "calib_accel_bias",
        "calib_gyro_bias",
        "imu_update_rate",
        "accel_noise_std",
        "gyro_noise_std",
        "accel_bias_std",
        "gyro_bias_std",
        "cam_time_offset_ns",
        "vignette",
    }
    assert keys <= set(document)  # what Basalt reads: it stops where one is missing


def test_basalts_noise(rig, tmp_path):
    calibration = rig(0, "ds", units=SI)
    assert "put in your own" in basalt_text(calibration)
    assert "consumer IMU" in said(export_texts(calibration, "basalt").losses)
    (tmp_path / "c.json").write_text(basalt_text(calibration, STATED))
    data = load_foreign(tmp_path / "c.json").imu_data["imu0"]
    assert (data.noise, data.update_rate_hz) == (NOISE, 200.0)
    assert "put in your own" not in basalt_text(calibration, STATED)


@pytest.mark.parametrize(("coeffs", "limit"), [([-0.5, 0, 0, 0], np.sqrt(2 / 3)), ([0.1, 0, 0, 0], 0.0)])
def test_a_fold_of_radtan_is_told_to_basalt(rig, coeffs, limit):
    """r (1 - r^2 / 2) rises up to r^2 = 2/3; a lens that never folds has zero."""
    calibration = rig(0, "radtan", units=SI)
    lens = replace(LENSES["radtan"], distortion_coeffs=coeffs)
    cameras = {"cam0": replace(calibration.cameras["cam0"], camera=lens)}
    document = json.loads(basalt_text(calibration_of(calibration.imus, cameras)))["value0"]
    assert document["intrinsics"][0]["intrinsics"]["rpmax"] == pytest.approx(limit, rel=1e-9)


BENT = {"radtan": [0.1, 0, 0, 0], "radtan5": [0.1, 0, 0, 0, 0.01], "equidistant": [0.1, 0, 0, 0], "fov": [0.9]}


def test_the_formats_that_are_advised_for_a_lens_can_hold_it(rig):
    shapes = [LENSES[name] for name in ("none", "ds", "eucm", "omni")]
    shapes.append(replace(LENSES["omni"], intrinsics=[-0.2, 540.5, 536.25, 321.0, 239.0]))
    bent = [replace(lens, distortion=name, distortion_coeffs=c) for name, c in BENT.items() for lens in shapes]
    advised = {lens: formats_of([lens]) for lens in shapes + bent}
    for lens, formats in advised.items():
        calibration = rig(0, "radtan", units=SI)
        cameras = {"cam0": replace(calibration.cameras["cam0"], camera=lens)}
        calibration = calibration_of(calibration.imus, cameras)
        for name in formats:
            assert "lens of cam0" not in said(export_texts(calibration, name, imu={"imu0": STATED}).losses)
    by_model = {lens.model: set(formats) for lens, formats in advised.items()}
    assert by_model["pinhole-fov"] == {"kalibr"}
    assert by_model["ds-none"] == {"kalibr", "basalt"}
    assert by_model["ds-radtan"] == {"json", "csv"}  # Kalibr reads ds without
    flight = export_texts(calibration, "px4").losses
    assert "Use json or csv to write them too" in said(flight)


@pytest.mark.parametrize("to", ["openvins", "basalt"])
def test_other_units(rig, tmp_path, to):
    """Samples converted as the file says, then the project's model: the same truth as from the calibration itself."""
    calibration = rig(4, "radtan", units=("g", "count"))
    found, losses = through(calibration, to, tmp_path)
    text = "".join(path.read_text() for path in tmp_path.iterdir())
    imu, read = calibration.imus["imu0"], found.imus["imu0"]
    rate, force = np.random.default_rng(0).normal(size=(2, 6, 3))
    accel = force @ imu.accelerometer.sensitivity.T + imu.accelerometer.bias
    counts = rate @ imu.gyroscope.sensitivity.T + imu.gyroscope.bias
    counts += (to == "openvins") * force @ imu.gyroscope.g_sensitivity.T
    line = re.search(r"gyroscope \[rad/s\] = \(count - \((.*?)\)\) \* ([\d.e+-]+)", text)
    assert line[0] in said(losses)
    converted = (counts - np.array([float(x) for x in line[1].split(",")])) * float(line[2])
    bias = imu.accelerometer.bias * 9.80665 if to == "openvins" else 0  # OpenVINS estimates it
    close(read.accelerometer.specific_force(accel * 9.80665 - bias), force, 1e-10)
    close(read.gyroscope.angular_rate(converted, force), rate, 1e-10)


def test_what_else_is_said(rig, tmp_path):
    calibration = rig(0, "radtan", "radtan", units=SI)
    slow = replace(calibration.cameras["cam0"].camera, line_delay_s=3e-5, topic="")
    cameras = {**calibration.cameras, "cam0": replace(calibration.cameras["cam0"], camera=slow)}
    imus = {**calibration.imus, "imu1": calibration.imus["imu0"]}
    for to in ("openvins", "basalt"):
        words = said(export_texts(calibration_of(imus, cameras), to).losses)
        assert "line_delay of cam0 (30 us a row, 14.4 ms an image): " in words
        assert "imu1: " in words
        gnomon.convert(calibration_of(imus, cameras), to, tmp_path / f"slow-{to}")
        read = load_foreign(*(tmp_path / f"slow-{to}").iterdir()).cameras["cam0"]
        of_the_middle_row = cameras["cam0"].time_shift_cam_imu + 239.5 * 3e-5
        np.testing.assert_allclose(read.time_shift_cam_imu, of_the_middle_row, atol=1e-9)
        assert "time shifts (the others differ by up to" in words
    assert "rostopic of cam0" in said(export_texts(calibration_of(imus, cameras), "openvins").losses)
    assert "at most 0.5 ns" in said(export_texts(calibration_of(imus, cameras), "basalt").losses)
    alone = calibration_of(calibration.imus, {})
    for to in ("openvins", "basalt"):
        assert "of an IMU alone" in said(gnomon.convert(alone, to, tmp_path / to))
        assert load_foreign(*(tmp_path / to).iterdir()).imus


@pytest.mark.parametrize("to", ["openvins", "basalt"])
def test_accelerometer_alone_has_an_ideal_gyroscope(random_calibration, tmp_path, to):
    found, losses = through(random_calibration(3, gyroscope=False, units=SI), to, tmp_path)
    assert "gyroscope of imu0: it was not calibrated" in said(losses)
    assert np.array_equal(found.imus["imu0"].gyroscope.sensitivity, np.eye(3))


# ---- from one to the other and back ----


@pytest.mark.parametrize("seed", range(4))
def test_through_all_of_them_and_back(rig, tmp_path, seed):
    """Kalibr, OpenVINS, Kalibr again, Basalt: what each can hold comes through all of them."""
    calibration = rig(seed, "radtan", "equidistant", units=SI)
    shift = calibration.cameras["cam0"].time_shift_cam_imu  # Basalt has one
    cameras = {name: replace(camera, time_shift_cam_imu=shift) for name, camera in calibration.cameras.items()}
    calibration = calibration_of(calibration.imus, cameras)
    expected, current = calibration.imus["imu0"], calibration
    for i, form in enumerate(("kalibr", "openvins", "kalibr", "openvins", "basalt", "kalibr", "basalt")):
        found, _ = through(current, form, tmp_path / str(i))
        same_cameras(found.cameras, cameras, shift=1e-15)
        close(found.imus["imu0"].accelerometer.sensitivity, expected.accelerometer.sensitivity)
        close(found.imus["imu0"].gyroscope.sensitivity, expected.gyroscope.sensitivity)
        if i < 4:
            close(found.imus["imu0"].gyroscope.g_sensitivity, expected.gyroscope.g_sensitivity)
        current = calibration_of(found.imus, found.cameras, found.frame)


# ---- samples of the projects, written back ----


def again(found, to, folder, stated=STATED):
    """Write what was read in the same format, noise and all, and read it."""
    from gnomon.formats.openvins import camera_chain_text

    folder.mkdir(exist_ok=True)
    if to == "basalt":
        calibration = calibration_of(found.imus, found.cameras)
        (folder / "calibration.json").write_text(basalt_text(calibration, stated))
    else:
        (folder / "imu.yaml").write_text(imu_chain_text(found.imus["imu0"], stated))
        (folder / "cam.yaml").write_text(camera_chain_text(calibration_of(found.imus, found.cameras)))
    return load_foreign(*folder.iterdir())


@pytest.mark.parametrize("name", ["euroc_mav", "kaist_vio", "rpng_sim", "rs_d455", "tum_vi", "uzhfpv_indoor_45"])
def test_openvins_samples_written_back(real_data, tmp_path, name):
    found = load_foreign(*real_data(f"kalibr-format-samples/openvins_{name}").iterdir())
    data = found.imu_data["imu0"]
    read = again(found, "openvins", tmp_path, StatedImu(noise=data.noise, update_rate_hz=data.update_rate_hz))
    for key, camera in found.cameras.items():
        assert np.array_equal(read.cameras[key].T_cam_imu, camera.T_cam_imu)
        assert np.array_equal(read.cameras[key].camera.parameters, camera.camera.parameters)
        assert read.cameras[key].time_shift_cam_imu == camera.time_shift_cam_imu
        assert read.cameras[key].camera.topic == camera.camera.topic
    assert read.imu_data["imu0"].noise == data.noise
    assert read.imu_data["imu0"].update_rate_hz == data.update_rate_hz
    assert np.array_equal(read.imus["imu0"].gyroscope.sensitivity, np.eye(3))


@pytest.mark.parametrize("name", ["euroc_ds", "euroc_eucm", "tumvi_512_ds"])
def test_basalt_samples_written_back(real_data, tmp_path, name):
    path = real_data("kalibr-format-samples") / "basalt" / f"{name}_calib.json"
    found = load_foreign(path)
    data = found.imu_data["imu0"]
    read = again(found, "basalt", tmp_path, StatedImu(noise=data.noise, update_rate_hz=data.update_rate_hz))
    for key, camera in found.cameras.items():
        close(read.cameras[key].T_cam_imu, camera.T_cam_imu, 1e-14)
        assert np.array_equal(read.cameras[key].camera.parameters, camera.camera.parameters)
    assert np.array_equal(read.imus["imu0"].accelerometer.bias, found.imus["imu0"].accelerometer.bias)
    assert np.array_equal(read.imus["imu0"].gyroscope.bias, found.imus["imu0"].gyroscope.bias)
    assert read.imu_data["imu0"].noise == data.noise


KALIBR = ["a-aprilgrid-full/kalibr/scale-misalignment", "a-aprilgrid-full/kalibr/sm_sigma0.1",
          "b-aprilgrid-ideal-imu/kalibr/calibrated", "d-checkerboard-ideal-imu/kalibr/cal"]  # fmt: skip


@pytest.mark.parametrize("folder", KALIBR)
@pytest.mark.parametrize("to", ["openvins", "basalt"])
def test_kalibrs_results_through_the_others(real_data, tmp_path, folder, to):
    place = real_data("rendered-camimu") / folder
    found = load_foreign(place / "data-imu.yaml", place / "data-camchain-imucam.yaml")
    read = again(found, to, tmp_path)
    one, other = read.imus["imu0"], found.imus["imu0"]
    close(one.accelerometer.sensitivity, other.accelerometer.sensitivity, 1e-14)
    close(one.gyroscope.sensitivity, other.gyroscope.sensitivity, 1e-14)
    if to == "openvins":
        assert np.abs(one.gyroscope.g_sensitivity - other.gyroscope.g_sensitivity).max() <= 1e-18
    close(read.cameras["cam0"].T_cam_imu, found.cameras["cam0"].T_cam_imu, 1e-14)
    shift = found.cameras["cam0"].time_shift_cam_imu
    assert abs(read.cameras["cam0"].time_shift_cam_imu - shift) <= (5e-10 if to == "basalt" else 0)


def test_our_results_read_back(camera_imu_case, tmp_path):
    """All three files that gnomon writes after a camera-IMU calibration, in Kalibr's layout."""
    from gnomon.writers.kalibr_files import camera_imu_texts

    result, recording, target = camera_imu_case()
    texts = camera_imu_texts(result, recording, target)
    names = ("camchain-imucam.yaml", "imu.yaml", "results-imucam.txt")
    for name in names:
        (tmp_path / name).write_text(texts[name])
    calibration = result.calibration.in_frame("accel-x")
    found = load_foreign(*(tmp_path / name for name in names))
    for name, camera in calibration.cameras.items():
        # The numbers of this case are rounded: they are made a rotation.
        assert np.abs(found.cameras[name].T_cam_imu - camera.T_cam_imu).max() < 1e-6
        assert found.cameras[name].time_shift_cam_imu == camera.time_shift_cam_imu
        assert np.array_equal(found.cameras[name].camera.parameters, camera.camera.parameters)
    close(found.imus["imu0"].gyroscope.sensitivity, calibration.imus["imu0"].gyroscope.sensitivity)
    assert found.imu_data["imu0"].noise == recording.imus["imu0"].noise
    assert np.abs(found.gravity_target - result.diagnostics.gravity_target).max() < 6e-9
    assert found.target.describe() == target.describe()
    printed = load_foreign(tmp_path / "results-imucam.txt")
    for name, camera in calibration.cameras.items():
        assert np.abs(printed.cameras[name].T_cam_imu - camera.T_cam_imu).max() < 1e-6
    assert set(printed.residuals) == {*calibration.cameras, "imu0.gyroscope", "imu0.accelerometer"}


WORDS = ["nan", "-1", "0", "1e400", "[]", "{}", "null", "'x'", "[1, 2]", "-", "9" * 30, "\t", ":", "!!x", "*a", ""]


@pytest.mark.parametrize("seed", range(3))
def test_damaged_files_are_read_or_refused(rig, camera_imu_case, tmp_path, seed):
    """Whatever stands in a file instead of what belongs there, it ends in a sentence, never in another error."""
    from gnomon.errors import GnomonError
    from gnomon.writers.kalibr_files import camera_imu_texts

    rng = np.random.default_rng(seed)
    calibration = rig(seed, "radtan", "equidistant", units=SI)
    texts = list(camera_imu_texts(*camera_imu_case()).values())[:3]
    texts += [text for to in ("openvins", "basalt") for text in export_texts(calibration, to).files.values()]
    read = refused = 0
    for _ in range(150):
        text = texts[rng.integers(len(texts))]
        for _ in range(rng.integers(1, 3)):
            i = int(rng.integers(len(text)))
            end = i + re.match(r"[^\s,\[\]]*", text[i:]).end()
            text = text[:i] + WORDS[rng.integers(len(WORDS))] + text[end:]
        (tmp_path / "file").write_text(text)
        try:
            load_foreign(tmp_path / "file")
            read += 1
        except GnomonError as error:
            assert "file" in str(error)  # noqa: PT017
            refused += 1
    assert read > 10
    assert refused > 10
