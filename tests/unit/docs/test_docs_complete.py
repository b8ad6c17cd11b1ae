"""The documentation tells everything there is, and nothing that is not."""

import importlib.util
import re
import sys
import typing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

import gnomon
import triad_result
from cameras_result import BOARD, make_cameras_result
from docs_pages import DOCS, PAGES, shell_commands, text
from gnomon.calibrate.steps import camera_reading
from gnomon.cli.command import COMMANDS, parse_command
from gnomon.cli.commands.convert import RecordingForm
from gnomon.cli.commands.study import PAGE, STUDIES
from gnomon.findings import Finding, read_catalogue
from gnomon.formats.conversion import FORMATS
from gnomon.formats.kalibr import camchain
from gnomon.formats.kalibr import target as kalibr_target
from gnomon.formats.own.calibration_file import SIGMAS
from gnomon.formats.own.calibration_text import calibration_text
from gnomon.formats.own.dataclass_file import read_use
from gnomon.formats.own.noise_file import allan_text, noise_document
from gnomon.options.requirements import GENERAL, GENERAL_IMU, GENERAL_RIG, QUANTITIES, USES, parse_sigma
from gnomon.readers.images.image_files import IMAGE_SUFFIXES
from gnomon.readers.images.image_pixels import ENCODINGS
from gnomon.readers.samples.npz import __doc__ as npz_keys
from gnomon.readers.samples.poses import pose_column
from gnomon.recording import FrameQuality
from gnomon.results.calibration import calibration_parameters
from gnomon.results.camera_diagnostics import SceneMap
from gnomon.results.result import diagnostic_arrays
from gnomon.results.trust import ParameterChange, WeakDirection
from gnomon.study.circuit import PROBES
from gnomon.units import ACCELEROMETER_UNITS_M_S2, GYROSCOPE_UNITS_RAD_S, MAGNETOMETER_UNITS_UT
from support.faults import fault_named, faults

SHORT = gnomon.Scenario(intervals=20, t_init_s=20.0, g_sensitivity=3e-4)
WAVED = gnomon.CameraImuScenario(duration_s=8.0, camera_rate_hz=10.0, cameras=2, target_cols=4, target_rows=4)


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


@pytest.fixture(scope="module")
def lenses_result():
    return make_cameras_result()


def as_if_from_images(frames):
    """Return frames of which it is known what the images were like."""
    each = np.full(len(frames.t_ns), 0.7)
    quality = FrameQuality(blur_px=each, black=30 * each, white=250 * each, dropped={"near the border": 3})
    return replace(frames, quality=quality, sigma_px=np.full(len(frames.frame), 0.3))


def page_maker(name):
    """Return a program of docs/, as a module."""
    spec = importlib.util.spec_from_file_location(name, DOCS / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # where dataclasses look for what their fields mean
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def generated():
    return page_maker("make_reference").pages()


@pytest.mark.parametrize("name", ["cli.md", "python.md", "symptoms.md"])
def test_generated_pages_are_up_to_date(name, generated):
    assert text(name) == generated[name], "run: python docs/make_reference.py"


@pytest.mark.parametrize("name", COMMANDS)
def test_every_option_in_the_help_is_documented(name, capsys):
    with pytest.raises(SystemExit):
        parse_command([name, "--help"])
    options = set(re.findall(r"(?<![\w-])--?[a-z][\w-]*", capsys.readouterr().out)) - {"-h", "--help"}
    options -= {"-x", "-y", "-z"}  # axes that point down
    section = text("cli.md").split(f"## gnomon {name}\n")[1].split("\n## ")[0]
    assert options
    assert {option for option in options if not re.search(rf"`{option}[` ]", section)} == set()


def test_every_public_name_is_documented():
    names = set(gnomon.__all__) - {"__version__"}
    assert {name for name in names if f"\n### {name}\n" not in text("python.md")} == set()


def keys_of(node, path=""):
    """Yield the path of every key of a document, list items by their first."""
    if isinstance(node, dict):
        for key, value in node.items():
            yield f"{path}.{key}".lstrip(".")
            yield from keys_of(value, f"{path}.{key}")
    elif isinstance(node, list) and node and isinstance(node[0], dict):
        yield from keys_of(node[0], path)


@pytest.mark.parametrize("which", ["result", "rig_result", "lenses_result", *triad_result.RESULTS])
def test_every_key_of_the_calibration_file_is_documented(which, request):
    section = text("files.md").split("## calibration.yaml")[1].split("\n## ")[0]
    made = triad_result.RESULTS[which]() if which in triad_result.RESULTS else request.getfixturevalue(which)
    calibration = made.calibration
    document = yaml.safe_load(calibration_text(calibration))
    document["provenance"]["inputs"] = [{"name": "", "sha256": ""}]
    document["assessment"].get("trust", {})["sigma_ratio"] = {}  # by the paths of the other keys
    sensors = {*calibration.imus, *calibration.cameras}
    last = {path.rsplit(".", 1)[-1] for path in keys_of(document)} - {*sensors, *document["provenance"]["options"]}
    sigmas = {f"{path.rsplit('.', 1)[-1]}_sigma" for path, _ in calibration_parameters(calibration.imus)}
    if calibration.cameras:
        of_imu = {"time_shift_cam_imu", "line_delay"} if not calibration.imus else set()
        sigmas |= {key for path, key in SIGMAS.items() if not path.startswith("T_cam_") and path not in of_imu}
    assert sigmas < last
    assert {key for key in last - sigmas if not re.search(rf"[`.]{key}[`.]", section)} == set()


def documented_keys(table):
    """Return the words in the first column of a table."""
    cells = re.findall(r"^\| (`.*?) \|", table, re.MULTILINE)
    return {word for cell in cells for word in re.findall(r"`([^`]+)`", cell)}


def keys_but_trust(diagnostics):
    return {name for name, _ in diagnostic_arrays(diagnostics) if not name.startswith("trust.")}


def test_every_key_of_the_diagnostics_is_documented(result, rig_result):
    section = text("files.md").split("## diagnostics.npz")[1].split("\n## ")[0]
    heads = "Of poses, a turntable|Of cameras and IMUs|Of cameras alone|Of all of them"
    alone, from_magnitudes, with_cameras, _, trusted = re.split(heads, section)
    assert documented_keys(alone) == keys_but_trust(result.diagnostics)
    scene = SceneMap(points=np.zeros((2, 3)), sigma=np.zeros((2, 3)))
    keys = keys_but_trust(replace(rig_result.diagnostics, scene=scene))
    names = {re.sub(r"(dropped\.).*", r"\1REASON", name) for name in keys}
    assert "corners.cam0.quality.dropped.REASON" in names
    twins = {name for name in names if name.split(".")[-1] == "cam1" or ".cam1." in name or "accelerometer" in name}
    assert {name.replace("cam1", "cam0").replace("accelerometer", "gyroscope") for name in twins} < names
    assert documented_keys(with_cameras) == names - twins
    results = [make() for make in triad_result.RESULTS.values()]
    tables = [replace(made.diagnostics, gravity=made.calibration.gravity) for made in results]
    names = {name for table in tables for name in keys_but_trust(table)}
    names = {re.sub(r"^(triads\.)\w+(?!.*history)", r"\1gyroscope", name) for name in names}
    names = {re.sub(r"^noise\..*", "noise.NAME", name) for name in names}
    assert len(names) > 40
    assert documented_keys(from_magnitudes) == names
    weak = WeakDirection(shares=(("cam0.time_shift_cam_imu", 1.0),), determined=0.1, words="it", cure="so", held=True)
    told = [replace(made.diagnostics.trust, weak=weaks) for made in (result, rig_result) for weaks in ((), (weak,))]
    one = np.ones(1)
    change = ParameterChange(block="a", names=("a[0]",), values=one, covariance=np.eye(1), where="", chance=0.0)
    told.append(replace(told[0], changes=(change,)))
    told.append(replace(told[0], clusters=None, ratios=(), models=(), splits=replace(told[0].splits, blocks=())))
    names = {re.sub(r"\.\d+\.", ".0.", name) for trust in told for name, _ in diagnostic_arrays(trust, "trust")}
    assert documented_keys(trusted) == names


def test_every_key_of_the_diagnostics_of_cameras_alone_is_documented(lenses_result):
    section = text("files.md").split("## diagnostics.npz")[1].split("\n## ")[0]
    of_rigs, of_lenses = re.split("Of cameras and IMUs|Of cameras alone|Of all of them", section)[1:3]
    names = keys_but_trust(lenses_result.diagnostics)
    names = {re.sub(r"^views\.\d+", "views.0", name).replace("cam1", "cam0") for name in names}
    names = {re.sub(r"(dropped\.).*", r"\1REASON", name) for name in names}
    shared = {
        name for name in names if name.split(".")[0] in {"corners", "parameters", "correlation", "noise", "steps"}
    }
    assert shared <= documented_keys(of_rigs)
    assert documented_keys(of_lenses) == names - shared


def test_every_key_of_kalibrs_results_of_cameras_alone_is_documented(lenses_result, tmp_path):
    section = text("files.md").split("## Kalibr's results of cameras alone")[1].split("\n## ")[0]
    for path in gnomon.save_camera_files(lenses_result, BOARD, tmp_path):
        assert f"`{path.name}`" in section
        if path.suffix == ".yaml":
            keys = {key.rsplit(".", 1)[-1] for key in keys_of(yaml.safe_load(path.read_text(encoding="utf-8")))}
            assert {key for key in keys - {"cam0", "cam1"} if f"`{key}`" not in section} == set()


def test_every_key_of_kalibrs_results_is_documented(rig_result, tmp_path):
    made = gnomon.simulate_camera_imu(WAVED, seed=2)
    section = text("files.md").split("## Kalibr's results\n")[1].split("\n## ")[0]
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
    assert documented_keys(kept) == {*camera_reading._ARRAYS, "told"}


def test_every_key_of_a_board_is_documented():
    inputs = text("files.md").split("## Kalibr's files")[1].split("\n## ")[0]
    keys = {key for _, values in kalibr_target._BOARDS.values() for key in values}
    assert len(keys) > 8
    keys |= {*kalibr_target._FIRST_TAG, kalibr_target._BORDER, *camchain._SIGMAS}
    assert {key for key in keys if f"`{key}`" not in inputs} == set()


def test_every_npz_key_and_export_format_is_documented():
    keys = set(re.findall(r"^    (\w+)|, (\w+_ns)", npz_keys, re.MULTILINE))
    keys = {a or b for a, b in keys}
    assert len(keys) > 6
    assert {key for key in keys if f"`{key}`" not in text("files.md")} == set()
    assert {name for name in FORMATS if f"| `{name}` |" not in text("files.md")} == set()


def test_every_key_of_the_noise_files_is_documented(tmp_path):
    rng = np.random.default_rng(1)
    t_s = np.arange(12_000) / 100
    found = gnomon.identify_noise(gnomon.Recording.from_arrays(t_s, *rng.normal(size=(2, len(t_s), 3)) * 1e-2))
    section = text("files.md").split("## noise.yaml")[1].split("\n## ")[0]
    keys = {key.rsplit(".", 1)[-1] for key in keys_of(noise_document(found.noise))}
    keys -= {"severity", "code", "message", "consequence", "cure", "gnomon_version", "method", "inputs", "options"}
    keys -= {"name", "sha256"}  # of each of the inputs
    assert len(keys) > 15
    assert {key for key in keys if not re.search(rf"[`.]{key}[`.]", section)} == set()
    section = text("files.md").split("## allan.csv")[1].split("\n## ")[0]
    header = allan_text(found).splitlines()[0].split(",")
    assert {name for name in header if f"`{name}`" not in section} == set()


def test_every_need_of_every_use_is_documented():
    section = text("how-to/trust/judge-for-a-use.md")
    head, *rows = [
        [cell.strip(" `") for cell in line.split("|")[1:-1]] for line in re.findall(r"^\| .*", section, re.M)
    ]
    written = {use: {row[0]: row[i] for row in rows if row[i]} for i, use in enumerate(head) if i}
    assert [row[0] for row in rows] == [*QUANTITIES]
    assert [row[0] for row in rows][:5] == [*GENERAL_RIG.needs]
    known = {name: {q: parse_sigma(q, words) for q, words in needs.items()} for name, needs in written.items()}
    uses = {name: use.needs for name, use in USES.items()} | {GENERAL: {**GENERAL_RIG.needs, **GENERAL_IMU.needs}}
    assert known == {name: {q: pytest.approx(size) for q, size in needs.items()} for name, needs in uses.items()}


def test_the_limits_of_odometry_follow_from_the_circuit():
    """Each is the drift by itself, over the root of eight, over what a small error adds, and rounded in the code."""
    section = text("validation.md").split("\n## Round a circuit")[1].split("\n## ")[0]
    rows = [[cell.strip() for cell in line.split("|")[1:-1]] for line in re.findall(r"^\| .*", section, re.M)]
    rows = rows[next(k for k, row in enumerate(rows) if row[0] == "off in") + 1 :]
    assert len(rows) == len(PROBES)
    drift_cm = float(re.search(r"Noise alone costs ([\d.]+) cm", section).group(1))
    for (name, probe), (words, _, _, small, added, _, _, follows, limits) in zip(PROBES.items(), rows, strict=True):
        assert parse_sigma(name, small) == pytest.approx(probe), words
        derived = probe * drift_cm / np.sqrt(8) / float(added)
        assert parse_sigma(name, follows) == pytest.approx(derived, rel=0.06 / float(added)), words
        now, unit = limits.split(", ")[1].split(" ", 1)
        assert parse_sigma(name, f"{now} {unit}") == pytest.approx(USES["vio"].needs[name]), words
        assert USES["vio"].needs[name] == pytest.approx(derived, rel=0.1), words


def test_the_warnings_whose_error_is_not_in_the_sigmas_are_marked():
    entries = [entry for entry in read_catalogue() if "when" in entry]
    beyond = [entry for entry in entries if not entry.get("in_sigmas", True)]
    assert all("warning" in entry["when"] for entry in beyond)
    entry_of = re.findall(r'<a id="code-([\w-]+)"></a>(.*?)(?=<a id=|\Z)', " ".join(text("symptoms.md").split()))
    marked = [code for code, words in entry_of if "*not in the sigmas*" in words]
    assert set(marked) == {entry["code"].partition("/")[0] for entry in beyond}
    code = marked[0]
    assert Finding(severity="warning", code=code, message="").label == f"{code}, not in the sigmas"
    assert Finding(severity="info", code=code, message="").label == code
    assert Finding(severity="warning", code="stream-short", message="").label == "stream-short"
    says = re.compile(
        "larger than the (stated )?sigmas|off by more than (their|its) sigmas|sigmas? comes? out too small"
    )
    told = {entry["code"] for entry in entries if says.search(f"{entry['explained']} {entry.get('consequence', '')}")}
    warned = {entry["code"] for entry in entries if "warning" in entry["when"]}
    assert len(told & warned) > 4
    assert told & warned <= {entry["code"] for entry in beyond}


def test_the_example_of_needs_can_be_read(tmp_path):
    example = re.search(r"^```yaml\n(name: .*?)^```", text("how-to/trust/judge-for-a-use.md"), re.MULTILINE | re.DOTALL)
    (tmp_path / "needs.yaml").write_text(example.group(1), encoding="utf-8")
    assert read_use(tmp_path / "needs.yaml").needs["time_shift"] == pytest.approx(2e-4)


def test_every_column_of_averaged_poses_is_documented():
    section = text("files.md").split("### Averaged poses")[1].split("\n### ")[0]
    listed = {word for word in documented_keys(section) if " " not in word and not word.startswith("-")}
    assert len(listed) > 12
    assert {word for word in listed if not pose_column(word).kind} == set()
    kinds = {"accelerometer", "gyroscope", "accelerometer_sigma", "gyroscope_sigma"}
    assert {pose_column(word).kind for word in listed} == {*kinds, "reference", "samples", "time", "name"}


def test_every_unit_and_file_of_a_study_is_documented():
    units = {
        unit for table in (ACCELEROMETER_UNITS_M_S2, GYROSCOPE_UNITS_RAD_S, MAGNETOMETER_UNITS_UT) for unit in table
    }
    section = text("files.md").split("**Units.**")[1].split("\n\n")[0]
    assert {unit for unit in units if f"`{unit}`" not in section} == set()
    section = text("files.md").split("## Studies")[1].split("\n## ")[0]
    tables = {table for study in STUDIES.values() for table in study.tables}
    assert {name for name in tables if f"`{name}.csv`" not in section} == set()
    assert f"`{PAGE}`" in section


def test_the_gallery_shows_every_fault():
    entries = text("gallery.md").split("\n### ")[1:]
    sound = [entry for entry in entries if entry.startswith("Nothing is wrong")]
    assert len(sound) == 2
    assert all("Verdict pass" in entry for entry in sound)
    titles = [entry.partition("\n")[0] for entry in entries]
    assert len(set(titles)) == len(titles) == len(faults()) + len(sound)
    for fault, entry in zip(faults(), [entry for entry in entries if entry not in sound], strict=True):
        assert entry.startswith(fault.title.replace("²", "^2")), fault.name
        assert " ".join(fault.symptom.split()) in " ".join(entry.split()), fault.name
    shown = set(re.findall(r"\]\(gallery/([\w-]+\.png)\)", text("gallery.md")))
    assert shown == {path.name for path in (DOCS / "gallery").iterdir()}
    assert max(path.stat().st_size for path in (DOCS / "gallery").iterdir()) < 60_000


def test_an_entry_of_the_gallery_is_what_gnomon_says():
    entry = page_maker("make_gallery").faulty_entry(fault_named("gyroscope-clips"), pictures=False)
    assert f"### {entry.title}\n" in text("gallery.md")
    assert f"Verdict {entry.verdict}:\n\n{entry.said}\n" in text("gallery.md")


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
            anchors |= set(re.findall(r'<a id="([\w-]+)"></a>', path.read_text(encoding="utf-8")))
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
            name = " ".join(words[:2]) if words[0] == "simulate" else words[0]
            assert type(parse_command(words)) is COMMANDS[name]


def test_every_page_is_on_the_site():
    nav = (DOCS.parent / "mkdocs.yml").read_text(encoding="utf-8").split("\nnav:\n")[1]
    named = re.findall(r"([\w/.-]+\.md)$", nav, re.MULTILINE)
    assert sorted(named) == sorted(page.relative_to(DOCS).as_posix() for page in PAGES[1:])


def test_indexes_list_every_page():
    for folder in (DOCS / "how-to").iterdir():
        pages = {page.name for page in folder.glob("*.md")} - {"index.md"}
        for index, prefix in ((folder / "index.md", ""), (DOCS / "how-to.md", f"how-to/{folder.name}/")):
            listed = re.findall(
                rf"^- \[.*\]\({prefix}([\w.-]+\.md)\)$", index.read_text(encoding="utf-8"), re.MULTILINE
            )
            assert set(listed) == pages, index
