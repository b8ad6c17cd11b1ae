"""The commands for cameras and an IMU, from reading to the folder of the result; the solution itself is put in."""

import contextlib
import io
import json
import re
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
import yaml

import gnomon
from gnomon.cli import main
from gnomon.cli.command import COMMANDS, parse_command
from gnomon.cli.commands.camera_imu import CameraImu, SimulateCameraImu
from gnomon.cli.files import CAMERA_IMU_FILES
from gnomon.formats.own.dataclass_file import options_text
from gnomon.options import CameraImuOptions
from gnomon.writers.kalibr_files import CAMERA_IMU_FILES as KALIBR_FILES

SMALL = ("--duration-s", 3, "--seed", 5)


def run(*arguments):
    """Exit code, standard output, standard error."""
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = main([str(argument) for argument in arguments])
    return code, out.getvalue(), err.getvalue()


def names(folder):
    return sorted(path.name for path in folder.iterdir())


@pytest.fixture(scope="module")
def simulated(tmp_path_factory):
    """A folder as a person would have it: corners, samples, and Kalibr's three files."""
    folder = tmp_path_factory.mktemp("rig") / "walk"
    code, _, err = run("simulate", "camera-imu", "-o", folder, *SMALL)
    assert code == 0, err
    return folder


@pytest.fixture
def solver(monkeypatch, camera_imu_case):
    """Stands for calibrate_camera_imu; notes what it was asked for."""
    calls = []
    state = {"verdict": "warn"}

    def calibrate(recording, target, options=None, progress=None, prior=None):
        calls.append((recording, target, options))
        progress("solving")
        return camera_imu_case(verdict=state["verdict"], cameras=len(recording.cameras))[0]

    monkeypatch.setattr("gnomon.calibrate.camera_imu.calibrate_camera_imu", calibrate, raising=False)
    calibrate.calls, calibrate.state = calls, state
    return calibrate


def test_a_walk_before_a_board_is_refused(tmp_path):
    code, _, err = run("simulate", "camera-imu", "-o", tmp_path / "rig", "--motion", "walk")
    assert code == 2
    assert "gnomon simulate room --motion walk" in " ".join(err.split())
    assert not (tmp_path / "rig").exists()


def test_result_folder(simulated, tmp_path, solver, camera_imu_case):
    code, out, err = run("camera-imu", simulated, "-o", tmp_path / "out", "--no-report")
    assert code == 0, err
    assert names(tmp_path / "out") == sorted(set(CAMERA_IMU_FILES) - {"report.html"})
    assert set(KALIBR_FILES) < set(CAMERA_IMU_FILES)
    for name in set(CAMERA_IMU_FILES) - {"report.html"}:
        assert str(tmp_path / "out" / name) in out
    assert "report.html" not in out
    assert "detected: camchain.yaml, imu.yaml and target.yaml in the recording's folder are used." in out
    assert "Traceback" not in err
    loaded = gnomon.load(tmp_path / "out" / "calibration.yaml")
    expected = camera_imu_case()[0].calibration
    assert np.array_equal(loaded.cameras["cam0"].T_cam_imu, expected.cameras["cam0"].T_cam_imu)
    with np.load(tmp_path / "out" / "diagnostics.npz", allow_pickle=False) as arrays:
        assert arrays["corners.cam0.resolution"].tolist() == [640, 480]
        assert arrays["corners.cam0.resolution"].dtype.kind == "i"
        assert arrays["signals.imu0.gyroscope.measured"].shape == arrays["signals.imu0.gyroscope.predicted"].shape
        assert "estimated" in arrays["parameters.status"]
        assert arrays["trajectory.t_ns"].dtype == np.int64
    assert options_of(solver).compare is False


def options_of(solver):
    return solver.calls[-1][2]


def test_the_default_folder_lies_beside_the_recording(simulated, solver):
    code, out, _ = run("camera-imu", simulated, "--no-report", "--json")
    assert code == 0
    folder = simulated.parent / "walk-camera-imu"
    assert json.loads(out)["files"]["camchain-imucam"] == str(folder / "camchain-imucam.yaml")
    assert "calibration.yaml" in names(folder)


def test_what_the_screen_says(simulated, tmp_path, solver):
    _, out, _ = run("camera-imu", simulated, "-o", tmp_path / "out", "--no-report")
    for words in (
        "warn: usable, with reservations",
        "7.0500 +- 0.0060 ms",
        "103.00 +- 0.23   -15.00 +- 0.23   -10.00 +- 0.23 mm",
        "+- 0.0063 0.0063 0.0063 deg about the body's x, y, z",
        "px (rms per axis)",
        "0.2054 -9.7911 -0.5131 m/s^2, +- 0.01",
        "imu0.gyroscope     9.1e-05 rad/s/sqrt(Hz), stated 8.73e-05 (x 1.04)",
        "cam0.corners       0.126 px",
        "-> Move faster: shake the rig along each of its axes.",
        "imu0 gyroscope g_sensitivity [",
    ):
        assert words in out
    lines = [line for line in out.splitlines() if str(tmp_path) not in line and str(simulated) not in line]
    assert max(len(line) for line in lines if not line.startswith("detected")) <= 80
    assert out.isascii()


def test_baseline_of_two_cameras(tmp_path, solver):
    assert run("simulate", "camera-imu", "-o", tmp_path / "rig", *SMALL, "--cameras", 2)[0] == 0
    code, out, _ = run("camera-imu", tmp_path / "rig", "-o", tmp_path / "out", "--no-report")
    assert code == 0
    assert re.search(r"cam0 to cam1 +\d+\.\d\d mm apart, turned by \d\.\d{3} deg", out)
    assert yaml.safe_load((tmp_path / "out" / "camchain-imucam.yaml").read_text())["cam1"]["T_cn_cnm1"]


def test_basic_model_hides_what_is_ideal(simulated, tmp_path, monkeypatch, camera_imu_case):
    monkeypatch.setattr(
        "gnomon.calibrate.camera_imu.calibrate_camera_imu",
        lambda *_, **__: camera_imu_case(model="basic")[0],
        raising=False,
    )
    code, out, _ = run("camera-imu", simulated, "-o", tmp_path / "out", "--no-report", "--model", "basic")
    assert code == 0
    assert "imu0 gyroscope bias [" in out
    assert "sensitivity [" not in out


def test_json_is_one_document(simulated, tmp_path, solver):
    code, out, _ = run("camera-imu", simulated, "-o", tmp_path / "out", "--no-report", "--json")
    document = json.loads(out)
    assert code == document["exit_code"] == 0
    assert document["verdict"] == "warn"
    assert document["calibration"]["schema"] == "gnomon/1.1"
    assert document["calibration"]["cameras"]["cam0"]["time_shift_cam_imu"] == 0.00705
    assert {level["name"] for level in document["noise"]} == {"imu0.accelerometer", "imu0.gyroscope", "cam0.corners"}
    assert document["noise"][-1]["nominal"] is None
    assert document["gravity_target"]["value"] == [0.2054, -9.7911, -0.5131]
    assert set(document["files"]) == {
        "calibration",
        "diagnostics",
        "trajectory",
        "camchain-imucam",
        "imu",
        "results-imucam",
    }


def test_do_not_use_ends_with_4_and_is_written_all_the_same(simulated, tmp_path, solver):
    solver.state["verdict"] = "fail"
    code, out, _ = run("camera-imu", simulated, "-o", tmp_path / "out", "--no-report")
    assert code == 4
    assert "do not use" in out
    assert "calibration.yaml" in names(tmp_path / "out")


def test_options_reach_the_solver(simulated, tmp_path, solver):
    code, _, err = run(
        "camera-imu", simulated, "-o", tmp_path / "out", "--no-report", "--model", "scale-misalignment", "--free",
        "cam0.line_delay", "cam0.intrinsics", "--prior", "cam0.intrinsics=2", "--fix", "imu0.S_g", "--no-robust",
        "--knots-per-s", "80", "--noise", "nominal", "--pixel-sigma", "0.2", "--line-delay", "2e-5",
    )  # fmt: skip
    assert code == 0, err
    assert options_of(solver) == CameraImuOptions(
        model="scale-misalignment", free=("cam0.line_delay", "cam0.intrinsics"), prior=("cam0.intrinsics=2",),
        fix=("imu0.S_g",), robust=False, knots_per_s=80.0, noise="nominal", pixel_sigma=0.2, line_delay=2e-5,
    )  # fmt: skip


def test_a_report_compares_with_the_basic_model(simulated, tmp_path, solver, monkeypatch):
    written = []
    monkeypatch.setattr(
        "gnomon.report.page.write_report", lambda result, path: written.append(path.write_text("report"))
    )
    code, out, _ = run("camera-imu", simulated, "-o", tmp_path / "out")
    assert code == 0
    assert len(written) == 1
    assert options_of(solver).compare is True
    assert str(tmp_path / "out" / "report.html") in out


# --- Kalibr's files ---


@pytest.mark.parametrize("flag", ["--cam", "--cams"])
def test_files_may_be_named(simulated, tmp_path, solver, flag):
    bare = tmp_path / "bare"
    bare.mkdir()
    for path in simulated.iterdir():
        if path.name.startswith(("cam0", "imu0")):
            (bare / path.name).write_bytes(path.read_bytes())
    files = {"camchain": flag, "imu": "--imu", "target": "--target"}
    named = [word for name, option in files.items() for word in (option, simulated / f"{name}.yaml")]
    code, out, err = run("camera-imu", bare, *named, "-o", tmp_path / "out", "--no-report")
    assert code == 0, err
    assert "in the recording's folder" not in out
    code, out, _ = run("camera-imu", bare, *named[:2], *named[4:], "-o", tmp_path / "out", "--no-report")
    assert code == 0
    assert "detected: no imu.yaml was given: the noise of a consumer IMU is assumed" in out
    assert solver.calls[-1][0].imus["imu0"].noise is None
    code, _, err = run("camera-imu", bare, *named[2:], "-o", tmp_path / "new", "--no-report")
    assert code == 2
    assert "--cam is missing" in err
    assert "camchain.yaml" in err
    assert "--resolution WIDTH HEIGHT makes one" in err
    code, _, err = run("camera", bare, "-o", tmp_path / "new")
    assert code == 2
    assert "--target is missing" in err
    assert "Give --resolution WIDTH HEIGHT" in err, "all that is missing is said at once"
    code, _, err = run("camera-imu", bare, *named[:4], "-o", tmp_path / "new", "--no-report")
    assert code == 2
    assert "--target is missing" in err
    assert names(tmp_path) == ["bare", "out"]


def test_a_recording_that_is_not_there(tmp_path, solver):
    code, out, err = run("camera-imu", tmp_path / "none", "-o", tmp_path / "out", "--json")
    assert code == 3
    assert "there is no such file or folder" in json.loads(out)["error"]["message"]
    assert "Traceback" not in err
    assert names(tmp_path) == []


def test_inputs_are_never_overwritten(simulated, tmp_path, solver):
    before = {path.name: path.read_bytes() for path in simulated.iterdir()}
    code, _, err = run("camera-imu", simulated, "-o", simulated, "--no-report")
    assert code == 2
    assert "Choose another folder" in err
    rig = tmp_path / "rig"
    rig.mkdir()
    (rig / "imu.yaml").write_bytes(before["imu.yaml"])
    code, _, err = run("camera-imu", simulated, "--imu", rig / "imu.yaml", "-o", rig, "--no-report")
    assert code == 2
    assert "--imu" in err
    assert (rig / "imu.yaml").read_bytes() == before["imu.yaml"]
    assert {path.name: path.read_bytes() for path in simulated.iterdir()} == before
    assert solver.calls == []


def test_a_failure_leaves_nothing(simulated, tmp_path, monkeypatch):
    def fails(*_, **__):
        raise gnomon.SolveError("it did not work")

    monkeypatch.setattr("gnomon.calibrate.camera_imu.calibrate_camera_imu", fails, raising=False)
    code, out, err = run("camera-imu", simulated, "-o", tmp_path / "out", "--no-report")
    assert code == 3
    assert "it did not work" in err
    assert "detected:" in out  # it often explains why
    assert names(tmp_path) == []


def test_other_files_in_the_folder_stay(simulated, tmp_path, solver):
    assert run("camera-imu", simulated, "-o", tmp_path, "--no-report")[0] == 0
    (tmp_path / "notes.txt").write_text("mine")
    (tmp_path / "report.html").write_text("of an earlier result")
    assert run("camera-imu", simulated, "-o", tmp_path, "--no-report")[0] == 0
    assert (tmp_path / "notes.txt").read_text() == "mine"
    assert not (tmp_path / "report.html").exists()


@pytest.mark.parametrize(
    "arguments",
    [
        ["camera-imu"],
        ["camera-imu", "x", "--modle", "full"],
        ["camera-imu", "x", "--model", "best"],
        ["camera-imu", "x", "--units", "furlong"],
        ["simulate-camera-imu"],
        ["simulate", "camera-imu", "-o", "x", "--duration-s", "-1"],
        ["simulate", "camera-imu", "-o", "x", "--motion", "dance"],
    ],
)
def test_wrong_usage_ends_with_2(arguments, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    code, out, err = run(*arguments)
    assert (code, out) == (2, "")
    assert err
    assert "Traceback" not in err
    assert names(tmp_path) == []


# --- gnomon show ---


@pytest.mark.parametrize("form", ["sensitivity", "kalibr", "tedaldi", "krebs", "angrisano"])
def test_show_shows_the_cameras(tmp_path, camera_calibration, form):
    calibration = camera_calibration(3, cameras=2)
    gnomon.save(calibration, tmp_path / "c.yaml")
    code, out, err = run("show", tmp_path / "c.yaml", "--form", form)
    assert code == 0, err
    frame = "accel-z" if form in {"tedaldi", "angrisano"} else "accel-x"
    assert f"cam0, pinhole-radtan, body frame {frame}" in out
    assert f"cam1, ds-none, body frame {frame}" in out
    assert "1190 of 1197" in out
    moved = calibration.in_frame(frame)
    section = out.split("cam0, pinhole")[1].split("cam1, ds")[0]
    for i, j in ((0, 1), (2, 2)):
        value = float(re.search(rf"R_{'xyz'[i]}{'xyz'[j]} +(\S+) ±", section)[1])
        assert value == pytest.approx(moved.cameras["cam0"].T_cam_imu[i, j], abs=1e-4)
    shift = float(re.search(r"time_shift_cam_imu +(\S+) ±", section)[1])
    assert shift == pytest.approx(calibration.cameras["cam0"].time_shift_cam_imu * 1e3, abs=0.1)
    assert "line_delay" in section
    assert "460 (fixed)  px" in section


@pytest.mark.parametrize(("form", "first", "second"), [("kalibr", "A", "AC"), ("krebs", "B", "B'")])
def test_show_shows_both_readings_of_b_g(tmp_path, camera_calibration, form, first, second):
    calibration = camera_calibration(3)
    gnomon.save(calibration, tmp_path / "c.yaml")
    _, out, _ = run("show", tmp_path / "c.yaml", "--form", form)
    assert "B1" in out
    assert "B2" in out
    gyroscope = calibration.imus["imu0"].gyroscope
    rotation = gnomon.models.forms.KrebsGyroscope.from_sensor(
        gyroscope.sensitivity, gyroscope.bias, gyroscope.g_sensitivity
    ).C_bg
    for name, matrix in ((first, gyroscope.g_sensitivity @ rotation), (second, gyroscope.g_sensitivity)):
        row = re.search(rf"^  {re.escape(name)}_xy +(.*) ± (.*?)  \(rad", out, re.MULTILINE)
        text = f"{row[1]} ± {row[2]}"
        scale = float(text.split(")")[1] and f"1{text.split(')')[1]}") if text.startswith("(") else 1.0
        value = float(text.lstrip("(").split(" ±")[0]) * scale
        assert value == pytest.approx(matrix[0, 1], rel=0.2)


@pytest.mark.parametrize("to", ["kalibr", "openvins", "basalt", "imucal"])
def test_show_shows_files_of_other_projects(tmp_path, camera_calibration, to):
    calibration = camera_calibration(3, cameras=1)
    gnomon.save(calibration, tmp_path / "c.yaml")
    code, out, err = run("convert", tmp_path / "c.yaml", "--to", to, "-o", tmp_path / to)
    assert code == 0, err
    assert f"not representable in {to}: uncertainty and origin" in out
    shown = ""
    for file in sorted((tmp_path / to).iterdir()):
        code, out, err = run("show", file, "--form", "kalibr")
        assert code == 0, err
        shown += out
        code, document, err = run("show", file, "--json")
        assert code == 0, err
        assert "format" in json.loads(document)
    assert re.search(rf"M_zy +{calibration.imus['imu0'].accelerometer.sensitivity[2, 1]:.6g} ", shown)
    if to != "imucal":
        assert re.search(rf"t_x +{calibration.cameras['cam0'].T_cam_imu[0, 3]:.6g}  m\n", shown)
        assert "460  px" in shown
    assert "±" not in shown
    assert "fixed" not in shown


def test_show_refuses_other_files(tmp_path):
    (tmp_path / "notes.txt").write_text("hello\n")
    code, _, err = run("show", tmp_path / "notes.txt")
    assert code == 3
    assert "no calibration file that gnomon knows. Readable are Kalibr's camchain.yaml" in err


def test_camera_entries_by_hand(camera_calibration):
    from gnomon.formats.shared.entries import camera_entries

    calibration = camera_calibration(6)
    found = {entry.name: (entry.value, sigma) for entry, sigma in camera_entries(calibration, "cam1")}
    T = calibration.cameras["cam1"].T_cam_imu
    covariance = calibration.covariance("cam1.T_cam_imu.rotation", "cam1.T_cam_imu.translation")
    rng = np.random.default_rng(1)
    draws = rng.multivariate_normal(np.zeros(6), covariance, 20_000)
    R = T[:3, :3] @ gnomon.geometry.rotations.rotation_from_rotvec(draws[:, :3])
    t = T[:3, 3] + draws[:, 3:]
    p = -np.einsum("nji,nj->ni", R, t)
    for i, j in np.ndindex(3, 3):
        value, sigma = found[f"R_{'xyz'[i]}{'xyz'[j]}"]
        assert value == T[i, j]
        assert sigma == pytest.approx(R[:, i, j].std(), rel=0.03)
    for axis, name in enumerate("xyz"):
        assert found[f"t_{name}"][1] == pytest.approx(t[:, axis].std(), rel=0.03)
        assert found[f"p_{name}"][0] == pytest.approx(-(T[:3, :3].T @ T[:3, 3])[axis])
        assert found[f"p_{name}"][1] == pytest.approx(p[:, axis].std(), rel=0.03)
    assert found["xi"] == (-0.2, 0.0)
    assert found["line_delay"] == (25.0, 0.0)


# --- simulate-camera-imu ---


def test_simulated_folder_is_read_as_it_is(simulated):
    recording, target = gnomon.read_camera_imu(
        simulated, cam=simulated / "camchain.yaml", imu=simulated / "imu.yaml", target=simulated / "target.yaml"
    )
    assert list(recording.cameras) == ["cam0"]
    assert target.kind == "aprilgrid"
    truth = gnomon.load(simulated / "truth.yaml")
    assert truth.cameras["cam0"].time_shift_cam_imu == pytest.approx(0.007)


def test_a_scenario_file_states_the_options(tmp_path):
    scenario = replace(gnomon.CameraImuScenario(), duration_s=2.5, cameras=2, line_delay_s=2e-5, known_line_delay=False)
    (tmp_path / "scenario.yaml").write_text(options_text(scenario))
    for words in (["--scenario", tmp_path / "scenario.yaml"], [f"--scenario={tmp_path / 'scenario.yaml'}"]):
        command = parse_command(["simulate", "camera-imu", "-o", "x", *map(str, words)])
        assert command.options == scenario
    # What is given on the line wins, also where it is the usual default.
    command = parse_command(
        ["simulate", "camera-imu", "--cameras", "1", "--scenario", str(tmp_path / "scenario.yaml"), "-o", "x",
         "--line-delay-s", "0"]
    )  # fmt: skip
    assert command.options == replace(scenario, cameras=1, line_delay_s=0.0)
    code, _, err = run("simulate", "camera-imu", "-o", tmp_path / "x", "--scenario", tmp_path / "none.yaml")
    assert code == 3
    assert "none.yaml" in err
    (tmp_path / "bad.yaml").write_text("durations: 3\n")
    code, _, err = run("simulate", "camera-imu", "-o", tmp_path / "x", "--scenario", tmp_path / "bad.yaml")
    assert code == 3
    assert "duration_s" in err


def test_simulation_says_what_it_wrote(tmp_path):
    code, out, _ = run("simulate", "camera-imu", "-o", tmp_path / "rig", *SMALL, "--json")
    document = json.loads(out)
    assert code == 0
    assert sorted(document["files"]) == sorted(str(path) for path in (tmp_path / "rig").iterdir())
    assert document["statistics"]["mean_rate_rad_s"] > 0
    # Again, with one camera less: nothing of the second one is left, and the same seed gives the same bytes.
    assert run("simulate", "camera-imu", "-o", tmp_path / "two", *SMALL, "--cameras", 2)[0] == 0
    assert run("simulate", "camera-imu", "-o", tmp_path / "two", *SMALL)[0] == 0
    for path in (tmp_path / "rig").iterdir():
        assert path.read_bytes() == (tmp_path / "two" / path.name).read_bytes()
    assert names(tmp_path / "two") == names(tmp_path / "rig")


def test_a_real_recording_is_not_simulated_over(tmp_path):
    (tmp_path / "imu0.csv.gz").write_bytes(b"real")
    code, _, err = run("simulate", "camera-imu", "-o", tmp_path, *SMALL)
    assert code == 3
    assert "not simulated" in err
    assert names(tmp_path) == ["imu0.csv.gz"]


# --- start-up ---


@pytest.mark.parametrize("command", ["camera-imu", "simulate-camera-imu"])
def test_help_needs_no_numbers(command):
    probe = (
        f"import sys\nfrom gnomon.cli import main\nassert main([{command!r}, '--help']) == 0\n"
        "print([m for m in ('numpy', 'scipy', 'matplotlib', 'yaml', 'rich') if m in sys.modules])"
    )
    result = subprocess.run([sys.executable, "-c", probe], capture_output=True, text=True, check=True)
    assert result.stdout.splitlines()[-1] == "[]"


def test_commands_are_known():
    assert COMMANDS["camera-imu"] is CameraImu
    assert COMMANDS["simulate camera-imu"] is SimulateCameraImu
