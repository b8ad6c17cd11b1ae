"""What to simulate of a sensor on a turntable; `gnomon simulate-turntable` is made from this class."""

from dataclasses import dataclass
from math import radians
from typing import Literal

from ..errors import OptionError
from ..ranges import check_ranges
from ..units import Units


@dataclass(frozen=True, slots=True, kw_only=True)
class TurntableScenario:
    """A sensor that lies on a record player in one attitude after another (document C, fig. 7)."""

    rpm: tuple[float, ...] = (16.0,)
    """Speeds of the platter in turns a minute, one after the other in each attitude; it rests before and after them."""

    rate_error: float = 0.0
    """Share by which the platter is faster than it says."""

    counter_clockwise: bool = False
    """Which way the platter turns, seen from above; record players turn clockwise."""

    poses: int = 18
    """Attitudes; 18 are the six faces and the twelve edges of a cube up, other numbers cover the sphere evenly."""

    attitude_error_deg: float = 10.0
    """Standard deviation of the tilt of each attitude about each axis, in degrees."""

    files: Literal["one", "each"] = "one"
    """one: a single recording, with the handling between the attitudes. each: one recording an attitude, without."""

    accelerometer: bool = True
    """Whether the accelerometer is recorded, too."""

    steady_s: float = 30.0
    """How long each speed is kept, in seconds."""

    rest_s: float = 5.0
    """How long the platter rests before and after, in seconds."""

    spin_up_s: float = 1.0
    """Time constant with which the platter takes up its speed, in seconds."""

    handling_s: float = 4.0
    """How long the sensor is handled between two attitudes, in seconds."""

    radius: float = 0.05
    """Distance of the sensor from the platter's axis in metres."""

    tilt_deg: float = 0.2
    """Angle of the platter's axis to the vertical in degrees."""

    wow: float = 0.001
    """Share by which the speed swings once a turn."""

    speed_scatter: float = 0.0
    """Standard deviation of the speed from one steady part to the next, as a share."""

    rate_hz: float = 100.0
    """Sample rate of both triads."""

    gravity: float = 9.80665
    """Local gravity in m/s^2."""

    earth_rate_latitude: float | None = None
    """Latitude in degrees where the Earth turns below the platter; without it the Earth stands still."""

    units: str = "si"
    """Units of the recording: "si", "raw" (counts), or a list such as "g deg/s"."""

    bits: int | None = None
    """Bits of the converter; the values are quantised where it is given. Counts have 16 bits where it is not."""

    accelerometer_range: float = 50.0
    """Full scale of the accelerometer in m/s^2; readings stop there."""

    gyroscope_range: float = radians(150.0)
    """Full scale of the gyroscope in rad/s; readings stop there."""

    g_sensitivity: float = 0.0
    """Elements of the gyroscope's g-sensitivity are drawn between minus and plus this, in rad/s per m/s^2."""

    gyroscope_drift: float = 0.0
    """How far the gyroscope's bias moves from beginning to end, along each axis, in rad/s; steadily."""

    accelerometer_noise_density: float = 2e-3
    """White noise in m/s^2/sqrt(Hz)."""

    gyroscope_noise_density: float = 8.7e-4
    """White noise in rad/s/sqrt(Hz)."""

    sensor_seed: int | None = None
    """Draw the sensor's parameters from this seed, so that many recordings of one sensor can be made."""

    def __post_init__(self) -> None:
        check_ranges(self)
        for name in ("rate_hz", "gravity", "accelerometer_range", "gyroscope_range", "steady_s", "poses"):
            if not getattr(self, name) > 0:
                raise OptionError(f"{name} {getattr(self, name):g} must be greater than zero.")
        for name in ("rest_s", "spin_up_s", "handling_s", "radius", "wow", "speed_scatter", "g_sensitivity"):
            if not getattr(self, name) >= 0:
                raise OptionError(f"{name} {getattr(self, name):g} must not be below zero.")
        if any(not speed >= 0 for speed in self.rpm):
            raise OptionError("rpm must not be below zero; counter_clockwise says which way the platter turns.")
        Units.parse(self.units)
