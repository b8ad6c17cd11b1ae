"""Options of the calibrations, of one sensor and of cameras with IMUs; and the ranges of all numbers among options."""

from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from math import isfinite, isnan, nan, pi
from typing import Any, Literal, get_args

from ..errors import OptionError
from ..frozen import value_class

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
        check_ranges(self, positive="t_init_s accelerometer_range gyroscope_range full_scale")


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
        check_stretch(self.start_s, self.stop_s)


_LABELS_RPM = (16.0, 50 / 3, 33.0, 100 / 3, 33.5, 45.0, 78.0, 78.26)
_LABEL_SIGMA, _OTHER_SIGMA = 1e-2, 1e-3
"""Relative: record players may be 1 % off and more (DIN 45500: -1 to +1.5 %); what is on no label was measured."""


def default_rate_sigma(rate_rad_s: float) -> float:
    """Return how well a rate is known of which only the number is stated, relative.

    Examples
    --------
    >>> default_rate_sigma(33.33 * pi / 30), default_rate_sigma(33.41 * pi / 30)
    (0.01, 0.001)
    """
    rpm = rate_rad_s * 30 / pi
    return _LABEL_SIGMA if any(abs(rpm - label) < 1.5e-3 * label for label in _LABELS_RPM) else _OTHER_SIGMA


@value_class(eq=True)
class StatedRate:
    """The rate of a turntable, as somebody stated it or as a video showed it.

    Attributes
    ----------
    name : as stated, such as "16rpm", or the name of the video
    rate_rad_s : [rad/s], 0 for a turntable at rest
    sigma_rad_s : its standard deviation [rad/s]; 0 where it is taken as exact. Where it is not stated, that of a record
        player's label (1 %) for the speeds that are on such labels, else 0.1 %
    turns : turns that a video showed; nan where there was none
    """

    name: str
    rate_rad_s: float
    sigma_rad_s: float = nan
    turns: float = nan

    def __post_init__(self) -> None:
        if isnan(self.sigma_rad_s):
            object.__setattr__(self, "sigma_rad_s", default_rate_sigma(self.rate_rad_s) * self.rate_rad_s)


@value_class(eq=True)
class TurntableOptions:
    """How to calibrate a gyroscope on a turntable (Angrisano)."""

    model: Literal["auto", "basic", "g-sensitivity"] = "auto"
    """Gyroscope bias: constant (basic), linear in the specific force (g-sensitivity), or chosen by hold-out (auto)."""

    rate_sigma: float | None = None
    """Relative standard deviation of rates that were stated as numbers: by default 0.01 of speeds that are on the label
    of a record player (16, 33 1/3, 45, 78 rpm), 0.001 of others."""

    sense: Literal["auto", "clockwise", "counterclockwise"] = "auto"
    """Which way the platter turns, seen from above; both triads are taken for right-handed where it is not stated."""

    gravity: float | None = None
    """Local gravity in m/s^2, where you know it."""

    latitude: float | None = None
    """Latitude in degrees, from which the earth's rate and, unless stated, normal gravity (WGS 84) are computed."""

    altitude: float = 0.0
    """Height above the ellipsoid in metres, used with --latitude."""

    fix: tuple[str, ...] = ()
    """Parameters that keep their prior value, such as imu0.gyroscope.g_sensitivity."""

    free: tuple[str, ...] = ()
    """Parameters to estimate that are fixed otherwise, such as rate.scale."""

    prior: tuple[str, ...] = ()
    """What is known beforehand: a calibration.yaml, a noise.yaml, or NAME=SIGMA, such as imu0.gyroscope.bias=0.01."""

    accelerometer_range: float | None = None
    """Full scale of the accelerometer, in the recording's unit; samples at or beyond it are masked."""

    gyroscope_range: float | None = None
    """Full scale of the gyroscope, in the recording's unit; samples at or beyond it are masked."""

    def __post_init__(self) -> None:
        check_ranges(self, positive="accelerometer_range gyroscope_range")


@value_class(eq=True)
class MagnetometerOptions:
    """How to calibrate a magnetometer."""

    field: float | None = None
    """Strength of the local magnetic field in uT, where you know it; otherwise it is the unit of the result."""

    dip: float | None = None
    """Angle of the local field below the horizontal in degrees, below zero where it points up; checks handedness."""

    latitude: float | None = None
    """Latitude in degrees: which way the field dips there checks the handedness of the axes."""

    model: Literal["auto", "hard-iron", "full"] = "auto"
    """Every entry of the sensitivity (full, auto), or offset and one scale (hard-iron), soft iron left out."""

    fix: tuple[str, ...] = ()
    """Parameters that keep their prior value, such as imu0.magnetometer.bias."""

    free: tuple[str, ...] = ()
    """Parameters of which a prior calibration is not asked, such as imu0.accelerometer."""

    prior: tuple[str, ...] = ()
    """What is known beforehand: a calibration.yaml, or NAME=SIGMA, such as imu0.magnetometer.bias=5."""

    magnetometer_range: float | None = None
    """Full scale of the magnetometer, in the recording's unit; samples at or beyond it are masked."""

    def __post_init__(self) -> None:
        check_ranges(self)


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
        check_ranges(self, positive="baseline_sigma")
        if isinstance(self.model, str):  # one name, as people write it in Python
            object.__setattr__(self, "model", (self.model,))
        if isinstance(self.among, str):
            object.__setattr__(self, "among", (self.among,))
        if self.model and self.among:
            raise OptionError("model states the lens, and among from which it is chosen. Leave out one of them.")
        for name, known in (("board", BOARDS), ("covariance", COVARIANCES)):
            if getattr(self, name) not in known:
                raise OptionError(f"{name} {getattr(self, name)!r} must be one of {', '.join(known)}.")


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
        check_ranges(self, positive="accelerometer_range gyroscope_range")
        if self.origin != "optimal":
            from ..models.origin import Origin

            Origin.stated(self.origin)
        for text in self.prior:
            if "=" in text:  # the others are files, which the command line reads
                stated_prior(text)


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


_HUGE = 1e9
_DAY_S = 86400.0
_RANGES: dict[str, tuple[float, float]] = {
    "altitude": (-12_000, 100_000),
    "baseline": (1e-4, 1e4),
    "between": (0, 10_000),
    "bits": (2, 32),
    "cols": (1, 1000),
    "covers": (0, 1000),
    "dip_deg": (-90, 90),
    "disturbances": (0, 10_000),
    "earth_rate_latitude": (-90, 90),
    "field": (1e-3, 1e6),
    "first": (0, 100_000),
    "focus_m": (1e-3, 1e4),
    "gravity": (9.0, 10.5),
    "height": (1, 16_384),
    "imus": (1, 100),
    "intervals": (1, 10_000),
    "jobs": (1, 1024),
    "knots_per_s": (0.01, 10_000),
    "latitude": (-90, 90),
    "line_delay": (-1.0, 1.0),
    "max_iterations": (1, 10_000),
    "multiplier": (1e-3, 1e6),
    "pixel_sigma": (1e-6, 1000),
    "poses": (1, 10_000),
    "rate": (1e-3, 1e6),
    "rate_rad_s": (-1000, 1000),
    "rate_sigma": (0, 1),
    "resolution": (1, 65_536),
    "rests": (0, 10_000),
    "rows": (1, 1000),
    "rpm": (-10_000, 10_000),
    "runs": (1, 1_000_000),
    "sample_rate": (1e-3, 1e6),
    "samples": (1, 10_000_000),
    "start_s": (-1e10, 1e10),
    "stop_s": (-1e10, 1e10),
    "symmetry": (1, 1000),
    "target_cols": (1, 1000),
    "target_rows": (1, 1000),
    "touched": (0, 10_000),
    "views": (1, 100_000),
    "width": (1, 16_384),
    "window_s": (1e-3, _DAY_S),
    "workers": (1, 1024),
}
"""Name of an option -> its least and its largest value."""
_ENDINGS: dict[str, tuple[float, float]] = {
    "seed": (0, 2.0**64),
    "_hz": (1e-3, 1e6),
    "_deg": (-360, 360),
    "_m": (-1e4, 1e4),
    "_px": (-1e5, 1e5),
    "duration_s": (1e-3, 40 * _DAY_S),
    **dict.fromkeys(("hold_s", "init_s", "motion_s", "rest_s", "wait_s", "steady_s", "handling_s"), (0, _DAY_S)),
    **dict.fromkeys(("spin_up_s", "spin_down_s", "exposure_s"), (0, _DAY_S)),
    "clock_offset_s": (-1e10, 1e10),
    "_s": (-1e7, 1e7),
    "": (-_HUGE, _HUGE),
}
"""Ending of a name -> the same, for all others; the first that fits."""


def option_range(name: str) -> tuple[float, float]:
    """Return the least and the largest value of an option.

    Examples
    --------
    >>> option_range("latitude"), option_range("gyroscope_rate_hz")
    ((-90, 90), (0.001, 1000000.0))
    """
    if name in _RANGES:
        return _RANGES[name]
    return next(limits for ending, limits in _ENDINGS.items() if name.endswith(ending))


def check_ranges(options: Any, *, positive: str = "", not_negative: str = "", fractions: str = "") -> None:
    """Check all numbers in a dataclass of options, and in those in it.

    Parameters
    ----------
    positive, not_negative, fractions : names of options, with spaces between, that must be greater than zero; not below
        zero; from zero to below one

    Raises
    ------
    OptionError
        If one is not finite, or outside of its range.
    """
    for name, value in _numbers(options):
        least, most = option_range(name)
        if not isfinite(value):
            raise OptionError(f"{name} {value:g} is not a finite number. Give one from {least:g} to {most:g}.")
        if not least <= value <= most:
            raise OptionError(f"{name} {value:g} is out of range. Give a number from {least:g} to {most:g}.")
    for names, fits, wanted in (
        (positive, lambda value: value > 0, " must be greater than zero."),
        (not_negative, lambda value: value >= 0, " must not be below zero."),
        (fractions, lambda value: 0 <= value < 1, ": give a fraction from 0 to below 1."),
    ):
        for name in names.split():
            value = getattr(options, name)
            if value is not None and not fits(value):
                raise OptionError(f"{name} {value:g}{wanted}")


def _numbers(options: Any) -> Iterator[tuple[str, float]]:
    """Yield the name and the value of every number, those in tuples too."""
    for entry in fields(options):
        todo: list[Any] = [getattr(options, entry.name)]
        while todo:
            value = todo.pop()
            if isinstance(value, tuple):
                todo.extend(value)  # pyright: ignore[reportUnknownArgumentType]
            elif isinstance(value, int | float) and not isinstance(value, bool):
                yield entry.name, value
            elif is_dataclass(value) and not isinstance(value, type):
                yield from _numbers(value)


def check_stretch(start_s: float, stop_s: float | None) -> None:
    """Raise an OptionError where a part of a recording ends before it begins, or begins before the recording does."""
    if not 0 <= start_s < float("inf"):
        raise OptionError(f"start_s {start_s:g} must be zero or more.")
    if stop_s is not None and not stop_s > start_s:
        raise OptionError(f"stop_s {stop_s:g} must be later than start_s {start_s:g}.")
