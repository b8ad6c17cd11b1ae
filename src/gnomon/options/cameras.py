"""Options of calibrations of cameras, alone and with IMUs."""

from typing import Literal, get_args

from ..errors import OptionError
from ..frozen import value_class
from .ranges import check_gravity, check_positive, check_ranges, check_stretch

BoardModel = Literal["auto", "stated", "aspect", "bow", "corners"]
CovarianceKind = Literal["robust", "ordinary"]
BOARDS, COVARIANCES = get_args(BoardModel), get_args(CovarianceKind)


@value_class(eq=True)
class FrameSelection:
    """Which frames of a recording are taken; what the IMU read beyond them may stay."""

    start_s: float = 0.0
    """Leave out this long at the start of the images, in seconds."""

    stop_s: float | None = None
    """Leave out the images that come later than this, in seconds from the first one."""

    frame_rate_hz: float | None = None
    """Take at most so many images a second: 20 are enough."""

    def __post_init__(self) -> None:
        check_ranges(self)
        check_stretch(self.start_s, self.stop_s)


@value_class(eq=True)
class CameraOptions:
    """How to calibrate one or several cameras from views of a board."""

    model: tuple[str, ...] = ()
    """Lens model of every camera, such as pinhole-radtan, or of each, cam0=pinhole-radtan cam1=ds-none; chosen by
    hold-out where it is not given."""

    among: tuple[str, ...] = ()
    """Lens models to choose from, such as pinhole-radtan pinhole-equidistant; the usual ones where not given, of which
    one that every program reads is taken where it predicts hold-out views within 3 % of the best."""

    board: BoardModel = "auto"
    """What of the board is estimated: nothing (stated), its scale along y over that along x (aspect), how it bends too
    (bow), the place of every corner (corners), or what the views prove to be there (auto)."""

    views: int | None = None
    """Most views to use, the most informative ones; chosen by what further ones would add where it is not given."""

    baseline: float | None = None
    """Measured distance of cam1 from cam0 in metres, which tells the true size of the board."""

    baseline_sigma: float = 1e-4
    """Standard deviation of that distance in metres."""

    robust: bool = True
    """Single corners that fit badly count less (Huber), and whole views that do are left out; with --no-robust all of
    them count alike."""

    covariance: CovarianceKind = "robust"
    """Take the uncertainty from the scatter between views, which holds where the errors of a view are correlated
    (robust), or count all errors as independent (ordinary)."""

    max_iterations: int = 50
    """Most iterations of one solution."""

    def __post_init__(self) -> None:
        check_ranges(self)
        if isinstance(self.model, str):  # one name, as people write it in Python
            object.__setattr__(self, "model", (self.model,))
        if isinstance(self.among, str):
            object.__setattr__(self, "among", (self.among,))
        if self.model and self.among:
            raise OptionError("model states the lens, and among from which it is chosen. Leave out one of them.")
        for name, known in (("board", BOARDS), ("covariance", COVARIANCES)):
            if getattr(self, name) not in known:
                raise OptionError(f"{name} {getattr(self, name)!r} must be one of {', '.join(known)}.")
        for name in ("views", "baseline", "baseline_sigma", "max_iterations"):
            value = getattr(self, name)
            if value is not None and not 0 < value < float("inf"):
                raise OptionError(f"{name} {value:g} must be greater than zero.")


@value_class(eq=True)
class CameraImuOptions:
    """How to calibrate cameras and an IMU that were waved together in front of a board (Krebs)."""

    model: Literal["auto", "basic", "scale-misalignment", "full"] = "auto"
    """Model: that of the IMU is ideal but for its biases (basic); with scale, misalignment and gyroscope rotation
    (scale-misalignment); with the gyroscope's g-sensitivity too, Table 4.1 of Krebs (full); or full with lever
    arms of the accelerometers, and what else the recording proves to be there, a rolling shutter's line delay, a delay
    of the accelerometer, the exposure of images, errors of the board and of the lens (auto).
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
        check_gravity(self.gravity)
        if self.origin != "optimal":
            from ..models.frames import Origin  # NumPy, which --help does without

            Origin.stated(self.origin)
        for text in self.prior:
            if "=" in text:  # the others are files, which the command line reads
                stated_prior(text)
        check_positive(self, ("pixel_sigma", "knots_per_s", "accelerometer_range", "gyroscope_range", "max_iterations"))


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
