"""The noise levels that the residuals show, by their variance components.

A group of residuals that was assumed to have sigma = 1 has sigma^2 = chi^2 / (number of residuals - trace of its part
of the hat matrix); the trace comes from random signs carried along as a further right-hand side.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ...recording import Integers
from .batch import NoiseLevels, NormalEquations
from .gauss_newton import GaussNewtonStep
from .terms.corner_sums import CornerSums, Exposures
from .terms.inertial_data import InertialNoise
from .trajectory import BIAS
from .walk_noise import found_walks, walk_sums

_LONGEST = 100  # images over which errors of a point may last
_MOST_ROUNDS, _SAME = 20, 1e-3  # of Huber's proposal, and relative change after which it stands


def estimated_noise(lin: NormalEquations, step: GaussNewtonStep, noise: NoiseLevels) -> NoiseLevels:
    """Return the noise levels that the residuals show, at a linearisation that was made with `noise` and probes."""
    free = lin.layout.free_index
    imus: list[InertialNoise] = []
    for i, used in enumerate(noise.imus):
        levels: list[float] = []
        for which, sigma in enumerate((used.gyroscope, used.accelerometer)):
            count, probe = lin.inertial_count[i][which], 1 + 2 * i + which
            absorbed = step.factor.quadratic(probe, probe, free, step.covariance)
            freedom = max(count - absorbed, 0.05 * count, 1.0)
            levels.append(sigma * float(np.sqrt(lin.inertial_chi2[i][which] / freedom)))
        imus.append(InertialNoise(gyroscope=levels[0], accelerometer=levels[1]))
    first = 1 + len(noise.pixel_sigma) + (2 + BIAS) * len(noise.imus)
    # After the step: under another level the biases are much smoother, or rougher, than before it.
    sums = walk_sums(lin.trajectory.plus(step.trajectory), noise.walks)
    walks = found_walks(sums, step.factor, first, free, step.covariance) * np.array(noise.walks)
    return replace(
        noise,
        imus=tuple(imus),
        pixel_sigma=pixel_levels(lin.sums, lin.inside, noise, step, free),
        walks=tuple((float(g), float(a)) for g, a in walks),
    )


def pixel_levels(
    sums: Sequence[CornerSums], inside: Sequence[np.ndarray], noise: NoiseLevels, step: GaussNewtonStep, free: Integers
) -> tuple[float, ...]:
    """Return the noise levels of corners that residuals of the cameras show.

    Parameters
    ----------
    sums, inside : of the exposures of each camera, and which count
    step, free : by equations with probes, and its columns: what of the residuals it absorbs
    """
    pixels: list[float] = []
    for camera, sigma in enumerate(noise.pixel_sigma):
        probe = 1 + 2 * len(noise.imus) + camera
        absorbed = step.factor.quadratic(probe, probe, free, step.covariance)
        pixels.append(sigma * _pixel_factor(sums[camera], inside[camera], sigma, noise.huber, absorbed))
    return tuple(pixels)


def lasting_factor(exposures: Exposures, sums: CornerSums) -> float:
    """Return by how much a mean over images scatters more than if the errors of a point were new in each.

    Its square is 1 + 2 sum rho(lag), with the correlations of the residuals of a point in images lag apart, none larger
    than one before it, up to the first that is not positive (initial monotone sequence, Geyer 1992): it changes by
    little where they do.
    """
    if exposures.point is None:
        return 1.0
    weight = np.where(np.isfinite(sums.residual).all(axis=1), sums.weight, 0.0)
    residual = np.nan_to_num(sums.comparable) * np.sqrt(weight)[:, None]
    frame = exposures.frame[exposures.of_corner]
    images = int(frame.max()) + 1
    place = exposures.point * (images + _LONGEST) + frame
    order = np.argsort(place, kind="stable")
    place, residual = place[order], residual[order]
    own, total, rho = float(np.mean(residual**2)), 1.0, 1.0
    for lag in range(1, _LONGEST):
        at = np.minimum(np.searchsorted(place, place + lag), len(place) - 1)
        pair = np.flatnonzero(place[at] == place + lag)
        rho = min(rho, float(np.mean(residual[pair] * residual[at[pair]])) / own) if len(pair) else 0.0
        if rho <= 0:
            break
        total += 2 * rho
    return float(np.sqrt(total))


def _pixel_factor(sums: CornerSums, inside: np.ndarray, sigma: float, huber: float, absorbed: float) -> float:
    """Return the scatter of the corners over the assumed one, by Huber's proposal 2 in two dimensions."""
    corners = np.repeat(inside, sums.lengths)
    residual = sums.comparable[corners]
    distance = np.sqrt(np.einsum("ij,ij->i", residual, residual)) / sigma
    distance = distance[np.isfinite(distance)]
    freedom = max(2 * len(distance) - absorbed, 0.05 * len(distance), 1.0)
    share = 1 - np.exp(-0.5 * huber**2) if np.isfinite(huber) else 1.0
    total = 1.0
    for _ in range(_MOST_ROUNDS):
        factor = float(np.sqrt((np.minimum(distance / total, huber) ** 2).sum() / (freedom * share)))
        total *= factor
        if abs(factor - 1) < _SAME:
            break
    return total
