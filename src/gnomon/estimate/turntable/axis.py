"""Where the axis of the platter is in the sensor, by the accelerometer.

In one attitude the accelerometer shows

    a = F + A cos(phi) + B sin(phi) + omega^2 C + noise,

with the angle phi by which the platter has turned: F is what it would show if the axis stood still and vertical, A and
B are the tilt of the platter, and C the centripetal acceleration of each axis, wherever it is. All of them are linear;
rests before and after the turning, or a second speed, tell F and C apart. Whole turns are not needed.
"""

import numpy as np

from ...frozen import value_class
from ...recording import Floats, Integers

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
            variance=_variance_of_mean(force),
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


def _variance_of_mean(values: Floats) -> Floats:
    return np.var(values, axis=0, ddof=1) / len(values) if len(values) > 1 else np.full(3, np.inf)
