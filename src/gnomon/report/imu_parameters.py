"""The parameter tables of an IMU: matrices as scales, misalignments and biases that a person can judge, with sigmas."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from math import degrees, isfinite, pi

import numpy as np

from ..geometry.rotation_vector import rotvec_from_rotation
from ..models.forms import in_own_axes
from ..recording import Floats
from ..results.calibration import (
    AccelerometerCalibration,
    Calibration,
    GyroscopeCalibration,
    ImuCalibration,
    MagnetometerCalibration,
)
from ..results.parameters import element_units
from ..units import ACCELEROMETER_UNITS_M_S2, GYROSCOPE_UNITS_RAD_S, MAGNETOMETER_UNITS_UT, STANDARD_GRAVITY_M_S2
from .numbers import MISSING, estimate_text, fixed_text, number_text, readable_unit, with_sigma
from .page import Bar, Parameter, ParameterGroup, ReportTable, parameter_line

AXES = "xyz"
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
    text, spread = with_sigma(value, sigma, sign=True)
    return f"{text}{f' ± {spread}' if spread else ''}\u00a0%"


def with_bars(rows: list[Parameter], values: list[tuple[float, float]]) -> tuple[Parameter, ...]:
    """Give rows of one group their bars on a common scale, symmetric about zero."""
    reaches = [abs(v) + 2 * (s if isfinite(s) else 0.0) for v, s in values if isfinite(v)]
    reach = max(reaches, default=0.0)
    if not reach > 0:
        return tuple(rows)

    def place(value: float) -> float:
        return 50 + 49 * value / reach

    result: list[Parameter] = []
    for row, (value, sigma) in zip(rows, values, strict=True):
        spread = 2 * sigma if isfinite(sigma) else 0.0
        bar = Bar(50.0, place(value), place(value - spread), place(value + spread))
        result.append(replace(row, bar=bar if isfinite(value) else None))
    return tuple(result)


_STEP = 1e-6
NOT_ABOVE = "within its σ"
"""Marks an entry that the recording does not tell from an ideal sensor's (the rule of Krebs, section 5.2)."""


def sigmas_of(view: Callable[[Floats], Floats], at: Floats, covariance: Floats) -> Floats:
    """Return the sigmas (m,) of view(x) at x (n,) for the covariance (n, n) of x, by central differences."""
    columns: list[Floats] = []
    for i, value in enumerate(at):
        step = np.zeros(len(at))
        step[i] = _STEP * max(abs(float(value)), 1.0)
        columns.append((view(at + step) - view(at - step)) / (2 * step[i]))
    slopes = np.stack(columns, axis=1)
    return np.sqrt(np.fmax(np.diag(slopes @ covariance @ slopes.T), 0.0))


def axes_group(title: str, note: str, unit: str, values: Floats, spreads: Floats) -> ParameterGroup:
    """Return a group of angles about the axes [°], or of lengths along them."""
    word = "about" if unit == "°" else "along"
    rows: list[Parameter] = []
    for axis, value, spread in zip(AXES, values.tolist(), spreads.tolist(), strict=True):
        reads_as = f"{fixed_text(1e3 * value / _DEG, 2)} mrad" if unit == "°" else ""
        rows.append(parameter_line(f"{word} {axis}", value, spread, unit, reads_as=reads_as))
    return ParameterGroup(title, note, with_bars(rows, _pairs(values, spreads)))


def _pairs(values: Floats, spreads: Floats) -> list[tuple[float, float]]:
    return list(zip(values.tolist(), spreads.tolist(), strict=True))


def imu_groups(calibration: Calibration, name: str) -> tuple[ParameterGroup, ...]:
    """Return an IMU in the letters of Krebs, chapter 4: S, M, b of both triads, q_bg and B_g.

    Groups that were held at an ideal sensor's values are left out.
    """
    return tuple(
        group
        for group in _all_imu_groups(calibration, name)
        if any(row.sigma or row.bar is not None or row.value == MISSING for row in group.rows)
    )


def _all_imu_groups(calibration: Calibration, name: str) -> list[ParameterGroup]:
    imu = calibration.imus[name]
    path = f"{name}.accelerometer"
    triad = _lower_triad(imu.required_accelerometer.sensitivity)
    spreads = sigmas_of(
        _lower_triad, imu.required_accelerometer.sensitivity.ravel(), calibration.covariance(f"{path}.sensitivity")
    )
    groups = [*_own_triad("Accelerometer", "a", triad, spreads), _own_bias(calibration, path, "Accelerometer", "a")]
    groups += _lever_arms(calibration, path)
    if imu.gyroscope is None:
        return groups
    path = f"{name}.gyroscope"
    at = imu.gyroscope.sensitivity.ravel()
    own, spreads = _gyroscope(at), sigmas_of(_gyroscope, at, calibration.covariance(f"{path}.sensitivity"))
    groups += [*_own_triad("Gyroscope", "g", own[:6], spreads[:6]), _own_bias(calibration, path, "Gyroscope", "g")]
    turned = axes_group(
        "Gyroscope rotation", "C_bg, from the gyroscope's axes to the body's", "°", own[6:], spreads[6:]
    )
    groups.append(_marked(turned, own[6:], spreads[6:]))
    groups.append(_own_g_sensitivity(calibration, path, imu.gyroscope.g_sensitivity, imu.gyroscope.unit))
    return groups


def _lever_arms(calibration: Calibration, path: str) -> list[ParameterGroup]:
    """Return where the accelerometers that are not the body's origin lie; nothing where that was not estimated."""
    places = calibration.imus[path.split(".", maxsplit=1)[0]].required_accelerometer.lever_arms_m
    if places is None:
        return []
    spreads = calibration.sigma(f"{path}.lever_arms_m")
    return [
        axes_group(f"Place of the {axis} accelerometer", "from the body's origin", "mm", 1e3 * place, 1e3 * spread)
        for axis, place, spread in zip(AXES, places, spreads, strict=True)
        if spread.any()
    ]


def gyroscope_quaternion(sensitivity: Floats) -> str:
    """Return a sentence on the rotation C_bg, as the quaternion of Krebs and its angle; none without rotation."""
    rotvec = _gyroscope(sensitivity.ravel())[6:] / _DEG
    angle = float(np.linalg.norm(rotvec))
    if not angle > 0:
        return ""
    axis = np.sin(angle / 2) * rotvec / angle
    numbers = ", ".join(fixed_text(v, 6) for v in (np.cos(angle / 2), *axis.tolist()))
    return f"As a quaternion, C_bg is q_bg = ({numbers}), real part first: {number_text(degrees(angle), 3)}° in all."


def _lower_triad(sensitivity: Floats) -> Floats:
    """Return the diagonal of S and yz, zy, zx of M, (6,), of S M."""
    matrix = np.reshape(sensitivity, (3, 3))
    S = np.diag(matrix)
    return np.concatenate([S, (matrix / S[:, None])[[1, 2, 2], [0, 0, 1]]])


def _gyroscope(sensitivity: Floats) -> Floats:
    """Return S_g, M_g, and the rotation vector of C_bg [deg], (9,), of S_g M_g C_bg'."""
    lower, C_gb = in_own_axes(np.reshape(sensitivity, (3, 3)), "accel-x")
    return np.concatenate([_lower_triad(lower), rotvec_from_rotation(C_gb.T) * _DEG])


def _own_triad(title: str, letter: str, values: Floats, spreads: Floats) -> tuple[ParameterGroup, ParameterGroup]:
    percents, percent_spreads = 100 * (values[:3] - 1), 100 * spreads[:3]
    scales: list[Parameter] = []
    for i, axis in enumerate(AXES):
        percent, of_it = with_sigma(float(percents[i]), float(percent_spreads[i]), sign=True)
        reads_as = f"{percent}{f' ± {of_it}' if of_it else ''}\u00a0%"
        scales.append(parameter_line(f"scale {axis}", values[i], spreads[i], "", reads_as=reads_as))
    scale = ParameterGroup(
        f"{title} scale", f"S_{letter}; bars: deviation from one",
        with_bars(scales, _pairs(percents, percent_spreads)),
    )  # fmt: skip
    tilts: list[Parameter] = []
    for entry, value, spread in zip(("yz", "zy", "zx"), 1e3 * values[3:], 1e3 * spreads[3:], strict=True):
        reads_as = f"{fixed_text(float(value) * 1e-3 * _DEG, 3, sign=True)}°"
        tilts.append(
            parameter_line(f"entry {entry}", float(value), float(spread), "mrad", reads_as=reads_as, sign=True)
        )
    tilt = ParameterGroup(
        f"{title} misalignment", f"M_{letter} = [1 0 0; yz 1 0; zy zx 1]",
        with_bars(tilts, _pairs(1e3 * values[3:], 1e3 * spreads[3:])),
    )  # fmt: skip
    return (_marked(scale, percents, percent_spreads), _marked(tilt, values[3:], spreads[3:]))


def _marked(group: ParameterGroup, values: Floats, spreads: Floats) -> ParameterGroup:
    """Mark the rows whose deviation from an ideal sensor is not above its sigma."""
    rows = [
        replace(row, note=NOT_ABOVE) if spread > 0 and abs(value) <= spread else row
        for row, value, spread in zip(group.rows, values.tolist(), spreads.tolist(), strict=True)
    ]
    return replace(group, rows=rows)


def _own_bias(calibration: Calibration, path: str, title: str, letter: str) -> ParameterGroup:
    values, spreads = calibration.parameter(f"{path}.bias"), calibration.sigma(f"{path}.bias")
    gyroscope = letter == "g"
    rows: list[Parameter] = []
    for axis, value, spread in zip(AXES, values.tolist(), spreads.tolist(), strict=True):
        physical = f"{number_text(value * _DEG, 3)}\u00a0°/s" if gyroscope else f"{_milli_g(value)}\u00a0mg"
        unit = "rad/s" if gyroscope else "m/s²"
        rows.append(parameter_line(f"bias {axis}", value, spread, unit, reads_as=physical, sign=True))
    note = f"b_{letter}, mean over the recording"
    return ParameterGroup(f"{title} bias", note, with_bars(rows, _pairs(values, spreads)))


def _milli_g(value: float) -> str:
    return number_text(1e3 * value / STANDARD_GRAVITY_M_S2, 3)


def _own_g_sensitivity(calibration: Calibration, path: str, values: Floats, unit: str) -> ParameterGroup:
    flat, spreads = 1e3 * values.ravel(), 1e3 * calibration.sigma(f"{path}.g_sensitivity").ravel()
    rows: list[Parameter] = []
    for (i, j), value, spread in zip(np.ndindex(3, 3), flat.tolist(), spreads.tolist(), strict=True):
        per_g = f"{number_text(value * 1e-3 * _DEG * STANDARD_GRAVITY_M_S2, 3)} °/s per g"
        name = f"{AXES[i]} by force {AXES[j]}"
        rows.append(parameter_line(name, value, spread, f"m{unit} per m/s²", reads_as=per_g, sign=True))
    group = ParameterGroup(
        "Gyroscope g-sensitivity",
        "B_g, on the specific force in the body frame (Krebs, chapter 4)",
        with_bars(rows, _pairs(flat, spreads)),
    )
    return _marked(group, flat, spreads)


def other_reading(calibration: Calibration, name: str) -> ReportTable | None:
    """Return B_g as chapter 3 of Krebs reads it, on the force in the gyroscope's axes; None where it is zero."""
    gyroscope = calibration.imus[name].gyroscope
    if gyroscope is None or not gyroscope.g_sensitivity.any():
        return None

    def view(x: Floats) -> Floats:
        _, C_gb = in_own_axes(np.reshape(x[:9], (3, 3)), "accel-x")
        return 1e3 * (np.reshape(x[9:], (3, 3)) @ C_gb.T).ravel()

    at = np.concatenate([gyroscope.sensitivity.ravel(), gyroscope.g_sensitivity.ravel()])
    paths = (f"{name}.gyroscope.sensitivity", f"{name}.gyroscope.g_sensitivity")
    values, spreads = view(at).reshape(3, 3), sigmas_of(view, at, calibration.covariance(*paths)).reshape(3, 3)
    rows = tuple(
        (f"rate about {axis}", *(estimate_text(v, s, sign=True) for v, s in _pairs(values[i], spreads[i])))
        for i, axis in enumerate(AXES)
    )
    return ReportTable(
        "g-sensitivity on the force in the gyroscope's axes (Krebs, chapter 3)",
        (f"[m{gyroscope.unit} per m/s²]", *(f"force along {axis}" for axis in AXES)),
        rows,
        "B_g C_bg: it acts on the force in the gyroscope's own axes, which the rotation q_bg turns. The sensor "
        "is the same; Kalibr's A is this matrix too.",
    )
