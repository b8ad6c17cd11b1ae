"""Options of calibrations of one sensor: multi-position recordings, noise, turntable and magnetometer."""

from math import isnan, nan, pi
from typing import Literal

from ..errors import OptionError
from ..frozen import value_class
from .ranges import check_gravity, check_positive, check_ranges, check_stretch

Preset = Literal["gnomon", "tedaldi2014", "tedaldi2014-text", "imu_tk", "angrisano"]


@value_class(eq=True)
class ImuOptions:
    """How to calibrate an IMU from a multi-position recording."""

    preset: Preset = "gnomon"
    """gnomon: the better estimator (default). tedaldi2014: the authors' published script behind Table 4.8.
    tedaldi2014-text: Algorithm 1 as printed. imu_tk: the published C++ program. angrisano: the accelerometer by
    Angrisano, Eqs. 8 to 12."""

    gravity: float | None = None
    """Local gravity in m/s^2, where you know it."""

    latitude: float | None = None
    """Latitude in degrees, from which normal gravity (WGS 84), unless stated, and the earth's rate are computed."""

    altitude: float = 0.0
    """Height above the ellipsoid in metres, used with --latitude."""

    frame: str = "accel-x"
    """Body frame: accel-x (Kalibr), accel-z (Tedaldi), or poses "x=3 z=-7" (interval 3 with x up, 7 with z down)."""

    model: Literal["auto", "basic", "g-sensitivity", "static"] = "auto"
    """Gyroscope bias: constant (basic), linear in the specific force (g-sensitivity), or chosen by hold-out (auto); or
    linear and from the rests alone, whatever the rotations show (static: Krebs, section 5.2)."""

    covariance: Literal["robust", "ordinary"] = "robust"
    """Sigmas from the scatter between stretches of time, which hold where errors are correlated (robust), or those for
    independent errors (ordinary). Both are in the report."""

    time_base: Literal["auto", "stamps", "uniform"] = "auto"
    """Use the timestamps as they are, a straight line through them, or what the recording supports (auto)."""

    window_s: float = 1.0
    """Length of the sliding window of the static detector in seconds (t_w of Eq. 3.9)."""

    multiplier: float | None = None
    """Threshold of the static detector in units of the resting level; chosen automatically where it is not given."""

    t_init_s: float | None = None
    """Length of the initial static part in seconds, for the presets (30 s or 50 s where it is not given)."""

    accelerometer_range: float | None = None
    """Full scale of the accelerometer, in the recording's unit; samples at or beyond it are masked."""

    gyroscope_range: float | None = None
    """Full scale of the gyroscope, in the recording's unit; samples at or beyond it are masked."""

    bits: int | None = None
    """Bits of the converter, for the start of preset angrisano on counts (n of Eq. 12)."""

    full_scale: float | None = None
    """Full scale of the accelerometer in m/s^2, for the same start (y of Eq. 12)."""

    geometry: Literal["small-angle", "exact"] = "small-angle"
    """Alignment matrix of preset angrisano: Eq. 15 (small-angle) or Eq. 14 (exact)."""

    fix: tuple[str, ...] = ()
    """Parameters that keep their prior value, such as imu0.gyroscope.g_sensitivity."""

    free: tuple[str, ...] = ()
    """Parameters of which a prior calibration is not asked, such as imu0.accelerometer."""

    prior: tuple[str, ...] = ()
    """What is known beforehand: a calibration.yaml, a noise.yaml, or NAME=SIGMA as imu0.accelerometer.bias=0.05."""

    def __post_init__(self) -> None:
        check_ranges(self)
        check_gravity(self.gravity)
        positive = ("window_s", "multiplier", "t_init_s", "accelerometer_range", "gyroscope_range", "full_scale")
        check_positive(self, positive)


@value_class(eq=True)
class NoiseOptions:
    """How to identify the noise of an IMU from a long recording at rest."""

    start_s: float = 0.0
    """Leave out this long at the start, in seconds: the sensor was still touched, or warmed up."""

    stop_s: float | None = None
    """Leave out what comes later than this, in seconds from the start of the recording."""

    topic: str = "/imu0"
    """ROS topic (rostopic) for imu.yaml; the noise does not depend on it."""

    def __post_init__(self) -> None:
        check_ranges(self)
        check_stretch(self.start_s, self.stop_s)


_LABELS_RPM = (16.0, 50 / 3, 33.0, 100 / 3, 33.5, 45.0, 78.0, 78.26)
_LABEL_SIGMA, _OTHER_SIGMA = 1e-2, 1e-3
"""Relative: record players may be 1 % off and more (DIN 45500: -1 to +1.5 %); what is on no label was measured."""


def default_rate_sigma(rate_rad_s: float) -> float:
    """Return how well a rate is known of which only the number is stated, relative.

    Examples
    --------
    >>> default_rate_sigma(33.33 * pi / 30), default_rate_sigma(33.41 * pi / 30)
    (0.01, 0.001)
    """
    rpm = rate_rad_s * 30 / pi
    return _LABEL_SIGMA if any(abs(rpm - label) < 1.5e-3 * label for label in _LABELS_RPM) else _OTHER_SIGMA


@value_class(eq=True)
class StatedRate:
    """The rate of a turntable, as somebody stated it or as a video showed it.

    Attributes
    ----------
    name : as stated, such as "16rpm", or the name of the video
    rate_rad_s : [rad/s], 0 for a turntable at rest
    sigma_rad_s : its standard deviation [rad/s]; 0 where it is taken as exact. Where it is not stated, that of a record
        player's label (1 %) for the speeds that are on such labels, else 0.1 %
    turns : turns that a video showed; nan where there was none
    """

    name: str
    rate_rad_s: float
    sigma_rad_s: float = nan
    turns: float = nan

    def __post_init__(self) -> None:
        if isnan(self.sigma_rad_s):
            object.__setattr__(self, "sigma_rad_s", default_rate_sigma(self.rate_rad_s) * self.rate_rad_s)


@value_class(eq=True)
class TurntableOptions:
    """How to calibrate a gyroscope on a turntable (Angrisano)."""

    model: Literal["auto", "basic", "g-sensitivity"] = "auto"
    """Gyroscope bias: constant (basic), linear in the specific force (g-sensitivity), or chosen by hold-out (auto)."""

    rate_sigma: float | None = None
    """Relative standard deviation of rates that were stated as numbers: by default 0.01 of speeds that are on the label
    of a record player (16, 33 1/3, 45, 78 rpm), 0.001 of others."""

    sense: Literal["auto", "clockwise", "counterclockwise"] = "auto"
    """Which way the platter turns, seen from above; both triads are taken for right-handed where it is not stated."""

    gravity: float | None = None
    """Local gravity in m/s^2, where you know it."""

    latitude: float | None = None
    """Latitude in degrees, from which the earth's rate and, unless stated, normal gravity (WGS 84) are computed."""

    altitude: float = 0.0
    """Height above the ellipsoid in metres, used with --latitude."""

    fix: tuple[str, ...] = ()
    """Parameters that keep their prior value, such as imu0.gyroscope.g_sensitivity."""

    free: tuple[str, ...] = ()
    """Parameters to estimate that are fixed otherwise, such as rate.scale."""

    prior: tuple[str, ...] = ()
    """What is known beforehand: a calibration.yaml, a noise.yaml, or NAME=SIGMA, such as imu0.gyroscope.bias=0.01."""

    accelerometer_range: float | None = None
    """Full scale of the accelerometer, in the recording's unit; samples at or beyond it are masked."""

    gyroscope_range: float | None = None
    """Full scale of the gyroscope, in the recording's unit; samples at or beyond it are masked."""

    def __post_init__(self) -> None:
        check_ranges(self)
        if self.rate_sigma is not None and not self.rate_sigma >= 0:
            raise OptionError(f"rate_sigma {self.rate_sigma:g} must not be below zero.")
        check_gravity(self.gravity)
        check_positive(self, ("accelerometer_range", "gyroscope_range"))


@value_class(eq=True)
class MagnetometerOptions:
    """How to calibrate a magnetometer."""

    field: float | None = None
    """Strength of the local magnetic field in uT, where you know it; otherwise it is the unit of the result."""

    dip: float | None = None
    """Angle of the local field below the horizontal in degrees, below zero where it points up; checks handedness."""

    latitude: float | None = None
    """Latitude in degrees: which way the field dips there checks the handedness of the axes."""

    model: Literal["auto", "hard-iron", "full"] = "auto"
    """Every entry of the sensitivity (full, auto), or offset and one scale (hard-iron), soft iron left out."""

    fix: tuple[str, ...] = ()
    """Parameters that keep their prior value, such as imu0.magnetometer.bias."""

    free: tuple[str, ...] = ()
    """Parameters of which a prior calibration is not asked, such as imu0.accelerometer."""

    prior: tuple[str, ...] = ()
    """What is known beforehand: a calibration.yaml, or NAME=SIGMA, such as imu0.magnetometer.bias=5."""

    magnetometer_range: float | None = None
    """Full scale of the magnetometer, in the recording's unit; samples at or beyond it are masked."""

    def __post_init__(self) -> None:
        check_ranges(self)
