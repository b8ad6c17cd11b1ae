"""Every command that README, tutorial and how-to show does what they say."""

import contextlib
import io
import re
import shlex
import shutil
from pathlib import Path

import numpy as np
import pytest
import yaml

import gnomon
from docs_pages import DOCS, ROOT, how_to, shell_commands, text
from gnomon.cli import main
from gnomon.formats.shared.yaml_text import kalibr_yaml

PYTHON = re.compile(r"^```python\n(.*?)^```", re.MULTILINE | re.DOTALL)
RIG = shlex.split("--duration-s 10 --camera-rate-hz 5 --imu-rate-hz 100 --target-cols 3 --target-rows 3")
"""Options of a small simulated rig."""
LENS = shlex.split("--intrinsics 460 458.5 322.4 237.1 --distortion-coeffs -0.28 0.075 0.0002 -0.00015")
VIEWS = ["--views", "12", "--resolution", "640", "480", *LENS]
"""Options of a few images of the board by the camera of the simulated rig."""
SMALL = shlex.split("--target-cols 4 --target-rows 4")
SIX = shlex.split("simulate poses -o six.npz --attitudes seven --samples 1000 --sensor drawn --units si")
"""A static experiment."""
DISC = shlex.split("--steady-s 8 --rest-s 2 --handling-s 2 --gyroscope-range 10 --sensor-seed 1")
PLATTER = shlex.split("--rate-rad-s 3.4903 --duration-s 15 --width 320 --height 240")
"""Options of a small simulated turntable at 33.33 rpm, and of a video of it."""


def run(arguments, *, may_fail=False):
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()) as errors:
        code = main(arguments)
    expected = {0, 4} if may_fail else {0}
    assert code in expected, f"gnomon {shlex.join(arguments)}: exit code {code}: {errors.getvalue()}"


LESS = {
    "camera-imu": ["--camera-rate-hz", "4", "--duration-s", "14"],
    "platter-video": ["--duration-s", "20"],
    "noise": ["--duration-s", "1200"],
    "cameras": ["--views", "12"],
}
"""What is simulated -> how, in less time than the tutorial has it; what it states beside that stays."""


@pytest.mark.first(1)
@pytest.mark.long
@pytest.mark.parametrize("less", [LESS, {}], ids=["less of it", "as shown"])
def test_the_tutorial_can_be_followed(less, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    commands = list(shell_commands(DOCS / "tutorial.md"))
    alone = ["simulate", "check", "imu", "show", "apply", "convert"]
    with_cameras = ["simulate", "check", "camera-imu", "show", "convert", "apply", "convert"]
    turned = ["simulate", "simulate", "rate", "turntable"]
    at_rest = ["simulate", "noise", "camera-imu"]
    a_lens = ["target", "simulate", "camera", "show", "camera-imu"]
    assert [words[0] for words in commands] == alone + with_cameras + turned + at_rest + a_lens
    for words in commands:
        run(words + less.get(words[1], []) * (words[0] == "simulate"))
    for part in ("first/result", "second/result", "third/result", "third/noise", "fourth/result"):
        assert (tmp_path / part / "report.html").exists()
    files = re.findall(r"^\| `([\w.-]+)` \|", text("tutorial.md"), re.MULTILINE)
    assert {name for name in files if not (tmp_path / "second" / "result" / name).exists()} == set()
    header = text("tutorial.md").split("```text\n")[1].split("\n")[0]
    rows = np.loadtxt("first/recording.csv", delimiter=",", skiprows=1)
    rows[:, 0] //= 1000
    Path("mine.csv").write_text(header + "\n", encoding="utf-8")
    with Path("mine.csv").open("a", encoding="utf-8") as file:
        np.savetxt(file, rows, fmt="%d", delimiter=",")
    assert gnomon.read("mine.csv").imus["imu0"].gyroscope.rate_hz == pytest.approx(100)


@pytest.mark.long
def test_the_readme_does_what_it_shows(single_sensors, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name, seed in (("log.csv", 1), ("flight.csv", 2)):
        run(["simulate", "-o", name, "--seed", str(seed), "--intervals", "20", "--t-init-s", "20"])
    run(["simulate", "camera-imu", "-o", "rig", "--images", *RIG])
    run(["convert", "rig", "--to", "ros1", "-o", "rig.bag"])
    run(["simulate", "cameras", "-o", "photographs", "--images", *VIEWS])
    for name in ("camchain.yaml", "imu.yaml", "target.yaml"):
        shutil.copy(f"rig/{name}", name)
    shutil.copytree(single_sensors, ".", dirs_exist_ok=True)
    page = ROOT / "README.md"
    commands = list(shell_commands(page))
    alone, camera = ["check", "imu", "show", "apply", "convert"], ["target", "camera"]
    with_cameras = ["camera-imu", "check", "camera-imu", "show", "convert"]
    single, trust = ["imu", "turntable", "noise", "magnetometer"], ["show", "compare", "plan"]
    assert [words[0] for words in commands] == alone + camera + with_cameras + single + trust
    for words in commands:
        once = words[:2] == ["camera-imu", "rig"]
        run(words + ["--no-report"] * (words[0] in {"camera", "camera-imu"} and not once))
    for block in PYTHON.findall(page.read_text(encoding="utf-8")):
        with contextlib.redirect_stdout(io.StringIO()):
            exec(compile(block, "README.md", "exec"), {})
    for report in ("report.html", "rig-camera-imu/report.html"):
        assert (tmp_path / report).exists()


@pytest.fixture(scope="module")
def single_sensors(tmp_path_factory):
    """Make small recordings of single sensors by the names that the documentation uses; return their folder."""
    folder = tmp_path_factory.mktemp("single")
    with contextlib.chdir(folder):
        run(["simulate", "poses", "-o", "poses.csv", "--sensor", "drawn", "--units", "g deg/s"])
        run(["simulate", "turntable", "-o", "disc", *DISC, "--rpm", "33.33"])
        run(["simulate", "platter-video", "-o", "platter.mkv", *PLATTER])
        run(["simulate", "noise", "-o", "rest.npz", "--duration-s", "2400"])
        run(["simulate", "magnetometer", "-o", "turned.npz", "--rests", "12"])
    return folder


@pytest.mark.long
def test_every_way_to_calibrate_one_sensor_works(single_sensors, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    section = how_to("sensors")
    (tmp_path / "section.md").write_text(section, encoding="utf-8")
    shutil.copytree(single_sensors, ".", dirs_exist_ok=True)
    run(["simulate", "-o", "log.csv", "--intervals", "20", "--t-init-s", "20"])
    run(["simulate", "poses", "-o", "poses", "--sensor", "drawn", "--units", "si"])
    run(["simulate", "poses", "-o", "faces", "--attitudes", "six", "--sensor", "drawn", "--units", "si"])
    faces = sorted(Path("faces").glob("pose*.csv"))
    for face, name in zip(faces, ("flat", "left", "right", "up", "down", "over"), strict=True):
        shutil.copy(face, f"{name}.csv")
    table = np.genfromtxt("poses.csv", delimiter=",", skip_header=1)
    np.savetxt("poses.txt", table[:, 2:5])
    run(["simulate", "poses", "-o", "known.csv", "--known", "--sensor", "drawn", "--units", "si"])
    run(["simulate", "poses", "-o", "counts.csv"])
    run(SIX)
    for name, rpm, seed in (("slow", "16", "1"), ("fast", "33.33", "2")):  # of one seed they would share their noise
        run(["simulate", "turntable", "-o", name, *DISC, "--rpm", rpm, "--seed", seed])
        shutil.copy(f"{name}/recording.npz", f"{name}.csv")  # what a file is follows from its content
    for copy, name in (("session.csv", "fast.csv"), ("rest.csv", "rest.npz"), ("night.csv", "rest.npz")):
        shutil.copy(name, copy)
    shutil.copy("turned.npz", "turned.csv")
    run(["simulate", "temperature", "-o", "warm-ups", "--duration-s", "300", "--rate-hz", "10"])
    for i in (1, 2, 3):
        shutil.copy(f"warm-ups/warm-up-{i}.npz", f"cold-{i}.csv")
    run(["simulate", "temperature", "-o", "oven", "--turned", "--intervals", "14"])
    for i, name in enumerate(("window", "room", "radiator"), 1):
        shutil.copy(f"oven/turned-{i}.npz", f"{name}.csv")
    shutil.copy("cold-1.csv", "flight.csv")
    run(["imu", "log.csv", "-o", "board-imu", "--no-report"])
    shown = {"check", "show", "rate", "apply", "convert"}
    commands = [words for words in shell_commands(tmp_path / "section.md") if words[0] not in {"camera-imu", "study"}]
    assert {"imu", "turntable", "noise", "magnetometer", *shown} < {words[0] for words in commands}
    for words in commands:
        if not words[0].startswith("simulate"):
            run(words if words[0] in shown else [*words, "--no-report"])


@pytest.mark.long
def test_every_way_to_calibrate_a_rig_works(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "section.md").write_text(how_to("rig"), encoding="utf-8")
    commands = [words for words in shell_commands(tmp_path / "section.md") if words[:2] == ["camera-imu", "rig"]]
    commands = [words for words in commands if "photographs-camera/calibration.yaml" not in words]  # with the cameras
    assert len(commands) > 5
    run(["simulate", "camera-imu", "-o", "rig", *RIG, "--seed", "5"])
    chain = yaml.safe_load(Path("rig/camchain.yaml").read_text(encoding="utf-8"))
    truth = gnomon.load("rig/truth.yaml").cameras["cam0"]
    chain["cam0"] |= {"T_cam_imu": truth.T_cam_imu, "timeshift_cam_imu": truth.time_shift_cam_imu}
    Path("rig/camchain.yaml").write_text(kalibr_yaml(chain), encoding="utf-8")  # what --fix and --prior hold
    run(SIX)
    run(["imu", "six.npz", "--model", "static"])
    Path("rest-noise").mkdir()
    for name in ("rest-noise/imu.yaml", "first.yaml", "second.yaml"):
        shutil.copy("rig/imu.yaml", name)
    make_two_imus("pair")
    for number, words in enumerate(commands):
        several = any("imu1" in word or word == "second.yaml" for word in words)
        run([*words[:1], "pair" if several else "rig", *words[2:], "--no-report", "-o", f"result-{number}"])


def make_two_imus(folder):
    """Make a recording with two IMUs, whose imu.yaml states how the second one lies to the first."""
    run(["simulate", "camera-imu", "-o", folder, *RIG, "--imus", "2", "--seed", "5"])
    second = gnomon.load(f"{folder}/truth.yaml").imus["imu1"]
    path = Path(folder) / "imu.yaml"
    stated = yaml.safe_load(path.read_text(encoding="utf-8"))
    stated["imu1"] |= {"T_i_b": second.T_imu_body, "time_offset": second.time_shift_s}
    path.write_text(kalibr_yaml(stated), encoding="utf-8")


@pytest.mark.long
def test_every_way_to_calibrate_cameras_works(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    section = how_to("cameras")
    (tmp_path / "section.md").write_text(section, encoding="utf-8")
    run(["simulate", "cameras", "-o", "photographs", "--images", *VIEWS])
    run(["simulate", "cameras", "-o", "pair", "--images", "--cameras", "2", "--form", "ros1", *VIEWS, *SMALL])
    shutil.copy(next(Path("pair").glob("*.bag")), "pair.bag")
    for name in ("stereo", "corners"):
        run(["simulate", "cameras", "-o", name, "--cameras", "2", "--views", "10", *SMALL])
    shutil.copy("stereo/target.yaml", "target.yaml")
    run(["simulate", "camera-imu", "-o", "rig", *RIG, "--seed", "5"])
    stated = list(shell_commands(tmp_path / "section.md"))
    commands = [words for words in stated if words[0] != "live"]  # there is no camera here
    assert {"target", "camera", "camera-imu", "simulate"} == {words[0] for words in commands}
    here = {"/left/image_raw": "/cam0/image_raw", "/right/image_raw": "/cam1/image_raw"}
    for number, stated in enumerate(commands):
        # The rig's board is a smaller one, and the bag's topics are called otherwise.
        names = {"target.yaml": "rig/target.yaml"} if stated[0] == "camera-imu" else {}
        words = [names.get(word, re.sub("(?<==)/.*", lambda topic: here[topic[0]], word)) for word in stated]
        fewer = ["--views", "3"] if "--images" in words else []
        elsewhere = ["--no-report"] + ["-o", f"result-{number}"] * (number > 1)
        run(words + fewer + elsewhere * (words[0] in {"camera", "camera-imu"}), may_fail=words[0] == "camera")


@pytest.mark.long
def test_every_way_to_trust_and_to_take_elsewhere_works(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    section = how_to("trust")
    (tmp_path / "section.md").write_text(section, encoding="utf-8")
    needs = re.search(r"^```yaml\n(name: .*?)^```", section, re.MULTILINE | re.DOTALL)
    (tmp_path / "needs.yaml").write_text(needs.group(1), encoding="utf-8")
    run(["simulate", "-o", "log.csv", "--intervals", "20", "--t-init-s", "20"])
    run(["simulate", "camera-imu", "-o", "rig", *RIG, "--seed", "5"])
    run(["camera-imu", "rig", "--no-report"])
    run(["simulate", "camera-imu", "-o", "today-rig", *RIG, "--seed", "6", "--sensor-seed", "5"])
    for seed, day in enumerate(("monday", "today")):
        sensor = ["--sensor-seed", "1", "--seed", str(seed)]
        run(["simulate", "imu", "-o", f"{day}.csv", "--intervals", "20", "--t-init-s", "20", *sensor])
    run(["imu", "monday.csv", "--no-report"])
    shutil.copytree("rig-camera-imu", "monday-camera-imu")
    for day in ("tuesday", "wednesday"):
        shutil.copytree("rig-camera-imu", f"{day}-camera-imu")
    for name in ("camchain-imucam", "imu"):
        shutil.copy(f"rig-camera-imu/{name}.yaml", f"run-{name}.yaml")
    run(["convert", "rig-camera-imu/calibration.yaml", "--to", "basalt", "-o", "."])
    for name in ("camchain", "imu", "target"):
        shutil.copy(f"rig/{name}.yaml", f"{name}.yaml")
    shutil.copytree("monday-imu", "old-results/SN0007")
    for line, name, source in (("line-1", "SN0042_2026-03-31", "today.csv"), ("line-2", "run-17", "log.csv")):
        Path(line).mkdir()
        shutil.copy(source, f"{line}/{name}.csv")
    table = re.search(r"^```text\n(recording,.*?)^```", section, re.MULTILINE | re.DOTALL)
    Path("devices.csv").write_text(table.group(1), encoding="utf-8")
    commands = [words for words in shell_commands(tmp_path / "section.md") if words[1:2] != ["rig.bag"]]
    commands = [words for words in commands if words[0] != "study" and words[1:2] != ["serve"]]  # tested elsewhere
    used = {"imu", "show", "compare", "verify", "convert", "plan", "plan-imu", "batch", "library"}
    assert used == {words[0] for words in commands}
    for words in commands:
        shown = words[0] in {"show", "plan"} and ("needs.yaml" in words or "gimbal" in words or "planar" in words)
        shorter = ["--duration-s", "15"] * (words[0] == "plan" and "--duration-s" not in words)
        run(words + shorter, may_fail=shown)  # the verdict on so short a recording, and on a vehicle
