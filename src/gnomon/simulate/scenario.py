"""What to simulate; `gnomon simulate` is made from this class."""

from dataclasses import dataclass
from math import radians
from typing import Literal

from ..errors import OptionError
from ..ranges import check_ranges
from ..units import Units


@dataclass(frozen=True, slots=True, kw_only=True)
class Scenario:
    """A multi-position recording by hand (document A, section 4.1) of an IMU with drawn parameters."""

    style: Literal["hand", "thesis"] = "hand"
    """hand: smooth turns about changing axes between attitudes that cover the sphere. thesis: as document A describes
    its signals: sinusoidal accelerations, gravity turning at a random zenith and azimuth rate in each motion."""

    intervals: int = 40
    """Static intervals, the initial one included; there is one motion between two of them."""

    attitudes: Literal["sphere", "one-axis"] = "sphere"
    """sphere: the vertical points in evenly spread directions of the sensor, in style hand. one-axis: the sensor is
    tilted about its y axis alone, which never points up or down."""

    t_init_s: float = 50.0
    """Length of the initial static interval in seconds."""

    hold_s: tuple[float, float] = (4.0, 4.0)
    """Shortest and longest static interval after a motion in seconds."""

    motion_s: tuple[float, float] = (1.5, 3.0)
    """Shortest and longest motion in seconds."""

    rate_hz: float = 100.0
    """Sample rate of the accelerometer."""

    gyroscope_rate_hz: float | None = None
    """Sample rate of the gyroscope; that of the accelerometer where it is not given."""

    gravity: float = 9.80665
    """Local gravity in m/s^2."""

    earth_rate_latitude: float | None = None
    """Latitude in degrees where the Earth turns below the recording; without it the Earth stands still."""

    units: str = "si"
    """Units of the recording: "si", "raw" (counts), or a list such as "g deg/s"."""

    bits: int | None = None
    """Bits of the converter; the values are quantised where it is given. Counts have 16 bits where it is not."""

    accelerometer_range: float = 50.0
    """Full scale of the accelerometer in m/s^2; readings stop there."""

    gyroscope_range: float = radians(500.0)
    """Full scale of the gyroscope in rad/s; readings stop there."""

    accelerometer_misalignment: float = 0.01
    """Elements of T off the diagonal are drawn between minus and plus this (Eq. 2.6)."""

    gyroscope_misalignment: float = 0.03
    """As for the accelerometer, six elements (Eq. 2.7)."""

    accelerometer_scale: tuple[float, float] = (0.99, 1.01)
    """Elements of K are drawn between these (Eq. 2.6)."""

    gyroscope_scale: tuple[float, float] = (0.84, 1.13)
    """As for the accelerometer (Eq. 2.7)."""

    accelerometer_bias: float = 0.1
    """Biases are drawn between minus and plus this, in m/s^2."""

    gyroscope_bias: float = 0.02
    """Biases are drawn between minus and plus this, in rad/s."""

    g_sensitivity: float = 0.0
    """Elements of the gyroscope's g-sensitivity are drawn between minus and plus this, in rad/s per m/s^2."""

    accelerometer_noise_density: float = 7e-4
    """White noise in m/s^2/sqrt(Hz); 0.007 m/s^2 per sample at 100 Hz."""

    gyroscope_noise_density: float = 4.3e-4
    """White noise in rad/s/sqrt(Hz); 0.0043 rad/s per sample at 100 Hz."""

    gyroscope_bias_walk: float = 0.0
    """Random walk of the gyroscope's bias in rad/s/sqrt(s); the true bias is then its mean over the recording."""

    stamp_jitter_s: float = 0.0
    """Standard deviation of the stamps about the instants of sampling, in seconds."""

    stamp_resolution_s: float = 0.0
    """Stamps are rounded to multiples of this, in seconds."""

    dropped: float = 0.0
    """Fraction of the samples that are lost, one by one."""

    touched: int = 0
    """Static intervals that are not quite still: something pushes and tilts the sensor a little halfway."""

    touch_acceleration: float = 0.05
    """Peak acceleration of a touch in m/s^2."""

    touch_angle: float = 0.003
    """Peak angle of a touch in radians."""

    sensor_seed: int | None = None
    """Draw the sensor's parameters from this seed, so that many recordings of one sensor can be made."""

    def __post_init__(self) -> None:
        check_ranges(self)
        self._check_positive()
        for name in ("hold_s", "motion_s", "accelerometer_scale", "gyroscope_scale"):
            low, high = getattr(self, name)
            if not 0 < low <= high:
                raise OptionError(f"{name} {low:g} {high:g}: give the smaller value first; both must exceed zero.")
        if self.intervals < 2:
            raise OptionError(f"intervals {self.intervals}: at least 2 are needed for one motion between them.")
        if not 0 <= self.touched < self.intervals:
            raise OptionError(
                f"touched {self.touched}: must be from 0 to {self.intervals - 1}, "
                "since the initial interval is never touched."
            )
        if self.touched and self.style == "thesis":
            raise OptionError("touched: the signals of document A (style thesis) have none. Choose style hand.")
        if self.attitudes == "one-axis" and self.style == "thesis":
            raise OptionError("attitudes one-axis: the signals of document A (style thesis) have none. Choose hand.")
        if not 0 <= self.dropped < 1:
            raise OptionError(f"dropped {self.dropped:g}: give a fraction from 0 to below 1.")
        Units.parse(self.units)

    def _check_positive(self) -> None:
        for name in ("t_init_s", "rate_hz", "gyroscope_rate_hz", "gravity", "accelerometer_range", "gyroscope_range"):
            value = getattr(self, name)
            if value is not None and not value > 0:
                raise OptionError(f"{name} {value:g} must be greater than zero.")
        names = [name for name in self.__slots__ if name.endswith(("noise_density", "misalignment", "bias", "walk"))]
        names += ["g_sensitivity", "stamp_jitter_s", "stamp_resolution_s", "touch_acceleration", "touch_angle"]
        for name in names:
            value = getattr(self, name)
            if not value >= 0:
                raise OptionError(f"{name} {value:g} must not be below zero.")
