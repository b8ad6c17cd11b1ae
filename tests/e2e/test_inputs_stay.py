"""What is read is never written over, by whatever name; pipes and devices are refused before anything hangs on them."""

import os
import sys

import pytest

from gnomon.errors import OutputError, RecordingError
from gnomon.formats.own.calibration_file import load
from gnomon.output import atomic_file, files_together, spare_inputs
from gnomon.readers.recordings import read


@pytest.fixture(scope="module")
def result(run, good_table, write_table, tmp_path_factory):
    """A recording and its calibration, made once."""
    folder = tmp_path_factory.mktemp("result")
    write_table(folder / "r.csv", good_table)
    assert run("imu", folder / "r.csv", "-o", folder / "cal", "--no-report")[0] in {0, 4}
    return folder


def contents(folder):
    return {path.relative_to(folder): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def refused(run, folder, *words):
    """Run a command, which must change nothing and say one line."""
    before = contents(folder)
    code, _, err = run(*words)
    assert code == 3, err
    lines = [line for line in err.splitlines() if line.startswith("gnomon: ")]
    assert len(lines) == 1
    assert contents(folder) == before
    return lines[0]


def test_apply_spares_its_inputs(run, result, tmp_path):
    calibration, recording = tmp_path / "c.yaml", tmp_path / "r.csv"
    calibration.write_bytes((result / "cal/calibration.yaml").read_bytes())
    recording.write_bytes((result / "r.csv").read_bytes())
    (tmp_path / "soft.csv").symlink_to(recording)
    (tmp_path / "hard.csv").hardlink_to(recording)
    (tmp_path / "folder").symlink_to(tmp_path)
    for place in ("r.csv", "soft.csv", "hard.csv", "c.yaml", "folder/r.csv"):
        said = refused(run, tmp_path, "apply", calibration, recording, "-o", tmp_path / place)
        assert "is read, and would be replaced" in said
    refused(run, tmp_path, "apply", calibration, tmp_path / "soft.csv", "-o", recording)
    assert run("apply", calibration, recording, "-o", tmp_path / "new.csv")[0] == 0
    assert (
        run("apply", calibration, recording, "-o", tmp_path / "new.csv")[0] == 0
    )  # what it made itself it may replace


def test_apply_spares_the_files_of_a_folder(run, result, tmp_path):
    inside = tmp_path / "recording/deep"
    inside.mkdir(parents=True)
    (tmp_path / "recording/imu0.csv").write_bytes((result / "r.csv").read_bytes())
    (inside / "notes.txt").write_text("mine")
    for place in ("imu0.csv", "deep/notes.txt"):
        words = ("apply", result / "cal/calibration.yaml", tmp_path / "recording", "-o", tmp_path / "recording" / place)
        refused(run, tmp_path, *words)


def test_a_prior_is_not_replaced_by_what_follows_from_it(run, result):
    prior = result / "cal/calibration.yaml"
    said = refused(run, result, "imu", result / "r.csv", "--prior", prior, "-o", result / "cal")
    assert "calibration.yaml: this file is read" in said


def test_a_simulation_spares_its_scenario(run, tmp_path):
    (tmp_path / "scenario.yaml").write_text("duration_s: 4\n")
    words = ("--scenario", tmp_path / "scenario.yaml", "-o", tmp_path)
    assert "scenario.yaml: this file is read" in refused(run, tmp_path, "simulate", "camera-imu", *words)


def test_whatever_writes_spares_inputs(tmp_path):
    """Also where a command finds out only late what it writes."""
    (tmp_path / "camchain.yaml").write_text("mine")
    for named in (tmp_path / "camchain.yaml", tmp_path):
        with spare_inputs([named]):
            with pytest.raises(OutputError, match="is read"), atomic_file(tmp_path / "camchain.yaml"):
                pytest.fail("it was opened")
            with pytest.raises(OutputError, match="is read"), files_together(tmp_path) as staging:
                (staging / "camchain.yaml").write_text("new")
    assert (tmp_path / "camchain.yaml").read_text() == "mine"
    with atomic_file(tmp_path / "camchain.yaml") as stream:
        stream.write(b"new")
    assert (tmp_path / "camchain.yaml").read_text() == "new"


@pytest.mark.skipif(sys.platform == "win32", reason="pipes have no names there")
def test_a_pipe_is_refused_by_every_command_that_reads(run, result, tmp_path):
    """Nobody ever writes into it: whoever opens it waits for ever."""
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    calibration = result / "cal/calibration.yaml"
    for words in (
        *(("check", pipe), ("imu", pipe), ("noise", pipe), ("magnetometer", pipe), ("show", pipe)),
        *(("turntable", pipe, "--rate", "16rpm"), ("rate", pipe), ("camera", pipe), ("camera-imu", pipe)),
        *(("apply", calibration, pipe, "-o", tmp_path / "o.csv"), ("compare", calibration, pipe)),
        *(("convert", pipe, "--to", "kalibr"), ("imu", result / "r.csv", "--prior", pipe)),
        ("imu", result / "r.csv", "--for", pipe),
        ("simulate", "camera-imu", "--scenario", pipe, "-o", tmp_path / "rig"),
    ):
        code, _, err = run(*words)
        assert (code, "this is a pipe" in err) == (3, True), (words, err)


@pytest.mark.skipif(sys.platform == "win32", reason="pipes have no names there")
@pytest.mark.parametrize("name", ["imu0.csv", "camchain.yaml", "cam0_corners.csv"])
def test_a_pipe_in_a_folder_holds_nobody_up(name, run, tmp_path):
    (tmp_path / "rig").mkdir()
    os.mkfifo(tmp_path / "rig" / name)
    assert run("camera-imu", tmp_path / "rig", "-o", tmp_path / "out")[0] in {2, 3}
    assert run("check", tmp_path / "rig")[0] == 3


@pytest.mark.skipif(sys.platform == "win32", reason="there is no such device")
def test_devices_are_refused_in_python_too():
    with pytest.raises(RecordingError, match="this is a device"):
        read("/dev/zero")
    with pytest.raises(RecordingError, match="this is a device"):
        load("/dev/zero")


def test_a_header_before_six_gigabytes_of_nothing(tmp_path):
    """A file with a hole takes no place on the disk, and would take all of the memory."""
    path = tmp_path / "sparse.csv"
    with path.open("wb") as file:
        file.write(b"t,ax,ay,az,gx,gy,gz\n" + b"0.01,0,0,9.81,0,0,0\n" * 1000)
        try:
            file.truncate(6_000_000_000)
        except OSError:
            pytest.skip("no such files here")
    with pytest.raises(RecordingError, match="zeros around byte"):
        read(path)
