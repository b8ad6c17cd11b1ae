"""How a calibration by known magnitudes came about: poses, turntable, magnetometer. Values only."""

from dataclasses import field
from typing import Literal

import numpy as np

from ..frozen import value_class
from ..recording import Floats
from .calibration import Gravity
from .trust import Trust

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
