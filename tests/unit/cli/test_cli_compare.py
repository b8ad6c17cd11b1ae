"""`gnomon compare`: where calibrations are found, how they are called, what is printed, and what is refused."""

import contextlib
import hashlib
import io
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import gnomon
from gnomon.assess.comparison.comparison import block_words
from gnomon.cli import main
from gnomon.cli.commands.compare import read_comparison
from gnomon.cli.files import sources_of
from gnomon.cli.terminal import json_value
from gnomon.formats.foreign_files import load_any, source_names
from gnomon.recording import Source
from gnomon.report.comparison import compared_tables
from gnomon.report.numbers import MISSING
from gnomon.results.calibration import TRUTH_METHOD
from html_page import Page


def run(*arguments):
    """Run a command in this process: exit code, standard output, standard error."""
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = main([str(argument) for argument in arguments])
    return code, out.getvalue(), err.getvalue()


def hash_of(path):
    return hashlib.sha256(path.read_bytes()).hexdigest()


@pytest.fixture
def rig(camera_calibration, tmp_path, monkeypatch):
    """Return a folder with three results of one rig; the last has another translation of cam0."""
    monkeypatch.chdir(tmp_path)
    calibration = camera_calibration(1)
    for name, away in (("mon", 0.0), ("tue", 0.0), ("wed", 0.05)):
        T = calibration.cameras["cam0"].T_cam_imu.copy()
        T[0, 3] += away
        cameras = {**calibration.cameras, "cam0": replace(calibration.cameras["cam0"], T_cam_body=T)}
        provenance = replace(calibration.provenance, inputs=(Source(name=f"{name}.bag", sha256=name * 8),))
        (tmp_path / f"{name}-gnomon").mkdir()
        made = replace(calibration, cameras=cameras, provenance=provenance)
        gnomon.save(made, tmp_path / f"{name}-gnomon" / "calibration.yaml")
    gnomon.convert(calibration, "kalibr", tmp_path / "kalibr")
    return tmp_path


def test_agreement_in_words_and_files(rig):
    code, out, err = run("compare", "mon-gnomon", "tue-gnomon/calibration.yaml")
    assert code == 0, err
    assert out.startswith("pass: mon and tue agree: of ")
    assert "translation of cam0" in out
    assert max(map(len, out.partition("\nreport ")[0].splitlines()[1:])) < 100
    page = Page((rig / "mon-gnomon-compare" / "report.html").read_text(encoding="utf-8"))
    assert "svg" in page.tags
    assert (
        (rig / "mon-gnomon-compare" / "comparison.csv")
        .read_text()
        .startswith("calibration,path,element,value,sigma,unit")
    )
    before = {path.name: path.read_bytes() for path in (rig / "mon-gnomon-compare").iterdir()}
    assert run("compare", "mon-gnomon", "tue-gnomon")[0] == 0
    assert {path.name: path.read_bytes() for path in (rig / "mon-gnomon-compare").iterdir()} == before


def test_a_comparison_is_read_again_and_has_a_certificate(rig):
    code, out, err = run("compare", "mon-gnomon", "wed-gnomon", "kalibr", "--serial", "A-17", "--json", "-o", "out")
    assert code == 4, err
    known = read_comparison(rig / "out" / "comparison.json")
    again = json.loads(out)
    assert {key: again[key] for key in json_value(known)} == json_value(known)
    assert known.blocks[0].values.shape == (len(known.blocks[0].names), len(known.blocks[0].elements))
    hashes = {
        f"{name}-gnomon/calibration.yaml": hash_of(rig / f"{name}-gnomon" / "calibration.yaml")
        for name in ("mon", "wed")
    }
    assert {source.name: source.sha256 for source in known.provenance.inputs} == hashes
    stated, compared, blocks, criteria = compared_tables(known)
    assert stated.rows == [("Serial number", "A-17")]
    assert [row[2] for row in compared.rows] == ["stated", "stated", "not stated"]
    assert [row[0] for row in blocks.rows] == [block_words(block.path) for block in known.blocks]
    assert {block.path for block in known.blocks if not np.isfinite(block.z_rms)} == {
        block.path for block, row in zip(known.blocks, blocks.rows, strict=True) if row[4] == MISSING
    }
    assert criteria.rows[criteria.marked][0] == "fail"
    (rig / "out" / "comparison.json").write_text('{"verdict": "fine"}')
    assert run("certificate", "out")[0] == 3


def test_the_pdf_of_a_comparison(rig):
    pytest.importorskip("matplotlib")
    assert run("compare", "mon-gnomon", "wed-gnomon", "-o", "out")[0] == 4
    assert run("certificate", "out", "-o", "out.pdf")[0] == 4
    assert (rig / "out.pdf").read_bytes().startswith(b"%PDF")


def test_with_the_truth_among_them_the_figure_shows_errors(rig, monkeypatch):
    calibration = gnomon.load("mon-gnomon")
    assert calibration.uncertainty.matrix.any()
    provenance = replace(calibration.provenance, method=TRUTH_METHOD)
    gnomon.save(replace(calibration, provenance=provenance), rig / "truth.yaml")
    drawn = []

    def dots(panel, x, y, color, **_):
        drawn.append((color, np.abs(x).max(initial=0.0)))

    monkeypatch.setattr("gnomon.report.comparison.draw_dots", dots)
    for names, words, colors, errors in (
        (("truth.yaml", "tue-gnomon", "wed-gnomon"), "Deviation from the truth", {"y", "z"}, {"y"}),
        (("mon-gnomon", "tue-gnomon", "wed-gnomon"), "Deviation from the mean", {"x", "y", "z"}, set()),
    ):
        drawn.clear()
        run("compare", *names)
        html = Path(f"{names[0].removesuffix('.yaml')}-compare/report.html").read_text(encoding="utf-8")
        assert words in html
        assert (", the truth of a simulation, over" in html) == ("truth.yaml" in names)
        assert {color for color, _ in drawn} == colors
        # Two are exactly the truth: the third one's error is its own, and shifts the mean of all.
        assert {color for color in colors if all(away == 0 for c, away in drawn if c == color)} == errors


def test_the_odd_one_out_fails(rig):
    code, out, _ = run("compare", "mon-gnomon", "tue-gnomon", "wed-gnomon", "-o", "out")
    assert code == 4
    assert out.startswith("fail: mon and tue agree; wed differs in the translation of cam0 by 50 mm (")
    assert (rig / "out" / "report.html").exists()


def test_json_and_names_and_joined_files(rig):
    parts = sorted(path.name for path in (rig / "kalibr").iterdir())
    joined = "k=" + "+".join(f"kalibr/{name}" for name in parts)
    code, out, err = run("compare", "ours=mon-gnomon", joined, "--json", "--no-report")
    assert code == 0, err
    document = json.loads(out)
    assert [one["name"] for one in document["calibrations"]] == ["ours", "k"]
    assert document["calibrations"][1]["sigmas"] is False
    assert document["verdict"] == "pass"
    assert document["files"] == {}
    assert not (rig / "mon-gnomon-compare").exists()
    block = next(block for block in document["blocks"] if block["path"] == "cam0.rotation")
    assert block["names"] == ["ours", "k"]
    assert np.abs(block["values"]).max() < 1e-9
    folder = run("compare", "ours=mon-gnomon", "k=kalibr", "--json", "--no-report")
    assert json.loads(folder[1])["blocks"] == document["blocks"]


def test_renamed_sensors(rig):
    code, out, err = run("compare", "mon-gnomon", "k=kalibr", "--rename", "k.cam0=cam1", "k.cam1=cam0", "--no-report")
    assert code == 0, err
    assert out.startswith("warn: mon and k differ in")


def test_samples_in_other_units_are_shown_apart(rig, random_calibration):
    gnomon.save(random_calibration(2, units=("count", "count")), rig / "counts.yaml")
    code, out, err = run("compare", "mon-gnomon", "counts.yaml", "--no-report")
    assert code in {0, 4}, err
    line = next(line for line in out.splitlines() if line.startswith("  scale of the accelerometer"))
    assert line.split()[4] == "-"


def test_the_folders_in_a_folder_are_named(rig):
    code, _, err = run("compare", "mon-gnomon", ".")
    assert code == 3
    assert "Name one of the folders in it (kalibr, mon-gnomon, tue-gnomon, wed-gnomon)" in " ".join(err.split())


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        ((), 2, ""),
        (("mon-gnomon",), 2, "found 1 calibration, expected at least two"),
        (("mon-gnomon", "nowhere"), 3, "nowhere: there is no such file or folder"),
        (("mon-gnomon", "empty"), 3, "empty: there is no calibration file in this folder"),
        (("mon-gnomon", "noise.png"), 3, "noise.png"),
        (("mon-gnomon", "mon-gnomon/calibration.yaml+kalibr/imu.yaml"), 3, "cannot be joined with others"),
        (("mon-gnomon", "kalibr+mon-gnomon"), 3, "kalibr: this is a folder, which cannot be joined"),
        (("mon-gnomon", "gyro.csv"), 3, "is no calibration file that gnomon knows"),
        (
            ("mon-gnomon", "target.yaml"),
            2,
            "nothing in common that could be compared: mon has imu0, cam0, cam1; target",
        ),
        (("imu.yaml", "lens.yaml"), 2, "nothing in common"),
        (("mon-gnomon", "degrees.yaml"), 3, "ratio of deg/s and rad/s"),
        (("a=mon-gnomon", "a=tue-gnomon"), 2, 'two calibrations are called "a"'),
        (("mon-gnomon", "tue-gnomon", "--rename", "cam0"), 2, "expected NAME.OLD=NEW"),
        (("mon-gnomon", "tue-gnomon", "--rename", "fri.cam0=cam1"), 2, '"fri" is none of the calibrations'),
        (("mon-gnomon", "tue="), 2, "expected a path behind the name"),
    ],
)
def test_one_clear_error(rig, arguments, code, message):
    (rig / "empty").mkdir()
    (rig / "noise.png").write_bytes(np.random.default_rng(0).bytes(3000))
    (rig / "gyro.csv").write_text("t,x,y,z\n0,1,2,3\n")
    (rig / "target.yaml").write_text(
        "target_type: aprilgrid\ntagCols: 6\ntagRows: 6\ntagSize: 0.088\ntagSpacing: 0.3\n"
    )
    (rig / "lens.yaml").write_text(
        "cam0:\n  camera_model: pinhole\n  intrinsics: [460.0, 460.0, 320.0, 240.0]\n  distortion_model: radtan\n"
        "  distortion_coeffs: [0.0, 0.0, 0.0, 0.0]\n  resolution: [640, 480]\n"
    )
    gnomon.convert(gnomon.load("mon-gnomon/calibration.yaml"), "kalibr", rig / "other")
    imu = next(path for path in (rig / "other").iterdir() if "imu" in path.name and "cam" not in path.name)
    (rig / "imu.yaml").write_bytes(imu.read_bytes())
    calibration = gnomon.load("mon-gnomon/calibration.yaml")
    gyroscope = calibration.imus["imu0"].gyroscope
    scaled = replace(gyroscope, sensitivity=gyroscope.sensitivity * 180 / np.pi)
    wrong = replace(calibration, imus={"imu0": replace(calibration.imus["imu0"], gyroscope=scaled)})
    gnomon.save(wrong, rig / "degrees.yaml")
    found, out, err = run("compare", *arguments)
    assert (found, out) == (code, ""), err
    assert message in " ".join(err.split())
    assert "Traceback" not in err
    assert not (rig / "mon-gnomon-compare").exists()


def test_lenses_alone_are_compared(rig):
    lens = (
        "cam0:\n  camera_model: pinhole\n  intrinsics: [460.0, 460.0, {}, 240.0]\n  distortion_model: radtan\n"
        "  distortion_coeffs: [-0.1, 0.02, 0.0, 0.0]\n  resolution: [640, 480]\n"
    )
    (rig / "one.yaml").write_text(lens.format(320.0))
    (rig / "two.yaml").write_text(lens.format(323.0))
    code, out, err = run("compare", "one.yaml", "two.yaml", "--no-report")
    assert code == 0, err
    assert "differ by 3 px rms" in " ".join(out.split())
    assert "turn of the camera by 0.3" in " ".join(out.split())


def test_where_a_folder_holds_several(rig):
    for name in ("a-", "b-"):
        for path in list((rig / "kalibr").iterdir()):
            if not path.name.startswith(("a-", "b-")):
                (rig / "kalibr" / f"{name}{path.name}").write_bytes(path.read_bytes())
    code, _, err = run("compare", "mon-gnomon", "kalibr")
    assert code == 3, err


def test_paths_and_names():
    assert sources_of(("a=b+c", "d")) == [("a", [Path("b"), Path("c")]), ("", [Path("d")])]
    assert source_names([["x/run1-gnomon"], ["x/run2-gnomon/calibration.yaml"]]) == ["run1", "run2"]
    assert source_names([["a/kalibr/cam.yaml"], ["b/kalibr/cam.yaml"], ["ours"]]) == ["a", "b", "ours"]


def test_a_result_can_be_given_as_it_is(make_result):
    from gnomon.calibrate.comparison import compare

    result = make_result()
    assert compare(result, result.calibration).verdict == "pass"


def test_kalibrs_folder_with_its_inputs(rig, real_data):
    """Kalibr writes beside its inputs: those of its own that go together are taken."""
    folder = real_data("rendered-camimu/a-aprilgrid-full")
    for path in (folder / "kalibr" / "scale-misalignment").iterdir():
        (rig / "empty.txt").write_text("")
        (rig / path.name).write_bytes(path.read_bytes())
    for name in ("camchain.yaml", "imu.yaml", "target.yaml"):
        (rig / name).write_bytes((folder / name).read_bytes())
    found = load_any(rig)
    assert set(found.cameras) == {"cam0"}
    assert not np.allclose(found.imus["imu0"].gyroscope.sensitivity, np.eye(3))
