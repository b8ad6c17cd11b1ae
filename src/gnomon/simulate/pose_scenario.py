"""What to simulate of a sensor at rest in many attitudes; `gnomon simulate-poses` is made from this class."""

from dataclasses import dataclass
from math import radians
from typing import Literal

from ..errors import OptionError
from ..ranges import check_ranges
from ..units import Units

Attitudes = Literal["angrisano18", "six", "seven", "sphere"]

Nine = tuple[float, float, float, float, float, float, float, float, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseScenario:
    """A sensor that is laid down in one attitude after another, and what is recorded while it lies still."""

    attitudes: Attitudes = "angrisano18"
    """angrisano18: the six faces and the twelve edges of a cube up, as with document C's wedge of 45 deg. six: the
    faces. seven: document B's static experiment, -z -y z y x -x -z. sphere: evenly spread directions."""

    poses: int = 24
    """How many attitudes of "sphere"; the other sets have their own number."""

    attitude_error_deg: float = 1.0
    """How well the sensor is laid down: standard deviation of the tilt about each axis, in degrees. Document C:
    1 with a wedge, 10 without."""

    jig_rotation_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Rotation vector from the axes of the jig, in which the attitudes are named, to the sensor's, in degrees."""

    known: bool = False
    """Whether the attitudes are told: the components of gravity along the axes of the jig, as they were meant."""

    samples: int = 100
    """Samples of each pose."""

    rate_hz: float = 100.0
    """Sample rate of both triads."""

    wait_s: float = 20.0
    """Time between two poses, in seconds, which is not recorded."""

    gravity: float = 9.80665
    """Local gravity in m/s^2."""

    earth_rate_latitude: float | None = None
    """Latitude in degrees where the Earth turns below the sensor; without it the Earth stands still."""

    sensor: Literal["angrisano", "drawn"] = "angrisano"
    """angrisano: the MTi of document C (Tables 1 and 3), in counts. drawn: as `gnomon simulate` draws one."""

    sensor_seed: int | None = None
    """Draw the sensor's parameters from this seed, so that many experiments with one sensor can be made."""

    units: str = "raw"
    """Units of the readings: "si", "raw" (counts), or a list such as "g deg/s"."""

    bits: int | None = None
    """Bits of the converter; the readings are quantised where it is given. Counts have 16 bits where it is not."""

    accelerometer_range: float = 50.0
    """Full scale of the accelerometer in m/s^2; readings stop there."""

    gyroscope_range: float = radians(150.0)
    """Full scale of the gyroscope in rad/s; readings stop there."""

    accelerometer_noise_density: float = 2e-3
    """White noise in m/s^2/sqrt(Hz)."""

    gyroscope_noise_density: float = 8.7e-4
    """White noise in rad/s/sqrt(Hz)."""

    g_sensitivity: Nine = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    """The gyroscope's g-sensitivity, row by row, in rad/s per m/s^2."""

    gyroscope_drift: float = 0.0
    """How far the gyroscope's bias moves from the first pose to the last, along each axis, in rad/s; steadily."""

    def __post_init__(self) -> None:
        check_ranges(self)
        for name in ("poses", "samples", "rate_hz", "gravity", "accelerometer_range", "gyroscope_range"):
            if not getattr(self, name) > 0:
                raise OptionError(f"{name} {getattr(self, name):g} must be greater than zero.")
        for name in ("attitude_error_deg", "wait_s", "accelerometer_noise_density", "gyroscope_noise_density"):
            if not getattr(self, name) >= 0:
                raise OptionError(f"{name} {getattr(self, name):g} must not be below zero.")
        units = Units.parse(self.units)
        raw = units.accelerometer == units.gyroscope == "count"
        if self.sensor == "angrisano" and not (raw and self.bits in (None, 16)):
            raise OptionError(
                'sensor angrisano: it reads counts of 16 bits. Leave units "raw" and bits 16, or choose drawn.'
            )
