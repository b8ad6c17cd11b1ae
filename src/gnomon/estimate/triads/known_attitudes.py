"""Attitudes that somebody stated, held against what the accelerometer shows (Angrisano, Eqs. 4 to 7).

The sensor lies in its jig in some way that nobody knows; but the angles between poses are those between the stated
directions. An attitude that was stated wrongly, a sign lost or two axes swapped, stands out by tens of degrees.

An accelerometer that was turned by hand with a magnetometer: where up is, and how well that is known meanwhile.
"""

from itertools import permutations, product

import numpy as np

from ...frozen import value_class
from ...geometry.rotation_vector import invert_matrix
from ...recording import Floats
from ...results.calibration import AccelerometerCalibration
from ...results.result import Booleans
from .blocks import Stage, by_direction
from .triad import TriadFit, fit_triad
from .triad_poses import TriadPoses, TriadPrior
from .triad_start import near_ellipsoid

_SHORTEST_S = 0.04
_NEAR_S, _AROUND_S = 0.4, 1.0
_QUIET = 0.1  # quantile of the unrest below which poses count alike


@value_class
class GravityFit:
    """The accelerometer's parameters, and its direction of up in each pose.

    Attributes
    ----------
    triad : fit of the poses that `used` marks
    used : (n,) bool, of all poses
    up : (n, 3) unit vectors, frame accel-x
    sigma : (n,) of this direction, from how much |f| differs from gravity around each pose [rad]
    by_parameters : (n, 3, f) derivative of up by the free parameters
    stage : linearised, rows for all poses
    """

    triad: TriadFit
    used: Booleans
    up: Floats
    sigma: Floats
    by_parameters: Floats
    stage: Stage


def force_at(t_s: Floats, values: Floats, start_s: Floats, stop_s: Floats) -> Floats:
    """Return means of an accelerometer (k, 3) over given spans of time, at least 40 ms, (n, 3)."""
    middle, half = (start_s + stop_s) / 2, np.maximum((stop_s - start_s) / 2, _SHORTEST_S / 2)
    steps = np.diff(t_s)[:, None]
    total = np.concatenate([np.zeros((1, 3)), np.cumsum(0.5 * (values[1:] + values[:-1]) * steps, axis=0)])
    low = np.clip(middle - half, t_s[0], t_s[-1] - _SHORTEST_S)
    high = np.clip(middle + half, low + _SHORTEST_S / 2, t_s[-1])
    integral = [np.column_stack([np.interp(at, t_s, total[:, i]) for i in range(3)]) for at in (low, high)]
    return (integral[1] - integral[0]) / (high - low)[:, None]


def fit_gravity(
    t_s: Floats,
    measured: Floats,
    length: Floats,
    *,
    noise: Floats,
    gravity_m_s2: float,
    prior: TriadPrior | None,
    known: AccelerometerCalibration | None = None,
) -> GravityFit:
    """Fit the accelerometer to the magnitude of gravity; poses in the middle of accelerations count little.

    Parameters
    ----------
    t_s : (n,) rising [s]
    measured : (n, 3) means [unit]
    length : (n,) of a mean in units of gravity: the chord's less than 1 where the sensor turned meanwhile
    noise : (3,) of a sample [unit]
    gravity_m_s2 : its magnitude
    prior : what is known of the accelerometer
    known : where iterations start, if it is near

    Raises
    ------
    InitialisationError
        If the poses do not determine the accelerometer.
    """
    variance = np.maximum(noise, 1e-12) ** 2
    magnitude = gravity_m_s2 * length
    start = None
    if known is not None and prior is None:
        start = near_ellipsoid(measured, magnitude, known.sensitivity, known.bias)
    if start is None:
        triad = fit_triad(TriadPoses.of(measured, magnitude, variance=variance), prior=prior)
        sensitivity, force = triad.sensitivity, triad.physical(measured)
    else:
        sensitivity, force = invert_matrix(start.correction), (measured - start.bias) @ start.correction.T
    unrest = _unrest(t_s, np.linalg.norm(force, axis=1) - magnitude)
    shaken = unrest[:, None] ** 2 * np.sum(sensitivity**2, axis=1)  # a hand accelerates along all axes
    data = TriadPoses.of(measured, magnitude, variance=variance + shaken)
    triad = fit_triad(data, prior=prior, start=start)
    force = triad.physical(measured)
    up = force / np.linalg.norm(force, axis=1, keepdims=True)
    correction = invert_matrix(triad.sensitivity)
    free = triad.free[:12]
    weight = triad.used / triad.magnitude_sigma
    pull = up @ correction
    jacobian = -np.concatenate([(pull[:, :, None] * force[:, None, :]).reshape(-1, 9), pull], axis=1)
    return GravityFit(
        triad=triad,
        used=triad.used,
        up=up,
        sigma=np.sqrt(unrest**2 + triad.extra_sigma**2 + float(np.mean(variance * np.sum(correction**2, axis=0))))
        / gravity_m_s2,
        by_parameters=by_direction(force, correction)[:, :, free],
        stage=Stage(
            residual=triad.magnitude_error * weight,
            jacobian=jacobian[:, free] * weight[:, None],
            covariance=triad.covariance[:12, :12][np.ix_(free, free)],
            precision=None if prior is None else prior.precision[:12, :12][np.ix_(free, free)],
        ),
    )


def _unrest(t_s: Floats, error: Floats) -> Floats:
    """Return the root mean square of errors around each pose, (n,), not its own: a small error must not weigh more."""
    total = np.concatenate([[0.0], np.cumsum(error**2)])

    def within(span: float) -> tuple[Floats, Floats]:
        low = np.searchsorted(t_s, t_s - span)
        high = np.searchsorted(t_s, t_s + span, side="right")
        return total[high] - total[low], (high - low).astype(np.float64)

    (squares, count), (near, own) = within(_AROUND_S), within(_NEAR_S)
    alone = count == own
    around = np.sqrt(np.where(alone, squares / count, (squares - near) / np.where(alone, 1.0, count - own)))
    return np.maximum(around, np.quantile(around, _QUIET))


FEWEST = 4
_AGREE_RAD = np.radians(8.0)  # a sensor before its calibration, and a hand that lays it down
_GUESS_RAD = np.radians(12.0)
_MOST_PAIRS = 600
_APART = 0.3  # sine of the least angle between two poses that are to give the turn


@value_class
class StatedAttitudes:
    """How stated and shown directions agree.

    Attributes
    ----------
    turn : (3, 3) sensor axes from the axes of the jig; a reflection where one of the two is left-handed
    angle_rad : (n,) between shown and stated direction
    wrong : (n,) bool, stated wrongly
    guess : (n,) what of each wrong one would fit, such as "y and z swapped", or ""
    sigma_rad : how exactly the attitudes were set, about each axis, as the fit finds it; nan before it
    """

    turn: Floats
    angle_rad: Floats
    wrong: Booleans
    guess: tuple[str, ...]
    sigma_rad: float = float("nan")

    @property
    def mirrored(self) -> bool:
        """Whether the jig's axes are left-handed, seen from the sensor's."""
        return bool(np.linalg.det(self.turn) < 0)


def rough_directions(measured: Floats, unit_si: float | None) -> Floats:
    """Return the directions (n, 3) that an accelerometer shows before its calibration, good to some degrees.

    Parameters
    ----------
    measured : (n, 3) means [unit]
    unit_si : one unit in m/s^2; None for counts, whose zero and scale are taken from their range
    """
    force = measured
    if unit_si is None:
        low, high = measured.min(axis=0), measured.max(axis=0)
        force = (measured - 0.5 * (low + high)) / np.where(high > low, high - low, 1.0)
    length = np.linalg.norm(force, axis=1, keepdims=True)
    return force / np.where(length > 0, length, 1.0)


def compare_attitudes(shown: Floats, stated: Floats) -> StatedAttitudes:
    """Find the turn between sensor and jig that most attitudes agree with, and those that do not.

    Parameters
    ----------
    shown : (n, 3) unit vectors, sensor axes, good to some degrees
    stated : (n, 3) unit vectors, axes of the jig
    """
    turn, agree = _most_agreed(shown, stated)
    for _ in range(3 if agree.any() else 0):
        turn = _nearest((shown[agree].T @ stated[agree])[None], float(np.sign(np.linalg.det(turn))))[0]
        agree = _angles(shown, stated @ turn.T) < _AGREE_RAD
        if not agree.any():
            break
    angle = _angles(shown, stated @ turn.T)
    usual = float(np.median(angle))
    wrong = angle > max(2 * _AGREE_RAD, 5 * usual)
    guess = tuple(_guess(shown[k] @ turn, stated[k]) if wrong[k] else "" for k in range(len(shown)))
    return StatedAttitudes(turn=turn, angle_rad=angle, wrong=wrong, guess=guess)


def _most_agreed(shown: Floats, stated: Floats) -> tuple[Floats, Booleans]:
    """Return the turn by two poses with which most others agree; a reflection has to be better, not as good."""
    first, second = np.triu_indices(len(shown), 1)
    apart = np.linalg.norm(np.cross(stated[first], stated[second]), axis=1) > _APART
    first, second = first[apart], second[apart]
    step = max(1, len(first) // _MOST_PAIRS)
    first, second = first[::step], second[::step]
    if not len(first):
        return np.eye(3), np.zeros(len(shown), dtype=bool)
    both = shown[first, :, None] * stated[first, None, :] + shown[second, :, None] * stated[second, None, :]
    turns = np.concatenate([_nearest(both, 1.0), _nearest(both, -1.0)])
    cosine = np.einsum("ni,pij,nj->pn", shown, turns, stated)
    angle = np.arccos(np.clip(cosine, -1.0, 1.0))
    agree = angle < _AGREE_RAD
    score = agree.sum(axis=1) - np.minimum(angle, _AGREE_RAD).mean(axis=1)
    score[len(both) :] -= 0.5
    best = int(np.argmax(score))
    return turns[best], agree[best]


def _nearest(matrices: Floats, hand: float) -> Floats:
    """Return the nearest orthogonal matrices (p, 3, 3) whose determinant is `hand`."""
    left, _, right = np.linalg.svd(matrices)
    last = hand * np.linalg.det(left @ right)
    left = left.copy()
    left[:, :, 2] *= last[:, None]
    return np.asarray(left @ right, dtype=np.float64)


def _angles(a: Floats, b: Floats) -> Floats:
    return np.arctan2(np.linalg.norm(np.cross(a, b), axis=1), np.einsum("ij,ij->i", a, b))


def _guess(shown: Floats, stated: Floats) -> str:
    """Name the exchange of axes and signs that makes a stated direction fit what was shown, in the axes of the jig."""
    best, angle = "", _GUESS_RAD
    for order in permutations(range(3)):
        for signs in product((1.0, -1.0), repeat=3):
            changed = np.array(signs) * stated[list(order)]
            found = float(_angles(shown[None], changed[None])[0])
            if found < angle - 1e-6:
                best, angle = _words(order, signs, stated), found
    return best


def _words(order: tuple[int, ...], signs: tuple[float, ...], stated: Floats) -> str:
    swapped = [
        f"{'xyz'[i]} and {'xyz'[j]} swapped" for i, j in ((0, 1), (0, 2), (1, 2)) if order[i] == j and order[j] == i
    ]
    moved = "" if order == (0, 1, 2) else swapped[0] if swapped else "the axes in another order"
    flipped = [
        axis
        for axis, sign, value in zip("xyz", signs, stated[list(order)], strict=True)
        if sign < 0 and abs(value) > 0.1
    ]
    reversed_ = f"the sign of {' and '.join(flipped)} reversed" if flipped else ""
    return " and ".join(part for part in (moved, reversed_) if part)
