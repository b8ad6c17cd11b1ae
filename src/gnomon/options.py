"""What a person may choose; the command line is made from these classes."""

from dataclasses import dataclass
from typing import Literal

from .errors import OptionError

Preset = Literal["gnomon", "tedaldi2014", "tedaldi2014-text", "imu_tk"]


@dataclass(frozen=True, slots=True, kw_only=True)
class ImuOptions:
    """How to calibrate an IMU from a multi-position recording."""

    preset: Preset = "gnomon"
    """gnomon: the better estimator (default). tedaldi2014: the authors' published script behind Table 4.8.
    tedaldi2014-text: Algorithm 1 as printed. imu_tk: the published C++ program."""

    gravity: float | None = None
    """Local gravity in m/s^2, where you know it."""

    latitude: float | None = None
    """Latitude in degrees, from which normal gravity (WGS 84), unless stated, and the earth's rate are computed."""

    altitude: float = 0.0
    """Height above the ellipsoid in metres, used with --latitude."""

    frame: str = "accel-x"
    """Body frame: accel-x (Kalibr), accel-z (Tedaldi), or poses "x=3 z=-7" (interval 3 with x up, 7 with z down)."""

    model: Literal["auto", "basic", "g-sensitivity"] = "auto"
    """Gyroscope bias: constant (basic), linear in the specific force (g-sensitivity), or chosen by hold-out (auto)."""

    time_base: Literal["auto", "stamps", "uniform"] = "auto"
    """Use the stamps as they are, a straight line through them, or what the recording supports (auto)."""

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

    def __post_init__(self) -> None:
        if self.gravity is not None and not 9.0 < self.gravity < 10.5:
            raise OptionError(
                f"gravity {self.gravity:g} m/s^2 is found nowhere on Earth (9.76 to 9.84). "
                "Give the local value in m/s^2, or --latitude and --altitude."
            )
        if self.latitude is not None and not -90 <= self.latitude <= 90:
            raise OptionError(f"latitude {self.latitude:g} deg is not between -90 and 90.")
        for name in ("window_s", "multiplier", "t_init_s", "accelerometer_range", "gyroscope_range"):
            value = getattr(self, name)
            if value is not None and not value > 0:
                raise OptionError(f"{name} {value:g} must be greater than zero.")
