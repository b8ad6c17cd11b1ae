"""Least squares: dense, by Levenberg and Marquardt; not below zero; and chains of small states with a border.

A chain: many small states of which each touches the next, and few parameters touch them all. The normal matrix is block
tridiagonal with a border (an arrow):

    [ D0  E0            F0 ]
    [ E0' D1  E1        F1 ]
    [     E1' D2  ..    .. ]
    [ F0' F1' ..        C  ]

It is factorised from the first block to the last; time and memory grow linearly with the chain. States are gathered in
larger blocks first, so that the work is done in few calls of LAPACK.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from ..frozen import value_class

_LEAST_GROWTH = 1e-13  # of a column's product with the right side that counts as growth

Floats = NDArray[np.float64]

_GATHERED = 48  # scalars in a block; measured: flat between 30 and 100


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


def solve_nonnegative(A: Floats, b: Floats, near: Floats | None = None) -> Floats:
    """Return the x >= 0, (n,), with the least |A x - b|, by the active sets of Lawson and Hanson (1974), chapter 23.

    Parameters
    ----------
    A : (m, n) of full rank
    b : (m,)
    near : (n,) of a problem much like it: what is above zero there is taken to be so first
    """
    x, free = np.zeros(A.shape[1]), np.zeros(A.shape[1], dtype=bool)
    if near is not None and (near > 0).any():
        first = np.linalg.lstsq(A[:, near > 0], b)[0]
        if (first > 0).all():
            free = near > 0
            x[free] = first
    least = _LEAST_GROWTH * np.linalg.norm(A, axis=0) * np.linalg.norm(b)
    for _ in range(10 * len(x)):
        growth = np.where(free, 0.0, A.T @ (b - A @ x) - least)
        if growth.max(initial=0.0) <= 0:
            break
        free[np.argmax(growth)] = True
        while True:
            ahead = np.zeros(len(x))
            ahead[free] = np.linalg.lstsq(A[:, free], b)[0]
            below = free & (ahead <= 0)
            if not below.any():
                break
            share = x[below] / (x[below] - ahead[below])
            x = x + share.min() * (ahead - x)
            free[np.flatnonzero(below)[share <= share.min()]] = False
        x = ahead
    return x


@value_class
class ArrowSystem:
    """Normal equations N x = -gradient of n chained states of d scalars each and p border parameters.

    Attributes
    ----------
    diagonal : (n, d, d)
    coupling : (n - 1, d, d), rows of state k, columns of state k + 1
    border : (n, d, p)
    corner : (p, p)
    gradient : (n, d), of the states
    corner_gradient : (p,)
    """

    diagonal: Floats
    coupling: Floats
    border: Floats
    corner: Floats
    gradient: Floats
    corner_gradient: Floats


@value_class
class ArrowSolution:
    """Step and covariance of an arrow system.

    Attributes
    ----------
    states : (n, d) step of the states
    corner : (p,) step of the border parameters
    corner_covariance : (p, p) inverse of the Schur complement
    state_covariance : (n, d, d)
    next_covariance : (n - 1, d, d) between state k and state k + 1
    cross_covariance : (n, d, p) between state k and the border parameters
    """

    states: Floats
    corner: Floats
    corner_covariance: Floats
    state_covariance: Floats
    next_covariance: Floats
    cross_covariance: Floats


def solve_arrow(system: ArrowSystem) -> ArrowSolution:
    """Solve an arrow system and return the covariances of everything that neighbours in it.

    Raises
    ------
    numpy.linalg.LinAlgError
        If the matrix is not positive definite.
    """
    n, d, p = system.border.shape
    per_block = max(1, _GATHERED // d)
    blocks = -(-n // per_block)
    inverses, gains, eliminated = _eliminate(*_gather(system, per_block, blocks))
    schur, corner_right, _ = _reduce(system, inverses, eliminated)
    factor = np.linalg.cholesky(0.5 * (schur + schur.T))
    whitener = np.linalg.inv(factor)
    corner_covariance = whitener.T @ whitener
    corner = corner_covariance @ corner_right
    solved, own, following = _substitute_back(inverses, gains, eliminated)
    z = solved[:, :, :p].reshape(blocks * per_block, d, p)[:n]
    states = solved[:, :, p].reshape(-1, d)[:n] - z @ corner
    cross = -z @ corner_covariance
    own_states, next_states = _spread(own, following, per_block, d, n)
    return ArrowSolution(
        states=states,
        corner=corner,
        corner_covariance=corner_covariance,
        state_covariance=own_states - cross @ np.swapaxes(z, 1, 2),
        next_covariance=next_states - cross[:-1] @ np.swapaxes(z[1:], 1, 2),
        cross_covariance=cross,
    )


def reduced_normal_equations(system: ArrowSystem, apart: int = 0) -> tuple[Floats, Floats, float]:
    """Return what is left when the states are eliminated.

    Parameters
    ----------
    apart : see `column_products`

    Returns
    -------
    (p, p) normal matrix and (p,) right-hand side of the border, and by how much the states lower the sum of squares
    """
    per_block = max(1, _GATHERED // system.border.shape[1])
    inverses, _, eliminated = _eliminate(*_gather(system, per_block, -(-len(system.border) // per_block)))
    return _reduce(system, inverses, eliminated, apart)


def column_products(a: Floats, b: Floats, apart: int = 0) -> Floats:
    """Return a'b (p, p), which is symmetric.

    The last `apart` columns are the first, second and third of each three that are tried without the others: what they
    make with those is left zero.
    """
    kept = a.shape[1] - apart
    if not apart:
        return a.T @ b
    found = np.zeros((a.shape[1], a.shape[1]))
    found[:kept] = a[:, :kept].T @ b
    found[kept:, :kept] = found[:kept, kept:].T
    numbers = np.arange(kept, a.shape[1]).reshape(3, -1)
    for i in range(3):
        for j in range(i + 1):
            one, other = numbers[i], numbers[j]
            own = np.einsum("rk,rk->k", a[:, one[0] : one[-1] + 1], b[:, other[0] : other[-1] + 1])
            found[one, other] = found[other, one] = own
    return found


def _reduce(
    system: ArrowSystem, inverses: list[Floats], eliminated: list[Floats], apart: int = 0
) -> tuple[Floats, Floats, float]:
    """Return the Schur complement, its right-hand side, and by how much the states lower the sum of squares."""
    p, lowered = len(system.corner), 0.0
    schur, right = system.corner.copy(), -system.corner_gradient
    for inverse, rhs in zip(inverses, eliminated, strict=True):
        half = inverse @ rhs
        schur -= column_products(rhs[:, :p], half[:, :p], apart)
        right = right - rhs[:, :p].T @ half[:, p]
        lowered += float(rhs[:, p] @ half[:, p])
    return schur, right, lowered


def _gather(system: ArrowSystem, per_block: int, blocks: int) -> tuple[Floats, Floats, Floats]:
    """Gather states into larger blocks; padding states are unit and alone. Right-hand sides: [border | -gradient]."""
    n, d, p = system.border.shape
    size = per_block * d
    diagonal = np.zeros((blocks, per_block, d, per_block, d))
    coupling = np.zeros((blocks, per_block, d, per_block, d))
    right = np.zeros((blocks * per_block, d, p + 1))
    right[:n, :, :p] = system.border
    right[:n, :, p] = -system.gradient
    index = np.arange(blocks * per_block)
    padded = np.tile(np.eye(d), (len(index), 1, 1))
    padded[:n] = system.diagonal
    diagonal[index // per_block, index % per_block, :, index % per_block, :] = padded
    k = np.arange(n - 1)
    inside = k[(k + 1) % per_block > 0]
    across = k[(k + 1) % per_block == 0]
    row, at = inside // per_block, inside % per_block
    diagonal[row, at, :, at + 1, :] = system.coupling[inside]
    diagonal[row, at + 1, :, at, :] = np.swapaxes(system.coupling[inside], 1, 2)
    coupling[across // per_block, per_block - 1, :, 0, :] = system.coupling[across]
    shape = (blocks, size, size)
    return diagonal.reshape(shape), coupling.reshape(shape), right.reshape(blocks, size, p + 1)


def _eliminate(diagonal: Floats, coupling: Floats, right: Floats) -> tuple[list[Floats], list[Floats], list[Floats]]:
    inverses: list[Floats] = []
    gains: list[Floats] = []
    eliminated: list[Floats] = []
    block, rhs = diagonal[0], right[0]
    for k in range(len(diagonal)):
        factor = np.linalg.inv(np.linalg.cholesky(block))
        inverses.append(factor.T @ factor)
        eliminated.append(rhs)
        if k + 1 < len(diagonal):
            gain = inverses[k] @ coupling[k]
            gains.append(gain)
            block = diagonal[k + 1] - coupling[k].T @ gain
            rhs = right[k + 1] - gain.T @ rhs
    return inverses, gains, eliminated


def _substitute_back(
    inverses: list[Floats], gains: list[Floats], eliminated: list[Floats]
) -> tuple[Floats, Floats, Floats]:
    """Return solutions of all right-hand sides and, of the inverse of the chain, diagonal and next blocks."""
    blocks, size = len(inverses), len(inverses[0])
    solved = np.empty((blocks, size, eliminated[0].shape[1]))
    own = np.empty((blocks, size, size))
    following = np.empty((max(blocks - 1, 0), size, size))
    solved[-1], own[-1] = inverses[-1] @ eliminated[-1], inverses[-1]
    for k in range(blocks - 2, -1, -1):
        solved[k] = inverses[k] @ eliminated[k] - gains[k] @ solved[k + 1]
        following[k] = -gains[k] @ own[k + 1]
        own[k] = inverses[k] - following[k] @ gains[k].T
    return solved, own, following


def _spread(own: Floats, following: Floats, per_block: int, d: int, n: int) -> tuple[Floats, Floats]:
    """Read the covariances of single states and of neighbours out of the gathered blocks."""
    blocks = len(own)
    grid = own.reshape(blocks, per_block, d, per_block, d)
    index = np.arange(n)
    states = grid[index // per_block, index % per_block, :, index % per_block, :]
    k = np.arange(n - 1)
    neighbours = np.empty((max(n - 1, 0), d, d))
    inside = k[(k + 1) % per_block > 0]
    across = k[(k + 1) % per_block == 0]
    neighbours[inside] = grid[inside // per_block, inside % per_block, :, inside % per_block + 1, :]
    if len(across):
        edge = following.reshape(blocks - 1, per_block, d, per_block, d)
        neighbours[across] = edge[across // per_block, per_block - 1, :, 0, :]
    return states, neighbours
