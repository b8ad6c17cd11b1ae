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
from ..multiposition.bias_changes import RestMeans, functions_of_time, gyroscope_changes
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
_FEWEST_FOR_COURSE = 16


@value_class
class BiasCourse:
    """What the gyroscope's bias does with the temperature.

    Attributes
    ----------
    slopes : (k, 3) coefficients of its powers, from the first on [unit/K^j]
    covariance : (3 k, 3 k)
    at_parts, variance : (n, 3) bias minus that at the reference, and its variance by what is not known of the course
    at_reference : (3,) variance that this gives the bias at the reference
    """

    slopes: Floats
    covariance: Floats
    at_parts: Floats
    variance: Floats
    at_reference: Floats


def bias_course(
    data: TurntableData, residual: Floats, noise: Floats, at_rest: Booleans, force: Floats | None
) -> BiasCourse | None:
    """Return how the bias follows the temperature, by the rests; None where they do not tell it from drift in time.

    Generalised least squares (Aitken 1936): beside the temperature a decay, where one is likelier than none, what the
    attitude does by the g-sensitivity, and a random walk as what is left shows it.

    Parameters
    ----------
    residual, noise : see `drift_at`
    force : (n, 3) specific force of each part; None where it is not known
    """
    t_s, n = data.t_s, int(at_rest.sum())
    if data.degc is None or n < _FEWEST_FOR_COURSE:
        return None
    felt = np.zeros_like(residual) if force is None else force
    rests = RestMeans(
        rest=np.arange(n), t_s=t_s[at_rest], half_s=np.zeros(n), means=residual[at_rest], variance=noise[at_rest],
        degc=data.degc[at_rest],
    )  # fmt: skip
    changes = gyroscope_changes(rests, felt[at_rest] / max(float(np.abs(felt).max()), 1e-300))
    if not changes.temperature or changes.steps:
        return None
    powers = data.degc.shape[1]
    course = functions_of_time(changes, t_s, np.zeros_like(t_s), data.degc)
    course[:, :-powers] -= course[at_rest, :-powers].mean(axis=0)
    design = np.column_stack([course, np.ones(len(t_s)), felt])
    design = design[:, np.any(design != 0, axis=0)]
    kept = course.shape[1] - powers + np.array([0, *range(2, powers - 2)])
    slopes, covariance = np.empty((len(kept), 3)), np.zeros((3 * len(kept), 3 * len(kept)))
    at_parts, variance, at_reference = np.empty_like(residual), np.empty_like(residual), np.empty(3)
    left, x, told = residual.copy(), design[at_rest], np.arange(course.shape[1])
    apart = np.minimum(*np.meshgrid(t_s[at_rest] - t_s[at_rest][0], t_s[at_rest] - t_s[at_rest][0]))
    for axis in range(3):
        left[:, axis] -= design @ np.linalg.lstsq(x, residual[at_rest, axis], rcond=1e-12)[0]
    walks = walk_density(t_s, left, at_rest)
    for axis in range(3):
        errors = np.diag(noise[at_rest, axis]) + (0.0 if walks is None else walks[axis]) * apart
        root = np.linalg.inv(np.linalg.cholesky(errors))
        size = np.linalg.norm(root @ x, axis=0)
        inverse = np.linalg.pinv(root @ x / size) / size[:, None]
        found = inverse @ root @ residual[at_rest, axis]
        off = root @ (residual[at_rest, axis] - x @ found)
        own = inverse @ inverse.T * max(1.0, float(off @ off) / max(n - x.shape[1], 1))
        slopes[:, axis], covariance[axis::3, axis::3] = found[kept], own[np.ix_(kept, kept)]
        at_parts[:, axis] = course @ found[told]
        middle = course[at_rest].mean(axis=0)
        variance[:, axis] = np.einsum("ni,ij,nj->n", course - middle, own[np.ix_(told, told)], course - middle)
        at_reference[axis] = middle @ own[np.ix_(told, told)] @ middle
    return BiasCourse(
        slopes=slopes, covariance=covariance, at_parts=at_parts, variance=variance, at_reference=at_reference
    )


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
