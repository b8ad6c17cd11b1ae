"""The covariance of everything that a calibration publishes, and what held parameters would have done.

Beside the free parameters theta, the means of the biases over the recording are published, m = L x. Solving the normal
equations with L as further right-hand sides gives their covariance and that with theta. A parameter c that was held at
a value of its own uncertainty (gravity) adds (d theta / d c) sigma_c; one that was held without need (the size of the
board, the intrinsics) is tested by the step that it would take if it were free.
"""

from dataclasses import dataclass

import numpy as np

from ...recording import Floats
from .batch import Step, mean_weights
from .parameters import Layout
from .solution import Solution
from .trajectory import BIAS, POSE


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Held:
    """What a held parameter would do.

    Attributes
    ----------
    names : (h,) scalars
    by_unit : (h, f + 6 m) change of what is published per unit of each
    wanted : (h,) step that they would take together if they were free
    wanted_sigma : (h,) standard deviation of that step
    """

    names: tuple[str, ...]
    by_unit: Floats
    wanted: Floats
    wanted_sigma: Floats


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Uncertainty:
    """Covariance of what is published.

    Attributes
    ----------
    names : (f,) free scalars; after them stand the 6 m means of the biases
    covariance : (f + 6 m, f + 6 m)
    bias_mean : (m, 6) means of the biases over the trajectory, gyroscope [rad/s] and accelerometer [m/s^2]
    held : by block name
    """

    names: tuple[str, ...]
    covariance: Floats
    bias_mean: Floats
    held: dict[str, Held]


def uncertainty(solution: Solution, held_blocks: tuple[str, ...]) -> Uncertainty:
    """Return the covariance at a solution.

    Parameters
    ----------
    solution : the estimate
    held_blocks : blocks to look at that were not estimated
    """
    noise, step, layout = solution.noise, solution.step, solution.layout
    free = layout.free_index
    count = BIAS * len(noise.imus)
    first = 1 + 2 * len(noise.imus) + len(noise.pixel_sigma)
    sides = np.arange(first, first + count)
    schur_sides = step.factor.schur_sides[:, sides]
    gain = step.covariance @ schur_sides[free]  # (f, 6 m) covariance of parameters and means
    means = step.factor.inner(sides) + schur_sides[free].T @ gain
    held = {name: found for name in held_blocks if (found := _held(name, layout, step, schur_sides)) is not None}
    biases = solution.state.trajectory.controls[:, POSE:]
    return Uncertainty(
        names=tuple(name for name, is_free in zip(layout.names, layout.free, strict=True) if is_free),
        covariance=np.block([[step.covariance, gain], [gain.T, means]]),
        bias_mean=(mean_weights(solution.state.trajectory) @ biases).reshape(-1, BIAS),
        held=held,
    )


def _held(name: str, layout: Layout, step: Step, schur_sides: Floats) -> Held | None:
    columns = layout.get(name)
    if columns is None:
        return None
    index = np.array([c for c in range(columns.start, columns.stop) if not layout.free[c]], dtype=np.int64)
    if not len(index):
        return None
    free = layout.free_index
    schur = step.factor.schur
    by_unit = -step.covariance @ schur[np.ix_(free, index)]  # (f, h)
    means_by_unit = schur_sides[index].T + schur_sides[free].T @ by_unit
    information = schur[np.ix_(index, index)] + schur[np.ix_(index, free)] @ by_unit
    right = step.factor.schur_sides[index, 0] + by_unit.T @ step.factor.schur_sides[free, 0]
    scale = 1 / np.sqrt(np.maximum(np.diag(information), 1e-300))
    covariance = np.linalg.inv(information * np.outer(scale, scale)) * np.outer(scale, scale)
    return Held(
        names=tuple(layout.names[i] for i in index),
        by_unit=np.concatenate([by_unit, means_by_unit]).T,
        wanted=covariance @ right,
        wanted_sigma=np.sqrt(np.maximum(np.diag(covariance), 0.0)),
    )


def with_uncertain(found: Uncertainty, block: str, sigma: float) -> Floats:
    """Return the covariance with the uncertainty of a held scalar added."""
    if block not in found.held or not np.isfinite(sigma):
        return found.covariance
    influence = found.held[block].by_unit[0]
    return found.covariance + np.outer(influence, influence) * sigma**2
