"""What a use needs of a calibration: for each quantity the standard deviation up to which it serves.

Numbers follow from what an error does in that use; where a document states one, it is named. Gravity's own uncertainty
is not counted: it is common to all axes of the accelerometer, and whoever uses the calibration takes the same gravity.
A bias is judged as it was during the recording: at the next switching-on it is another one, by about what
`BETWEEN_RECORDINGS` says, and whoever uses the calibration has to follow it.
"""

import difflib
from collections.abc import Mapping
from math import isfinite, pi

from ..errors import OptionError
from ..frozen import FrozenMapping, value_class

_DEG, _MRAD = pi / 180, 1e-3
_MM, _MS, _PERCENT = 1e-3, 1e-3, 1e-2
_G = 9.80665
_DEG_S_G = _DEG / _G
_UNITS: Mapping[str, Mapping[str, float]] = {
    "angle": {"deg": _DEG, "rad": 1.0, "mrad": 1e-3},
    "length": {"mm": 1e-3, "m": 1.0, "cm": 1e-2},
    "time": {"ms": 1e-3, "s": 1.0, "us": 1e-6},
    "ratio": {"%": 1e-2, "ppm": 1e-6, "1": 1.0},
    "rate": {"deg/s": _DEG, "rad/s": 1.0, "mrad/s": 1e-3, "deg/h": _DEG / 3600},
    "acceleration": {"mm/s^2": 1e-3, "m/s^2": 1.0, "mg": 1e-3 * _G, "g": _G},
    "rate per acceleration": {"deg/s/g": _DEG_S_G, "rad/s/(m/s^2)": 1.0},
}
"""Kind of quantity -> its units, in SI; the first is the one that is shown."""


@value_class(eq=True)
class RequiredQuantity:
    """Something that a use may need.

    Attributes
    ----------
    words : for people; {sensor} stands for the camera or the IMU
    unit : in which it is shown
    size : one of that unit, in SI
    """

    words: str
    unit: str
    size: float


FIELD_UT = 48.0
"""A usual field of the Earth, where a magnetometer's calibration does not state its own."""

_WORDS_AND_KINDS: Mapping[str, tuple[str, str]] = {
    "camera_rotation": ("rotation of {sensor} against the IMU", "angle"),
    "camera_translation": ("translation of {sensor} against the IMU", "length"),
    "time_shift": ("time shift of {sensor}", "time"),
    "imu_rotation": ("rotation of {sensor} against imu0", "angle"),
    "imu_translation": ("translation of {sensor} against imu0", "length"),
    "gyroscope_scale": ("gyroscope scale", "ratio"),
    "gyroscope_misalignment": ("gyroscope axes", "angle"),
    "gyroscope_bias": ("gyroscope bias", "rate"),
    "gyroscope_g_sensitivity": ("gyroscope g-sensitivity", "rate per acceleration"),
    "accelerometer_scale": ("accelerometer scale", "ratio"),
    "accelerometer_misalignment": ("accelerometer axes", "angle"),
    "accelerometer_bias": ("accelerometer bias", "acceleration"),
    "heading": ("heading by the magnetometer", "angle"),
}

QUANTITIES: Mapping[str, RequiredQuantity] = FrozenMapping(
    {
        name: RequiredQuantity(words=words, unit=unit, size=size)
        for name, (words, kind) in _WORDS_AND_KINDS.items()
        for unit, size in tuple(_UNITS[kind].items())[:1]
    }
)
"""What a use may need, by name."""


@value_class(eq=True)
class Use:
    """A use of a calibration.

    Attributes
    ----------
    name : such as "vio"
    words : what it is
    needs : quantity -> standard deviation up to which it passes [SI]
    fails_at : times the need from which on the use is not served at all
    """

    name: str
    words: str
    needs: Mapping[str, float]
    fails_at: float = 3.0


def parse_sigma(name: str, text: str) -> float:
    """Return a standard deviation in SI units, stated as "0.1 deg".

    Raises
    ------
    OptionError
        If there is no such quantity, its unit is another one, or the number is not greater than zero.
    """
    if name not in QUANTITIES:
        close = difflib.get_close_matches(name, QUANTITIES, n=1)
        hint = f"Did you mean {close[0]}?" if close else f"Known: {', '.join(QUANTITIES)}."
        raise OptionError(f"{name}: there is no such quantity. {hint}")
    units = _UNITS[_WORDS_AND_KINDS[name][1]]
    number, _, unit = text.strip().partition(" ")
    if number.endswith("%"):
        number, unit = number[:-1], "%"
    try:
        value = float(number)
    except ValueError:
        value = float("nan")
    if unit.strip() not in units or not (isfinite(value) and value > 0):
        raise OptionError(
            f'{name}: found "{text}", expected a number above zero and its unit, such as '
            f'"{0.1:g} {next(iter(units))}" (or {", ".join(list(units)[1:])}).'
        )
    return value * units[unit.strip()]


USES: Mapping[str, Use] = FrozenMapping(
    {
        # Measured (gnomon study circuit, seed 0): with all eight quantities of cameras, clock, scales, axes and
        # g-sensitivity off by these at once, the odometry of a rig with an MPU-6000 that is carried round 60 to
        # 120 m drifts as much more as it does by itself, and each adds the same part. Biases are followed by the
        # odometry: a tilt of 0.1 deg turns gravity into 17 mm/s^2. A second IMU may be turned against the first by
        # as much as a gyroscope's axes may, and be as far from where it should as a camera.
        "vio": Use(
            name="vio",
            words="visual-inertial odometry",
            needs=FrozenMapping(
                {
                    "camera_rotation": 0.08 * _DEG,
                    "camera_translation": 4 * _MM,
                    "time_shift": 0.25 * _MS,
                    "imu_rotation": 0.1 * _DEG,
                    "imu_translation": 4 * _MM,
                    "gyroscope_scale": 0.15 * _PERCENT,
                    "gyroscope_misalignment": 0.1 * _DEG,
                    "gyroscope_bias": 0.05 * _DEG,
                    "gyroscope_g_sensitivity": 0.1 * _DEG_S_G,
                    "accelerometer_scale": 0.3 * _PERCENT,
                    "accelerometer_misalignment": 0.4 * _DEG,
                    "accelerometer_bias": 20 * _MM,
                }
            ),
        ),
        # Data sheets of attitude modules state 0.2 to 0.5 deg in roll and pitch, 1 to 2 deg in heading: a third of
        # it for each contribution. Tilt by bias and axes of the accelerometer 0.1 deg; turns of 90 deg end within
        # 0.3 deg, until gravity corrects them.
        "ahrs": Use(
            name="ahrs",
            words="attitude and heading",
            needs=FrozenMapping(
                {
                    "imu_rotation": 0.1 * _DEG,
                    "gyroscope_scale": 0.3 * _PERCENT,
                    "gyroscope_misalignment": 0.2 * _DEG,
                    "gyroscope_bias": 0.05 * _DEG,
                    "gyroscope_g_sensitivity": 0.1 * _DEG_S_G,
                    "accelerometer_scale": 0.3 * _PERCENT,
                    "accelerometer_misalignment": 0.1 * _DEG,
                    "accelerometer_bias": 17 * _MM,
                    "heading": 0.7 * _DEG,
                }
            ),
        ),
        # A horizon off by 0.1 deg is seen in a picture 1000 px wide (1.7 px), as is a drift of 0.02 deg/s within
        # seconds. Rates are fed back, so that their scale hardly matters; positions do not matter at all.
        "gimbal": Use(
            name="gimbal",
            words="stabilised camera",
            needs=FrozenMapping(
                {
                    "camera_rotation": 0.1 * _DEG,
                    "time_shift": 2 * _MS,
                    "imu_rotation": 0.05 * _DEG,
                    "gyroscope_scale": 1 * _PERCENT,
                    "gyroscope_misalignment": 0.5 * _DEG,
                    "gyroscope_bias": 0.02 * _DEG,
                    "gyroscope_g_sensitivity": 0.05 * _DEG_S_G,
                    "accelerometer_scale": 0.5 * _PERCENT,
                    "accelerometer_misalignment": 0.05 * _DEG,
                    "accelerometer_bias": 9 * _MM,
                }
            ),
        ),
        # Android's Camera ITS (test_sensor_fusion) lets camera and gyroscope differ by 1 ms. Video is stabilised
        # by rotation alone; augmented reality follows both online, within centimetres and half a degree.
        "phone": Use(
            name="phone",
            words="video stabilisation and augmented reality",
            needs=FrozenMapping(
                {
                    "camera_rotation": 0.3 * _DEG,
                    "camera_translation": 10 * _MM,
                    "time_shift": 1 * _MS,
                    "imu_rotation": 0.3 * _DEG,
                    "imu_translation": 10 * _MM,
                    "gyroscope_scale": 0.3 * _PERCENT,
                    "gyroscope_misalignment": 0.3 * _DEG,
                    "gyroscope_bias": 0.1 * _DEG,
                    "gyroscope_g_sensitivity": 0.1 * _DEG_S_G,
                    "accelerometer_scale": 0.5 * _PERCENT,
                    "accelerometer_misalignment": 0.3 * _DEG,
                    "accelerometer_bias": 50 * _MM,
                }
            ),
        ),
    }
)
"""Built-in uses by name."""

GENERAL = "general"
"""The name under which a calibration is judged again for no special use."""

GENERAL_RIG = Use(
    name=GENERAL,
    words="general use",
    needs=FrozenMapping(
        {
            "camera_rotation": 0.1 * _DEG,
            "camera_translation": 5 * _MM,
            "time_shift": 0.5 * _MS,
            "imu_rotation": 0.1 * _DEG,
            "imu_translation": 5 * _MM,
        }
    ),
    fails_at=10.0,
)
"""What is asked of cameras and IMUs where no use is stated."""

GENERAL_IMU = Use(
    name=GENERAL,
    words="general use",
    needs=FrozenMapping(
        {
            "gyroscope_scale": 0.2 * _PERCENT,
            "gyroscope_misalignment": 3 * _MRAD,
            "accelerometer_scale": 0.2 * _PERCENT,
            "accelerometer_misalignment": 3 * _MRAD,
        }
    ),
    fails_at=10.0,
)
"""What is asked of an IMU alone where no use is stated."""


def known_use(name: str) -> Use:
    """Return a built-in use.

    Raises
    ------
    OptionError
        If there is none of that name.
    """
    if name in USES:
        return USES[name]
    close = difflib.get_close_matches(name, USES, n=1)
    hint = f" Did you mean {close[0]}?" if close else ""
    raise OptionError(
        f"no use {name!r} is known.{hint} Known: {', '.join(USES)}; or name a YAML file with lines such as "
        "camera_rotation: 0.1 deg."
    )


BETWEEN_RECORDINGS: Mapping[str, float] = FrozenMapping(
    {
        # REML over eight MPU-9150 on six occasions (MIMU4444: Carlsson, Skog and Jalden 2021), in one laboratory:
        # 0.0137 %, 0.19 mrad, 5.3e-6 rad/s per m/s^2.
        "accelerometer_scale": 0.015 * _PERCENT,
        "accelerometer_misalignment": 0.0002,
        "gyroscope_g_sensitivity": 5.5e-06,
        # There the gyroscope's axes changed by less than could be told: as the accelerometer's. Its scale is typical of
        # consumer sensors, from memory of data sheets and not from one source: 0.01 to 0.03 % a kelvin, over the 3 K
        # between two days in one room.
        "gyroscope_scale": 0.05 * _PERCENT,
        "gyroscope_misalignment": 0.0002,
        # Typical values again, from memory of data sheets: 1 mg and 0.05 deg/s a kelvin, over 5 K. MIMU4444 measured
        # 28 mm/s^2 and 0.10 deg/s.
        "accelerometer_bias": 50 * _MM,
        "gyroscope_bias": 0.25 * _DEG,
    }
)
"""By how much one sensor differs from recording to recording, standard deviation [SI]: switched on anew, at another
temperature, mounted anew in its box. One recording cannot tell; several, joined, measure it."""

USUAL_SLOPE: Mapping[str, float] = FrozenMapping({"gyroscope": 0.05 * _DEG, "accelerometer": 1e-3 * _G})
"""Of a bias with the temperature, from memory of data sheets, as above [rad/s/K, m/s^2/K]."""

TURN_ON = ("accelerometer_bias", "gyroscope_bias")
"""What every use has to follow by itself, since it is another one after each switching-on."""
