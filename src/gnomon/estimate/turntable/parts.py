"""Steady parts of recordings on a turntable, as estimation takes them.

A gyroscope's bias that wanders over a session on the turntable, from its rests.

Where the axis of the platter is in the sensor, by the accelerometer.

In one attitude the accelerometer shows

    a = F + A cos(phi) + B sin(phi) + omega^2 C + noise,

with the angle phi by which the platter has turned: F is what it would show if the axis stood still and vertical, A and
B are the tilt of the platter, and C the centripetal acceleration of each axis, wherever it is. All of them are linear;
rests before and after the turning, or a second speed, tell F and C apart. Whole turns are not needed.

Which of the stated speeds each part had is told by its measured magnitude alone.
"""

from dataclasses import replace

import numpy as np

from ...errors import DetectionError
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

_SIGMAS = 3.0

NO_SPEED = -1
_AT_REST = 0.25  # of the slowest speed; less is no turning
_SAME_PLACE = 0.05  # of the largest distance: means of one cluster
_UNSCALED = 1.3  # factor by which an uncalibrated axis may be off
_COST_UNUSED = 0.5  # of a stated speed that no part has
_FARTHEST, _COST_FAR, _CLEARLY = 1.5, 0.1, 0.1  # factor of a scale; cost of its logarithm; gain for another scale
_ROUNDS = 10


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


@value_class
class Speeds:
    """Speeds of steady parts.

    Attributes
    ----------
    index : (n,) of the speed; NO_SPEED where it is none of those stated
    zero : (3,) what the gyroscope shows at rest, about [unit]
    scale : (3,) about what an axis shows for 1 rad/s [unit]
    shown : (n,) magnitude by these [rad/s]
    """

    index: Integers
    zero: Floats
    scale: Floats
    shown: Floats


def assign_speeds(means: Floats, speeds: Floats, allowed: Booleans, unit_rad_s: float | None) -> Speeds:
    """Return the speed of each part.

    Parameters
    ----------
    means : (n, 3) of steady parts [unit]
    speeds : (g,) stated, zero among them [rad/s]
    allowed : (n, g) which speeds a part may have, such as those of its file
    unit_rad_s : one unit in rad/s; None for counts, whose zero and size are not known either

    Raises
    ------
    DetectionError
        If no part turns.
    """
    if unit_rad_s is not None:
        zero, size = np.zeros(3), _size_by_ratios(means, speeds, allowed, 1 / unit_rad_s)
    else:
        zero, size = _zero_and_size(means, speeds, allowed)
    scale = np.full(3, size)
    index = np.full(len(means), NO_SPEED)
    for _ in range(_ROUNDS):
        shown = np.linalg.norm((means - zero) / scale, axis=1)
        new = _nearest(shown, speeds, allowed)
        if np.array_equal(new, index):
            break
        index = new
        rests = (index != NO_SPEED) & (speeds[index] == 0)
        if rests.any():
            zero = np.median(means[rests], axis=0)
        scale = _axis_scales(means - zero, speeds[index], (index != NO_SPEED) & ~rests, size)
    shown = np.linalg.norm((means - zero) / scale, axis=1)
    return Speeds(index=index, zero=zero, scale=scale, shown=shown)


def _size_by_ratios(means: Floats, speeds: Floats, allowed: Booleans, nominal: float) -> float:
    """Return what the sensor shows for 1 rad/s, where its unit says what it should show.

    A scale that is off by up to `_FARTHEST` is found by the ratios of the speeds; the one that the unit says is kept
    where no other explains the parts clearly better.
    """
    radius, turning = np.linalg.norm(means, axis=1), speeds[speeds > 0]
    moving = radius[radius > _AT_REST * turning.min() * nominal / _FARTHEST]
    if not len(moving):
        return nominal
    sizes = np.outer(np.quantile(moving, np.linspace(0, 1, 21)), 1 / turning).ravel()
    sizes = np.append(sizes[np.abs(np.log(sizes / nominal)) < np.log(_FARTHEST)], nominal)
    costs = np.array([
        _cost(radius / size, speeds, allowed) + _COST_FAR * abs(float(np.log(size / nominal))) for size in sizes
    ])  # fmt: skip
    return float(sizes[np.argmin(costs)]) if costs.min() < costs[-1] - _CLEARLY else nominal


def reassign_speeds(shown: Floats, speeds: Floats, allowed: Booleans, tolerance: float) -> Integers:
    """Return the speed of each part by its calibrated magnitude (n,) [rad/s]; none beyond a relative tolerance."""
    return _nearest(shown, speeds, allowed, 1 + tolerance)


def _nearest(shown: Floats, speeds: Floats, allowed: Booleans, factor: float = _UNSCALED) -> Integers:
    turning = speeds[speeds > 0]
    at_rest = shown < _AT_REST * turning.min()
    with np.errstate(divide="ignore"):
        away = np.abs(np.log(np.maximum(shown, 1e-12))[:, None] - np.log(speeds))
    away = np.where(allowed & (speeds > 0), away, np.inf)
    index = np.argmin(away, axis=1)
    index[away[np.arange(len(shown)), index] > np.log(factor)] = NO_SPEED
    rest = np.flatnonzero(speeds == 0)
    index[at_rest] = rest[0] if len(rest) else NO_SPEED
    return index


def _axis_scales(offset: Floats, rate: Floats, turning: Booleans, size: float) -> Floats:
    """Return what each axis shows for 1 rad/s, (3,), where the parts tell it: sum over axes (m / s)^2 = rate^2."""
    squares = offset[turning] ** 2
    if len(squares) < 6:
        return np.full(3, size)
    found = np.linalg.lstsq(squares / rate[turning, None] ** 2, np.ones(len(squares)), rcond=1e-3)[0]
    scales = np.sqrt(1 / np.maximum(found, 1e-30))
    return scales if np.all(np.abs(np.log(scales / size)) < 2 * np.log(_UNSCALED)) else np.full(3, size)


def _zero_and_size(means: Floats, speeds: Floats, allowed: Booleans) -> tuple[Floats, float]:
    """Return the zero (3,) and the size of 1 rad/s of counts that make the magnitudes those of the stated speeds best.

    Rests all show the zero; without rests it is the centre of the sphere on which the parts lie.
    """
    if len(means) < 2 or not np.ptp(means, axis=0).any():
        raise DetectionError(
            f"{len(means)} steady parts found, all alike; the speeds cannot be told from them. "
            "Record the turntable at rest and turning, with the sensor in many orientations."
        )
    apart = np.linalg.norm(means[:, None] - means, axis=2)
    close = apart < _SAME_PLACE * apart.max()
    densest = close[np.argmax(close.sum(axis=1))]
    candidates = [means[densest].mean(axis=0)]
    for chosen in (means, means[~densest]):
        if len(chosen) >= 6:
            design = np.column_stack([2 * chosen, np.ones(len(chosen))])
            candidates.append(np.linalg.lstsq(design, np.sum(chosen**2, axis=1), rcond=1e-12)[0][:3])
    best = (np.inf, candidates[0], 1.0)
    turning = speeds[speeds > 0]
    for zero in candidates:
        radius = np.linalg.norm(means - zero, axis=1)
        for size in np.unique(np.outer(np.quantile(radius[radius > 0], np.linspace(0, 1, 21)), 1 / turning)):
            cost = _cost(radius / size, speeds, allowed)
            if cost < best[0]:
                best = (cost, zero, float(size))
    return best[1], best[2]


def _cost(shown: Floats, speeds: Floats, allowed: Booleans) -> float:
    with np.errstate(divide="ignore"):
        away = np.abs(np.log(np.maximum(shown, 1e-12))[:, None] - np.log(np.maximum(speeds, 1e-300)))
    away = np.where(allowed & (speeds > 0), away, np.inf)
    turning = shown >= _AT_REST * speeds[speeds > 0].min()
    if not turning.any():
        return np.inf
    nearest = np.argmin(away, axis=1)[turning]
    unused = np.count_nonzero(speeds > 0) - len(np.unique(nearest))
    return float(np.mean(np.minimum(away.min(axis=1)[turning], 1.0))) + _COST_UNUSED * unused
