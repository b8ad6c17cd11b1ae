"""A gyroscope's bias that wanders over a session on the turntable, from its rests."""

import numpy as np

from ...recording import Floats
from ...results.intervals import Booleans
from ..multiposition.drift import walk_density

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
