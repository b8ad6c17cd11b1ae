"""Levenberg-Marquardt for small dense problems."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from ..frozen import value_class

Floats = NDArray[np.float64]


@value_class
class LeastSquaresSolution:
    """The minimum of 1/2 |r(x)|^2.

    Attributes
    ----------
    x : (n,) parameters
    residual : (m,) at x
    jacobian : (m, n) at x
    iterations : accepted and rejected steps
    converged : whether a step became negligible
    """

    x: Floats
    residual: Floats
    jacobian: Floats
    iterations: int
    converged: bool

    @property
    def cost(self) -> float:
        """1/2 |r|^2."""
        return 0.5 * float(self.residual @ self.residual)


def levenberg_marquardt(
    problem: Callable[[Floats], tuple[Floats, Floats]],
    start: Floats,
    tolerance: float = 1e-12,
    most_iterations: int = 100,
) -> LeastSquaresSolution:
    """Minimise 1/2 |r(x)|^2 with Marquardt's scaling; damped only after a rejected step.

    Parameters
    ----------
    problem : x (n,) -> residual (m,), Jacobian (m, n)
    start : (n,)
    tolerance : a step is negligible when its scaled length is below tolerance times that of x
    most_iterations : bound on the number of steps tried
    """
    x = start.astype(np.float64)
    residual, jacobian = problem(x)
    damping, iteration, converged = 0.0, 0, False
    scale = np.zeros(len(x))
    while iteration < most_iterations and not converged:
        iteration += 1
        scale = np.maximum(scale, np.linalg.norm(jacobian, axis=0))
        scaled = jacobian / np.where(scale > 0, scale, 1.0)
        step = _damped_step(scaled, residual, damping) / np.where(scale > 0, scale, 1.0)
        trial = x + step
        trial_residual, trial_jacobian = problem(trial)
        gain = residual @ residual - trial_residual @ trial_residual
        small = np.linalg.norm(scale * step) <= tolerance * (np.linalg.norm(scale * x) + np.linalg.norm(residual))
        if np.isfinite(gain) and gain >= 0:
            x, residual, jacobian = trial, trial_residual, trial_jacobian
            damping = 0.0 if damping < 1e-6 else damping / 10
        else:
            damping = max(10 * damping, 1e-4)
        converged = bool(small)
    return LeastSquaresSolution(x=x, residual=residual, jacobian=jacobian, iterations=iteration, converged=converged)


def _damped_step(scaled: Floats, residual: Floats, damping: float) -> Floats:
    """Return the step of one damping by QR of the scaled Jacobian, which keeps digits that normal equations lose."""
    n = scaled.shape[1]
    if damping:
        scaled = np.concatenate([scaled, np.sqrt(damping) * np.eye(n)])
        residual = np.concatenate([residual, np.zeros(n)])
    q, r = np.linalg.qr(scaled)
    if np.abs(np.diag(r)).min() > 1e-13:
        return -np.asarray(np.linalg.solve(r, q.T @ residual), dtype=np.float64)
    return -np.asarray(np.linalg.lstsq(scaled, residual, rcond=1e-12)[0], dtype=np.float64)
