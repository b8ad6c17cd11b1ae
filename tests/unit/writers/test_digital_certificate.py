"""The digital calibration certificate: order of its elements, units, values and covariance, what must be stated."""

import re
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest

from gnomon.assess.uncertainty_budget import uncertainty_budget
from gnomon.errors import OptionError
from gnomon.findings import Finding
from gnomon.results.calibration import Covariance, Source
from gnomon.results.temperature_dependence import TemperatureDependence
from gnomon.writers.digital_certificate import si_unit, write_digital_certificate

NAMES = {"dcc": "https://ptb.de/dcc", "si": "https://ptb.de/si"}
ORDER = {  # of DCC 3.2.1 and D-SI 2.1.0, of what gnomon writes; "!" where the schema wants it
    "digitalCalibrationCertificate": "administrativeData! measurementResults!",
    "administrativeData": "dccSoftware! coreData! items! calibrationLaboratory! respPersons! customer!",
    "software": "name! release!",
    "coreData": "countryCodeISO3166_1! usedLangCodeISO639_1! mandatoryLangCodeISO639_1! uniqueIdentifier! "
    "beginPerformanceDate! endPerformanceDate! performanceLocation!",
    "item": "name! identifications!",
    "identification": "issuer! value! name",
    "contact": "name! location!",
    "customer": "name! location!",
    "measurementResult": "name! usedMethods usedSoftware influenceConditions results! measurementMetaData",
    "influenceCondition": "name! description data!",
    "result": "name! data!",
    "quantity": "name description real realListXMLList",
    "metaData": "name description convention reference declaration conformity data",
    "real": "value! unit! expandedUnc",
    "expandedUnc": "uncertainty! coverageFactor! coverageProbability! distribution",
    "realListXMLList": "labelXMLList valueXMLList! unitXMLList! ellipsoidalRegionXMLList",
    "ellipsoidalRegionXMLList": "covarianceMatrix! coverageFactor! coverageProbability! distribution",
    "covariance": "value! unit!",
}
UNIT = r"(\\(one|metre|second|radian|kelvin|tesla|degreecelsius)(\\tothe\{-?\d+\})?)+"


@pytest.fixture
def calibration(make_result):
    made = make_result().calibration
    random = np.random.default_rng(3).normal(size=(len(made.uncertainty.names),) * 2)
    options = {"sensor": " <MTi>\x1b ", "serial": "SN & 1", "date": "2026-03-31", "temperature_c": "21.5"}
    fixed = np.arange(len(random)) % 7 > 0
    matrix = 1e-6 * random @ random.T * np.outer(fixed, fixed)
    source = Source(name="a.csv", sha256="0" * 64)
    finding = Finding(severity="warning", code="drift", message="It drifts.", consequence="So.", cure="Wait.")
    return replace(
        made,
        uncertainty=Covariance(names=made.uncertainty.names, matrix=matrix),
        provenance=replace(made.provenance, options=options, inputs=(source,)),
        assessment=replace(made.assessment, findings=(finding,)),
    )


@pytest.fixture
def root(calibration, tmp_path):
    for name in ("a.xml", "b.xml"):
        write_digital_certificate(calibration, tmp_path / name, country="DE")
    assert (tmp_path / "a.xml").read_bytes() == (tmp_path / "b.xml").read_bytes()
    return ElementTree.parse(tmp_path / "a.xml").getroot()


def test_it_says_at_which_temperature_the_parameters_hold(calibration, tmp_path):
    slopes = np.array([[1e-4, -2e-4, 3e-4]])
    known = TemperatureDependence(reference_degc=21.0, low_degc=-2.0, high_degc=44.0, gyroscope_bias=slopes)
    calibration = calibration.with_temperature("imu0", known, {"gyroscope_bias": 1e-12 * np.eye(3)})
    write_digital_certificate(calibration, tmp_path / "a.xml", country="DE")
    root = ElementTree.parse(tmp_path / "a.xml").getroot()
    conditions = {
        one.findtext("dcc:name/dcc:content", namespaces=NAMES): one.findtext(".//si:value", namespaces=NAMES)
        for one in root.iterfind(".//dcc:influenceCondition", NAMES)
    }
    assert conditions["Temperature at which the parameters of imu0 hold"] == "21.0"
    assert conditions["Lowest temperature for the coefficients of imu0"] == "-2.0"
    units = [
        one.findtext(".//si:unit", namespaces=NAMES)
        for one in root.iterfind(".//dcc:quantity", NAMES)
        if (one.findtext("dcc:name/dcc:content", namespaces=NAMES) or "").startswith("imu0.temperature.")
    ]
    assert units == [r"\kelvin\tothe{-1}"] * 3  # of counts


def tag(element):
    return element.tag.rpartition("}")[2]


def test_elements_stand_in_the_order_of_the_schema(root):
    for element in root.iter():
        if tag(element) not in ORDER:
            continue
        order = ORDER[tag(element)].replace("!", "").split()
        children = [tag(child) for child in element]
        assert children == sorted(children, key=order.index), tag(element)
        needed = {name[:-1] for name in ORDER[tag(element)].split() if name.endswith("!")}
        assert needed <= set(children), tag(element)
    for element in root.iter():
        assert len(element) or re.fullmatch(r"\S+(\s+\S+)*", element.text or ""), tag(element)


def test_values_uncertainties_and_covariance_are_those_of_the_calibration(root, calibration):
    wanted = dict(zip(calibration.uncertainty.names, np.sqrt(np.diag(calibration.uncertainty.matrix)), strict=True))
    data = root.find(".//dcc:result/dcc:data", NAMES)
    *scalars, joint = data.findall("dcc:quantity", NAMES)
    assert [one.findtext("dcc:name/dcc:content", None, NAMES) for one in scalars] == list(wanted)
    for one, (name, sigma) in zip(scalars, wanted.items(), strict=True):
        path, _, element = name.partition("[")
        value = calibration.parameter(path)[tuple(map(int, element.rstrip("]").split(",")))]
        assert float(one.findtext("si:real/si:value", None, NAMES)) == value
        expanded = one.findtext("si:real/si:expandedUnc/si:uncertainty", "0", NAMES)
        assert float(expanded) == pytest.approx(2 * sigma, rel=1e-15)
    labels = joint.findtext(".//si:labelXMLList", None, NAMES).split()
    assert labels == [name for name, sigma in wanted.items() if sigma > 0]
    columns = [
        [float(value.text) for value in column.findall("si:covariance/si:value", NAMES)]
        for column in joint.iterfind(".//si:column", NAMES)
    ]
    rows = [list(wanted).index(name) for name in labels]
    np.testing.assert_array_equal(columns, calibration.uncertainty.matrix[np.ix_(rows, rows)])
    counts = {len(joint.findtext(f".//si:{name}XMLList", None, NAMES).split()) for name in ("label", "value", "unit")}
    assert counts == {len(columns)}


def test_units_are_those_of_d_si(root):
    units = [unit.text for unit in root.iterfind(".//si:unit", NAMES)]
    units += root.findtext(".//si:unitXMLList", None, NAMES).split()
    assert all(re.fullmatch(UNIT, unit) for unit in units)
    assert si_unit("g/(m/s^2)") == (9.80665, "\\one")
    assert si_unit("mg") == (pytest.approx(9.80665e-3), "\\metre\\second\\tothe{-2}")
    assert si_unit("count/uT") == (pytest.approx(1e6), "\\tesla\\tothe{-1}")
    assert si_unit("(deg/s)/(rad/s)") == (pytest.approx(np.pi / 180), "\\one")
    assert si_unit("((rad/s)/(m/s^2))/K") == (1.0, "\\radian\\second\\metre\\tothe{-1}\\kelvin\\tothe{-1}")
    assert si_unit("(rad/s)/K^2") == (1.0, "\\radian\\second\\tothe{-1}\\kelvin\\tothe{-2}")


def test_what_was_stated_inputs_findings_and_budget_are_in_it(root, calibration):
    def texts(path):
        return [element.text for element in root.iterfind(path, NAMES)]

    assert texts(".//dcc:item/dcc:name/dcc:content") == ["<MTi>\\x1b"]
    assert texts(".//dcc:identification/dcc:value") == ["SN & 1"]
    assert texts(".//dcc:beginPerformanceDate") == ["2026-03-31"]
    assert texts(".//dcc:countryCodeISO3166_1") == ["DE"]
    assert texts(".//dcc:metaData/dcc:reference") == ["0" * 64]
    assert texts(".//dcc:conformity") == ["conditionalPass"]
    assert "It drifts. So. Wait." in texts(".//dcc:declaration/dcc:content")
    titles = [name for name in texts(".//dcc:metaData/dcc:name/dcc:content") if "budget" in name]
    assert titles == [f"Uncertainty budget of {budget.name}" for budget in uncertainty_budget(calibration)]


@pytest.mark.parametrize("missing", ["serial", "date"])
def test_serial_number_and_date_must_have_been_stated(calibration, tmp_path, missing):
    stated = {key: value for key, value in calibration.provenance.options.items() if key != missing}
    silent = replace(calibration, provenance=replace(calibration.provenance, options=stated))
    with pytest.raises(OptionError, match=f"Calibrate with --{missing}"):
        write_digital_certificate(silent, tmp_path / "c.xml", country="DE")
    with pytest.raises(OptionError, match="two capital letters"):
        write_digital_certificate(calibration, tmp_path / "c.xml", country="Germany")
    assert not list(tmp_path.iterdir())


def test_it_keeps_the_rules_of_ptb(root):
    """By the Schematron rules of dcclib, which come with it; the XSD is on PTB's site alone, which no test asks."""
    schematron = pytest.importorskip("dcclib.validation.schematron", reason="needs pip install dcclib")
    report = schematron.SchematronValidator.for_dcc().validate_str(ElementTree.tostring(root, encoding="unicode"))
    assert not [failed.text for failed in report.failed_assertions if failed.role == "error"]
