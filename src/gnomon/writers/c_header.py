"""C99 (and C++): one header with the numbers and an inline function for each IMU, in single precision.

A bias of 33124.1825 counts loses two thousandths of a count in a float; it is therefore kept as the sum of two floats,
whose differences to a sample of similar size are exact.
"""

import re

import numpy as np

from ..calibration import Calibration, ImuCalibration
from ..models.forms import inverse
from ..recording import Floats
from .calibration_file import FRAMES
from .export import Export, Loss, camera_losses, uncertainty_loss

_HEAD = """\
/* Calibration of an inertial sensor as C code, made by gnomon.
 *
 * With specific force f [m/s^2] and angular rate w [rad/s] in the body frame, the sensor reads
 *   accelerometer = S f + b,   gyroscope = S w + b + G f,
 * so that
 *   f = S^-1 (accelerometer - b),   w = S^-1 (gyroscope - b - G f).
 * Body frame: {frame}.
 */
#ifndef GNOMON_IMU_H
#define GNOMON_IMU_H
"""

_FUNCTION = """\
/* {imu}: from samples in {units} to specific force [m/s^2]{and_rate} in the body frame.
 * Samples and results are x, y, z of one instant. */
static inline void gnomon_{imu}_apply({arguments})
{{
    float d[3];
    for (int i = 0; i < 3; ++i)
        d[i] = (accelerometer[i] - gnomon_{imu}_accelerometer_bias[i]) - gnomon_{imu}_accelerometer_bias_rest[i];
    for (int i = 0; i < 3; ++i)
        force[i] = gnomon_{imu}_accelerometer_correction[i][0] * d[0]
                 + gnomon_{imu}_accelerometer_correction[i][1] * d[1]
                 + gnomon_{imu}_accelerometer_correction[i][2] * d[2];
{gyroscope}}}
"""

_GYROSCOPE = """\
    for (int i = 0; i < 3; ++i)
        d[i] = ((gyroscope[i] - gnomon_{imu}_gyroscope_bias[i]) - gnomon_{imu}_gyroscope_bias_rest[i])
             - (gnomon_{imu}_g_sensitivity[i][0] * force[0]
              + gnomon_{imu}_g_sensitivity[i][1] * force[1]
              + gnomon_{imu}_g_sensitivity[i][2] * force[2]);
    for (int i = 0; i < 3; ++i)
        rate[i] = gnomon_{imu}_gyroscope_correction[i][0] * d[0]
                + gnomon_{imu}_gyroscope_correction[i][1] * d[1]
                + gnomon_{imu}_gyroscope_correction[i][2] * d[2];
"""


def export(calibration: Calibration) -> Export:
    """Return `gnomon_imu.h` with a function `gnomon_imu0_apply` for each IMU."""
    frame = f"{calibration.frame}, {FRAMES.get(calibration.frame, FRAMES['user'])}"
    parts = [_HEAD.format(frame=frame.replace("*/", "* /"))]
    for name, imu in calibration.imus.items():
        identifier = re.sub(r"\W", "_", name, flags=re.ASCII)
        parts += [_constants(identifier, imu), _function(identifier, imu)]
    text = "\n".join([*parts, "#endif\n"])
    rounding = Loss(
        what="precision", why="the numbers are floats; csv and calibration.yaml hold more.", size="6e-8 relative"
    )
    losses = (*camera_losses(calibration, "the C header"), rounding, uncertainty_loss("the C header"))
    return Export(files={"gnomon_imu.h": text}, losses=losses)


def _constants(imu: str, calibration: ImuCalibration) -> str:
    triads = {"accelerometer": calibration.accelerometer, "gyroscope": calibration.gyroscope}
    lines: list[str] = []
    for name, triad in triads.items():
        if triad is not None:
            bias = triad.bias.astype(np.float32)
            lines += [
                f"/* S^-1 of the {name} [{'m/s^2' if name == 'accelerometer' else 'rad/s'} per {triad.unit}] */",
                _matrix(f"gnomon_{imu}_{name}_correction", inverse(triad.sensitivity)),
                f"/* b of the {name} [{triad.unit}], the sum of two floats */",
                _vector(f"gnomon_{imu}_{name}_bias", triad.bias),
                _vector(f"gnomon_{imu}_{name}_bias_rest", triad.bias - bias),
            ]
    if calibration.gyroscope is not None:
        lines.append(f"/* G [{calibration.gyroscope.unit} per m/s^2] */")
        lines.append(_matrix(f"gnomon_{imu}_g_sensitivity", calibration.gyroscope.g_sensitivity))
    return "\n".join(lines) + "\n"


def _function(imu: str, calibration: ImuCalibration) -> str:
    units = [calibration.accelerometer.unit]
    arguments, gyroscope, and_rate = "const float accelerometer[3], float force[3]", "", ""
    if calibration.gyroscope is not None:
        arguments = "const float accelerometer[3], const float gyroscope[3], float force[3], float rate[3]"
        gyroscope, and_rate = _GYROSCOPE.format(imu=imu), " and angular rate [rad/s]"
        units += [calibration.gyroscope.unit] if calibration.gyroscope.unit not in units else []
    return _FUNCTION.format(
        imu=imu, units=" and ".join(units), and_rate=and_rate, arguments=arguments, gyroscope=gyroscope
    )


def _vector(name: str, values: Floats) -> str:
    return f"static const float {name}[3] = {_row(values)};"


def _matrix(name: str, values: Floats) -> str:
    return f"static const float {name}[3][3] = {{\n    " + ",\n    ".join(map(_row, values)) + "\n};"


def _row(values: Floats) -> str:
    return "{" + ", ".join(_literal(value) for value in values.tolist()) + "}"


def _literal(value: float) -> str:
    text = f"{float(np.float32(value)):.9g}"
    return f"{text}f" if any(c in text for c in ".e") else f"{text}.0f"
