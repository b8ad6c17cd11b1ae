"""How a calibration of cameras, alone or with IMUs, came about. Values only."""

import numpy as np

from ..frozen import value_class
from ..recording import Floats, FrameQuality
from .trust import Trust


@value_class
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


@value_class
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


@value_class
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


@value_class
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


@value_class
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


@value_class
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


@value_class
class SolverStep:
    """One Gauss-Newton iteration: cost before it, largest step in sigmas of a parameter, damping, and if accepted."""

    cost: float
    largest_step: float
    damping: float
    accepted: bool


@value_class
class SceneMap:
    """Landmarks of a scene without a board, in the target's frame.

    Attributes
    ----------
    points : (k, 3) where they were found [m]
    sigma : (k, 3) standard deviations along the axes, beside a shift, a turn or another size of the whole [m]
    """

    points: Floats
    sigma: Floats


@value_class
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
    scene : landmarks, where there was no board; corners are then those of landmarks
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
    scene: SceneMap | None = None
    trust: Trust | None = None


@value_class
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


@value_class
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


@value_class
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
