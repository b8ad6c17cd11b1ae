"""Steady parts of recordings on a turntable, as estimation takes them."""

from dataclasses import replace

from ...findings import Finding
from ...frozen import value_class
from ...options import StatedRate
from ...recording import Floats, Integers
from ...results.intervals import Booleans
from .axis import AxisInSensor


@value_class
class TurntableData:
    """Steady parts, and what the accelerometer showed in each attitude.

    Attributes
    ----------
    measured, variance : (n, 3) mean of the gyroscope, and its variance by noise [unit], [unit^2]
    speed : (n,) index of the speed
    rates, rate_sigmas : (g,) speeds and their sigmas [rad/s]
    wander : (n,) sigma of each part's mean rate as it wanders from turn to turn [rad/s]
    t_s : (n,) middle of each part [s]
    pose : (n,) index of the attitude
    force : (n, 3) mean of the accelerometer in each part [unit]; None without accelerometer
    axes : of each attitude; empty without accelerometer
    walk : random walk of the bias [unit^2/s], where it was stated; otherwise the rests tell whether it wanders
    """

    measured: Floats
    variance: Floats
    speed: Integers
    rates: Floats
    rate_sigmas: Floats
    wander: Floats
    t_s: Floats
    pose: Integers
    force: Floats | None
    axes: tuple[AxisInSensor, ...]
    walk: float | None = None

    @property
    def rate(self) -> Floats:
        """(n,) stated rate of each part [rad/s]."""
        return self.rates[self.speed]

    def where(self, keep: Booleans) -> "TurntableData":
        """Return the parts that `keep` (n,) marks."""
        names = ("measured", "variance", "speed", "wander", "t_s", "pose")
        force = None if self.force is None else self.force[keep]
        return replace(self, force=force, **{name: getattr(self, name)[keep] for name in names})


@value_class
class TurntableParts:
    """Steady parts of all recordings.

    Attributes
    ----------
    data : those that can be used
    names : of each of these
    start_s, stop_s : (n,) [s from the start of its recording]
    samples : (n,) of the gyroscope
    rates : the speeds, zero last
    noise : (3,) density of the gyroscope's noise [unit^2 s]
    left_out : what was not used, and why
    findings : what was noticed
    gyroscope_unit, accelerometer_unit : as recorded; None without accelerometer
    """

    data: TurntableData
    names: tuple[str, ...]
    start_s: Floats
    stop_s: Floats
    samples: Integers
    rates: tuple[StatedRate, ...]
    noise: Floats
    left_out: tuple[tuple[str, str], ...]
    findings: tuple[Finding, ...]
    gyroscope_unit: str
    accelerometer_unit: str | None

    def where(self, keep: Booleans) -> "TurntableParts":
        """Return the parts that `keep` (n,) marks."""
        return replace(
            self,
            data=self.data.where(keep),
            names=tuple(name for name, kept in zip(self.names, keep, strict=True) if kept),
            start_s=self.start_s[keep],
            stop_s=self.stop_s[keep],
            samples=self.samples[keep],
        )
