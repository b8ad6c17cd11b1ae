"""Files for VINS-Fusion, ORB-SLAM3, OKVIS, PX4, ArduPilot, ROS 2 and JSON: directions, signs, losses, and back."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
import yaml

import gnomon
from gnomon.errors import FormatError, OptionError
from gnomon.findings import Finding
from gnomon.formats import orb_slam3
from gnomon.formats.conversion import FORMATS, WITH_NOISE, export_texts
from gnomon.formats.foreign_files import load_foreign
from gnomon.formats.own.calibration_text import calibration_text
from gnomon.formats.shared.losses import Context, StatedImu
from gnomon.models.camera import Camera
from gnomon.recording.samples import ImuNoise
from gnomon.results.calibration import Assessment, Calibration, Covariance, Gravity, ImuCalibration, Provenance
from gnomon.results.sensors import calibration_parameters, covariance_names

NOISE = ImuNoise(
    accelerometer_noise_density=0.0039,
    accelerometer_random_walk=0.0012,
    gyroscope_noise_density=8.73e-5,
    gyroscope_random_walk=2e-5,
)
STATED = {"imu0": StatedImu(noise=NOISE, update_rate_hz=200.0, topic="/imu0")}
RADTAN = Camera(
    projection="pinhole", intrinsics=[460.1, 458.5, 322.4, 237.1], distortion="radtan",
    distortion_coeffs=[-0.28, 0.075, 2e-4, -1.5e-4], resolution=(640, 480), topic="/left",
)  # fmt: skip
WIDE = replace(RADTAN, distortion="equidistant", distortion_coeffs=[-0.012, 0.022, -0.0137, 0.0027], topic="/wide")
PLAIN = replace(RADTAN, distortion="none", distortion_coeffs=np.empty(0))
OMNI = replace(RADTAN, projection="omni", intrinsics=[0.9, 540.5, 536.25, 321.0, 239.0])
DS = replace(PLAIN, projection="ds", intrinsics=[-0.2, 0.55, 290.25, 291.5, 319.0, 241.0])
SI = ("m/s^2", "rad/s")
ESTIMATORS = ("vins-fusion", "orb-slam3", "okvis", "ros2")
FLIGHT = ("px4", "ardupilot")


def said(losses):
    return " | ".join(str(loss) for loss in losses)


def close(found, expected, tolerance=1e-12):
    assert np.abs(np.asarray(found) - expected).max() <= tolerance * max(np.abs(expected).max(), 1e-300)


def calibration_of(imus, cameras=None, frame="accel-x", **assessed):
    cameras = cameras or {}
    names = covariance_names(imus, cameras)
    return Calibration(
        imus=imus, cameras=cameras, frame=frame, gravity=Gravity(value=9.81, sigma=0.0, source="given"),
        uncertainty=Covariance(names=names, matrix=np.eye(len(names)) * 1e-8),
        assessment=Assessment(**{"verdict": "pass", "findings": (), "model": "full", **assessed}),
        provenance=Provenance(gnomon_version="0", method="camera-imu"),
    )  # fmt: skip


@pytest.fixture
def rig(camera_calibration):
    """Make a random calibration with these lenses, all with the same time shift unless told otherwise."""

    def make(seed, *lenses, shift=0.0123, **changes):
        calibration = camera_calibration(seed, cameras=len(lenses), **changes)
        cameras = {
            name: replace(camera, camera=lens, time_shift_cam_imu=shift)
            for (name, camera), lens in zip(calibration.cameras.items(), lenses, strict=True)
        }
        return calibration_of(calibration.imus, cameras, calibration.frame)

    return make


def through(calibration, form, folder, imu=STATED):
    losses = gnomon.convert(calibration, form, folder, imu=imu)
    return load_foreign(*sorted(folder.iterdir())), losses


# ---- read back ----


@pytest.mark.parametrize("form", ESTIMATORS)
@pytest.mark.parametrize("lenses", [(RADTAN,), (WIDE, WIDE), (RADTAN, RADTAN), (PLAIN,)])
@pytest.mark.parametrize("seed", range(3))
def test_cameras_come_back(rig, tmp_path, form, lenses, seed):
    calibration = rig(seed, *lenses, units=SI)
    found, losses = through(calibration, form, tmp_path)
    assert list(found.cameras) == list(calibration.cameras)
    assert not found.lenses
    for name, camera in calibration.cameras.items():
        close(found.cameras[name].T_cam_imu, camera.T_cam_imu)
        close(found.cameras[name].camera.intrinsics, camera.camera.intrinsics, 0)
        assert found.cameras[name].camera.resolution == (640, 480)
        coeffs = found.cameras[name].camera.distortion_coeffs
        if camera.camera.distortion == "none":
            assert not coeffs.any()
        else:
            assert np.array_equal(coeffs, camera.camera.distortion_coeffs)
        kept = camera.time_shift_cam_imu if form in ("vins-fusion", "okvis") else 0.0
        assert found.cameras[name].time_shift_cam_imu == kept
    assert ("time shift of cam0 (+12.3 ms)" in said(losses)) == (form in ("orb-slam3", "ros2"))
    if form != "ros2":
        data = found.imu_data["imu0"]
        close([getattr(data.noise, key) for key in ImuNoise.__slots__], [getattr(NOISE, k) for k in ImuNoise.__slots__])
        assert data.update_rate_hz == 200.0
    if form == "okvis":
        for triad in ("accelerometer", "gyroscope"):
            bias = getattr(calibration.imus["imu0"], triad).bias
            assert np.array_equal(getattr(found.imus["imu0"], triad).bias, bias)


def test_vins_knows_omni(rig, tmp_path):
    for i, lens in enumerate((OMNI, replace(OMNI, distortion="none", distortion_coeffs=np.empty(0)))):
        found, _ = through(rig(0, lens, units=SI), "vins-fusion", tmp_path / str(i))
        assert found.cameras["cam0"].camera.model == "omni-radtan"
        assert np.array_equal(found.cameras["cam0"].camera.intrinsics, lens.intrinsics)


@pytest.mark.parametrize("form", ESTIMATORS)
def test_estimators_refuse_a_calibration_without_cameras(rig, form):
    with pytest.raises(OptionError, match=r"holds no camera. Convert to kalibr"):
        export_texts(calibration_of(rig(0, RADTAN).imus), form)


def test_orb_slam3_takes_two_lenses_of_a_kind(rig, tmp_path):
    """A lens of the other kind is fitted anew, and what that costs is said."""
    losses = gnomon.convert(rig(0, RADTAN, WIDE, units=SI), "orb-slam3", tmp_path, imu=STATED)
    (lens,) = [loss for loss in losses if loss.what.startswith("lens of")]
    assert "beside a lens of another kind" in lens.why
    assert "px off on average" in lens.size
    text = (tmp_path / "orb_slam3.yaml").read_text()
    assert 'Camera.type: "PinHole"' in text
    assert text.count("Camera2.k3:") == 1  # the fullest lens of that kind
    with pytest.raises(OptionError, match="cam0 and cam1 have lenses of two kinds"):
        orb_slam3.export(rig(0, RADTAN, WIDE, units=SI), Context(stated={}))
    assert "cam2: ORB-SLAM3 takes 2 cameras at most" in said(export_texts(rig(0, WIDE, WIDE, WIDE), "orb-slam3").losses)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("frame", ["accel-x", "accel-z", "user"])
def test_json_is_the_whole_calibration(camera_calibration, tmp_path, seed, frame):
    calibration = camera_calibration(seed, frame=frame)
    gnomon.convert(calibration, "json", tmp_path)
    assert calibration_text(gnomon.load(tmp_path / "calibration.json")) == calibration_text(calibration)
    document = json.loads((tmp_path / "calibration.json").read_text())
    assert list(document)[:2] == ["schema", "comment"]
    assert "p_cam = T_cam_imu p_imu" in document["comment"]["T_cam_imu"]
    assert "t_imu = t_cam + time_shift_cam_imu" in document["comment"]["time_shift_cam_imu"]
    with pytest.raises(FormatError, match="own calibration"):
        load_foreign(tmp_path / "calibration.json")


def test_json_without_standard_deviations(rig, tmp_path):
    gnomon.convert(rig(0, RADTAN, units=SI), "basalt", tmp_path / "basalt", imu=STATED)
    gnomon.convert(load_foreign(tmp_path / "basalt/calibration.json"), "json", tmp_path / "json")
    found = gnomon.load(tmp_path / "json/calibration.json")
    assert np.isnan(found.uncertainty.matrix).all()
    assert found.provenance.method == "foreign"


def test_csv_holds_the_cameras(camera_calibration, tmp_path):
    calibration = camera_calibration(1, cameras=4)
    gnomon.convert(calibration, "csv", tmp_path)
    found = load_foreign(tmp_path / "calibration.csv")
    begin, end = (dict(calibration_parameters(c.imus, c.cameras)) for c in (calibration, found))
    for path, value in begin.items():
        assert np.allclose(end[path], value, rtol=0, atol=1e-13 if "rotation" in path else 0)
        assert np.array_equal(found.sigmas[path], calibration.sigma(path))
    for name, camera in calibration.cameras.items():
        assert found.cameras[name].camera.topic == camera.camera.topic
        assert found.cameras[name].camera.resolution == camera.camera.resolution


# ---- directions and signs, by hand ----


def test_directions_and_signs(rig):
    """The camera is at (0.1, 0.2, 0.3) in the IMU's frame and looks along its x; images are stamped 12.3 ms early."""
    calibration = rig(0, RADTAN, units=SI)
    R_imu_cam = np.array([[0, 0, 1], [-1, 0, 0], [0, -1, 0.0]])
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R_imu_cam.T, -R_imu_cam.T @ [0.1, 0.2, 0.3]
    cameras = {"cam0": replace(calibration.cameras["cam0"], T_cam_body=T)}
    calibration = calibration_of(calibration.imus, cameras)
    texts = {form: export_texts(calibration, form, imu=STATED).files for form in ESTIMATORS}
    plain = {
        form: yaml.safe_load(next(iter(files.values())).replace("%YAML:1.0", "").replace("!!opencv-matrix", ""))
        for form, files in texts.items()
    }
    vins, orb, okvis = (plain[form] for form in ESTIMATORS[:3])
    for data in (vins["body_T_cam0"]["data"], orb["IMU.T_b_c1"]["data"], okvis["cameras"][0]["T_SC"]):
        pose = np.reshape(data, (4, 4))
        assert np.array_equal(pose[:3, :3], R_imu_cam)
        close(pose[:3, 3], [0.1, 0.2, 0.3], 1e-15)
    assert orb["IMU.T_b_c1"]["dt"] == "f"  # ORB-SLAM3 takes the bytes as floats
    assert vins["td"] == 0.0123
    assert okvis["camera_parameters"]["image_delay"] == -0.0123
    words = plain["ros2"]["launch"][0]["node"]["args"].split()
    given = {key: float(value) for key, value in zip(words[:14:2], words[1:14:2], strict=True)}
    close([given["--x"], given["--y"], given["--z"]], [0.1, 0.2, 0.3], 1e-15)
    # Half a turn about (1, -1, 1) / sqrt(3) less a third: (x, y, z, w) = (-1, 1, -1, 1) / 2
    close([given[f"--q{c}"] for c in "xyzw"], np.array([-1, 1, -1, 1]) / 2, 1e-15)
    assert words[14:] == ["--frame-id", "imu0", "--child-frame-id", "cam0"]
    assert vins["acc_n"] == pytest.approx(0.0039 * np.sqrt(200), rel=1e-15)
    assert vins["gyr_w"] == pytest.approx(2e-5 * np.sqrt(200), rel=1e-15)
    assert (orb["IMU.NoiseAcc"], orb["IMU.GyroWalk"], orb["IMU.Frequency"]) == (0.0039, 2e-5, 200.0)
    assert (okvis["imu_parameters"]["sigma_g_c"], okvis["imu_parameters"]["sigma_aw_c"]) == (8.73e-5, 0.0012)


def test_the_second_camera_of_orb_slam3(rig):
    calibration = rig(3, RADTAN, RADTAN, units=SI)
    text = export_texts(calibration, "orb-slam3", imu=STATED).files["orb_slam3.yaml"]
    plain = yaml.safe_load(text.replace("%YAML:1.0", "").replace("!!opencv-matrix", ""))
    T_c1_c2 = np.reshape(plain["Stereo.T_c1_c2"]["data"], (4, 4))
    point = np.array([0.3, -0.2, 1.5, 1.0])  # in the IMU's frame
    one, two = (camera.T_cam_imu @ point for camera in calibration.cameras.values())
    close(T_c1_c2 @ two, one, 1e-14)


DEFINITIONS = {
    "kalibr": ("p_cam = T_cam_imu p_imu", "t_imu = t_cam + timeshift_cam_imu"),
    "openvins": ("p_cam = T_cam_imu p_imu", "t_imu = t_cam + timeshift_cam_imu"),
    "vins-fusion": ("p_imu = body_T_cam0 p_cam0", "t_imu = t_cam + td"),
    "orb-slam3": ("p_b = IMU.T_b_c1 p_c1", "t_imu = t_cam + shift"),
    "basalt": ("p_imu = T_imu_cam p_cam", "t_imu = t_cam + cam_time_offset_ns"),
    "okvis": ("p_imu = T_SC p_cam", "t_imu = t_cam - image_delay"),
    "ros2": ("p_imu0 = T p_cam", "t_imu = t_cam + 0.0123 s"),
    "px4": ("T_cam_imu", "time shift"),
    "ardupilot": ("T_cam_imu", "time shift"),
    "json": ("p_cam = T_cam_imu p_imu", "t_imu = t_cam + time_shift_cam_imu"),
    "csv": ("p_cam = R p_imu + t", "t_imu = t_cam + time_shift_cam_imu"),
}


@pytest.mark.parametrize("form", DEFINITIONS)
def test_every_file_defines_its_letters(rig, form):
    text = "".join(export_texts(rig(0, RADTAN, units=SI), form).files.values())
    for words in DEFINITIONS[form]:
        assert words in text


@pytest.mark.parametrize("form", ["vins-fusion", "orb-slam3", "okvis"])
def test_opencv_reads_what_they_will(rig, tmp_path, form):
    """These programs read by OpenCV, which takes less than YAML allows and tells real numbers from whole ones."""
    cv2 = pytest.importorskip("cv2")
    calibration = rig(2, WIDE, WIDE, units=SI)
    gnomon.convert(calibration, form, tmp_path, imu=STATED)
    file = {"vins-fusion": "config.yaml", "orb-slam3": "orb_slam3.yaml", "okvis": "okvis.yaml"}[form]
    storage = cv2.FileStorage(str(tmp_path / file), cv2.FILE_STORAGE_READ)
    pose = np.linalg.inv(calibration.cameras["cam0"].T_cam_imu)
    if form == "okvis":
        cameras = storage.getNode("cameras")
        assert cameras.size() == 2
        T = cameras.at(0).getNode("T_SC")
        close([T.at(i).real() for i in range(16)], pose.ravel(), 1e-14)
        assert storage.getNode("camera_parameters").getNode("image_delay").real() == -0.0123
        assert storage.getNode("imu_parameters").getNode("sigma_g_c").isReal()
        assert cameras.at(1).getNode("distortion_type").string() == "equidistant"
    else:
        key, kind = ("body_T_cam0", np.float64) if form == "vins-fusion" else ("IMU.T_b_c1", np.float32)
        found = storage.getNode(key).mat()
        assert found.dtype == kind
        close(found, pose, 1e-14 if form == "vins-fusion" else 1e-6)
        reals = ("acc_n", "td", "g_norm") if form == "vins-fusion" else ("IMU.NoiseGyro", "IMU.Frequency", "Camera2.k4")
        assert all(storage.getNode(name).isReal() for name in reals)
    storage.release()
    if form == "vins-fusion":
        lens = cv2.FileStorage(str(tmp_path / "cam1.yaml"), cv2.FILE_STORAGE_READ)
        assert lens.getNode("model_type").string() == "KANNALA_BRANDT"
        assert lens.getNode("projection_parameters").getNode("k2").real() == WIDE.distortion_coeffs[0]
        lens.release()


# ---- flight controllers ----


@pytest.mark.parametrize("form", FLIGHT)
@pytest.mark.parametrize("units", [SI, ("g", "deg/s")])
def test_offsets_and_scales(random_calibration, tmp_path, form, units):
    calibration = random_calibration(3, units=units)
    found, losses = through(calibration, form, tmp_path, imu=None)
    imu, original = found.imus["imu0"], calibration.imus["imu0"]
    factors = (1.0, 1.0) if units == SI else (9.80665, np.pi / 180)
    close(imu.accelerometer.bias, original.accelerometer.bias * factors[0])
    close(imu.gyroscope.bias, original.gyroscope.bias * factors[1])
    assert np.array_equal(imu.gyroscope.sensitivity, np.eye(3))
    # What is said to be lost is what is wrong at 1 g in the worst attitude, found here by trying attitudes.
    up = np.random.default_rng(0).normal(size=(100_000, 3))
    up *= 9.80665 / np.linalg.norm(up, axis=1)[:, None]
    measured = up @ (original.accelerometer.sensitivity * factors[0]).T + original.accelerometer.bias * factors[0]
    worst = np.linalg.norm(imu.accelerometer.specific_force(measured) - up, axis=1).max()
    stated = re.search(
        r"misalignment of the accelerometer of imu0 \(.*?up to ([\d.e+-]+) m/s\^2 at 1 g\)", said(losses)
    )
    assert float(stated[1]) == pytest.approx(worst, rel=0.06)  # two digits
    assert "scale and misalignment of the gyroscope of imu0" in said(losses)
    assert "g-sensitivity of imu0 (up to" in said(losses)


def test_parameter_names(random_calibration):
    texts = {form: next(iter(export_texts(random_calibration(0, units=SI), form).files.values())) for form in FLIGHT}
    names = {form: re.findall(r"(?m)^(?:1\t1\t)?([A-Z]\w+)[\t,]", text) for form, text in texts.items()}
    axes = "XYZ"
    assert names["px4"] == [
        *(f"CAL_ACC0_{axis}OFF" for axis in axes),
        *(f"CAL_ACC0_{axis}SCALE" for axis in axes),
        *(f"CAL_GYRO0_{axis}OFF" for axis in axes),
    ]
    assert names["ardupilot"] == [
        *(f"INS_ACCOFFS_{axis}" for axis in axes),
        *(f"INS_ACCSCAL_{axis}" for axis in axes),
        *(f"INS_GYROFFS_{axis}" for axis in axes),
    ]
    imus = dict.fromkeys(("imu0", "imu1"), random_calibration(0, units=SI).imus["imu0"])
    second = next(iter(export_texts(calibration_of(imus), "ardupilot").files.values()))
    assert all(name in second for name in ("INS_ACC2OFFS_X,", "INS_ACC2SCAL_Z,", "INS_GYR2OFFS_Y,"))


def test_parameters_of_ground_stations(tmp_path):
    """Layouts as ground stations and consoles write them; the correction is (a - offset) scale in this order."""
    kinds = {
        "a.params": "# Onboard parameters for Vehicle 1\n1\t1\tCAL_ACC0_XOFF\t0.5\t9\n1\t1\tCAL_ACC0_XSCALE\t1.01\t9\n"
        "1\t1\tCAL_GYRO0_ZOFF\t-1e-2\t9\n1\t1\tCAL_ACC0_ID\t1310988\t6\n1\t1\tMPC_XY_P\t0.95\t9\n",
        "b.txt": "param set CAL_ACC0_XOFF 0.5\nparam set CAL_ACC0_XSCALE 1.01\nparam set CAL_GYRO0_ZOFF -0.01\n",
        "c.param": "#NOTE: 2021\nINS_ACCOFFS_X,0.5\nINS_ACCSCAL_X,1.01\nINS_GYROFFS_Z,-0.01\nINS_ACC_ID,2753028\n",
        "d.parm": "INS_ACCOFFS_X    0.5\nINS_ACCSCAL_X    1.01\nINS_GYROFFS_Z    -0.01\n",
    }
    for name, text in kinds.items():
        (tmp_path / name).write_text(text)
        found = load_foreign(tmp_path / name)
        imu = found.imus["imu0"]
        close(imu.accelerometer.specific_force(np.array([[1.5, 2.0, 3.0]]))[0], [1.01, 2.0, 3.0], 1e-15)
        close(imu.gyroscope.angular_rate(np.array([[0.1, 0.2, 0.3]]), np.zeros((1, 3)))[0], [0.1, 0.2, 0.31], 1e-15)
        assert found.format == ("PX4" if name < "c" else "ArduPilot")
    (tmp_path / "e").write_text("INS_ACCSCAL_X,0\n")
    with pytest.raises(FormatError, match=r"INS_ACCSCAL_X is 0, expected a number above zero"):
        load_foreign(tmp_path / "e")


def test_values_out_of_range_are_said(random_calibration):
    calibration = random_calibration(0, units=SI)
    sensor = replace(calibration.imus["imu0"].accelerometer, sensitivity=np.eye(3) * 1.5)
    imus = {"imu0": replace(calibration.imus["imu0"], accelerometer=sensor)}
    assert "range of imu0: ArduPilot states scales from 0.8 to 1.2" in said(
        export_texts(calibration_of(imus), "ardupilot").losses
    )


# ---- an ideal IMU ----


@pytest.mark.parametrize("form", ["vins-fusion", "orb-slam3", "okvis"])
def test_what_an_ideal_imu_leaves_uncorrected(rig, form):
    calibration = rig(1, RADTAN, units=SI)
    stated = said(export_texts(calibration, form, imu=STATED).losses)
    rest = calibration.imus["imu0"].gyroscope.sensitivity - np.eye(3)
    rates = np.random.default_rng(0).normal(size=(100_000, 3))
    worst = (np.linalg.norm(rates @ rest.T, axis=1) / np.linalg.norm(rates, axis=1)).max()
    share = re.search(r"gyroscope of imu0 \(scale off by .*? mrad of misalignment: up to ([\d.e+-]+) % of", stated)
    assert float(share[1]) == pytest.approx(100 * worst, rel=0.06)
    assert "run gnomon apply first" in stated
    ideal = calibration.imus["imu0"]
    ideal = ImuCalibration(
        accelerometer=replace(ideal.accelerometer, sensitivity=np.eye(3)),
        gyroscope=replace(ideal.gyroscope, sensitivity=np.eye(3), g_sensitivity=np.zeros((3, 3))),
    )
    stated = said(export_texts(calibration_of({"imu0": ideal}, calibration.cameras), form, imu=STATED).losses)
    assert "scales and axes" not in stated
    assert "g-sensitivity" not in stated


def test_lever_arms_are_said(rig):
    calibration = rig(0, RADTAN, units=SI)
    arms = np.array([[0, 0, 0], [0.01, 0, 0], [0, 0.02, 0.0]])
    sensor = replace(calibration.imus["imu0"].accelerometer, lever_arms_m=arms)
    imus = {"imu0": replace(calibration.imus["imu0"], accelerometer=sensor)}
    for form in ("openvins", "basalt", "vins-fusion", "okvis", "px4", "c-header", "imucal", "imu_tk"):
        words = said(export_texts(calibration_of(imus, calibration.cameras), form).losses)
        assert "lever arms of the accelerometers of imu0 (20 mm: up to 0.5 m/s^2 at 5 rad/s)" in words


# ---- what was not measured is never exported as if it were ----

HELD = ("imu0.gyroscope.g_sensitivity[0,0]", "cam0.T_cam_imu.translation[0]", "cam0.T_cam_imu.translation[1]",
        "cam0.T_cam_imu.translation[2]")  # fmt: skip


@pytest.mark.parametrize("form", FORMATS)
def test_what_a_prior_holds_is_said_in_every_file(rig, form):
    calibration = rig(0, RADTAN, units=SI)
    problem = Finding(severity="problem", code="x", message="The board was bent */ by 3 mm.")
    assessment = replace(calibration.assessment, held_by_prior=HELD, verdict="fail", findings=(problem,))
    export = export_texts(replace(calibration, assessment=assessment), form)
    assert "held by assumption, not measured (4 numbers)" in said(export.losses)
    assert "verdict fail: this calibration should not be used: The board was bent" in said(export.losses)
    for text in export.files.values():
        flat = re.sub(r"\s*\n\s*(?:#|\*)?\s*", " ", text)
        assert (
            "Held by assumption, not measured: imu0.gyroscope.g_sensitivity[0,0], cam0.T_cam_imu.translation: " in flat
        )
        assert "this calibration should not be used" in flat
    if form == "c-header":
        assert export.files["gnomon_imu.h"].count("*/") == export.files["gnomon_imu.h"].count("/*")
    clean = export_texts(calibration, form)
    assert "held by" not in said(clean.losses).lower() + "".join(clean.files.values()).lower()


def test_files_with_remarks_are_read(rig, tmp_path):
    calibration = rig(0, RADTAN, units=SI)
    calibration = replace(calibration, assessment=replace(calibration.assessment, held_by_prior=HELD))
    for form in FORMATS:
        if form not in ("c-header", "json"):
            found, _ = through(calibration, form, tmp_path / form)
            assert found.imus or found.cameras


def test_lenses_taken_as_given_are_said(camera_calibration):
    words = said(export_texts(camera_calibration(0, cameras=1), "kalibr").losses)
    assert "taken as given, not estimated: intrinsics of cam0" in words
    assert "taken as given" not in said(export_texts(camera_calibration(0, cameras=1), "imucal").losses)


# ---- noise ----


@pytest.mark.parametrize("form", WITH_NOISE)
def test_noise_is_never_made_up_in_silence(rig, form):
    calibration = rig(0, RADTAN, units=SI)
    without, with_it = export_texts(calibration, form), export_texts(calibration, form, imu=STATED)
    assert "noise and rate: accelerometer_noise_density" in said(without.losses)
    assert "noise and rate" not in said(with_it.losses)
    text = "".join(without.files.values())
    if form == "basalt":
        assert "Noise and imu_update_rate of this file are not this IMU's" in text
    else:
        assert not re.search(r"(?m)^\W*(acc_n|sigma_g_c|IMU.NoiseGyro|gyroscope_noise_density)\s*:", text)
        assert re.search(r"also needs .*add them", text)
    alone = {"imu0": StatedImu(noise=NOISE)}
    assert "rate: update_rate" in said(export_texts(calibration, form, imu=alone).losses)


# ---- from one project to the other ----


def test_kalibr_to_all_of_them(rig, tmp_path):
    calibration = rig(4, RADTAN, RADTAN, units=SI)
    kalibr, _ = through(calibration, "kalibr", tmp_path / "kalibr")
    for form in FORMATS:
        losses = gnomon.convert(kalibr, form, tmp_path / form)
        assert "origin: converted from Kalibr" in said(losses)
        assert "noise and rate" not in said(losses)  # Kalibr's imu.yaml states them
        if form in ("vins-fusion", "orb-slam3", "okvis", "basalt", "openvins"):
            found = load_foreign(*sorted((tmp_path / form).iterdir()))
            for name, camera in calibration.cameras.items():
                close(found.cameras[name].T_cam_imu, camera.T_cam_imu)
            data = found.imu_data["imu0"]
            assert data.noise.gyroscope_noise_density == pytest.approx(8.73e-5, rel=1e-14)


def test_cameras_alone_have_an_ideal_imu(rig, tmp_path):
    gnomon.convert(rig(4, RADTAN, units=SI), "vins-fusion", tmp_path / "vins", imu=STATED)
    rigged = load_foreign(tmp_path / "vins/config.yaml")
    gnomon.convert(rigged, "kalibr", tmp_path / "kalibr")
    found = load_foreign(*sorted((tmp_path / "kalibr").iterdir()))
    assert np.array_equal(found.imus["imu0"].gyroscope.sensitivity, np.eye(3))
    with pytest.raises(FormatError, match="lenses without their poses"):
        gnomon.convert(load_foreign(tmp_path / "vins/cam0.yaml"), "kalibr", tmp_path / "none")


# ---- files as the projects themselves lay them out ----

T_BS = """0.0148655429818, -0.999880929698, 0.00414029679422, -0.0216401454975,
   0.999557249008, 0.0149672133247, 0.025715529948, -0.064676986768,
   -0.0257744366974, 0.00375618835797, 0.999660727178, 0.00981073058949,
   0.0, 0.0, 0.0, 1.0"""  # EuRoC's published pose of cam0
VINS = f"""%YAML:1.0

imu: 1
num_of_cam: 1
imu_topic: "/imu0"
image0_topic: "/cam0/image_raw"
cam0_calib: "cam0_pinhole.yaml"
image_width: 752
image_height: 480
body_T_cam0: !!opencv-matrix
   rows: 4
   cols: 4
   dt: d
   data: [{T_BS}]
acc_n: 0.1          # noise of a sample
gyr_n: 0.01
acc_w: 0.001
gyr_w: 0.0001
td: 0.002
"""
VINS_LENS = """%YAML:1.0
---
model_type: PINHOLE
camera_name: camera
image_width: 752
image_height: 480
distortion_parameters:
   k1: -2.917e-01
   k2: 8.228e-02
   p1: 5.333e-05
   p2: -1.578e-04
projection_parameters:
   fx: 4.616e+02
   fy: 4.603e+02
   cx: 3.630e+02
   cy: 2.481e+02
"""
ORB = f"""%YAML:1.0
File.version: "1.0"
Camera.type: "PinHole"
Camera1.fx: 458.654
Camera1.fy: 457.296
Camera1.cx: 367.215
Camera1.cy: 248.375
Camera1.k1: -0.28340811
Camera1.k2: 0.07395907
Camera1.p1: 0.00019359
Camera1.p2: 1.76187114e-05
Camera.width: 752
Camera.height: 480
Camera.fps: 20
IMU.T_b_c1: !!opencv-matrix
   rows: 4
   cols: 4
   dt: f
   data: [{T_BS}]
IMU.NoiseGyro: 1.7e-4 # comment
IMU.NoiseAcc: 2.0000e-3
IMU.GyroWalk: 1.9393e-05
IMU.AccWalk: 3.0000e-03
IMU.Frequency: 200.0
ORBextractor.nFeatures: 1000
"""
OKVIS = f"""%YAML:1.0
cameras:
     - {{T_SC: [{T_BS}],
        image_dimension: [752, 480],
        distortion_coefficients: [-0.28340811217, 0.0739590738929, 0.000193595028569, 1.76187114545e-05],
        distortion_type: radialtangential,
        focal_length: [458.654880721, 457.296696463],
        principal_point: [367.215803962, 248.37534061],
        camera_type: gray,
        slam_use: okvis}}
camera_parameters:
    timestamp_tolerance: 0.005
    image_delay: 0.003
imu_parameters:
    use: true
    sigma_g_c: 20.0e-4
    sigma_a_c: 20.0e-3
    sigma_gw_c: 20.0e-5
    sigma_aw_c: 20.0e-3
    a0: [ -0.05, 0.09, 0.01 ]
"""


def test_one_rig_in_the_layouts_of_three_projects(tmp_path):
    for name, text in (
        ("vins.yaml", VINS), ("cam0_pinhole.yaml", VINS_LENS), ("orb.yaml", ORB), ("okvis.yaml", OKVIS)
    ):  # fmt: skip
        (tmp_path / name).write_text(text)
    vins, orb, okvis = (load_foreign(tmp_path / f"{name}.yaml") for name in ("vins", "orb", "okvis"))
    expected = np.linalg.inv(np.array([float(x) for x in T_BS.replace("\n", " ").split(",")]).reshape(4, 4))
    for found, shift in ((vins, 0.002), (orb, 0.0), (okvis, -0.003)):
        assert np.abs(found.cameras["cam0"].T_cam_imu - expected).max() < 1e-9  # rounded numbers are made a rotation
        assert found.cameras["cam0"].time_shift_cam_imu == shift
        assert found.cameras["cam0"].camera.model == "pinhole-radtan"
        assert found.cameras["cam0"].camera.resolution == (752, 480)
    assert vins.imu_data["imu0"].noise is None
    assert any("the rate is not stated" in note for note in vins.notes)
    assert orb.imu_data["imu0"].noise.accelerometer_noise_density == 2e-3
    assert okvis.imus["imu0"].accelerometer.bias.tolist() == [-0.05, 0.09, 0.01]
    (tmp_path / "old.yaml").write_text(ORB.replace("Camera1.", "Camera.").replace("IMU.T_b_c1", "Tbc"))
    close(load_foreign(tmp_path / "old.yaml").cameras["cam0"].T_cam_imu, orb.cameras["cam0"].T_cam_imu, 0)
    old = OKVIS.replace("imu_parameters", "imu_params").replace("    image_delay: 0.003\n", "") + "imageDelay: 0.004\n"
    (tmp_path / "first_okvis.yaml").write_text(old)
    assert load_foreign(tmp_path / "first_okvis.yaml").cameras["cam0"].time_shift_cam_imu == -0.004


def test_the_published_rig_agrees_with_the_others(real_data, tmp_path):
    """EuRoC's pose in VINS', ORB-SLAM3's and OKVIS' letters against that of OpenVINS' file: alike if directions are."""
    (tmp_path / "orb.yaml").write_text(ORB)
    place = real_data("kalibr-format-samples/openvins_euroc_mav")
    other = load_foreign(place / "kalibr_imucam_chain.yaml").cameras["cam0"].T_cam_imu
    assert np.abs(load_foreign(tmp_path / "orb.yaml").cameras["cam0"].T_cam_imu - other).max() < 0.01


@pytest.mark.parametrize(
    ("name", "text", "expected"),
    [
        ("v.yaml", VINS, r"cam0_calib: there is no file .*cam0_pinhole.yaml"),
        ("o.yaml", ORB.replace("0.999660727178", "0.2"), "no rotation matrix"),
        ("l.yaml", VINS_LENS.replace("PINHOLE", "SCARAMUZZA"), "model_type"),
        ("l.yaml", VINS_LENS.replace("   cx:", "   c:"), "the key cx is missing"),
        ("o.yaml", ORB.replace("PinHole", "Fisheye"), r"Camera.type: found \"Fisheye\""),
        ("o.yaml", ORB.replace("Camera.width", "Camera.w"), "Camera.width is missing"),
        ("k.yaml", OKVIS.replace("radialtangential", "fisheye"), "distortion_type"),
        ("k.yaml", OKVIS.replace("[458.654880721, ", "["), "found 1 numbers, expected 2"),
        ("r.yaml", "launch:\n- node: {exec: static_transform_publisher, args: '1 2 3'}\n", "--frame-id is missing"),
        ("r.yaml", "launch:\n- include: {file: x}\n", "no static transform from an IMU"),
        ("r.yaml", "launch:\n- node: {exec: static_transform_publisher, args: '--yaw 1 --frame-id imu0 "
         "--child-frame-id cam0'}\n", "reads quaternions"),
    ],
)  # fmt: skip
def test_bad_files_are_named(tmp_path, name, text, expected):
    (tmp_path / name).write_text(text)
    with pytest.raises(FormatError, match=expected) as caught:
        load_foreign(tmp_path / name)
    assert str(tmp_path / name) in str(caught.value)


# ---- a lens with k3 ----

K3 = replace(RADTAN, distortion="radtan5", distortion_coeffs=[-0.28, 0.075, 2e-4, -1.5e-4, -0.02])


@pytest.mark.parametrize("form", ["orb-slam3", "okvis", "ros2", "basalt", "csv"])
def test_k3_is_held(rig, tmp_path, form):
    found, losses = through(rig(0, K3, units=SI), form, tmp_path, imu=STATED)
    assert found.cameras["cam0"].camera.model == "pinhole-radtan5"
    assert np.array_equal(found.cameras["cam0"].camera.distortion_coeffs, K3.distortion_coeffs)
    assert "k3 of cam0" not in said(losses)


@pytest.mark.parametrize("form", ["kalibr", "openvins", "vins-fusion"])
def test_k3_is_made_up_for_and_what_is_left_is_said(rig, tmp_path, form):
    found, losses = through(rig(0, K3, units=SI), form, tmp_path)
    camera = found.cameras["cam0"].camera
    assert camera.model == "pinhole-radtan"
    assert np.array_equal(camera.intrinsics, K3.intrinsics)
    u, v = np.meshgrid(np.linspace(0, 639, 40), np.linspace(0, 479, 40))
    pixels = np.column_stack([u.ravel(), v.ravel()])
    rays, valid = K3.unproject(pixels)
    off = np.linalg.norm(camera.project(rays[valid]).pixels - pixels[valid], axis=1)
    rms, largest = re.search(r"k3 of cam0 \(([\d.e-]+) px rms, up to ([\d.e-]+) px\)", said(losses)).groups()
    assert float(rms) == pytest.approx(np.sqrt(np.mean(off**2)), rel=0.06)
    assert float(largest) == pytest.approx(off.max(), rel=0.06)
    cut = replace(RADTAN, distortion_coeffs=K3.distortion_coeffs[:4])  # as if k3 were simply left out
    naive = np.linalg.norm(cut.project(rays[valid]).pixels - pixels[valid], axis=1)
    assert np.sqrt(np.nanmean(naive**2)) > 5 * float(rms)
