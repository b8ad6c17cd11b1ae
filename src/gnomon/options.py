"""What a person may choose; the command line is made from these classes."""

from dataclasses import dataclass
from typing import Literal

from .errors import OptionError
from .ranges import check_ranges

Preset = Literal["gnomon", "tedaldi2014", "tedaldi2014-text", "imu_tk", "angrisano"]


@dataclass(frozen=True, slots=True, kw_only=True)
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
        _check_gravity(self.gravity)
        positive = ("window_s", "multiplier", "t_init_s", "accelerometer_range", "gyroscope_range", "full_scale")
        _check_positive(self, positive)


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraImuOptions:
    """How to calibrate cameras and an IMU that were waved together in front of a board (Krebs)."""

    model: Literal["auto", "basic", "scale-misalignment", "full"] = "auto"
    """Model: that of the IMU is ideal but for its biases (basic); with scale, misalignment and gyroscope rotation
    (scale-misalignment); with the gyroscope's g-sensitivity too, Table 4.1 of Krebs (full); or full with lever
    arms of the accelerometers, and what else the recording proves to be there, a delay of the accelerometer, errors of
    the board and of the lens (auto).
    """

    gravity: float | None = None
    """Local gravity in m/s^2, where you know it."""

    latitude: float | None = None
    """Latitude in degrees, from which normal gravity (WGS 84) is computed unless gravity is stated."""

    altitude: float = 0.0
    """Height above the ellipsoid in metres, used with --latitude."""

    noise: Literal["estimated", "coloured", "nominal"] = "estimated"
    """Weigh the measurements by the white noise found in the residuals (estimated); let the biases wander as strongly
    as they are found to, too, at least as stated (coloured); or take the nominal noise (nominal)."""

    pixel_sigma: float | None = None
    """Nominal standard deviation of a corner in px, per axis; where it is not given, the scatter of the corners about
    their frames' poses is taken."""

    knots_per_s: float | None = None
    """Knots of the trajectory's spline per second; chosen by the fastest motion and the IMU's rate where not given."""

    spline_order: Literal[4, 5, 6] = 6
    """Order of the trajectory's spline."""

    fix: tuple[str, ...] = ()
    """Parameters that keep their start value, such as imu0.B_g or cam0.time_shift_cam_imu."""

    free: tuple[str, ...] = ()
    """Parameters to estimate that are fixed otherwise, such as cam0.intrinsics, cam0.line_delay or target.scale."""

    prior: tuple[str, ...] = ()
    """Parameters to estimate with a prior about their start value, NAME=SIGMA, such as cam0.intrinsics=2; or a file
    with what is known of the IMU, a calibration.yaml."""

    origin: str = "optimal"
    """Point of the IMU to which T_cam_imu refers where lever arms of the accelerometers are estimated: the one whose
    place is known best, p* (optimal); the x, y or z accelerometer; or a place from the x accelerometer in the IMU's
    axes, in metres with commas between, such as 0.010,0,-0.005."""

    line_delay: float | None = None
    """Time from one image row to the next in seconds, of every camera (rolling shutter)."""

    robust: bool = True
    """Single corners that fit badly count less (Huber), and whole frames that do are left out; with --no-robust all of
    them count alike."""

    covariance: Literal["robust", "ordinary"] = "robust"
    """Take the uncertainty from the scatter between clusters of time, which holds where errors are correlated (robust),
    or count all errors as independent (ordinary)."""

    accelerometer_range: float | None = None
    """Full scale of the accelerometer, in m/s^2; samples at or beyond it are masked."""

    gyroscope_range: float | None = None
    """Full scale of the gyroscope, in rad/s; samples at or beyond it are masked."""

    compare: bool = False
    """Estimate the basic model too, to compare what both predict (Figs. 5.6 and 5.7 of Krebs). The command line
    always does for a report, which shows it."""

    marginals: bool = False
    """Give the standard deviations of the trajectory and the biases over time, too."""

    max_iterations: int = 30
    """Most Gauss-Newton iterations of one solution."""

    def __post_init__(self) -> None:
        check_ranges(self)
        _check_gravity(self.gravity)
        if self.origin != "optimal":
            from .models.origin import Origin  # NumPy, which --help does without

            Origin.stated(self.origin)
        for text in self.prior:
            if "=" in text:  # the others are files, which the command line reads
                stated_prior(text)
        _check_positive(
            self, ("pixel_sigma", "knots_per_s", "accelerometer_range", "gyroscope_range", "max_iterations")
        )


@dataclass(frozen=True, slots=True, kw_only=True)
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


def stated_prior(text: str) -> tuple[str, float]:
    """Return name and standard deviation of a prior, from NAME=SIGMA.

    Raises
    ------
    OptionError
        If it is not of this form, or the standard deviation is not greater than zero.
    """
    name, equals, value = text.partition("=")
    try:
        sigma = float(value)
    except ValueError:
        sigma = float("nan")
    if not equals or not 0 < sigma < float("inf"):
        raise OptionError(
            f"--prior {text}: expected NAME=SIGMA with SIGMA greater than zero, as cam0.intrinsics=2, or a file on the "
            "command line (in Python: prior=gnomon.load(file))."
        )
    return name, sigma


def _check_gravity(gravity_m_s2: float | None) -> None:
    if gravity_m_s2 is not None and not 9.0 < gravity_m_s2 < 10.5:
        raise OptionError(
            f"gravity {gravity_m_s2:g} m/s^2 is found nowhere on Earth (9.76 to 9.84). "
            "Give the local value in m/s^2, or --latitude and --altitude."
        )


def _check_positive(options: object, names: tuple[str, ...]) -> None:
    for name in names:
        value = getattr(options, name)
        if value is not None and not value > 0:
            raise OptionError(f"{name} {value:g} must be greater than zero.")
