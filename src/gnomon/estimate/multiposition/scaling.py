"""Pulls and information that static intervals and rotations have on the parameters, for covariances by clusters.

A stretch of time is a static interval with the rotation that follows it. The directions of gravity are eliminated as in
the factor of the solution: with Z = inv(N_uu) N_up, a stretch whose normal equations are H and whose gradient is g has
the information T' H T and the pull -T' g, T = [-Z; I]. Over all stretches and the prior the information adds up to the
Schur complement, and the pulls to zero.

Between the sensors' units and the scaled units in which the multi-position problem is solved.

Every axis is centred and divided by its spread, so that offsets and scales of any size are the same problem.
"""

from typing import Protocol

import numpy as np

from ...frozen import value_class
from ...models.gravity import EARTH_RATE_RAD_S
from ...recording import Floats, frozen_array
from ...results.result import Booleans
from ..trust.clusters import ClusterSums
from .fit import MultiPositionFit
from .model import B_, BG_, CG_, G_, LOWER, S_, MultiPositionState
from .noise_levels import rotation_variance

_RUNS = (5, 4), (3, 3)  # rotations that follow each other, and how many of them


def segment_sums(fit: MultiPositionFit, rotations: Booleans | None = None) -> ClusterSums:
    """Return the sums of each static interval with the rotation behind it, over the free parameters of a fit.

    Parameters
    ----------
    rotations : (n - 1,) which of them count; those that the fit used where not given
    """
    lines, whitening, free = fit.lines, fit.whitening, fit.free
    cross = np.swapaxes(fit.arrow.cross_covariance, 1, 2)
    follow = np.swapaxes(np.linalg.solve(fit.arrow.corner_covariance, cross), 1, 2)  # -Z, (n, 2, p)
    n, _, p = follow.shape
    pull, information = np.zeros((n, p)), np.zeros((n, p, p))
    for name in ("accelerometer", "gyroscope"):
        root = getattr(whitening, name)
        rows = root @ (getattr(lines, f"{name}_theta")[..., free] + getattr(lines, f"{name}_u") @ follow)
        _add(pull, information, rows, np.einsum("kij,kj->ki", root, getattr(lines, name)))
    rows = lines.rotation_theta[..., free] + lines.rotation_u @ follow[:-1] + follow[1:]
    weight = whitening.rotation[:, None]
    if rotations is not None:
        spread = np.sqrt(rotation_variance(fit.data, fit.state) + fit.extra.rotation)
        weight = (rotations / spread)[:, None]
    _add(pull[:-1], information[:-1], weight[..., None] * rows, weight * lines.rotation)
    prior = whitening.prior[np.ix_(free, free)]
    return ClusterSums(
        t_s=fit.data.interval_s,
        pull=pull,
        information=information,
        prior_pull=-(whitening.prior @ fit.from_prior)[free],
        prior_information=prior,
    )


def with_runs(fit: MultiPositionFit) -> Booleans:
    """Return the rotations (n - 1,) that a fit used, and those left out as outliers many of which follow each other.

    Outliers come one by one. Where they are most of a stretch of the recording, it is the stretch that differs.
    """
    linked = np.flatnonzero(fit.data.linked)
    out = ~fit.rotation_used[linked]
    used = fit.rotation_used.copy()
    for length, most in _RUNS:
        many = np.convolve(out, np.ones(length), mode="full")  # number left out of the last few, up to each
        for end in np.flatnonzero(many[: len(out)] >= most):
            used[linked[max(0, end - length + 1) : end + 1]] = True
    return used


def free_jacobian(fit: MultiPositionFit, jacobian: Floats) -> Floats:
    """Return derivatives (m, 30) by theta as those (m, p) by the free parameters of the sums."""
    return np.pad(jacobian, ((0, 0), (0, len(fit.free) - jacobian.shape[1])))[:, fit.free]


def _add(pull: Floats, information: Floats, rows: Floats, residual: Floats) -> None:
    pull -= np.einsum("kip,ki->kp", rows, residual)
    information += np.swapaxes(rows, 1, 2) @ rows


@value_class
class Scaling:
    """scaled = (measured - centre) / spread, axis by axis.

    Attributes
    ----------
    centre, spread : (3,) [unit]
    """

    centre: Floats
    spread: Floats

    def __post_init__(self) -> None:
        object.__setattr__(self, "centre", frozen_array(self.centre))
        object.__setattr__(self, "spread", frozen_array(self.spread))

    @classmethod
    def of(cls, centre: Floats, deviations: Floats) -> "Scaling":
        """Return the scaling with a given centre and the rms of deviations (n, 3) as spread."""
        spread = np.sqrt(np.mean(deviations**2, axis=0)) if len(deviations) else np.ones(3)
        return cls(centre=centre, spread=np.where(spread > 0, spread, 1.0))

    def scaled(self, values: Floats) -> Floats:
        """Return scaled values (n, 3)."""
        return (values - self.centre) / self.spread


@value_class
class ImuEstimate:
    """An IMU's parameters in the sensors' units, in frame accel-x, with their covariance.

    Attributes
    ----------
    accelerometer_sensitivity : (3, 3) [unit per m/s^2]
    accelerometer_bias : (3,) [unit]
    gyroscope_sensitivity : (3, 3) [unit per rad/s]
    gyroscope_bias : (3,) [unit]
    g_sensitivity : (3, 3) [unit per m/s^2]
    covariance : (33, 33), elements in the order of the attributes, matrices in row order
    """

    accelerometer_sensitivity: Floats
    accelerometer_bias: Floats
    gyroscope_sensitivity: Floats
    gyroscope_bias: Floats
    g_sensitivity: Floats
    covariance: Floats

    @property
    def values(self) -> Floats:
        """All scalars (33,), in the order of the covariance."""
        parts = (
            self.accelerometer_sensitivity,
            self.accelerometer_bias,
            self.gyroscope_sensitivity,
            self.gyroscope_bias,
            self.g_sensitivity,
        )
        return np.concatenate([part.ravel() for part in parts])


class Fitted(Protocol):
    """What a fit says in scaled units: the state, the covariance (30, 30), and which parameters were estimated."""

    @property
    def state(self) -> MultiPositionState:
        """Where it stands."""
        ...

    @property
    def covariance(self) -> Floats:
        """Of theta."""
        ...

    @property
    def free(self) -> Booleans:
        """Whether each of theta was estimated."""
        ...


def to_physical_units(
    fit: Fitted,
    accelerometer: Scaling,
    gyroscope: Scaling,
    *,
    gravity_m_s2: float,
    gravity_sigma_m_s2: float,
    latitude_deg: float | None,
) -> ImuEstimate:
    """Return the fit in the sensors' units.

    The uncertainty of gravity goes to the sensitivities, which are proportional to 1 / g. The vertical part of the
    earth's rate turns with the attitude like gravity and hides in the g-sensitivity: it is taken off where the latitude
    is known, and is part of the sigma where it is not.
    """
    values, jacobian = sensor_scalars(
        fit.state, accelerometer, gyroscope, gravity_m_s2=gravity_m_s2, latitude_deg=latitude_deg
    )
    covariance = jacobian @ fit.covariance @ jacobian.T
    estimated = bool(fit.free[G_].any())
    if not estimated:
        values[24:] = 0.0
    by_gravity = np.zeros(33)
    by_gravity[:9], by_gravity[24:] = -values[:9] / gravity_m_s2, -values[24:] / gravity_m_s2
    covariance += gravity_sigma_m_s2**2 * np.outer(by_gravity, by_gravity)
    if estimated and latitude_deg is None:
        by_earth = np.zeros(33)
        by_earth[24:] = values[12:21] / gravity_m_s2
        covariance += EARTH_RATE_RAD_S**2 / 3 * np.outer(by_earth, by_earth)
    return ImuEstimate(
        accelerometer_sensitivity=values[:9].reshape(3, 3),
        accelerometer_bias=values[9:12],
        gyroscope_sensitivity=values[12:21].reshape(3, 3),
        gyroscope_bias=values[21:24],
        g_sensitivity=values[24:].reshape(3, 3),
        covariance=covariance,
    )


def blocks_of_scalars(values: Floats) -> tuple[tuple[str, Floats, str], ...]:
    """Return of each block of scalars (33,) its path, the factors (33,) by which it is shown, and the unit of that.

    Sensitivities are shown as shares of the axis' own, biases and g-sensitivity as what they make of the rate or force.
    """
    force, rate = (np.linalg.norm(values[part].reshape(3, 3), axis=1) for part in (slice(0, 9), slice(12, 21)))
    shares = {
        "imu0.accelerometer.sensitivity": (slice(0, 9), 100 / np.repeat(force, 3), "%"),
        "imu0.accelerometer.bias": (slice(9, 12), 1 / force, "m/s^2"),
        "imu0.gyroscope.sensitivity": (slice(12, 21), 100 / np.repeat(rate, 3), "%"),
        "imu0.gyroscope.bias": (slice(21, 24), 1 / rate, "rad/s"),
        "imu0.gyroscope.g_sensitivity": (slice(24, 33), 1 / np.repeat(rate, 3), "rad/s per m/s^2"),
    }
    found: list[tuple[str, Floats, str]] = []
    for path, (part, share, unit) in shares.items():
        factor = np.zeros(len(values))
        factor[part] = share
        found.append((path, factor, unit))
    return tuple(found)


def sensor_scalars(
    state: MultiPositionState,
    accelerometer: Scaling,
    gyroscope: Scaling,
    *,
    gravity_m_s2: float,
    latitude_deg: float | None,
) -> tuple[Floats, Floats]:
    """Return the scalars (33,) in the sensors' units, in the order of `ImuEstimate.covariance`, and their derivative.

    The derivative (33, 30) is by the scaled parameters theta.
    """
    s, b, c_g, b_g, g = state.matrices
    s_g = np.linalg.inv(c_g) if np.any(c_g) else np.zeros((3, 3))
    da, dg = accelerometer.spread, gyroscope.spread
    vertical = EARTH_RATE_RAD_S * np.sin(np.radians(latitude_deg)) if latitude_deg is not None else 0.0
    gyro_sensitivity = dg[:, None] * s_g
    values = np.concatenate(
        [
            (da[:, None] * s / gravity_m_s2).ravel(),
            da * b + accelerometer.centre,
            gyro_sensitivity.ravel(),
            dg * b_g + gyroscope.centre,
            (dg[:, None] * g / gravity_m_s2 - gyro_sensitivity * vertical / gravity_m_s2).ravel(),
        ]
    )
    jacobian = np.zeros((33, 30))
    for column, (i, j) in enumerate(zip(*LOWER, strict=True)):
        jacobian[3 * i + j, S_.start + column] = da[i] / gravity_m_s2
    jacobian[9:12, B_] = np.diag(da)
    jacobian[12:21, CG_] = -np.kron(np.diag(dg) @ s_g, s_g.T)  # d inv(C) = -inv(C) dC inv(C)
    jacobian[21:24, BG_] = np.diag(dg)
    jacobian[24:33, G_] = np.kron(np.diag(dg), np.eye(3)) / gravity_m_s2
    return values, jacobian
