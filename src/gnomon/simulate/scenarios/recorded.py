"""What to simulate of an IMU alone, in poses or over its temperature, of a magnetometer, of noise.

Commands show these options. Needs no NumPy.
"""

from dataclasses import dataclass
from math import radians
from typing import Literal

from ...errors import OptionError
from ...options import check_ranges
from ...units import Units

Attitudes = Literal["angrisano18", "six", "seven", "sphere"]

Nine = tuple[float, float, float, float, float, float, float, float, float]


@dataclass(frozen=True, kw_only=True)
class RecordedSensor:
    """Where a sensor is, and how its readings are recorded."""

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

    gyroscope_range: float = radians(150.0)
    """Full scale of the gyroscope in rad/s; readings stop there."""

    accelerometer_noise_density: float = 2e-3
    """White noise in m/s^2/sqrt(Hz)."""

    gyroscope_noise_density: float = 8.7e-4
    """White noise in rad/s/sqrt(Hz)."""

    sensor_seed: int | None = None
    """Draw the sensor's parameters from this seed, so that many recordings of one sensor can be made."""

    def check(self, *, positive: str = "", not_negative: str = "", fractions: str = "") -> None:
        """Check the ranges of all numbers; see `check_ranges`."""
        check_ranges(
            self,
            positive=f"{positive} accelerometer_range gyroscope_range",
            not_negative=f"{not_negative} accelerometer_noise_density gyroscope_noise_density",
            fractions=fractions,
        )
        Units.parse(self.units)


@dataclass(frozen=True, slots=True, kw_only=True)
class Scenario(RecordedSensor):
    """A multi-position recording by hand (Tedaldi 2014, section 4.1) of an IMU with drawn parameters."""

    style: Literal["hand", "thesis"] = "hand"
    """hand: smooth turns about changing axes between attitudes that cover the sphere. thesis: as Tedaldi 2014 describes
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
    """Standard deviation of the timestamps about the instants of sampling, in seconds."""

    stamp_resolution_s: float = 0.0
    """Timestamps are rounded to multiples of this, in seconds."""

    dropped: float = 0.0
    """Fraction of the samples that are lost, one by one."""

    touched: int = 0
    """Static intervals that are not quite still: something pushes and tilts the sensor a little halfway."""

    touch_acceleration: float = 0.05
    """Peak acceleration of a touch in m/s^2."""

    touch_angle: float = 0.003
    """Peak angle of a touch in radians."""

    def __post_init__(self) -> None:
        self.check(
            positive="t_init_s",
            not_negative="accelerometer_misalignment gyroscope_misalignment accelerometer_bias gyroscope_bias "
            "gyroscope_bias_walk g_sensitivity stamp_jitter_s stamp_resolution_s touch_acceleration touch_angle",
            fractions="dropped",
        )
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
            raise OptionError("touched: the signals of Tedaldi 2014 (style thesis) have none. Choose style hand.")
        if self.attitudes == "one-axis" and self.style == "thesis":
            raise OptionError("attitudes one-axis: the signals of Tedaldi 2014 (style thesis) have none. Choose hand.")


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseScenario(RecordedSensor):
    """A sensor that is laid down in one attitude after another, and what is recorded while it lies still."""

    attitudes: Attitudes = "angrisano18"
    """angrisano18: the six faces and the twelve edges of a cube up, as with Angrisano's wedge of 45 deg. six: the
    faces. seven: Krebs's static experiment, -z -y z y x -x -z. sphere: evenly spread directions."""

    poses: int = 24
    """How many attitudes of "sphere"; the other sets have their own number."""

    attitude_error_deg: float = 1.0
    """How well the sensor is laid down: standard deviation of the tilt about each axis, in degrees. Angrisano:
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

    sensor: Literal["angrisano", "drawn"] = "angrisano"
    """angrisano: the MTi of Angrisano (Tables 1 and 3), in counts. drawn: as `gnomon simulate` draws one."""

    units: str = "raw"
    """Units of the readings: "si", "raw" (counts), or a list such as "g deg/s"."""

    g_sensitivity: Nine = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    """The gyroscope's g-sensitivity, row by row, in rad/s per m/s^2."""

    gyroscope_drift: float = 0.0
    """How far the gyroscope's bias moves from the first pose to the last, along each axis, in rad/s; steadily."""

    def __post_init__(self) -> None:
        self.check(not_negative="attitude_error_deg")
        units = Units.parse(self.units)
        raw = units.accelerometer == units.gyroscope == "count"
        if self.sensor == "angrisano" and not (raw and self.bits in (None, 16)):
            raise OptionError(
                'sensor angrisano: it reads counts of 16 bits. Leave units "raw" and bits 16, or choose drawn.'
            )


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

    heating_k: float = 0.0
    """By which the chip warms up in the first half of the recording, and cools again in the second, in K; above 0 its
    thermometer is recorded."""

    lag_s: float = 0.0
    """By which the thermometer follows the sensor, in seconds."""

    offset_drift: float = 0.0
    """Usual size of what a kelvin changes of each offset, in uT/K."""

    sensitivity_drift: float = 0.0
    """The same of the three scales, relative, in 1/K."""

    sensor_seed: int | None = None
    """Draw the sensor's parameters from this seed, so that many recordings of one sensor can be made."""

    def __post_init__(self) -> None:
        check_ranges(
            self,
            positive="inhomogeneity_s disturbance_s magnetometer_range",
            not_negative="hard_iron soft_iron noise inhomogeneity disturbance hand_acceleration heating_k lag_s "
            "offset_drift sensitivity_drift",
            fractions="outliers",
        )
        if self.soft_iron >= 0.3:
            raise OptionError(f"soft_iron {self.soft_iron:g}: give less than 0.3; iron that strong is no perturbation.")
        if self.rests * self.rest_s >= self.duration_s:
            raise OptionError(f"{self.rests} rests of {self.rest_s:g} s do not fit into {self.duration_s:g} s.")
        Units.parse(self.units)


@dataclass(frozen=True, slots=True, kw_only=True)
class NoiseScenario:
    """A long recording of an IMU at rest, with noise of known coefficients, the same in all axes."""

    duration_s: float = 10_800.0
    """Length in seconds."""

    rate_hz: float = 100.0
    """Sample rate."""

    accelerometer_white_noise: float = 2e-3
    """N in m/s^2/sqrt(Hz)."""

    accelerometer_bias_instability: float = 7e-4
    """B in m/s^2; the floor of the Allan deviation is 0.664 B."""

    accelerometer_random_walk: float = 8e-5
    """K in m/s^3/sqrt(Hz)."""

    accelerometer_quantisation: float = 0.0
    """Q in m/s."""

    accelerometer_rate_ramp: float = 0.0
    """R in m/s^3."""

    gyroscope_white_noise: float = 2e-4
    """N in rad/s/sqrt(Hz)."""

    gyroscope_bias_instability: float = 7e-5
    """B in rad/s; the floor of the Allan deviation is 0.664 B."""

    gyroscope_random_walk: float = 8e-6
    """K in rad/s^2/sqrt(Hz)."""

    gyroscope_quantisation: float = 0.0
    """Q in rad."""

    gyroscope_rate_ramp: float = 0.0
    """R in rad/s^2."""

    def __post_init__(self) -> None:
        check_ranges(self, not_negative=" ".join(self.__slots__))
        if self.samples < 2:
            raise OptionError(f"duration_s {self.duration_s:g} at {self.rate_hz:g} Hz makes no two samples.")

    @property
    def samples(self) -> int:
        """Length in samples."""
        return round(self.duration_s * self.rate_hz)

    def of(self, sensor: str) -> dict[str, float]:
        """Return the coefficients of the "accelerometer" or the "gyroscope" by name."""
        names = ("white_noise", "bias_instability", "random_walk", "quantisation", "rate_ramp")
        return {name: getattr(self, f"{sensor}_{name}") for name in names}


@dataclass(frozen=True, slots=True, kw_only=True)
class TemperatureScenario:
    """Recordings of one IMU over its temperature, each from one switching-on, with its thermometer."""

    recordings: int = 3
    """How many."""

    turned: bool = False
    """Turn it from rest to rest, at one temperature in each recording, from start to end, instead of warm-ups."""

    intervals: int = 30
    """Rests of a recording in which it is turned."""

    self_heating_k: float = 2.0
    """By which it warms up while it is turned, in K."""

    duration_s: float = 1200.0
    """Length of each warm-up in seconds."""

    rate_hz: float = 50.0
    """Sample rate."""

    start_degc: float = 0.0
    """Temperature at the start, as from a freezer; another by about 1 degC each time."""

    end_degc: float = 45.0
    """Temperature that it approaches."""

    time_constant_s: float = 250.0
    """Of the approach, in seconds."""

    back: bool = False
    """Cool down to the start again in the second half."""

    order: int = 2
    """Order of the polynomials of the biases, 0 to 3; their coefficients are drawn."""

    sensitivity_order: int = 1
    """The same of sensitivities, which show where it is turned."""

    sensitivity: float = 1e-4
    """Usual size of their first coefficients, relative, in 1/K."""

    g_sensitivity: float = 0.0
    """The same of the gyroscope's g-sensitivity, to first order, in rad/s per m/s^2 and K; it is 300 times as large."""

    sensitivity_scatter: float = 1.5e-4
    """Scatter of scales, and of misalignments in rad, from one switching-on to the next, as of eight MPU-9150."""

    lag_s: float = 0.0
    """By which the thermometer follows the sensor, in seconds."""

    step_k: float = 0.1
    """Steps of the thermometer."""

    thermometer_noise: float = 0.02
    """Of each reading, in K."""

    thermometer_rate_hz: float = 50.0
    """Readings of the thermometer a second."""

    gyroscope_turn_on: float = 1e-3
    """Scatter of the bias from one switching-on to the next, in rad/s."""

    accelerometer_turn_on: float = 5e-3
    """The same in m/s^2."""

    gyroscope_white_noise: float = 2e-4
    """Of warm-ups, in rad/s/sqrt(Hz)."""

    accelerometer_white_noise: float = 2e-3
    """The same in m/s^2/sqrt(Hz)."""

    gyroscope_bias_instability: float = 7e-5
    """Of warm-ups, in rad/s."""

    branches: float = 0.0
    """By how much more the gyroscope reads while the temperature rises than while it falls, in rad/s."""

    def __post_init__(self) -> None:
        positive = "recordings intervals duration_s rate_hz time_constant_s thermometer_rate_hz"
        check_ranges(
            self,
            positive=positive,
            not_negative="order sensitivity_order sensitivity g_sensitivity sensitivity_scatter self_heating_k lag_s "
            "step_k thermometer_noise gyroscope_turn_on accelerometer_turn_on gyroscope_white_noise "
            "accelerometer_white_noise gyroscope_bias_instability",
        )
        if max(self.order, self.sensitivity_order) > 3:
            raise OptionError(
                f"order {max(self.order, self.sensitivity_order)}: polynomials of order 0 to 3 are drawn."
            )
