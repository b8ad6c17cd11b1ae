"""Normal equations of a long chain of control points and a border of parameters that touch all of them.

Each term of the cost touches `order` neighbouring control points, of d scalars each, and some of the p border
parameters. Gathered into super-blocks of order - 1 control points the matrix is block tridiagonal with a border,

    [ D0  E0            F0 ]
    [ E0' D1  E1        F1 ]
    [     E1' D2  ..    .. ]
    [ F0' F1' ..        C  ]

and is factorised from the first block to the last with a few dense operations a block, in place: time and memory grow
linearly with the chain. Right-hand sides and border are carried along, so that the Schur complement of the border, and
with it the covariance of the parameters, falls out.

Hundreds of parameters that are touched by a few numbers of each term, such as the corners of a board, would fill the
memory as columns of the border. They are the wide part of it: their rows of F are made when a block is eliminated, add
to the Schur complement, and are forgotten.
"""

from collections.abc import Iterator
from itertools import repeat
from math import prod
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ..frozen import value_class
from .lapack import dpotrf, dsyrk, dtrsm, dtrsv, dtrtri
from .tied_band import TiedLayout

Floats = NDArray[np.float64]


_LOWER, _CHAIN, _TAIL = "lower", "chain", "tail"
_OF_A_FACTOR = {_LOWER, _CHAIN}


class Workspace:
    """Memory that is used again from one iteration to the next.

    Fresh memory costs more than the arithmetic on it. Equations and factor that were made in a workspace are valid
    until the next ones are made in it.
    """

    def __init__(self) -> None:
        self._arrays: dict[str, Floats] = {}
        self._wide: WideBorder | None = None

    def take(self, wide: "WideBorder | None") -> None:
        """Take the wide border of the next equations; that of the last ones is released."""
        if self._wide is not None and self._wide is not wide:
            self._wide.release()
        self._wide = wide

    def zeros(self, name: str, shape: tuple[int, ...]) -> Floats:
        """Return an array of zeros under a name; what was there before is overwritten."""
        size = prod(shape)
        flat = self._arrays.get(name)
        if flat is None or len(flat) < size:
            flat = None  # before the larger one is made
            self._arrays.pop(name, None)
            flat = self._arrays[name] = np.zeros(size)
        else:
            flat[:size] = 0.0
        return flat[:size].reshape(shape)

    def behind_a_factor(self, shape: tuple[int, ...]) -> Floats:
        """Return an array in memory of the equations, of which the factor alone is needed on."""
        return self.zeros(_TAIL, shape)

    def beside_a_factor(self) -> "Workspace":
        """Return a workspace for other equations in the memory of these, of which the factor alone is needed on."""
        other = Workspace()
        other._arrays = {name: flat for name, flat in self._arrays.items() if name not in _OF_A_FACTOR}
        return other


class WideBorder(Protocol):
    """Border parameters whose coupling to the control points is made where it is needed."""

    @property
    def size(self) -> int:
        """Number of parameters."""
        ...

    def release(self) -> None:
        """Let go of the blocks: equations with them are no longer needed."""
        ...

    def times(self, parameters: Floats) -> Floats:
        """Return the product (n, d, k) of all blocks with values (size, k) of the parameters."""
        ...

    def blocks(self, first: int, count: int) -> Floats:
        """Return the blocks (count, g, size) of control points from `first` on, g the first of their d scalars."""
        ...


class BorderedBand:
    """Normal equations that are being summed up.

    The d scalars of a control point come in groups, such as its pose and its biases, so that what a term adds is
    contiguous in memory.

    Attributes
    ----------
    groups : sizes of the groups; they sum to d
    band : band[g][h] (n, size of g, order, size of h), entries [i, :, j, :] of group g of control point i (rows) and
        group h of control point i + j (columns); of a control point with itself (j = 0) one of [g][h] and [h][g]
        suffices, since the two are summed up, and of [g][g] both triangles are needed
    parameters : p, border parameters but for the wide ones
    border : (n, d, p) blocks of control points and border parameters
    rhs : (n, d, q) right-hand sides of the control points, such as the gradient
    tail : (n, d, p + q) both of them, one behind the other
    corner : (p + w, p + w), corner_rhs : (p + w, q) the same of the border parameters, the w wide ones last
    wide : the w further border parameters, or None
    ties : by which all groups but the first have one value for every super-block, or None; given is `tied`, the first
        control point that has one
    """

    def __init__(
        self,
        *,
        controls: int,
        order: int,
        groups: tuple[int, ...],
        parameters: int,
        sides: int,
        workspace: Workspace | None = None,
        wide: WideBorder | None = None,
        tied: int | None = None,
    ) -> None:
        self.wide = wide
        self.ties = (
            None if tied is None else TiedLayout(controls=controls, per_block=order - 1, groups=groups, offset=tied)
        )
        self.workspace = workspace or Workspace()
        self.workspace.take(wide)
        self.groups = groups
        self.order = order
        self.parameters = parameters
        self.band = [
            [self.workspace.zeros(f"band {g} {h}", (controls, a, order, b)) for h, b in enumerate(groups)]
            for g, a in enumerate(groups)
        ]
        self.tail = self.workspace.zeros(_TAIL, (controls, sum(groups), parameters + sides))
        self.border, self.rhs = self.tail[:, :, :parameters], self.tail[:, :, parameters:]
        total = parameters + (wide.size if wide is not None else 0)
        self.corner = np.zeros((total, total))
        self.corner_rhs = np.zeros((total, sides))

    def starts(self) -> list[int]:
        """Return the first scalar of every group, and their sum."""
        return [0, *np.cumsum(self.groups).tolist()]

    def damped(self, damping: float) -> None:
        """Add a fraction of the diagonal to the diagonal (Marquardt)."""
        for g in range(len(self.groups)):
            diagonal = np.einsum("nii->ni", self.band[g][g][:, :, 0, :])
            diagonal += damping * diagonal
        corner = np.einsum("ii->i", self.corner)
        corner += damping * corner

    def factorised(self) -> "Factor":
        """Return the factor, which is valid until the next one is made in the same workspace.

        Raises
        ------
        numpy.linalg.LinAlgError
            If the matrix is not positive definite.
        """
        return _factorise(self)


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


def _factorise(system: BorderedBand) -> Factor:
    p, q = system.border.shape[2], system.rhs.shape[2]
    lower, chain = _gathered(system)
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
    factor = Factor(
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


def _gathered(system: BorderedBand) -> tuple[Floats, Floats]:
    """Return the super-blocks on the diagonal (b, s, s), and [E | F | r] transposed (b, s + p + q, s).

    Transposed rows in C order are columns in Fortran order, so that LAPACK works in place.
    """
    n, d, p = system.border.shape
    order, q, ties = system.order, system.rhs.shape[2], system.ties
    if ties is not None:
        lower = system.workspace.zeros(_LOWER, (ties.blocks, ties.size, ties.size))
        chain = system.workspace.zeros(_CHAIN, (ties.blocks, ties.size + p + q, ties.size))
        ties.gather(system.band, system.tail, lower, chain)
        return lower, chain
    per_block = max(order - 1, 1)
    blocks, s = -(-n // per_block), per_block * d
    lower = system.workspace.zeros(_LOWER, (blocks, s, s))
    chain = system.workspace.zeros(_CHAIN, (blocks, s + p + q, s))
    diagonal = lower.reshape(blocks, per_block, d, per_block, d)
    ahead = chain[:, :s].reshape(blocks, per_block, d, per_block, d)  # E, transposed; a view
    starts = system.starts()
    pairs = [
        (g, slice(starts[g], starts[g + 1]), h, slice(starts[h], starts[h + 1]))
        for g, h in np.ndindex(len(system.groups), len(system.groups))
    ]
    for row in range(per_block):
        count = len(range(row, n, per_block))
        within = min(order, per_block - row)  # control points that are in the same block
        for g, rows, h, columns in pairs:
            part = system.band[g][h][row::per_block]
            diagonal[:count, row, rows, row : row + within, columns] = part[:, :, :within]
            ahead[:count, : order - within, columns, row, rows] = part[:, :, within:].transpose(0, 2, 3, 1)
        for g, rows, h, columns in pairs:
            if g != h:  # the control point with itself: its other triangle
                diagonal[:count, row, columns, row, rows] += np.swapaxes(system.band[g][h][row::per_block, :, 0], 1, 2)
    whole = n // per_block
    chain[:whole, s:] = system.tail[: whole * per_block].reshape(whole, s, p + q).transpose(0, 2, 1)
    chain[whole:, s:, : (n - whole * per_block) * d] = system.tail[whole * per_block :].reshape(-1, p + q).T
    # LAPACK reads one triangle only: the lower one of the Fortran view, the upper one of these rows.
    alone = np.arange((n - (blocks - 1) * per_block) * d, s)  # padding control points are unit and alone
    lower[-1, alone, alone] = 1.0
    return lower, chain
