"""How a calibration of an IMU from rests and rotations came about. Values only."""

import numpy as np

from ..frozen import value_class
from ..recording import Floats
from .trust import Trust


@value_class
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


@value_class
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


@value_class
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


@value_class
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


@value_class
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


@value_class
class ModelTrial:
    """One candidate model with its held-out errors, accelerometer [m/s^2] and rotation [rad]."""

    model: str
    chosen: bool
    accelerometer_rms: float
    rotation_rms: float
    parameters: int


@value_class
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


@value_class
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
