"""How a bias follows the temperature, by the rests of a recording in which the attitude or the place changed."""

import numpy as np

from ...frozen import value_class
from ...recording import Floats
from ...results.result import Booleans
from ..multiposition.bias_changes import RestMeans, functions_of_time, gyroscope_changes
from ..multiposition.bias_functions import walk_density


@value_class
class BiasCourse:
    """What a bias does with the temperature.

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
    t_s: Floats, degc: Floats | None, residual: Floats, noise: Floats, *, at_rest: Booleans, force: Floats | None = None
) -> BiasCourse | None:
    """Return how the bias follows the temperature, by the rests; None where they do not tell it from drift in time.

    Generalised least squares (Aitken 1936): beside the temperature a decay, where one is likelier than none, what the
    attitude does by the g-sensitivity, and a random walk as what is left shows it.

    Parameters
    ----------
    t_s : (n,) middle of each part [s]
    degc : (n, m) what a bias may follow of the temperature, see `RestMeans`; None where nothing tells it from the time
    residual, noise : (n, 3) measured minus bias, and the variance of each; count at rest alone
    at_rest : (n,) bool
    force : (n, 3) specific force of each part; None where it is not known
    """
    n = int(at_rest.sum())
    if degc is None or n < FEWEST_FOR_COURSE:
        return None
    felt = np.zeros_like(residual) if force is None else force
    rests = RestMeans(
        rest=np.arange(n), t_s=t_s[at_rest], half_s=np.zeros(n), means=residual[at_rest], variance=noise[at_rest],
        degc=degc[at_rest],
    )  # fmt: skip
    changes = gyroscope_changes(rests, felt[at_rest] / max(float(np.abs(felt).max()), 1e-300))
    if not changes.temperature or changes.steps:
        return None
    powers = degc.shape[1]
    course = functions_of_time(changes, t_s, np.zeros_like(t_s), degc)
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


FEWEST_FOR_COURSE = 16
"""Means that tell it."""
