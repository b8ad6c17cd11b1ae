"""Steady parts of recordings on a turntable, as estimation takes them.

A gyroscope's bias that wanders over a session on the turntable, from its rests.

Where the axis of the platter is in the sensor, by the accelerometer.

In one attitude the accelerometer shows

    a = F + A cos(phi) + B sin(phi) + omega^2 C + noise,

with the angle phi by which the platter has turned: F is what it would show if the axis stood still and vertical, A and
B are the tilt of the platter, and C the centripetal acceleration of each axis, wherever it is. All of them are linear;
rests before and after the turning, or a second speed, tell F and C apart. Whole turns are not needed.
"""

from dataclasses import replace

import numpy as np

from ...findings import Finding
from ...frozen import value_class
from ...options import StatedRate
from ...recording import Floats, Integers
from ...results.result import Booleans
from ...results.temperature_dependence import TemperatureDependence
from ..multiposition.bias_functions import walk_density

_ACROSS = 0.08  # share of the rate that may lie across the axis while the platter takes up its speed
_ACROSS_NOISE = 6.0
_APART = 0.02  # scatter of the squared rate, relative to the largest, at which F and C are told apart
_LONGEST_GAP_S = 120.0
_ANGLE_SCALE, _ANGLE_STEP, _MOST_STEPS = 0.03, 0.5, 200  # share; rad at the end
_SIGNIFICANT, _REFINEMENTS = 25.0, 8


@value_class
class AxisInSensor:
    """What the accelerometer showed in one attitude on the platter.

    Attributes
    ----------
    upright : (3,) F, mean without tilt and, where `separated`, without centripetal acceleration [unit]
    variance : (3,) of it [unit^2]
    tilt : (3, 2) A and B [unit]
    separated : whether the centripetal acceleration was told apart; else it is part of `upright`
    rate : fastest rate of the parts [rad/s]
    """

    upright: Floats
    variance: Floats
    tilt: Floats
    separated: bool
    rate: float


@value_class
class Between:
    """What lies between two steady parts.

    Attributes
    ----------
    means : (k, 3) of the gyroscope over blocks [unit]
    gap_s : longest hole in the timestamps [s]
    """

    means: Floats
    gap_s: float


def link_parts(axes: Floats, rates: Floats, between: list[Between], zero: Floats, noise: Floats) -> Integers:
    """Return which parts of one recording share an attitude, (n,) numbers that rise.

    Between two parts that do, the platter may change its speed, but the rate keeps its axis; a hand does not.

    Parameters
    ----------
    axes : (n, 3) means of the gyroscope without its reading at rest [unit]
    rates : (n,) speeds, 0 at rest [rad/s]
    between : n - 1
    zero : (3,) reading at rest [unit]
    noise : (3,) of a block's mean [unit]
    """
    pose, k = np.zeros(len(axes), dtype=np.int64), 0
    for i in range(1, len(axes)):
        turning = i if rates[i] >= rates[i - 1] else i - 1
        size = float(np.linalg.norm(axes[turning]))
        same = rates[turning] > 0 and between[i - 1].gap_s < _LONGEST_GAP_S
        if same:
            axis = axes[turning] / size
            rate = np.vstack([between[i - 1].means - zero, axes[i - 1 : i + 1]])
            across = rate - np.outer(rate @ axis, axis)
            same = bool(np.all(np.linalg.norm(across, axis=1) < _ACROSS * size + _ACROSS_NOISE * np.linalg.norm(noise)))
        k += not same
        pose[i] = k
    return pose


@value_class
class ForceBlocks:
    """The accelerometer in the parts of one attitude, in means over blocks.

    Attributes
    ----------
    force : (k, 3) [unit]
    angle : (k,) by which the platter has turned at the middle of each block, by the gyroscope [rad]
    rate : (k,) of the platter, by the gyroscope [rad/s], 0 at rest
    block_s : length of a block [s]
    """

    force: Floats
    angle: Floats
    rate: Floats
    block_s: float


def axis_in_sensor(blocks: ForceBlocks) -> AxisInSensor:
    """Return what one attitude shows."""
    force, fastest = blocks.force, float(blocks.rate.max())
    if fastest == 0.0:
        return AxisInSensor(
            upright=force.mean(axis=0),
            variance=np.var(force, axis=0, ddof=1) / len(force) if len(force) > 1 else np.full(3, np.inf),
            tilt=np.zeros((3, 2)),
            separated=True,
            rate=0.0,
        )
    squared = (blocks.rate / fastest) ** 2
    separated = bool(np.std(squared) > _APART)
    fixed = np.column_stack([np.ones(len(force)), squared])[:, : 1 + separated]
    fit = _fitted(blocks, fixed, _angle_scale(blocks, fixed))
    return AxisInSensor(
        upright=fit.found[0],
        variance=fit.squares / max(len(force) - len(fit.found), 1) * fit.inverse[0, 0],
        tilt=fit.found[-2:].T,
        separated=separated,
        rate=fastest,
    )


@value_class
class _Fit:
    found: Floats
    inverse: Floats
    squares: Floats


def _fitted(blocks: ForceBlocks, fixed: Floats, scale: float) -> _Fit:
    """Return the linear fit with all angles multiplied by `scale`; a mean over a block makes the waves smaller."""
    shrunk = np.sinc(scale * blocks.rate * blocks.block_s / (2 * np.pi))
    phi = scale * blocks.angle
    design = np.column_stack([fixed, shrunk * np.cos(phi), shrunk * np.sin(phi)])
    inverse = np.asarray(np.linalg.pinv(design.T @ design, hermitian=True), dtype=np.float64)
    found = inverse @ (design.T @ blocks.force)
    return _Fit(found=found, inverse=inverse, squares=np.sum((blocks.force - design @ found) ** 2, axis=0))


def _angle_scale(blocks: ForceBlocks, fixed: Floats) -> float:
    """Return the factor by which the gyroscope's angles go round as gravity does; 1 where the platter is level.

    The gyroscope's scale is not known yet, and after a hundred radians one percent of it matters.
    """
    dof = max(len(blocks.force) - fixed.shape[1] - 2, 1)

    def misfit(scale: float) -> float:
        return float(np.sum(_fitted(blocks, fixed, scale).squares / level))

    level = _fitted(blocks, fixed, 1.0).squares / dof
    level = np.where(level > 0, level, 1.0)
    step = _ANGLE_STEP / max(float(np.ptp(blocks.angle)), 1.0)
    count = max(1, min(int(_ANGLE_SCALE / step), _MOST_STEPS))
    scales = 1 + step * np.arange(-count, count + 1)
    best = float(scales[int(np.argmin([misfit(scale) for scale in scales]))])
    for _ in range(_REFINEMENTS):
        step *= 0.5
        around = best + step * np.array([-1.0, 0.0, 1.0])
        best = float(around[int(np.argmin([misfit(scale) for scale in around]))])
    return best if misfit(1.0) - misfit(best) > _SIGNIFICANT else 1.0


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
