"""What the name of a column says: which quantity, which axis, which unit."""

import re
from dataclasses import replace
from typing import Literal

from ...errors import OptionError, RecordingError
from ...frozen import value_class
from .recognise import column_counts, columns_help
from .text_table import TextLayout, column_rises, is_number

Quantity = Literal["time", "accelerometer", "gyroscope", "magnetometer", "temperature", "unnamed", "other"]


def _words(text: str) -> frozenset[str]:
    return frozenset(text.split())


_AXES = {"x": 0, "y": 1, "z": 2}
_ACCELEROMETER = _words(
    "a ac acc accm acce accl accel accelero accelerometer acceleration linacc alpha f sf specific force"
)
_GYROSCOPE = _words("g gy gyr gyrm gyro gyroscope w omega angular angvel rate rot rotation")
_MAGNETOMETER = _words("m mag magn magnet magnetic magneto magnetometer compass")
_TIME = _words(
    "t ts time times timestamp timestamps stamp stamps epoch epoc elapsed sec secs seconds nsec nsecs nanosec "
    "millis micros ticks tow cts"
)
_SENSORS: dict[Quantity, frozenset[str]] = {
    "accelerometer": _ACCELEROMETER,
    "gyroscope": _GYROSCOPE,
    "magnetometer": _MAGNETOMETER,
}
# Columns of these are something else, even if the name of a sensor is in them too.
_OTHER = _words("covariance cov std stddev var variance bias offset orientation quaternion quat gravity user angle")
_EMPTY = _words("axis value")
_TEMPERATURE = _words("temperature temp tmp")

_COUNT = dict.fromkeys(_words("count counts lsb raw adc digit digits bit bits"), "count")
_UNITS: dict[str, dict[str, str]] = {
    "accelerometer": {
        **dict.fromkeys(_words("ms2 mps2 mss msec2 metrespersecondsquared meterspersecondsquared"), "m/s^2"),
        **dict.fromkeys(_words("g gs g0 gn gee"), "g"),
        **dict.fromkeys(_words("mg millig mgs"), "mg"),
        **_COUNT,
    },
    "gyroscope": {
        **dict.fromkeys(_words("rads rads1 radps rad radsec radpersec radianspersecond radianss"), "rad/s"),
        **dict.fromkeys(_words("degs degs1 dps degps deg degsec degreespersecond degreess"), "deg/s"),
        **dict.fromkeys(_words("mdegs mdps mdegs1 millidps"), "mdeg/s"),
        **_COUNT,
    },
    "magnetometer": {
        **dict.fromkeys(_words("ut microt utesla microtesla microteslas"), "uT"),
        **dict.fromkeys(_words("nt ntesla nanotesla nanoteslas"), "nT"),
        **dict.fromkeys(_words("t tesla teslas"), "T"),
        **dict.fromkeys(_words("g ga gs gauss"), "gauss"),
        **dict.fromkeys(_words("mg mga mgauss milligauss"), "mgauss"),
        **_COUNT,
    },
    "temperature": {
        **dict.fromkeys(_words("c degc celsius degcelsius degreec degreescelsius"), "degC"),
        **dict.fromkeys(_words("k kelvin"), "K"),
        **dict.fromkeys(_words("f degf fahrenheit degfahrenheit"), "degF"),
        **dict.fromkeys(_words("mpu6050 mpu6000"), "MPU-6050 count"),
        **dict.fromkeys(_words("mpu9250 mpu9255"), "MPU-9250 count"),
        **{f"{chip.lower()}{number}": f"{chip}-{number} count" for chip, number in (("ICM", 20948), ("ICM", 42688))},
        **{chip.lower(): f"{chip} count" for chip in ("LSM6DSO", "BMI270", "BMI088")},
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


@value_class(eq=True)
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
    text = re.sub(r"[\[(]([xyzXYZ])[\])]", r" \1 ", text[:_LONGEST]).replace("ang_vel", "angvel")
    bracket = re.search(r"[\[(]([^\])]*)[\])]", text)
    inside = bracket.group(1).strip() if bracket else ""
    bare = text[: bracket.start()] + " " + text[bracket.end() :] if bracket else text
    words = [word.lower() for word in re.findall(r"[A-Z]+(?![a-z])|[A-Z]?[a-zµμ]+|\d+", bare)]
    words = [word for word in words if word not in _EMPTY]
    if not words or _OTHER.intersection(words):
        return OTHER
    warmth = _temperature(words, inside)
    if warmth is not None:
        return warmth
    found = _axis(words, inside)
    if found is not None:
        return _triad_column(*found, inside)
    if words[-3:] == ["sample", "time", "fine"]:  # of Xsens
        return ColumnName(quantity="time", unit="100us")
    if _TIME.intersection(words) or words in (["ms"], ["us"]):
        return ColumnName(
            quantity="time", unit=unit_of(inside, "time") or unit_of(words[-1], "time") or _time_word(words)
        )
    return OTHER


def _temperature(words: list[str], inside: str) -> ColumnName | None:
    """Return what "temp_degC" and "T (°C)" are; None for what is no temperature."""
    unit = unit_of(inside, "temperature")
    if _TEMPERATURE.intersection(words):
        last = max(i for i, word in enumerate(words) if word in _TEMPERATURE)
        return ColumnName(quantity="temperature", unit=unit or unit_of("".join(words[last + 1 :]), "temperature"))
    if words == ["t"] and inside and unit_of(inside, "time") is None:
        return OTHER if unit is None else ColumnName(quantity="temperature", unit=unit)
    return None


def _axis(words: list[str], inside: str) -> tuple[int, list[str], list[str]] | None:
    """Return (axis, words that name the sensor, words behind them that may be a unit)."""
    for i, word in enumerate(words):
        if word in _AXES:
            before = words[:i]
            return (_AXES[word], before, words[i + 1 :]) if before else (_AXES[word], words[1:], [])
        if word == "gy" and words[i + 1 : i + 2] and words[i + 1] in _AXES:  # "GyX"
            continue
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
    within = unit_of("".join(names[1:]), quantity)  # "Gyro_DPS_X"; raw there may mean not filtered
    unit = unit_of(inside, quantity) or unit_of("".join(behind), quantity) or (None if within == "count" else within)
    return ColumnName(quantity=quantity, axis=axis, unit=unit)


def _bare_axis(axis: int, inside: str) -> ColumnName:
    for quantity in _SENSORS:
        unit = unit_of(inside, quantity)
        if unit is not None and unit != "count":
            return ColumnName(quantity=quantity, axis=axis, unit=unit)
    return ColumnName(quantity="unnamed", axis=axis)


def _time_word(words: list[str]) -> str | None:
    return next((unit for word in words if len(word) > 1 and (unit := unit_of(word, "time"))), None)


_ROS_2_IMU = (  # of `ros2 topic echo --csv` of a sensor_msgs/Imu
    *("sec", "nanosec", "frame_id", *(f"orientation_{i}" for i in "xyzw"), *["covariance"] * 9),
    *("angular_velocity_x", "angular_velocity_y", "angular_velocity_z", *["covariance"] * 9),
    *("linear_acceleration_x", "linear_acceleration_y", "linear_acceleration_z", *["covariance"] * 9),
)


@value_class(eq=True)
class TriadColumns:
    """Columns x, y, z of one triad; quantity "unnamed" where only the values can tell which sensor it is."""

    quantity: str
    columns: tuple[int, int, int]
    unit: str | None = None


@value_class(eq=True)
class Roles:
    """Columns that are used.

    Attributes
    ----------
    time : columns of the stamp and their units: none, one, or two to be added (seconds and nanoseconds)
    triads : one or two, and the magnetometer behind them, or it alone
    notes : what was assumed
    temperature : column of the thermometer, the first one, and its unit where the name tells it
    """

    time: tuple[tuple[int, str | None], ...]
    triads: tuple[TriadColumns, ...]
    notes: tuple[str, ...] = ()
    temperature: tuple[int, str | None] | None = None


def column_roles(layout: TextLayout, stated: str | None, where: str) -> Roles:
    """Decide which columns are used.

    Parameters
    ----------
    layout : of the table
    stated : --columns, or None
    where : file, for messages

    Raises
    ------
    OptionError
        If `stated` does not fit the table.
    RecordingError
        If neither header nor the number of columns tells what they are.
    """
    if stated is not None:
        return _stated(layout, stated, where)
    if not layout.header and layout.columns == len(_ROS_2_IMU) and not is_number(layout.sample[0][2]):
        layout = replace(layout, header=_ROS_2_IMU)
    if layout.header:
        names = [column_name(text) for text in layout.header]
        if any(name.quantity not in {"time", "temperature", "other"} for name in names):
            return _named(names, layout, where, "the header")
        advice = columns_help(layout)
        raise RecordingError(
            f"{where}: the header names no accelerometer, gyroscope or magnetometer "
            f"({', '.join(layout.header)[:120]}). {advice}"
        )
    return _by_number(layout, where)


def _stated(layout: TextLayout, stated: str, where: str) -> Roles:
    words = stated.replace(",", " ").split()
    if len(words) != layout.columns:
        raise OptionError(
            f'columns "{stated}" names {len(words)} columns, {where} has {layout.columns} ({layout}). '
            "Name every column; _ skips one."
        )
    names = [OTHER if word == "_" else column_name(word) for word in words]
    unknown = [word for word, name in zip(words, names, strict=True) if name is OTHER and word != "_"]
    if unknown:
        raise OptionError(
            f'columns "{stated}": "{unknown[0]}" is not known. '
            "Write t, ax, ay, az, gx, gy, gz, mx, my, mz, temp, or _ to skip a column."
        )
    return _named(names, layout, where, "--columns")


def _named(names: list[ColumnName], layout: TextLayout, where: str, origin: str) -> Roles:
    triads: list[TriadColumns] = []
    quantities = [name.quantity for name in names]
    for quantity in ("accelerometer", "gyroscope", "unnamed", "magnetometer"):
        axes = {axis: [i for i, n in enumerate(names) if (n.quantity, n.axis) == (quantity, axis)] for axis in range(3)}
        axes = {axis: _measured(columns, layout.header) for axis, columns in axes.items()}
        found = sum(len(columns) for columns in axes.values())
        if not found:
            continue
        if any(len(columns) != 1 for columns in axes.values()):
            if quantity == "magnetometer" and triads:  # what is wanted may well be without it
                continue
            listed = ", ".join(f"{'xyz'[axis]}: {len(columns)}" for axis, columns in axes.items())
            sensor = "triad" if quantity == "unnamed" else quantity
            advice = columns_help(layout, quantities)
            raise RecordingError(
                f"{where}: {origin} must name each axis of the {sensor} once; found {listed} columns. {advice}"
            )
        columns = (axes[0][0], axes[1][0], axes[2][0])
        triads.append(TriadColumns(quantity=quantity, columns=columns, unit=names[columns[0]].unit))
    inertial = any(triad.quantity in {"accelerometer", "gyroscope"} for triad in triads)
    named = [triad for triad in triads if triad.quantity != "unnamed"] if inertial else triads
    if not triads:
        advice = columns_help(layout, quantities)
        raise RecordingError(f"{where}: {origin} names no accelerometer, no gyroscope and no magnetometer. {advice}")
    warmth = [(i, n.unit) for i, n in enumerate(names) if n.quantity == "temperature"]
    called = [layout.header[i] if i < len(layout.header) else f"column {i + 1}" for i, _ in warmth]
    notes = [f"{where}: {len(called)} temperatures ({', '.join(called)}); {called[0]} is used."] if called[1:] else []
    return Roles(
        time=time_columns(names, layout),
        triads=tuple(named),
        notes=tuple(notes),
        temperature=warmth[0] if warmth else None,
    )


def _measured(columns: list[int], header: tuple[str, ...]) -> list[int]:
    """Return, of several columns for one axis, those that the sensor itself measured, in a unit rather than in counts.

    AndroSensor has LINEAR ACCELERATION (without gravity) beside ACCELEROMETER, Physics Toolbox ax (linear) beside gFx
    (in g), SensorLog of iOS motionRotationRate (filtered) beside gyroRotation, Bosch's examples Acc_Raw beside Acc_ms2.
    """
    if len(columns) < 2 or not header:
        return columns
    in_g = [i for i in columns if header[i].startswith("gF")]
    kept = in_g or [i for i in columns if not re.search("linear|motion", header[i], re.IGNORECASE)] or columns
    in_units = [i for i in kept if column_name(header[i]).unit not in {None, "count"}]
    return in_units if len(kept) > 1 and in_units else kept


def time_columns(names: list[ColumnName], layout: TextLayout) -> tuple[tuple[int, str | None], ...]:
    """Choose among the columns that may be stamps those that hold numbers; a header stamp beats the time of arrival."""
    row = layout.sample[0]
    found = [i for i, name in enumerate(names) if name.quantity == "time" and is_number(row[i], layout.decimal_comma)]
    if not found:
        return ()
    texts = [layout.header[i].lower() if layout.header else "" for i in found]
    seconds = [
        i
        for i, text in zip(found, texts, strict=True)
        if text.rstrip("s").endswith("sec") and "nsec" not in text and "nano" not in text
    ]
    nanoseconds = [i for i, text in zip(found, texts, strict=True) if text.rstrip("s").endswith(("nsec", "nanosec"))]
    if len(seconds) == len(nanoseconds) == 1:
        return ((seconds[0], "s"), (nanoseconds[0], "ns"))
    rise = [i for i in found if column_rises(layout, i)]  # "GPS TFlags" is no time
    rising = min(rise or found, key=lambda i: names[i].unit == "ms" and any(names[j].unit == "ns" for j in rise))
    best = next((i for i, text in zip(found, texts, strict=True) if "header" in text and "stamp" in text), rising)
    return ((best, names[best].unit),)


def _by_number(layout: TextLayout, where: str) -> Roles:
    """Two triads, with time in front or without time; or one triad (of a pair of files)."""
    count = layout.columns
    if count in {3, 6}:
        return Roles(time=(), triads=_triads(0, count))
    if count in {4, 7} and column_counts(layout, 0):
        return Roles(time=(), triads=_triads(1, count))
    if count in {4, 7} and column_rises(layout):
        return Roles(
            time=((0, None),),
            triads=_triads(1, count),
            notes=(f"{where}: no header; the first column rises steadily and was taken for the time.",),
        )
    if count in {4, 7} and column_rises(layout, count - 1):
        return Roles(
            time=((count - 1, None),),
            triads=_triads(0, count - 1),
            notes=(f"{where}: no header; the last column rises steadily and was taken for the time.",),
        )
    why = (
        "of which neither the first nor the last is a time (it does not rise)"
        if count in {4, 7}
        else "without names that gnomon knows"
    )
    raise RecordingError(f"{where}: found {layout}, {why}. {columns_help(layout)}")


def _triads(first: int, count: int) -> tuple[TriadColumns, ...]:
    return tuple(TriadColumns(quantity="unnamed", columns=(i, i + 1, i + 2)) for i in range(first, count, 3))
