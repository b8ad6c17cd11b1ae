"""Calibrations of any of accelerometer, gyroscope and magnetometer, alone or together: file, show, convert."""

import ctypes
import re
import shutil
import subprocess
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import gnomon
from gnomon.cli.results import parameter_lines, summary_lines
from gnomon.errors import FormatError, OptionError
from gnomon.formats.conversion import FORMATS, export_texts
from gnomon.formats.foreign_files import load_foreign
from gnomon.formats.own.calibration_text import calibration_text
from gnomon.results.calibration import Covariance, calibration_parameters
from gnomon.writers.tables import form_tables, summary_table
from triad_subsets import FRAMES, SUBSETS, TRIADS, recorded, subset_calibration

GOLDEN = Path(__file__).parents[2] / "golden"
FORMS = ("sensitivity", "tedaldi", "krebs", "angrisano", "kalibr")
NEW = [triads for triads in SUBSETS if "accelerometer" not in triads or "magnetometer" in triads]


def minor(text):
    return re.search(r"^schema: gnomon/1(?:\.(\d+))?$", text, re.MULTILINE)[1]


@settings(max_examples=60, deadline=None)
@given(
    triads=st.sampled_from(SUBSETS),
    which=st.integers(0, 2),
    seed=st.integers(0, 2**32 - 1),
    field=st.sampled_from(["uT", "local field"]),
    units=st.tuples(
        st.sampled_from(["m/s^2", "g", "count"]),
        st.sampled_from(["rad/s", "mdeg/s", "count"]),
        st.sampled_from(["uT", "nT", "T", "gauss", "mgauss", "count"]),
    ),
)
def test_every_subset_reads_back_bit_by_bit(tmp_path_factory, triads, which, seed, field, units):
    folder = tmp_path_factory.mktemp("round")
    frames = FRAMES[triads[0]]
    frame = frames[which % len(frames)]
    saved = subset_calibration(triads, seed=seed, frame=frame, units=units, field_unit=field)
    gnomon.save(saved, folder / "a.yaml")
    read = gnomon.load(folder / "a.yaml")
    assert [name for name in TRIADS if getattr(read.imus["imu0"], name) is not None] == list(triads)
    for path, value in calibration_parameters(saved.imus):
        assert np.array_equal(read.parameter(path), value)
        assert np.array_equal(read.sigma(path), saved.sigma(path))
    assert np.array_equal(np.tril(read.uncertainty.matrix), np.tril(saved.uncertainty.matrix))
    for name, unit in zip(TRIADS, units, strict=True):
        assert name not in triads or getattr(read.imus["imu0"], name).unit == unit
    assert "magnetometer" not in triads or read.imus["imu0"].magnetometer.field_unit == field
    assert (read.frame, read.assessment.intervals_used) == (frame, 17)
    for name in ("accelerometer_rms", "rotation_rms", "rate_rms", "field_rms"):
        pair = getattr(read.assessment.holdout, name), getattr(saved.assessment.holdout, name)
        assert pair[0] == pair[1] or np.isnan(pair).all()
    gnomon.save(read, folder / "b.yaml")
    assert (folder / "a.yaml").read_bytes() == (folder / "b.yaml").read_bytes()


def test_golden_file():
    """The file as version 1.2 of the schema wrote it; it must stay readable, and be written the same way."""
    golden = GOLDEN / "calibration-gnomon-1.2.yaml"
    calibration = gnomon.load(golden)
    assert calibration_text(calibration) == golden.read_text(encoding="utf-8")
    imu = calibration.imus["imu0"]
    assert (imu.accelerometer, calibration.frame) == (None, "gyro-x")
    assert (imu.magnetometer.unit, imu.magnetometer.field_unit) == ("mgauss", "local field")
    assert calibration.parameter("imu0.magnetometer.sensitivity")[2, 1] == 17.0
    assert calibration.sigma("imu0.gyroscope.g_sensitivity")[0, 2] == pytest.approx(0.04)
    assert calibration.assessment.holdout.rate_rms == 1.1e-4
    assert calibration.assessment.holdout.field_rms == 0.0084


def test_only_what_is_new_asks_for_a_new_gnomon():
    """What version 1 could hold is written as version 1, so that an older gnomon reads it."""
    quiet = {"rate_rms": float("nan"), "field_rms": float("nan")}
    for triads in SUBSETS:
        made = subset_calibration(triads)
        assessment = replace(made.assessment, holdout=replace(made.assessment.holdout, **quiet))
        assert minor(calibration_text(replace(made, assessment=assessment))) == ("2" if triads in NEW else None)
    turntable = subset_calibration(("accelerometer", "gyroscope"))
    assert minor(calibration_text(turntable)) == "2"  # it holds a held-out rate


def test_header_explains_the_magnetometer_only_where_there_is_one():
    for triads in SUBSETS:
        header = calibration_text(subset_calibration(triads)).split("schema:")[0]
        assert ("hard iron" in header) == ("magnetometer" in triads)


def changed(text, pattern, replacement):
    new, count = re.subn(pattern, replacement, text, count=1, flags=re.MULTILINE)
    assert count == 1
    return new


@pytest.mark.parametrize(
    ("triads", "pattern", "replacement", "expected"),
    [
        (("gyroscope",), r"^schema: gnomon/1\.2", "schema: gnomon/1.1", r"imu0: the key accelerometer is missing"),
        (("magnetometer",), r"^body_frame: mag-x", "body_frame: accel-x", r"imu0: body frame accel-x is that of"),
        (("magnetometer",), r"^body_frame: mag-x", "body_frame: gyro-x", r"that of the gyroscope, and there is none"),
        (("gyroscope",), r"(        - \[[^,]*), 0\.0", r"\1, 0.7", r"gyroscope\.sensitivity: in body frame gyro-x"),
        (("magnetometer",), r"field_unit: .*", "field_unit: mT", r'field_unit: found "mT"'),
        (("magnetometer",), r"^      unit: .*", "      unit: rad/s", r'magnetometer\.unit: found "rad/s"'),
        (("magnetometer",), r"bias_sigma: \[[^,]*", "bias_sigma: [7.5", r"magnetometer\.bias_sigma: this contradicts"),
        (("magnetometer",), r"^    magnetometer:", "    magnetometr:", r"magnetometr: unknown key"),
        (("magnetometer",), r"field_rms: .*", "field_rms: much", r'field_rms: found the text "much"'),
    ],
)  # fmt: skip
def test_what_is_wrong_is_said(tmp_path, triads, pattern, replacement, expected):
    path = tmp_path / "c.yaml"
    path.write_text(changed(calibration_text(subset_calibration(triads)), pattern, replacement), encoding="utf-8")
    with pytest.raises(FormatError, match=expected):
        gnomon.load(path)


def test_an_imu_without_triads_is_refused(tmp_path):
    text = calibration_text(subset_calibration(("magnetometer",)))
    path = tmp_path / "c.yaml"
    path.write_text(re.sub(r"imus:\n(.*\n)*?cameras:", "imus:\n  imu0: {}\ncameras:", text), encoding="utf-8")
    with pytest.raises(FormatError, match=r"imu0: found no sensor, expected an accelerometer"):
        gnomon.load(path)


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("triads", SUBSETS)
def test_show_of_every_subset_in_every_form(triads, form):
    calibration = subset_calibration(triads, seed=5)
    tables = form_tables(calibration, form)
    assert [table.title.split()[1].rstrip(",") for table in tables] == list(triads)
    assert all(len(table.rows) >= 9 for table in tables)
    assert all(row.unit for table in tables for row in table.rows)
    if "accelerometer" not in triads:  # nothing can turn the frame of another triad
        assert all(table.title.endswith(calibration.frame) for table in tables)
    rows = {row.name: row.value for row in summary_table(calibration).rows}
    counted = {"accelerometer": "poses", "gyroscope": "steady parts", "magnetometer": "stretches"}[triads[0]]
    assert rows[f"{counted} used"] == "17 of 18"
    assert ("gravity" in rows) == (triads != ("magnetometer",))
    for name, label in zip(TRIADS, ("|f| - g", "|w| - rate", "|m| - field"), strict=True):
        assert (f"hold-out {label}, rms" in rows) == (name in triads)


@pytest.mark.parametrize("form", ["krebs", "angrisano", "kalibr", "tedaldi"])
def test_sigmas_of_a_gyroscope_alone_are_those_of_many_draws(form):
    """The form's sigmas against the scatter of the form of drawn sensors."""
    calibration = subset_calibration(("gyroscope",), seed=2)
    (table,) = form_tables(calibration, form)
    imu = calibration.imus["imu0"]
    rng = np.random.default_rng(0)
    start = np.concatenate([value.ravel() for _, value in calibration_parameters({"": imu})])
    from gnomon.writers.tables import _entries, entries_with_sigmas

    entries, sigmas = entries_with_sigmas(imu, calibration.uncertainty.matrix, form)
    draws = rng.multivariate_normal(start, calibration.uncertainty.matrix, size=2000, method="eigh")
    drawn = np.array([[entry.value for entry in _entries(x, imu, form)] for x in draws])
    assert len(table.rows) == len(entries)
    moving = sigmas > 0
    np.testing.assert_allclose(drawn[:, moving].std(axis=0), sigmas[moving], rtol=0.08)
    assert np.abs(drawn[:, ~moving] - drawn[0, ~moving]).max(initial=0) < 1e-9


@pytest.mark.parametrize("triads", SUBSETS)
def test_the_terminal_says_what_was_counted(triads):
    calibration = subset_calibration(triads, seed=6)
    said = "\n".join([*summary_lines(calibration), *parameter_lines(calibration)])
    assert "17 used of 18" in said
    for name in TRIADS:
        assert (f"imu0 {name} bias [" in said) == (name in triads)
    assert ("gravity" in said.split("imu0")[0]) == (triads != ("magnetometer",))
    assert max(map(len, said.splitlines())) <= 80


NEEDS = {
    "imu_tk": "accelerometer|gyroscope", "kalibr": "accelerometer", "openvins": "accelerometer",
    "basalt": "accelerometer", "imucal": "accelerometer&gyroscope", "c-header": "", "csv": "", "json": "",
    "px4": "accelerometer|gyroscope", "ardupilot": "accelerometer|gyroscope",
    **dict.fromkeys(("vins-fusion", "orb-slam3", "okvis", "ros2"), "camera"),
}  # fmt: skip


def can(to, triads):
    """Tell whether a format can hold a calibration of these triads."""
    needs = NEEDS[to]
    return (
        any(n in triads for n in needs.split("|")) if "|" in needs else all(n in triads for n in needs.split("&") if n)
    )


@pytest.mark.parametrize(("to", "triads"), list(product(FORMATS, SUBSETS)))
def test_convert_every_subset(tmp_path, to, triads):
    calibration = subset_calibration(triads, units=("m/s^2", "rad/s", "uT"))
    folder = tmp_path / "out"
    if not can(to, triads):
        with pytest.raises(OptionError, match=r"c-header or csv") as caught:
            gnomon.convert(calibration, to, folder)
        assert str(caught.value).count(". ") <= 2
        assert not folder.exists()
        return
    losses = gnomon.convert(calibration, to, folder)
    files = {path.name: path.read_text() for path in folder.iterdir()}
    assert files
    assert all(files.values())
    lost = any("magnetometer of imu0" in loss.what for loss in losses)
    assert lost == ("magnetometer" in triads and to not in {"c-header", "csv", "json"})
    assert export_texts(calibration, to).files == files


@pytest.mark.parametrize("triads", SUBSETS)
def test_csv_reads_back(tmp_path, triads):
    for field in ("uT", "local field"):
        calibration = subset_calibration(triads, units=("g", "deg/s", "uT"), field_unit=field)
        gnomon.convert(calibration, "csv", tmp_path)
        read = load_foreign(tmp_path / "calibration.csv")
        assert read.frame == calibration.frame
        for path, value in calibration_parameters(calibration.imus):
            assert np.array_equal(dict(calibration_parameters(read.imus))[path], value)
            assert np.array_equal(read.sigmas[path], calibration.sigma(path))
        if "magnetometer" in triads:
            assert read.imus["imu0"].magnetometer.field_unit == field


def test_csv_with_a_wrong_field_unit(tmp_path):
    gnomon.convert(subset_calibration(("magnetometer",)), "csv", tmp_path)
    path = tmp_path / "calibration.csv"
    path.write_text(path.read_text().replace("count/local field", "count/mT"))
    with pytest.raises(FormatError, match=r'in "count/mT", expected count/uT or count/local field'):
        load_foreign(path)


def test_imu_tk_of_a_gyroscope_alone(tmp_path):
    calibration = subset_calibration(("gyroscope", "magnetometer"), g_sensitivity=False)
    gnomon.convert(calibration, "imu_tk", tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["imu0_gyro.calib"]
    numbers = np.array((tmp_path / "imu0_gyro.calib").read_text().split("#")[0].split(), dtype=float)
    T, K, B = numbers[:9].reshape(3, 3), numbers[9:18].reshape(3, 3), numbers[18:]
    samples = recorded(("gyroscope",)).gyroscope.values
    expected = calibration.imus["imu0"].gyroscope.angular_rate(samples, np.zeros_like(samples))
    np.testing.assert_allclose((samples - B) @ (T @ K).T, expected, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("triads", SUBSETS)
def test_c_header_of_every_subset_compiles_and_agrees(tmp_path, triads):
    compiler = shutil.which("cc")
    if compiler is None:
        pytest.skip("needs a C compiler")
    calibration = subset_calibration(triads, seed=3)
    gnomon.convert(calibration, "c-header", tmp_path)
    acc, gyro, mag = (name in triads for name in TRIADS)
    arguments = [*["a"] * acc, *["g"] * gyro, *["f"] * acc, *["w"] * (gyro and acc)]
    arguments += ["f", "w"] * (gyro and not acc)
    calls = f"gnomon_imu0_apply({', '.join(arguments)});" * (acc or gyro)
    calls += "gnomon_imu0_apply_magnetometer(m, h);" * mag
    signature = "void go(const float *a, const float *g, const float *m, float *f, float *w, float *h)"
    source = tmp_path / "t.c"
    unused = "(void)a; (void)g; (void)m; (void)f; (void)w; (void)h;"
    source.write_text(f'#include "gnomon_imu.h"\n{signature};\n{signature} {{ {unused} {calls} }}\n')
    flags = ["-std=c99", "-pedantic-errors", "-Wall", "-Wextra", "-Werror", "-shared", "-fPIC"]
    subprocess.run([compiler, *flags, "-o", tmp_path / "t.so", source], check=True)
    library = ctypes.CDLL(tmp_path / "t.so")
    samples = recorded(TRIADS, count=20)
    imu = calibration.imus["imu0"]
    force = np.array([0.5, -9.0, 3.0])
    pointer = ctypes.POINTER(ctypes.c_float)
    for a, g, m in zip(*(getattr(samples, name).values for name in TRIADS), strict=True):
        inputs = [np.ascontiguousarray(values, np.float32) for values in (a, g, m)]
        outputs = [np.ascontiguousarray(force, np.float32), np.zeros(3, np.float32), np.zeros(3, np.float32)]
        library.go(*(values.ctypes.data_as(pointer) for values in (*inputs, *outputs)))
        felt = imu.accelerometer.specific_force(a[None])[0] if acc else force
        expected = [felt] if acc else []
        expected += [imu.gyroscope.angular_rate(g[None], felt[None])[0]] if gyro else []
        expected += [imu.magnetometer.magnetic_field(m[None])[0]] if mag else []
        found = [outputs[i] for i, name in enumerate(TRIADS) if name in triads]
        for one, other in zip(found, expected, strict=True):
            assert np.abs(one - other).max() <= 2e-6 * max(np.abs(other).max(), np.abs(expected[0]).max())


def test_unknown_sigmas_and_a_changed_covariance_are_kept(tmp_path):
    calibration = subset_calibration(("magnetometer",))
    matrix = calibration.uncertainty.matrix.copy()
    matrix[-1], matrix[:, -1] = np.nan, np.nan
    names = calibration.uncertainty.names
    gnomon.save(replace(calibration, uncertainty=Covariance(names=names, matrix=matrix)), tmp_path / "c.yaml")
    assert np.isnan(gnomon.load(tmp_path / "c.yaml").sigma("imu0.magnetometer.bias")[2])
