"""What is missing is named at once, with the command that makes it; what is of the wrong kind, with the right one."""

import numpy as np
import pytest

import gnomon
from gnomon.cli import main
from gnomon.errors import OptionError, RecordingError


@pytest.fixture
def rig(tmp_path, capsys):
    assert main(["simulate", "camera-imu", "-o", str(tmp_path / "rig"), "--duration-s", "2"]) == 0
    capsys.readouterr()
    return tmp_path / "rig"


def said(capsys):
    return " ".join(capsys.readouterr().err.split())


def test_all_missing_files_are_named_at_once(rig, capsys):
    for name in ("camchain.yaml", "imu.yaml", "target.yaml"):
        (rig / name).unlink()
    assert main(["camera-imu", str(rig)]) == 2
    words = said(capsys)
    assert "--target is missing" in words
    assert "gnomon target" in words
    assert "--cam is missing" in words
    assert f"gnomon camera {rig} --target target.yaml --resolution WIDTH HEIGHT makes one" in words


def test_what_is_there_is_not_asked_for(rig, capsys):
    (rig / "camchain.yaml").unlink()
    assert main(["camera-imu", str(rig)]) == 2
    words = said(capsys)
    assert "--cam is missing" in words
    assert f"--target {rig / 'target.yaml'} --resolution WIDTH HEIGHT makes one" in words
    assert "--target is missing" not in words


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("compare no1 b=no2/calibration.yaml+no3 no4", ["no1", "no2/calibration.yaml", "no3", "no4"]),
        ("imu no1.csv no2.csv --for no3.yaml --prior no4.yaml", ["no1.csv", "no2.csv", "--for no3.yaml", "no4.yaml"]),
        ("apply no.yaml no1.csv no2.csv", ["no.yaml (gnomon imu", "no1.csv", "no2.csv"]),
        ("turntable no1 no2", ["no1", "no2", "--rate is missing"]),
        ("turntable no1 --rate no1=16rpm no2=no.mkv", ["no1", "--rate no.mkv"]),
        ("temperature no1 no2 --calibration no3", ["no1", "no2", "--calibration no3"]),
        ("verify no.yaml no1 --target no2", ["no.yaml", "no1", "--target no2 (gnomon target makes one)"]),
        ("batch no1 no2 --kind imu --devices no3", ["no1", "no2", "--devices no3"]),
        ("noise no1 --datasheet no2.yaml", ["no1", "--datasheet no2.yaml"]),
        (
            "camera-imu no1 --cam no2 --imu no3 --target no4",
            ["no1", "--cam no2 (gnomon camera makes one)", "--imu no3 (gnomon noise makes one)", "--target no4"],
        ),
        ("batch", ["FOLDER and --kind", "are missing"]),
        ("live", ["WHAT", "SOURCE and --output are missing"]),
    ],
)
def test_everything_that_is_missing_is_named_in_one_go(capsys, monkeypatch, tmp_path, line, words):
    monkeypatch.chdir(tmp_path)
    assert main(line.split()) in (2, 3)
    told = said(capsys)
    assert [word for word in words if word not in told] == []


def test_a_file_and_an_option_that_are_missing_are_named_together(rig, capsys):
    (rig / "target.yaml").unlink()
    assert main(["camera-imu", str(rig), "--cam", "nowhere.yaml"]) == 3
    words = said(capsys)
    assert "--cam nowhere.yaml (gnomon camera makes one)" in words
    assert "--target is missing" in words


def test_a_turntable_without_stamps_is_told_its_own_option(tmp_path, capsys):
    simulation = gnomon.simulate_turntable(gnomon.TurntableScenario(steady_s=5.0), 0)
    values = next(iter(simulation.recordings[0].imus.values())).gyroscope.values
    np.savetxt(tmp_path / "gyro.csv", values, delimiter=",")
    assert main(["turntable", str(tmp_path / "gyro.csv"), "--rate", "16rpm"]) == 3
    words = said(capsys)
    assert "--sample-rate 100" in words
    assert "--rate 100" not in words.replace("--sample-rate 100", "")


@pytest.mark.parametrize("command", ["imu", "magnetometer"])
def test_one_triad_without_name_may_be_any(tmp_path, capsys, command):
    t = np.arange(500) / 100
    np.savetxt(
        tmp_path / "x.csv", np.column_stack([t, np.random.default_rng(0).normal(40, 5, (500, 3))]), delimiter=","
    )
    assert main([command, str(tmp_path / "x.csv")]) == 3
    words = said(capsys)
    assert '"t mx my mz"' in words
    assert "an accelerometer is needed" not in words


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: gnomon.calibrate_imu("x.csv"), r"takes a Recording, and was given a str 'x.csv'.*gnomon\.read\("),
        (lambda: gnomon.calibrate_imu(np.zeros((3, 3))), "was given a ndarray"),
        (lambda: gnomon.calibrate_imu(["a.csv", "b.csv"]), "was given a str 'a.csv'"),
        (lambda: gnomon.calibrate_magnetometer("x.csv"), "was given a str"),
        (lambda: gnomon.calibrate_turntable("x.csv", []), r"was given a str 'x.csv'.*read_turntable"),
        (lambda: gnomon.calibrate_cameras("images", "target.yaml"), "read_camera_views"),
        (lambda: gnomon.calibrate_camera_imu("rig.bag", "target.yaml"), "read_camera_imu"),
        (
            lambda: gnomon.calibrate_cameras(gnomon.simulate(gnomon.Scenario(intervals=2), 0)[0], "target.yaml"),
            "takes a Target, and was given a str 'target.yaml'",
        ),
    ],
)
def test_a_path_in_place_of_a_recording(call, words):
    with pytest.raises(OptionError, match=words):
        call()


def test_swapped_arrays_are_named():
    imu = gnomon.simulate(gnomon.Scenario(intervals=8), 0)[0].imus["imu0"]
    t, accel, gyro = imu.accelerometer.t_s, imu.accelerometer.values, imu.gyroscope.values
    assert gnomon.Recording.from_arrays(t, gyro, accel).imus
    assert gnomon.Recording.from_arrays(t, np.degrees(gyro), accel / 9.80665, "g deg/s").imus
    with pytest.raises(RecordingError, match=r"seem to be swapped: .*from_arrays\(t_s, gyro, accel\)"):
        gnomon.Recording.from_arrays(t, accel, gyro)
