"""Names that try to be something else: markup in reports and tables, commands for terminals, lines and code in files.

Files of others bring them: names of files, topics, cameras, devices and units, and the texts of calibrations.
"""

import csv
import io
import re
from dataclasses import replace
from functools import cache
from html.parser import HTMLParser

import pytest
import yaml

import gnomon
from camera_imu_result import make_camera_imu_result
from cameras_result import make_cameras_result
from gnomon.cli import main
from gnomon.cli.terminal import Terminal
from gnomon.findings import Finding, printable_text
from gnomon.formats.conversion import FORMATS, export_texts
from gnomon.formats.own.calibration_text import calibration_text
from gnomon.recording import Source
from gnomon.report.page import write_report
from hostile.structured_targets import NOISE, StatedImu

EVIL = (
    '<script>alert(1)</script><img src=x onerror="alert(2)">&quot;\'"><svg onload=alert(3)>',
    "*/ #include </etc/passwd>\nint main; // \\",
    "a: b\n- c: *d # e\u2028key: value\x85key: value",
    "[red]x[/red] [/] [link=https://example.org]y[/link]",
    "\x1b[2J\x1b]0;title\x07\x9b31m\r\u202etxt.exe",
    "{{ 7 * 7 }} {% raw %} ${jndi:x} %s %n",
    '=cmd|" /C calc"!A0,"\n1,2,3',
)


class Tags(HTMLParser):
    """Collects what a browser would see: elements, attributes that run code, and what they refer to."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.elements: set[str] = set()
        self.handlers: list[str] = []
        self.scripts = 0
        self.feed(html)

    def handle_starttag(self, tag, attrs):
        self.elements.add(tag)
        self.scripts += tag == "script"
        self.handlers += [f"{tag} {key}" for key, _ in attrs if key.startswith("on")]
        self.handlers += [f"{tag} {key}={value}" for key, value in attrs if "javascript:" in (value or "")]


def named(result, evil):
    """Return a result in which every text that a file or a user may bring is an evil one."""
    calibration = result.calibration
    told = Finding(severity="warning", code="evil", message=evil, consequence=evil, cure=evil)
    cameras = {
        name: replace(camera, camera=replace(camera.camera, topic=evil)) for name, camera in calibration.cameras.items()
    }
    provenance = replace(
        calibration.provenance, inputs=(Source(name=evil, sha256="0" * 64),), options={"recording": evil, evil: "x"}
    )
    assessment = replace(calibration.assessment, findings=(told,), model=evil)
    changed = replace(calibration, cameras=cameras, provenance=provenance, assessment=assessment)
    return replace(result, calibration=changed)


@pytest.mark.parametrize("kind", ["imu", "camera-imu", "cameras"])
def test_reports_hold_no_markup_of_others(make_result, tmp_path, kind):
    make = {"imu": make_result, "camera-imu": make_camera_imu_result, "cameras": make_cameras_result}[kind]
    made = make()
    honest, attacked = named(made, "honest"), named(made, " ".join(EVIL))
    pages = []
    for number, result in enumerate((honest, attacked)):
        write_report(result, tmp_path / f"{number}.html")
        assert b"\x1b" not in (tmp_path / f"{number}.html").read_bytes()
        pages.append(Tags((tmp_path / f"{number}.html").read_text(encoding="utf-8")))
    assert pages[1].elements <= pages[0].elements | {
        "li",
        "p",
        "dd",
        "dt",
        "dl",
        "ul",
        "td",
        "tr",
        "h3",
        "strong",
        "div",
    }
    assert pages[1].scripts == pages[0].scripts == 1
    assert pages[1].handlers == pages[0].handlers


@pytest.mark.parametrize("evil", EVIL)
def test_own_files_read_back(make_result, tmp_path, evil):
    calibration = named(make_result(), evil).calibration
    (tmp_path / "calibration.yaml").write_text(calibration_text(calibration), encoding="utf-8")
    again = gnomon.load(tmp_path / "calibration.yaml")
    assert repr(again.provenance) == repr(calibration.provenance)
    assert again.assessment.findings == calibration.assessment.findings


RESULT = cache(make_camera_imu_result)


@cache
def converted(name, form):
    """Return the files of a result whose topics, inputs and remarks have a name."""
    stated = {"imu0": StatedImu(noise=NOISE, update_rate_hz=200.0, topic=name)}
    kept = ("kalibr", "openvins", "vins-fusion", "orb-slam3", "basalt", "okvis")
    return export_texts(named(RESULT(), name).calibration, form, imu=stated if form in kept else None).files


@pytest.mark.parametrize("evil", EVIL)
@pytest.mark.parametrize("form", [form for form in FORMATS if form not in {"imu_tk", "imucal", "px4", "ardupilot"}])
def test_converted_files_hold_names_as_text(form, evil):
    """Keys of the files stay those of honest names, whatever a topic or a remark says."""
    files = [converted("/honest", form), converted(evil, form)]
    assert list(files[0]) == list(files[1])
    for name, text in files[1].items():
        if name.endswith(".yaml"):
            texts = [re.sub(r"(?m)^%.*$", "", of[name]).replace("!!opencv-matrix", "") for of in files]
            documents = [yaml.load(text, yaml.CSafeLoader) for text in texts]
            assert keys(documents[0]) == keys(documents[1])
        elif name.endswith(".csv"):
            assert {len(row) for row in csv.reader(io.StringIO(text))} == {4}
        elif name.endswith(".h"):
            code = [re.sub(r"/\*.*?\*/", "", of[name], flags=re.DOTALL) for of in files]
            assert code[0] == code[1]


def keys(node) -> list[str]:
    if isinstance(node, dict):
        return [f"{key}/{inner}" for key, value in node.items() for inner in keys(value) or [""]]
    return [inner for item in node for inner in keys(item)] if isinstance(node, list) else []


@pytest.mark.parametrize("evil", EVIL)
def test_terminals_are_not_steered(make_result, tmp_path, capsys, evil):
    gnomon.save(named(make_result(), evil).calibration, tmp_path / "calibration.yaml")
    other = tmp_path / "other.yaml"
    other.write_text((tmp_path / "calibration.yaml").read_text())
    main(["compare", str(tmp_path / "calibration.yaml"), str(other), "-o", str(tmp_path / "compared")])
    main(["convert", str(tmp_path / "calibration.yaml"), "--to", "c-header", "-o", str(tmp_path / "out")])
    main(["imu", str(tmp_path / evil.replace("/", "_").replace("\0", ""))])
    terminal = Terminal(as_json=False)
    terminal.print(evil)
    terminal.progress(evil)
    said = capsys.readouterr()
    for text in (said.out, said.err):
        assert not re.search("[\x00-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e]", text)
    assert "x[/red]" in said.out or "[red]" not in evil


def test_what_is_no_command_is_left_alone():
    assert printable_text("\u00e9t\u00e9 \u6f22 m/s\u00b2\n\tx") == "\u00e9t\u00e9 \u6f22 m/s\u00b2\n\tx"
    assert printable_text("\x1b[0m\u202e") == "\\x1b[0m\\u202e"
