"""Hold-out for the multi-position problem: each interval and each rotation predicted from all the others.

The fit without an interval or a rotation is one Gauss-Newton step away from the fit with it, and the covariance that
the step needs is at hand; nothing is fitted again.
"""

import numpy as np

from ...frozen import value_class
from ...geometry.rotation_vector import invert_matrix, tangent_basis
from ...recording import Floats
from ...results.result import Booleans
from ...solve.arrow import ArrowSolution, solve_arrow
from .fit import MultiPositionFit
from .model import (
    B_,
    G_,
    LOWER,
    S_,
    MultiPositionData,
    MultiPositionLinearization,
    normal_equations,
)
from .noise_levels import interval_rows, rotation_rows


@value_class
class LeaveOneOutErrors:
    """Errors of each interval and rotation when it was left out.

    Attributes
    ----------
    magnitude, magnitude_fit : (n,) |f| - 1 left out, and in the fit [g]
    rotation, rotation_fit : (n - 1, 2) u_a - u_g in the tangent plane, left out, and in the fit [rad]
    measured : (n, 3) directions that the accelerometer shows, u_a
    """

    magnitude: Floats
    magnitude_fit: Floats
    rotation: Floats
    rotation_fit: Floats
    measured: Floats


def leave_one_out(fit: MultiPositionFit, *, g_sensitivity: bool = True) -> LeaveOneOutErrors:
    """Predict each interval and each rotation from all the others.

    Parameters
    ----------
    fit : the solution of the problem
    g_sensitivity : False judges the model without it, from the same linearisation
    """
    data, lines, arrow, free, theta = fit.data, fit.lines, fit.arrow, fit.free, fit.state.theta
    if not g_sensitivity and free[G_].any():
        lines, arrow, free, theta = _without_g_sensitivity(fit)
    rows, gain = interval_rows("accelerometer", lines, arrow, fit.whitening, free)
    residual = np.einsum("kij,kj->ki", fit.whitening.accelerometer, lines.accelerometer)
    thetas = theta + _change_without(rows, gain, residual, free)
    forces = _forces(data, theta[None])
    norms = np.linalg.norm(forces, axis=1)
    measured = forces / norms[:, None]
    basis = tangent_basis(fit.state.u)
    offset = np.einsum("kij,ki->kj", basis, measured - fit.state.u)
    direct = lines.rotation + offset[1:] + np.einsum("kij,kj->ki", lines.rotation_u, offset[:-1])
    rows, gain = rotation_rows(lines, arrow, fit.whitening, free)
    change = _change_without(rows, gain, fit.whitening.rotation[:, None] * lines.rotation, free)
    return LeaveOneOutErrors(
        magnitude=np.linalg.norm(_forces(data, thetas), axis=1) - 1,
        magnitude_fit=norms - 1,
        rotation=direct + np.einsum("kij,kj->ki", lines.rotation_theta, change),
        rotation_fit=direct,
        measured=measured,
    )


def _change_without(rows: Floats, gain: Floats, residual: Floats, free: Booleans) -> Floats:
    """Return the change of theta (k, p) when rows A with residual r are left out: P A' inv(I - A P A') r."""
    kept = np.eye(rows.shape[1]) - rows @ gain
    step = (gain @ np.linalg.solve(kept, residual[..., None]))[..., 0]
    change = np.zeros((len(rows), len(free)))
    change[:, free] = step[:, -int(free.sum()) :]
    return change


def _without_g_sensitivity(fit: MultiPositionFit) -> tuple[MultiPositionLinearization, ArrowSolution, Booleans, Floats]:
    """Return the linearised solution with G = 0."""
    free = fit.free.copy()
    free[G_] = False
    to_zero = np.zeros(len(free))
    to_zero[G_] = -fit.state.theta[G_]
    lines = fit.lines.extrapolated(to_zero, np.zeros((len(fit.state.u), 2)))
    arrow = solve_arrow(normal_equations(lines, fit.whitening, np.zeros(len(free)), free))
    step = np.zeros(len(free))
    step[free] = arrow.corner
    return lines.extrapolated(step, arrow.states), arrow, free, fit.state.theta + to_zero + step


def _forces(data: MultiPositionData, thetas: Floats) -> Floats:
    """Return the specific force (n, 3) [g] of interval k by the parameters thetas[k], or by the only ones."""
    s = np.zeros((len(thetas), 3, 3))
    s[:, LOWER[0], LOWER[1]] = thetas[:, S_]
    drifting = thetas[:, thetas.shape[1] - 3 * data.trend.shape[1] :].reshape(len(thetas), -1, 3)
    drift = np.einsum("kq,kqi->ki", data.trend, np.broadcast_to(drifting, (len(data.trend), *drifting.shape[1:])))
    return (invert_matrix(s) @ (data.accelerometer - thetas[:, B_] - drift)[..., None])[..., 0]
