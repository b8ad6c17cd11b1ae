"""A stored calibration as a digital calibration certificate: PTB's DCC, an XML file with quantities in D-SI.

Elements and their order are those of DCC 3.2.1 (https://ptb.de/dcc/v3.2.1) with D-SI 2.1.0 (https://ptb.de/si). Values
are in SI units, with the expanded uncertainty of each scalar (k = 2) and the covariance of all.
"""

import hashlib
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from xml.etree.ElementTree import Element, SubElement, indent, register_namespace, tostring

import numpy as np

from ..assess.uncertainty_budget import COVERAGE_FACTOR, QuantityBudget, uncertainty_budget
from ..errors import OptionError
from ..findings import printable_text
from ..output import write_whole
from ..recording import Floats
from ..results.calibration import Calibration
from ..results.sensors import calibration_parameters, element_units
from ..units import ACCELEROMETER_UNITS_M_S2, GYROSCOPE_UNITS_RAD_S, MAGNETOMETER_UNITS_UT

SCHEMA_VERSION = "3.2.1"
_DCC, _SI = "https://ptb.de/dcc", "https://ptb.de/si"
_COVERAGE = 0.9545
"""Probability of k = 2, normal."""
_REGION = 0.95
"""Probability of the ellipsoid of all scalars together."""
UNKNOWN_COUNTRY = "ZZ"
"""Of ISO 3166-1, free for own use."""
_NOT_STATED = "not stated"
_CONFORMITY = {"pass": "pass", "warn": "conditionalPass", "fail": "fail"}
_Dimension = Mapping[str, int]
_FORCE: _Dimension = {"metre": 1, "second": -2}
_RATE: _Dimension = {"radian": 1, "second": -1}
_UNITS: dict[str, tuple[float, _Dimension]] = {
    **{unit: (1e-6 * size, {"tesla": 1}) for unit, size in MAGNETOMETER_UNITS_UT.items() if size},
    **{unit: (size, _FORCE) for unit, size in ACCELEROMETER_UNITS_M_S2.items() if size},
    **{unit: (size, _RATE) for unit, size in GYROSCOPE_UNITS_RAD_S.items() if size},
    **{f"K^{power}" if power > 1 else "K": (1.0, {"kelvin": power}) for power in (1, 2, 3)},
    **{unit: (1.0, {}) for unit in ("1", "count", "px")},
    **{unit: (1.0, {name: 1}) for unit, name in (("m", "metre"), ("s", "second"), ("rad", "radian"))},
}
"""Unit -> its size in SI, and the dimension; what only counts has none."""


def write_digital_certificate(calibration: Calibration, path: str | Path, *, country: str = UNKNOWN_COUNTRY) -> None:
    """Write the digital certificate of a calibration; the same calibration gives the same bytes.

    Parameters
    ----------
    calibration : of which sensor, serial number, date, ... were stated
    path : of the XML file
    country : of the laboratory, by ISO 3166-1

    Raises
    ------
    OptionError
        If serial number or date, which every certificate has, were not stated when it was calibrated, or the country
        is no code.
    OutputError
        If the file cannot be written.
    """
    stated = calibration.provenance.options
    missing = [f"--{name}" for name in ("serial", "date") if name not in stated]
    if missing:
        raise OptionError(
            f"a digital calibration certificate tells serial number and date. Calibrate with {' and '.join(missing)}."
        )
    if not re.fullmatch("[A-Z]{2}", country):
        raise OptionError(f"--country {country}: give two capital letters (ISO 3166-1), such as DE.")
    register_namespace("dcc", _DCC)
    register_namespace("si", _SI)
    root = Element(f"{{{_DCC}}}digitalCalibrationCertificate", schemaVersion=SCHEMA_VERSION)
    administrative = _add(root, "administrativeData")
    results = _add(_add(root, "measurementResults"), "measurementResult")
    _fill_results(results, calibration)
    _fill_administrative(administrative, calibration, hashlib.sha256(tostring(results)).hexdigest(), country)
    indent(root)
    write_whole(path, tostring(root, encoding="utf-8", xml_declaration=True) + b"\n")


def si_unit(unit: str) -> tuple[float, str]:
    r"""Return the size of a unit of a parameter in SI units, and these as D-SI writes them.

    Examples
    --------
    >>> si_unit("m/s^2"), si_unit("count/(rad/s)")
    ((1.0, '\\metre\\second\\tothe{-2}'), (1.0, '\\radian\\tothe{-1}\\second'))
    """
    size, dimension = _si_dimension(unit)
    return size, _dsi(dimension)


def _si_dimension(unit: str) -> tuple[float, _Dimension]:
    return _known_dimension(unit) or (1.0, {})  # of a field that is not known, in its own size


def _known_dimension(unit: str) -> tuple[float, _Dimension] | None:
    """Return size and dimension of a unit that may be a ratio of others in brackets; None where it is not known."""
    if unit in _UNITS:
        return _UNITS[unit]
    depth = np.cumsum([(character == "(") - (character == ")") for character in unit])
    cuts = [i for i, character in enumerate(unit) if character == "/" and depth[i] == 0]
    if not cuts:
        return _known_dimension(unit[1:-1]) if unit.startswith("(") and unit.endswith(")") else None
    above, below = _known_dimension(unit[: cuts[-1]]), _known_dimension(unit[cuts[-1] + 1 :])
    if above is None or below is None:
        return None
    (size, one), (other_size, other) = above, below
    return size / other_size, {name: one.get(name, 0) - other.get(name, 0) for name in {**one, **other}}


def _dsi(dimension: _Dimension) -> str:
    powers = [(name, power) for name, power in dimension.items() if power]
    return "".join(f"\\{name}" + (f"\\tothe{{{power}}}" if power != 1 else "") for name, power in powers) or "\\one"


def _add(parent: Element, name: str, text: str = "") -> Element:
    """Add an element, "si:" before the name of one of D-SI's, and return it."""
    space, _, tag = name.rpartition(":")
    element = SubElement(parent, f"{{{_SI if space else _DCC}}}{tag}")
    if text:
        element.text = " ".join(printable_text(text).split())  # no spaces at the ends, as the schema wants it
    return element


def _add_text(parent: Element, name: str, text: str) -> Element:
    """Add an element with text in English, and return it."""
    element = _add(parent, name)
    _add(element, "content", text or _NOT_STATED).set("lang", "en")
    return element


def _fill_administrative(parent: Element, calibration: Calibration, digest: str, country: str) -> None:
    stated = calibration.provenance.options
    _fill_software(_add(parent, "dccSoftware"), calibration)
    core = _add(parent, "coreData")
    _add(core, "countryCodeISO3166_1", country)
    _add(core, "usedLangCodeISO639_1", "en")
    _add(core, "mandatoryLangCodeISO639_1", "en")
    _add(core, "uniqueIdentifier", f"gnomon-{digest}")
    _add(core, "beginPerformanceDate", stated["date"])
    _add(core, "endPerformanceDate", stated["date"])
    _add(core, "performanceLocation", "laboratory" if "place" in stated else "other")
    item = _add(_add(parent, "items"), "item")
    _add_text(item, "name", stated.get("sensor", ", ".join((*calibration.imus, *calibration.cameras))))
    identification = _add(_add(item, "identifications"), "identification")
    _add(identification, "issuer", "manufacturer")
    _add(identification, "value", stated["serial"])
    _add_text(identification, "name", "Serial number")
    _fill_contact(_add(_add(parent, "calibrationLaboratory"), "contact"), stated.get("place", ""))
    person = _add(_add(parent, "respPersons"), "respPerson")
    _add_text(_add(person, "person"), "name", stated.get("operator", ""))
    _fill_contact(_add(parent, "customer"), "")


def _fill_software(parent: Element, calibration: Calibration) -> None:
    software = _add(parent, "software")
    _add_text(software, "name", "gnomon")
    _add(software, "release", f"v{calibration.provenance.gnomon_version}")


def _fill_contact(parent: Element, name: str) -> None:
    _add_text(parent, "name", name)
    _add_text(_add(parent, "location"), "further", _NOT_STATED)


def _fill_results(parent: Element, calibration: Calibration) -> None:
    provenance = calibration.provenance
    _add_text(parent, "name", "Calibration")
    method = _add(_add(parent, "usedMethods"), "usedMethod")
    _add_text(method, "name", f"gnomon {provenance.method}")
    _add_text(method, "description", f"Model {calibration.assessment.model}, body frame {calibration.frame}.")
    _fill_software(_add(parent, "usedSoftware"), calibration)
    _fill_conditions(_add(parent, "influenceConditions"), calibration)
    result = _add(_add(parent, "results"), "result")
    _add_text(result, "name", "Parameters")
    _fill_parameters(_add(result, "data"), calibration)
    _fill_metadata(_add(parent, "measurementMetaData"), calibration)


def _fill_conditions(parent: Element, calibration: Calibration) -> None:
    gravity, stated = calibration.gravity, calibration.provenance.options
    condition = _add(parent, "influenceCondition")
    _add_text(condition, "name", "Gravity")
    _add_text(condition, "description", gravity.source)
    _add_real(_add(_add(condition, "data"), "quantity"), gravity.value, gravity.sigma, *si_unit("m/s^2"))
    temperatures = {"Temperature": stated.get("temperature_c"), "Temperature of the chip": stated.get("chip_degc")}
    for imu, sensor in calibration.imus.items():
        if (known := sensor.temperature) is not None:
            temperatures |= {
                f"Temperature at which the parameters of {imu} hold": known.reference_degc,
                f"Lowest temperature for the coefficients of {imu}": known.low_degc,
                f"Highest temperature for the coefficients of {imu}": known.high_degc,
            }
    for name, degc in temperatures.items():
        if degc is not None:
            condition = _add(parent, "influenceCondition")
            _add_text(condition, "name", name)
            _add_real(_add(_add(condition, "data"), "quantity"), float(degc), 0.0, 1.0, "\\degreecelsius")


def _fill_parameters(parent: Element, calibration: Calibration) -> None:
    """Add each scalar, and the covariance of those that were estimated."""
    known = list(calibration_parameters(calibration.imus, calibration.cameras))
    names, matrix = calibration.uncertainty.names, calibration.uncertainty.matrix
    values = np.concatenate([np.ravel(value) for _, value in known])
    units = [unit for path, _ in known for unit in element_units(calibration, path)]
    sigmas = np.sqrt(np.fmax(np.diag(matrix), 0.0))
    for name, value, sigma, unit in zip(names, values.tolist(), sigmas.tolist(), units, strict=True):
        quantity = _add(parent, "quantity")
        _add_text(quantity, "name", name)
        own = f"In {unit}." if sigma > 0 else f"In {unit}; fixed, or not estimated."
        _add_text(quantity, "description", own)
        _add_real(quantity, value, sigma, *si_unit(unit))
    estimated = np.flatnonzero(sigmas > 0)
    if len(estimated):
        quantity = _add(parent, "quantity")
        _add_text(quantity, "name", "All that was estimated, with its covariance")
        kept = [units[i] for i in estimated]
        covariance = matrix[np.ix_(estimated, estimated)]
        _add_joint(quantity, [names[i] for i in estimated], values[estimated], covariance, kept)


def _add_real(parent: Element, value: float, sigma: float, size: float, unit: str) -> None:
    """Add a value; with its expanded uncertainty where it has one."""
    real = _add(parent, "si:real")
    _add(real, "si:value", repr(value * size))
    _add(real, "si:unit", unit)
    if sigma > 0:
        expanded = _add(real, "si:expandedUnc")
        _add(expanded, "si:uncertainty", repr(COVERAGE_FACTOR * sigma * size))
        _add(expanded, "si:coverageFactor", f"{COVERAGE_FACTOR:g}")
        _add(expanded, "si:coverageProbability", str(_COVERAGE))
        _add(expanded, "si:distribution", "normal")


def _add_joint(parent: Element, names: Sequence[str], values: Floats, covariance: Floats, units: Sequence[str]) -> None:
    """Add a list of scalars with their covariance, as the ellipsoid that holds all of them together."""
    from scipy.stats import chi2

    sizes = np.array([si_unit(unit)[0] for unit in units])
    dimensions = [_si_dimension(unit)[1] for unit in units]
    joint = _add(parent, "si:realListXMLList")
    _add(joint, "si:labelXMLList", " ".join(names))
    _add(joint, "si:valueXMLList", " ".join(map(repr, (values * sizes).tolist())))
    _add(joint, "si:unitXMLList", " ".join(map(_dsi, dimensions)))
    region = _add(joint, "si:ellipsoidalRegionXMLList")
    matrix = _add(region, "si:covarianceMatrix")
    for row, one in zip((covariance * np.outer(sizes, sizes)).tolist(), dimensions, strict=True):
        column = _add(matrix, "si:column")
        for number, other in zip(row, dimensions, strict=True):
            entry = _add(column, "si:covariance")
            _add(entry, "si:value", repr(number))
            _add(entry, "si:unit", _dsi({name: one.get(name, 0) + other.get(name, 0) for name in {**one, **other}}))
    _add(region, "si:coverageFactor", repr(float(np.sqrt(chi2.ppf(_REGION, len(names))))))
    _add(region, "si:coverageProbability", str(_REGION))
    _add(region, "si:distribution", "normal")


def _fill_metadata(parent: Element, calibration: Calibration) -> None:
    """Add the verdict, problems and warnings, the files that were read, and the uncertainty budget."""
    verdict = _add(parent, "metaData")
    _add_text(verdict, "name", "Verdict")
    use = calibration.assessment.trust.use
    _add_text(verdict, "declaration", f"For {use}." if use else "For no special use.")
    _add(verdict, "conformity", _CONFORMITY[calibration.verdict])
    for finding in calibration.assessment.findings:
        if finding.severity in ("problem", "warning"):
            entry = _add(parent, "metaData")
            _add_text(entry, "name", f"{finding.severity}: {finding.code}")
            _add_text(entry, "declaration", " ".join((finding.message, finding.consequence, finding.cure)))
    for source in calibration.provenance.inputs:
        entry = _add(parent, "metaData")
        _add_text(entry, "name", f"Input file {source.name}")
        _add(entry, "convention", "SHA-256")
        _add(entry, "reference", source.sha256)
    for budget in uncertainty_budget(calibration):
        entry = _add(parent, "metaData")
        _add_text(entry, "name", f"Uncertainty budget of {budget.name}")
        _add_text(entry, "description", "Contributions to its standard uncertainty, after JCGM 100:2008.")
        data = _add(entry, "data")
        for name, words, sigma in _contributions(budget):
            quantity = _add(data, "quantity")
            _add_text(quantity, "name", name)
            _add_text(quantity, "description", words)
            _add_real(quantity, sigma, 0.0, *si_unit(budget.unit))


def _contributions(budget: QuantityBudget) -> Iterator[tuple[str, str, float]]:
    """Yield name, evaluation and standard uncertainty of each source, and of all combined."""
    for source in budget.sources:
        share = source.variance / budget.sigma**2
        words = (
            f"Type {source.kind}; {source.distribution}, {source.amount:.6g} {source.unit}, divisor "
            f"{source.divisor:.6g}, sensitivity {source.sensitivity:.6g}, share of the variance {share:.6g}."
        )
        yield source.name, words, source.variance**0.5
    yield "combined standard uncertainty", "Root of the sum of the squares.", budget.sigma
