"""Normal equations of a long chain of control points and a border of parameters that touch all of them.

Each term of the cost touches `order` neighbouring control points, of d scalars each, and some of the p border
parameters. Gathered into super-blocks of order - 1 control points the matrix is block tridiagonal with a border,

    [ D0  E0            F0 ]
    [ E0' D1  E1        F1 ]
    [     E1' D2  ..    .. ]
    [ F0' F1' ..        C  ]

which `factorisation.Factor` factorises in place.

Hundreds of parameters that are touched by a few numbers of each term, such as the corners of a board, would fill the
memory as columns of the border. They are the wide part of it: their rows of F are made when a block is eliminated, add
to the Schur complement, and are forgotten.

Some scalars change so slowly that one value for every super-block tells them. All groups of a tied chain but the first,
such as the biases beside the pose, are given at every (order - 1)-th control point, and lie on straight lines between:
with values v_k at control points c_k = k (order - 1) + offset, that of control point c_k + r is (1 - u) v_k + u
v_(k+1), u = r / (order - 1). Before the first and behind the last they stay as they are there. With T the matrix of
these weights the equations N x = b become T' N T y = T' b, x = T y. A super-block then has the first group's scalars of
its control points, and behind them one value of each of the others'.

A term that touches the first group's scalars of control points i to i + order - 1 may touch tied ones of i + offset and
of the one behind it; then N stays block tridiagonal. Tied groups may have terms of their own, of neighbours, but none
with each other.
"""

from math import prod
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ..frozen import value_class
from ..kernel import library

Floats = NDArray[np.float64]

_LOWER, _CHAIN, _TAIL = "lower", "chain", "tail"
_OF_A_FACTOR = {_LOWER, _CHAIN}
_COLUMNS = 16  # that are folded at once: all of them would be a copy as large as what stands beside the band


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


@value_class(eq=True)
class TiedLayout:
    """Where the scalars of super-blocks are.

    Attributes
    ----------
    controls : n, number of control points
    per_block : order - 1, control points of a super-block
    groups : sizes of the groups, the first one and the tied ones; they sum to d
    offset : first control point whose tied scalars are given
    """

    controls: int
    per_block: int
    groups: tuple[int, ...]
    offset: int

    @property
    def blocks(self) -> int:
        """Number b of super-blocks."""
        return -(-self.controls // self.per_block)

    @property
    def own(self) -> int:
        """Scalars of the first group in a super-block; the others stand behind them."""
        return self.per_block * self.groups[0]

    @property
    def size(self) -> int:
        """Scalars of a super-block."""
        return self.own + sum(self.groups[1:])

    def folded(self, values: Floats) -> Floats:
        """Return T' values (n, d, k), super-block by super-block, (b, s, k)."""
        first, blocks = self.groups[0], self.blocks
        found = np.zeros((blocks, self.size, values.shape[2]))
        whole = found[:, : self.own].reshape(blocks, self.per_block, first, -1)  # a view
        for row in range(self.per_block):
            part = values[row :: self.per_block, :first]
            whole[: len(part), row] = part
        tied = np.zeros((blocks + 1, self.size - self.own, values.shape[2]))
        for r, u in self._weights():
            part = values[self.offset + r :: self.per_block, first:]
            tied[: len(part)] += (1 - u) * part
            tied[1 : len(part) + 1] += u * part
        tied[0] += values[: self.offset, first:].sum(axis=0)
        tied[-2] += tied[-1]
        found[:, self.own :] = tied[:-1]
        return found

    def unfolded(self, values: Floats) -> Floats:
        """Return T values (b, s), (n, d)."""
        found = np.empty((self.controls, sum(self.groups), 1))
        for block, own in enumerate(values):
            self.take(block, own[:, None], found)
        self.spread(values[:, self.own :, None], found)
        return found[:, :, 0]

    def take(self, block: int, values: Floats, out: Floats) -> Floats:
        """Write values (s, k) of a super-block's first group to their places in (n, d, k); return the tied ones."""
        first = slice(block * self.per_block, (block + 1) * self.per_block)
        part = out[first, : self.groups[0]]
        part[:] = values[: self.own].reshape(self.per_block, self.groups[0], -1)[: len(part)]
        return values[self.own :]

    def spread(self, tied: Floats, out: Floats) -> None:
        """Write what tied values (b, t, k) are at the control points to (n, d, k)."""
        begin, tied = self.groups[0], np.concatenate([tied, tied[-1:]])
        for r, u in self._weights():
            part = out[self.offset + r :: self.per_block, begin:]
            part[:] = (1 - u) * tied[: len(part)] + u * tied[1 : len(part) + 1]
        out[: self.offset, begin:] = tied[0]

    def variances(self, own: Floats, following: Floats) -> Floats:
        """Return the variances (n, d) from the covariances of super-blocks, and those between each and the next one."""
        at, found = slice(self.own, self.size), np.empty((self.controls, sum(self.groups), 1))
        diagonal = np.einsum("bii->bi", own)
        for block, values in enumerate(diagonal):
            self.take(block, values[:, None], found)
        tied = diagonal[:, at, None]
        self.spread(tied, found)
        between = np.zeros((len(own) + 1, *tied.shape[1:]))
        between[:-2] = np.einsum("bii->bi", following[:, at, at])[:, :, None]
        between[-2] = tied[-1]
        bent = 0.5 * (tied + np.concatenate([tied[1:], tied[-1:]])) - between[:-1]
        for r, u in self._weights():  # (1 - u)^2 a + u^2 b + 2 u (1 - u) c = (1 - u) a + u b - 2 u (1 - u) bent
            part = found[self.offset + r :: self.per_block, self.groups[0] :]
            part -= 2 * u * (1 - u) * bent[: len(part)]
        return found[:, :, 0]

    def gather(self, band: list[list[Floats]], tail: Floats, lower: Floats, chain: Floats) -> None:
        """Write T' N T: blocks on the diagonal (b, s, s), and transposed those after them and T' tail (b, s + t, s).

        Of the diagonal ones the part right of the diagonal is written, which is the triangle that LAPACK reads.
        """
        if library.load_kernel() is not None:
            library.gather_tied(
                per_block=self.per_block,
                offset=self.offset,
                groups=self.groups,
                band=band,
                tail=tail,
                lower=lower,
                chain=chain,
            )
            return
        for begin in range(0, tail.shape[2], _COLUMNS):
            some = slice(begin, begin + _COLUMNS)
            chain[:, self.size :][:, some] = np.swapaxes(self.folded(tail[:, :, some]), 1, 2)
        self._gather_first(band[0][0], lower, chain)
        padding = np.arange(self.controls * self.groups[0] - (self.blocks - 1) * self.own, self.own)
        lower[-1, padding, padding] = 1.0  # control points that are not there are unit and alone
        begin = self.own
        for group, size in enumerate(self.groups[1:], 1):
            at = slice(begin, begin + size)
            self._gather_coupling(band[0][group], band[group][0], at, lower, chain)
            self._gather_tied(band[group][group], at, lower, chain)
            begin += size

    def _gather_first(self, band: Floats, lower: Floats, chain: Floats) -> None:
        d, per_block = self.groups[0], self.per_block
        for row in range(per_block):
            part = band[row::per_block]
            rows = slice(d * row, d * (row + 1))
            for j in range(per_block + 1):
                column = row + j
                at = slice(d * (column % per_block), d * (column % per_block + 1))
                if column < per_block:
                    lower[: len(part), rows, at] = part[:, :, j]
                else:
                    chain[: len(part), at, rows] = np.swapaxes(part[:, :, j], 1, 2)

    def _gather_coupling(self, later: Floats, earlier: Floats, at: slice, lower: Floats, chain: Floats) -> None:
        """Add the products of the first group with a tied one at later (n, d, order, t) or earlier control points."""
        d, per_block, blocks = self.groups[0], self.per_block, self.blocks
        for row, j in np.ndindex(per_block, per_block + 2):
            j = j + self.offset - per_block  # noqa: PLW2901
            rows = slice(d * row, d * (row + 1))
            begin = max(0, -((row + j - self.offset) // per_block))  # first block in which the tied one is there
            stop = (self.controls - 1 - row - max(j, 0)) // per_block + 1
            if stop <= begin:
                continue
            first = slice(row + begin * per_block, row + (stop - 1) * per_block + 1, per_block)
            tied = slice(first.start + j, first.stop + j, per_block)
            part = later[first, :, j] if j >= 0 else np.swapaxes(earlier[tied, :, -j], 1, 2)
            if j == 0:
                part = part + np.swapaxes(earlier[first, :, 0], 1, 2)
            ahead, r = divmod(row + j - self.offset, per_block)
            for block, weight in ((ahead, 1 - r / per_block), (ahead + 1, r / per_block)):
                if not weight:
                    continue
                if block == 0:
                    lower[begin:stop, rows, at] += weight * part
                elif block > 0:
                    chain[begin:stop, at, rows] += weight * np.swapaxes(part, 1, 2)
                else:
                    skipped = max(1 - begin, 0)  # no block before the first
                    chain[begin + skipped - 1 : stop - 1, rows, at] += weight * part[skipped:]
        lower[blocks - 1, : self.own, at] += chain[blocks - 1, at, : self.own].T
        chain[blocks - 1, at, : self.own] = 0.0

    def _gather_tied(self, band: Floats, at: slice, lower: Floats, chain: Floats) -> None:
        """Add the products (n, t, order, t) of a tied group with itself, of control points and their next ones."""
        size = band.shape[1]
        on, after = (np.zeros((self.blocks + 1, size, size)) for _ in range(2))
        for r, u in self._weights():
            part = band[self.offset + r :: self.per_block]
            count, then = len(part), u + 1 / self.per_block
            same, following = part[:, :, 0], part[:, :, 1]
            both = following + np.swapaxes(following, 1, 2)
            on[:count] += (1 - u) ** 2 * same + (1 - u) * (1 - then) * both
            on[1 : count + 1] += u**2 * same + u * then * both
            after[:count] += (1 - u) * u * same + (1 - u) * then * following
            after[:count] += u * (1 - then) * np.swapaxes(following, 1, 2)
        start = band[: self.offset]
        on[0] += start[:, :, 0].sum(axis=0) + start[:, :, 1].sum(axis=0) + start[:, :, 1].sum(axis=0).T
        on[-2] += on[-1] + after[-2] + after[-2].T
        lower[:, at, at] = on[:-1]
        chain[:-1, at, at] = np.swapaxes(after[:-2], 1, 2)

    def _weights(self) -> list[tuple[int, float]]:
        return [(r, r / self.per_block) for r in range(self.per_block)]


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

    def gathered(self) -> tuple[Floats, Floats]:
        """Return the super-blocks on the diagonal (b, s, s), and [E | F | r] transposed (b, s + p + q, s).

        Transposed rows in C order are columns in Fortran order, so that LAPACK works in place.
        """
        n, d, p = self.border.shape
        order, q, ties = self.order, self.rhs.shape[2], self.ties
        if ties is not None:
            lower = self.workspace.zeros(_LOWER, (ties.blocks, ties.size, ties.size))
            chain = self.workspace.zeros(_CHAIN, (ties.blocks, ties.size + p + q, ties.size))
            ties.gather(self.band, self.tail, lower, chain)
            return lower, chain
        per_block = max(order - 1, 1)
        blocks, s = -(-n // per_block), per_block * d
        lower = self.workspace.zeros(_LOWER, (blocks, s, s))
        chain = self.workspace.zeros(_CHAIN, (blocks, s + p + q, s))
        diagonal = lower.reshape(blocks, per_block, d, per_block, d)
        ahead = chain[:, :s].reshape(blocks, per_block, d, per_block, d)  # E, transposed; a view
        starts = self.starts()
        pairs = [
            (g, slice(starts[g], starts[g + 1]), h, slice(starts[h], starts[h + 1]))
            for g, h in np.ndindex(len(self.groups), len(self.groups))
        ]
        for row in range(per_block):
            count = len(range(row, n, per_block))
            within = min(order, per_block - row)  # control points that are in the same block
            for g, rows, h, columns in pairs:
                part = self.band[g][h][row::per_block]
                diagonal[:count, row, rows, row : row + within, columns] = part[:, :, :within]
                ahead[:count, : order - within, columns, row, rows] = part[:, :, within:].transpose(0, 2, 3, 1)
            for g, rows, h, columns in pairs:
                if g != h:  # the control point with itself: its other triangle
                    diagonal[:count, row, columns, row, rows] += np.swapaxes(
                        self.band[g][h][row::per_block, :, 0], 1, 2
                    )
        whole = n // per_block
        chain[:whole, s:] = self.tail[: whole * per_block].reshape(whole, s, p + q).transpose(0, 2, 1)
        chain[whole:, s:, : (n - whole * per_block) * d] = self.tail[whole * per_block :].reshape(-1, p + q).T
        # LAPACK reads one triangle only: the lower one of the Fortran view, the upper one of these rows.
        alone = np.arange((n - (blocks - 1) * per_block) * d, s)  # padding control points are unit and alone
        lower[-1, alone, alone] = 1.0
        return lower, chain
