"""What to simulate of a magnetometer turned by hand; `gnomon simulate-magnetometer` is made from this class."""

from dataclasses import dataclass
from typing import Literal

from ..errors import OptionError
from ..ranges import check_ranges
from ..units import Units


@dataclass(frozen=True, slots=True, kw_only=True)
class FieldScenario:
    """A magnetometer, with an accelerometer and a gyroscope beside it if wanted, that a hand turns over the sphere."""

    duration_s: float = 90.0
    """Length of the recording in seconds."""

    rate_hz: float = 50.0
    """Sample rate of the magnetometer."""

    imu_rate_hz: float = 100.0
    """Sample rate of accelerometer and gyroscope."""

    accelerometer: bool = True
    """Whether there is an accelerometer."""

    gyroscope: bool = False
    """Whether there is a gyroscope."""

    motion: Literal["sphere", "one-axis", "still"] = "sphere"
    """sphere: through all attitudes. one-axis: turns about one axis only. still: one attitude."""

    rests: int = 0
    """How often the hand pauses, evenly over the recording."""

    rest_s: float = 2.0
    """Length of each pause in seconds."""

    field: float = 48.0
    """Strength of the local field in uT."""

    dip_deg: float = 64.0
    """Angle of the field below the horizontal in degrees; below zero south of the magnetic equator."""

    hard_iron: float = 30.0
    """The three offsets are drawn between minus and plus this, in uT."""

    soft_iron: float = 0.05
    """Entries of the symmetric matrix by which soft iron and scales differ from one are drawn between minus and plus
    this."""

    misalignment_deg: float = 3.0
    """The magnetometer is turned against the accelerometer by this angle, about a random axis."""

    noise: float = 0.3
    """White noise of a sample in uT."""

    inhomogeneity: float = 0.0
    """Standard deviation of each component by which the field differs from place to place, in uT."""

    inhomogeneity_s: float = 1.0
    """How long the hand stays where the field is alike, in seconds: the correlation time of these differences."""

    outliers: float = 0.0
    """Fraction of the samples that are wrong by up to the strength of the field."""

    disturbances: int = 0
    """How often the sensor comes near to iron."""

    disturbance: float = 15.0
    """How much each of them adds to the field at most, in uT."""

    disturbance_s: float = 3.0
    """How long each of them lasts, in seconds."""

    hand_acceleration: float = 0.3
    """Standard deviation of the hand's acceleration along each axis between pauses, in m/s^2."""

    units: str = "si"
    """Units of the recording: "si", "raw" (counts), or a list such as "g deg/s gauss"."""

    magnetometer_range: float = 800.0
    """Full scale of the magnetometer in uT; readings stop there, and counts of 16 bits end there."""

    sensor_seed: int | None = None
    """Draw the sensor's parameters from this seed, so that many recordings of one sensor can be made."""

    def __post_init__(self) -> None:
        check_ranges(self)
        above = [
            "duration_s",
            "rate_hz",
            "imu_rate_hz",
            "field",
            "inhomogeneity_s",
            "disturbance_s",
            "magnetometer_range",
        ]
        for name in above:
            if not getattr(self, name) > 0:
                raise OptionError(f"{name} {getattr(self, name):g} must be greater than zero.")
        not_below = "rests rest_s hard_iron soft_iron noise inhomogeneity disturbances disturbance hand_acceleration"
        for name in not_below.split():
            if not getattr(self, name) >= 0:
                raise OptionError(f"{name} {getattr(self, name):g} must not be below zero.")
        if not 0 <= self.outliers < 1:
            raise OptionError(f"outliers {self.outliers:g}: give a fraction from 0 to below 1.")
        if self.soft_iron >= 0.3:
            raise OptionError(f"soft_iron {self.soft_iron:g}: give less than 0.3; iron that strong is no perturbation.")
        if self.rests * self.rest_s >= self.duration_s:
            raise OptionError(f"{self.rests} rests of {self.rest_s:g} s do not fit into {self.duration_s:g} s.")
        Units.parse(self.units)
