"""What is known of the sensors beforehand, from whichever file it stands in, and what of it reaches the recording."""

import json
from dataclasses import replace

import numpy as np
import pytest
import yaml

import gnomon
from gnomon.errors import FormatError
from gnomon.formats.own.calibration_text import calibration_text
from gnomon.formats.sensor_inputs import read_cameras, read_imus

CAM = {
    "camera_model": "pinhole",
    "intrinsics": [460.0, 458.5, 322.4, 237.1],
    "distortion_model": "radtan",
    "distortion_coeffs": [-0.28, 0.075, 0.0002, -0.00015],
    "resolution": [640, 480],
}
SIGMA = [0.5, 0.6, 0.7, 0.8, 0.001, 0.002, 0.0003, 0.0004]
RESULTS = """\
Calibration results 
====================
Camera-system parameters:
cam0 (/cam0/image_raw):
    type: <class 'aslam_cv.libaslam_cv_python.DistortedPinholeCameraGeometry'>
    distortion: [-0.28     0.075    0.0002  -0.00015] +- [0.001  0.002  0.0003 0.0004]
    projection: [460.  458.5 322.4 237.1] +- [0.5 0.6 0.7
 0.8]
    reprojection error: [-0.000001, 0.000002] +- [0.064207, 0.065217]

Target configuration
====================

  Type: aprilgrid
"""  # noqa: W291 - as Kalibr prints it


def write(path, content):
    path.write_text(content if isinstance(content, str) else yaml.safe_dump(content))
    return path


def test_camchain_with_standard_deviations(tmp_path):
    stated = {**CAM, "intrinsics_sigma": SIGMA[:4], "distortion_coeffs_sigma": SIGMA[4:]}
    notes = []
    found = read_cameras(write(tmp_path / "camchain.yaml", {"cam0": stated, "cam1": CAM}), notes)
    assert np.array_equal(found["cam0"].lens_covariance, np.diag(np.square(SIGMA)))
    assert found["cam1"].lens_covariance is None
    assert notes == []


def test_lens_without_distortion_has_no_sigma_of_it(tmp_path):
    stated = {**CAM, "distortion_model": "none", "distortion_coeffs": [], "intrinsics_sigma": SIGMA[:4]}
    found = read_cameras(write(tmp_path / "camchain.yaml", {"cam0": stated}))
    assert found["cam0"].lens_covariance.shape == (4, 4)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"intrinsics_sigma": SIGMA[:4]}, "the key distortion_coeffs_sigma is missing. Expected 4 standard deviations"),
        (
            {"intrinsics_sigma": SIGMA[:3], "distortion_coeffs_sigma": SIGMA[4:]},
            r"intrinsics_sigma: found \[.*expected 4",
        ),
        ({"intrinsics_sigma": [0, 1, 1, 1], "distortion_coeffs_sigma": SIGMA[4:]}, "greater than zero"),
        ({"intrinsics_sigma": ["a", 1, 1, 1], "distortion_coeffs_sigma": SIGMA[4:]}, 'found the text "a"'),
    ],
)
def test_bad_standard_deviations(tmp_path, changes, message):
    with pytest.raises(FormatError, match=message):
        read_cameras(write(tmp_path / "camchain.yaml", {"cam0": {**CAM, **changes}}))


def test_gnomons_own_calibration_brings_its_covariance(tmp_path, camera_calibration):
    calibration = camera_calibration(1)
    index = [i for i, name in enumerate(calibration.uncertainty.names) if name.startswith(("cam0.intr", "cam0.dist"))]
    matrix = calibration.uncertainty.matrix.copy()
    root = np.random.default_rng(0).normal(size=(8, 8))
    matrix[np.ix_(index, index)] = root @ root.T
    known = replace(calibration, uncertainty=replace(calibration.uncertainty, matrix=matrix))
    found = read_cameras(write(tmp_path / "calibration.yaml", calibration_text(known)))
    for name, camera in calibration.cameras.items():
        assert np.array_equal(found[name].camera.parameters, camera.camera.parameters)
        assert np.array_equal(found[name].T_cam_imu, camera.T_cam_imu)
        assert found[name].time_shift_cam_imu_s == camera.time_shift_cam_imu
    # The order is that of Camera.parameters: the intrinsics, then the distortion.
    assert np.array_equal(found["cam0"].lens_covariance, known.covariance("cam0.intrinsics", "cam0.distortion_coeffs"))
    assert found["cam0"].lens_covariance[0, 7] == matrix[index[0], index[7]] != 0
    assert found["cam1"].lens_covariance is None  # its lens was held


def test_gnomons_own_calibration_of_an_imu_alone(tmp_path, random_calibration):
    with pytest.raises(FormatError, match=r"is of an IMU alone\. Give one with cameras"):
        read_cameras(write(tmp_path / "calibration.yaml", calibration_text(random_calibration())))


def test_gnomons_own_calibration_stays_strict(tmp_path, camera_calibration):
    text = calibration_text(camera_calibration(1)).replace("cameras:", "colour: red\ncameras:", 1)
    with pytest.raises(FormatError, match="colour: unknown key"):
        read_cameras(write(tmp_path / "calibration.yaml", text))


@pytest.mark.parametrize("to", ["kalibr", "openvins", "basalt"])
def test_other_projects_cameras(tmp_path, camera_calibration, to):
    calibration = camera_calibration(1, cameras=1)
    gnomon.convert(calibration, to, tmp_path)
    file = {"kalibr": "camchain-imucam.yaml", "openvins": "kalibr_imucam_chain.yaml", "basalt": "calibration.json"}[to]
    found = read_cameras(tmp_path / file)["cam0"]
    expected = calibration.cameras["cam0"]
    assert np.array_equal(found.camera.parameters, expected.camera.parameters)
    assert np.allclose(found.T_cam_imu, expected.T_cam_imu, atol=1e-14)
    assert found.time_shift_cam_imu_s == pytest.approx(expected.time_shift_cam_imu, abs=6e-10)
    assert found.lens_covariance is None


@pytest.mark.parametrize("name", ["results-cam.txt", "data-results-cam.txt", "data-results-cam-2024-01-01.txt"])
def test_standard_deviations_of_kalibrs_camera_calibration(tmp_path, name):
    write(tmp_path / name.replace("results-cam", "camchain").replace(".txt", ".yaml"), {"cam0": CAM, "cam1": CAM})
    notes = []
    found = read_cameras(write(tmp_path / name, RESULTS), notes)
    assert np.array_equal(np.sqrt(np.diag(found["cam0"].lens_covariance)), SIGMA)  # the order of Kalibr's is other
    assert found["cam0"].camera.resolution == (640, 480)
    assert found["cam1"].lens_covariance is None
    assert any("has no standard deviations of cam1" in note for note in notes)


def test_results_of_cameras_without_or_with_another_chain(tmp_path):
    path = write(tmp_path / "results-cam.txt", RESULTS)
    with pytest.raises(FormatError, match=r"camchain\.yaml is not beside it"):
        read_cameras(path)
    chain = write(tmp_path / "camchain.yaml", {"cam0": {**CAM, "intrinsics": [461.0, 458.5, 322.4, 237.1]}})
    with pytest.raises(FormatError, match="The two files are not of one calibration"):
        read_cameras(path)
    write(chain, {"cam0": CAM})
    for old, new, message in (
        ("projection: [460", "projection: [none", "has no line projection"),
        ("0.001  0.002  0.0003 0.0004", "0.001  0.002", "has 4 values of distortion, and 2 behind"),
    ):
        with pytest.raises(FormatError, match=message):
            read_cameras(write(path, RESULTS.replace(old, new)))
    notes = []
    write(path, RESULTS.replace("+- [0.5", "+- [0.0"))
    assert read_cameras(path, notes)["cam0"].lens_covariance is None
    assert any("not all above zero" in note for note in notes)


def test_json_and_other_files_that_hold_no_camera(tmp_path):
    for content, message in (
        ('{"cal_type": "Ferraris"}', "the key cam0 is missing"),
        ("{", "this is not JSON"),
        ({"target_type": "aprilgrid", "tagCols": 6}, "which belongs to --target"),
    ):
        with pytest.raises(FormatError, match=message):
            read_cameras(write(tmp_path / "file", content))


# ---- noise ----

NOISE = {
    "accelerometer_noise_density": 0.0039,
    "accelerometer_random_walk": 0.0012,
    "gyroscope_noise_density": 8.73e-5,
    "gyroscope_random_walk": 2e-5,
}


def test_noise_of_every_project(tmp_path, real_data):
    rendered, samples = real_data("rendered-camimu/a-aprilgrid-full"), real_data("kalibr-format-samples")
    for path in (rendered / "imu.yaml", rendered / "kalibr/scale-misalignment-size-effect/data-imu.yaml"):
        assert read_imus(path)["imu0"].noise.gyroscope_noise_density == 8.73e-5
    notes = []
    assert read_imus(samples / "openvins_rs_d455/kalibr_imu_chain.yaml", notes)["imu0"].update_rate_hz == 400
    assert any("Tw" in note for note in notes)
    notes = []
    found = read_imus(samples / "basalt/euroc_ds_calib.json", notes)["imu0"]
    assert (found.noise.accelerometer_noise_density, found.update_rate_hz) == (0.016, 200)
    assert any("sensor model in it was passed over" in note for note in notes)
    euroc = {"sensor_type": "imu", "T_BS": {"cols": 4, "rows": 4, "data": np.eye(4).ravel().tolist()}, "rate_hz": 200}
    assert read_imus(write(tmp_path / "sensor.yaml", {**euroc, **NOISE}))["imu0"].update_rate_hz == 200


def test_yaml_in_flow_style_begins_like_json(tmp_path):
    noise = ", ".join(f"{key}: {value}" for key, value in NOISE.items())
    found = read_imus(write(tmp_path / "imu.yaml", f"{{update_rate: 200.0, {noise}}}"))["imu0"]
    assert (found.update_rate_hz, found.noise.gyroscope_noise_density) == (200, 8.73e-5)
    assert (
        read_imus(write(tmp_path / "imu.json", json.dumps({"update_rate": 100.0, **NOISE})))["imu0"].noise
        == found.noise
    )
    chain = yaml.safe_dump({"cam0": CAM}, default_flow_style=True, width=1000)
    assert chain.startswith("{cam0")
    read = read_cameras(write(tmp_path / "camchain.yaml", chain))["cam0"].camera
    assert read.intrinsics.tolist() == CAM["intrinsics"]
    with pytest.raises(FormatError, match=r"imu.yaml, line 1: this is not JSON"):
        read_imus(write(tmp_path / "imu.yaml", "{update_rate: [200.0"))


def test_basalt_without_noise(tmp_path):
    path = write(tmp_path / "c.json", json.dumps({"value0": {"T_imu_cam": [], "intrinsics": [], "resolution": []}}))
    with pytest.raises(FormatError, match="no usable accel_noise_std"):
        read_imus(path)
    with pytest.raises(FormatError, match="holds no camera"):
        read_cameras(path)


# ---- as far as the recording ----


def test_covariance_reaches_the_frames(tmp_path):
    stated = {**CAM, "intrinsics_sigma": SIGMA[:4], "distortion_coeffs_sigma": SIGMA[4:]}
    write(tmp_path / "camchain.yaml", {"cam0": stated})
    board = {"target_type": "aprilgrid", "tagCols": 6, "tagRows": 6, "tagSize": 0.088, "tagSpacing": 0.3}
    write(tmp_path / "target.yaml", board)
    write(tmp_path / "cam0_corners.csv", "ts_ns,corner_id,u_px,v_px\n0,0,100,100\n0,1,120,100\n50000000,0,101,100\n")
    rows = "".join(f"{i * 5_000_000},0.1,0.2,0.3,0.1,9.8,0.3\n" for i in range(100))
    write(tmp_path / "imu0.csv", "ts_ns,wx,wy,wz,ax,ay,az\n" + rows)
    from gnomon import read_camera_imu

    recording, _ = read_camera_imu(
        tmp_path, cam=tmp_path / "camchain.yaml", imu=None, target=tmp_path / "target.yaml", units="si"
    )
    assert np.array_equal(recording.cameras["cam0"].lens_covariance, np.diag(np.square(SIGMA)))
