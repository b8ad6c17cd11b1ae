"""What to simulate of a sensor on a turntable, and of a webcam that sees a platter turn; shown by commands."""

from dataclasses import dataclass
from math import pi
from typing import Literal

from ...errors import OptionError
from ...options import check_ranges
from .recorded import RecordedSensor


@dataclass(frozen=True, slots=True, kw_only=True)
class TurntableScenario(RecordedSensor):
    """A sensor that lies on a record player in one attitude after another (Angrisano, fig. 7)."""

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

    g_sensitivity: float = 0.0
    """Elements of the gyroscope's g-sensitivity are drawn between minus and plus this, in rad/s per m/s^2."""

    gyroscope_drift: float = 0.0
    """How far the gyroscope's bias moves from beginning to end, along each axis, in rad/s; steadily."""

    def __post_init__(self) -> None:
        self.check(positive="steady_s", not_negative="radius wow speed_scatter g_sensitivity")
        if any(not speed >= 0 for speed in self.rpm):
            raise OptionError("rpm must not be below zero; counter_clockwise says which way the platter turns.")


@dataclass(frozen=True, slots=True, kw_only=True)
class PlatterScenario:
    """A webcam that looks at a turning platter, as in the gyroscope experiment of Angrisano (fig. 7)."""

    rate_rad_s: float = 2 * pi * 16 / 60
    """Rate of the platter in rad/s; negative turns the other way."""

    duration_s: float = 60.0
    """Length of the video in seconds."""

    frame_rate_hz: float = 15.0
    """Frames in a second."""

    width: int = 640
    """Pixels of a row."""

    height: int = 480
    """Rows of an image."""

    exposure_s: float = 0.03
    """For so long a frame is exposed, in seconds; the platter blurs meanwhile."""

    jitter_s: float = 0.003
    """Standard deviation of the instants of the frames about even ones, in seconds."""

    stamps: Literal["true", "nominal"] = "true"
    """true: the video states the instant of each frame. nominal: it states even ones at the nominal frame rate."""

    clock_error: float = 0.0
    """By this share the camera is faster than its nominal frame rate."""

    dropped: float = 0.0
    """Share of frames that are missing; in a video with nominal timestamps nothing tells where."""

    noise_grey: float = 3.0
    """Standard deviation of a pixel's noise in grey levels."""

    flicker: float = 0.01
    """Share by which the brightness varies, by lamps and by the camera's exposure control."""

    start_s: float = 0.0
    """The platter begins to turn after so many seconds."""

    spin_up_s: float = 0.0
    """Time constant with which it reaches its speed, in seconds."""

    stop_s: float | None = None
    """After so many seconds the motor is switched off; never where it is not given."""

    spin_down_s: float = 2.0
    """Time constant with which it comes to rest, in seconds."""

    wow: float = 0.001
    """Share by which the speed swings with a period of 1.7 turns."""

    drift: float = 0.0
    """Share by which the speed rises over the video."""

    flutter: float = 0.0
    """Random walk of the phase by irregular speed, in rad after one second."""

    texture: float = 1.0
    """Contrast of the print on the label; 0 is a plain one."""

    symmetry: int = 1
    """The print looks the same after a turn by 1/symmetry."""

    mark: bool = True
    """Whether a mark is drawn on the platter."""

    sensor: bool = True
    """Whether the sensor lies on the platter."""

    tilt_deg: float = 30.0
    """Angle of the camera's axis to the platter's in degrees."""

    radius: float = 0.8
    """Radius of the platter in the image, in halves of the image's height."""

    offset: tuple[float, float] = (0.0, 0.0)
    """Where the platter's centre is seen, to the right and down from the image's, in halves of its height."""

    hidden: tuple[tuple[float, float], ...] = ()
    """From when to when a hand is before the platter, in seconds."""

    background: float = 0.0
    """How much something in the background moves; 1 is a person walking about."""

    motion: Literal["turn", "swing", "blink"] = "turn"
    """What the platter does; swing and blink are periodic, too, but have no rate."""

    def __post_init__(self) -> None:
        check_ranges(
            self, positive="radius", not_negative="jitter_s noise_grey flutter background", fractions="dropped"
        )
        if not abs(self.tilt_deg) < 80:
            raise OptionError(f"tilt_deg {self.tilt_deg!r} must be between -80 and 80.")
