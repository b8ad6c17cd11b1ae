"""Steady parts of recordings on a turntable, as estimation takes them.

A gyroscope's bias that wanders over a session on the turntable, from its rests.
"""

from dataclasses import replace

import numpy as np

from ...findings import Finding
from ...frozen import value_class
from ...options import StatedRate
from ...recording import Floats, Integers
from ...results.result import Booleans
from ...results.sensors import TemperatureDependence
from ..multiposition.drift import walk_density
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
    degc : (n, m) what a bias may follow of the temperature, see `RestMeans`; None where nothing tells it from the time
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
    degc: Floats | None = None

    @property
    def rate(self) -> Floats:
        """(n,) stated rate of each part [rad/s]."""
        return self.rates[self.speed]

    def where(self, keep: Booleans) -> "TurntableData":
        """Return the parts that `keep` (n,) marks."""
        names = ("measured", "variance", "speed", "wander", "t_s", "pose")
        force, degc = (None if one is None else one[keep] for one in (self.force, self.degc))
        return replace(self, force=force, degc=degc, **{name: getattr(self, name)[keep] for name in names})


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
    temperature : its range, about the mean at rest, where it rose and fell
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
    temperature: TemperatureDependence | None = None

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


_SIGMAS = 3.0


def drift_at(
    t_s: Floats, residual: Floats, noise: Floats, at_rest: Booleans, stated: float | None = None
) -> tuple[Floats, Floats] | None:
    """Return drift (n, 3) [unit], of mean zero at the rests, and its variance (n, 3), or None where the bias stays.

    A random walk, whose density was stated or is shown by the residuals at rest, is predicted at all parts from the
    rests.

    Parameters
    ----------
    t_s : (n,) middle of each part [s]
    residual : (n, 3) measured minus bias; counts at rest alone [unit]
    noise : (n, 3) variance of each mean [unit^2]
    at_rest : (n,) bool
    stated : density of the random walk, where it was stated [unit^2/s]
    """
    density = shown_density(t_s, residual, noise, at_rest) if stated is None else np.full(3, stated)
    if density is None or not at_rest.any():
        return None
    start = float(t_s[at_rest].min())
    t = t_s - start
    seen = t[at_rest]
    both = np.minimum(np.abs(t[:, None]), np.abs(seen)) * (np.sign(t)[:, None] * np.sign(seen) >= 0)
    drift, variance = np.empty_like(residual), np.empty_like(residual)
    span = max(float(np.ptp(seen)), 1e-9)
    for axis in range(3):
        walk = density[axis] * both
        offset = density[axis] * span  # the bias itself, as free as the walk over the whole session
        covariance = walk[at_rest] + offset + np.diag(noise[at_rest, axis])
        gain = np.linalg.solve(covariance, (walk + offset).T).T
        found = gain @ residual[at_rest, axis]
        drift[:, axis] = found - found[at_rest].mean()
        own = density[axis] * np.abs(t) + offset
        variance[:, axis] = np.maximum(own - np.einsum("ij,ij->i", gain, walk + offset), 0.0)
    return drift, variance


def shown_density(t_s: Floats, residual: Floats, noise: Floats, at_rest: Booleans) -> Floats | None:
    """Return the density (3,) of the random walk that the rests show, or None where noise explains them."""
    squares = residual[at_rest] ** 2 / noise[at_rest]
    if np.sum(squares) <= squares.size + _SIGMAS * np.sqrt(2 * squares.size):
        return None
    return walk_density(t_s, residual, at_rest)
