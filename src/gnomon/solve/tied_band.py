"""Scalars of a long chain that change so slowly that one value for every super-block tells them.

All groups but the first, such as the biases beside the pose, are given at every (order - 1)-th control point, and lie
on straight lines between: with values v_k at control points c_k = k (order - 1) + offset, that of control point c_k + r
is (1 - u) v_k + u v_(k+1), u = r / (order - 1). Before the first and behind the last they stay as they are there. With
T the matrix of these weights the equations N x = b become T' N T y = T' b, x = T y. A super-block then has the first
group's scalars of its control points, and behind them one value of each of the others'.

A term that touches the first group's scalars of control points i to i + order - 1 may touch tied ones of i + offset and
of the one behind it; then N stays block tridiagonal. Tied groups may have terms of their own, of neighbours, but none
with each other.
"""

import numpy as np
from numpy.typing import NDArray

from ..frozen import value_class
from ..kernel import library

Floats = NDArray[np.float64]

_COLUMNS = 16  # that are folded at once: all of them would be a copy as large as what stands beside the band


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
