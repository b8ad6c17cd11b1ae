"""What a calibration rests on, and how well it predicts what it has not seen: the words for each kind of it."""

from collections.abc import Iterator
from math import isfinite

from ..results.calibration import Calibration


def counted_things(calibration: Calibration) -> str:
    """Return what `intervals_found` and `intervals_used` of the assessment count, such as "poses"."""
    if calibration.provenance.method == "turntable":
        return "steady parts"
    if calibration.provenance.method == "magnetometer":
        return "stretches"
    return "static intervals" if calibration.assessment.rotations_found else "poses"


def modelled_thing(calibration: Calibration) -> str:
    """Return what the model of the assessment is one of: "IMU", "gyroscope" or "magnetometer"."""
    if calibration.assessment.camera_imu is not None:
        return "IMU"
    if not calibration.imus:
        return "lens"
    return "magnetometer" if calibration.provenance.method == "magnetometer" else "gyroscope"


def rests_on_gravity(calibration: Calibration) -> bool:
    """Tell whether the magnitude of gravity has a part in any parameter."""
    return any(
        imu.accelerometer is not None or (imu.gyroscope is not None and bool(imu.gyroscope.g_sensitivity.any()))
        for imu in calibration.imus.values()
    )


def held_out_errors(calibration: Calibration) -> Iterator[tuple[str, str, float, str]]:
    """Yield (sensor, what was compared, rms, unit) of every hold-out error data that is known.

    Errors of the magnetic field are in percent of the local field.
    """
    holdout = calibration.assessment.holdout
    for found in (
        ("accelerometer", "|f| - g", holdout.accelerometer_rms, "m/s^2"),
        ("rotations", "rotations", holdout.rotation_rms, "rad"),
        ("gyroscope", "|w| - rate", holdout.rate_rms, "rad/s"),
        ("magnetometer", "|m| - field", 100 * holdout.field_rms, "%"),
    ):
        if isfinite(found[2]):
            yield found
