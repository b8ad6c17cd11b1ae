"""Errors of an estimated path by the definitions of evo (github.com/MichaelGrupp/evo; Sturm et al., IROS 2012)."""

import numpy as np
from scipy.spatial.transform import Rotation

from ..frozen import value_class
from ..recording import Floats

STEP_M = 10.0
"""Way after which relative errors are taken."""

_TOLERANCE_M = 0.1 * STEP_M


@value_class(eq=True)
class PathErrors:
    """How far a path is off.

    Attributes
    ----------
    closure_m : distance of its end from the true one, where both begin at the same place
    ate_m : absolute: rms distance after the best rigid alignment (`evo_ape --align`)
    rpe_m : relative: rms error of the translation over each 10 m of way
        (`evo_rpe --delta 10 --delta_unit m --all_pairs`)
    """

    closure_m: float
    ate_m: float
    rpe_m: float


def path_errors(R: Floats, p: Floats, true_R: Floats, true_p: Floats) -> PathErrors:
    """Return the errors of a path R (n, 3, 3), p (n, 3) [m] against the true one, at the same n instants."""
    middle, true_middle = p.mean(axis=0), true_p.mean(axis=0)
    turn = Rotation.align_vectors(true_p - true_middle, p - middle)[0]
    off = turn.apply(p - middle) + true_middle - true_p
    return PathErrors(
        closure_m=float(np.linalg.norm((p[-1] - p[0]) - (true_p[-1] - true_p[0]))),
        ate_m=float(np.sqrt(np.mean(np.sum(off**2, axis=1)))),
        rpe_m=_relative(R, p, true_R, true_p),
    )


def _relative(R: Floats, p: Floats, true_R: Floats, true_p: Floats) -> float:
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(p, axis=0), axis=1))])
    ends = np.array([start + np.argmin(np.abs(way[start:] - way[start] - STEP_M)) for start in range(len(way))])
    starts = np.flatnonzero(np.abs(way[ends] - way - STEP_M) <= _TOLERANCE_M)
    if not len(starts):
        return float("nan")
    ends = ends[starts]

    def moved(R: Floats, p: Floats) -> Floats:
        return np.einsum("nji,nj->ni", R[starts], p[ends] - p[starts])

    # | Q^-1 P | in translation: the turn of Q does not change its length
    return float(np.sqrt(np.mean(np.sum((moved(R, p) - moved(true_R, true_p)) ** 2, axis=1))))
