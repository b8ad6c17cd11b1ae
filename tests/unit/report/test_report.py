"""The report: complete, escaped, small, the same bytes every time, whatever is missing."""

import re
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from gnomon.errors import OutputError
from gnomon.findings import Finding
from gnomon.report.certificate import parameter_groups
from gnomon.report.drawing.figures import Sheet, coarsen_envelope, draw_dots, thin_points
from gnomon.report.numbers import fixed_text, number_text, quantity_text, si_prefix, with_sigma
from gnomon.report.page import write_report
from gnomon.results.result import Result
from gnomon.results.sensor_diagnostics import DetectorTrace
from html_page import Page


@pytest.fixture
def page_of(tmp_path):
    def make(result):
        path = tmp_path / "report.html"
        write_report(result, path)
        return Page(path.read_text(encoding="utf-8"))

    return make


def with_diagnostics(result, **changes):
    return replace(result, diagnostics=replace(result.diagnostics, **changes))


def test_report_says_the_verdict_first_and_everything_once(make_result, page_of):
    page = page_of(make_result())
    text = page.text
    order = [
        "Warn. This calibration can be used", "Give --latitude", "The numbers that matter", "Directions of gravity",
        "Error of the magnitude", "Gravity carried along", "414.870 ± 0.030",
        "Signals and static detector", "Gyroscope at rest", "Threshold of the static detector", "Models", "Noise",
        "What was assumed",
        "gnomon apply calibration.yaml", "Provenance", "window_s = 1.0",
    ]  # fmt: skip
    place = 0
    for words in order:
        assert words in text[place:], words
        place = text.index(words, place)
    assert "1.46 mm/s²" in text
    assert "2.65 mrad" in text
    assert "36 of 38" in text
    assert page.tags.count("h1") == 1


def test_page_refers_to_nothing_outside_itself(make_result, page_of):
    page = page_of(make_result())
    assert len(page.ids) == len(set(page.ids))
    for link in page.links:
        assert link.startswith(("#", "data:"))
        if len(link) > 1 and link.startswith("#"):
            assert link[1:] in page.ids


def test_no_file_or_network_is_named_in_style_and_script(make_result, tmp_path):
    write_report(make_result(), tmp_path / "r.html")
    text = (tmp_path / "r.html").read_text(encoding="utf-8")
    assert set(re.findall(r"https?://[^\s\"']+", text)) <= {"http://www.w3.org/1999/xlink"}
    assert "@import" not in text
    assert all(target.startswith("#") for target in re.findall(r"url\(([^)]*)\)", text))
    assert "#c0de" not in text


def test_same_result_gives_same_bytes_in_another_process(make_result, tmp_path):
    result = make_result()
    write_report(result, tmp_path / "a.html")
    write_report(result, tmp_path / "b.html")
    assert (tmp_path / "a.html").read_bytes() == (tmp_path / "b.html").read_bytes()
    assert not re.search(rb"20\d\d-\d\d-\d\d", (tmp_path / "a.html").read_bytes())


@pytest.mark.parametrize(
    "name", ["<script>alert(1)</script>&\"'", "</style><img src=x onerror=alert(1)>", "{{ 7 * 7 }}", "ünï\udcff.csv"]
)
def test_names_are_escaped_everywhere(make_result, page_of, name):
    finding = Finding(severity="problem", code="x", message=name, consequence=name, cure=name)
    result = make_result(names=(name,), unit=name, findings=(finding,))
    intervals = replace(result.diagnostics.intervals, reason=(name,) * 38)
    page = page_of(with_diagnostics(result, intervals=intervals, noise={f"accelerometer.{name}": 1.0}))
    assert page.tags.count("script") == 1
    assert page.tags.count("style") == 1
    assert "img" not in page.tags
    shown = name.encode("utf-8", "backslashreplace").decode()
    # Title, subject, axis label, finding (three), reasons (two left out), noise, files and more.
    assert page.text.count(shown) > 9
    assert f"Accelerometer [{shown}]" in page.text


@pytest.mark.parametrize("count", [1, 2, 9, 3000])
def test_any_number_of_intervals(make_result, page_of, tmp_path, count):
    page_of(make_result(count=count, left_out=1 if count > 1 else 0, bins=20_000 if count > 100 else 50))
    assert (tmp_path / "report.html").stat().st_size < 2_000_000


def test_usual_report_is_small(make_result, tmp_path):
    write_report(make_result(), tmp_path / "r.html")
    assert (tmp_path / "r.html").stat().st_size < 400_000


def test_no_gyroscope(make_result, page_of):
    page = page_of(make_result(gyroscope=False))
    assert "Gyroscope bias" not in page.text
    assert "Gyroscope at rest" not in page.text
    assert "Gyroscope [count]" not in page.text
    assert "ω" not in page.text.replace("angular rate ω", "")


def _blanked(value):
    """Return a frozen value with nan in all of its floating-point arrays and scalars."""
    changes = {}
    for name in value.__slots__:
        part = getattr(value, name)
        if isinstance(part, np.ndarray) and part.dtype == np.float64:
            changes[name] = np.full_like(part, np.nan)
        elif isinstance(part, float):
            changes[name] = float("nan")
    return replace(value, **changes)


def test_nothing_but_nan(make_result, page_of):
    result = make_result()
    diagnostics = result.diagnostics
    parts = ("accelerometer", "gyroscope", "detector", "intervals", "rotations", "allan")
    blank = {name: _blanked(getattr(diagnostics, name)) for name in parts}
    blank["trials"] = tuple(_blanked(trial) for trial in diagnostics.trials)
    blank["noise"] = {"gyroscope.density": float("nan")}
    calibration = result.calibration
    nothing = np.full_like(calibration.uncertainty.matrix, np.nan)
    calibration = replace(
        calibration,
        uncertainty=replace(calibration.uncertainty, matrix=nothing),
        assessment=replace(calibration.assessment, holdout=_blanked(calibration.assessment.holdout)),
        gravity=replace(calibration.gravity, sigma=float("nan")),
    )
    page = page_of(Result(calibration=calibration, diagnostics=replace(diagnostics, **blank)))
    assert not re.search(r"\bnan\b", page.text)
    assert not re.search(r"\bnan\b", " ".join(page.links))


def test_nothing_used_and_nothing_tried(make_result, page_of):
    result = make_result()
    diagnostics = result.diagnostics
    none = np.zeros(38, dtype=bool)
    empty = DetectorTrace(t_s=np.empty(0), statistic=np.empty(0), multiplier=float("nan"), candidates=np.empty((0, 4)))
    page = page_of(
        with_diagnostics(
            result,
            intervals=replace(diagnostics.intervals, used=none, reason=("too short",) * 38),
            rotations=replace(diagnostics.rotations, used=none[:-1], reason=("",) * 37),
            detector=empty,
            allan=None,
            trials=(),
            noise={},
        )
    )
    assert page.text.count("too short") == 38


def test_values_that_are_far_off_stay_inside_their_figures(make_result, page_of):
    result = make_result()
    intervals = result.diagnostics.intervals
    wild = intervals.error_before.copy()
    wild[3], wild[4] = 1e9, np.inf
    page_of(with_diagnostics(result, intervals=replace(intervals, error_before=wild)))


def test_a_user_defined_frame_and_parameters_held(make_result, page_of):
    result = make_result()
    assessment = replace(result.calibration.assessment, held_by_prior=("imu0.gyroscope.bias[2]",))
    page = page_of(replace(result, calibration=replace(result.calibration, frame="user", assessment=assessment)))
    assert page.text.count("not determined by this recording") == 1
    assert "axes of your own" in page.text


def test_table_shows_scales_and_angles_with_the_right_sigma(make_result):
    """Sigmas of derived values against differences of a random perturbation."""
    calibration = make_result().calibration
    groups = {group.title: group for group in parameter_groups(calibration)}
    scale = groups["Gyroscope scale"].rows[0]
    matrix = calibration.imus["imu0"].gyroscope.sensitivity
    assert float(scale.value) == pytest.approx(np.linalg.norm(matrix[0]), abs=0.05)
    assert float(scale.sigma) == pytest.approx(1.3, abs=0.05)
    tilt = next(row for row in groups["Gyroscope misalignment"].rows if row.name == "y towards z")
    rng = np.random.default_rng(1)
    rows = matrix[1] + rng.normal(0, 1.3, (4000, 3))
    samples = 1e3 * rows[:, 2] / np.linalg.norm(rows, axis=1)
    assert float(tilt.value) == pytest.approx(samples.mean(), abs=0.03)
    assert float(tilt.sigma) == pytest.approx(samples.std(), rel=0.05)
    matrices = matrix + rng.normal(0, 1.3, (4000, 3, 3))
    lengths = np.linalg.norm(matrices, axis=2)
    deviation = 100 * (lengths[:, 0] / lengths.mean(axis=1) - 1)
    value, sigma = map(float, scale.reads_as.replace("−", "-").removesuffix("\u00a0%").split(" ± "))
    assert value == pytest.approx(deviation.mean(), abs=0.002)
    assert sigma == pytest.approx(deviation.std(), rel=0.06)
    names = [row.name for row in groups["Accelerometer misalignment"].rows]
    assert names == ["y towards x", "z towards x", "z towards y"]  # the other three define the frame
    for row in groups["Gyroscope scale"].rows:
        assert 0 <= row.bar.low <= row.bar.value <= row.bar.high <= 100


@pytest.mark.parametrize(("unit", "scale"), [("m/s^2", 1.0), ("g", 1 / 9.80665)])
def test_nominal_scale_of_known_units(make_result, unit, scale):
    calibration = make_result().calibration
    imu = calibration.imus["imu0"]
    accelerometer = replace(imu.accelerometer, sensitivity=1.01 * scale * np.eye(3), unit=unit)
    changed = replace(calibration, imus={"imu0": replace(imu, accelerometer=accelerometer)})
    group = parameter_groups(changed)[0]
    assert group.note == "deviation from nominal"
    assert all(row.reads_as.startswith("+1") for row in group.rows)


def test_failed_writing_leaves_nothing(make_result, tmp_path):
    target = tmp_path / "folder"
    target.mkdir()
    with pytest.raises(OutputError, match="this is a folder"):
        write_report(make_result(), target)
    with pytest.raises(OutputError, match="nowhere"):
        write_report(make_result(), tmp_path / "nowhere" / "report.html")
    assert [path.name for path in tmp_path.iterdir()] == ["folder"]


def test_importing_the_room_is_light():
    code = (
        "import sys, gnomon.report; "
        "heavy = {'matplotlib', 'jinja2', 'scipy'} & set(sys.modules); sys.exit(str(heavy) if heavy else 0)"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.0, "0"), (-1234.5678, "−1235"), (1e-9, "10⁻⁹"), (-3.2e8, "−3.2·10⁸"), (float("inf"), "–"), (100.0, "100")],
)
def test_number(value, text):
    assert number_text(value) == text


def test_numbers_with_units_and_sigma():
    assert quantity_text(0.0014, "m/s²") == "1.40\u00a0mm/s²"
    assert quantity_text(0.0, "rad") == "0\u00a0rad"
    assert quantity_text(float("nan"), "rad") == "–"
    assert si_prefix(3e-10) == ("n", 1e9)
    assert fixed_text(1.005, 1, sign=True) == "+1.0"
    assert with_sigma(1.0, 0.0) == ("1", "")
    assert with_sigma(float("nan"), 1.0) == ("–", "")
    assert with_sigma(12345.678, 25.0) == ("12346", "25")
    assert with_sigma(0.0, 0.0) == ("0", "")
    assert with_sigma(5.0, float("nan")) == ("5", "")


def test_coarser_keeps_extremes_and_gaps():
    rng = np.random.default_rng(3)
    low = rng.normal(size=(10_000, 3))
    low[2000:3000] = np.nan
    t, coarse_low, coarse_high = coarsen_envelope(np.arange(10_000.0), low, low + 1, bins=100)
    assert len(t) == 100
    assert np.nanmin(coarse_low) == np.nanmin(low)
    assert np.nanmax(coarse_high) == np.nanmax(low + 1)
    assert np.isnan(coarse_low[20:30]).all()
    assert np.isfinite(coarse_low[[19, 30]]).all()


def test_thinned_keeps_extremes():
    rng = np.random.default_rng(4)
    y = rng.normal(size=5000)
    y[17] = np.nan
    x, kept = thin_points(np.arange(5000.0), y, bins=100)
    assert len(x) <= 200
    assert kept.min() == np.nanmin(y)
    assert kept.max() == np.nanmax(y)


def test_drawing_keeps_every_dot_and_its_own_ids():
    sheet = Sheet()
    axes = sheet.panel("<b>", top=30, height=100)
    draw_dots(axes, np.arange(5.0), np.array([1.0, 2.0, np.nan, 4.0, 5.0]), "x", ring=True)
    svg = sheet.draw("name", 200, 'a "quoted" <alt>').svg
    paths = re.findall(r'class="dots"><path d="([^"]*)"', svg)
    assert [path.count("M") for path in paths] == [4, 4]
    assert "&lt;b&gt;" in svg
    assert 'aria-label="a &#34;quoted&#34; &lt;alt&gt;"' in svg
    assert all(name.startswith("name-") for name in re.findall(r' id="([^"]*)"', svg))
