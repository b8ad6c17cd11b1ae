"""Units of measured values, and what one of them is in SI.

Samples keep the unit in which they were recorded; a calibration maps that unit to SI. Conversion happens
nowhere else, so that raw counts, g and m/s^2 are the same problem with other numbers.
"""

import re
from math import isfinite, pi
from typing import Literal, Self

from .errors import OptionError
from .frozen import value_class

STANDARD_GRAVITY_M_S2 = 9.80665
"""Standard gravity, the definition of the unit g [m/s^2]."""

AccelerometerUnit = Literal["m/s^2", "g", "mg", "count"]
GyroscopeUnit = Literal["rad/s", "deg/s", "mdeg/s", "count"]
MagnetometerUnit = Literal["uT", "nT", "T", "gauss", "mgauss", "count"]
TimeUnit = Literal["s", "ms", "us", "ns"]

ACCELEROMETER_UNITS_M_S2: dict[str, float | None] = {
    "m/s^2": 1.0,
    "g": STANDARD_GRAVITY_M_S2,
    "mg": 1e-3 * STANDARD_GRAVITY_M_S2,
    "count": None,
}
"""One unit in m/s^2; None where only a calibration can tell."""

GYROSCOPE_UNITS_RAD_S: dict[str, float | None] = {
    "rad/s": 1.0,
    "deg/s": pi / 180,
    "mdeg/s": 1e-3 * pi / 180,
    "count": None,
}
"""One unit in rad/s; None where only a calibration can tell."""

MAGNETOMETER_UNITS_UT: dict[str, float | None] = {
    "uT": 1.0,
    "nT": 1e-3,
    "T": 1e6,
    "gauss": 100.0,
    "mgauss": 0.1,
    "count": None,
}
"""One unit in microtesla; None where only a calibration can tell."""

TEMPERATURE_UNITS_DEGC: dict[str, tuple[float, float] | None] = {
    "degC": (1.0, 0.0),
    "K": (1.0, -273.15),
    "degF": (5 / 9, -160 / 9),
    "MPU-6050 count": (1 / 340, 36.53),
    "MPU-9250 count": (1 / 333.87, 21.0),
    "ICM-20948 count": (1 / 333.87, 21.0),
    "ICM-42688 count": (1 / 132.48, 25.0),
    "LSM6DSO count": (1 / 256, 25.0),
    "BMI270 count": (1 / 512, 23.0),
    "BMI088 count": (0.125, 23.0),
    "count": None,
}
"""Factor and offset that make degrees Celsius of a value, of chips by their data sheets; None where nobody tells."""

TIME_UNITS_NS: dict[str, int] = {"s": 1_000_000_000, "ms": 1_000_000, "us": 1_000, "ns": 1}
"""One unit in nanoseconds."""


@value_class(eq=True)
class Units:
    """Units of a recording as stated by its owner; None where they are to be recognised.

    Attributes
    ----------
    accelerometer : "m/s^2", "g", "mg" or "count"
    gyroscope : "rad/s", "deg/s", "mdeg/s" or "count"
    time : "s", "ms", "us" or "ns"
    magnetometer : "uT", "nT", "T", "gauss", "mgauss" or "count"
    """

    accelerometer: AccelerometerUnit | None = None
    gyroscope: GyroscopeUnit | None = None
    time: TimeUnit | None = None
    magnetometer: MagnetometerUnit | None = None

    @classmethod
    def parse(cls, text: str) -> Self:
        """Read "si", "raw" or a list such as "g deg/s us", in any order.

        Raises
        ------
        OptionError
            If a word is no unit, or two words are units of the same quantity.

        Examples
        --------
        >>> Units.parse("si")
        Units(accelerometer='m/s^2', gyroscope='rad/s', time=None, magnetometer='uT')
        >>> Units.parse("g deg/s us")
        Units(accelerometer='g', gyroscope='deg/s', time='us', magnetometer=None)
        """
        if text == "si":
            return cls(accelerometer="m/s^2", gyroscope="rad/s", magnetometer="uT")
        if text == "raw":
            return cls(accelerometer="count", gyroscope="count", magnetometer="count")
        found: dict[str, str] = {}
        tables = {
            "accelerometer": ACCELEROMETER_UNITS_M_S2,
            "gyroscope": GYROSCOPE_UNITS_RAD_S,
            "time": TIME_UNITS_NS,
            "magnetometer": MAGNETOMETER_UNITS_UT,
        }
        for word in text.replace(",", " ").replace("m/s2", "m/s^2").split():
            quantities = [name for name, table in tables.items() if word in table and word != "count"]
            if len(quantities) != 1 or quantities[0] in found:
                problem = "given twice for one quantity" if quantities else "not a unit"
                known = ", ".join(unit for table in tables.values() for unit in table if unit != "count")
                raise OptionError(f'units "{text}": "{word}" is {problem}. Write "si", "raw", or a list of: {known}.')
            found[quantities[0]] = word
        return cls(**found)  # pyright: ignore[reportArgumentType]


ROTATION_UNITS_RAD_S = {"rpm": pi / 30, "rad/s": 1.0, "deg/s": pi / 180, "Hz": 2 * pi}
"""One unit of a platter's rate in rad/s; Hz are turns a second."""

FASTEST_RAD_S = 1000.0
"""No platter turns faster [rad/s]."""

_NUMBER_AND_UNIT = re.compile(r"\s*([-+]?[\d.]+(?:e[-+]?\d+)?)\s*(.*?)\s*", re.IGNORECASE)


def parse_rate(text: str) -> float:
    """Return how fast a platter turns, as in "33.33rpm", in rad/s.

    Raises
    ------
    OptionError
        If it is not a number, zero or more, with one of the units rpm, rad/s, deg/s and Hz.

    Examples
    --------
    >>> round(parse_rate("16rpm"), 6)
    1.675516
    >>> parse_rate("2.0 rad/s")
    2.0
    """
    units = {unit.lower(): factor for unit, factor in ROTATION_UNITS_RAD_S.items()} | {"°/s": pi / 180}
    match = _NUMBER_AND_UNIT.fullmatch(text)
    expected = 'Write a number and a unit, such as "33.33rpm", "2.0rad/s", "90deg/s" or "0.5Hz".'
    if match is None:
        raise OptionError(f'rate "{text}": there is no number in front. {expected}')
    try:
        number = float(match[1])
    except ValueError:
        raise OptionError(f'rate "{text}": "{match[1]}" is not a number. {expected}') from None
    if match[2].lower() not in units:
        what = f'"{match[2]}" is not a unit of it' if match[2] else "the unit is missing"
        raise OptionError(f'rate "{text}": {what}. {expected}')
    if not (isfinite(number) and number >= 0):
        raise OptionError(f'rate "{text}": it must not be negative; the direction does not matter. {expected}')
    rate_rad_s = number * units[match[2].lower()]
    if rate_rad_s > FASTEST_RAD_S:
        raise OptionError(f'rate "{text}": no platter turns by more than {FASTEST_RAD_S:g} rad/s. {expected}')
    return rate_rad_s
