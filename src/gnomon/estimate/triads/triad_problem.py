"""Poses of one triad, what is known of it from elsewhere, and the equations of both with the directions eliminated.

A pose measures m = S x + b + G f with noise of covariance V, where x = w u. With C = inv(S), the corrected measurement
C (m - b - G f) has the covariance C V C' and should be x. In scaled units:

- Only w known: u is the foot of m on the ellipsoid in the metric of V, and one residual u'C (m - b - G f) - w is left.
- Direction known to an angle: u moves away from it as far as the noise says, and three residuals are left.
- w = 0: three residuals, and no direction.

Noise across u lengthens a vector on the average. That is taken off (`excess`), so that ten thousand noisy samples do
not agree on a wrong scale.
"""

from dataclasses import replace
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from ...errors import OptionError
from ...frozen import value_class
from ...geometry.rotations import invert_matrix
from ...recording import Floats, Integers, frozen_array
from ...results.result import Booleans

PARAMETERS = 21
S_, B_, G_ = slice(0, 9), slice(9, 12), slice(12, 21)
"""Where sensitivity (row order), bias and g-sensitivity (row order) stand among the 21 parameters."""

_FOOT_STEPS = 2
_TURN_STEPS = 3
_LARGEST_EXCESS = 0.1  # of the magnitude; noise that large is no perturbation
_TINY = 1e-18  # variance below all rounding, in scaled units


@value_class
class TriadPoses:
    """Means of one triad in n poses, and the magnitude of what it measured in them.

    The model is measured = sensitivity @ (magnitude * u) + bias + g_sensitivity @ force, with a unit vector u that is
    unknown unless a direction is given. `TriadPoses.of` fills in what is not stated.

    Attributes
    ----------
    measured : (n, 3) mean measurements [unit]
    variance : (n, 3) of these means by the noise of the sensor [unit^2]
    magnitude : (n,) length of the measured vector [SI]; zero for a turntable at rest, which shows the bias. State zero
        with a sigma where noise hides the direction, such as the earth's rate at rest
    magnitude_sigma : (n,) error of each magnitude on its own, sigma [SI]; of each component where the magnitude is zero
    group : (n,) int, poses whose magnitudes share one relative error, such as those of one speed of a turntable
    group_sigma : (g,) sigma of these relative errors; zero where the magnitude is exact
    direction : (n, 3) unit vectors along what is measured, in the frame in which the result is wanted; None where only
        magnitudes are known, and nan in the poses of which only the magnitude is known
    direction_sigma : (n,) of each direction, about each of the two axes across it [rad]
    force : (n, 3) specific force in the same frame [m/s^2], for the g-sensitivity of a gyroscope; None without
    """

    measured: Floats
    variance: Floats
    magnitude: Floats
    magnitude_sigma: Floats
    group: Integers
    group_sigma: Floats
    direction: Floats | None = None
    direction_sigma: Floats | None = None
    force: Floats | None = None

    def __post_init__(self) -> None:
        for name in ("measured", "variance", "magnitude", "magnitude_sigma", "group_sigma"):
            object.__setattr__(self, name, frozen_array(getattr(self, name)))
        object.__setattr__(self, "group", frozen_array(self.group, np.int64))
        for name in ("direction", "direction_sigma", "force"):
            if getattr(self, name) is not None:
                object.__setattr__(self, name, frozen_array(getattr(self, name)))
        self._check()

    def _check(self) -> None:
        n = len(self.measured)
        vectors = {"measured": self.measured, "variance": self.variance, "direction": self.direction}
        numbers = {"magnitude": self.magnitude, "magnitude_sigma": self.magnitude_sigma, "group": self.group}
        for name, array in {**vectors, "force": self.force}.items():
            if array is not None and array.shape != (n, 3):
                raise OptionError(f"poses need {name} of shape {(n, 3)}; found {array.shape}.")
        for name, array in {**numbers, "direction_sigma": self.direction_sigma}.items():
            if array is not None and array.shape != (n,):
                raise OptionError(f"poses need {name} of shape {(n,)}; found {array.shape}.")
        if (self.direction is None) != (self.direction_sigma is None):
            raise OptionError("directions of poses need their sigmas, and sigmas need directions.")
        if n and not 0 <= int(self.group.min()) <= int(self.group.max()) < len(self.group_sigma):
            raise OptionError(f"groups of poses must be 0 to {len(self.group_sigma) - 1}, one for each group_sigma.")
        for name, array in {**numbers, "measured": self.measured, "variance": self.variance}.items():
            bad = ~np.isfinite(array) | ((array < 0) & (name != "measured"))
            if bad.any():
                raise OptionError(f"{name} of pose {int(np.argwhere(bad)[0, 0]) + 1} is not a usable number.")

    def __len__(self) -> int:
        return len(self.measured)

    @classmethod
    def of(
        cls,
        measured: ArrayLike,
        magnitude: ArrayLike,
        *,
        variance: ArrayLike = 0.0,
        magnitude_sigma: ArrayLike = 0.0,
        group: ArrayLike = 0,
        group_sigma: ArrayLike = 0.0,
        direction: ArrayLike | None = None,
        direction_sigma: ArrayLike = 0.0,
        force: ArrayLike | None = None,
    ) -> Self:
        """Return poses with everything that is one number for all of them spread over them; see the attributes.

        Directions need not be of unit length.
        """
        values = np.asarray(measured, dtype=np.float64)
        n = len(values)
        unit = None
        if direction is not None:
            unit = np.asarray(direction, dtype=np.float64)
            unit = unit / np.linalg.norm(unit, axis=1, keepdims=True)
        return cls(
            measured=values,
            variance=np.broadcast_to(variance, (n, 3)).astype(np.float64),
            magnitude=np.broadcast_to(magnitude, n).astype(np.float64),
            magnitude_sigma=np.broadcast_to(magnitude_sigma, n).astype(np.float64),
            group=np.broadcast_to(group, n).astype(np.int64),
            group_sigma=np.atleast_1d(np.asarray(group_sigma, dtype=np.float64)),
            direction=unit,
            direction_sigma=None if unit is None else np.broadcast_to(direction_sigma, n).astype(np.float64),
            force=None if force is None else np.asarray(force, dtype=np.float64),
        )


@value_class
class TriadPrior:
    """What is known of a triad from elsewhere, in sensor units: another calibration, stated values, held values.

    Parameters are the nine entries of the sensitivity in row order [unit/SI], the bias [unit] and the nine entries of
    the g-sensitivity in row order [unit per m/s^2]. Without directions the poses know the sensitivity only up to a
    rotation of the body frame: a prior that knows the three entries above the diagonal says which frame is meant.

    Attributes
    ----------
    mean : (21,); anything finite where nothing is known
    precision : (21, 21) inverse of the covariance; zero where nothing is known
    fixed : (21,) bool, held at the mean and not estimated
    """

    mean: Floats
    precision: Floats
    fixed: Booleans

    def __post_init__(self) -> None:
        object.__setattr__(self, "mean", frozen_array(self.mean))
        object.__setattr__(self, "precision", frozen_array(self.precision))
        object.__setattr__(self, "fixed", frozen_array(self.fixed, np.bool_))
        if self.mean.shape != (PARAMETERS,) or self.precision.shape != (PARAMETERS, PARAMETERS):
            raise OptionError(f"a prior of a triad has {PARAMETERS} parameters; found {self.mean.shape}.")

    @classmethod
    def of(cls, mean: ArrayLike, sigma: ArrayLike = np.inf, *, fixed: ArrayLike = False) -> Self:
        """Return a prior of independent parameters.

        Parameters
        ----------
        mean : (21,); nan where nothing is known
        sigma : (21,) or one for all; infinite where nothing is known, zero where the parameter is held fixed
        fixed : (21,) bool or one for all
        """
        values = np.broadcast_to(np.asarray(mean, dtype=np.float64), PARAMETERS)
        sigmas = np.broadcast_to(np.asarray(sigma, dtype=np.float64), PARAMETERS)
        held = np.broadcast_to(np.asarray(fixed, dtype=np.bool_), PARAMETERS) | (sigmas == 0)
        known = np.isfinite(values) & np.isfinite(sigmas) & ~held
        precision = np.where(known, 1 / np.where(known, sigmas, 1.0) ** 2, 0.0)
        return cls(mean=np.where(np.isfinite(values), values, 0.0), precision=np.diag(precision), fixed=held)


@value_class
class TriadProblem:
    """Poses in scaled units, and what is known beforehand. The parameters are S, b, G and p relative magnitude errors.

    Attributes
    ----------
    measured, variance, force : (n, 3)
    magnitude, magnitude_sigma : (n,)
    level : (n, p) derivative of the logarithm of each magnitude by the magnitude errors
    direction : (n, 3) unit vectors; zero where unknown
    direction_sigma : (n,) [rad]; infinite where unknown
    free : (21 + p,) bool
    prior_root : (k, 21 + p), rows of the square root of the prior's precision
    prior_target : (k,) what they should give
    """

    measured: Floats
    variance: Floats
    force: Floats
    magnitude: Floats
    magnitude_sigma: Floats
    level: Floats
    direction: Floats
    direction_sigma: Floats
    free: Booleans
    prior_root: Floats
    prior_target: Floats

    @property
    def length_only(self) -> Booleans:
        """(n,) bool, poses with one equation."""
        return (self.magnitude > 0) & ~np.isfinite(self.direction_sigma)

    def of(self, kept: Booleans) -> "TriadProblem":
        """Return the problem of some of the poses."""
        names = ("measured", "variance", "force", "magnitude", "magnitude_sigma", "level", "direction")
        some = {name: getattr(self, name)[kept] for name in (*names, "direction_sigma")}
        return replace(self, **some)


@value_class
class TriadNoiseLevels:
    """What stays the same while the parameters settle.

    Attributes
    ----------
    covariance : (n, 3, 3) of each measurement
    excess : (n,) by how much noise lengthens each vector on the average
    """

    covariance: Floats
    excess: Floats


@value_class
class Latent:
    """Where the poses are, by some parameters: all poses of one equation first, then those of three.

    Attributes
    ----------
    pose : (r,) index of the pose of each residual; slice(None) where each has one
    u : (n, 3) unit vectors; zero where the magnitude is
    spread : (n,) mean squared angle between u and the true direction, both axes together
    q : (r, 3) in the body frame, along which the residual is taken
    error, sigma : (r,) residual and its standard deviation
    length : (n,) of the vector
    """

    pose: Integers | slice
    u: Floats
    spread: Floats
    q: Floats
    error: Floats
    sigma: Floats
    length: Floats


@value_class
class TriadResiduals:
    """Residuals with unit variance and their derivatives, all poses of one equation first, then those of three.

    Attributes
    ----------
    pose : (r,) index of the pose
    residual : (r,)
    jacobian : (r, f) by the free parameters
    sigma : (r,) standard deviation of the residuals before they were divided by it
    u : (n, 3) unit vectors; zero where the magnitude is
    """

    pose: Integers
    residual: Floats
    jacobian: Floats
    sigma: Floats
    u: Floats


def sensor_covariance(problem: TriadProblem, theta: Floats, u: Floats, extra: float) -> Floats:
    """Return the covariance (n, 3, 3) of the measurements: noise, magnitude's error, extra variance."""
    s = theta[S_].reshape(3, 3)
    lengths = problem.magnitude_sigma**2
    along = u @ s.T
    at_rest = problem.magnitude == 0
    isotropic = extra + np.where(at_rest, lengths, 0.0)
    floor = _TINY * np.einsum("ij,ij->i", s, s) + problem.variance
    return (
        floor[:, :, None] * np.eye(3)
        + isotropic[:, None, None] * (s @ s.T)
        + np.where(at_rest, 0.0, lengths)[:, None, None] * along[:, :, None] * along[:, None, :]
    )


def true_vectors(problem: TriadProblem, theta: Floats) -> Floats:
    """Return the true vectors (n, 3) that measurements and parameters say."""
    c = invert_matrix(theta[S_].reshape(3, 3))
    return (problem.measured - theta[B_] - problem.force @ theta[G_].reshape(3, 3).T) @ c.T


def known_magnitudes(problem: TriadProblem, theta: Floats) -> Floats:
    """Return the known magnitudes (n,) with their estimated errors."""
    return problem.magnitude * (1 + problem.level @ theta[PARAMETERS:])


def eliminate_directions(problem: TriadProblem, theta: Floats, noise: TriadNoiseLevels) -> Latent:
    """Return the direction of each pose and the residuals that are left when it is eliminated."""
    c = invert_matrix(theta[S_].reshape(3, 3))
    x = true_vectors(problem, theta)
    w = known_magnitudes(problem, theta) + noise.excess
    body = c @ noise.covariance @ c.T
    single = problem.length_only
    if single.all():
        u, spread, q, error, sigma = _feet(x, w, body)
        return Latent(pose=slice(None), u=u, spread=spread, q=q, error=error, sigma=sigma, length=w)
    one, three = np.flatnonzero(single), np.flatnonzero(~single)
    u, spread = np.zeros_like(x), np.zeros(len(x))
    u[one], spread[one], q_one, e_one, sigma_one = _feet(x[one], w[one], body[one])
    u[three], spread[three], q_three, e_three, sigma_three = _posteriors(
        x[three], w[three], body[three], problem.direction[three], problem.direction_sigma[three]
    )
    return Latent(
        pose=np.concatenate([one, np.repeat(three, 3)]),
        u=u,
        spread=spread,
        q=np.concatenate([q_one, q_three.reshape(-1, 3)]),
        error=np.concatenate([e_one, e_three.ravel()]),
        sigma=np.concatenate([sigma_one, sigma_three.ravel()]),
        length=w,
    )


def triad_residuals(problem: TriadProblem, theta: Floats, noise: TriadNoiseLevels) -> TriadResiduals:
    """Return the residuals and their derivatives by the free parameters."""
    at = eliminate_directions(problem, theta, noise)
    pose, scale = at.pose, 1 / at.sigma
    c = invert_matrix(theta[S_].reshape(3, 3))
    normal = -(at.q @ c) * scale[:, None]
    along = -scale * np.einsum("ri,ri->r", at.q, at.u[pose]) * problem.magnitude[pose]
    point = (at.length[:, None] * at.u)[pose]
    columns = _columns(problem, pose, normal, point, along)
    return TriadResiduals(
        pose=np.arange(len(at.u)) if isinstance(pose, slice) else pose,
        residual=at.error * scale,
        jacobian=np.stack(columns).T,  # each column in one piece, as it is made and used
        sigma=at.sigma,
        u=at.u,
    )


def _columns(
    problem: TriadProblem, pose: Integers | slice, normal: Floats, point: Floats, along: Floats
) -> list[Floats]:
    """Return the derivatives (r,) by each free parameter.

    Parameters
    ----------
    normal : (r, 3) derivative of the residual by the bias
    point : (r, 3) true vectors
    along : (r,) derivative by the logarithm of the magnitude
    """
    force, level = problem.force[pose], problem.level[pose]
    columns: list[Floats] = []
    for k in np.flatnonzero(problem.free):
        if k < B_.start:
            columns.append(normal[:, k // 3] * point[:, k % 3])
        elif k < G_.start:
            columns.append(normal[:, k - B_.start])
        elif k < PARAMETERS:
            columns.append(normal[:, (k - G_.start) // 3] * force[:, k % 3])
        else:
            columns.append(along * level[:, k - PARAMETERS])
    return columns


def _feet(x: Floats, w: Floats, body: Floats) -> tuple[Floats, Floats, Floats, Floats, Floats]:
    """Return u, spread, q, error and sigma of Latent for poses of known length only; u is the foot, and q is u."""
    u = _unit(x)
    for _ in range(_FOOT_STEPS):
        u = _unit(_nearer_foot(x, w, body, u))
    pull = (body @ u[..., None])[..., 0]
    variance = np.einsum("ki,ki->k", u, pull)
    across = np.trace(body, axis1=1, axis2=2) - np.einsum("ki,ki->k", pull, pull) / variance
    return u, across / w**2, u, np.einsum("ki,ki->k", u, x) - w, np.sqrt(variance)


def _nearer_foot(x: Floats, w: Floats, body: Floats, u: Floats) -> Floats:
    """Return the point (k, 3) nearest to x on the plane that touches the sphere at u."""
    pull = (body @ u[..., None])[..., 0]
    variance = np.einsum("ki,ki->k", u, pull)
    return x - pull * ((np.einsum("ki,ki->k", u, x) - w) / variance)[:, None]


def _unit(vectors: Floats) -> Floats:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), np.sqrt(_TINY))


def _posteriors(
    x: Floats, w: Floats, body: Floats, direction: Floats, sigma: Floats
) -> tuple[Floats, Floats, Floats, Floats, Floats]:
    """Return the same for poses with three equations; q, error and sigma are (k, 3, 3), (k, 3) and (k, 3)."""
    known = np.isfinite(sigma)
    angle = np.where(known, sigma, 0.0)
    u = np.where(known[:, None], direction, 0.0)
    prior = (angle**2)[:, None, None] * np.eye(3)

    def spread_at(u: Floats) -> tuple[Floats, Floats]:
        across = prior - (angle**2)[:, None, None] * u[:, :, None] * u[:, None, :]
        return across, body + (w**2)[:, None, None] * across

    def gain_of(across: Floats, total: Floats) -> Floats:
        return w[:, None, None] * np.swapaxes(np.linalg.solve(total, across), 1, 2)

    def improved(u: Floats) -> Floats:
        offset = _logarithm(u, direction)
        error = x - w[:, None] * (u + offset)
        return _exponential(u, offset + np.einsum("kij,kj->ki", gain_of(*spread_at(u)), error))

    for _ in range(_TURN_STEPS if angle.any() else 0):
        u = improved(u)
    across, total = spread_at(u)
    gain, error = gain_of(across, total), x - w[:, None] * (u + _logarithm(u, direction))
    spread = np.trace(across - w[:, None, None] * gain @ across, axis1=1, axis2=2)
    variance, vectors = np.linalg.eigh(total)
    q = np.swapaxes(vectors, 1, 2)
    return u, spread, q, np.einsum("kij,kj->ki", q, error), np.sqrt(np.maximum(variance, _TINY))


def _logarithm(u: Floats, target: Floats) -> Floats:
    """Return the tangent vectors at u that lead to target, (k, 3) [rad]; zero where either is."""
    cosine = np.einsum("ki,ki->k", u, target)
    across = target - cosine[:, None] * u
    sine = np.linalg.norm(across, axis=1)
    return across * (np.arctan2(sine, cosine) / np.where(sine > 0, sine, 1.0))[:, None]


def _exponential(u: Floats, tangent: Floats) -> Floats:
    """Return unit vectors u moved along tangent vectors (k, 3) [rad]."""
    angle = np.linalg.norm(tangent, axis=1, keepdims=True)
    moved = np.cos(angle) * u + np.sinc(angle / np.pi) * tangent
    length = np.linalg.norm(moved, axis=1, keepdims=True)
    return moved / np.where(length > 0, length, 1.0)


def noise_at(problem: TriadProblem, theta: Floats, extra: float) -> TriadNoiseLevels:
    """Return the noise as it is at these parameters, with an extra variance of every component."""
    x = true_vectors(problem, theta)
    length = np.linalg.norm(x, axis=1, keepdims=True)
    u = np.where(problem.magnitude[:, None] > 0, x / np.where(length > 0, length, 1.0), 0.0)
    noise = TriadNoiseLevels(covariance=sensor_covariance(problem, theta, u, extra), excess=np.zeros(len(x)))
    w = known_magnitudes(problem, theta)
    spread = eliminate_directions(problem, theta, noise).spread
    return replace(noise, excess=np.clip(0.5 * w * spread, 0.0, _LARGEST_EXCESS * w))
