"""How a result came about: what a report draws and `diagnostics.npz` keeps. Values only."""

from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from .calibration import Calibration, Gravity
from .recording import Floats, FrameQuality
from .trust import Trust

TriadKind = Literal["poses", "turntable", "magnetometer"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PoseTable:
    """Poses in which one triad measured a vector of known magnitude, in the order of the recording.

    Attributes
    ----------
    name : (n,) what a person knows the pose by: a file, a row, a number
    start_s, stop_s : (n,) when [s from the start of the recording]; nan where that is not known
    samples : (n,) samples of which the mean was taken; 0 where that is not known
    measured : (n, 3) mean [unit]
    magnitude : (n,) known magnitude [SI]; 0 for a turntable at rest
    direction : (n, 3) estimated direction of the true vector, body frame, unit vectors; nan where its magnitude is 0
    error_before : (n,) |x| - magnitude with one nominal scale and no bias, as an uncalibrated sensor would read [SI]
    error_after : (n,) |x| - magnitude of the fit [SI]
    error_holdout : (n,) |x| - magnitude when this pose was left out of the fit [SI]
    sigma : (n,) predicted sigma of error_after [SI]
    used : (n,) bool
    reason : (n,) why it was not used, or ""
    """

    name: tuple[str, ...]
    start_s: Floats
    stop_s: Floats
    samples: np.ndarray
    measured: Floats
    magnitude: Floats
    direction: Floats
    error_before: Floats
    error_after: Floats
    error_holdout: Floats
    sigma: Floats
    used: np.ndarray
    reason: tuple[str, ...]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class IterationHistory:
    """The paper's iteration (preset angrisano): after each step the residual quadratic form q, and X, (k, 9)."""

    q: Floats
    parameters: Floats


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TriadRecord:
    """One triad of a calibration from magnitudes.

    Attributes
    ----------
    quantity : "specific force", "angular rate" or "magnetic field"
    unit : of the measurements
    si_unit : of the true quantity: "m/s^2", "rad/s", "uT", or "" where the field's strength is the unit
    poses : see there
    noise_sigma : typical sigma of a mean by the noise at rest [SI]
    extra_sigma : what the residuals show beyond it [SI]; 0 where nothing was found
    history : of the paper's iteration, or None
    """

    quantity: str
    unit: str
    si_unit: str
    poses: PoseTable
    noise_sigma: float
    extra_sigma: float
    history: IterationHistory | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GyroscopeAtRest:
    """Gyroscope at rest in several attitudes (the static experiment of Krebs, section 5.2).

    Attributes
    ----------
    t_s : (n,) middle of each rest [s from the start of the recording]
    force : (n, 3) specific force, body frame [m/s^2]
    measured : (n, 3) mean rate [unit]
    predicted : (n, 3) bias + drift + g_sensitivity @ force (+ earth's rate) [unit]
    drift : (n, 3) estimated drift of the bias, mean 0 [unit]
    sigma : (n, 3) of a mean [unit]
    unit : of the measurements
    """

    t_s: Floats
    force: Floats
    measured: Floats
    predicted: Floats
    drift: Floats
    sigma: Floats
    unit: str


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TurntableRate:
    """One speed of a turntable.

    Attributes
    ----------
    name : as stated: "16rpm", or the name of a video
    stated, stated_sigma : known rate and its sigma [rad/s]
    estimated, estimated_sigma : rate after the fit (the same where it was held) [rad/s]
    parts : number of steady parts at this speed
    turns : turns that a video showed; nan where there was none
    """

    name: str
    stated: float
    stated_sigma: float
    estimated: float
    estimated_sigma: float
    parts: int
    turns: float = float("nan")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PeriodCurve:
    """What a video of the platter showed.

    Attributes
    ----------
    period_s, score : (k,) candidate periods and how well the picture repeats after them
    t_s, phase_error_turns : (m,) phase of the platter minus that of a constant rate
    """

    name: str
    period_s: Floats
    score: Floats
    t_s: Floats
    phase_error_turns: Floats


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DipTable:
    """Angle between magnetic field and horizontal in each attitude in which the accelerometer rested [rad]."""

    attitude: Floats
    dip_rad: Floats
    estimated_rad: float
    sigma_rad: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TriadTrial:
    """One candidate model: its held-out error of the magnitude [SI] and its number of parameters."""

    model: str
    chosen: bool
    holdout_rms: float
    parameters: int


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TriadDiagnostics:
    """How a calibration from magnitudes came about.

    Attributes
    ----------
    kind : what was done: "poses" (accelerometer in static poses), "turntable" or "magnetometer"
    triads : "accelerometer", "gyroscope", "magnetometer" -> record, those that were calibrated
    gravity : what was taken for gravity, where it played a role
    at_rest : gyroscope at rest, where g-sensitivity came from it
    rates : speeds of a turntable
    videos : what videos of it showed
    dip : of a magnetometer with accelerometer
    trials : models that were compared
    noise : name -> value, as in ImuDiagnostics
    trust : what the recording tells of its own calibration's uncertainty
    """

    kind: TriadKind
    triads: dict[str, TriadRecord]
    gravity: Gravity | None = None
    at_rest: GyroscopeAtRest | None = None
    rates: tuple[TurntableRate, ...] = ()
    videos: tuple[PeriodCurve, ...] = ()
    dip: DipTable | None = None
    trials: tuple[TriadTrial, ...] = ()
    noise: dict[str, float] = field(default_factory=dict[str, float])
    trust: Trust | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SignalEnvelope:
    """A three-axis signal reduced to the extremes of consecutive bins, so that no peak is lost.

    Attributes
    ----------
    t_s : (k,) centre of the bin [s from the start of the recording]
    low, high : (k, 3) smallest and largest value in the bin [unit]
    unit : unit of the signal
    """

    t_s: Floats
    low: Floats
    high: Floats
    unit: str


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DetectorTrace:
    """The static detector of Eq. (3.9) over the recording.

    Attributes
    ----------
    t_s : (k,) [s]
    statistic : (k,) largest variance magnitude squared in the bin, relative to the resting level (1 = at rest)
    multiplier : threshold in the same unit
    candidates : (c, 4) multiplier, static intervals, held-out rms [m/s^2], criterion (smaller is better); not finite
        where unusable
    """

    t_s: Floats
    statistic: Floats
    multiplier: float
    candidates: Floats


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class IntervalTable:
    """Static intervals, in order of time.

    Attributes
    ----------
    start_s, stop_s : (n,) [s from the start of the recording]
    samples : (n,) accelerometer samples in it
    accelerometer : (n, 3) mean [unit of the recording]
    gyroscope : (n, 3) mean [unit of the recording]; nan without gyroscope
    direction : (n, 3) estimated direction of specific force (up), body frame, unit vectors
    error_before : (n,) |f| - g with the best single scale and no bias, as an uncalibrated sensor would read [m/s^2]
    error_after : (n,) |f| - g of the fit [m/s^2]
    error_holdout : (n,) |f| - g when this interval was left out of the fit [m/s^2]
    sigma : (n,) predicted sigma of error_after's measurement noise [m/s^2]
    used : (n,) bool
    reason : why it was not used, or ""
    """

    start_s: Floats
    stop_s: Floats
    samples: Floats
    accelerometer: Floats
    gyroscope: Floats
    direction: Floats
    error_before: Floats
    error_after: Floats
    error_holdout: Floats
    sigma: Floats
    used: np.ndarray
    reason: tuple[str, ...]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RotationTable:
    """Rotations between consecutive static intervals.

    Attributes
    ----------
    start_s, stop_s : (m,) [s from the start of the recording]
    first : (m,) index of the static interval before it (the one after it is `first + 1` among those used)
    angle_rad : (m,) angle by which gravity turned in the body frame
    measured : (m, 3) unit vector u_a after the rotation, from the accelerometer
    propagated : (m, 3) unit vector u_g, from the gyroscope
    error_before : (m,) |u_a - u_g| with nominal gyroscope (one scale, bias of the first interval) [rad]
    error_after : (m,) |u_a - u_g| of the fit [rad]
    error_holdout : (m,) |u_a - u_g| when this rotation was left out [rad]
    sigma : (m,) predicted sigma of error_after [rad]
    used : (m,) bool
    reason : why it was not used, or ""
    """

    start_s: Floats
    stop_s: Floats
    first: np.ndarray
    angle_rad: Floats
    measured: Floats
    propagated: Floats
    error_before: Floats
    error_after: Floats
    error_holdout: Floats
    sigma: Floats
    used: np.ndarray
    reason: tuple[str, ...]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class AllanCurve:
    """Allan deviation of the gyroscope over the initial static part, Eq. (3.17).

    Attributes
    ----------
    tau_s : (k,) averaging time [s]
    deviation : (k, 3) [rad/s], per gyroscope axis, by the estimated scale
    t_init_s : averaging time where the three curves flatten [s]; nan where the static part is too short to tell
    static_s : length of the initial static part [s]
    """

    tau_s: Floats
    deviation: Floats
    t_init_s: float
    static_s: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ModelTrial:
    """One candidate model with its held-out errors, accelerometer [m/s^2] and rotation [rad]."""

    model: str
    chosen: bool
    accelerometer_rms: float
    rotation_rms: float
    parameters: int


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BiasSegments:
    """A triad's bias in the parts of a recording between which it stepped.

    Attributes
    ----------
    triad : "accelerometer" or "gyroscope"
    start_s, stop_s : (k,) from the first to the last static interval of each part [s from the start of the recording]
    bias, sigma : (k, 3) [unit of the recording]
    published : index of the part whose bias the calibration states
    """

    triad: str
    start_s: Floats
    stop_s: Floats
    bias: Floats
    sigma: Floats
    published: int


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ImuDiagnostics:
    """How an IMU calibration came about.

    Attributes
    ----------
    bias_segments : of each triad whose bias stepped
    noise : name -> value: "accelerometer.density" [m/s^2/sqrt(Hz)], "gyroscope.density" [rad/s/sqrt(Hz)], and the like
    trust : what the recording tells of its own calibration's uncertainty
    """

    accelerometer: SignalEnvelope
    gyroscope: SignalEnvelope | None
    detector: DetectorTrace
    intervals: IntervalTable
    rotations: RotationTable
    allan: AllanCurve | None
    trials: tuple[ModelTrial, ...]
    noise: dict[str, float]
    trust: Trust | None = None
    bias_segments: tuple[BiasSegments, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SignalFit:
    """A triad of an IMU as measured, and as the estimated trajectory and calibration predict it (Figs. 5.6 and 5.7).

    Attributes
    ----------
    t_s : (n,) [s from the start of the recording]
    measured, predicted : (n, 3) [unit]
    basic : (n, 3) [unit] prediction of the basic model, or None where it was not estimated
    used : (n,) bool, False where the sample was masked (saturated) or lies outside the trajectory
    sigma : predicted standard deviation of a single sample's noise [unit]
    unit : "m/s^2" or "rad/s"
    """

    t_s: Floats
    measured: Floats
    predicted: Floats
    basic: Floats | None
    used: np.ndarray
    sigma: float
    unit: str


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BiasTrack:
    """A bias over time.

    Attributes
    ----------
    t_s : (k,) [s from the start of the recording]
    value, sigma : (k, 3) estimate and its standard deviation [unit]; sigma is nan where no marginals were asked for
    random_walk : assumed random walk [unit/sqrt(s)]
    unit : "m/s^2" or "rad/s"
    """

    t_s: Floats
    value: Floats
    sigma: Floats
    random_walk: float
    unit: str


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CornerFit:
    """The corners of one camera as detected, and how far the prediction is from them.

    Attributes
    ----------
    frame_t_s : (f,) time of every frame on the IMU's clock [s from the start of the recording]
    frame_corners : (f,) number of corners detected in it
    frame_rms : (f,) rms residual of the frame's corners, per axis [px]; nan without corners
    frame_used : (f,) bool
    frame_reason : (f,) why the frame was not used, or ""
    frame : (m,) index of each corner's frame
    point : (m,) number of each corner on the target
    pixels : (m, 2) detected [px]
    residual : (m, 2) predicted minus detected [px]; nan where the frame was not predicted
    weight : (m,) robust weight, 0 to 1
    sigma_px : standard deviation of a corner per axis that was used [px]
    resolution : (width, height) [px]
    corner_sigma_px : (m,) standard deviation of each corner per axis as its detector knows it [px]; None where all are
        alike
    quality : what the images were like, one entry a frame; None where there were no images
    """

    frame_t_s: Floats
    frame_corners: np.ndarray
    frame_rms: Floats
    frame_used: np.ndarray
    frame_reason: tuple[str, ...]
    frame: np.ndarray
    point: np.ndarray
    pixels: Floats
    residual: Floats
    weight: Floats
    sigma_px: float
    resolution: tuple[int, int]
    corner_sigma_px: Floats | None = None
    quality: FrameQuality | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TrajectoryTrack:
    """The estimated trajectory at the timestamps of imu0, where it is known.

    Attributes
    ----------
    t_ns : (n,) int64 timestamps of the IMU [ns]
    p_target_imu : (n, 3) origin of the IMU in the target's frame [m]
    q_target_imu_wxyz : (n, 4) attitude, Hamilton: v_target = q v_imu q*
    omega_imu : (n, 3) angular rate [rad/s]
    f_imu : (n, 3) specific force [m/s^2]
    position_sigma : (n, 3) [m] or None; attitude_sigma : (n, 3) [rad] or None (marginals, on request)
    """

    t_ns: np.ndarray
    p_target_imu: Floats
    q_target_imu_wxyz: Floats
    omega_imu: Floats
    f_imu: Floats
    position_sigma: Floats | None = None
    attitude_sigma: Floats | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class EstimatedParameter:
    """One scalar parameter of the batch estimation.

    Attributes
    ----------
    name : such as "cam0.T_cam_imu.rotation[0]", "imu0.M_g[2]", "gravity.direction[1]"
    unit : such as "rad", "m", "s", ""
    value, start : estimate and initial guess; of rotations and directions the small angle from the initial guess
    sigma : standard deviation
    prior_sigma : of the prior; infinite where there is none
    status : "estimated", "prior" (a stated prior), "considered" (held, its sigma carried into all others), "fixed"
    """

    name: str
    unit: str
    value: float
    start: float
    sigma: float
    prior_sigma: float
    status: str


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class NoiseLevel:
    """A noise level: as stated beforehand, as found in the residuals, and as used.

    Attributes
    ----------
    name : such as "imu0.gyroscope", "imu0.accelerometer", "cam0.corners"
    unit : such as "rad/s/sqrt(Hz)", "px"
    nominal : nan where nothing was stated
    """

    name: str
    unit: str
    nominal: float
    estimated: float
    used: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SolverStep:
    """One Gauss-Newton iteration: cost before it, largest step in sigmas of a parameter, damping, and if accepted."""

    cost: float
    largest_step: float
    damping: float
    accepted: bool


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CameraImuDiagnostics:
    """How a camera-IMU calibration came about.

    Attributes
    ----------
    signals : "imu0.accelerometer", "imu0.gyroscope" -> SignalFit
    biases : the same names -> BiasTrack
    corners : "cam0", ... -> CornerFit
    trajectory : estimated trajectory
    parameters : every scalar of the batch estimation, also the fixed ones
    correlation : (p, p) of the parameters that were estimated, in their order
    noise : levels
    steps : iterations of the solution, in order
    gravity_target : (3,) gravity in the target's frame, pointing down [m/s^2]
    gravity_sigma : (3,) [m/s^2]
    gravity_plane : (3, 2) unit vectors, target frame, along which gravity.direction[0] and [1] tilt it
    knots_per_s, spline_order : of the trajectory
    segments : number of pieces of the trajectory
    baselines : "cam1_cam0" -> (4, 4) T_cam1_cam0
    initial_time_shift_s : "cam0" -> time shift found before the batch estimation
    trust : what the recording tells of its own calibration's uncertainty
    """

    signals: dict[str, SignalFit]
    biases: dict[str, BiasTrack]
    corners: dict[str, CornerFit]
    trajectory: TrajectoryTrack
    parameters: tuple[EstimatedParameter, ...]
    correlation: Floats
    noise: tuple[NoiseLevel, ...]
    steps: tuple[SolverStep, ...]
    gravity_target: Floats
    gravity_sigma: Floats
    gravity_plane: Floats
    knots_per_s: float
    spline_order: int
    segments: int
    baselines: dict[str, Floats]
    initial_time_shift_s: dict[str, float]
    trust: Trust | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LensTrial:
    """One lens model of one camera, with its error on views that it had not seen.

    Attributes
    ----------
    camera : such as "cam0"
    model : such as "pinhole-radtan"
    chosen : whether it was taken
    holdout_rms_px : rms per axis of views that the estimate had not seen, each with a pose of its own [px]; nan where
        the model could not be fitted
    rms_px : rms per axis of the views used [px]
    parameters : how many the lens has
    """

    camera: str
    model: str
    chosen: bool
    holdout_rms_px: float
    rms_px: float
    parameters: int


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ViewPose:
    """The board as one view saw it.

    Attributes
    ----------
    t_ns : timestamp of the view [ns]
    cameras : those whose corners were used
    R_target_cam0, p_target_cam0 : (3, 3) and (3,) pose of cam0 in the board's frame [m]
    information : what the view adds to what the others know of the lenses, in nats; nan where it was not asked
    """

    t_ns: int
    cameras: tuple[str, ...]
    R_target_cam0: Floats
    p_target_cam0: Floats
    information: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CamerasDiagnostics:
    """How a calibration of cameras alone came about.

    Attributes
    ----------
    corners : "cam0", ... -> CornerFit; frame_used tells the views that the estimate rests on, and frames that were held
        out or not chosen have residuals about a pose of their own
    views : the views that were used, in the order of time
    coverage : "cam0" -> (rows, cols) corners used in each cell of the image
    trials : lens models that were tried, of each camera
    parameters : every scalar that could be estimated, also the fixed ones
    correlation : (p, p) of the parameters that were estimated, in their order
    noise : levels, "cam0.corners"
    steps : iterations of the solution, in order
    board_points : (k, 3) stated places of the board's points [m]
    board_shifts : (k, 3) from there to where they are by the estimate [m]; zero where the board was taken as stated
    trust : what the recording tells of its own calibration's uncertainty
    """

    corners: dict[str, CornerFit]
    views: tuple[ViewPose, ...]
    coverage: dict[str, np.ndarray]
    trials: tuple[LensTrial, ...]
    parameters: tuple[EstimatedParameter, ...]
    correlation: Floats
    noise: tuple[NoiseLevel, ...]
    steps: tuple[SolverStep, ...]
    board_points: Floats
    board_shifts: Floats
    trust: Trust | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class JoinedRecording:
    """One of several recordings of one sensor, calibrated for itself.

    Attributes
    ----------
    name : its file, or its number
    verdict, model : of it alone
    intervals, rotations : used
    accelerometer_rms, rotation_rms : on data left out [m/s^2], [rad]
    values, sigma : (n,) its scalars and their standard deviations [SI; of a sensor in counts relative to its scale]
    z : (n,) its distance from what the others foretell, in standard deviations; nan where nothing was estimated
    diagnostics : how it came about
    """

    name: str
    verdict: str
    model: str
    intervals: int
    rotations: int
    accelerometer_rms: float
    rotation_rms: float
    values: Floats
    sigma: Floats
    z: Floats
    diagnostics: ImuDiagnostics | TriadDiagnostics


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class JoinedDiagnostics:
    """How the calibration of one sensor from several recordings came about.

    Attributes
    ----------
    names : (n,) scalars, as in `Covariance.names`
    quantity : (n,) of each, such as "accelerometer_scale"
    mean, mean_sigma : (n,) over the recordings, and its standard deviation [as `JoinedRecording.values`]
    scatter : (n,) standard deviation from recording to recording
    recordings : one by one, in the order given
    """

    names: tuple[str, ...]
    quantity: tuple[str, ...]
    mean: Floats
    mean_sigma: Floats
    scatter: Floats
    recordings: tuple[JoinedRecording, ...]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Result:
    """A calibration, and how it came about."""

    calibration: Calibration
    diagnostics: ImuDiagnostics | CameraImuDiagnostics | CamerasDiagnostics | TriadDiagnostics | JoinedDiagnostics

    def _repr_html_(self) -> str:
        return self.calibration._repr_html_()  # pyright: ignore[reportPrivateUsage]
