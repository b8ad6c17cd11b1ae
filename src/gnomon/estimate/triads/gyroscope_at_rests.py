"""A gyroscope from few rests: its sensitivity by the rotations between, its g-sensitivity by the attitudes.

**Rotations.** Nine attitudes calibrate accelerometer and gyroscope together (`estimate.multiposition`). With fewer,
gravity's direction u_k in each rest is that of the accelerometer's own fit, and each rotation says

    u_{k+1} = R_k' u_k,   omega = C (y - b_k),   C = inv(S)

with the rotation R_k integrated from all samples between the rests (Tedaldi et al. 2014, Eqs. 7 to 10) and the bias b_k
the mean of the rests before and after. A turn by 360 deg about a level axis, from rest to rest as in Ferraris et al.
(1995), ends where it began: it fixes the scale to what the directions are known to over two pi. Gravity shows the angle
up to whole turns; the number of turns is that of the integrated rate, which is unambiguous as long as the scale is
known beforehand to half a turn over the angle: by the unit of the samples (3 %), angles up to sixteen turns. About the
vertical gravity shows no angle.

**Attitudes** (Krebs, section 5.2, the static experiment). At rest a gyroscope shows, in pose k at time t_k,

    measured_k = bias + drift(t_k) + g_sensitivity @ force_k + noise_k

which is linear in what is sought. The document adjusts g_sensitivity until opposite attitudes agree; that is the
least squares solution without drift. Here the drift is a straight line plus a random walk, and what the means scatter
beyond the noise within the rests is white. How large walk and scatter are is read from the residuals: the answer is the
average over all sizes, each weighed by how well it explains them, so that few poses give an honest sigma.
"""

import numpy as np

from ...errors import InitialisationError
from ...frozen import value_class
from ...geometry.rotations import invert_matrix, skew, tangent_basis
from ...recording import Floats, Integers, frozen_array
from ...results.result import Booleans
from ..multiposition.measurements import MotionSegments, integrate_rates, propagate_directions

_ROUNDS = 15
_OUTLYING = 4.0  # sigma of a rotation beyond which it counts by its size, not by its square
_LEAST_TURN_RAD = 0.17
_KNOWN = 0.5  # sigma after over sigma before from which on a scale is measured

FEWEST_POSES = 6
_ON_THEIR_OWN = 12  # poses from which each axis tells its own scatter; of fewer the axes are taken together
_SIZES = np.array([0.0, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0, 128.0])
"""Tried for the scatter of a mean, and for the step of the walk between two poses, in units of the noise of a mean."""
_RARITY = 3.0
_LEAST_SINE = 0.1  # of the spread of the attitudes along the axis that they cover least
_LEAST_APART = 0.03  # of drift and g-sensitivity


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


@value_class
class RestingRates:
    """What a gyroscope showed in n poses.

    Attributes
    ----------
    measured : (n, 3) means [unit], the rate of the Earth taken off as far as it is known
    variance : (n, 3) of these means by noise, and by what is not known of the Earth's rate [unit^2]; zero where nothing
        tells the noise, which then comes from the residuals
    force : (n, 3) specific force, body frame [m/s^2]
    t_s : (n,) middle of each rest, rising [s]
    """

    measured: Floats
    variance: Floats
    force: Floats
    t_s: Floats

    def __post_init__(self) -> None:
        for name in ("measured", "variance", "force", "t_s"):
            object.__setattr__(self, name, frozen_array(getattr(self, name)))


@value_class
class StaticGSensitivity:
    """What the rests say.

    Attributes
    ----------
    bias : (3,) mean over the poses [unit]
    g_sensitivity : (3, 3) [unit per m/s^2], gyroscope axes by body axes; zero where it was not asked for
    covariance : (12, 12) of bias, then g-sensitivity in row order
    gain : (3, 4, n) derivatives of each axis' bias and row of g-sensitivity by its measurements, scatter as found
    drift : (n, 3) estimated drift of the bias, mean 0 [unit]
    predicted : (n, 3) bias + drift + g_sensitivity @ force [unit]
    holdout : (n, 3) measured minus what the other poses predict [unit]
    extra_sigma : (3,) scatter of the means beyond their noise, white and walk between two poses together [unit]
    degrees_of_freedom : poses less parameters, of each axis
    """

    bias: Floats
    g_sensitivity: Floats
    covariance: Floats
    gain: Floats
    drift: Floats
    predicted: Floats
    holdout: Floats
    extra_sigma: Floats
    degrees_of_freedom: int


@value_class
class _Axis:
    """One axis, averaged over all sizes of scatter and walk; p parameters: bias, g-sensitivity, drift."""

    theta: Floats
    covariance: Floats
    gain: Floats
    walk: Floats
    holdout: Floats
    extra: float


@value_class
class _Trials:
    """Generalised least squares of one axis at g sizes of scatter and walk."""

    log_evidence: Floats
    theta: Floats
    covariance: Floats
    gain: Floats
    walk: Floats
    holdout: Floats
    extra: Floats

    def averaged(self, weight: Floats) -> _Axis:
        """Return the mean over the sizes; the covariance includes how far they differ."""
        theta = weight @ self.theta
        apart = self.theta - theta
        return _Axis(
            theta=theta,
            covariance=np.einsum("g,gij->ij", weight, self.covariance) + (weight[:, None] * apart).T @ apart,
            gain=np.einsum("g,gij->ij", weight, self.gain),
            walk=weight @ self.walk,
            holdout=weight @ self.holdout,
            extra=float(np.sqrt(weight @ self.extra**2)),
        )


def fit_static_g_sensitivity(rates: RestingRates, *, g_sensitivity: bool = True) -> StaticGSensitivity:
    """Fit bias, drift and g-sensitivity to a gyroscope at rest.

    Parameters
    ----------
    rates : means in each pose
    g_sensitivity : whether the bias depends on the specific force

    Raises
    ------
    InitialisationError
        If there are too few poses, or their attitudes leave the g-sensitivity open.
    """
    n = len(rates.measured)
    time = _unit_time(rates.t_s)
    columns = [np.ones(n), *(rates.force.T if g_sensitivity else ()), *([time] if time.any() else ())]
    design = np.column_stack(columns)
    _require(rates, design, g_sensitivity)
    variance = rates.variance if rates.variance.any() else _variance_of_residuals(design, rates.measured)
    trials = [_tried(design, rates.measured[:, axis], variance[:, axis], time) for axis in range(3)]
    evidence = np.array([trial.log_evidence for trial in trials])
    if n < _ON_THEIR_OWN:
        evidence[:] = evidence.sum(axis=0)
    log_weight = evidence + _log_prior()
    weight = np.exp(log_weight - log_weight.max(axis=1, keepdims=True))
    axes = [trial.averaged(w / w.sum()) for trial, w in zip(trials, weight, strict=True)]
    return _joined(rates, design, axes, g_sensitivity=g_sensitivity)


def _require(rates: RestingRates, design: Floats, g_sensitivity: bool) -> None:
    n = len(rates.measured)
    if n < FEWEST_POSES:
        raise InitialisationError(
            f"{n} poses do not determine the gyroscope's g-sensitivity and its drift: at least {FEWEST_POSES} are "
            "needed. Lay the sensor down with every axis up once and down once, and the first attitude again at last."
        )
    if not g_sensitivity:
        return
    spread = np.linalg.svd(rates.force - rates.force.mean(axis=0), compute_uv=False) / np.sqrt(n)
    if spread[-1] < _LEAST_SINE * np.linalg.norm(rates.force, axis=1).mean():
        raise InitialisationError(
            "the attitudes of the poses leave the gyroscope's g-sensitivity open: gravity hardly changes along one "
            "axis. Lay the sensor down with every axis up once and down once."
        )
    if np.linalg.svd(design / np.linalg.norm(design, axis=0), compute_uv=False)[-1] < _LEAST_APART:
        raise InitialisationError(
            "in the order of these attitudes a drift of the gyroscope looks like g-sensitivity. "
            "Repeat the first attitude at the end, or change the order."
        )


def _unit_time(t_s: Floats) -> Floats:
    """Return times with mean 0 and a span of 1; zero where there is none."""
    span = float(np.ptp(t_s))
    return (t_s - t_s.mean()) / span if span > 0 else np.zeros(len(t_s))


def _variance_of_residuals(design: Floats, measured: Floats) -> Floats:
    """Return the variance (n, 3) that least squares leave, enlarged for how few residuals tell it (Student's t)."""
    n, p = design.shape
    left = measured - design @ np.linalg.lstsq(design, measured, rcond=None)[0]
    degrees = 3 * (n - p)
    size = float(np.sum(left**2)) / max(degrees - 2, 1)
    return np.full((n, 3), max(size, np.finfo(float).tiny))


def _walk_covariance(time: Floats) -> Floats:
    """Return the covariance (n, n) of a random walk less its mean, with a variance of 1 between two usual poses."""
    since = time - time.min()
    steps = np.minimum.outer(since, since) * (len(time) - 1)
    centred = steps - steps.mean(axis=0)
    return centred - centred.mean(axis=1, keepdims=True)


def _sizes() -> tuple[Floats, Floats]:
    """Return scatter and step of the walk of all trials, (g,) each."""
    white, step = np.meshgrid(_SIZES, _SIZES, indexing="ij")
    return white.ravel(), step.ravel()


def _log_prior() -> Floats:
    """Return the logarithm of how likely each size is beforehand: mostly, the noise at rest is all there is."""
    white, step = _sizes()
    return -_RARITY * (np.log1p(white) + np.log1p(step))


def _tried(design: Floats, y: Floats, variance: Floats, time: Floats) -> _Trials:
    """Return generalised least squares of one axis, and its restricted likelihood, at all sizes."""
    unit = np.sqrt(max(float(variance.mean()), np.finfo(float).tiny))
    white, step = _sizes()
    walk = _walk_covariance(time)
    V = (variance / unit**2 + white[:, None] ** 2)[:, None, :] * np.eye(len(y)) + (step**2)[:, None, None] * walk
    root = np.linalg.cholesky(V)
    inverse = np.linalg.inv(root)
    precision = np.swapaxes(inverse, 1, 2) @ inverse
    size = np.linalg.norm(design, axis=0)
    information = (design / size).T @ precision @ (design / size)
    unscaled = np.linalg.inv(information) / np.outer(size, size)
    gain = unscaled @ design.T @ precision
    theta = gain @ y
    weighted = np.einsum("gij,gj->gi", precision, y - theta @ design.T) / unit**2
    projected = precision - np.swapaxes(gain, 1, 2) @ design.T @ precision  # of the weighted residuals, by y
    return _Trials(
        log_evidence=-np.sum(np.log(np.diagonal(root, axis1=1, axis2=2)), axis=1)
        - 0.5 * np.linalg.slogdet(information)[1]
        - 0.5 * np.einsum("gi,gi->g", y - theta @ design.T, weighted),
        theta=theta,
        covariance=unit**2 * unscaled,
        gain=gain,
        walk=(step * unit)[:, None] ** 2 * weighted @ walk,
        holdout=weighted * unit**2 / np.maximum(np.diagonal(projected, axis1=1, axis2=2), np.finfo(float).tiny),
        extra=unit * np.hypot(white, step),
    )


def _joined(rates: RestingRates, design: Floats, axes: list[_Axis], *, g_sensitivity: bool) -> StaticGSensitivity:
    n = len(design)
    count = 4 if g_sensitivity else 1  # of bias and g-sensitivity; the drift is behind them
    theta, covariance, gain = np.zeros((3, 4)), np.zeros((12, 12)), np.zeros((3, 4, n))
    for axis, fit in enumerate(axes):
        rows = [axis, *range(3 + 3 * axis, 6 + 3 * axis)][:count]
        covariance[np.ix_(rows, rows)] = fit.covariance[:count, :count]
        gain[axis, :count] = fit.gain[:count]
        theta[axis, :count] = fit.theta[:count]
    drift = np.column_stack([design[:, count:] @ fit.theta[count:] + fit.walk for fit in axes])
    return StaticGSensitivity(
        bias=theta[:, 0],
        g_sensitivity=theta[:, 1:],
        covariance=covariance,
        gain=gain,
        drift=drift,
        predicted=theta[:, 0] + drift + rates.force @ theta[:, 1:].T,
        holdout=np.column_stack([fit.holdout for fit in axes]),
        extra_sigma=np.array([fit.extra for fit in axes]),
        degrees_of_freedom=n - design.shape[1],
    )
