"""A gyroscope's sensitivity from the rotations between a few rests, whose accelerometer is calibrated already.

Nine attitudes calibrate accelerometer and gyroscope together (`estimate.multiposition`). With fewer, gravity's
direction u_k in each rest is that of the accelerometer's own fit, and each rotation says

    u_{k+1} = R_k' u_k,   omega = C (y - b_k),   C = inv(S)

with the rotation R_k integrated from all samples between the rests (Tedaldi et al. 2014, Eqs. 7 to 10) and the bias b_k
the mean of the rests before and after. A turn by 360 deg about a level axis, from rest to rest as in Ferraris et al.
(1995), ends where it began: it fixes the scale to what the directions are known to over two pi. Gravity shows the angle
up to whole turns; the number of turns is that of the integrated rate, which is unambiguous as long as the scale is
known beforehand to half a turn over the angle: by the unit of the samples (3 %), angles up to sixteen turns. About the
vertical gravity shows no angle.
"""

import numpy as np

from ...frozen import value_class
from ...geometry.rotation_vector import invert_matrix, skew, tangent_basis
from ...recording import Floats, Integers
from ...results.result import Booleans
from ..multiposition.measurements import MotionSegments, integrate_rates, propagate_directions

_ROUNDS = 15
_OUTLYING = 4.0  # sigma of a rotation beyond which it counts by its size, not by its square
_LEAST_TURN_RAD = 0.17
_KNOWN = 0.5  # sigma after over sigma before from which on a scale is measured


@value_class
class RestRotations:
    """Rotations between consecutive rests.

    Attributes
    ----------
    segments : gyroscope in its unit, time steps
    first : (m,) index of the rest before each, the one after it is `first + 1`
    bias : (m, 3) mean of the gyroscope in both [unit]
    variance : (m, 3) of the integrated rate by noise [unit^2 s^2]
    reason : (m,) why a rotation cannot be used, or ""
    """

    segments: MotionSegments
    first: Integers
    bias: Floats
    variance: Floats
    reason: tuple[str, ...]


@value_class
class RotationSensitivity:
    """What rotations say of a gyroscope's sensitivity.

    Attributes
    ----------
    sensitivity, covariance : (3, 3) [unit per rad/s], (9, 9) of its elements in row order
    measured : (3,) axes whose scale comes from the rotations rather than from what was assumed
    angle_rad : (m,) angle of each rotation by it
    vertical : (m,) rotations about the vertical, of which gravity shows no angle
    rms_rad : of the rotations' errors
    used : (m,)
    """

    sensitivity: Floats
    covariance: Floats
    measured: Booleans
    angle_rad: Floats
    vertical: Booleans
    rms_rad: float
    used: Booleans


def fit_rotation_sensitivity(
    rotations: RestRotations,
    up: Floats,
    up_by_accelerometer: Floats,
    accelerometer_covariance: Floats,
    beforehand: tuple[Floats, Floats],
) -> RotationSensitivity:
    """Return the gyroscope's sensitivity by the rotations between rests, and by what was known of it beforehand.

    Parameters
    ----------
    rotations : m of them between n rests
    up : (n, 3) direction of gravity's reaction in each rest, unit vectors
    up_by_accelerometer : (n, 3, q) its derivative by the q parameters of the accelerometer
    accelerometer_covariance : (q, q)
    beforehand : (3, 3) sensitivity [unit per rad/s] and (9, 9) its covariance
    """
    start, prior = beforehand
    correction = nominal = invert_matrix(start)  # C of the module's head
    to_C = -np.kron(nominal, nominal.T)
    information = np.linalg.inv(to_C @ prior @ to_C.T)
    k = rotations.first
    basis = tangent_basis(up[k + 1])
    usable = np.array([not why for why in rotations.reason], dtype=bool)
    weight = np.where(usable, 1.0, 0.0)
    rate = rotations.segments.gyroscope - np.repeat(rotations.bias, rotations.segments.lengths, axis=0)
    extra, rounds = 0.0, 0
    while True:
        residual, rows, back = _residuals(rotations, rate, up, basis, correction)
        noise = rotations.variance @ (correction**2).sum(axis=0) / 3 + extra
        white = weight / np.sqrt(np.maximum(noise, 1e-12))
        A, r = (white[:, None, None] * rows).reshape(-1, 9), (white[:, None] * residual).ravel()
        normal = A.T @ A + information
        step = np.linalg.solve(normal, -A.T @ r - information @ (correction - nominal).ravel())
        correction = correction + step.reshape(3, 3)
        left = residual + rows @ step
        freedom = max(2 * float(weight.sum()) - 9 + float(np.trace(np.linalg.solve(normal, information))), 1.0)
        squares = np.sum(left**2, axis=1)
        extra = max(float(np.sum(weight**2 * squares)) / freedom - float(np.mean(noise - extra)), 0.0)
        size = np.sqrt(squares / 2 / np.maximum(noise - 0.5 * extra, 1e-12))
        usual = max(float(np.median(size[usable])), 1.0)
        weight = np.where(usable, np.sqrt(np.minimum(_OUTLYING * usual / np.maximum(size, 1e-9), 1.0)), 0.0)
        rounds += 1
        if np.max(np.abs(step)) < 1e-9 * np.abs(correction).max() or rounds == _ROUNDS:
            break
    by_up = np.einsum("kij,kiq->kjq", basis, up_by_accelerometer[k + 1]) - np.einsum(
        "kib,kbq->kiq", back, up_by_accelerometer[k]
    )
    moved = -np.linalg.solve(normal, A.T @ (white[:, None, None] * by_up).reshape(-1, by_up.shape[2]))
    covariance = np.linalg.inv(normal) + moved @ accelerometer_covariance @ moved.T
    S = invert_matrix(correction)
    to_S = -np.kron(S, S.T)
    angle, vertical = _turns(rotations, rate @ correction.T, up[k])
    covariance = to_S @ covariance @ to_S.T
    return RotationSensitivity(
        sensitivity=S,
        covariance=0.5 * (covariance + covariance.T),
        measured=np.sqrt(np.diag(covariance)[[0, 4, 8]]) < _KNOWN * np.sqrt(np.diag(prior)[[0, 4, 8]]),
        angle_rad=angle,
        vertical=vertical & usable,
        rms_rad=float(np.sqrt(np.mean(squares[usable]))),
        used=usable & (weight > 0.5),
    )


def _residuals(
    rotations: RestRotations, rate: Floats, up: Floats, basis: Floats, correction: Floats
) -> tuple[Floats, Floats, Floats]:
    """Return errors of directions (m, 2), their derivatives by C (m, 2, 9), and the basis before the turn (m, 2, 3)."""
    k = rotations.first
    regressors = np.concatenate([rate, np.zeros((len(rate), 4))], axis=1)
    turns = integrate_rates(rotations.segments, rate @ correction.T, regressors)
    back = np.einsum("kai,kab->kib", basis, np.swapaxes(turns.rotation, 1, 2))
    residual = np.einsum("kij,ki->kj", basis, up[k + 1] - propagate_directions(turns.rotation, up[k]))
    turned = -np.einsum("kib,kbl->kil", back, skew(up[k]))
    rows = np.einsum("kil,klac->kiac", turned, turns.sensitivity)[..., :3].reshape(len(k), 2, 9)
    return residual, rows, back


def _turns(rotations: RestRotations, omega: Floats, up: Floats) -> tuple[Floats, Booleans]:
    """Return the angle (m,) that each turn went through, whole turns included, and which were about the vertical."""
    first, dt = rotations.segments.first, rotations.segments.dt_s[:, None]
    total = np.add.reduceat(omega * dt, first)
    path = np.add.reduceat(np.linalg.norm(omega, axis=1) * dt[:, 0], first)
    angle = np.linalg.norm(total, axis=1)
    along = np.abs(np.einsum("ki,ki->k", total, up)) / np.maximum(angle, 1e-9)
    steady = angle > 0.9 * path  # one axis throughout
    return np.where(steady, angle, path), steady & (along > 0.98) & (angle > _LEAST_TURN_RAD)
