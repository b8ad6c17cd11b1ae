"""What is given in the place of something else is named as what it is, and the command that it belongs to is told."""

import shutil

import numpy as np
import pytest

from gnomon.cli import main
from gnomon.cli.files import files_beside
from gnomon.readers.recordings import recordings_in


@pytest.fixture(scope="module")
def place(tmp_path_factory, good_table, write_table):
    """A folder with one of each: a recording, its result, noise, corners, several recordings, averaged poses."""
    folder = tmp_path_factory.mktemp("one-of-each")
    log = write_table(folder / "log.csv", good_table)
    np.savez(folder / "log.npz", accelerometer=good_table[:, 1:4])
    assert main(["imu", str(log), "-o", str(folder / "result"), "--no-report", "-q"]) == 0
    (folder / "noise").mkdir()
    (folder / "noise" / "noise.yaml").write_text("schema: gnomon-noise/1\n")
    for name, files in {
        "cameras": ("cam0_corners.csv", "cam0_frames.csv"),
        "tables": ("a.npz", "b.npz", "c.npz"),
    }.items():
        (folder / name).mkdir()
        for file in files:
            (folder / name / file).write_bytes(b"x")
    (folder / "runs").mkdir()
    for name in ("mon.csv", "tue.csv", "wed.csv"):
        shutil.copy(log, folder / "runs" / name)
    (folder / "poses.csv").write_text("ax,ay,az\n" + "".join(f"{x},{y},9.8\n" for x in range(3) for y in range(4)))
    return folder


CASES = {
    "check result": "result: this folder holds a result, and no recording",
    "imu result/calibration.yaml": "belongs to a calibration and is no recording",
    "noise result/diagnostics.npz": "belongs to a calibration and is no recording",
    "show log.npz": "Is it the recording, given in the place of the calibration?",
    "apply log.npz result": "Is it the recording, given in the place of the calibration?",
    "apply noise log.npz -o c.csv": "This file holds the noise of a sensor",
    "show runs": "runs: this is a folder, without a calibration.yaml",
    "imu cameras": "cameras: this folder holds corners of cameras, for gnomon camera",
    "imu runs": "gnomon imu and gnomon temperature take several recordings of one sensor",
    "check tables": "tables: 3 files may be the recording (a.npz, b.npz, c.npz)",
    "camera log.npz": "log.npz: this is an NPZ file, which holds no images",
    "camera-imu log.csv": "log.csv: this is a text file, which holds no images",
    "verify result poses.csv": "the recording of averages alone: nothing to verify",
    "batch --kind imu log.csv": "log.csv: this is a file. Name the folder with the recordings",
    "turntable --rate 33rpm": "PATH is missing",
    "live imu": "SOURCE and --output are missing",
    "live imu /dev/ttyUSB0 -o live": "Name it as serial:/dev/ttyUSB0",
    "batch runs": "--kind imu | camera-imu | camera | magnetometer is missing",
}


@pytest.mark.parametrize("words", CASES)
def test_what_it_is_is_told(place, monkeypatch, run, words):
    monkeypatch.chdir(place)
    code, _, err = run(*words.split())
    assert code in (2, 3)
    assert CASES[words] in err


def test_an_option_of_several_values_leaves_the_operands(place, monkeypatch, run):
    monkeypatch.chdir(place)
    behind = run("turntable", "--rate", "33rpm", "log.csv")
    before = run("turntable", "log.csv", "--rate", "33rpm")
    assert behind == before
    assert "all 24 steady parts show the same rate" in before[2]


def test_a_folder_where_several_recordings_are_expected(place):
    assert recordings_in(place / "runs") == [place / "runs" / name for name in ("mon.csv", "tue.csv", "wed.csv")]
    assert recordings_in(place / "log.csv") == [place / "log.csv"]
    assert recordings_in(place / "cameras") == [place / "cameras"]


def test_a_folder_may_stand_for_the_file_in_it(tmp_path, place):
    (tmp_path / "calibration.yaml").write_text("")
    found = files_beside(place / "log.csv", {"cam": tmp_path, "imu": (tmp_path,), "target": None})[0]
    assert found == {"cam": tmp_path / "calibration.yaml", "imu": (tmp_path,), "target": None}


@pytest.fixture(scope="module")
def simulated_rig(tmp_path_factory):
    """A simulated recording of a rig, with the files that describe it."""
    folder = tmp_path_factory.mktemp("rig") / "seen"
    assert main(["simulate", "camera-imu", "-o", str(folder), "--duration-s", "15", "-q"]) == 0
    return folder


@pytest.mark.parametrize(
    ("options", "files", "following"),
    [
        ("", (), "camera seen --target TARGET"),
        ("--target board.yaml", (), "camera seen --target board.yaml"),
        ("", ("target.yaml",), "camera seen"),
        ("", ("target.yaml", "camchain.yaml"), "camera-imu seen"),
        ("--cam lens.yaml", ("target.yaml",), "camera-imu seen --cam lens.yaml"),
    ],
)
def test_check_goes_on_with_the_cameras(simulated_rig, tmp_path, monkeypatch, run, options, files, following):
    shutil.copytree(simulated_rig, tmp_path / "seen")
    monkeypatch.chdir(tmp_path)
    shutil.copy("seen/target.yaml", "board.yaml")
    shutil.copy("seen/camchain.yaml", "lens.yaml")
    for name in {"target.yaml", "camchain.yaml", "imu.yaml"} - {*files}:
        (tmp_path / "seen" / name).unlink()
    assert f"gnomon {following}\n" in run("check", "seen", *options.split())[1]
