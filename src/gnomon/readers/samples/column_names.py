"""What the name of a column says: which quantity, which axis, which unit."""

import re
from dataclasses import dataclass
from typing import Literal

Quantity = Literal["time", "accelerometer", "gyroscope", "magnetometer", "unnamed", "other"]


def _words(text: str) -> frozenset[str]:
    return frozenset(text.split())


_AXES = {"x": 0, "y": 1, "z": 2}
_ACCELEROMETER = _words("a acc accl accel accelero accelerometer acceleration linacc alpha f sf specific force")
_GYROSCOPE = _words("g gyr gyro gyroscope w omega angular angvel rate rot rotation")
_MAGNETOMETER = _words("m mag magn magnet magnetic magneto magnetometer compass")
_TIME = _words(
    "t ts time times timestamp timestamps stamp stamps epoch epoc elapsed sec secs seconds nsec nsecs nanosec"
)
_SENSORS: dict[Quantity, frozenset[str]] = {
    "accelerometer": _ACCELEROMETER,
    "gyroscope": _GYROSCOPE,
    "magnetometer": _MAGNETOMETER,
}
# Columns of these are something else, even if the name of a sensor is in them too.
_OTHER = _words(
    "covariance cov std stddev var variance bias offset orientation quaternion quat gravity user temperature temp"
)

_COUNT = dict.fromkeys(_words("count counts lsb raw adc digit digits bit bits"), "count")
_UNITS: dict[str, dict[str, str]] = {
    "accelerometer": {
        **dict.fromkeys(_words("ms2 mps2 mss msec2 metrespersecondsquared meterspersecondsquared"), "m/s^2"),
        **dict.fromkeys(_words("g gs g0 gn gee"), "g"),
        **dict.fromkeys(_words("mg millig mgs"), "mg"),
        **_COUNT,
    },
    "gyroscope": {
        **dict.fromkeys(_words("rads rads1 radps rad radsec radianspersecond"), "rad/s"),
        **dict.fromkeys(_words("degs degs1 dps degps deg degsec degreespersecond"), "deg/s"),
        **dict.fromkeys(_words("mdegs mdps mdegs1 millidps"), "mdeg/s"),
        **_COUNT,
    },
    "magnetometer": {
        **dict.fromkeys(_words("ut utesla microtesla microteslas"), "uT"),
        **dict.fromkeys(_words("nt ntesla nanotesla nanoteslas"), "nT"),
        **dict.fromkeys(_words("t tesla teslas"), "T"),
        **dict.fromkeys(_words("g ga gs gauss"), "gauss"),
        **dict.fromkeys(_words("mg mga mgauss milligauss"), "mgauss"),
        **_COUNT,
    },
    "time": {
        **dict.fromkeys(_words("s sec secs second seconds"), "s"),
        **dict.fromkeys(_words("ms msec msecs millis milliseconds"), "ms"),
        **dict.fromkeys(_words("us usec usecs micros microseconds"), "us"),
        **dict.fromkeys(_words("ns nsec nsecs nanosec nanos nanoseconds"), "ns"),
    },
}


_LONGEST = 400
"""Characters of a name that are looked at; no name is so long."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ColumnName:
    """A column's name, understood.

    Attributes
    ----------
    quantity : what is in the column; "unnamed" for a bare axis such as "x", whose sensor the name does not tell
    axis : 0, 1, 2 for x, y, z; None for time and other columns
    unit : a unit of `gnomon.units`, or None where the name does not tell it
    """

    quantity: Quantity
    axis: int | None = None
    unit: str | None = None


OTHER = ColumnName(quantity="other")


def unit_of(text: str, quantity: str) -> str | None:
    """Return the unit that `text` spells for a quantity, or None.

    Examples
    --------
    >>> unit_of("m s^-2", "accelerometer"), unit_of("°/s", "gyroscope"), unit_of("V", "gyroscope")
    ('m/s^2', 'deg/s', None)
    """
    plain = text.lower().replace("²", "2").replace("°", "deg").replace("µ", "u").replace("μ", "u")
    return _UNITS.get(quantity, {}).get(re.sub(r"[^a-z0-9]", "", plain))


def column_name(text: str) -> ColumnName:
    """Understand the name of a column in any common spelling.

    Examples
    --------
    >>> column_name("w_RS_S_y [rad s^-1]")
    ColumnName(quantity='gyroscope', axis=1, unit='rad/s')
    >>> column_name("linear_acceleration.z")
    ColumnName(quantity='accelerometer', axis=2, unit=None)
    >>> column_name("timestamp_us")
    ColumnName(quantity='time', axis=None, unit='us')
    """
    text = text[:_LONGEST]
    bracket = re.search(r"[\[(]([^\])]*)[\])]", text)
    inside = bracket.group(1).strip() if bracket else ""
    bare = text[: bracket.start()] + " " + text[bracket.end() :] if bracket else text
    words = [word.lower() for word in re.findall(r"[A-Z]+(?![a-z])|[A-Z]?[a-zµμ]+|\d+", bare)]
    words = [word for word in words if word != "axis"]
    if not words or _OTHER.intersection(words):
        return OTHER
    found = _axis(words, inside)
    if found is not None:
        return _triad_column(*found, inside)
    if _TIME.intersection(words):
        return ColumnName(
            quantity="time", unit=unit_of(inside, "time") or unit_of(words[-1], "time") or _time_word(words)
        )
    return OTHER


def _axis(words: list[str], inside: str) -> tuple[int, list[str], list[str]] | None:
    """Return (axis, words that name the sensor, words behind them that may be a unit)."""
    for i, word in enumerate(words):
        if word in _AXES:
            before = words[:i]
            return (_AXES[word], before, words[i + 1 :]) if before else (_AXES[word], words[1:], [])
        for stem, axis in ((word[:-1], word[-1]), (word[1:], word[0])):  # "ax", "gyrox"; "xacc"
            known = any(stem in names for names in _SENSORS.values())
            if axis in _AXES and known and not (stem == word[1:] and len(stem) == 1):
                return _AXES[axis], [stem], words[i + 1 :]
    if inside in {"0", "1", "2"}:  # "accelerometer_m_s2[0]"
        return int(inside), words[:1], words[1:]
    return None


def _triad_column(axis: int, names: list[str], behind: list[str], inside: str) -> ColumnName:
    # A single letter names a sensor only in front: "a_RS_S_x", but not "imu_a".
    telling = {word for i, word in enumerate(names) if len(word) > 1 or i == 0}
    sensors: list[Quantity] = [quantity for quantity, known in _SENSORS.items() if telling & known]
    if len(sensors) > 1:
        return OTHER
    if not sensors:
        return OTHER if names else _bare_axis(axis, inside)
    (quantity,) = sensors
    unit = unit_of(inside, quantity) or unit_of("".join(behind), quantity)
    return ColumnName(quantity=quantity, axis=axis, unit=unit)


def _bare_axis(axis: int, inside: str) -> ColumnName:
    for quantity in _SENSORS:
        unit = unit_of(inside, quantity)
        if unit is not None and unit != "count":
            return ColumnName(quantity=quantity, axis=axis, unit=unit)
    return ColumnName(quantity="unnamed", axis=axis)


def _time_word(words: list[str]) -> str | None:
    return next((unit for word in words if len(word) > 1 and (unit := unit_of(word, "time"))), None)
