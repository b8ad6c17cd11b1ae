"""How a calibration of an IMU from rests and rotations came about. Values only.

How a calibration by known magnitudes came about: poses, turntable, magnetometer. Values only.
"""

from dataclasses import field
from typing import Literal

import numpy as np

from ..frozen import value_class
from ..recording import Floats
from .calibration import Gravity
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


TriadKind = Literal["poses", "turntable", "magnetometer"]


@value_class
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


@value_class
class IterationHistory:
    """The paper's iteration (preset angrisano): after each step the residual quadratic form q, and X, (k, 9)."""

    q: Floats
    parameters: Floats


@value_class
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


@value_class
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


@value_class
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


@value_class
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


@value_class
class DipTable:
    """Angle between magnetic field and horizontal in each attitude in which the accelerometer rested [rad]."""

    attitude: Floats
    dip_rad: Floats
    estimated_rad: float
    sigma_rad: float


@value_class
class TriadTrial:
    """One candidate model: its held-out error of the magnitude [SI] and its number of parameters."""

    model: str
    chosen: bool
    holdout_rms: float
    parameters: int


@value_class
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
