"""Every command line that gnomon proposes is run as it stands, on real output; and a folder holds one command's result.

RECORDING, which a proposal leaves to the user, is replaced by a recording of the same sensor.
"""

import json
import shlex
import shutil
from pathlib import Path

import pytest

import gnomon
from gnomon.cli import main
from gnomon.cli.files import owner_of
from gnomon.report.cameras.page import NEXT as CAMERA_LINES
from gnomon.report.page import Code
from gnomon.report.static.page import imu_use_section

STARTS = {
    "imu": "simulate -o log.npz --intervals 14 --t-init-s 12",
    "poses": "simulate poses -o p --sensor drawn --units si",
    "turntable": "simulate turntable -o disc --steady-s 8",
    "magnetometer": "simulate magnetometer -o turned.npz --rests 12",
    "noise": "simulate noise -o rest.npz --duration-s 1300 --rate-hz 20",
    "camera": "simulate cameras -o views --views 20",
    "camera-imu": "simulate camera-imu -o rig --duration-s 9 --imu-rate-hz 100 --camera-rate-hz 10",
}
QUICK = {"camera": ["--model", "pinhole-radtan", "--board", "stated"], "magnetometer": [], "camera-imu": []}
CALIBRATE = {"imu", "turntable", "magnetometer", "noise", "camera", "camera-imu"}


@pytest.fixture
def run(capsys, tmp_path, monkeypatch):
    """Run a command line, and return its document."""
    monkeypatch.chdir(tmp_path)

    def carried_out(words):
        if words[0] in CALIBRATE:
            words = [*words, "--no-report", *QUICK.get(words[0], [])]
        code = main([*words, "--json"])
        document = json.loads(capsys.readouterr().out)
        assert code in {0, 4}, (words, document)
        return document

    return carried_out


RECORDINGS = {"imu": "log.npz", "poses": "log.npz", "magnetometer": "turned.npz", "noise": "rig", "camera": "rig"}
"""What stands for RECORDING in the lines that follow from a start."""


@pytest.mark.parametrize("start", STARTS)
def test_every_proposed_line_runs(start, run, tmp_path):
    for needed in {"log.npz": ["imu"], "rig": ["camera-imu"]}.get(RECORDINGS.get(start, ""), []):
        run(shlex.split(STARTS[needed]))
    lines, seen = [f"gnomon {STARTS[start]}"], []
    while lines:
        program, *words = shlex.split(lines.pop())
        assert program == "gnomon"
        lines += run([RECORDINGS[start] if word == "RECORDING" else word for word in words]).get("next", [])
        seen.append(words[0])
    assert len(seen) > 1
    assert len(set(seen)) == len(seen)


def test_a_rig_goes_through_both_calibrations_into_two_folders(run, tmp_path):
    run(shlex.split(STARTS["camera-imu"]))
    (line,) = run(["camera", "rig"])["next"]
    assert shlex.split(line)[1:3] == ["camera-imu", "rig"]  # it has an IMU: the very recording is proposed
    run(shlex.split(line)[1:])
    assert owner_of(Path("rig-camera")) == "camera"
    assert owner_of(Path("rig-camera-imu")) == "camera-imu"


def test_a_folder_belongs_to_the_command_that_made_it(run, capsys, tmp_path):
    run(shlex.split(STARTS["imu"]))
    run(["imu", "log.npz", "-o", "out"])
    run(["imu", "log.npz", "-o", "out"])  # its own is replaced
    run(shlex.split(STARTS["magnetometer"]))
    before = {path.name: path.read_bytes() for path in Path("out").iterdir()}
    assert main(["magnetometer", "turned.npz", "-o", "out"]) == 3
    assert "holds a result of gnomon imu" in capsys.readouterr().err
    assert main(["noise", "log.npz", "-o", "out"]) == 3
    assert main(["demo", "-o", "out"]) == 3
    assert main(["compare", "out", "truth.yaml", "-o", "out"]) == 3
    assert {path.name: path.read_bytes() for path in Path("out").iterdir()} == before
    run(["convert", "out", "--to", "kalibr", "-o", "out"])
    run(["convert", "out", "--to", "kalibr", "-o", "converted"])
    assert owner_of(Path("converted")) == ""


def test_a_file_of_nobody_is_not_replaced(run, capsys, tmp_path):
    run(shlex.split(STARTS["imu"]))
    Path("out").mkdir()
    Path("out/calibration.yaml").write_text("mine: 1\n")
    assert main(["imu", "log.npz", "-o", "out"]) == 3
    assert "would replace calibration.yaml" in capsys.readouterr().err
    assert Path("out/calibration.yaml").read_text() == "mine: 1\n"


def test_converting_does_not_replace_the_files_of_a_result(run, capsys, tmp_path):
    run(shlex.split(STARTS["noise"]))
    run(["noise", "rest.npz", "-o", "out"])
    run(shlex.split(STARTS["imu"]))
    run(["imu", "log.npz", "-o", "cal"])
    before = Path("out/imu.yaml").read_bytes()
    assert main(["convert", "cal", "--to", "kalibr", "-o", "out"]) == 3
    assert "imu.yaml would be replaced" in capsys.readouterr().err
    assert Path("out/imu.yaml").read_bytes() == before


def test_each_simulated_recording_keeps_its_truth(run, tmp_path):
    first = run(["simulate", "-o", "a.npz", "--intervals", "3"])["truth"]
    truth = Path(first).read_bytes()
    second = run(["simulate", "-o", "b.npz", "--intervals", "4", "--seed", "2"])["truth"]
    assert (first, second) == ("truth.yaml", "b-truth.yaml")
    assert Path(first).read_bytes() == truth
    assert run(["simulate", "-o", "b.npz", "--intervals", "4", "--seed", "2"])["truth"] == second
    assert run(["simulate", "-o", "a.npz", "--intervals", "3"])["truth"] == first
    assert run(["simulate", "poses", "-o", "p.csv"])["truth"] == "p-truth.yaml"
    assert run(["simulate", "magnetometer", "-o", "m.npz", "--rests", "3"])["truth"] == "m-truth.yaml"
    assert Path(first).read_bytes() == truth


def lines_of(section):
    """Return the command lines that a section of a report shows."""
    return [
        shlex.split(line)[1:]
        for block in section.blocks
        if isinstance(block, Code) and "ommand line" in block.title
        for line in block.text.splitlines()
    ]


def test_the_lines_in_a_report_on_an_imu_run_in_its_folder(run, tmp_path, monkeypatch):
    run(shlex.split(STARTS["imu"]))
    run(["imu", "log.npz"])
    lines = lines_of(imu_use_section(gnomon.load("log-imu")))
    monkeypatch.chdir(tmp_path / "log-imu")
    assert {words[0] for words in lines} == {"apply", "show", "convert"}
    for words in lines:
        run(["../log.npz" if word == "RECORDING" else word for word in words])


def test_the_lines_in_a_report_on_cameras_run_in_its_folder(run, tmp_path, monkeypatch):
    run(shlex.split(STARTS["camera-imu"]))
    run(["camera", "rig"])
    for name in ("imu.yaml", "target.yaml"):
        shutil.copy(tmp_path / "rig" / name, tmp_path / "rig-camera" / name)
    monkeypatch.chdir(tmp_path / "rig-camera")
    lines = [shlex.split(line)[1:] for line in CAMERA_LINES.splitlines()]
    assert {words[0] for words in lines} == {"camera-imu", "show", "compare"}
    for words in lines:
        there = {"RECORDING": "../rig", "ANOTHER/calibration.yaml": "../rig/truth.yaml"}
        run([there.get(word, word) for word in words])


def test_a_simulated_recording_takes_the_place_of_another_kind_as_a_whole(run, tmp_path):
    def files(place):
        return sorted(str(path.relative_to(place)) for path in Path(place).rglob("*"))

    both, cameras = STARTS["camera-imu"].replace("-o rig", "-o a"), STARTS["camera"].replace("-o views", "-o a")
    for first, second in ((both, cameras), (cameras, both)):
        run(shlex.split(second.replace("-o a", "-o alone")))
        run(shlex.split(first))
        run(shlex.split(second))
        assert files("a") == files("alone")
        shutil.rmtree("a")
        shutil.rmtree("alone")
