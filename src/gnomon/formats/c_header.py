"""C99 (and C++): one header with the numbers and inline functions for each IMU, in single or double precision.

A bias of 33124.1825 counts loses two thousandths of a count in a float; it is therefore kept as the sum of two floats,
whose differences to a sample of similar size are exact.
"""

import re
from collections.abc import Iterator, Mapping

import numpy as np

from ..geometry.rotations import invert_matrix
from ..recording import Floats
from ..results.calibration import Calibration, ImuCalibration
from ..results.temperature_dependence import TemperatureDependence
from .own.calibration_text import FRAMES
from .shared.losses import Context, Export, Loss
from .shared.sensor_losses import Holds, not_representable

_HEAD = """\
/* Calibration of an inertial sensor as C code, made by gnomon.
 *
 * With specific force f [m/s^2] and angular rate w [rad/s] in the body frame, the sensor reads
 *   accelerometer = S f + b,   gyroscope = S w + b + G f,
 * so that
 *   f = S^-1 (accelerometer - b),   w = S^-1 (gyroscope - b - G f).
{magnetometer} * Body frame: {frame}.
{remarks} * Define GNOMON_DOUBLE before including this to compute in double.
 */
#ifndef GNOMON_IMU_H
#define GNOMON_IMU_H

#ifdef GNOMON_DOUBLE
typedef double gnomon_real;
#define GNOMON_R(x) x
#else
typedef float gnomon_real;
#define GNOMON_R(x) x##f
#endif
"""

_HEAD_MAGNETOMETER = """\
 * With the magnetic field m in the body frame,
 *   magnetometer = S m + b, so that m = S^-1 (magnetometer - b);
 * its unit stands at the function; where it is "local field", m has length 1 where the sensor was calibrated.
"""

_FUNCTION = """\
/* {imu}: from samples in {units} to {results} in the body frame.
 * {notes} */
static inline void gnomon_{imu}_apply{suffix}({arguments})
{{
    gnomon_real d[3];
{body}}}
"""

_OFFSET = """\
    for (int i = 0; i < 3; ++i)
        d[i] = (accelerometer[i] - gnomon_{imu}_accelerometer_bias[i]) - gnomon_{imu}_accelerometer_bias_rest[i];
"""

_OFFSET_WITH_FORCE = """\
    for (int i = 0; i < 3; ++i)
        d[i] = ((gyroscope[i] - gnomon_{imu}_gyroscope_bias[i]) - gnomon_{imu}_gyroscope_bias_rest[i])
             - (gnomon_{imu}_g_sensitivity[i][0] * force[0]
              + gnomon_{imu}_g_sensitivity[i][1] * force[1]
              + gnomon_{imu}_g_sensitivity[i][2] * force[2]);
"""

_PRODUCT = """\
    for (int i = 0; i < 3; ++i)
        {result}[i] = gnomon_{imu}_{triad}_correction[i][0] * d[0]
        {pad}     + gnomon_{imu}_{triad}_correction[i][1] * d[1]
        {pad}     + gnomon_{imu}_{triad}_correction[i][2] * d[2];
"""

_TEMPERATURE = """\
/* {imu}: takes off the samples, in place, what the temperature changes: first this, then gnomon_{imu}_apply{suffix}.
 * degc: of the chip [degC], {low:g} to {high:g}; beyond it is taken for the nearer end. */
static inline void gnomon_{imu}_at_reference{suffix}({arguments}, gnomon_real degc)
{{
    const gnomon_real t = degc < {low_literal} ? {low_literal} : degc > {high_literal} ? {high_literal} : degc;
    const gnomon_real d = t - {reference};
{body}}}
"""

_SENSITIVITY = """\
    {{   /* y - bias = (1 + D) x is solved for x by x = y - bias - D x, over and over */
        gnomon_real y[3], x[3], more[3];
        for (int i = 0; i < 3; ++i)
            x[i] = y[i] = {triad}[i] - gnomon_{imu}_{triad}_bias[i] - gnomon_{imu}_{triad}_bias_rest[i];
        for (int k = 0; k < {times}; ++k) {{
            for (int i = 0; i < 3; ++i) {{
                more[i] = GNOMON_R(0.0);
                for (int j = 0; j < 3; ++j)
                    more[i] += d * {change} * x[j];
            }}
            for (int i = 0; i < 3; ++i)
                x[i] = y[i] - more[i];
        }}
        for (int i = 0; i < 3; ++i)
            {triad}[i] -= more[i];
    }}
"""

_FELT = """\
    /* what the temperature changes of the g-sensitivity alone, by the accelerometer at the reference */
    for (int i = 0; i < 3; ++i)
        for (int j = 0; j < 3; ++j)
            gyroscope[i] -= d * {change}
                * ((accelerometer[j] - gnomon_{imu}_accelerometer_bias[j]) - gnomon_{imu}_accelerometer_bias_rest[j]);
"""

HOLDS = Holds(
    program="the C header", cameras=0, samples_in_si=False, magnetometer=True, temperature=True, temperature_scale=True
)


def export(calibration: Calibration, context: Context) -> Export:
    """Return `gnomon_imu.h` with a function `gnomon_imu0_apply` for each IMU.

    A magnetometer, whose samples come at a rate of their own, has `gnomon_imu0_apply_magnetometer`.
    """
    frame = f"{calibration.frame}, {FRAMES.get(calibration.frame, FRAMES['user'])}"
    magnetic = any(imu.magnetometer is not None for imu in calibration.imus.values())
    remarks = context.comment(" * ").replace("*/", "* /")
    parts = [
        _HEAD.format(
            frame=frame.replace("*/", "* /"), magnetometer=_HEAD_MAGNETOMETER if magnetic else "", remarks=remarks
        )
    ]
    for name, imu in calibration.imus.items():
        identifier = re.sub(r"\W", "_", name, flags=re.ASCII)
        parts.append(_constants(identifier, imu))
        if imu.accelerometer is not None or imu.gyroscope is not None:
            parts.append(_function(identifier, imu))
        if imu.temperature is not None and dict(imu.temperature.parts()):
            parts += _temperature_functions(identifier, imu.temperature)
        if imu.magnetometer is not None:
            parts.append(_magnetometer_function(identifier, imu.magnetometer.unit, imu.magnetometer.field_unit))
    text = "\n".join([*parts, "#endif\n"])
    rounding = Loss(
        what="precision", why="the numbers are floats unless GNOMON_DOUBLE is defined.", size="6e-8 relative"
    )
    return Export(files={"gnomon_imu.h": text}, losses=(*not_representable(calibration, HOLDS, context), rounding))


def _constants(imu: str, calibration: ImuCalibration) -> str:
    magnetometer = calibration.magnetometer
    triads = {
        "accelerometer": (calibration.accelerometer, "m/s^2"),
        "gyroscope": (calibration.gyroscope, "rad/s"),
        "magnetometer": (magnetometer, "" if magnetometer is None else magnetometer.field_unit),
    }
    lines: list[str] = []
    for name, (triad, physical) in triads.items():
        if triad is not None:
            bias = triad.bias.astype(np.float32)
            lines += [
                f"/* S^-1 of the {name} [{physical} per {triad.unit}] */",
                _matrix(f"gnomon_{imu}_{name}_correction", invert_matrix(triad.sensitivity)),
                f"/* b of the {name} [{triad.unit}], the sum of two floats */",
                _vector(f"gnomon_{imu}_{name}_bias", bias.astype(np.float64)),
                _vector(f"gnomon_{imu}_{name}_bias_rest", triad.bias - bias),
            ]
    if calibration.gyroscope is not None:
        lines.append(f"/* G [{calibration.gyroscope.unit} per m/s^2] */")
        lines.append(_matrix(f"gnomon_{imu}_g_sensitivity", calibration.gyroscope.g_sensitivity))
    return "\n".join(lines) + "\n"


def _function(imu: str, calibration: ImuCalibration) -> str:
    """Return the function of accelerometer and gyroscope; of a gyroscope alone it takes the specific force."""
    accelerometer, gyroscope = calibration.accelerometer, calibration.gyroscope
    samples, results, meant, units, body = list[str](), list[str](), list[str](), list[str](), ""
    if accelerometer is not None:
        samples.append("const gnomon_real accelerometer[3]")
        results.append("gnomon_real force[3]")
        meant.append("specific force [m/s^2]")
        units.append(accelerometer.unit)
        body += _OFFSET.format(imu=imu) + _product(imu, "accelerometer", "force")
    note = "Samples and results are x, y, z of one instant."
    if gyroscope is not None:
        samples.append("const gnomon_real gyroscope[3]")
        results.append("gnomon_real rate[3]")
        meant.append("angular rate [rad/s]")
        units += [gyroscope.unit] if gyroscope.unit not in units else []
        body += _OFFSET_WITH_FORCE.format(imu=imu) + _product(imu, "gyroscope", "rate")
        if accelerometer is None:
            samples.append("const gnomon_real force[3]")
            note += " force is the specific force [m/s^2] in the body frame."
    return _FUNCTION.format(
        imu=imu, units=" and ".join(units), results=" and ".join(meant), notes=note, suffix="",
        arguments=", ".join([*samples, *results]), body=body,
    )  # fmt: skip


def _temperature_functions(imu: str, found: TemperatureDependence) -> Iterator[str]:
    """Yield the functions that take samples to the reference: a magnetometer's come at times of their own."""
    parts = dict(found.parts())
    magnetic = {part: parts.pop(part) for part in list(parts) if part.startswith("magnetometer")}
    for own, suffix in ((parts, ""), (magnetic, "_magnetometer")):
        if own:
            yield _temperature_function(imu, found, own, suffix)


def _temperature_function(imu: str, found: TemperatureDependence, parts: Mapping[str, Floats], suffix: str) -> str:
    body, constants, after = "", "", ""
    for part, coefficients in parts.items():
        triad, kind = part.split("_", 1)
        name = f"gnomon_{imu}_{triad}_{'' if kind == 'bias' else f'{kind}_'}by_temperature"
        if kind == "bias":
            rows = ", ".join(map(_row, coefficients))
            constants += f"static const gnomon_real {name}[{len(coefficients)}][3] = {{{rows}}};\n"
            body += f"        {triad}[i] -= d * {_polynomial(name, len(coefficients), '[i]')};\n"
            continue
        matrices = ", ".join("{" + ", ".join(map(_row, matrix)) + "}" for matrix in coefficients)
        constants += f"static const gnomon_real {name}[{len(coefficients)}][3][3] = {{{matrices}}};\n"
        change = _polynomial(name, len(coefficients), "[i][j]")
        if kind == "g_sensitivity":
            after += _FELT.format(imu=imu, triad=triad, change=change)
        else:
            times = _repetitions(found.change(part, np.array([found.low_degc, found.high_degc])))
            after += _SENSITIVITY.format(imu=imu, triad=triad, change=change, times=times)
    needed = ("accelerometer",) if "gyroscope_g_sensitivity" in parts else ()
    triads = dict.fromkeys([*needed, *(part.split("_")[0] for part in parts)])
    return constants + _TEMPERATURE.format(
        imu=imu, suffix=suffix, low=found.low_degc, high=found.high_degc, low_literal=_literal(found.low_degc),
        high_literal=_literal(found.high_degc), reference=_literal(found.reference_degc),
        body=f"    for (int i = 0; i < 3; ++i) {{\n{body}    }}\n{after}" if body else after,
        arguments=", ".join(f"gnomon_real {triad}[3]" for triad in triads),
    )  # fmt: skip


def _repetitions(changes: Floats) -> int:
    """Return how often x = y - D x is repeated until D (2, 3, 3) to that power is below what a double rounds."""
    largest = min(float(np.linalg.norm(changes, ord=2, axis=(1, 2)).max()), 0.5)
    return max(7, int(np.ceil(np.log(1e-14) / np.log(max(largest, 1e-14)))))


def _polynomial(name: str, order: int, at: str) -> str:
    """Return what a polynomial of d is over d, by Horner's scheme."""
    change = f"{name}[{order - 1}]{at}"
    for j in range(order - 2, -1, -1):
        change = f"({name}[{j}]{at} + d * {change})"
    return change


def _magnetometer_function(imu: str, unit: str, field_unit: str) -> str:
    body = _OFFSET.format(imu=imu).replace("accelerometer", "magnetometer") + _product(imu, "magnetometer", "field")
    return _FUNCTION.format(
        imu=imu, units=unit, results=f"magnetic field [{field_unit}]", suffix="_magnetometer", body=body,
        notes="Samples and results are x, y, z.", arguments="const gnomon_real magnetometer[3], gnomon_real field[3]",
    )  # fmt: skip


def _product(imu: str, triad: str, result: str) -> str:
    return _PRODUCT.format(imu=imu, triad=triad, result=result, pad=" " * (len(result) - 1))


def _vector(name: str, values: Floats) -> str:
    return f"static const gnomon_real {name}[3] = {_row(values)};"


def _matrix(name: str, values: Floats) -> str:
    return f"static const gnomon_real {name}[3][3] = {{\n    " + ",\n    ".join(map(_row, values)) + "\n};"


def _row(values: Floats) -> str:
    return "{" + ", ".join(_literal(value) for value in values.tolist()) + "}"


def _literal(value: float) -> str:
    text = repr(float(value))
    return f"GNOMON_R({text if any(c in text for c in '.e') else f'{text}.0'})"
