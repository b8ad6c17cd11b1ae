"""Factorisations of symmetric equations: dense and banded ones by LAPACK, and those of a chain with a border.

A chain (`bordered_band`) is factorised from the first super-block to the last with a few dense operations a block, in
place: time and memory grow linearly with the chain. Right-hand sides and border are carried along, so that the Schur
complement of the border, and with it the covariance of the parameters, falls out.

The routines of BLAS and LAPACK are SciPy's, without what `import scipy.linalg` loads beside them: all of NumPy, with
f2py and the tests, which takes 0.2 s of CPU time, as much as a short calibration. So the two modules of routines are
loaded alone where SciPy has them; elsewhere the public ones, which have the same routines.
"""

import sys
from collections.abc import Callable, Iterator
from importlib import import_module
from importlib.machinery import PathFinder
from importlib.util import module_from_spec
from itertools import repeat
from typing import Any, Self

import numpy as np
import scipy
from numpy.typing import NDArray

from ..frozen import value_class
from .bordered_band import BorderedBand, TiedLayout, WideBorder

Floats = NDArray[np.float64]


def _routines(module: str) -> Any:
    spec = None
    if "scipy.linalg" not in sys.modules:
        spec = PathFinder.find_spec(f"scipy.linalg._f{module}", [f"{place}/linalg" for place in scipy.__path__])
    if spec is not None and spec.loader is not None:
        try:
            found = module_from_spec(spec)
            spec.loader.exec_module(found)
        except ImportError:
            pass
        else:
            return found
    return import_module(f"scipy.linalg.{module}")


_blas, _lapack = _routines("blas"), _routines("lapack")
dsyrk: Callable[..., Any] = _blas.dsyrk
dtrsm: Callable[..., Any] = _blas.dtrsm
dtrsv: Callable[..., Any] = _blas.dtrsv
dpotrf: Callable[..., Any] = _lapack.dpotrf
dpotrs: Callable[..., Any] = _lapack.dpotrs
dtrtri: Callable[..., Any] = _lapack.dtrtri


def solve_banded(lower: Floats, right: Floats) -> Floats:
    """Solve symmetric equations, of which entry [k, i] is that of row i + k and column i, (b, n), for (n, q) or (n,).

    Raises
    ------
    numpy.linalg.LinAlgError
        If the matrix is not positive definite.
    """
    _, found, failed = _lapack.dpbsv(lower, right, lower=1)
    if failed:
        raise np.linalg.LinAlgError(f"row {failed} of the banded equations is not positive definite")
    return np.asarray(found, dtype=np.float64).reshape(right.shape)


def solve_positive(matrix: Floats, right: Floats) -> Floats:
    """Solve symmetric equations (n, n) for right-hand sides (n, q).

    Raises
    ------
    numpy.linalg.LinAlgError
        If the matrix is not positive definite.
    """
    _, found, failed = _lapack.dposv(matrix.T, right, lower=1)
    if failed:
        raise np.linalg.LinAlgError(f"row {failed} of the equations is not positive definite")
    return np.asarray(found, dtype=np.float64)


@value_class
class Factor:
    """Block Cholesky factor of the chain, with border and right-hand sides eliminated.

    Attributes
    ----------
    lower : (b, s, s) Cholesky factors L of the super-blocks, transposed
    eliminated : (b, s + p + q, s) rows [L^-1 E | L^-1 F | L^-1 r] of each super-block, transposed
    schur : (p + w, p + w) Schur complement of the border parameters, the wide ones last
    schur_sides : (p + w, q) its right-hand sides
    controls, size : number of control points, scalars of each
    wide : the wide part of the border, or None
    ties : see `BorderedBand`
    """

    lower: Floats
    eliminated: Floats
    schur: Floats
    schur_sides: Floats
    controls: int
    size: int
    wide: WideBorder | None = None
    ties: TiedLayout | None = None

    @classmethod
    def of(cls, system: BorderedBand) -> Self:
        """Factorise equations; the factor is valid until the next one is made in the same workspace.

        Raises
        ------
        numpy.linalg.LinAlgError
            If the matrix is not positive definite.
        """
        p, q = system.border.shape[2], system.rhs.shape[2]
        lower, chain = system.gathered()
        blocks, s = lower.shape[:2]
        ahead = np.zeros((0, s))
        for k in range(blocks):
            if k:  # what block k - 1 sends on: its [E F r]' times its own E
                update = ahead @ ahead[:s].T
                lower[k] -= update[:s]
                chain[k, s:] -= update[s:]
            failed = dpotrf(lower[k].T, lower=1, clean=1, overwrite_a=1)[1]
            if failed:
                raise np.linalg.LinAlgError(f"super-block {k} of {blocks} is not positive definite")
            dtrsm(1.0, lower[k].T, chain[k].T, lower=1, overwrite_b=1)
            ahead = chain[k]
        total = np.zeros((p + q, p + q))
        for k in range(0, blocks, _TOGETHER):
            rows = chain[k : k + _TOGETHER, s:].swapaxes(0, 1).reshape(p + q, -1)
            total += rows @ rows.T
        schur, sides = system.corner.copy(), system.corner_rhs.copy()
        schur[:p, :p] -= total[:p, :p]
        sides[:p] -= total[:p, p:]
        factor = cls(
            lower=lower,
            eliminated=chain,
            schur=schur,
            schur_sides=sides,
            controls=len(system.border),
            size=sum(system.groups),
            wide=system.wide,
            ties=system.ties,
        )
        if system.wide is None or not system.wide.size:
            return factor
        taken, cross = _taken(system.wide, factor)
        schur[p:, p:] -= taken
        schur[p:, :p] -= cross[:p].T
        schur[:p, p:] -= cross[:p]
        sides[p:] -= cross[p:].T
        return factor

    @property
    def narrow(self) -> int:
        """Number p of border parameters that are not wide; they come first."""
        return len(self.schur) - (self.wide.size if self.wide is not None else 0)

    @property
    def _border(self) -> slice:
        s = self.lower.shape[1]
        return slice(s, s + self.narrow)

    def _side(self, side: int) -> int:
        return self.lower.shape[1] + self.narrow + side

    def quadratic(self, a: int, b: int, free: NDArray[np.intp], schur_inverse: Floats) -> float:
        """Return r_a' N^-1 r_b of two right-hand sides, with the border parameters outside of `free` held."""
        inner = float(np.sum(self.eliminated[:, self._side(a)] * self.eliminated[:, self._side(b)]))
        left, right = self.schur_sides[free, a], self.schur_sides[free, b]
        return inner + float(left @ schur_inverse @ right)

    def quadratics(self, right: Floats, free: NDArray[np.intp], schur_inverse: Floats) -> Floats:
        """Return R' N^-1 R (k, k) of right-hand sides (n, d, k) of the control points; see `quadratic`."""
        inner, _, sides = self.further_sides(right, np.zeros((self.narrow, right.shape[2])))
        return inner + sides[free].T @ schur_inverse @ sides[free]

    def further_sides(
        self, right: Floats, border: Floats, sides: NDArray[np.intp] | None = None
    ) -> tuple[Floats, Floats, Floats]:
        """Eliminate right-hand sides that the equations do not have.

        Parameters
        ----------
        right, border : (n, d, k) of the control points, (p, k) of the border
        sides : (q,) right-hand sides of the equations, none where not given

        Returns
        -------
        inner, with_sides : (k, k), (q, k) r_a' (band alone)^-1 r_b with each other, and with those of the equations
        schur_sides : (p + w, k) of the Schur complement
        """
        forward = self._forward(right)

        def product(rows: slice | NDArray[np.intp]) -> Floats:
            return np.tensordot(self.eliminated[:, rows], forward, axes=((0, 2), (0, 2)))

        schur_sides = border - product(self._border)
        if self.wide is not None:
            wide = sum(
                np.tensordot(rows, forward[first : first + len(rows)], axes=((0, 1), (0, 2)))
                for first, rows in _wide_rows(self.wide, self)
            )
            schur_sides = np.concatenate([schur_sides, -np.asarray(wide)])
        inner = np.tensordot(forward, forward, axes=((0, 2), (0, 2)))
        own = np.zeros(0, np.intp) if sides is None else sides
        return inner, product(self.lower.shape[1] + self.narrow + own), schur_sides

    def inner(self, sides: NDArray[np.intp]) -> Floats:
        """Return r_a' (band alone)^-1 r_b of all pairs of some right-hand sides."""
        rows = self.eliminated[:, self.lower.shape[1] + self.narrow + sides]
        return np.tensordot(rows, rows, axes=((0, 2), (0, 2)))

    def substituted(self, side: int, parameters: Floats) -> Floats:
        """Return the control points' part of the solution of N x = r, (n, d).

        Parameters
        ----------
        side : right-hand side
        parameters : (p + w,) the border parameters' part of the solution
        """
        blocks, s = self.lower.shape[:2]
        right = self.eliminated[:, self._side(side)] - parameters[: self.narrow] @ self.eliminated[:, self._border]
        if self.wide is not None and parameters[self.narrow :].any():
            right -= self._forward(self.wide.times(parameters[self.narrow :, None]))[:, 0]
        solution = np.empty((blocks, s))
        following = np.zeros(s)
        for k in range(blocks - 1, -1, -1):
            rhs = right[k] - following @ self.eliminated[k, :s]
            following = dtrsv(self.lower[k].T, rhs, lower=1, trans=1)
            solution[k] = following
        if self.ties is None:
            return solution.reshape(-1, self.size)[: self.controls]
        return self.ties.unfolded(solution)

    def chain_solutions(
        self, columns: NDArray[np.intp], wide: Floats | None = None, out: Floats | None = None
    ) -> Floats:
        """Return (band alone)^-1 C, (n, d, k), of some columns C of the border and, behind it, the right-hand sides.

        Parameters
        ----------
        columns : (k,) which
        wide : (w, k) by which the columns of the wide part are added to them
        out : (n, d, k) where to write
        """
        blocks, s = self.lower.shape[:2]
        found = np.empty((self.controls, self.size, len(columns))) if out is None else out
        beyond = None if wide is None or self.wide is None else self._forward(self.wide.times(wide))
        flat, ties = found.reshape(-1, len(columns)), self.ties
        tied = np.empty((blocks, 0 if ties is None else s - ties.own, len(columns)))
        following = np.zeros((len(columns), s))
        for k in range(blocks - 1, -1, -1):
            right = self.eliminated[k, s + columns]  # transposed: (k, s)
            right -= following @ self.eliminated[k, :s]
            if beyond is not None:
                right += beyond[k]
            dtrsm(1.0, self.lower[k].T, right.T, lower=1, trans_a=1, overwrite_b=1)
            if ties is None:
                flat[k * s : (k + 1) * s] = right.T[: len(flat) - k * s]
            else:
                tied[k] = ties.take(k, right.T, found)
            following = right
        if ties is not None:
            ties.spread(tied, found)
        return found

    def _forward(self, right: Floats) -> Floats:
        """Return L^-1 of right-hand sides (n, d, k), block by block and transposed (b, k, s)."""
        (blocks, s), count = self.lower.shape[:2], right.shape[2]
        flat = (right if self.ties is None else self.ties.folded(right)).reshape(-1, count)
        found = np.zeros((blocks, count, s))
        for k in range(blocks):
            part = flat[k * s : (k + 1) * s].T
            found[k, :, : part.shape[1]] = part
            if k:
                found[k] -= found[k - 1] @ self.eliminated[k - 1, :s].T
            dtrsm(1.0, self.lower[k].T, found[k].T, lower=1, overwrite_b=1)
        return found

    def marginals(self, free: NDArray[np.intp], schur_inverse: Floats) -> tuple[Floats, Floats]:
        """Return the covariances of super-blocks, with the border parameters' uncertainty in them.

        Returns
        -------
        own : (b, s, s) of every super-block
        following : (b - 1, s, s) between every super-block (rows) and the next one (columns)
        """
        blocks, s = self.lower.shape[:2]
        border, wide = s + free[free < self.narrow], free[free >= self.narrow] - self.narrow
        beyond = repeat(np.zeros((s, 0))) if self.wide is None else _wide_rows_back(self.wide, self)
        result, following = np.empty((blocks, s, s)), np.empty((max(blocks - 1, 0), s, s))
        own, z_next = np.zeros((s, s)), np.zeros((s, len(free)))
        for k in range(blocks - 1, -1, -1):
            inverse = dtrtri(self.lower[k].T, lower=1)[0]
            gain = inverse.T @ self.eliminated[k, :s].T
            own_border = np.concatenate([self.eliminated[k][border], next(beyond)[:, wide].T])
            z = inverse.T @ own_border.T - gain @ z_next
            spread = z @ schur_inverse
            if k + 1 < blocks:
                following[k] = spread @ z_next.T - gain @ own
            own = inverse.T @ inverse + gain @ own @ gain.T
            result[k] = own + spread @ z.T
            z_next = z
        return result, following

    def variances(self, marginals: tuple[Floats, Floats]) -> Floats:
        """Return the variances (n, d) of the control points' scalars from `marginals`."""
        own, following = marginals
        if self.ties is not None:
            return self.ties.variances(own, following)
        return np.einsum("bii->bi", own).reshape(-1, self.size)[: self.controls]


_TOGETHER = 8  # blocks whose products are summed up at once: fewer and larger calls


def _taken(wide: WideBorder, factor: Factor) -> tuple[Floats, Floats]:
    """Return F' (band alone)^-1 F of the wide part F of the border, (w, w), and of the rest with it, (p + q, w)."""
    s = factor.lower.shape[1]
    found, cross = np.zeros((wide.size, wide.size), order="F"), np.zeros((factor.eliminated.shape[1] - s, wide.size))
    for first, rows in _wide_rows(wide, factor):
        flat, others = rows.reshape(-1, wide.size), factor.eliminated[first : first + len(rows), s:]
        cross += others.swapaxes(0, 1).reshape(len(cross), -1) @ flat
        dsyrk(1.0, flat.T, beta=1.0, c=found, overwrite_c=1)
    return np.triu(found) + np.triu(found, 1).T, cross


def _wide_rows(wide: WideBorder, factor: Factor) -> Iterator[tuple[int, Floats]]:
    """Yield the first of some blocks, and L^-1 F of the wide border there, (b, s, w), valid until the next ones."""
    blocks, s = factor.lower.shape[:2]
    before, memory = np.zeros((s, wide.size)), np.zeros((_TOGETHER, s, wide.size))
    for first in range(0, blocks, _TOGETHER):
        yield first, _eliminated(wide, factor, first, before, memory)
        before = memory[-1].copy()


def _wide_rows_back(wide: WideBorder, factor: Factor) -> Iterator[Floats]:
    """Yield L^-1 F of the wide border, (s, w), from the last block to the first: made twice, all are never held."""
    memory = np.zeros((_TOGETHER, factor.lower.shape[1], wide.size))
    before = [memory[-1].copy(), *(rows[-1].copy() for _, rows in _wide_rows(wide, factor))]
    for number in range(len(before) - 2, -1, -1):
        yield from _eliminated(wide, factor, number * _TOGETHER, before[number], memory)[::-1]


def _eliminated(wide: WideBorder, factor: Factor, first: int, before: Floats, memory: Floats) -> Floats:
    """Return L^-1 F of the wide border of some blocks (b, s, w) in a memory, by that of the block before them."""
    (blocks, s), ties = factor.lower.shape[:2], factor.ties
    d, own = (factor.size, s) if ties is None else (ties.groups[0], ties.own)
    some, per_block = memory[: blocks - first], own // d
    given = wide.blocks(first * per_block, min(len(some) * per_block, factor.controls - first * per_block))
    some[:] = 0.0
    for k in range(len(some)):
        rows = some[k]
        part = given[k * per_block : (k + 1) * per_block]
        rows[:own].reshape(per_block, d, -1)[: len(part), : part.shape[1]] = part
        if first + k:
            rows -= factor.eliminated[first + k - 1, :s] @ before
        dtrsm(1.0, factor.lower[first + k].T, rows.T, side=1, lower=1, trans_a=1, overwrite_b=1)
        before = rows
    return some
