"""gnomon's own calibration file, schema "gnomon/1"; `readers.calibration_file` reads it.

Matrices stand row by row, numbers read back bit by bit, and the same calibration gives the same bytes.
"""

import math
from os import PathLike
from typing import Any

import numpy as np

from ..calibration import Assessment, Calibration, Covariance, parameters
from ..errors import OutputError
from ..output import write_whole
from ..readers.calibration_file import SCHEMA_MAJOR, SCHEMA_MINOR
from .yaml_text import yaml_lines

FRAMES = {
    "accel-x": "x along the sensitivity axis of the x accelerometer, the axis of the y accelerometer in the x-y plane",
    "accel-z": "z along the sensitivity axis of the z accelerometer, the axis of the y accelerometer in the y-z plane",
    "user": "the axes that its owner named",
}
"""Body frames in words."""

_HEADER = """\
# Calibration of an inertial sensor, made by gnomon.
#
# With specific force f [m/s^2] and angular rate w [rad/s] in the body frame, the sensor reads, in its `unit`,
#
#     accelerometer = sensitivity * f + bias
#     gyroscope     = sensitivity * w + bias + g_sensitivity * f
#
# so that f = sensitivity^-1 (accelerometer - bias), and w = sensitivity^-1 (gyroscope - bias - g_sensitivity * f).
# Units: sensitivity in unit per m/s^2 (accelerometer) or unit per rad/s (gyroscope), bias in unit, g_sensitivity in
# unit per m/s^2. Matrices have a row for each sensor axis and a column for each body axis.
# Body frame: {frame}.
# Every *_sigma is one standard deviation, and the square root of the covariance's diagonal at the end of this file.
"""


def save(calibration: Calibration, path: str | PathLike[str]) -> None:
    """Write a calibration to gnomon's own YAML file; a second run writes the same bytes.

    Raises
    ------
    OutputError
        If the file cannot be written, or a parameter is not a finite number.
    """
    write_whole(path, calibration_text(calibration))


def calibration_text(calibration: Calibration) -> str:
    """Return the text of the calibration file.

    Raises
    ------
    OutputError
        If a parameter is not a finite number.
    """
    for name, value in parameters(calibration.imus):
        if not np.isfinite(value).all():
            raise OutputError(f"{name} is not a finite number: this calibration is of no use and was not written.")
    if calibration.cameras:
        raise OutputError("this calibration holds cameras, which the schema gnomon/1 does not know.")
    header = _HEADER.format(frame=f"{calibration.frame}, {FRAMES.get(calibration.frame, FRAMES['user'])}")
    return header + "\n" + "\n".join(yaml_lines(_document(calibration))) + "\n"


def _document(calibration: Calibration) -> dict[str, Any]:
    minor = f".{SCHEMA_MINOR}" if SCHEMA_MINOR else ""
    gravity, provenance = calibration.gravity, calibration.provenance
    origin: dict[str, Any] = {
        "gnomon_version": provenance.gnomon_version,
        "method": provenance.method,
        "inputs": [{"name": source.name, "sha256": source.sha256} for source in provenance.inputs],
        "options": dict(provenance.options),
    }
    if provenance.seed is not None:
        origin["seed"] = provenance.seed
    return {
        "schema": f"gnomon/{SCHEMA_MAJOR}{minor}",
        "verdict": calibration.verdict,
        "body_frame": calibration.frame,
        "gravity": {"value": gravity.value, "sigma": gravity.sigma, "source": gravity.source},
        "imus": _imus(calibration),
        "cameras": {},
        "assessment": _assessment(calibration.assessment),
        "provenance": origin,
        "covariance": _covariance(calibration.uncertainty),
    }


def _imus(calibration: Calibration) -> dict[str, Any]:
    result: dict[str, Any] = {}
    for name, imu in calibration.imus.items():
        result[name] = {"accelerometer": {"unit": imu.accelerometer.unit}}
        if imu.gyroscope is not None:
            result[name]["gyroscope"] = {"unit": imu.gyroscope.unit}
    for path, value in parameters(calibration.imus):
        imu, triad, parameter = path.split(".")
        result[imu][triad][parameter] = value
        result[imu][triad][f"{parameter}_sigma"] = calibration.sigma(path)
    return result


def _assessment(assessment: Assessment) -> dict[str, Any]:
    rms = assessment.holdout.accelerometer_rms, assessment.holdout.rotation_rms
    return {
        "verdict": assessment.verdict,
        "model": assessment.model,
        "holdout": {
            "accelerometer_rms": rms[0] if math.isfinite(rms[0]) else None,
            "rotation_rms": rms[1] if math.isfinite(rms[1]) else None,
        },
        "intervals_found": assessment.intervals_found,
        "intervals_used": assessment.intervals_used,
        "rotations_found": assessment.rotations_found,
        "rotations_used": assessment.rotations_used,
        "held_by_prior": list(assessment.held_by_prior),
        "findings": [
            {
                key: getattr(finding, key)
                for key in ("severity", "code", "message", "consequence", "cure")
                if getattr(finding, key) or key in ("severity", "code", "message")
            }
            for finding in assessment.findings
        ],
    }


def _covariance(covariance: Covariance) -> dict[str, Any]:
    rows = [covariance.matrix[i, : i + 1] for i in range(len(covariance.names))]
    return {"names": list(covariance.names), "lower_triangle": rows}
