"""Units of derived quantities, as people write them."""

from ..calibration import Calibration

_SI = {"accelerometer": "m/s^2", "gyroscope": "rad/s"}


def parameter_unit(calibration: Calibration, path: str) -> str:
    """Return the unit of a parameter by its path, such as "count/(m/s^2)" for "imu0.accelerometer.sensitivity"."""
    name, triad, parameter = path.split(".")
    imu = calibration.imus[name]
    sensor = imu.accelerometer if triad == "accelerometer" else imu.gyroscope
    assert sensor is not None
    if parameter == "bias":
        return sensor.unit
    return per(sensor.unit, "m/s^2" if parameter == "g_sensitivity" else _SI[triad])


def per(unit: str, other: str) -> str:
    """Return `unit` divided by `other`.

    Examples
    --------
    >>> per("count", "m/s^2"), per("rad/s", "rad/s"), per("m/s^2", "count")
    ('count/(m/s^2)', '1', '(m/s^2)/count')
    """
    if unit == other:
        return "1"
    return "/".join(f"({part})" if "/" in part else part for part in (unit, other))
