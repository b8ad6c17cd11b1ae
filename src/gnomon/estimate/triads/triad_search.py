"""Starts that several bad poses do not reach: ellipsoids through few poses, judged by how well most of all agree."""

from collections.abc import Iterator

import numpy as np

from ...geometry.so3 import invert_matrix
from ...recording import Floats
from ...results.intervals import Booleans
from .triad_ellipsoid import general_ellipsoid
from .triad_poses import B_, PARAMETERS, S_
from .triad_rows import TriadProblem, known_magnitudes, noise_at, true_vectors
from .triad_solve import Minimum, minimise_from

_SUBSETS = 150  # with every fourth pose bad, some ten of them have none
_POSES = 10  # in a subset
_KEPT = 3
_CONCENTRATIONS = 10
_FEWEST_SHARE = 0.6


def most_errors(problem: TriadProblem, theta: Floats) -> float:
    """Return the mean of | |x| - w | over the better part of the poses, in which bad ones should not be.

    It is in the unit of the measurements: an ellipsoid so large that all poses are on one patch fits well in its own.
    """
    error = _errors(problem, theta)
    size = float(np.abs(np.linalg.det(theta[S_].reshape(3, 3)))) ** (1 / 3)
    return size * float(np.mean(error[_better_part(problem, error)]))


def concentrate_fit(problem: TriadProblem, theta: Floats, extra: float) -> Minimum:
    """Return a fit to the better part of the poses, which are chosen again until they stay the same."""
    kept = _better_part(problem, _errors(problem, theta))
    point = minimise_from(problem, theta, noise_at(problem, theta, extra), kept.astype(np.float64), rough=True)
    for _ in range(_CONCENTRATIONS):
        old, kept = kept, _better_part(problem, _errors(problem, point.theta))
        if np.array_equal(kept, old):
            break
        point = minimise_from(problem, point.theta, point.noise, kept.astype(np.float64), rough=True)
    return point


def _errors(problem: TriadProblem, theta: Floats) -> Floats:
    return np.abs(np.linalg.norm(true_vectors(problem, theta), axis=1) - known_magnitudes(problem, theta))


def _better_part(problem: TriadProblem, error: Floats) -> Booleans:
    half = (len(error) + int(problem.free[:PARAMETERS].sum()) + 1) // 2
    count = min(max(half, int(_FEWEST_SHARE * len(error))), len(error))
    return error <= np.partition(error, count - 1)[count - 1]


def subset_starts(problem: TriadProblem, theta: Floats) -> Iterator[Floats]:
    """Yield the best of many starts through few poses (least trimmed squares, Rousseeuw and Van Driessen 1999).

    Parameters
    ----------
    problem : in scaled units
    theta : (21 + p,) a start by all poses, which gives what a few poses cannot: body frame, g-sensitivity
    """
    moving = np.flatnonzero(problem.magnitude > 0)
    if len(moving) < _POSES + 2:
        return
    rng = np.random.default_rng(0)
    found: list[tuple[float, Floats]] = []
    unbiased = problem.measured - problem.force @ theta[PARAMETERS - 9 : PARAMETERS].reshape(3, 3).T
    for _ in range(_SUBSETS):
        some = rng.choice(moving, _POSES, replace=False)
        centre = unbiased[some].mean(axis=0)
        ellipsoid = general_ellipsoid(unbiased[some] - centre, problem.magnitude[some])
        if ellipsoid is not None:
            trial = theta.copy()
            trial[B_] = ellipsoid.bias + centre
            trial[S_] = _turned(invert_matrix(ellipsoid.correction), theta[S_].reshape(3, 3)).ravel()
            found.append((most_errors(problem, trial), trial))
    found.sort(key=lambda pair: pair[0])
    yield from (trial for _, trial in found[:_KEPT])


def _turned(sensitivity: Floats, like: Floats) -> Floats:
    """Return a sensitivity in the body frame in which another one is."""
    left, _, right = np.linalg.svd(sensitivity.T @ like)
    turned = np.asarray(sensitivity @ left @ right, dtype=np.float64)
    return np.tril(turned) if np.array_equal(like, np.tril(like)) else turned
