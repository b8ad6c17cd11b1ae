"""How the biases of an IMU follow something known, such as its temperature, beside their random walk.

The random walk is the prior of the biases, with covariance Q; what the readings tell of them alone scatters by R. Of
coefficients p of known courses X, b = c + X p + walk, generalised least squares (Aitken 1936) has the information
X' (Q + R)^-1 X. With the estimate b under the walk alone, and its covariance C,

    (Q + R)^-1 = Q^-1 - Q^-1 C Q^-1   and   (Q + R)^-1 y = Q^-1 b,

so that one more substitution into the factor at hand gives p and its covariance, as if X had been estimated along.
"""

import numpy as np

from ....recording import Floats
from ..solution import Solution
from ..terms.assembly import random_walk_links
from ..trajectory import BIAS, POSE, KnotGrid


def control_times(grid: KnotGrid) -> Floats:
    """Return the instants (n,) of the control points that hold biases [s]."""
    times = np.zeros(grid.controls)
    for segment in grid.segments:
        own = np.arange(segment.spans + grid.order - 1)
        times[segment.first + own] = segment.start_s + grid.spacing_s * (own - grid.bias_offset)
    return times


def biases_along(solution: Solution, courses: Floats, sigma: Floats) -> tuple[Floats, Floats]:
    """Return by how much each bias of the first IMU follows some courses, (k, 6), and the covariance (6 k, 6 k).

    Parameters
    ----------
    courses : (n, k) at the control points
    sigma : (k, 6) standard deviations of the coefficients beforehand
    """
    trajectory, step = solution.state.trajectory, solution.step
    count = courses.shape[1] * BIAS
    columns = np.zeros((len(courses), BIAS, courses.shape[1], BIAS))
    columns[:, np.arange(BIAS), :, np.arange(BIAS)] = courses
    columns = columns.reshape(len(courses), BIAS, count)
    variance = np.repeat(np.square(solution.noise.walks[0]), BIAS // 2)[:, None]
    pulled = np.zeros_like(columns)
    for a, distance, time_s in random_walk_links(trajectory.grid):
        steps = (columns[a + distance] - columns[a]) / (variance * time_s)
        np.add.at(pulled, a + distance, steps)
        np.add.at(pulled, a, -steps)
    right = np.zeros((trajectory.grid.controls, step.factor.size, count))
    right[:, POSE : POSE + BIAS] = pulled
    told = step.factor.quadratics(right, solution.layout.free_index, step.covariance)
    information = np.tensordot(columns, pulled, axes=((0, 1), (0, 1))) - told + np.diag(np.ravel(sigma) ** -2.0)
    pull = np.tensordot(pulled, trajectory.controls[:, POSE : POSE + BIAS], axes=((0, 1), (0, 1)))
    scale = 1 / np.sqrt(np.diag(information))
    covariance = np.linalg.inv(information * np.outer(scale, scale)) * np.outer(scale, scale)
    return (covariance @ pull).reshape(-1, BIAS), (covariance + covariance.T) / 2
