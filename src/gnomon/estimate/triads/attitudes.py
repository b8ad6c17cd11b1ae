"""How a triad lies: to the vertical, by a constant angle between the two, or to attitudes that somebody stated.

**A magnetometer to an accelerometer.** With u the direction of the specific force, up at rest, and m that of the field
in the magnetometer's own frame,

    u' Q m = -sin(dip)

in every attitude, with one rotation Q and one dip (positive down). Nothing need be known of the attitudes, but they
must differ about more than one axis. The pair (-Q, -dip) fits as well: Q is taken as a rotation, which is right where
both sensors are right-handed and the accelerometer shows specific force, up at rest. A dip of the wrong sign says
otherwise. Where up is, an accelerometer tells that was turned by hand along, and how well that is known meanwhile.

**Stated attitudes** (Angrisano, Eqs. 4 to 7). The sensor lies in its jig in some way that nobody knows; but the angles
between poses are those between the stated directions. An attitude that was stated wrongly, a sign lost or two axes
swapped, stands out by tens of degrees.
"""

from itertools import permutations, product

import numpy as np

from ...frozen import value_class
from ...geometry.rotations import invert_matrix, nearest_rotation, rotation_from_rotvec, skew
from ...recording import Floats
from ...results.calibration import AccelerometerCalibration
from ...results.result import Booleans
from .triad import TriadFit, fit_triad
from .triad_problem import TriadPoses, TriadPrior
from .triad_start import near_ellipsoid
from .triad_trust import Stage, by_direction

_SAMPLE = 400  # in which the start is sought
_STEPS = 30
_AS_PREDICTED = 2.0  # spread [sigma] of a start beside which no other one is tried: no other rotation explains as much
_TUNING = 4.685  # Tukey's biweight in units of the spread
_MAD = 1.4826

_SHORTEST_S = 0.04
_NEAR_S, _AROUND_S = 0.4, 1.0
_QUIET = 0.1  # quantile of the unrest below which poses count alike

FEWEST = 4
_AGREE_RAD = np.radians(8.0)  # a sensor before its calibration, and a hand that lays it down
_GUESS_RAD = np.radians(12.0)
_MOST_PAIRS = 600
_APART = 0.3  # sine of the least angle between two poses that are to give the turn


@value_class
class DipFit:
    """The rotation and the dip.

    Attributes
    ----------
    rotation : (3, 3) Q, from the magnetometer's own frame to that of the accelerometer
    sine : u' Q m, which is -sin(dip)
    error : (n,) u' Q m - sine
    sigma : (n,) predicted sigma of it
    weight : (n,) 0 to 1, small where a pose stands out
    stage : linearised: a small rotation on the right of Q (3,), then the sine; earlier: the free parameters of the
        magnetometer, then those of the accelerometer
    """

    rotation: Floats
    sine: float
    error: Floats
    sigma: Floats
    weight: Floats
    stage: Stage

    @property
    def dip_rad(self) -> float:
        """Angle of the field below the horizontal [rad]."""
        return float(-np.arcsin(np.clip(self.sine, -1, 1)))


def fit_dip(
    up: Floats,
    field: Floats,
    sigma: Floats,
    used: Booleans,
    *,
    by_up: Floats,
    by_field: Floats,
    turn: bool = True,
) -> DipFit:
    """Fit rotation and dip, robustly.

    Parameters
    ----------
    up : (n, 3) unit vectors, frame of the accelerometer
    field : (n, 3) unit vectors, frame of the magnetometer
    sigma : (n,) of each direction, together, about either axis across it [rad]
    used : (n,) bool
    by_up, by_field : (n, 3, p) derivatives of the unit vectors by the parameters behind them
    turn : whether Q is estimated; else it is the identity
    """
    some = np.flatnonzero(used)
    some = some[:: max(1, len(some) // _SAMPLE)]
    start = _linear(up[some], field[some], sigma[some]) if turn else np.eye(3)
    found = [_minimum(up[some], field[some], sigma[some], start, turn=turn)]
    if turn and found[0][2] > _AS_PREDICTED:
        found += [_minimum(up[some], field[some], sigma[some], start, turn=True) for start in _axes()]
    rotation, _, _ = min(found, key=lambda one: one[2])
    rotation, sine, _ = _minimum(up[used], field[used], sigma[used], rotation, turn=turn)
    error, jacobian = _rows(up, field, sigma, rotation, sine)
    size = error / sigma
    spread = _spread(size[used])
    weight = np.where(used, _tukey(size / spread), 0.0)
    root = (np.sqrt(weight) / (sigma * spread))[:, None]
    # Weights that move with the residuals hold the estimate less than fixed ones would.
    held = np.sqrt(np.sum(_slope(size[used] / spread)) / np.sum(weight[used]))
    earlier = (
        np.einsum("ni,nip->np", up @ rotation, by_field) * root,
        np.einsum("ni,nip->np", field @ rotation.T, by_up) * root,
    )
    rows = (jacobian if turn else jacobian[:, 3:]) * root
    return DipFit(
        rotation=rotation,
        sine=sine,
        error=error,
        sigma=sigma * spread,
        weight=weight,
        stage=Stage(
            residual=error * root[:, 0] / held,
            jacobian=rows * held,
            covariance=np.linalg.pinv(rows.T @ rows, hermitian=True) / held**2,
            earlier=(earlier[0] * held, earlier[1] * held),
        ),
    )


def _rows(up: Floats, field: Floats, sigma: Floats, rotation: Floats, sine: float) -> tuple[Floats, Floats]:
    """Return the errors (n,) and their derivatives (n, 4) by a small rotation on the right and by the sine.

    Directions that err by sigma on either side are on the average shorter by sigma^2 along the true one.
    """
    seen, length = up @ rotation, 1 - sigma**2
    error = np.einsum("ni,ni->n", seen, field) - sine * length
    return error, np.column_stack([np.cross(field, seen), -length])


def _minimum(up: Floats, field: Floats, sigma: Floats, start: Floats, *, turn: bool) -> tuple[Floats, float, float]:
    """Return rotation, sine and spread [sigma] of the robust minimum near a start."""
    rotation, sine = start, float(np.median(np.einsum("ni,ni->n", up @ start, field)))
    for _ in range(_STEPS):
        error, jacobian = _rows(up, field, sigma, rotation, sine)
        size = error / sigma
        root = np.sqrt(_tukey(size / _spread(size))) / sigma
        a = jacobian * root[:, None] if turn else jacobian[:, 3:] * root[:, None]
        step = np.linalg.lstsq(a, -error * root, rcond=1e-12)[0]
        sine += float(step[-1])
        if turn:
            shorter = min(1.0, 0.5 / max(float(np.abs(step[:3]).max()), 1e-12))
            rotation = rotation @ rotation_from_rotvec(np.asarray(shorter * step[:3], dtype=np.float64))
        if float(np.abs(step).max()) < 1e-10:
            break
    error, _ = _rows(up, field, sigma, rotation, sine)
    return rotation, sine, _spread(error / sigma)


def _spread(size: Floats) -> float:
    return max(_MAD * float(np.median(np.abs(size))), 1e-9)


def _tukey(size: Floats) -> Floats:
    return np.where(np.abs(size) < _TUNING, (1 - (size / _TUNING) ** 2) ** 2, 0.0)


def _slope(size: Floats) -> Floats:
    """Return the derivative of size times weight, (n,)."""
    ratio = (size / _TUNING) ** 2
    return np.where(ratio < 1, (1 - ratio) * (1 - 5 * ratio), 0.0)


def _linear(up: Floats, field: Floats, sigma: Floats) -> Floats:
    """Return the rotation nearest to the matrix of least squares, u' A m = constant."""
    rows = np.column_stack([np.einsum("ni,nj->nij", up, field).reshape(-1, 9), -np.ones(len(up))]) / sigma[:, None]
    a = np.linalg.svd(rows, full_matrices=False)[2][-1][:9].reshape(3, 3)
    return nearest_rotation(a * np.sign(np.linalg.det(a) or 1.0))


def _axes() -> list[Floats]:
    """Return the 24 rotations that bring axes to axes."""
    found: list[Floats] = []
    for i in range(3):
        for j in range(3):
            for signs in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
                if i != j:
                    x, y = signs[0] * np.eye(3)[i], signs[1] * np.eye(3)[j]
                    found.append(np.stack([x, y, np.cross(x, y)]))
    return found


def in_body_frame(sensitivity: Floats, rotation: Floats) -> tuple[Floats, Floats]:
    """Return the sensitivity (3, 3) in the accelerometer's frame, and its derivatives (9, 12).

    The derivatives are by the sensitivity in the own frame (row order) and by a small rotation on the right of Q.
    """
    jacobian = np.zeros((9, 12))
    jacobian[:, :9] = np.kron(np.eye(3), rotation)
    for axis in range(3):
        jacobian[:, 9 + axis] = -(sensitivity @ skew(np.eye(3)[axis]) @ rotation.T).ravel()
    return sensitivity @ rotation.T, jacobian


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
