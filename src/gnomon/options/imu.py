"""Options of calibrations of an IMU alone: multi-position recordings, and noise."""

from typing import Literal

from ..errors import OptionError
from ..frozen import value_class
from .ranges import check_gravity, check_positive, check_ranges

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
        if not 0 <= self.start_s < float("inf"):
            raise OptionError(f"start_s {self.start_s:g} must be zero or more.")
        if self.stop_s is not None and not self.stop_s > self.start_s:
            raise OptionError(f"stop_s {self.stop_s:g} must be later than start_s {self.start_s:g}.")
