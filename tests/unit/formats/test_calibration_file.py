"""gnomon's own file: bit by bit, strict, whole or not at all, and readable for ever."""

import os
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import gnomon
from gnomon.cli import main
from gnomon.errors import FormatError, OutputError
from gnomon.findings import Finding
from gnomon.formats.own.calibration_text import calibration_text
from gnomon.recording import Source
from gnomon.results.calibration import Covariance, Gravity, Provenance, calibration_parameters

GOLDEN = Path(__file__).parents[2] / "golden"
AWKWARD = ["no", "1e5", "a: b", " #x", 'quo"te\\', "é\x85\u2028\n", "\U0001f600", "", "-", "null", "[1]", "\ufeff~"]


@pytest.mark.parametrize("frame", ["accel-x", "accel-z", "user"])
@pytest.mark.parametrize("gyroscope", [True, False])
def test_reads_back_bit_by_bit(random_calibration, tmp_path, frame, gyroscope):
    for seed in range(5):
        saved = random_calibration(seed, frame=frame, gyroscope=gyroscope, units=("g", "deg/s"))
        gnomon.save(saved, tmp_path / "a.yaml")
        read = gnomon.load(tmp_path / "a.yaml")
        for path, value in calibration_parameters(saved.imus):
            assert np.array_equal(read.parameter(path), value)
        assert np.array_equal(np.tril(read.uncertainty.matrix), np.tril(saved.uncertainty.matrix))
        assert read.frame == frame
        assert read.imus["imu0"].accelerometer.unit == "g"
        assert read.assessment.findings == saved.assessment.findings
        assert read.assessment.held_by_prior == saved.assessment.held_by_prior
        assert read.provenance.inputs == saved.provenance.inputs
        assert (read.provenance.options, read.provenance.seed) == (saved.provenance.options, seed)
        assert vars_of(read.gravity) == vars_of(saved.gravity)
        assert np.isnan(read.assessment.holdout.rotation_rms) != gyroscope
        gnomon.save(read, tmp_path / "b.yaml")
        assert (tmp_path / "a.yaml").read_bytes() == (tmp_path / "b.yaml").read_bytes()


def vars_of(gravity: Gravity):
    return gravity.value, gravity.sigma, gravity.source


def test_awkward_texts_survive(random_calibration, tmp_path):
    calibration = replace(
        random_calibration(),
        gravity=Gravity(value=np.float64(9.81), sigma=1e-5, source=AWKWARD[5]),
        provenance=Provenance(
            gnomon_version="1.10",
            method="yes",
            inputs=tuple(Source(name=text, sha256=text) for text in AWKWARD),
            options={f"{text}.k": text for text in AWKWARD},
        ),
        assessment=replace(
            random_calibration().assessment,
            findings=tuple(Finding(severity="info", code=text, message=text, cure=text) for text in AWKWARD),
        ),
    )
    gnomon.save(calibration, tmp_path / "c.yaml")
    read = gnomon.load(tmp_path / "c.yaml")
    assert read.provenance.inputs == calibration.provenance.inputs
    assert dict(read.provenance.options) == dict(calibration.provenance.options)
    assert read.assessment.findings == calibration.assessment.findings
    assert vars_of(read.gravity) == vars_of(calibration.gravity)


def test_undecodable_file_name_can_be_saved(random_calibration, tmp_path):
    source = Source(name=os.fsdecode(b"rec\xff.csv"), sha256="0")
    calibration = replace(
        random_calibration(), provenance=Provenance(gnomon_version="1", method="imu", inputs=(source,))
    )
    gnomon.save(calibration, tmp_path / "c.yaml")
    assert gnomon.load(tmp_path / "c.yaml").provenance.inputs[0].name == "rec\N{REPLACEMENT CHARACTER}.csv"


def test_golden_file():
    """The file as version 1.0 of the schema wrote it; it must stay readable, and be written the same way."""
    golden = GOLDEN / "calibration-gnomon-1.yaml"
    calibration = gnomon.load(golden)
    assert calibration_text(calibration) == golden.read_text(encoding="utf-8")
    assert calibration.parameter("imu0.gyroscope.sensitivity")[1, 2] == 207.0
    assert calibration.sigma("imu0.accelerometer.bias")[0] == pytest.approx(0.2)
    assert calibration.provenance.inputs[1].name == "xsens_gyro.mat.gz"
    assert calibration.verdict == "warn"


def test_comments_state_model_units_and_frame(random_calibration):
    header = calibration_text(random_calibration()).split("schema:")[0]
    for words in ("sensitivity * f + bias", "m/s^2", "rad/s", "x along the sensitivity axis of the x accelerometer"):
        assert words in header


def changed(text, pattern, replacement):
    new, count = re.subn(pattern, replacement, text, count=1, flags=re.MULTILINE)
    assert count == 1
    return new


@pytest.mark.parametrize(
    ("pattern", "replacement", "expected"),
    [
        (r"^      bias:", "      bais:", r"imus\.imu0\.accelerometer\.bais: unknown key\. Did you mean bias\?"),
        (r"^verdict: pass\n", "", r"the key verdict is missing"),
        (r"^verdict: pass", "verdict: warn", r"verdict: .*contradicts assessment\.verdict"),
        (r"^body_frame: .*", "body_frame: accel_x", r'body_frame: found "accel_x"\. Did you mean accel-x\?'),
        (r"^body_frame: .*", "body_frame: accel-z", r"imu0\.accelerometer\.sensitivity: .*upper triangular"),
        (r"bias: \[[^,]*, ", "bias: [", r"accelerometer\.bias: found 2 numbers, expected 3"),
        (r"bias: \[[^,]*", "bias: [twelve", r'bias\[0\]: found the text "twelve", expected a number'),
        (r"bias: \[[^,]*", "bias: [.nan", r"bias\[0\]: found nan, expected a finite number"),
        (r"bias: \[.*", "bias: 3", r"bias: found 3, expected a list"),
        (r"unit: count", "unit: counts", r'accelerometer\.unit: found "counts"\. Did you mean count\?'),
        (r"intervals_used: 38", "intervals_used: 38.5", r"intervals_used: found 38\.5, expected a whole number"),
        (r"^schema: gnomon/1$", "schema: gnomon/1.99", r"schema: found gnomon/1\.99, .*update gnomon"),
        (r"^schema: gnomon/1$", "schema: gnomon/2", r"schema: found gnomon/2, .*update gnomon"),
        (r"^schema: gnomon/1$", "schema: other/1", r'found "other/1", expected gnomon/1'),
        (r"^schema: gnomon/1\n", "", r"this is no gnomon calibration"),
        (r"^cameras: {}", "cameras: {cam0: {}}", r"cameras\.cam0: unknown key"),
        (r"severity: warning", "severity: bad", r"assessment\.findings\[0\]\.severity"),
        (r"bias_sigma: \[[^,]*", "bias_sigma: [1.5", r"accelerometer\.bias_sigma: this contradicts the covariance"),
        (r'"imu0\.accelerometer\.bias\[0\]"', '"imu0.x"', r"covariance\.names: entry 9 is imu0\.x"),
        (r"lower_triangle:\n.*\n", "lower_triangle:\n", r"lower_triangle: found 32 rows, expected 33"),
        (r"^verdict: pass", "verdict: pass\nverdict: pass", r"line \d+: the key verdict stands here twice"),
        (r"^verdict: pass", "verdict: [pass", r"line \d+: this is not YAML"),
    ],
)
def test_what_is_wrong_is_said(random_calibration, tmp_path, pattern, replacement, expected):
    path = tmp_path / "c.yaml"
    path.write_text(changed(calibration_text(random_calibration()), pattern, replacement), encoding="utf-8")
    with pytest.raises(FormatError, match=expected) as caught:
        gnomon.load(path)
    assert str(path) in str(caught.value)


def test_singular_sensitivity_is_refused(random_calibration, tmp_path):
    text = calibration_text(random_calibration(frame="user"))
    path = tmp_path / "c.yaml"
    path.write_text(changed(text, r"(sensitivity:\n)(        - .*\n).*\n", r"\1\2\2"), encoding="utf-8")
    with pytest.raises(FormatError, match="singular"):
        gnomon.load(path)


@pytest.mark.parametrize("content", [b"", b"\xff\xfe\x00", b"just text", b"- 1\n- 2\n", b"\x00\x01"])
def test_other_files_are_refused(tmp_path, content):
    (tmp_path / "c.yaml").write_bytes(content)
    with pytest.raises(FormatError, match=r"c\.yaml"):
        gnomon.load(tmp_path / "c.yaml")


def test_missing_file_and_folder(tmp_path):
    with pytest.raises(FormatError, match="there is no such file"):
        gnomon.load(tmp_path / "none.yaml")
    with pytest.raises(FormatError, match="this is a folder"):
        gnomon.load(tmp_path)


def test_numbers_as_people_write_them(random_calibration, tmp_path):
    """YAML 1.1 takes 1e-5 for text; people do not."""
    path = tmp_path / "c.yaml"
    path.write_text(changed(calibration_text(random_calibration()), r"bias: \[[^,]*", "bias: [1e-5"), encoding="utf-8")
    assert gnomon.load(path).parameter("imu0.accelerometer.bias")[0] == 1e-5


def test_nothing_half_written(random_calibration, tmp_path, monkeypatch):
    path = tmp_path / "c.yaml"
    path.write_text("old")
    monkeypatch.setattr(Path, "replace", lambda *_: (_ for _ in ()).throw(OSError(28, "No space left on device")))
    with pytest.raises(OutputError, match="No space left"):
        gnomon.save(random_calibration(), path)
    assert path.read_text() == "old"
    assert [path.name for path in tmp_path.iterdir()] == ["c.yaml"]


def test_where_nothing_can_be_written(random_calibration, tmp_path):
    with pytest.raises(OutputError, match="cannot be written"):
        gnomon.save(random_calibration(), tmp_path / "none" / "c.yaml")
    with pytest.raises(OutputError, match="folder"):
        gnomon.save(random_calibration(), tmp_path)


def test_only_this_file_is_touched(random_calibration, tmp_path):
    (tmp_path / "other.txt").write_text("mine")
    (tmp_path / "linked.yaml").write_text("old")
    (tmp_path / "link.yaml").symlink_to("linked.yaml")
    gnomon.save(random_calibration(), tmp_path / "link.yaml")
    assert (tmp_path / "link.yaml").is_symlink()
    assert gnomon.load(tmp_path / "linked.yaml").verdict == "pass"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["link.yaml", "linked.yaml", "other.txt"]


def test_useless_numbers_are_not_saved(random_calibration, tmp_path):
    calibration = random_calibration()
    broken = replace(calibration.imus["imu0"].accelerometer, bias=np.array([0, np.nan, 0]))
    imus = {"imu0": replace(calibration.imus["imu0"], accelerometer=broken)}
    with pytest.raises(OutputError, match=r"imu0\.accelerometer\.bias is not a finite number"):
        gnomon.save(replace(calibration, imus=imus), tmp_path / "c.yaml")


def test_unknown_variances_survive(random_calibration, tmp_path):
    calibration = random_calibration()
    matrix = calibration.uncertainty.matrix.copy()
    matrix[-1, :] = matrix[:, -1] = np.nan
    calibration = replace(calibration, uncertainty=Covariance(names=calibration.uncertainty.names, matrix=matrix))
    gnomon.save(calibration, tmp_path / "c.yaml")
    assert np.array_equal(gnomon.load(tmp_path / "c.yaml").uncertainty.matrix, matrix, equal_nan=True)


@pytest.mark.parametrize(
    ("edit", "said"),
    [
        (lambda m, k: m.__setitem__((k[2], k[2]), np.inf), r"the covariance of imu0\..* is inf"),
        (lambda m, k: m.__setitem__((k[2], k[1]), np.nan), "is nan"),
        (lambda m, k: m.__setitem__((k[2], k[2]), -1e-9), "is below zero"),
        (lambda m, k: m.__setitem__((k[2], k[1]), 3 * np.sqrt(m[k[1], k[1]] * m[k[2], k[2]])), "than their variances"),
        (lambda m, k: m.__setitem__((k[2], k[2]), 0.0), "larger than their variances allow"),
        (lambda m, k: m.__setitem__((k[2], k), [-1e3, 0.0, 0.0]), "larger than their variances allow"),
        (lambda m, k: m.__setitem__(np.ix_(k, k), unlike(np.sqrt(np.diag(m)[k]))), "not positive semi-definite"),
    ],
)
def test_what_is_no_covariance_is_refused(edit, said, random_calibration, tmp_path, capsys):
    """Each pair of the last one is possible alone: a is like b, b like c, and a unlike c."""
    calibration = random_calibration()
    matrix = calibration.uncertainty.matrix.copy()
    known = np.flatnonzero(np.diag(matrix) > 0)[:3]
    matrix[known[2], known[0]] = 0.1 * np.sqrt(matrix[known[0], known[0]] * matrix[known[2], known[2]])
    edit(matrix, known)
    lower = np.tril(matrix)
    matrix = lower + np.tril(lower, -1).T
    calibration = replace(calibration, uncertainty=Covariance(names=calibration.uncertainty.names, matrix=matrix))
    with np.errstate(invalid="ignore"):
        gnomon.save(calibration, tmp_path / "c.yaml")
    with pytest.raises(FormatError, match=said):
        gnomon.load(tmp_path / "c.yaml")
    for words in (["show"], ["convert", "--to", "json", "-o", str(tmp_path / "out")]):
        assert main([*words[:1], str(tmp_path / "c.yaml"), *words[1:]]) == 3
        assert "Traceback" not in capsys.readouterr().err


def unlike(sigma):
    return np.outer(sigma, sigma) * np.array([[1, 0.9, -0.9], [0.9, 1, 0.9], [-0.9, 0.9, 1]])


def test_the_folder_of_a_result_stands_for_its_calibration(random_calibration, tmp_path):
    gnomon.save(random_calibration(1), tmp_path / "calibration.yaml")
    assert gnomon.load(tmp_path).imus.keys() == {"imu0"}
    with pytest.raises(FormatError, match="this is a folder"):
        gnomon.load(tmp_path.parent)


def test_findings_keep_their_subject_and_cause(random_calibration, tmp_path):
    calibration = random_calibration()
    cause = Finding(severity="warning", code="rolling-shutter", message="m", subject="cam0.line_delay")
    effect = replace(cause, code="reprojection", subject="", consequence="It follows from: rolling-shutter.")
    told = (cause, replace(effect, follows_from="rolling-shutter"))
    assessment = replace(calibration.assessment, findings=told)
    gnomon.save(replace(calibration, assessment=assessment), tmp_path / "c.yaml")
    assert gnomon.load(tmp_path / "c.yaml").assessment.findings == told
    older = (tmp_path / "c.yaml").read_text(encoding="utf-8")
    for key in ("subject: cam0.line_delay", "follows_from: rolling-shutter"):
        assert key in older
        older = "\n".join(line for line in older.split("\n") if key not in line)
    (tmp_path / "older.yaml").write_text(older, encoding="utf-8")
    assert gnomon.load(tmp_path / "older.yaml").assessment.findings[1].follows_from == "rolling-shutter"


@pytest.mark.parametrize("sigma", ["-1.0", "inf", "1e308"])
def test_what_is_no_standard_deviation_in_a_table_is_refused(sigma, random_calibration, tmp_path, capsys):
    gnomon.save(random_calibration(), tmp_path / "c.yaml")
    assert main(["convert", str(tmp_path / "c.yaml"), "--to", "csv", "-o", str(tmp_path)]) == 0
    path = tmp_path / "calibration.csv"
    lines = path.read_text(encoding="utf-8").splitlines()
    row = next(k for k, line in enumerate(lines) if line.startswith('"imu0.'))
    lines[row] = ",".join([*lines[row].rsplit(",", 2)[:1], sigma, "1"])
    path.write_text("\n".join(lines), encoding="utf-8")
    capsys.readouterr()
    assert main(["show", str(path)]) == 3
    assert f"line {row + 1}: {sigma} is no standard deviation" in capsys.readouterr().err
