"""The report of a calibration from magnitudes: complete, with units, small, whatever is missing."""

import re
from dataclasses import replace
from math import isfinite

import numpy as np
import pytest

import triad_result
from gnomon.findings import Finding
from gnomon.report.certificate import parameter_groups
from gnomon.report.numbers import magnitude_text, magnitude_unit
from gnomon.report.page import write_report
from gnomon.report.static.vectors import _covered, _labels
from gnomon.results.result import Result, save_diagnostics
from gnomon.results.sensors import ImuCalibration
from html_page import Page

KINDS = list(triad_result.RESULTS)


@pytest.fixture
def page_of(tmp_path):
    def make(result):
        path = tmp_path / "report.html"
        write_report(result, path)
        return Page(path.read_text(encoding="utf-8"))

    return make


def in_order(text, words):
    place = 0
    for part in words:
        assert part in text[place:], part
        place = text.index(part, place)


WORDS = {
    "poses": (
        "Accelerometer calibration", "Warn. This calibration can be used", "Accelerometer hold-out error", "1.90 mm/s²",
        "17 of 18", "9.80665 ± 0.02 m/s²", "Give --latitude", "The numbers that matter",
        "Directions of gravity", "Error of the magnitude of specific force", "655.400 ± 0.060", "In numbers",
        "Every pose", "pose 18", "Why they were left out", "What was tried", "Angrisano's iteration", "step by step",
        "Noise", "What was assumed", "f = S⁻¹ (m − b)", "Provenance",
    ),
    "poses with gyroscope": (
        "Calibration at rest", "Gyroscope g-sensitivity", "Gyroscope at rest", "Mean rate at rest in each attitude",
        "Measured against predicted", "with g-sensitivity, rms", "0.120 count",
    ),
    "turntable": (
        "Turntable calibration", "Pass.", "Gyroscope hold-out error", "110 µrad/s", "39 of 40", "3.49510 rad/s",
        "gyro-x", "Directions of the axis of rotation", "|ω| − rate",
        "Speed of the turntable", "webcam.mp4", "1.67552 ± 0.00016", "1.67558 ± 0.00012", "+0.4 σ",
        "16.0006 ± 0.0011", "33.33rpm", "+1.4 σ", "Video webcam.mp4", "one turn, 3.75 s", "161.2 turns",
        "Models", "they cannot tell how these axes",
        "ω = S⁻¹ (y − b − G f)",
    ),
    "turntable with accelerometer": (
        "accel-x", "Directions of", "Speed of the turntable", "Directions of", "|f| − g",
    ),
    "magnetometer": (
        "Magnetometer calibration", "0.840 %", "3960 of 4000", "mag-x", "Directions of the magnetic field",
        "Magnetometer scale", "soft iron", "480.00 ± 0.90 mgauss per local field", "Magnetometer bias", "hard iron",
        "−24.6 % of the field", "|h| − field", "hard-iron", "full", "the unit of the calibrated field",
        "h = S⁻¹ (c − b)",
    ),
    "magnetometer with accelerometer": (
        "accel-x", "Alignment to the accelerometer", "Dip in each attitude", "Estimated 64.210 ± 0.080°",
    ),
}  # fmt: skip


@pytest.mark.parametrize("kind", KINDS)
def test_the_page_says_everything_in_order(page_of, kind):
    page = page_of(triad_result.RESULTS[kind]())
    in_order(page.text, WORDS[kind])
    assert page.tags.count("h1") == 1
    assert len(page.ids) == len(set(page.ids))
    assert ("they cannot tell how these axes" in page.text) == (kind in {"turntable", "magnetometer"})
    assert ("Gravity is" in page.text) == ("poses" in kind or kind == "turntable with accelerometer")


@pytest.mark.parametrize("kind", KINDS)
def test_a_page_refers_to_nothing_outside_itself_and_is_small(page_of, tmp_path, kind):
    page = page_of(triad_result.RESULTS[kind]())
    for link in page.links:
        assert link.startswith(("#", "data:"))
        assert len(link) == 1 or not link.startswith("#") or link[1:] in page.ids
    assert (tmp_path / "report.html").stat().st_size < 400_000
    first = (tmp_path / "report.html").read_bytes()
    write_report(triad_result.RESULTS[kind](), tmp_path / "again.html")
    assert first == (tmp_path / "again.html").read_bytes()


@pytest.mark.parametrize("kind", KINDS)
def test_names_are_escaped_everywhere(page_of, kind):
    name = "<script>alert(1)</script>&\"'"
    finding = Finding(severity="problem", code="x", message=name, consequence=name, cure=name)
    result = triad_result.RESULTS[kind](names=(name,), findings=(finding,))
    found = result.diagnostics
    triads = {
        key: replace(record, poses=replace(record.poses, name=(name,) * len(record.poses.name),
                                           reason=tuple("" if used else name for used in record.poses.used)))
        for key, record in found.triads.items()
    }  # fmt: skip
    rates = tuple(replace(rate, name=name) for rate in found.rates)
    videos = tuple(replace(curve, name=name) for curve in found.videos)
    page = page_of(replace(result, diagnostics=replace(found, triads=triads, rates=rates, videos=videos)))
    assert page.tags.count("script") == 1
    assert page.text.count(name) > 5


@pytest.mark.parametrize("count", [1, 2, 9, 20_000])
@pytest.mark.parametrize("kind", [k for k in KINDS if "accelerometer" not in k])
def test_any_number_of_poses(page_of, tmp_path, kind, count):
    page_of(triad_result.RESULTS[kind](count=count))
    assert (tmp_path / "report.html").stat().st_size < 1_000_000


def _blanked(value):
    """Return a frozen value with nan in all of its floating-point arrays and scalars."""
    changes = {}
    for name in value.__slots__:
        part = getattr(value, name)
        if isinstance(part, np.ndarray) and part.dtype == np.float64:
            changes[name] = np.full_like(part, np.nan)
        elif isinstance(part, float):
            changes[name] = float("nan")
        elif isinstance(part, tuple) and part and hasattr(part[0], "__slots__"):
            changes[name] = tuple(_blanked(item) for item in part)
        elif isinstance(part, dict):
            changes[name] = {k: _blanked(v) if hasattr(v, "__slots__") else float("nan") for k, v in part.items()}
        elif hasattr(part, "__slots__") and not isinstance(part, np.ndarray):
            changes[name] = _blanked(part)
    return replace(value, **changes)


@pytest.mark.parametrize("kind", KINDS)
def test_nothing_but_nan(page_of, kind):
    result = triad_result.RESULTS[kind]()
    page = page_of(replace(result, diagnostics=_blanked(result.diagnostics)))
    assert not re.search(r"\bnan\b|\binf\b", page.text)
    assert "How to use it" in page.text


@pytest.mark.parametrize("kind", KINDS)
def test_nothing_used_and_nothing_tried(page_of, kind):
    result = triad_result.RESULTS[kind]()
    found = result.diagnostics
    triads = {
        name: replace(record, history=None, poses=replace(record.poses, used=np.zeros(len(record.poses.used), bool)))
        for name, record in found.triads.items()
    }
    bare = replace(found, triads=triads, at_rest=None, rates=(), videos=(), dip=None, trials=(), noise={})
    page = page_of(replace(result, diagnostics=bare))
    for words in ("Directions", "Error of the magnitude", "What was tried", "Speed of the turntable", "Noise"):
        assert words not in page.text
    assert "What was assumed" in page.text


def test_every_number_of_a_table_has_its_unit(page_of, tmp_path):
    page_of(triad_result.RESULTS["turntable"]())
    text = (tmp_path / "report.html").read_text(encoding="utf-8")
    heads = re.findall(r'<th scope="col">([^<]*)</th>', text)
    without = {"speed", "steady parts", "change", "steady part", "reason", "which", "model", "parameters", "noise"}
    without |= {"rms", "mean size", "worst", "|ω| − rate", "|ω| − rate, held out", "value", "reads as", "file", ""}
    without |= {
        "SHA-256",
        "Parameter",
        "Estimate ± σ",
        "Reads as",
        "estimate",
        "U = 2σ",
        "unit",
        "verdict",
        "criterion",
    }
    without |= {"quantity, and its sources", "type", "amount", "divisor", "sensitivity", "u", "share"}  # in the cells
    assert [head for head in heads if "[" not in head and head not in without] == []


def test_a_parameter_table_of_any_triad():
    """Scales, soft iron and hard iron with the right sigma, in the unit of the sensor and as a person reads them."""
    calibration = triad_result.magnetometer_result().calibration
    groups = {group.title: group.rows for group in parameter_groups(calibration)}
    assert list(groups) == ["Magnetometer scale", "Magnetometer misalignment", "Magnetometer bias"]
    y = groups["Magnetometer scale"][1]
    length = np.hypot(11, 455)
    assert (y.value, y.sigma, y.unit) == (f"{length:.2f}", "0.90", "mgauss per local field")
    tilt = groups["Magnetometer misalignment"]
    assert [row.name for row in tilt if isfinite(float(row.value.replace("−", "-")))][-1] == "z towards y"
    bias = groups["Magnetometer bias"][0]
    assert (bias.value, bias.sigma, bias.unit, bias.reads_as) == (
        "−118.00",
        "0.50",
        "mgauss",
        "−24.6\u00a0% of the field",
    )
    assert bias.bar is not None
    stated = replace(triad_result.MAGNETOMETER, field_unit="uT")
    imus = {"imu0": ImuCalibration(magnetometer=stated)}
    rows = {group.title: group.rows for group in parameter_groups(replace(calibration, imus=imus))}
    assert rows["Magnetometer bias"][0].reads_as == "−0.246\u00a0µT"
    assert rows["Magnetometer scale"][0].unit == "mgauss per µT"
    # One mgauss is a tenth of a microtesla, so that a nominal scale is 10 mgauss per microtesla.
    assert rows["Magnetometer scale"][0].reads_as == "× 48"


def test_units_of_magnitudes():
    assert magnitude_unit(0.002, "m/s^2") == ("mm/s²", 1000.0)
    assert magnitude_unit(48.0, "uT") == ("µT", 1.0)
    assert magnitude_unit(0.05, "uT") == ("nT", 1000.0)
    assert magnitude_unit(0.01, "") == ("% of the field", 100.0)
    assert magnitude_text(0.00265, "rad/s") == "2.65\u00a0mrad/s"
    assert magnitude_text(0.0123, "") == "1.23\u00a0%"
    assert magnitude_text(48.25, "uT") == "48.2\u00a0µT"
    assert magnitude_text(float("nan"), "") == "–"


@pytest.mark.parametrize("seed", range(20))
def test_labels_of_directions_stand_apart(seed):
    """Labels neither cover each other nor the names of the axes, as long as there is room."""
    rng = np.random.default_rng(seed)
    flat = rng.uniform(-1, 1, (14, 2)) * np.sqrt(2) / np.sqrt(2)
    boxes = [(x, y, x + 0.054 * len(text), y + 0.075) for x, y, text in _labels(flat, np.arange(14))]
    for i, box in enumerate(boxes):
        assert _covered(box, boxes[:i]) < 0.001
        assert _covered(box, [(1.45, -0.08, 1.65, 0.08), (-0.1, 1.42, 0.1, 1.58)]) == 0


@pytest.mark.parametrize("kind", KINDS)
def test_every_field_is_in_the_diagnostics_file(tmp_path, kind):
    diagnostics = triad_result.RESULTS[kind]().diagnostics
    for name in ("a.npz", "b.npz"):
        save_diagnostics(diagnostics, tmp_path / name)
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()
    with np.load(tmp_path / "a.npz", allow_pickle=False) as arrays:
        assert str(arrays["kind"]) == diagnostics.kind
        for name, record in diagnostics.triads.items():
            np.testing.assert_array_equal(arrays[f"triads.{name}.poses.error_holdout"], record.poses.error_holdout)
            assert tuple(arrays[f"triads.{name}.poses.name"]) == record.poses.name
            assert arrays[f"triads.{name}.extra_sigma"] == record.extra_sigma
            assert (f"triads.{name}.history.q" in arrays) == (record.history is not None)
        assert [str(name) for name in arrays.get("rates.name", [])] == [rate.name for rate in diagnostics.rates]
        for i, curve in enumerate(diagnostics.videos):
            np.testing.assert_array_equal(arrays[f"videos.{i}.phase_error_turns"], curve.phase_error_turns)
        assert ("at_rest.predicted" in arrays) == (diagnostics.at_rest is not None)
        assert ("dip.dip_rad" in arrays) == (diagnostics.dip is not None)


def test_two_videos_of_different_length(tmp_path):
    result = triad_result.turntable_result()
    (curve,) = result.diagnostics.videos
    other = replace(curve, name="other.mp4", t_s=curve.t_s[:7], phase_error_turns=curve.phase_error_turns[:7])
    diagnostics = replace(result.diagnostics, videos=(curve, other))
    save_diagnostics(diagnostics, tmp_path / "d.npz")
    with np.load(tmp_path / "d.npz", allow_pickle=False) as arrays:
        assert len(arrays["videos.1.t_s"]) == 7
        assert str(arrays["videos.0.name"]) == "webcam.mp4"
    write_report(Result(calibration=result.calibration, diagnostics=diagnostics), tmp_path / "r.html")
