"""Page one: what was stated, U = 2 sigma, and the PDF of a stored result."""

import re
import sys
from dataclasses import replace

import numpy as np
import pytest

from camera_imu_result import make_camera_imu_result
from gnomon import save_noise
from gnomon.assess.uncertainty_budget import gravity_part, uncertainty_budget
from gnomon.cli import main
from gnomon.cli.command import CertificateFacts
from gnomon.cli.results import result_with_reading
from gnomon.errors import OptionError
from gnomon.report.certificate import budget_table, certificate_tables
from gnomon.report.certificate_pdf import page_one, write_certificate
from gnomon.report.page import parameter_line, write_report
from gnomon.results.calibration import Covariance, Provenance
from gnomon.results.sensor_noise import AxisNoise, Coefficient, SensorNoise, TriadNoise
from gnomon.results.temperature_dependence import TemperatureDependence
from html_page import Page

FACTS = CertificateFacts(sensor="BMI270 <3>", serial="A-17", date="2026-03-31", temperature_c=21.5)

SUPERSCRIPTS = str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹−", "-0123456789-")


@pytest.fixture
def stated(make_result):
    return result_with_reading(make_result(), FACTS.stated)


def test_what_was_stated_stands_on_page_one_and_sections_are_folded(stated, tmp_path):
    write_report(stated, tmp_path / "report.html")
    html = (tmp_path / "report.html").read_text(encoding="utf-8")
    front = Page(html).text.split("Signals and static detector")[0]
    for words in ("BMI270 <3>", "A-17", "2026-03-31", "21.5 °C", "U = 2σ", "Accelerometer bias x"):
        assert words in front.replace("\u00a0", " "), words
    assert "Operator" not in front
    one = html.split('class="folded"')[0]
    assert one.count("<figure>") == 3
    assert "<details open" not in html
    assert html.count('class="folded"') == html.count("<details>") - one.count("<details>")


def test_the_expanded_uncertainty_is_twice_sigma():
    row = parameter_line("bias x", 0.0822, 0.00011, "m/s²")
    assert (row.sigma, row.expanded) == ("0.00011", "0.00022")
    assert parameter_line("fixed", 1.0, 0.0, "").expanded == ""


def test_the_marked_criterion_is_the_verdict(make_result):
    for k, verdict in enumerate(("pass", "warn", "fail")):
        table = certificate_tables(make_result(verdict=verdict).calibration)[-1]
        assert table.rows[table.marked][0] == verdict
        assert table.marked == k


def test_what_changes_with_the_temperature_stands_on_page_one(make_result):
    calibration = make_result().calibration
    slopes = np.array([[1e-4, -2e-4, 3e-4], [1e-6, 1e-6, 1e-6]])
    known = TemperatureDependence(reference_degc=21.0, low_degc=-2.0, high_degc=44.0, gyroscope_bias=slopes)
    table = certificate_tables(calibration.with_temperature("imu0", known, {"gyroscope_bias": 1e-12 * np.eye(6)}))[-2]
    assert [row[0] for row in table.rows] == [f"Gyroscope bias {axis}" for axis in "xyz"]
    assert all("/K" in row[3] for row in table.rows)
    assert [float(row[1].replace("·10", "e").translate(SUPERSCRIPTS)) for row in table.rows] == pytest.approx(slopes[0])
    assert "21.0 °C" in table.caption


def test_the_budget_adds_up_and_tells_gravity_from_the_recording(make_result):
    calibration = make_result().calibration
    names = calibration.uncertainty.names
    matrix = 1e-6 * np.eye(len(names)) + gravity_part(calibration)
    ratios = {"imu0.accelerometer.sensitivity": 2.0, "imu0.gyroscope.bias": 0.9}
    trust = replace(calibration.assessment.trust, covariance="cluster-robust", sigma_ratio=ratios)
    calibration = replace(
        calibration,
        uncertainty=Covariance(names=names, matrix=matrix),
        assessment=replace(calibration.assessment, trust=trust, held_by_prior=("imu0.accelerometer.bias",)),
    )
    budgets = {budget.name.partition("[")[0]: budget for budget in uncertainty_budget(calibration)}
    for budget in budgets.values():
        assert sum(source.variance for source in budget.sources) == pytest.approx(budget.sigma**2, rel=1e-9)
        for source in budget.sources:
            standard = abs(source.sensitivity) * source.amount / source.divisor
            assert standard**2 == pytest.approx(source.variance, rel=1e-9)
    scale = budgets["imu0.accelerometer.sensitivity"]
    assert [(source.name, source.kind) for source in scale.sources] == [
        ("gravity", "B"), ("errors that last", "A"), ("independent noise", "A"),
    ]  # fmt: skip
    assert [source.variance for source in scale.sources[1:]] == pytest.approx([0.75e-6, 0.25e-6], rel=1e-3)
    assert [source.kind for source in budgets["imu0.accelerometer.bias"].sources] == ["B"]
    assert [source.name for source in budgets["imu0.gyroscope.bias"].sources] == ["independent noise"]
    rotating = budgets["imu0.gyroscope.g_sensitivity"].sources
    assert {source.distribution for source in rotating if source.name == "rate of the earth"} <= {"rectangular"}
    rows = budget_table(calibration).rows
    assert len(rows) == sum(1 + len(budget.sources) for budget in budgets.values())


def test_the_budget_of_a_rig_says_what_it_does_not_tell_apart():
    calibration = make_camera_imu_result().calibration
    for budget in uncertainty_budget(calibration):
        assert sum(source.variance for source in budget.sources) == pytest.approx(budget.sigma**2, rel=1e-9)
        assert {(source.name, source.kind) for source in budget.sources} <= {
            ("noise, gravity, detector", "A, B"), ("errors that last", "A"), ("prior, not determined here", "B"),
        }  # fmt: skip


@pytest.mark.parametrize("facts", [{"date": "31.3.2026"}, {"date": "2026-02-30"}, {"temperature_c": float("nan")}])
def test_facts_that_cannot_be_are_refused(facts):
    with pytest.raises(OptionError, match=r"no date|no temperature"):
        CertificateFacts(**facts)


def test_the_pdf_has_two_pages_and_the_same_bytes_again(stated, tmp_path):
    pytest.importorskip("matplotlib")
    for name in ("a.pdf", "b.pdf"):
        write_certificate(stated.calibration, tmp_path / name)
    content = (tmp_path / "a.pdf").read_bytes()
    assert content == (tmp_path / "b.pdf").read_bytes()
    assert len(re.findall(rb"/Type /Page\b", content)) == 2
    assert b"CreationDate" not in content


def test_noise_has_a_certificate_too(tmp_path):
    pytest.importorskip("matplotlib")
    found = [Coefficient(value=value, sigma=0.01 * value) for value in (2e-3, 2.5e-3, 3e-3)]
    none = Coefficient(value=0.0, bound=4e-5)
    axes = tuple(
        AxisNoise(white_noise=one, bias_instability=none, random_walk=none, quantisation=none, rate_ramp=none)
        for one in found
    )
    triad = TriadNoise(rate_hz=100.0, samples=720_000, tau_s=(0.01, 600.0), axes=axes)
    made = Provenance(method="noise", options={"serial": "A-17"})
    noise = SensorNoise(
        accelerometer=triad, gyroscope=None, t_init_s=np.nan, verdict="warn", findings=(), provenance=made
    )
    stated, numbers, criteria = page_one(noise)
    assert stated.rows == [("Serial number", "A-17")]
    assert [row[1:3] for row in numbers.rows] == [
        ("0.002000", "0.000040"), ("0.002500", "0.000050"), ("0.003000", "0.000060"), *[("< 4·10⁻⁵", "–")] * 3
    ]  # fmt: skip
    assert criteria.marked == 1
    write_certificate(noise, tmp_path / "noise.pdf")
    assert len(re.findall(rb"/Type /Page\b", (tmp_path / "noise.pdf").read_bytes())) == 1
    save_noise(noise, tmp_path / "noise.yaml")
    assert main(["certificate", str(tmp_path / "noise.yaml")]) == 0
    assert main(["certificate", str(tmp_path / "noise.yaml"), "-o", str(tmp_path / "noise.xml")]) == 2


def test_a_missing_library_is_named_with_its_extra(stated, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(OptionError, match=r"gnomon\[certificate\]"):
        write_certificate(stated.calibration, tmp_path / "c.pdf")
    assert not (tmp_path / "c.pdf").exists()
