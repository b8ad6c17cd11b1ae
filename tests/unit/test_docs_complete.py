"""The documentation tells everything there is, and nothing that is not."""

import ast
import contextlib
import importlib.util
import io
import re
import shlex
import shutil
import typing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

import gnomon
from gnomon.calibrate import corner_cache
from gnomon.calibration import parameters
from gnomon.cli import main
from gnomon.cli.commands import COMMANDS, RecordingForm
from gnomon.cli.parse import parse
from gnomon.readers import kalibr_camchain, kalibr_target
from gnomon.readers.calibration_cameras import SIGMAS
from gnomon.readers.image_file import IMAGE_SUFFIXES
from gnomon.readers.image_pixels import ENCODINGS
from gnomon.readers.npz import __doc__ as npz_keys
from gnomon.recording import FrameQuality
from gnomon.writers.calibration_file import calibration_text
from gnomon.writers.conversion import FORMATS
from gnomon.writers.diagnostics_file import diagnostic_arrays
from gnomon.writers.kalibr_text import kalibr_yaml

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
PAGES = (ROOT / "README.md", *sorted(DOCS.glob("*.md")))
SHELL = re.compile(r"^```sh\n(.*?)^```", re.MULTILINE | re.DOTALL)
PYTHON = re.compile(r"^```python\n(.*?)^```", re.MULTILINE | re.DOTALL)
DOCUMENTED_CODE = re.compile(r"^- (\*\*`.*?)\(", re.MULTILINE)
SHORT = gnomon.Scenario(intervals=20, t_init_s=20.0, g_sensitivity=3e-4)
WAVED = gnomon.CameraImuScenario(duration_s=8.0, camera_rate_hz=10.0, cameras=2, target_cols=4, target_rows=4)
RIG = shlex.split("--duration-s 10 --camera-rate-hz 5 --imu-rate-hz 100 --target-cols 3 --target-rows 3")
"""Options of a small simulated rig."""


def text(name):
    return (DOCS / name).read_text(encoding="utf-8")


def shell_commands(page):
    """Yield the words of every `gnomon` command in a page's shell blocks."""
    for block in SHELL.findall(page.read_text(encoding="utf-8")):
        for line in block.splitlines():
            words = shlex.split(line, comments=True)
            if words[:1] == ["gnomon"]:
                end = next((i for i, word in enumerate(words) if word.startswith((">", "2>"))), len(words))
                yield words[1:end]


def run(arguments):
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()) as errors:
        code = main(arguments)
    assert code == 0, f"gnomon {shlex.join(arguments)}: exit code {code}: {errors.getvalue()}"


@pytest.fixture(scope="module")
def result():
    recording, _ = gnomon.simulate(SHORT, seed=2)
    return gnomon.calibrate_imu(recording)


@pytest.fixture(scope="module")
def rig_result():
    made = gnomon.simulate_camera_imu(WAVED, seed=2)
    cameras = {name: as_if_from_images(frames) for name, frames in made.recording.cameras.items()}
    recording = replace(made.recording, cameras=cameras)
    return gnomon.calibrate_camera_imu(recording, made.target, gnomon.CameraImuOptions(compare=True))


def as_if_from_images(frames):
    """Return frames of which it is known what the images were like."""
    each = np.full(len(frames.t_ns), 0.7)
    quality = FrameQuality(blur_px=each, black=30 * each, white=250 * each, dropped={"near the border": 3})
    return replace(frames, quality=quality, sigma_px=np.full(len(frames.frame), 0.3))


@pytest.fixture(scope="module")
def generated():
    spec = importlib.util.spec_from_file_location("make_reference", DOCS / "make_reference.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.pages()


@pytest.mark.parametrize("name", ["cli.md", "python.md"])
def test_generated_pages_are_up_to_date(name, generated):
    assert text(name) == generated[name], "run: python docs/make_reference.py"


@pytest.mark.parametrize("name", COMMANDS)
def test_every_option_in_the_help_is_documented(name, capsys):
    with pytest.raises(SystemExit):
        parse([name, "--help"])
    options = set(re.findall(r"(?<![\w-])--?[a-z][\w-]*", capsys.readouterr().out)) - {"-h", "--help", "-gnomon"}
    section = text("cli.md").split(f"## gnomon {name}\n")[1].split("\n## ")[0]
    assert options
    assert {option for option in options if not re.search(rf"`{option}[` ]", section)} == set()


def test_every_public_name_is_documented():
    names = set(gnomon.__all__) - {"__version__"}
    assert {name for name in names if f"\n### {name}\n" not in text("python.md")} == set()


def finding_codes():
    """Return every code that the source gives to a finding; a part that is filled in becomes a star."""
    codes = set()
    for folder in ("assess", "calibrate"):
        for path in (ROOT / "src" / "gnomon" / folder).glob("*.py"):
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "Finding":
                    value = next(keyword.value for keyword in node.keywords if keyword.arg == "code")
                    parts = value.values if isinstance(value, ast.JoinedStr) else [value]
                    codes.add("".join(part.value if isinstance(part, ast.Constant) else "*" for part in parts))
    return codes


def test_every_finding_is_explained_and_no_other():
    written = {code for line in DOCUMENTED_CODE.findall(text("how-to.md")) for code in re.findall(r"`([\w-]+)`", line)}
    patterns = {code: re.compile(re.escape(code).replace(r"\*", r"[\w-]+")) for code in finding_codes()}
    assert len(patterns) > 30
    assert {code for code, pattern in patterns.items() if not any(map(pattern.fullmatch, written))} == set()
    assert {code for code in written if not any(p.fullmatch(code) for p in patterns.values())} == set()


def keys_of(node, path=""):
    """Yield the path of every key of a document, list items by their first."""
    if isinstance(node, dict):
        for key, value in node.items():
            yield f"{path}.{key}".lstrip(".")
            yield from keys_of(value, f"{path}.{key}")
    elif isinstance(node, list) and node and isinstance(node[0], dict):
        yield from keys_of(node[0], path)


@pytest.mark.parametrize("which", ["result", "rig_result"])
def test_every_key_of_the_calibration_file_is_documented(which, request):
    section = text("files.md").split("## calibration.yaml")[1].split("\n## ")[0]
    calibration = request.getfixturevalue(which).calibration
    document = yaml.safe_load(calibration_text(calibration))
    document["provenance"]["inputs"] = [{"name": "", "sha256": ""}]
    sensors = {*calibration.imus, *calibration.cameras}
    last = {path.rsplit(".", 1)[-1] for path in keys_of(document)} - {*sensors, *document["provenance"]["options"]}
    sigmas = {f"{path.rsplit('.', 1)[-1]}_sigma" for path, _ in parameters(calibration.imus)}
    if calibration.cameras:
        sigmas |= {key for path, key in SIGMAS.items() if not path.startswith("T_cam_imu")}
    assert sigmas < last
    assert {key for key in last - sigmas if not re.search(rf"[`.]{key}[`.]", section)} == set()


def documented_keys(table):
    """Return the words in the first column of a table."""
    cells = re.findall(r"^\| (`.*?) \|", table, re.MULTILINE)
    return {word for cell in cells for word in re.findall(r"`([^`]+)`", cell)}


def test_every_key_of_the_diagnostics_is_documented(result, rig_result):
    section = text("files.md").split("## diagnostics.npz")[1].split("\n## ")[0]
    alone, with_cameras = section.split("Of cameras and an IMU")
    assert documented_keys(alone) == {name for name, _ in diagnostic_arrays(result.diagnostics)}
    names = {re.sub(r"(dropped\.).*", r"\1REASON", name) for name, _ in diagnostic_arrays(rig_result.diagnostics)}
    assert "corners.cam0.quality.dropped.REASON" in names
    twins = {name for name in names if name.split(".")[-1] == "cam1" or ".cam1." in name or "accelerometer" in name}
    assert {name.replace("cam1", "cam0").replace("accelerometer", "gyroscope") for name in twins} < names
    assert documented_keys(with_cameras) == names - twins


def test_every_key_of_kalibrs_results_is_documented(rig_result, tmp_path):
    made = gnomon.simulate_camera_imu(WAVED, seed=2)
    section = text("files.md").split("## Kalibr's results")[1].split("\n## ")[0]
    inputs = text("files.md").split("## Kalibr's files")[1].split("\n## ")[0]
    for path in gnomon.save_camera_imu_files(rig_result, made.recording, made.target, tmp_path):
        assert f"`{path.name}`" in section or f"## {path.name}" in text("files.md")
        if path.suffix == ".yaml":
            keys = {key.rsplit(".", 1)[-1] for key in keys_of(yaml.safe_load(path.read_text(encoding="utf-8")))}
            keys -= {"imu0", "cam0", "cam1"}
            assert {key for key in keys if not re.search(rf"\b{key}\b", section + inputs)} == set()


def test_every_board_and_lens_is_documented():
    inputs = text("files.md").split("## Kalibr's files")[1].split("\n## ")[0]
    for field in ("projection", "distortion", "target_type"):
        choices = typing.get_args(typing.get_type_hints(gnomon.CameraImuScenario)[field])
        assert len(choices) > 2
        assert {choice for choice in choices if f"`{choice}`" not in inputs} == set()


def test_every_kind_of_image_and_of_recording_is_documented():
    section = text("files.md").split("## Camera-IMU recordings")[1].split("\n## ")[0]
    encodings = section.split("### Encodings")[1].split("\n### ")[0]
    listed = set(re.findall(r"`(\w+)`", encodings))
    listed |= {f"{name.removesuffix('8')}16" for name in listed if name.startswith("bayer_")}  # "the same four with 16"
    assert set(ENCODINGS) == listed - {"16"}
    kinds = {".jpg": "JPEG", ".jpeg": "JPEG", ".tif": "TIFF"}
    assert {kinds.get(suffix, suffix[1:].upper()) for suffix in IMAGE_SUFFIXES} <= set(
        re.findall(r"[A-Z]{3,4}", section)
    )
    written = text("files.md").split("**Recordings.**")[1].split("\n## ")[0]
    assert {name for name in typing.get_args(RecordingForm) if f"| `{name}` |" not in written} == set()
    kept = section.split("### The corner cache")[1]
    assert documented_keys(kept) == {*corner_cache._ARRAYS, "told"}


def test_every_key_of_a_board_is_documented():
    inputs = text("files.md").split("## Kalibr's files")[1].split("\n## ")[0]
    keys = {key for _, values in kalibr_target._BOARDS.values() for key in values}
    assert len(keys) > 8
    keys |= {*kalibr_target._FIRST_TAG, kalibr_target._BORDER, *kalibr_camchain._SIGMAS}
    assert {key for key in keys if f"`{key}`" not in inputs} == set()


def test_every_npz_key_and_export_format_is_documented():
    keys = set(re.findall(r"^    (\w+)|, (\w+_ns)", npz_keys, re.MULTILINE))
    keys = {a or b for a, b in keys}
    assert len(keys) > 6
    assert {key for key in keys if f"`{key}`" not in text("files.md")} == set()
    assert {name for name in FORMATS if f"| `{name}` |" not in text("files.md")} == set()


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_lead_somewhere(page):
    for target in re.findall(r"\]\(([^)\s]+)\)", page.read_text(encoding="utf-8")):
        if target.startswith(("http:", "https:")):
            continue
        name, _, anchor = target.partition("#")
        path = page.parent / name if name else page
        assert path.exists(), f"{page.name}: {target}"
        if anchor:
            titles = re.findall(r"^#+ (.*)$", path.read_text(encoding="utf-8"), re.MULTILINE)
            anchors = {re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-") for title in titles}
            assert anchor in anchors, f"{page.name}: {target}"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_no_path_of_a_machine(page):
    content = page.read_text(encoding="utf-8")
    assert not re.search(r"/(?:work|tmp|home|root|Users)/", content)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_commands_can_be_parsed(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for words in shell_commands(page):
        if "--scenario" in words:  # it is read while the command is parsed
            file = Path(words[words.index("--scenario") + 1])
            file.parent.mkdir(exist_ok=True)
            file.write_text("motion: shaky\n", encoding="utf-8")
        if words[0] != "demo" or words[1:]:
            assert type(parse(words)) is COMMANDS[words[0]]


def test_the_tutorial_can_be_followed(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    commands = list(shell_commands(DOCS / "tutorial.md"))
    alone = ["simulate", "check", "imu", "show", "apply", "convert"]
    with_cameras = ["simulate-camera-imu", "check", "camera-imu", "show", "convert", "apply", "convert"]
    assert [words[0] for words in commands] == alone + with_cameras
    for words in commands:
        run(words)
    for part in ("first", "second"):
        assert (tmp_path / part / "result" / "report.html").exists()
    files = re.findall(r"^\| `([\w.-]+)` \|", text("tutorial.md"), re.MULTILINE)
    assert {name for name in files if not (tmp_path / "second" / "result" / name).exists()} == set()
    header = text("tutorial.md").split("```text\n")[1].split("\n")[0]
    rows = np.loadtxt("first/recording.csv", delimiter=",", skiprows=1)
    rows[:, 0] //= 1000
    Path("mine.csv").write_text(header + "\n", encoding="utf-8")
    with Path("mine.csv").open("a", encoding="utf-8") as file:
        np.savetxt(file, rows, fmt="%d", delimiter=",")
    assert gnomon.read("mine.csv").imus["imu0"].gyroscope.rate_hz == pytest.approx(100)


def test_the_readme_does_what_it_shows(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name, seed in (("log.csv", 1), ("flight.csv", 2)):
        run(["simulate", "-o", name, "--seed", str(seed), "--intervals", "20", "--t-init-s", "20"])
    run(["simulate-camera-imu", "-o", "rig", "--images", *RIG])
    run(["convert", "rig", "--to", "ros1", "-o", "rig.bag"])
    for name in ("camchain.yaml", "imu.yaml", "target.yaml"):
        shutil.copy(f"rig/{name}", name)
    page = ROOT / "README.md"
    commands = list(shell_commands(page))
    alone, calibrated = ["check", "imu", "show", "apply", "convert"], ["camera-imu", "show", "camera-imu", "camera-imu"]
    with_cameras = ["camera-imu", "check", *calibrated, "convert", "convert", "simulate-camera-imu"]
    assert [words[0] for words in commands] == alone + with_cameras
    for words in commands:
        once = words[:2] == ["camera-imu", "rig"] and "-o" not in words
        run(words + ["--no-report"] * (words[0] == "camera-imu" and not once))
    for block in PYTHON.findall(page.read_text(encoding="utf-8")):
        with contextlib.redirect_stdout(io.StringIO()):
            exec(compile(block, "README.md", "exec"), {})
    for report in ("report.html", "rig-gnomon/report.html"):
        assert (tmp_path / report).exists()


def test_every_way_to_calibrate_a_rig_works(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    commands = [words for words in shell_commands(DOCS / "how-to.md") if words[:2] == ["camera-imu", "rig"]]
    assert len(commands) > 5
    run(["simulate-camera-imu", "-o", "rig", *RIG, "--seed", "5"])
    chain = yaml.safe_load(Path("rig/camchain.yaml").read_text(encoding="utf-8"))
    truth = gnomon.load("rig/truth.yaml").cameras["cam0"]
    chain["cam0"] |= {"T_cam_imu": truth.T_cam_imu, "timeshift_cam_imu": truth.time_shift_cam_imu}
    Path("rig/camchain.yaml").write_text(kalibr_yaml(chain), encoding="utf-8")  # what --fix and --prior hold
    for number, words in enumerate(commands):
        run([*words, "--no-report", "-o", f"result-{number}"])
