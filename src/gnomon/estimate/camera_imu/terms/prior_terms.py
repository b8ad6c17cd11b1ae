"""Terms that are no measurements: the random walk of the biases, and the priors of the constant parameters."""

from collections.abc import Iterator

import numpy as np

from ....recording import Floats, Integers
from ....solve.bordered_band import BorderedBand
from ..layout import BorderLayout
from ..parameters import RigParameters
from ..rig_prior import rig_prior
from ..trajectory import BIAS, POSE, KnotGrid, Trajectory
from .assembly import TRIAD

FIRST_BIAS_SIGMA = (1.0, 10.0)
"""Of gyroscope [rad/s] and accelerometer [m/s^2]: hardly a prior."""

_SMOOTHNESS = 1e3  # rad/s^2 and m/s^2: what the trajectory does where nothing is measured


def add_walks(system: BorderedBand, trajectory: Trajectory, walks: tuple[tuple[float, float], ...]) -> float:
    """Add the random walk of the biases from knot to knot, and across the cuts between segments; return its cost.

    Parameters
    ----------
    walks : for each IMU, of gyroscope [rad/s/sqrt(s)] and accelerometer [m/s^2/sqrt(s)]
    """
    grid = trajectory.grid
    cost = 0.0
    for imu, walk in enumerate(walks):
        band = system.band[1 + imu][1 + imu]
        scalars = slice(POSE + BIAS * imu, POSE + BIAS * (imu + 1))
        bias, rhs = trajectory.controls[:, scalars], system.rhs[:, scalars, 0]
        variance = np.repeat(np.square(walk), TRIAD)
        for a, distance, time_s in random_walk_links(grid):
            information = 1 / (variance * time_s)
            difference = bias[a + distance] - bias[a]
            for i in range(BIAS):
                band[a, i, 0, i] += information[i]
                band[a + distance, i, 0, i] += information[i]
                band[a, i, distance, i] -= information[i]
            rhs[a] += information * difference
            rhs[a + distance] -= information * difference
            cost += 0.5 * float((information * difference**2).sum())
        information = np.repeat(FIRST_BIAS_SIGMA, TRIAD) ** -2.0
        band[0, np.arange(BIAS), 0, np.arange(BIAS)] += information
        rhs[0] -= information * bias[0]
        cost += 0.5 * float((information * bias[0] ** 2).sum())
    return cost


def random_walk_links(grid: KnotGrid) -> Iterator[tuple[Integers, int, float]]:
    """Yield which biases a random walk links: control points (n,), how much further the others are, and time [s]."""
    for number, segment in enumerate(grid.segments):
        yield segment.first + np.arange(segment.spans + grid.order - 2), 1, grid.spacing_s
        if number + 1 < len(grid.segments):
            gap = grid.segments[number + 1].start_s - segment.start_s - segment.spans * grid.spacing_s
            last = np.array([segment.first + grid.bias_offset + segment.spans])
            yield last, grid.order - 1, max(gap, grid.spacing_s)


def add_smoothness(system: BorderedBand, trajectory: Trajectory) -> None:
    """Hold second differences of the pose's control points small, by so little that only gaps notice."""
    for at, weight in second_differences(trajectory.grid):
        second = sum(weight[i] * trajectory.controls[at + i, :POSE] for i in range(3))
        for i in range(3):
            for j in range(i, 3):
                for scalar in range(POSE):
                    system.band[0][0][at + i, scalar, j - i, scalar] += weight[i] * weight[j]
            system.rhs[at + i, :POSE, 0] -= weight[i] * second


def second_differences(grid: KnotGrid) -> Iterator[tuple[Integers, Floats]]:
    """Yield the first (n,) of three control points in a row, and their weights (3,), segment by segment."""
    weight = np.array([1.0, -2.0, 1.0]) / (grid.spacing_s**2 * _SMOOTHNESS)
    for segment in grid.segments:
        yield segment.first + np.arange(segment.spans + grid.order - 3), weight


def add_priors(system: BorderedBand, parameters: RigParameters, layout: BorderLayout) -> float:
    """Add the priors of the border parameters; return the cost of those that are estimated."""
    if not len(layout):
        return 0.0
    information, pull, cost = border_priors(parameters, layout)
    system.corner += information
    system.corner_rhs[:, 0] += pull
    return cost


def border_priors(parameters: RigParameters, layout: BorderLayout) -> tuple[Floats, Floats, float]:
    """Return information (p, p) and pull (p,) of the priors, by a step of the border's scalars, and their cost."""
    known = layout.prior_information
    difference = layout.values(parameters) - layout.prior_mean
    dense = slice(layout.dense)  # the corners of a board behind them move as they are, each on its own
    jacobian = layout.values_jacobian(parameters)[dense, dense]
    information, towards = known.copy(), known @ difference
    information[dense, dense] = jacobian.T @ known[dense, dense] @ jacobian
    towards[dense] = jacobian.T @ towards[dense]
    free = np.where(layout.free, difference, 0.0)
    together, pull, cost = rig_prior(layout, parameters)
    return information + together, pull - towards, cost + 0.5 * float(free @ known @ free)
