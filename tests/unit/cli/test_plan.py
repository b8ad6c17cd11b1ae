"""What a plan predicts, against recordings that were simulated as planned."""

import json
from dataclasses import asdict, replace

import numpy as np
import pytest

import gnomon
from gnomon.cli import main
from gnomon.errors import OptionError
from gnomon.formats.shared.yaml_text import kalibr_yaml
from gnomon.recording.samples import ImuNoise
from gnomon.simulate.camera_imu_rig import CONSUMER_NOISE

BLOCKS = (
    "imu0.gyroscope.sensitivity",
    "imu0.gyroscope.bias",
    "imu0.gyroscope.g_sensitivity",
    "imu0.accelerometer.sensitivity",
    "imu0.accelerometer.bias",
)
CAMERA_BLOCKS = ("cam0.T_cam_imu.rotation", "cam0.T_cam_imu.translation", "cam0.time_shift_cam_imu")
HAND_NOISE = ImuNoise(
    accelerometer_noise_density=7e-4,
    gyroscope_noise_density=4.3e-4,
    accelerometer_random_walk=1e-5,
    gyroscope_random_walk=1e-5,
)


def assert_predicted(predicted, result, blocks, tolerance=0.2):
    """Compare with the ordinary sigmas of a run, root mean square over each block."""
    names, trust = result.calibration.uncertainty.names, result.diagnostics.trust
    ordinary = dict(zip(trust.names, trust.ordinary_sigma.tolist(), strict=True))
    sigma = np.sqrt(np.diag(predicted.uncertainty.matrix))
    for block in blocks:
        pairs = [(sigma[i], ordinary[n]) for i, n in enumerate(names) if n.partition("[")[0] == block and n in ordinary]
        ours, theirs = np.sqrt(np.mean(np.square(pairs), axis=0))
        assert ours == pytest.approx(theirs, rel=tolerance), block


@pytest.mark.parametrize(
    "options",
    [{"duration_s": 15.0}, {"duration_s": 15.0, "motion": "gentle", "distance_m": 1.4, "camera_rate_hz": 10.0}],
    ids=["normal", "gentle and far"],
)
def test_a_waved_recording_is_predicted(options):
    scenario = gnomon.CameraImuScenario(trajectory_seed=3, gravity=9.80665, **options)
    simulation = gnomon.simulate_camera_imu(scenario, seed=9)  # by 8 the accelerometer may be filtered (2.2 sigma)
    run = gnomon.CameraImuOptions(model="full", gravity=9.80665)
    result = gnomon.calibrate_camera_imu(simulation.recording, simulation.target, run)
    hardware = replace(gnomon.read_hardware(), noise=CONSUMER_NOISE)
    plan = gnomon.CameraImuPlan(gravity=9.80665, **options)
    predicted = gnomon.plan(plan, hardware, seed=3, changes=False).calibration
    assert_predicted(predicted, result, (*CAMERA_BLOCKS, *BLOCKS), tolerance=0.05)  # the same path: 1 % was measured
    assert result.diagnostics.trust.weak == ()


@pytest.mark.parametrize(("rests", "hold_s", "seed"), [(40, 4.0, 0), (20, 3.0, 5)])
def test_a_recording_with_rests_is_predicted(rests, hold_s, seed):
    scenario = gnomon.Scenario(
        intervals=rests, hold_s=(hold_s, hold_s), motion_s=(2.25, 2.25), gyroscope_bias_walk=1e-5, g_sensitivity=3e-4
    )
    recording, _ = gnomon.simulate(scenario, seed)
    recording = replace(recording, imus={"imu0": replace(recording.imus["imu0"], noise=HAND_NOISE)})
    result = gnomon.calibrate_imu(recording, gnomon.ImuOptions(model="g-sensitivity", gravity=9.80665))
    hardware = replace(gnomon.read_hardware(), noise=HAND_NOISE)
    plan = gnomon.ImuPlan(intervals=rests, hold_s=hold_s, gravity=9.80665)
    assert_predicted(gnomon.plan(plan, hardware, changes=False).calibration, result, BLOCKS)  # other attitudes: 20 %
    assert result.diagnostics.trust.weak == ()


def test_longer_nearer_and_more_attitudes_help():
    found = gnomon.plan(gnomon.CameraImuPlan(duration_s=10.0, camera_rate_hz=10.0, motion="gentle"))
    words = [change.words for change in found.changes]
    assert any("twice as long, 20 s" in text for text in words)
    assert all(change.worst < change.before for change in found.changes)
    assert [change.worst for change in found.changes] == sorted(change.worst for change in found.changes)
    found = gnomon.plan(gnomon.ImuPlan(attitudes="one-axis"), use="ahrs")
    assert found.calibration.verdict == "fail"
    assert found.changes[0].words == "every attitude over the sphere"


def test_sigmas_fall_with_the_root_of_time():
    hardware = replace(gnomon.read_hardware(), imu_rate_hz=100.0)
    short, long = (
        gnomon.plan(gnomon.CameraImuPlan(duration_s=t, camera_rate_hz=10.0), hardware, changes=False).calibration
        for t in (20.0, 80.0)
    )
    ratio = float(short.sigma("cam0.time_shift_cam_imu") / long.sigma("cam0.time_shift_cam_imu"))
    assert 1.6 < ratio < 2.5


def test_the_rig_of_kalibrs_files_is_planned(tmp_path):
    (tmp_path / "camchain.yaml").write_text(
        "cam0:\n  camera_model: pinhole\n  intrinsics: [900.0, 900.0, 640.0, 360.0]\n  distortion_model: none\n"
        "  distortion_coeffs: []\n  resolution: [1280, 720]\n"
    )
    (tmp_path / "imu.yaml").write_text(
        "accelerometer_noise_density: 0.01\naccelerometer_random_walk: 0.001\ngyroscope_noise_density: 0.001\n"
        "gyroscope_random_walk: 0.0001\nupdate_rate: 100.0\n"
    )
    (tmp_path / "target.yaml").write_text(
        "target_type: checkerboard\ntargetCols: 7\ntargetRows: 6\nrowSpacingMeters: 0.06\ncolSpacingMeters: 0.06\n"
    )
    hardware = gnomon.read_hardware(*(tmp_path / f"{name}.yaml" for name in ("camchain", "target", "imu")))
    assert hardware.imu_rate_hz == 100.0
    assert hardware.cameras["cam0"].camera.resolution == (1280, 720)
    assert hardware.target.kind == "checkerboard"
    found = gnomon.plan(gnomon.CameraImuPlan(duration_s=10.0), hardware, changes=False)
    assert found.calibration.assessment.camera_imu.frames_used["cam0"] > 50
    assert len(found.needs) == 3


def test_a_board_that_leaves_the_image_is_refused():
    board = gnomon.Target.checkerboard(cols=7, rows=6, row_spacing_m=0.06, col_spacing_m=0.06)
    hardware = replace(gnomon.read_hardware(), target=board)
    with pytest.raises(OptionError, match=r"would see the board in \d+ frames only"):
        gnomon.plan(gnomon.CameraImuPlan(duration_s=5.0, distance_m=0.1), hardware, changes=False)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"turn_axes": "xw"}, "name axes of the camera"),
        ({"duration_s": -1.0}, "duration_s"),
        ({"duration_s": 7200.0}, "an hour at most"),
        ({"duration_s": 1e9}, "out of range"),
        ({"shaking": float("nan")}, "shaking"),
    ],
)
def test_a_plan_that_makes_no_sense_is_refused(options, said):
    with pytest.raises(OptionError, match=said):
        gnomon.CameraImuPlan(**options)
    with pytest.raises(OptionError, match="10 to 1000"):
        gnomon.ImuPlan(intervals=3)


def test_the_command_line_plans(capsys, tmp_path):
    arguments = ["plan", "--duration-s", "5", "--camera-rate-hz", "10", "--imu-rate-hz", "100", "--for", "phone"]
    assert main([*arguments, "--json"]) in (0, 4)
    document = json.loads(capsys.readouterr().out)
    assert document["use"] == "phone"
    assert {need["unit"] for need in document["needs"]} >= {"deg", "mm", "ms", "%"}
    assert np.shape(document["sigma"]["imu0.gyroscope.sensitivity"]) == (3, 3)
    assert document["changes"][0]["worst"] < document["changes"][0]["before"]
    path = tmp_path / "mine.yaml"
    path.write_text("gyroscope_scale: 0.0001 %\n")
    two = tmp_path / "imu.yaml"
    two.write_text(kalibr_yaml({name: {**asdict(HAND_NOISE), "update_rate": 200.0} for name in ("imu0", "imu1")}))
    assert main(["plan-imu", "--for", str(path), "--imu", str(two)]) == 4
    said = capsys.readouterr().out
    assert f"{two}: its first IMU is planned; of imu1 nothing is predicted." in said
    assert "such a recording would not do for mine" in said
    assert "gyroscope scale" in said
    assert main(["plan-imu", "--for", "nothing"]) == 2
    assert "no use 'nothing' is known" in capsys.readouterr().err


def test_a_calibration_file_is_judged_later(capsys, tmp_path):
    calibration = gnomon.plan(gnomon.ImuPlan(), changes=False).calibration
    gnomon.save(calibration, tmp_path / "calibration.yaml")
    assert main(["show", str(tmp_path / "calibration.yaml"), "--for", "ahrs"]) == 0
    said = capsys.readouterr().out
    assert "known, needed for ahrs" in said
    assert "gyroscope bias" in said
    (tmp_path / "imu.yaml").write_text(
        "accelerometer_noise_density: 0.01\naccelerometer_random_walk: 0.001\ngyroscope_noise_density: 0.001\n"
        "gyroscope_random_walk: 0.0001\nupdate_rate: 100.0\nrostopic: /imu0\n"
    )
    assert main(["show", str(tmp_path / "imu.yaml"), "--for", "ahrs"]) == 2
    assert "Leave out --for" in capsys.readouterr().err


def test_the_verdict_of_a_command_is_for_its_use(capsys, tmp_path):
    recording = tmp_path / "r.npz"
    assert main(["simulate", "-o", str(recording), "--intervals", "20", "--t-init-s", "20"]) == 0
    strict = tmp_path / "strict.yaml"
    strict.write_text("accelerometer_misalignment: 0.0001 deg\n")
    capsys.readouterr()
    assert main(["imu", str(recording), "--no-report", "--for", str(strict), "-o", str(tmp_path / "result")]) == 4
    assert "for strict" in capsys.readouterr().out
    assert gnomon.load(tmp_path / "result" / "calibration.yaml").verdict == "fail"
