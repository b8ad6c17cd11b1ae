"""The multi-position problem: what static intervals and the rotations between them say, linearised.

Beyond Tedaldi there is one latent direction of gravity u_k per static interval (a unit vector in the body frame), so
that the noise of an interval is counted once although both neighbouring rotations use it, and a gyroscope bias that
depends on the specific force as in Krebs, chapter 3. In units of gravity for the specific force:

    accelerometer at rest    x_k = S u_k + b                          S lower triangular (frame accel-x)
    gyroscope at rest        y_k = b_g + G u_k
    gyroscope in motion      omega = C_g (y - b_g - G f),  f = inv(S) (x - b)
    rotation k               u_{k+1} = R_k' u_k,  R_k integrated from omega

A bias that changes is b, or b_g, plus functions of time: hat functions with a random walk for their prior (b_g is then
the mean), a straight line, an exponential as of a sensor that warms up, and steps between segments of the recording (b
is then that of one segment). What an accelerometer's bias does matters at rest alone.
"""

import numpy as np

from ...frozen import value_class
from ...geometry.rotations import skew, tangent_basis
from ...recording import Floats, Integers
from ...solve.least_squares import ArrowSystem, column_products
from .bias_changes import RestMeans
from .measurements import MotionSegments, integrate_rates, propagate_directions

LOWER = np.tril_indices(3)
PARAMETERS = 30
"""S (6, lower triangle in row order), b (3), C_g (9), b_g (3), G (9). The knots of a drift follow, 3 each, and where
there is one the accelerometer's drift (3)."""
S_, B_, CG_, BG_, G_ = slice(0, 6), slice(6, 9), slice(9, 18), slice(18, 21), slice(21, 30)


@value_class
class BiasFunctions:
    """Functions of time that a bias follows beside its constant; each has three coefficients.

    Attributes
    ----------
    at_rest : (n, j) their means over the static intervals
    in_motion : (n - 1, j) their values in the rotations
    kind : (j,) of each: "walk" (hat functions, which come first), "line", "warm-up", "temperature", "warming" (its
        rate) and "curve" (its higher powers), "step", or "single" (one interval)
    sigma : (j, 3) standard deviation of the coefficients beforehand, scaled units; not used for a walk
    """

    at_rest: Floats
    in_motion: Floats
    kind: tuple[str, ...]
    sigma: Floats

    @classmethod
    def none(cls, n: int) -> "BiasFunctions":
        """Return no function, for n static intervals."""
        return cls(at_rest=np.empty((n, 0)), in_motion=np.empty((max(n - 1, 0), 0)), kind=(), sigma=np.empty((0, 3)))

    def beside(self, other: "BiasFunctions") -> "BiasFunctions":
        """Return these functions and others behind them."""
        return BiasFunctions(
            at_rest=np.concatenate([self.at_rest, other.at_rest], axis=1),
            in_motion=np.concatenate([self.in_motion, other.in_motion], axis=1),
            kind=self.kind + other.kind,
            sigma=np.concatenate([self.sigma, other.sigma]),
        )

    def of_kind(self, *kinds: str) -> np.ndarray:
        """Return which functions are of some kinds, (j,)."""
        return np.array([kind in kinds for kind in self.kind], dtype=bool)


@value_class
class MultiPositionData:
    """Means of n static intervals and samples of the n - 1 rotations between them, in scaled sensor units.

    Attributes
    ----------
    accelerometer, gyroscope : (n, 3) means
    accelerometer_variance, gyroscope_variance : (n, 3) variances of the means by the noise at rest
    segments : the rotations
    rotation_variance : (n - 1, 3) variance of the integrated rate of each gyroscope axis by the noise at rest
    linked : (n - 1,) bool, whether a rotation may be used
    interval_s, rotation_s : (n,), (n - 1,) middle of each static interval and of each rotation [s]
    span_s : start of the first and end of the last static interval [s]
    earth_rate_variance : variance per axis of the part of the earth's rate that is not modelled [(rad/s)^2]
    sampling_variance : variance of each rotation per axis by motion between samples, see noise_levels.py [rad^2]
    half_s : (n,) half of the length of each static interval [s], or None
    rests : means of the accelerometer and the gyroscope at rest, long static intervals in parts; None where the biases
        of other instants are not looked for
    gyroscope_functions, accelerometer_functions : what the biases follow in time; None where they are constant
    degc : (n, k), (n - 1, k) temperature above a reference [K], its rate [K/s] and higher powers at rest and in motion;
        None where nothing tells its effect from that of the time
    """

    accelerometer: Floats
    gyroscope: Floats
    accelerometer_variance: Floats
    gyroscope_variance: Floats
    segments: MotionSegments
    rotation_variance: Floats
    linked: np.ndarray
    interval_s: Floats
    rotation_s: Floats
    span_s: tuple[float, float]
    earth_rate_variance: float = 0.0
    sampling_variance: float = 0.0
    half_s: Floats | None = None
    rests: tuple[RestMeans, RestMeans] | None = None
    gyroscope_functions: BiasFunctions | None = None
    accelerometer_functions: BiasFunctions | None = None
    degc: tuple[Floats, Floats] | None = None

    @property
    def of_gyroscope(self) -> BiasFunctions:
        """What the gyroscope's bias follows in time."""
        return self.gyroscope_functions or BiasFunctions.none(len(self.accelerometer))

    @property
    def of_accelerometer(self) -> BiasFunctions:
        """What the accelerometer's bias follows in time."""
        return self.accelerometer_functions or BiasFunctions.none(len(self.accelerometer))

    @property
    def drift(self) -> tuple[Floats, Floats]:
        """Values of the gyroscope's functions of time at rest and in motion, (n, j) and (n - 1, j)."""
        return self.of_gyroscope.at_rest, self.of_gyroscope.in_motion

    @property
    def trend(self) -> Floats:
        """Values of the accelerometer's functions of time at rest, (n, q)."""
        return self.of_accelerometer.at_rest

    @property
    def drifting(self) -> int:
        """Number j + q of the functions of time in both biases."""
        return self.drift[0].shape[1] + self.trend.shape[1]


@value_class
class MultiPositionState:
    """A point in the space of unknowns: parameters theta (30 + 3 j,) and directions u (n, 3)."""

    theta: Floats
    u: Floats

    @property
    def matrices(self) -> tuple[Floats, Floats, Floats, Floats, Floats]:
        """S (3, 3), b (3,), C_g (3, 3), b_g (3,), G (3, 3)."""
        sensitivity = np.zeros((3, 3))
        sensitivity[LOWER] = self.theta[S_]
        return (
            sensitivity,
            self.theta[B_],
            self.theta[CG_].reshape(3, 3),
            self.theta[BG_],
            self.theta[G_].reshape(3, 3),
        )

    @property
    def knots(self) -> Floats:
        """Values of the gyroscope's drift at its knots, then the accelerometer's drift, (j + q, 3)."""
        return self.theta[PARAMETERS:].reshape(-1, 3)

    def moved(self, d_theta: Floats, d_u: Floats) -> "MultiPositionState":
        """Return the state after a step; d_u (n, 2) in the tangent planes of u."""
        u = self.u + np.einsum("kij,kj->ki", tangent_basis(self.u), d_u)
        return MultiPositionState(theta=self.theta + d_theta, u=u / np.linalg.norm(u, axis=1, keepdims=True))


@value_class
class MultiPositionLinearization:
    """Residuals, not yet divided by their sigma, and their derivatives.

    Attributes
    ----------
    accelerometer, gyroscope : (n, 3) residuals at rest
    rotation : (n - 1, 2) residuals of the rotations, in the tangent plane of the second direction [rad]
    accelerometer_u, gyroscope_u : (n, 3, 2) derivatives by the interval's direction
    rotation_u : (n - 1, 2, 2) by the first direction; the one by the second is the identity
    accelerometer_theta, gyroscope_theta : (n, 3, 30 + 3 j)
    rotation_theta : (n - 1, 2, 30 + 3 j)
    propagated : (n - 1, 3) R_k' u_k
    """

    accelerometer: Floats
    gyroscope: Floats
    rotation: Floats
    accelerometer_u: Floats
    gyroscope_u: Floats
    rotation_u: Floats
    accelerometer_theta: Floats
    gyroscope_theta: Floats
    rotation_theta: Floats
    propagated: Floats

    def extrapolated(self, d_theta: Floats, d_u: Floats) -> "MultiPositionLinearization":
        """Return the residuals after a small step without integrating again; derivatives stay."""
        return MultiPositionLinearization(
            accelerometer=self.accelerometer
            + self.accelerometer_theta @ d_theta
            + np.einsum("kij,kj->ki", self.accelerometer_u, d_u),
            gyroscope=self.gyroscope + self.gyroscope_theta @ d_theta + np.einsum("kij,kj->ki", self.gyroscope_u, d_u),
            rotation=self.rotation
            + self.rotation_theta @ d_theta
            + np.einsum("kij,kj->ki", self.rotation_u, d_u[:-1])
            + d_u[1:],
            accelerometer_u=self.accelerometer_u,
            gyroscope_u=self.gyroscope_u,
            rotation_u=self.rotation_u,
            accelerometer_theta=self.accelerometer_theta,
            gyroscope_theta=self.gyroscope_theta,
            rotation_theta=self.rotation_theta,
            propagated=self.propagated,
        )


@value_class
class Whitening:
    """Inverse square roots of the residuals' covariances; zero switches a residual off.

    Attributes
    ----------
    accelerometer, gyroscope : (n, 3, 3)
    rotation : (n - 1,) [1/rad]
    prior : (30 + 3 j,) * 2, precision of the weak prior and of the drift's random walk
    """

    accelerometer: Floats
    gyroscope: Floats
    rotation: Floats
    prior: Floats


def linearize_model(data: MultiPositionData, state: MultiPositionState) -> MultiPositionLinearization:
    """Return residuals (observed minus predicted at rest; second minus propagated direction) and derivatives."""
    s, b, _, b_g, g = state.matrices
    u, n, p = state.u, len(state.u), len(state.theta)
    basis = tangent_basis(u)
    (hats, _), trend = data.drift, data.trend
    wandering, drifting = np.split(state.knots, [hats.shape[1]])
    accelerometer_theta = np.zeros((n, 3, p))
    for column, (i, j) in enumerate(zip(*LOWER, strict=True)):
        accelerometer_theta[:, i, column] = -u[:, j]
    accelerometer_theta[:, :, B_] = -np.eye(3)
    accelerometer_theta[:, :, p - drifting.size :] = -np.einsum("ij,kc->kicj", np.eye(3), trend).reshape(n, 3, -1)
    gyroscope_theta = np.zeros((n, 3, p))
    gyroscope_theta[:, :, BG_] = -np.eye(3)
    gyroscope_theta[:, :, G_] = -np.einsum("ij,kc->kijc", np.eye(3), u).reshape(n, 3, 9)
    gyroscope_theta[:, :, PARAMETERS : p - drifting.size] = -np.einsum("ij,kc->kicj", np.eye(3), hats).reshape(n, 3, -1)
    propagated, rotation_u, rotation_theta = _rotations(data, state, basis)
    return MultiPositionLinearization(
        accelerometer=data.accelerometer - u @ s.T - b - trend @ drifting,
        gyroscope=data.gyroscope - u @ g.T - b_g - hats @ wandering,
        rotation=np.einsum("kij,ki->kj", basis[1:], u[1:] - propagated),
        accelerometer_u=-s @ basis,
        gyroscope_u=-g @ basis,
        rotation_u=rotation_u,
        accelerometer_theta=accelerometer_theta,
        gyroscope_theta=gyroscope_theta,
        rotation_theta=rotation_theta,
        propagated=propagated,
    )


def _rotations(data: MultiPositionData, state: MultiPositionState, basis: Floats) -> tuple[Floats, Floats, Floats]:
    """Return propagated directions, and derivatives of the rotations' residuals by u_k and by theta."""
    m, (_, hats), segments = len(state.u) - 1, data.drift, data.segments
    s, b, c_g, b_g, g = state.matrices
    inverse, count = np.linalg.inv(s), hats.shape[1]
    pull = g @ inverse
    measured = np.empty((len(segments.dt_s), 7))
    measured[:, :3], measured[:, 3], measured[:, 4:] = segments.gyroscope, 1.0, segments.accelerometer
    z = np.eye(7)  # y - b_g - G f, 1 and f by what is measured; the drift comes on top
    z[:3, 3], z[:3, 4:] = pull @ b - b_g, -pull
    z[4:, 3], z[4:, 4:] = -inverse @ b, inverse
    drift = hats @ state.knots[:count]
    omega = measured @ (c_g @ z[:3]).T
    if count:
        omega -= np.repeat(drift @ c_g.T, segments.lengths, axis=0)
    turns = integrate_rates(segments, omega, measured)
    start = state.u[:-1]
    back = np.einsum("kai,kab->kib", basis[1:], np.swapaxes(turns.rotation, 1, 2))  # tangent plane <- start frame
    turned = -np.einsum("kib,kbl->kil", back, skew(start))  # residual by delta theta in the start frame
    by_c = np.einsum("kil,klac->kiac", turned, turns.sensitivity @ z.T)
    by_rate_offset, by_force = by_c[..., 3], by_c[..., 4:]
    by_c[..., :3] -= by_rate_offset[..., None] * drift[:, None, None, :]
    pull = c_g @ pull  # omega by what the accelerometer reads
    theta = np.zeros((m, 2, len(state.theta)))
    by_s = np.einsum("kiac,aj->kijc", by_force, pull)
    theta[..., S_] = by_s[:, :, LOWER[0], LOWER[1]]
    theta[..., B_] = by_rate_offset @ pull
    theta[..., CG_] = by_c[..., :3].reshape(m, 2, 9)
    theta[..., BG_] = -by_rate_offset @ c_g
    theta[..., G_] = -np.einsum("kiac,aj->kijc", by_force, c_g).reshape(m, 2, 9)
    theta[..., PARAMETERS : PARAMETERS + 3 * count] = np.einsum("kc,kij->kicj", hats, theta[..., BG_]).reshape(m, 2, -1)
    return propagate_directions(turns.rotation, start), -back @ basis[:-1], theta


def normal_equations(
    lines: MultiPositionLinearization, whitening: Whitening, from_prior: Floats, free: np.ndarray, apart: int = 0
) -> ArrowSystem:
    """Return the normal equations of the free parameters.

    Parameters
    ----------
    from_prior : (30 + 3 j,) theta minus the mean of the prior
    free : (30 + 3 j,) bool; the others stay where they are
    apart : last columns, of which each three are tried without the others; see `column_products` of the solver
    """
    n, p = len(lines.accelerometer), int(free.sum())
    diagonal, border = np.zeros((n, 2, 2)), np.zeros((n, 2, p))
    gradient = np.zeros((n, 2))
    corner = whitening.prior[np.ix_(free, free)].copy()
    corner_gradient = whitening.prior[free] @ from_prior
    rest = (
        (lines.accelerometer, lines.accelerometer_u, lines.accelerometer_theta, whitening.accelerometer),
        (lines.gyroscope, lines.gyroscope_u, lines.gyroscope_theta, whitening.gyroscope),
    )
    chosen = slice(None) if free.all() else free  # without a copy
    for residual, by_u, by_theta, whitener in rest:
        theta = by_theta[..., chosen]
        own, apart_here = _acting(theta, apart)  # most columns act on one kind of residual
        r = (whitener @ residual[..., None])[..., 0]
        ju, jt = whitener @ by_u, whitener @ theta.take(own, axis=2)
        jut = np.swapaxes(ju, 1, 2)
        diagonal += jut @ ju
        border[..., own] += jut @ jt
        gradient += (jut @ r[..., None])[..., 0]
        flat = jt.reshape(-1, len(own))
        corner[np.ix_(own, own)] += column_products(flat, flat, apart_here)
        corner_gradient[own] += flat.T @ r.ravel()
    w = whitening.rotation[:, None, None]
    r, ju, jt = w[..., 0] * lines.rotation, w * lines.rotation_u, w * lines.rotation_theta[..., chosen]
    jut = np.swapaxes(ju, 1, 2)
    diagonal[:-1] += jut @ ju
    diagonal[1:] += w * w * np.eye(2)
    border[:-1] += jut @ jt
    border[1:] += w * jt
    gradient[:-1] += (jut @ r[..., None])[..., 0]
    gradient[1:] += w[..., 0] * r
    own, apart_here = _acting(jt, apart)
    flat = jt.take(own, axis=2).reshape(-1, len(own))
    corner[np.ix_(own, own)] += column_products(flat, flat, apart_here)
    corner_gradient[own] += flat.T @ r.ravel()
    return ArrowSystem(
        diagonal=diagonal + 1e-12 * np.trace(diagonal, axis1=1, axis2=2).max() * np.eye(2),
        coupling=w * jut,
        border=border,
        corner=corner,
        gradient=gradient,
        corner_gradient=corner_gradient,
    )


def _acting(theta: Floats, apart: int) -> tuple[Integers, int]:
    """Return which of the columns (n, i, p) are not zero, the last `apart` all or none, and how many of these."""
    acts = np.einsum("kip,kip->p", theta, theta) != 0
    last = slice(len(acts) - apart, len(acts))
    acts[last] = acts[last].any()
    return np.flatnonzero(acts), apart * bool(apart and acts[-1])
