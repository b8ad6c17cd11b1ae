"""A triad from the known magnitude of what it measures (Tedaldi 2014, section 3.2; Angrisano, Eqs. 8-11).

The sensor measures m = S f + b, and |f| is known. In a body frame that the triad's own axes define, S is triangular and
the correction f = C (m - b), C = inv(S), has nine unknowns.
"""

from collections.abc import Callable
from typing import Literal

import numpy as np

from ...errors import InitialisationError
from ...frozen import value_class
from ...recording import Floats
from ...solve.levenberg_marquardt import LeastSquaresSolution, levenberg_marquardt

UPPER = np.triu_indices(3)


def ellipsoid_start(measured: Floats) -> tuple[Floats, Floats]:
    """Return an upper triangular correction C (3, 3) and bias b (3,) with |C (m - b)| near 1, in closed form.

    Points of constant magnitude lie on an ellipsoid, whose equation is linear in nine coefficients. No initial guess is
    needed. The data are centred and scaled first, so that any unit and offset of the sensor will do.

    Parameters
    ----------
    measured : (n, 3), n >= 9 [unit]

    Raises
    ------
    InitialisationError
        If the points determine no ellipsoid: too few, or too much alike.
    """
    centre = 0.5 * (measured.max(axis=0) + measured.min(axis=0))
    spread = 0.5 * np.ptp(measured, axis=0)
    if len(measured) < 9 or not (spread > 0).all():
        raise InitialisationError(
            f"{len(measured)} attitudes, of which an axis never changes or nine are not reached, determine no "
            "accelerometer calibration. Record at least nine well spread attitudes."
        )
    x, y, z = ((measured - centre) / spread).T
    design = np.stack([x * x, y * y, z * z, 2 * x * y, 2 * x * z, 2 * y * z, 2 * x, 2 * y, 2 * z], axis=1)
    a = np.linalg.lstsq(design, np.ones(len(x)), rcond=None)[0]
    quadric = np.array([[a[0], a[3], a[4]], [a[3], a[1], a[5]], [a[4], a[5], a[2]]])
    if np.linalg.eigvalsh(quadric).min() <= 0:
        raise InitialisationError(
            "the static attitudes do not surround an ellipsoid: they are too much alike, or the sensor moved in them. "
            "Turn the sensor so that every axis points up once and down once, and some directions between."
        )
    offset = -np.linalg.solve(quadric, a[6:])
    level = 1 + offset @ quadric @ offset
    upper = np.linalg.cholesky(quadric / level).T
    return upper / spread, centre + spread * offset


@value_class
class MagnitudeFit:
    """A triangular calibration from magnitudes.

    Attributes
    ----------
    correction : (3, 3) upper triangular, f = correction @ (m - bias) [m/s^2 per unit]
    bias : (3,) [unit]
    residual : (n,) weighted residuals at the minimum
    jacobian : (n, 9) their derivatives, in scaled parameters
    covariance : (9, 9) of the correction's six entries in row order and the bias, for residuals of unit variance
    leverage : (n,) diagonal of the hat matrix
    cost : half the sum of squared residuals
    converged : whether the minimum was reached
    """

    correction: Floats
    bias: Floats
    residual: Floats
    jacobian: Floats
    covariance: Floats
    leverage: Floats
    cost: float
    converged: bool


def fit_magnitude(
    measured: Floats,
    magnitude: float,
    weight: Floats | None = None,
    residual: Literal["magnitude", "square"] = "magnitude",
    tolerance: float = 1e-12,
) -> MagnitudeFit:
    """Fit a triangular calibration to measurements of a vector of known magnitude.

    Parameters
    ----------
    measured : (n, 3) [unit]
    magnitude : of the measured vector, such as local gravity [m/s^2]
    weight : (n,) multiplies the residuals; all 1 where not given
    residual : "square" is the cost g^2 - |f|^2 of Eq. (3.4); "magnitude" is g - |f|, which has the noise of the sensor
    tolerance : relative length of a step at which the minimum is reached

    Raises
    ------
    InitialisationError
        If the attitudes determine no start.
    """
    centre, scale = measured.mean(axis=0), measured.std(axis=0)
    normal = (measured - centre) / np.where(scale > 0, scale, 1.0)
    correction, bias = ellipsoid_start(normal)
    start = np.concatenate([(magnitude * correction)[UPPER], bias])
    weights = np.ones(len(measured)) if weight is None else weight
    solution = levenberg_marquardt(_magnitude_problem(normal, magnitude, weights, residual), start, tolerance)
    turn = np.concatenate([(1 / np.broadcast_to(scale, (3, 3)))[UPPER], scale])  # back to the unit of the sensor
    x = solution.x * turn
    correction = np.zeros((3, 3))
    correction[UPPER] = x[:6]
    unscaled, leverage = _covariance_and_leverage(solution)
    return MagnitudeFit(
        correction=correction,
        bias=x[6:] + centre,
        residual=solution.residual,
        jacobian=solution.jacobian,
        covariance=unscaled * np.outer(turn, turn),
        leverage=leverage,
        cost=solution.cost,
        converged=solution.converged,
    )


def _covariance_and_leverage(solution: LeastSquaresSolution) -> tuple[Floats, Floats]:
    q, r = np.linalg.qr(solution.jacobian)
    inverse = np.linalg.pinv(r)
    return inverse @ inverse.T, np.einsum("ij,ij->i", q, q)


def _magnitude_problem(
    measured: Floats, magnitude: float, weights: Floats, kind: str
) -> Callable[[Floats], tuple[Floats, Floats]]:
    def problem(x: Floats) -> tuple[Floats, Floats]:
        """Return weighted residuals (n,) and their derivative (n, 9) by the correction and the bias, x (9,)."""
        correction = np.zeros((3, 3))
        correction[UPPER] = x[:6]
        centred = measured - x[6:]
        force = centred @ correction.T
        norm = np.sqrt(np.einsum("ij,ij->i", force, force))
        # derivative of the residual with respect to f: -f / |f|, or -2 f for squares
        pull = -2 * force if kind == "square" else -force / norm[:, None]
        value = magnitude**2 - norm**2 if kind == "square" else magnitude - norm
        jacobian = np.empty((len(measured), 9))
        for column, (i, j) in enumerate(zip(*UPPER, strict=True)):
            jacobian[:, column] = pull[:, i] * centred[:, j]
        jacobian[:, 6:] = -pull @ correction
        return value * weights, jacobian * weights[:, None]

    return problem
