"""Between poses in the units of a sensor and the scaled units in which a triad is fitted.

Every axis is centred and divided by its spread, and magnitudes by the largest, so that offsets of 32768 counts and
scales of any size are the same problem.
"""

from dataclasses import replace

import numpy as np

from ...frozen import value_class
from ...recording import Floats
from ...results.result import Booleans
from .triad_poses import B_, G_, PARAMETERS, S_, TriadPoses, TriadPrior
from .triad_rows import TriadProblem

_UPPER = [1, 2, 5]
_WILD = 10.0  # times the usual distance
_COMMON_SIGMA = 1.0  # of a factor that all magnitudes share and nobody knows
WEAK = 0.3  # sigma of the weak prior: of a scale, of the largest reading, and of that at one g


@value_class
class TriadScaling:
    """parameters = turn * scaled parameters + shift.

    Attributes
    ----------
    centre, spread : (3,) of the measurements [unit]
    size : of the magnitudes [SI]
    force : of the specific force [m/s^2]
    """

    centre: Floats
    spread: Floats
    size: float
    force: float

    @classmethod
    def of(cls, poses: TriadPoses) -> "TriadScaling":
        """Return the scaling of poses; a few wild ones do not matter."""
        moving = poses.magnitude > 0
        centre, spread = usual_spread(poses.measured[moving if moving.any() else ~moving])
        force = 0.0 if poses.force is None else float(np.median(np.linalg.norm(poses.force, axis=1)))
        return cls(
            centre=centre,
            spread=spread,
            size=float(poses.magnitude.max()) or 1.0,
            force=force or 1.0,
        )

    @property
    def turn(self) -> Floats:
        """(21,) scaled parameters to parameters, but for the shift of the bias."""
        by_axis = np.repeat(self.spread, 3)
        return np.concatenate([by_axis / self.size, self.spread, by_axis / self.force])

    @property
    def shift(self) -> Floats:
        """(21,) the centre, for the bias."""
        shift = np.zeros(PARAMETERS)
        shift[B_] = self.centre
        return shift


def usual_spread(measured: Floats) -> tuple[Floats, Floats]:
    """Return median and typical distance from it, (3,) each, in which wild measurements do not count."""
    centre = np.median(measured, axis=0)
    away = np.abs(measured - centre)
    distance = np.linalg.norm(away, axis=1)
    half, more = np.quantile(distance, [0.5, 0.75])
    usual = half if half > 0.05 * more else more  # most poses may be one attitude, to which the sensor came back
    away = away[distance <= _WILD * usual]
    three_quarters, most = np.quantile(away, [0.75, 0.9], axis=0)
    spread = np.where(three_quarters > 0.05 * most, three_quarters, most)  # an axis may lie level nearly always
    spread = np.where(spread > 0, spread, away.mean(axis=0))
    return centre, np.where(spread > 0, spread, 1.0)


def not_wild(measured: Floats, magnitude: Floats) -> Booleans:
    """Return which measurements lie within ten times the usual distance, (n,); no sensor in its range goes there.

    Poses of zero magnitude are all in one place and do not tell what is usual.
    """
    moving = magnitude > 0
    centre, usual = usual_spread(measured[moving if moving.any() else ~moving])
    return np.asarray((np.abs(measured - centre) <= _WILD * usual).all(axis=1), dtype=np.bool_)


def scaled_problem(
    poses: TriadPoses,
    scaling: TriadScaling,
    prior: TriadPrior | None,
    *,
    g_sensitivity: bool,
    unknown_scale: bool,
) -> TriadProblem:
    """Return the poses in scaled units, with the stated prior; `with_weak_prior` adds the weak one."""
    groups = len(poses.group_sigma)
    level = np.zeros((len(poses), groups + unknown_scale))
    level[np.arange(len(poses)), poses.group] = 1.0
    level[:, groups:] = 1.0
    sigma = np.append(poses.group_sigma, [_COMMON_SIGMA] * unknown_scale)
    known = np.zeros(len(poses), dtype=bool)
    direction = np.zeros_like(poses.measured)
    if poses.direction is not None:
        known = np.isfinite(poses.direction).all(axis=1)
        direction[known] = poses.direction[known]
    free = np.concatenate([_free(prior, bool(known.any()), g_sensitivity=g_sensitivity), sigma > 0])
    errors = np.diag(1 / np.where(sigma > 0, sigma, 1.0))[sigma > 0]
    root, target = np.zeros((0, PARAMETERS)), np.zeros(0)
    if prior is not None:
        root = _root(prior.precision * np.outer(scaling.turn, scaling.turn))
        target = root @ ((prior.mean - scaling.shift) / scaling.turn)
    sides = ((0, 0), (0, len(sigma))), ((0, 0), (PARAMETERS, 0))
    return TriadProblem(
        measured=(poses.measured - scaling.centre) / scaling.spread,
        variance=poses.variance / scaling.spread**2,
        force=np.zeros_like(poses.measured) if poses.force is None else poses.force / scaling.force,
        magnitude=poses.magnitude / scaling.size,
        magnitude_sigma=poses.magnitude_sigma / scaling.size,
        level=level,
        direction=direction,
        direction_sigma=np.where(known, 0.0 if poses.direction_sigma is None else poses.direction_sigma, np.inf),
        free=free,
        prior_root=np.concatenate([np.pad(root, sides[0]), np.pad(errors, sides[1])]),
        prior_target=np.concatenate([target, np.zeros(len(errors))]),
    )


def _free(prior: TriadPrior | None, directions: bool, *, g_sensitivity: bool) -> Booleans:
    """Return which of the 21 parameters are estimated."""
    free = np.ones(PARAMETERS, dtype=bool)
    free[G_] = g_sensitivity
    oriented = prior is not None and bool(np.all(np.diag(prior.precision)[_UPPER] > 0))
    free[_UPPER] = directions or oriented
    return free if prior is None else free & ~prior.fixed


def _root(precision: Floats) -> Floats:
    """Return rows R with R'R = precision, as many as it has rank."""
    size = np.sqrt(np.maximum(np.diag(precision), 0.0))
    size = np.where(size > 0, size, 1.0)
    values, vectors = np.linalg.eigh(precision / np.outer(size, size))
    kept = values > 1e-12
    return (np.sqrt(values[kept])[:, None] * vectors[:, kept].T) * size


def weak_sigma(theta: Floats) -> Floats:
    """Return the sigma (21,) of the weak prior around a start, in scaled units."""
    rows = np.linalg.norm(theta[S_].reshape(3, 3), axis=1)
    return WEAK * np.concatenate([np.repeat(rows, 3), np.maximum(rows, 1.0), np.repeat(np.maximum(rows, 1.0), 3)])


def with_weak_prior(problem: TriadProblem, theta: Floats) -> TriadProblem:
    """Return the problem with a weak prior around a start, which holds what the poses leave open."""
    precision = np.diag(1 / weak_sigma(theta))
    root = np.pad(precision, ((0, 0), (0, problem.level.shape[1])))
    return replace(
        problem,
        prior_root=np.concatenate([problem.prior_root, root]),
        prior_target=np.concatenate([problem.prior_target, precision @ theta[:PARAMETERS]]),
    )
