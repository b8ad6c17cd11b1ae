"""Page one of every report, the certificate: what was calibrated, the numbers with U = 2 sigma, criteria.

The numbers of an IMU are scales, misalignments and biases that a person can judge, made of its matrices.
"""

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from math import isfinite, pi
from typing import Protocol

import numpy as np

from ..assess.uncertainty_budget import uncertainty_budget
from ..frozen import FrozenMapping
from ..recording import Floats
from ..results.calibration import (
    AccelerometerCalibration,
    Calibration,
    GyroscopeCalibration,
    ImuCalibration,
    MagnetometerCalibration,
    Provenance,
    Verdict,
)
from ..results.sensors import element_units
from ..units import ACCELEROMETER_UNITS_M_S2, GYROSCOPE_UNITS_RAD_S, MAGNETOMETER_UNITS_UT, STANDARD_GRAVITY_M_S2
from .numbers import MISSING, estimate_text, fixed_text, number_text, readable_unit
from .page import (
    HEADLINES,
    KeyNumber,
    Parameter,
    ParameterGroup,
    ReportPage,
    ReportTable,
    Section,
    lift_figures,
    parameter_line,
    typeset_finding,
    with_bars,
)
from .rig_parameters import AXES, imu_groups


class Certified(Protocol):
    """What a certificate is of: a calibration, the noise of a sensor, a verification or a comparison."""

    @property
    def provenance(self) -> Provenance:
        """What was stated of the sensor and the measurement."""
        ...

    @property
    def verdict(self) -> Verdict:
        """Whether it can be used."""
        ...


def calibration_page(
    title: str,
    calibration: Calibration,
    key_numbers: tuple[KeyNumber, ...],
    sections: Iterable[Section | None],
    plots: Sequence[str] = (),
) -> ReportPage:
    """Return the page of a calibration; the first figures of the sections in `plots` stand on page one.

    Sections that there is nothing to say in are None.
    """
    made_by = calibration.provenance.gnomon_version
    budget = budget_table(calibration)
    figures, folded = lift_figures((section for section in sections if section is not None), plots)
    return ReportPage(
        title=title,
        subject=", ".join(source.name for source in calibration.provenance.inputs) or "recording from memory",
        verdict=calibration.verdict,
        headline=HEADLINES[calibration.verdict],
        key_numbers=key_numbers,
        findings=tuple(typeset_finding(f) for f in calibration.assessment.findings if f.code != "assumed"),
        sections=folded,
        front=(*certificate_tables(calibration), *figures, *(budget,) * bool(budget.rows)),
        footer=f"Made by gnomon {made_by}. This file needs no network and no other file.",
    )


STATED: Mapping[str, str] = FrozenMapping(
    {
        "sensor": "Sensor",
        "serial": "Serial number",
        "date": "Date",
        "operator": "Operator",
        "place": "Place",
        "temperature_c": "Temperature",
        "chip_degc": "Temperature of the chip",
    }
)
"""Option that states it -> its name on the certificate. Never the clock: equal inputs and options give equal bytes."""
BUDGET_TITLE = "Where the uncertainty comes from"
NUMBER_HEAD = ("", "estimate", "U = 2σ", "unit")
EXPANDED = "U is the expanded uncertainty with coverage factor k = 2 (about 95 %)."
_MOST = 14
"""Numbers on page one."""
_MATTERS = ("scale", "bias")
"""Ends of the titles of the groups of a triad that stand on page one."""
_CRITERIA = (
    ("pass", "no finding speaks against its use"),
    ("warn", "usable, with the reservations named under What to do"),
    ("fail", "at least one finding says not to use it"),
)


def certificate_tables(calibration: Calibration) -> tuple[ReportTable, ...]:
    """Return the tables of page one but the uncertainty budget, which stands behind the figures."""
    return front_tables(calibration, (_numbers(calibration), *_over_temperature(calibration)))


def front_tables(
    result: Certified, numbers: Iterable[ReportTable], criteria: Sequence[tuple[str, str]] = _CRITERIA
) -> tuple[ReportTable, ...]:
    """Return the tables of page one of a result: what was stated of it, its numbers, and what its verdict means."""
    meaning = ReportTable(
        "What the verdict means",
        ("verdict", "criterion"),
        criteria,
        "Each finding has its limit, listed with the symptoms of the documentation.",
        marked=[name for name, _ in criteria].index(result.verdict),
        prose=True,
    )
    stated = ReportTable("Certificate", ("", ""), stated_facts(result), prose=True)
    return tuple(table for table in (stated, *numbers, meaning) if table.rows)


def stated_facts(calibration: Certified) -> list[tuple[str, str]]:
    """Return name and text of what was stated of the sensor and the measurement."""
    options = calibration.provenance.options
    units: dict[str, str] = dict.fromkeys(("temperature_c", "chip_degc"), "\u00a0°C")
    return [(name, options[key] + units.get(key, "")) for key, name in STATED.items() if key in options]


def _numbers(calibration: Calibration) -> ReportTable:
    rows: list[tuple[str, ...]] = []
    note = f"{EXPANDED} Without U: fixed, or not estimated."
    for where, group in _groups(calibration):
        if rows and len(rows) + len(group.rows) > _MOST:  # a group is shown as a whole
            break
        rows += [
            (f"{where}{_called(group.title, row.name)}", row.value, row.expanded or MISSING, row.unit)
            for row in group.rows
        ]
        note += f" {where}Attitude: {group.note}." if group.title == "Attitude" else ""
    return ReportTable("The numbers that matter", NUMBER_HEAD, rows, note, dense=True)


def _over_temperature(calibration: Calibration) -> Iterator[ReportTable]:
    """Yield, for each IMU that changes with its temperature, the slopes of biases and scales."""
    for name, imu in calibration.imus.items():
        if imu.temperature is None:
            continue
        known, groups = imu.temperature, groups_over_temperature(calibration, name)
        yield ReportTable(
            "Over the temperature" + (f", {name}" if len(calibration.imus) > 1 else ""),
            ("", "slope", "U = 2σ", "unit"),
            [
                (f"{group.title.partition(' over ')[0]} {row.name[-1]}", row.value, row.expanded or MISSING, row.unit)
                for group in groups
                if "g-sensitivity" not in group.title
                for row in group.rows
            ],
            f"At {known.reference_degc:.1f} °C, where the numbers that matter hold; known from {known.low_degc:.1f} to "
            f"{known.high_degc:.1f} °C. All coefficients stand in calibration.yaml.",
            dense=True,
        )


def _called(group: str, name: str) -> str:
    """Return a group of parameters and one of it, "Accelerometer scale x", without saying a word twice."""
    first, _, rest = name.partition(" ")
    return f"{group} {rest}" if rest and group.lower().split()[-1] == first.lower() else f"{group}: {name}"


def _camera_groups(calibration: Calibration) -> Iterator[tuple[str, ParameterGroup]]:
    from .rig_parameters import camera_groups, lens_groups, pose_groups

    cameras, several = calibration.cameras, len(calibration.cameras) > 1
    for name in cameras:
        where = f"{name} " if several else ""
        groups = camera_groups(calibration, name) if calibration.imus else lens_groups(calibration, name)
        shown = ("Translation", "Attitude", "Time")
        yield from ((where, group) for group in groups if not calibration.imus or group.title in shown)
        if not calibration.imus and name != cameras[name].body:
            yield from ((where, group) for group in pose_groups(calibration, name))


def _groups(calibration: Calibration) -> Iterator[tuple[str, ParameterGroup]]:
    """Yield the groups of parameters for page one, and the words before their titles."""
    if calibration.cameras:
        yield from _camera_groups(calibration)
        if not calibration.imus:
            return
    groups = [g for name in calibration.imus for g in imu_groups(calibration, name)] if calibration.cameras else ()
    groups = groups or parameter_groups(calibration)
    for group in sorted(groups, key=lambda group: "Magnetometer" not in group.title):  # the accelerometer serves it
        if group.title.endswith(_MATTERS):
            yield "", group


def _read_aloud(calibration: Calibration, name: str) -> str:
    """Return the name of a scalar in words, "imu0.accelerometer.bias[1]" -> "imu0 accelerometer bias y"."""
    device, _, rest = name.partition(".")
    symbols: dict[str, str] = {}
    if device in calibration.cameras:
        camera = calibration.cameras[device].camera
        symbols = dict(zip(camera.parameter_names, camera.parameter_symbols, strict=True))
    path, _, element = rest.rstrip("]").partition("[")
    axes = "".join("xyz"[int(i)] for i in element.split(",")) if re.fullmatch("[012](,[012])?", element) else element
    words = path.replace("T_cam_imu.", "").replace("g_sensitivity", "g-sensitivity")
    words = re.sub("_(cam_imu|m)$", "", words).replace("_", " ").replace(".", " ")
    return f"{device} {symbols.get(rest) or f'{words} {axes}'.strip()}"


def budget_table(calibration: Calibration) -> ReportTable:
    """Return the uncertainty budget: of each block the least certain scalar, and from which sources its sigma comes."""
    rows: list[tuple[str, ...]] = []
    faint = set[int]()
    for quantity in uncertainty_budget(calibration):
        sigma, expanded = (number_text(size, 2) for size in (quantity.sigma, quantity.expanded))
        unit = "" if quantity.unit == "1" else f"\u00a0{readable_unit(quantity.unit)}"
        rows.append((_read_aloud(calibration, quantity.name), "", f"U\u00a0=\u00a0{expanded}{unit}", "", "", sigma, ""))
        for source in quantity.sources:
            share = source.variance / quantity.sigma**2
            stated = "" if source.unit == "1" else f"\u00a0{readable_unit(source.unit)}"
            faint.add(len(rows))
            rows.append(
                (
                    f"\u2003{source.name}",
                    source.kind,
                    f"{number_text(source.amount, 2)}{stated}",
                    "√3 (rect.)" if source.distribution == "rectangular" else "1 (normal)",
                    number_text(source.sensitivity, 2),
                    number_text(source.variance**0.5, 2),
                    f"{fixed_text(100 * share, 1)}\u00a0%",
                )
            )
    rig = calibration.imus and calibration.cameras
    within = " Noise, and what gravity and detector leave uncertain, are not told apart here." if rig else ""
    return ReportTable(
        BUDGET_TITLE,
        ("quantity, and its sources", "type", "amount", "divisor", "sensitivity", "u", "share"),
        rows,
        "Of each block of parameters the least certain one, after JCGM 100:2008. Type A: by the statistics of the "
        "recording, B: known otherwise. u = |sensitivity| × amount / divisor, in the unit of U; its share is of the "
        "variance. The first line of each has the combined standard uncertainty and U = 2u (k = 2, about 95 %). Errors "
        f"that last: what the scatter between parts of the recording shows beyond independent noise.{within}",
        faint=frozenset(faint),
        dense=True,
    )


_DEG = 180 / pi
_NOT_DETERMINED = "not determined by this recording"
Triad = AccelerometerCalibration | GyroscopeCalibration | MagnetometerCalibration
LOCAL_FIELD = "local field"
_AGAINST = {
    AccelerometerCalibration: "the mean of the three axes, which share what gravity leaves uncertain",
    GyroscopeCalibration: "the mean of the three axes",
    MagnetometerCalibration: "the mean of the three axes; soft iron is part of it",
}
"""What scales are compared with where the unit has no nominal one."""


def parameter_groups(calibration: Calibration) -> tuple[ParameterGroup, ...]:
    """Return the groups of parameters of all IMUs, each group with bars on one scale."""
    groups: list[ParameterGroup] = []
    for name, imu in calibration.imus.items():
        groups += _triad_groups(calibration, name, imu, f"{name}: " if len(calibration.imus) > 1 else "")
    return tuple(groups)


def _triad_groups(calibration: Calibration, name: str, imu: ImuCalibration, prefix: str) -> Iterator[ParameterGroup]:
    """Yield the groups of each triad of an IMU that was calibrated."""
    if imu.accelerometer is not None:
        path, nominal = f"{name}.accelerometer", ACCELEROMETER_UNITS_M_S2.get(imu.accelerometer.unit)
        title = f"{prefix}Accelerometer"
        yield from _shape(calibration, path, title, imu.accelerometer, si="m/s²", unit_in_si=nominal)
        yield _bias(calibration, path, f"{title} bias", imu.accelerometer, "m/s²")
    if imu.gyroscope is not None:
        path, nominal = f"{name}.gyroscope", GYROSCOPE_UNITS_RAD_S.get(imu.gyroscope.unit)
        title = f"{prefix}Gyroscope"
        yield from _shape(calibration, path, title, imu.gyroscope, si="rad/s", unit_in_si=nominal)
        yield _bias(calibration, path, f"{title} bias", imu.gyroscope, "rad/s")
        if np.any(imu.gyroscope.g_sensitivity != 0):
            yield _g_sensitivity(calibration, path, f"{title} g-sensitivity", imu.gyroscope)
    if imu.magnetometer is not None:
        known = imu.magnetometer.field_unit == "uT"
        nominal = MAGNETOMETER_UNITS_UT.get(imu.magnetometer.unit) if known else None
        path, title, si = f"{name}.magnetometer", f"{prefix}Magnetometer", "µT" if known else LOCAL_FIELD
        yield from _shape(calibration, path, title, imu.magnetometer, si=si, unit_in_si=nominal)
        yield _bias(calibration, path, f"{title} bias", imu.magnetometer, si)
    yield from groups_over_temperature(calibration, name)


def groups_over_temperature(calibration: Calibration, name: str) -> Iterator[ParameterGroup]:
    """Yield the slopes at the reference of what changes with the temperature."""
    if (found := calibration.imus[name].temperature) is None:
        return
    known = f"per kelvin at {found.reference_degc:.1f} °C, known from {found.low_degc:.1f} to {found.high_degc:.1f} °C"
    for part, coefficients in found.parts():
        triad, kind = part.split("_", 1)
        path = f"{name}.temperature.{part}"
        slopes, sigmas = coefficients[0], calibration.sigma(path)[0]
        axes = AXES
        if kind == "sensitivity":
            slopes, sigmas = np.diagonal(slopes), np.diagonal(sigmas)
        elif kind == "g_sensitivity":
            axes = tuple(f"{row}{column}" for row in AXES for column in AXES)
        unit = element_units(calibration, path)[0]
        rows = [
            parameter_line(f"slope {axis}", float(slope), float(sigma), readable_unit(unit))
            for axis, slope, sigma in zip(axes, np.ravel(slopes), np.ravel(sigmas), strict=True)
        ]
        what = {"bias": "bias", "sensitivity": "scale"}.get(kind, "g-sensitivity")
        note = f"{known}; of order {len(coefficients)}"
        yield ParameterGroup(f"{triad.capitalize()} {what} over the temperature", note, tuple(rows))


def _sigmas(calibration: Calibration, path: str) -> Floats:
    """Return the sigmas (9,) or (3,) of a parameter; rounding below zero counts as zero."""
    return np.sqrt(np.fmax(np.diag(calibration.covariance(path)), 0.0))


def _held(calibration: Calibration, path: str, *elements: str) -> bool:
    held = set(calibration.assessment.held_by_prior)
    return path in held or any(f"{path}[{element}]" in held for element in elements)


def _shape(
    calibration: Calibration, path: str, title: str, triad: Triad, *, si: str, unit_in_si: float | None
) -> Iterator[ParameterGroup]:
    """Yield the groups of scales and misalignments of a sensitivity matrix (rows are the sensor axes)."""
    path = f"{path}.sensitivity"
    covariance = calibration.covariance(path)
    unit = "" if readable_unit(triad.unit) == si else f"{readable_unit(triad.unit)} per {si}"
    against = "nominal" if unit_in_si else _AGAINST[type(triad)]
    yield ParameterGroup(
        f"{title} scale",
        f"deviation from {against}",
        _scales(calibration, path, triad.sensitivity, covariance, unit=unit, unit_in_si=unit_in_si),
    )
    tilts = _tilts(calibration, path, triad.sensitivity, covariance)
    if tilts:
        note = "sine of the angle by which the sensor axis leans out of the body axis"
        note += ", soft iron included" if isinstance(triad, MagnetometerCalibration) else ""
        yield ParameterGroup(f"{title} misalignment", note, tilts)


def _scales(
    calibration: Calibration, path: str, matrix: Floats, covariance: Floats, *, unit: str, unit_in_si: float | None
) -> tuple[Parameter, ...]:
    """Return the lengths of the rows; a minus sign says that the axis points the other way."""
    lengths = np.linalg.norm(matrix, axis=1)
    slopes = np.zeros((3, 9))  # of the lengths of the rows
    for i in range(3):
        slopes[i, 3 * i : 3 * i + 3] = matrix[i] / lengths[i]
    joint = slopes @ covariance @ slopes.T
    percents = _deviations(lengths, joint, 1 / unit_in_si if unit_in_si else None)
    rows: list[Parameter] = []
    for i, axis in enumerate(AXES):
        sign = -1.0 if matrix[i, i] < 0 else 1.0
        rows.append(
            parameter_line(
                f"scale {axis}",
                sign * float(lengths[i]),
                float(np.sqrt(np.fmax(joint[i, i], 0.0))),
                unit,
                reads_as=_percent(*percents[i]),
                note=_NOT_DETERMINED if _held(calibration, path, *(f"{i},{j}" for j in range(3))) else "",
            )
        )
    return with_bars(rows, percents)


def _tilts(calibration: Calibration, path: str, matrix: Floats, covariance: Floats) -> tuple[Parameter, ...]:
    """Return the components of each row off its own axis over its length, without those that the frame makes zero."""
    rows, angles = list[Parameter](), list[tuple[float, float]]()
    for i, j in ((i, j) for i in range(3) for j in range(3) if j != i):
        length = float(np.linalg.norm(matrix[i])) * (-1.0 if matrix[i, i] < 0 else 1.0)
        slope = (np.eye(3)[j] - matrix[i, j] * matrix[i] / length**2) / length
        block = covariance[3 * i : 3 * i + 3, 3 * i : 3 * i + 3]
        angle, sigma = 1e3 * float(matrix[i, j]) / length, 1e3 * float(np.sqrt(np.fmax(slope @ block @ slope, 0.0)))
        if angle == 0 and sigma == 0:
            continue
        angles.append((angle, sigma))
        rows.append(
            _about_zero(
                f"{AXES[i]} towards {AXES[j]}",
                angles[-1],
                unit="mrad",
                reads_as=f"{fixed_text(angle * 1e-3 * _DEG, 3, sign=True)}°",
                held=_held(calibration, path, f"{i},{j}"),
            )
        )
    return with_bars(rows, angles)


def _bias(calibration: Calibration, path: str, title: str, triad: Triad, si: str) -> ParameterGroup:
    sigmas = _sigmas(calibration, f"{path}.bias")
    lengths = np.linalg.norm(triad.sensitivity, axis=1)
    rows: list[Parameter] = []
    for i, axis in enumerate(AXES):
        physical, sigma = float(triad.bias[i] / lengths[i]), float(sigmas[i] / lengths[i])
        # The offset of raw counts is arbitrary; only its uncertainty says something in physical units.
        arbitrary = triad.unit == "count" and not isinstance(triad, MagnetometerCalibration)
        reads_as = f"± {_physical(sigma, si)}" if arbitrary else _physical(physical, si)
        rows.append(
            parameter_line(
                f"bias {axis}",
                float(triad.bias[i]),
                float(sigmas[i]),
                readable_unit(triad.unit),
                reads_as=reads_as if isfinite(sigma) else "",
                note=_NOT_DETERMINED if _held(calibration, f"{path}.bias", str(i)) else "",
            )
        )
    drawn = [(float(b), float(s)) for b, s in zip(triad.bias, sigmas, strict=True)]
    note = "hard iron, with the sensor's own offset" if isinstance(triad, MagnetometerCalibration) else ""
    bare = triad.unit == "count" and not note  # the offset of raw counts says nothing; that of hard iron does
    return ParameterGroup(title, note, tuple(rows) if bare else with_bars(rows, drawn))


def _physical(value: float, si: str) -> str:
    if si == "rad/s":
        return f"{number_text(value * _DEG, 3)}\u00a0°/s"
    if si == LOCAL_FIELD:
        return f"{number_text(100 * value, 3)}\u00a0% of the field"
    if si == "µT":
        return f"{number_text(value, 3)}\u00a0µT"
    return f"{number_text(value / STANDARD_GRAVITY_M_S2 * 1e3, 3)}\u00a0mg"


def _g_sensitivity(calibration: Calibration, path: str, title: str, gyroscope: GyroscopeCalibration) -> ParameterGroup:
    path = f"{path}.g_sensitivity"
    sigmas = _sigmas(calibration, path).reshape(3, 3)
    lengths = np.linalg.norm(gyroscope.sensitivity, axis=1)
    rows, drawn = list[Parameter](), list[tuple[float, float]]()
    for i, j in np.ndindex(3, 3):
        entry, sigma = float(gyroscope.g_sensitivity[i, j]), float(sigmas[i, j])
        drawn.append((entry, sigma))
        rows.append(
            _about_zero(
                f"{AXES[i]} by force {AXES[j]}",
                drawn[-1],
                unit=f"{readable_unit(gyroscope.unit)} per m/s²",
                reads_as=f"{number_text(entry / float(lengths[i]) * _DEG * STANDARD_GRAVITY_M_S2, 3)} °/s per g",
                held=_held(calibration, path, f"{i},{j}"),
            )
        )
    note = "change of the bias with specific force"
    return ParameterGroup(title, note, with_bars(rows, drawn))


def _about_zero(name: str, found: tuple[float, float], *, unit: str, reads_as: str, held: bool) -> Parameter:
    """Return the row of a value, with sigma, that is zero in an ideal sensor."""
    value, sigma = found
    insignificant = "within 2σ of zero" if sigma > 0 and abs(value) < 2 * sigma else ""
    note = _NOT_DETERMINED if held else insignificant
    return parameter_line(name, value, sigma, unit, reads_as=reads_as, note=note, sign=True)


def _deviations(lengths: Floats, covariance: Floats, nominal: float | None) -> list[tuple[float, float]]:
    """Return the deviation of each scale from nominal, or from their mean where there is none, with sigma [%]."""
    reference = float(np.mean(lengths)) if nominal is None else nominal
    slope = np.eye(3) / reference
    if nominal is None:
        slope = slope - np.outer(lengths, np.full(3, 1 / 3)) / reference**2
    sigmas = np.sqrt(np.fmax(np.diag(slope @ covariance @ slope.T), 0.0))
    return [(100 * float(x / reference - 1), 100 * float(s)) for x, s in zip(lengths, sigmas, strict=True)]


def _percent(value: float, sigma: float) -> str:
    if abs(value) >= 1000:
        return f"× {number_text(1 + value / 100, 3)}"
    return f"{estimate_text(value, sigma, sign=True)}\u00a0%"
