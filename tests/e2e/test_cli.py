"""The command line from the outside: what it prints, what it writes, how it ends."""

import json
import re
import shutil
import subprocess
import sys

import numpy as np
import pytest

import gnomon
from gnomon.cli.command import COMMANDS
from gnomon.kernel import describe_kernel
from repeatable import to_the_last_digit

RESULT = ["calibration.yaml", "diagnostics.npz", "report.html"]


@pytest.fixture(scope="session")
def calibrated(tmp_path_factory, good_table, run, write_table):
    """A folder with a recording and its result, which no test changes."""
    folder = tmp_path_factory.mktemp("calibrated")
    write_table(folder / "recording.csv", good_table)
    code, _, errors = run("imu", folder / "recording.csv", "--gravity", "9.80665")
    assert code == 0, errors
    return folder


def test_imu_writes_one_folder_and_says_the_verdict(calibrated, recording, run, names):
    assert names(calibrated) == ["recording-imu", "recording.csv"]
    assert names(calibrated / "recording-imu") == RESULT
    code, out, err = run("imu", recording, "--no-report", "-o", recording.parent / "here", "--gravity", "9.80665")
    assert code == 0
    assert re.match(r"detected|pass|warn", out)
    assert "imu0 gyroscope bias [" in out
    assert str(recording.parent / "here" / "calibration.yaml") in out
    assert "report.html" not in out
    assert max(map(len, out.splitlines())) <= 80 + len(str(recording.parent))
    assert "Traceback" not in err
    assert names(recording.parent / "here") == ["calibration.yaml", "diagnostics.npz"]


@to_the_last_digit
def test_a_second_run_gives_the_same_bytes_and_touches_nothing_else(calibrated, recording, run, names):
    folder = recording.parent / "recording-imu"
    folder.mkdir()
    (folder / "notes.txt").write_text("mine")
    for _ in range(2):
        assert run("imu", recording, "--gravity", "9.80665")[0] == 0
        assert names(folder) == sorted([*RESULT, "notes.txt"])
        for name in RESULT:
            assert (folder / name).read_bytes() == (calibrated / "recording-imu" / name).read_bytes(), name


def test_imu_json_is_one_document(recording, run):
    code, out, _ = run("imu", recording, "--json", "--no-report", "-o", recording.parent / "out")
    document = json.loads(out)
    assert code == document["exit_code"] == 0
    assert document["verdict"] in {"pass", "warn"}
    bias = document["calibration"]["imus"]["imu0"]["gyroscope"]["bias"]
    loaded = gnomon.load(document["files"]["calibration"])
    np.testing.assert_array_equal(bias, loaded.parameter("imu0.gyroscope.bias"))
    assert "report" not in document["files"]


def test_diagnostics_are_plain_arrays(calibrated):
    with np.load(calibrated / "recording-imu" / "diagnostics.npz", allow_pickle=False) as arrays:
        assert {"intervals.start_s", "rotations.error_holdout", "detector.multiplier", "trials.model"} <= set(arrays)
        assert arrays["intervals.direction"].shape == (len(arrays["intervals.start_s"]), 3)
        assert arrays["intervals.used"].dtype == bool


def test_check_says_what_a_recording_holds(recording, run, good_table):
    code, out, _ = run("check", recording)
    assert code == 0
    assert f"{len(good_table)} samples" in out
    document = json.loads(run("check", recording, "--json")[1])
    assert document["imus"]["imu0"]["gyroscope"]["rate_hz"] == pytest.approx(50.0)
    wanted = {"severity", "code", "message", "consequence", "cure", "subject", "follows_from"}
    assert set(document["findings"][0]) == wanted


@pytest.mark.parametrize("form", ["sensitivity", "kalibr", "tedaldi", "krebs", "angrisano"])
def test_show_prints_tables_with_sigmas(calibrated, form, run):
    code, out, _ = run("show", calibrated / "recording-imu" / "calibration.yaml", "--form", form)
    assert code == 0
    assert "imu0 accelerometer" in out
    assert "imu0 gyroscope" in out
    assert "±" in out


def test_show_json_is_the_file(calibrated, run):
    path = calibrated / "recording-imu" / "calibration.yaml"
    document = json.loads(run("show", path, "--json")[1])
    sensitivity = document["imus"]["imu0"]["accelerometer"]["sensitivity"]
    np.testing.assert_array_equal(sensitivity, gnomon.load(path).parameter("imu0.accelerometer.sensitivity"))


def test_apply_does_what_the_api_does(calibrated, tmp_path, run):
    path = calibrated / "recording-imu" / "calibration.yaml"
    target = tmp_path / "calibrated.csv"
    code, _, err = run("apply", path, calibrated / "recording.csv", "-o", target)
    assert code == 0, err
    expected = gnomon.load(path).imus["imu0"].apply(gnomon.read(calibrated / "recording.csv").imus["imu0"])
    again = gnomon.read(target).imus["imu0"]
    np.testing.assert_array_equal(again.accelerometer.t_ns, expected.accelerometer.t_ns)
    np.testing.assert_allclose(again.accelerometer.values, expected.accelerometer.values, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(again.gyroscope.values, expected.gyroscope.values, rtol=1e-12, atol=1e-12)
    copy = shutil.copy(calibrated / "recording.csv", tmp_path / "flight.csv")
    assert run("apply", path, copy)[0] == 0
    assert (tmp_path / "flight-calibrated.csv").read_bytes() == target.read_bytes()


@pytest.mark.parametrize("to", ["imu_tk", "kalibr", "imucal", "c-header", "csv"])
def test_convert_writes_files_and_states_losses(calibrated, tmp_path, to, run):
    path = calibrated / "recording-imu" / "calibration.yaml"
    code, out, _ = run("convert", path, "--to", to, "-o", tmp_path / "out", "--json")
    document = json.loads(out)
    assert code == 0
    assert sorted(document["files"]) == sorted(str(file) for file in (tmp_path / "out").iterdir())
    assert document["files"]
    assert all(set(loss) == {"what", "why", "size"} for loss in document["losses"])


@pytest.mark.parametrize("name", ["simulated.npz", "simulated.csv"])
def test_simulate_writes_a_recording_with_its_truth(tmp_path, name, run, names):
    arguments = ("--intervals", 4, "--t-init-s", 5, "--rate-hz", 50, "--seed", 7)
    code, _, err = run("simulate", "-o", tmp_path / name, *arguments)
    assert code == 0, err
    assert names(tmp_path) == sorted([name, "truth.yaml"])
    scenario = gnomon.Scenario(intervals=4, t_init_s=5.0, rate_hz=50.0)
    expected, truth = gnomon.simulate(scenario, 7)
    read = gnomon.read(tmp_path / name).imus["imu0"]
    np.testing.assert_array_equal(read.gyroscope.values, expected.imus["imu0"].gyroscope.values)
    np.testing.assert_array_equal(read.gyroscope.t_ns, expected.imus["imu0"].gyroscope.t_ns)
    path = "imu0.gyroscope.sensitivity"
    np.testing.assert_array_equal(gnomon.load(tmp_path / "truth.yaml").parameter(path), truth.parameter(path))


def test_demo_finds_the_truth(tmp_path, monkeypatch, run, names):
    monkeypatch.chdir(tmp_path)
    code, out, _ = run("demo", "--json")
    document = json.loads(out)
    assert code == 0
    assert names(tmp_path) == ["gnomon-demo"]
    assert names(tmp_path / "gnomon-demo") == sorted([*RESULT, "recording.npz", "truth.yaml"])
    z = np.array([(row["estimate"] - row["truth"]) / row["sigma"] for row in document["comparison"]])
    assert len(z) == 30  # all but the three elements that the body frame fixes
    assert np.abs(z).max() < 4
    assert 0.6 < np.sqrt(np.mean(z**2)) < 1.5


def test_demo_prints_a_table_that_fits(tmp_path, run):
    code, out, err = run("demo", "--no-report", "-o", tmp_path / "demo")
    assert code == 0
    for word in ("estimate", "sigma", "truth", "error/sigma", "gyroscope.g_sensitivity", "rms of error/sigma"):
        assert word in out
    assert max(len(line) for line in out.splitlines() if str(tmp_path) not in line) <= 80
    assert "\x1b" not in out + err


@pytest.mark.parametrize("words", [[], ["imu"], ["simulate", "noise"]])
def test_help_may_be_asked_for_by_name(words, run):
    assert run("help", *words) == run(*words, "--help")


def test_help_names_every_command(run):
    code, out, _ = run("--help")
    assert code == 0
    assert len(out.splitlines()) <= 40
    assert {name for name in COMMANDS if not re.search(rf"^  {name.split()[0]} ", out, re.MULTILINE)} == set()
    assert {name for name in COMMANDS if name.split()[-1] not in out} == set()


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_and_every_option_has_help(name, run):
    code, out, _ = run(*name.split(), "--help")
    assert code == 0
    flat = " ".join(out.partition("examples:")[0].split())
    options = re.findall(r"^  (?:-\w(?: \w+)?, )?(--[\w-]+)", out, re.MULTILINE)
    assert len(options) >= 4
    for option in options:  # after the flag and its placeholder comes a sentence
        assert re.search(rf"{re.escape(option)},?(?: \S+)*? [A-Z\d].{{10,}}", flat), option


@pytest.mark.parametrize(
    "arguments",
    [
        ["imu"],
        ["calibrate", "x"],
        ["imu", "x", "--gravty", "9.8"],
        ["imu", "x", "--gravity", "nine"],
        ["imu", "x", "--gravity", "3"],
        ["imu", "x", "--latitude", "95"],
        ["imu", "x", "--units", "furlong"],
        ["imu", "x", "--preset", "best"],
        ["convert", "x", "--to", "nothing"],
        ["simulate"],
        ["simulate", "-o", "x.npz", "--intervals", "1"],
        ["show"],
    ],
)
def test_wrong_usage_ends_with_2(arguments, tmp_path, monkeypatch, run, names):
    monkeypatch.chdir(tmp_path)
    code, out, err = run(*arguments)
    assert code == 2
    assert out == ""
    assert err
    assert "Traceback" not in err
    code, out, _ = run(*arguments, "--json")
    error = json.loads(out)["error"]
    assert code == error["exit_code"] == 2
    assert error["message"]
    assert names(tmp_path) == []


def test_a_simulation_in_an_unknown_format_writes_nothing(tmp_path, run, names):
    code, _, err = run("simulate", "-o", tmp_path / "x" / "y.parquet", "--intervals", 3, "--t-init-s", 1)
    assert code == 2
    assert ".npz" in err
    assert names(tmp_path) == []


def test_a_mistyped_option_is_answered_with_the_right_one(run):
    assert "--gravity" in run("imu", "x", "--gravty", "9.8")[2]


def program(*arguments):
    command = [sys.executable, "-m", "gnomon", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)


def test_the_program_runs_and_reports_its_exit_code(tmp_path):
    assert program("--version").stdout == f"gnomon {gnomon.__version__} ({describe_kernel()})\n"
    result = program("show", tmp_path / "nothing.yaml")
    assert result.returncode == 3
    assert result.stdout == ""
    assert result.stderr.startswith("gnomon: ")
    assert "Traceback" not in result.stderr


def test_output_that_nobody_reads_is_no_error(calibrated):
    command = [sys.executable, "-m", "gnomon", "show", str(calibrated / "recording-imu" / "calibration.yaml")]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        process.stdout.close()
        assert process.stderr.read() == b""


def test_an_unexpected_error_is_short_unless_asked_for(monkeypatch, run, tmp_path):
    def broken(*_arguments, **_keywords):
        raise ZeroDivisionError("oops")

    monkeypatch.setattr("gnomon.cli.commands.show.Show.run", broken)
    monkeypatch.delenv("GNOMON_DEBUG", raising=False)
    code, _, err = run("show", tmp_path)
    assert code == 1
    assert "ZeroDivisionError: oops" in err
    assert "Traceback" not in err
    monkeypatch.setenv("GNOMON_DEBUG", "1")
    with pytest.raises(ZeroDivisionError):
        run("show", tmp_path)


def test_an_interruption_leaves_nothing(recording, monkeypatch, run, names):
    def interrupted(*_arguments, **_keywords):
        raise KeyboardInterrupt

    monkeypatch.setattr("gnomon.readers.recordings.read", interrupted)
    code, _, err = run("imu", recording)
    assert code == 130
    assert "interrupted" in err
    assert names(recording.parent) == ["recording.csv"]
