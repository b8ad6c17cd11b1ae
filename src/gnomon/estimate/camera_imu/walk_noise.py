"""How strongly the biases wander, by the variance component of their random walk.

The steps of a walk from knot to knot are terms of the cost like readings. Those of level sigma = 1 have
sigma^2 = chi^2 / (number of steps - trace of their part of the hat matrix). Only slow wandering shows in a recording, a
few cycles of it; the estimate absorbs the rest. That leaves few degrees of freedom, so that several probes are needed
for the trace, and what was stated counts as a few further ones.
"""

import numpy as np

from ...frozen import value_class
from ...recording import Floats, Integers
from ...solve.bordered_band import BorderedBand, Factor
from .terms.assembly import TRIAD
from .terms.prior_terms import random_walk_links
from .trajectory import POSE, Trajectory

PROBES = 4
"""For the walk of each triad; they find its degrees of freedom f to sqrt(f / 2)."""

_ASSUMED_FREEDOM = 1.0
"""Degrees of freedom that the assumed level counts for: it stays where a recording tells nothing."""

_LARGEST = 30.0
"""Multiple of the stated level beyond which none is believed: that is the trajectory's own error."""

_FASTER = 1.5
"""Exponent of the step to the found level: alone it goes two thirds of the way, since what a walk may absorb grows."""


@value_class(eq=True)
class WalkSums:
    """Steps of one triad's walk: sum of squares in sigmas, and their number."""

    chi2: float
    count: int


def walk_sums(trajectory: Trajectory, walks: tuple[tuple[float, float], ...]) -> tuple[WalkSums, ...]:
    """Return the sums for gyroscope and accelerometer of every IMU, one after the other."""
    squares, count = np.zeros(2 * len(walks)), 0
    variance = np.square(np.ravel(walks))
    for a, distance, time_s in random_walk_links(trajectory.grid):
        biases = trajectory.controls[:, POSE:]
        steps = (biases[a + distance] - biases[a]) ** 2 / time_s
        squares += steps.reshape(-1, 2 * len(walks), TRIAD).sum(axis=(0, 2)) / variance
        count += TRIAD * len(a) // (trajectory.grid.order - 1 if trajectory.grid.tied else 1)
    return tuple(WalkSums(chi2=float(chi2), count=count) for chi2 in squares)


def add_walk_probes(
    system: BorderedBand, trajectory: Trajectory, walks: tuple[tuple[float, float], ...], first: int
) -> None:
    """Put random signs of all steps among the right-hand sides, from `first` on, `PROBES` for each triad's walk.

    A step is from bend to bend: where biases bend at every (order - 1)-th knot only, the links between share its sign.
    """
    rng = np.random.default_rng(2000)
    grid = trajectory.grid
    links = grid.order - 1 if grid.tied else 1
    for triad, walk in enumerate(np.ravel(walks)):
        scalars = slice(POSE + TRIAD * triad, POSE + TRIAD * (triad + 1))
        side = slice(first + PROBES * triad, first + PROBES * (triad + 1))
        for a, distance, time_s in random_walk_links(grid):
            step = (a - grid.bias_offset) // links
            signs = 2.0 * rng.integers(0, 2, (step[-1] - step[0] + 1, TRIAD, PROBES)) - 1.0
            signs = signs[step - step[0]] / (walk * np.sqrt(links * time_s))
            system.rhs[a + distance, scalars, side] += signs
            system.rhs[a, scalars, side] -= signs


def found_walks(sums: tuple[WalkSums, ...], factor: Factor, first: int, free: Integers, covariance: Floats) -> Floats:
    """Return the level that the steps of each walk show, in units of the assumed one, (m, 2).

    Parameters
    ----------
    sums : of the steps
    factor : of the normal equations with the probes from `first` on
    free, covariance : border parameters that are estimated, and their covariance
    """
    levels = np.empty(len(sums))
    for triad, own in enumerate(sums):
        probes = range(first + PROBES * triad, first + PROBES * (triad + 1))
        absorbed = np.mean([factor.quadratic(probe, probe, free, covariance) for probe in probes])
        freedom = max(own.count - absorbed, 0.0)
        levels[triad] = np.sqrt((own.chi2 + _ASSUMED_FREEDOM) / (freedom + _ASSUMED_FREEDOM))
    return levels.reshape(-1, 2)


def next_walk(found: float, used: float, stated: float) -> float:
    """Return the level of a walk to go on with: never less than what was stated, nor far more.

    A walk that is assumed too weak makes sigmas too small, one that is assumed too strong hardly makes them larger.
    """
    return float(np.clip(used * (found / used) ** _FASTER, stated, _LARGEST * stated))
