"""Kalibr's output files: laid out as Kalibr lays them out, and read back as what they were."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

import gnomon
from gnomon.formats.conversion import export_texts
from gnomon.formats.foreign import Residuals, Statistics
from gnomon.formats.kalibr.camchain import camchain_text, read_camchain
from gnomon.formats.kalibr.imu import StatedImu, imu_text, read_imu_input
from gnomon.formats.kalibr.results import read_kalibr_results
from gnomon.formats.kalibr.target import read_target
from gnomon.formats.own.calibration_text import calibration_text
from gnomon.geometry.rotations import rotation_from_quaternion
from gnomon.models.camera import Camera
from gnomon.models.target import Target
from gnomon.results.calibration import Assessment, Calibration, CameraCalibration, Covariance, Gravity, Provenance
from gnomon.results.sensors import covariance_names
from gnomon.writers.kalibr_files import KalibrResults, camera_imu_texts, residual_statistics, save_camera_imu_files
from kalibr_imus import read_kalibr

SAMPLES = [
    "a-aprilgrid-full/kalibr/calibrated",
    "a-aprilgrid-full/kalibr/scale-misalignment",
    "a-aprilgrid-full/kalibr/scale-misalignment-size-effect",
    "a-aprilgrid-full/kalibr/sm_sigma0.1",
    "b-aprilgrid-ideal-imu/kalibr/calibrated",
    "d-checkerboard-ideal-imu/kalibr/cal",
]
NUMBER = re.compile(r"-?\d+\.\d*(?:e[-+]\d+)?")


def own_lines(text):
    return [line for line in text.splitlines() if not line.startswith("#")]


@pytest.fixture(params=SAMPLES, ids=lambda name: name.replace("/kalibr", ""))
def sample(request, real_data):
    """A folder that Kalibr wrote: its files, and a calibration with the numbers in them."""
    folder = real_data("rendered-camimu") / request.param
    texts = {
        name: (folder / f"data-{name}").read_text()
        for name in ("camchain-imucam.yaml", "imu.yaml", "results-imucam.txt")
    }
    imus = read_kalibr(folder / "data-imu.yaml").imus
    cameras = {
        name: CameraCalibration(
            T_cam_body=np.array(yaml.safe_load(texts["camchain-imucam.yaml"])[name]["T_cam_imu"]),
            time_shift_cam_imu=stated.time_shift_cam_imu_s,
            camera=stated.camera,
        )
        for name, stated in read_camchain(folder / "data-camchain-imucam.yaml").items()
    }
    target = read_target(folder.parents[1] / "target.yaml")
    return texts, calibration_of(imus, cameras), target, read_imu_input(folder / "data-imu.yaml")


def calibration_of(imus, cameras):
    names = covariance_names(imus, cameras)
    return Calibration(
        imus=imus,
        cameras=cameras,
        frame="accel-x",
        gravity=Gravity(value=9.80655, sigma=0.0, source="Kalibr"),
        uncertainty=Covariance(names=names, matrix=np.zeros((len(names),) * 2)),
        assessment=Assessment(verdict="pass", findings=(), model="full"),
        provenance=Provenance(gnomon_version="0", method="camera-imu"),
    )


def stated(inputs):
    return {
        name: StatedImu(noise=found.noise, update_rate_hz=found.update_rate_hz, topic=found.topic)
        for name, found in inputs.items()
    }


def test_camchain_is_kalibrs(sample):
    texts, calibration, *_ = sample
    assert own_lines(camchain_text(calibration)) == texts["camchain-imucam.yaml"].splitlines()


def test_imu_yaml_is_kalibrs(sample):
    texts, calibration, _, inputs = sample
    ours, theirs = own_lines(imu_text(calibration, stated(inputs))), texts["imu.yaml"].splitlines()
    assert len(ours) == len(theirs)
    for line, expected in zip(ours, theirs, strict=True):
        # What passes through M and C of the gyroscope may be rounded.
        assert NUMBER.sub("#", line) == NUMBER.sub("#", expected)
        found, right = ([float(x) for x in NUMBER.findall(text)] for text in (line, expected))
        assert np.allclose(found, right, rtol=1e-12, atol=1e-15)


def statistics_of(text):
    """The residuals that Kalibr printed."""
    numbers = {}
    for line in text.splitlines():
        match = re.match(r"(\w+) error \((\w+)\)( \[.*\])?: +mean (\S+), median (\S+), std: (\S+)", line)
        if match:
            kind, sensor, unit, *values = match.groups()
            key = sensor if kind == "Reprojection" else f"{sensor}.{kind.lower()}"
            found = Statistics(**dict(zip(("mean", "median", "std"), map(float, values), strict=True)))
            numbers.setdefault(key, {})["normalised" if unit is None else "plain"] = found
    return {key: Residuals(**value) for key, value in numbers.items()}


def test_results_are_laid_out_as_kalibrs(sample):
    texts, calibration, target, inputs = sample
    theirs = texts["results-imucam.txt"]
    gravity = np.array(re.search(r"Gravity vector.*\n\[(.*)\]", theirs)[1].split(), dtype=float)
    results = KalibrResults(
        calibration=calibration,
        target=target,
        residuals=statistics_of(theirs),
        gravity_target=gravity,
        imus=stated(inputs),
    )
    ours = results.text().splitlines()
    assert len(ours) == len(theirs.splitlines())
    for line, expected in zip(ours, theirs.splitlines(), strict=True):
        # Every column at its place: numbers of the same length, the spaces around them alike.
        assert NUMBER.sub(lambda m: "#" * len(m[0]), line) == NUMBER.sub(lambda m: "#" * len(m[0]), expected)
        found, right = ([float(x) for x in NUMBER.findall(text)] for text in (line, expected))
        assert np.allclose(found, right, rtol=0, atol=1.1e-8)


# --- several cameras, other lenses ---


def test_several_cameras(camera_calibration, tmp_path):
    calibration = camera_calibration(2, cameras=4)
    text = camchain_text(calibration)
    chain = yaml.safe_load(text)
    assert list(chain) == ["cam0", "cam1", "cam2", "cam3"]
    for name, camera in calibration.cameras.items():
        assert list(chain[name]) == sorted(chain[name])
        assert chain[name]["T_cam_imu"] == camera.T_cam_imu.tolist()
        assert chain[name]["timeshift_cam_imu"] == camera.time_shift_cam_imu
    for before, name in (("cam0", "cam1"), ("cam1", "cam2"), ("cam2", "cam3")):
        expected = calibration.cameras[name].T_cam_imu @ np.linalg.inv(calibration.cameras[before].T_cam_imu)
        assert np.allclose(chain[name]["T_cn_cnm1"], expected, atol=1e-14)
    assert "T_cn_cnm1" not in chain["cam0"]
    (tmp_path / "chain.yaml").write_text(text)
    notes = []
    read = read_camchain(tmp_path / "chain.yaml", notes)
    assert notes == []
    for name, camera in calibration.cameras.items():
        again = read[name].camera
        assert np.array_equal(again.parameters, camera.camera.parameters)
        assert (again.model, again.resolution, again.topic) == (
            camera.camera.model, camera.camera.resolution, camera.camera.topic,
        )  # fmt: skip
        assert again.line_delay_s == camera.camera.line_delay_s
        assert np.allclose(read[name].T_cam_imu, camera.T_cam_imu, atol=1e-14)


def results_of(calibration, target=None):
    imus = {
        name: StatedImu(noise=gnomon.recording.samples.consumer_mems(), update_rate_hz=200.0)
        for name in calibration.imus
    }
    return KalibrResults(
        calibration=calibration,
        target=target or Target.aprilgrid(tag_cols=6, tag_rows=5, tag_size_m=0.088, tag_spacing=0.3),
        residuals={},
        gravity_target=np.array([0.1, -9.8, 0.2]),
        imus=imus,
    ).text()


def test_results_of_several_cameras(camera_calibration):
    calibration = camera_calibration(2, cameras=4)
    text = results_of(calibration)
    for name in calibration.cameras:
        assert re.search(rf"Transformation \({name}\):\n-{{23}}\nT_ci:  \(imu0 to {name}\): \n\[\[", text)
        assert f"Reprojection error ({name}):     no corners" in text
    assert "\n\n\nTransformation (cam1)" in text
    block = text.split("Baselines:\n----------\n")[1].split("\n\n\nGravity vector")[0]
    baselines = re.findall(r"Baseline \((\w+) to (\w+)\): \n(\[\[[^a-z]*\]\])\nbaseline norm:  (\S+) \[m\]", block)
    assert [(first, second) for first, second, *_ in baselines] == [
        ("cam0", "cam1"),
        ("cam1", "cam2"),
        ("cam2", "cam3"),
    ]
    for first, second, matrix, norm in baselines:
        T = calibration.cameras[second].T_cam_imu @ np.linalg.inv(calibration.cameras[first].T_cam_imu)
        numbers = np.array(re.sub(r"[\[\]]", " ", matrix).split(), dtype=float).reshape(4, 4)
        assert np.allclose(numbers, T, atol=1e-8)
        assert float(norm) == pytest.approx(np.linalg.norm(T[:3, 3]))
    for line in ("  Omni xi: 0.9", "  EUCM alpha: 0.6", "  EUCM beta: 1.1", "  DS xi: -0.2", "  DS alpha: 0.55"):
        assert line in text.splitlines()
    assert "  Focal length: [290.25, 291.5]\n  Principal point: [319.0, 241.0]\n  DS xi" in text


def test_charuco_of_which_kalibr_knows_nothing(camera_calibration, tmp_path):
    target = Target.charuco(
        cols=8, rows=6, square_size_m=0.03, marker_size_m=0.022, dictionary="6X6_250", first_marker=3, legacy=True
    )
    (tmp_path / "results-imucam.txt").write_text(results_of(camera_calibration(cameras=1), target))
    found = read_kalibr_results(tmp_path / "results-imucam.txt").target
    assert found.describe() == target.describe()
    assert np.array_equal(found.points, target.points)


def test_circles(camera_calibration):
    text = results_of(camera_calibration(cameras=1), Target.circlegrid(cols=7, rows=6, spacing_m=0.02))
    assert "  Type: circlegrid\n  Rows\n    Count: 6\n    Distance: 0.02 [m]\n  Cols\n    Count: 7\n" in text


# --- a whole result ---


def test_files_of_a_result(camera_imu_case, tmp_path):
    result, recording, target = camera_imu_case()
    paths = save_camera_imu_files(result, recording, target, tmp_path)
    assert sorted(path.name for path in paths) == [
        "camchain-imucam.yaml", "imu.yaml", "results-imucam.txt", "trajectory.txt",
    ]  # fmt: skip
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(path.name for path in paths)
    first = {path.name: path.read_bytes() for path in paths}
    save_camera_imu_files(result, recording, target, tmp_path)
    assert {path.name: path.read_bytes() for path in paths} == first
    imu = read_kalibr(tmp_path / "imu.yaml").imus["imu0"]
    truth = result.calibration.imus["imu0"]
    assert np.allclose(imu.accelerometer.sensitivity, truth.accelerometer.sensitivity, atol=1e-15)
    assert np.allclose(imu.gyroscope.sensitivity, truth.gyroscope.sensitivity, atol=1e-14)
    assert np.allclose(imu.gyroscope.g_sensitivity, truth.gyroscope.g_sensitivity, atol=1e-17)


def test_imu_yaml_repeats_the_nominal_noise_and_tells_the_estimated(camera_imu_case, tmp_path):
    result, recording, target = camera_imu_case()
    text = camera_imu_texts(result, recording, target)["imu.yaml"]
    (tmp_path / "imu.yaml").write_text(text)
    notes = []
    found = read_imu_input(tmp_path / "imu.yaml", notes)["imu0"]
    samples = recording.imus["imu0"]
    assert found.noise == samples.noise
    assert (found.update_rate_hz, found.topic) == (200.0, "/imu0")
    level = next(level for level in result.diagnostics.noise if level.name == "imu0.gyroscope")
    assert f"# imu0: gyroscope_noise_density found in the residuals: {level.estimated:.4g} rad/s/sqrt(Hz)" in text


def test_noise_that_nobody_stated_is_that_which_was_used(camera_imu_case):
    result, recording, target = camera_imu_case()
    imus = {"imu0": replace(recording.imus["imu0"], noise=None)}
    text = camera_imu_texts(result, replace(recording, imus=imus), target)["imu.yaml"]
    entry = yaml.safe_load(text)["imu0"]
    used = {level.name: level.used for level in result.diagnostics.noise}
    assert entry["accelerometer_noise_density"] == used["imu0.accelerometer"]
    assert entry["gyroscope_random_walk"] == result.diagnostics.biases["imu0.gyroscope"].random_walk
    assert "no noise was stated" in text


def test_basic_model_is_kalibrs_calibrated(camera_imu_case):
    result, recording, target = camera_imu_case(model="basic")
    texts = camera_imu_texts(result, recording, target)
    entry = yaml.safe_load(texts["imu.yaml"])["imu0"]
    assert entry["model"] == "calibrated"
    assert "accelerometers" not in entry
    assert "  Model: calibrated\n" in texts["results-imucam.txt"]
    assert "C_gyro_i" not in texts["results-imucam.txt"] + texts["imu.yaml"]


def test_statistics_of_what_was_used(camera_imu_case):
    result, *_ = camera_imu_case()
    diagnostics = result.diagnostics
    found = residual_statistics(diagnostics)
    fit = diagnostics.corners["cam0"]
    used = [
        np.hypot(*residual)
        for residual, frame in zip(fit.residual, fit.frame, strict=True)
        if fit.frame_used[frame] and np.isfinite(residual).all()
    ]
    assert 0 < len(used) < len(fit.residual)
    assert found["cam0"].plain.mean == pytest.approx(np.mean(used), rel=1e-12)
    assert found["cam0"].plain.median == pytest.approx(np.median(used), rel=1e-12)
    assert found["cam0"].normalised.std == pytest.approx(np.std(used) / fit.sigma_px, rel=1e-12)
    signal = diagnostics.signals["imu0.gyroscope"]
    # The length of three numbers of standard deviation one has the mean sqrt(8/pi).
    assert found["imu0.gyroscope"].normalised.mean == pytest.approx(np.sqrt(8 / np.pi), rel=0.02)
    assert found["imu0.gyroscope"].plain.mean == pytest.approx(np.sqrt(8 / np.pi) * signal.sigma, rel=0.02)


def test_what_gnomon_adds_stands_at_the_end(camera_imu_case):
    result, recording, target = camera_imu_case()
    kalibrs, added = camera_imu_texts(result, recording, target)["results-imucam.txt"].split("Added by gnomon\n")
    assert "sigma" not in kalibrs.lower()
    for words in ("Verdict:", "cam0.T_cam_imu.rotation [rad]", "cam0.time_shift_cam_imu [s]: ", "imu0.gyroscope ["):
        assert words in added
    sigma = result.calibration.sigma("cam0.time_shift_cam_imu")
    assert f"cam0.time_shift_cam_imu [s]: {sigma:.3g}" in added
    # Nothing that a parser of Kalibr's file would take for Kalibr's.
    for words in ("timeshift", "T_ci", "T_ic", "mean ", "Gravity vector", "Baseline", "Focal"):
        assert words not in added


def test_nothing_that_was_used_gives_no_statistics(camera_imu_case):
    result, recording, target = camera_imu_case()
    fit = result.diagnostics.corners["cam0"]
    none = {"cam0": replace(fit, frame_used=np.zeros_like(fit.frame_used))}
    empty = replace(result, diagnostics=replace(result.diagnostics, corners=none))
    assert (
        "Reprojection error (cam0) [px]:     no corners"
        in camera_imu_texts(empty, recording, target)["results-imucam.txt"]
    )


def test_trajectory(camera_imu_case):
    result, recording, target = camera_imu_case()
    track = result.diagnostics.trajectory
    lines = [
        line for line in camera_imu_texts(result, recording, target)["trajectory.txt"].splitlines() if line[0] != "#"
    ]
    assert len(lines) == len(track.t_ns)
    for k in (0, 1, 777, len(lines) - 1):
        stamp, *numbers = lines[k].split(" ")
        seconds, nanoseconds = stamp.split(".")
        assert len(nanoseconds) == 9
        assert int(seconds) * 10**9 + int(nanoseconds) == track.t_ns[k]
        x, y, z, qx, qy, qz, qw = map(float, numbers)
        assert np.allclose([x, y, z], track.p_target_imu[k], atol=1e-9)
        expected = rotation_from_quaternion(track.q_target_imu_wxyz[k])
        assert np.allclose(rotation_from_quaternion(np.array([qw, qx, qy, qz])), expected, atol=1e-11)


@pytest.mark.parametrize("stamp", [0, 1, 10**9 - 1, 1_600_000_000_123_456_789, -1, -(10**9), -1_500_000_001])
def test_stamps_lose_nothing(stamp, camera_imu_case):
    result, recording, target = camera_imu_case()
    track = replace(result.diagnostics.trajectory, t_ns=np.full(len(result.diagnostics.trajectory.t_ns), stamp))
    shifted = replace(result, diagnostics=replace(result.diagnostics, trajectory=track))
    text = camera_imu_texts(shifted, recording, target)["trajectory.txt"].splitlines()[2].split()[0]
    whole, fraction = text.lstrip("-").split(".")
    assert (int(whole) * 10**9 + int(fraction)) * (-1 if text.startswith("-") else 1) == stamp


# --- gnomon convert ---


def said(losses):
    return " | ".join(str(loss) for loss in losses)


@pytest.mark.parametrize("frame", ["accel-x", "accel-z"])
def test_convert_to_kalibr_takes_the_cameras_along(camera_calibration, tmp_path, frame):
    calibration = camera_calibration(4, frame=frame)
    losses = gnomon.convert(calibration, "kalibr", tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["camchain-imucam.yaml", "imu.yaml"]
    expected = calibration.in_frame("accel-x")
    for name, camera in read_camchain(tmp_path / "camchain-imucam.yaml").items():
        assert np.allclose(camera.T_cam_imu, expected.cameras[name].T_cam_imu, atol=1e-14)
    assert "cam0, cam1" not in said(losses)
    assert ("another camera" in said(losses)) == (frame == "accel-z")


@pytest.mark.parametrize("to", ["imu_tk", "imucal", "c-header"])
def test_formats_without_cameras_say_so(camera_calibration, random_calibration, to):
    assert "cam0, cam1: " in said(export_texts(camera_calibration(4), to).losses)
    assert "camera" not in said(export_texts(random_calibration(4), to).losses).replace("pose of a camera", "")


def test_csv_lists_the_cameras(camera_calibration, tmp_path):
    from gnomon.formats.own.other_forms import read_parameter_csv

    calibration = camera_calibration(4, cameras=3)
    gnomon.convert(calibration, "csv", tmp_path)
    text = (tmp_path / "calibration.csv").read_text()
    assert "cam0.model,pinhole-radtan,," in text.splitlines()
    shift, sigma = calibration.cameras["cam0"].time_shift_cam_imu, float(calibration.sigma("cam0.time_shift_cam_imu"))
    assert f'"cam0.time_shift_cam_imu",{shift!r},{sigma!r},s' in text.splitlines()
    assert '"cam2.intrinsics[0]",0.9,0.0,1' in text.splitlines()
    assert '"cam2.intrinsics[1]",540.5,0.0,px' in text.splitlines()
    read = read_parameter_csv(tmp_path / "calibration.csv")
    assert list(read.imus) == ["imu0"]
    assert list(read.cameras) == ["cam0", "cam1", "cam2"]
    older = [line for line in text.splitlines() if ".resolution" not in line]
    (tmp_path / "calibration.csv").write_text("\n".join(older))
    read = read_parameter_csv(tmp_path / "calibration.csv")
    assert read.notes == ("cam0 was passed over.", "cam1 was passed over.", "cam2 was passed over.")


def test_topics_that_nobody_stated_are_left_out(camera_calibration):
    calibration = camera_calibration(cameras=1)
    camera = calibration.cameras["cam0"]
    lens = Camera(
        projection="pinhole", intrinsics=[400, 400, 320, 240], distortion="none", distortion_coeffs=[],
        resolution=(640, 480),
    )  # fmt: skip
    nameless = replace(calibration, cameras={"cam0": replace(camera, camera=lens)})
    assert "rostopic" not in camchain_text(nameless)
    assert 'rostopic: ""' in calibration_text(nameless)


def test_pair_of_files_is_kalibrs_input_again(camera_imu_case, tmp_path):
    """Kalibr, and gnomon, start from what they wrote."""
    result, recording, target = camera_imu_case()
    save_camera_imu_files(result, recording, target, tmp_path)
    chain = read_camchain(Path(tmp_path / "camchain-imucam.yaml"))
    assert np.allclose(chain["cam0"].T_cam_imu, result.calibration.cameras["cam0"].T_cam_imu, atol=1e-14)
    assert chain["cam0"].time_shift_cam_imu_s == result.calibration.cameras["cam0"].time_shift_cam_imu
