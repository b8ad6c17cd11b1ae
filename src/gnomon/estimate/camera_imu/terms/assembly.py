"""From rows of the Jacobian to the normal equations.

A term of the cost at one instant touches the `order` pose control points of its span, the bias knots at the span's two
ends, and some border parameters. Its whitened rows are written in columns that are the same for all terms of a span;
the products of all rows of a span are summed up, and then added to the band, the border and the corner.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from ....recording import Floats, Integers
from ....solve.bordered_band import BorderedBand
from ..trajectory import BIAS, POSE, Grid

TRIAD = 3
"""Scalars of the bias of one triad."""

_SPANS = 128  # spans that are summed up together: few calls, and their products still in the cache


@dataclass(frozen=True, slots=True, kw_only=True)
class Columns:
    """Columns of the rows of a span.

    [order * 6 pose | of every IMU: 6 bias at the first knot, 6 at the second | border | right-hand sides]

    The first right-hand side is minus the whitened residual, the others are probes.

    Attributes
    ----------
    order : of the splines
    imus : number of IMUs
    parameters : columns of the border
    sides : right-hand sides
    """

    order: int
    imus: int
    parameters: int
    sides: int

    @property
    def pose(self) -> int:
        """Number of columns of the pose control points."""
        return POSE * self.order

    def bias(self, imu: int, knot: int) -> slice:
        """Return the columns of the biases of an IMU at the first (0) or second (1) knot of the span."""
        start = self.pose + BIAS * (2 * imu + knot)
        return slice(start, start + BIAS)

    @property
    def border(self) -> int:
        """First column of the border."""
        return self.pose + 2 * BIAS * self.imus

    @property
    def side(self) -> int:
        """First column of the right-hand sides."""
        return self.border + self.parameters

    @property
    def width(self) -> int:
        """Number of columns."""
        return self.side + self.sides


class Term(Protocol):
    """Error terms of one sensor."""

    @property
    def first(self) -> Integers:
        """First control point of the span of each instant, (n,), ascending."""
        ...

    def rows(self, part: slice) -> Floats:
        """Return the whitened rows (n, r, w) of some instants."""
        ...


def groups(imus: int) -> tuple[int, ...]:
    """Return the groups of scalars of a control point: pose, then the biases of every IMU."""
    return (POSE, *(BIAS,) * imus)


def summed_up(system: BorderedBand, grid: Grid, columns: Columns, terms: Iterable[Term]) -> None:
    """Add all terms to the normal equations."""
    total = grid.controls - grid.order + 1
    sums = _SpanSums(system, columns, grid.bias_offset, min(_SPANS, total))
    every = tuple(terms)
    for begin in range(0, total, _SPANS):
        count = min(_SPANS, total - begin)
        sums.clear()
        for term in every:
            part = slice(*np.searchsorted(term.first, [begin, begin + count]).tolist())
            if part.start < part.stop:
                sums.add(term.first[part] - begin, term.rows(part))
        sums.flush(begin, count)


class _SpanSums:
    """Products of the rows of some spans: [pose | biases] by all columns."""

    def __init__(self, system: BorderedBand, columns: Columns, bias_offset: int, spans: int) -> None:
        self._system, self._columns, self._offset = system, columns, bias_offset
        self._sums = np.zeros((spans, columns.border, columns.width))
        self._empty = True

    def clear(self) -> None:
        """Forget what was summed up."""
        self._empty = True

    def add(self, span: Integers, rows: Floats) -> None:
        """Add rows (n, r, w) of instants in spans (n,), ascending."""
        columns = self._columns
        spans, gathered = by_span(span, rows)
        left = gathered[:, :, : columns.border].transpose(0, 2, 1)
        if self._empty and len(spans) == len(self._sums):
            np.matmul(left, gathered, out=self._sums)
        else:
            if self._empty:
                self._sums[:] = 0.0
            consecutive = spans[-1] - spans[0] + 1 == len(spans)
            at = slice(int(spans[0]), int(spans[-1]) + 1) if consecutive else spans
            self._sums[at] += np.matmul(left, gathered)
        self._empty = False
        tail = rows.reshape(-1, columns.width)[:, columns.border :]
        corner, p = tail.T @ tail, columns.parameters
        self._system.corner[:p, :p] += corner[:p, :p]
        self._system.corner_rhs[:p] += corner[:p, p:]

    def flush(self, begin: int, count: int) -> None:
        """Add the sums of `count` spans, which overlap each other, to the normal equations."""
        if self._empty:
            return
        columns, sums = self._columns, self._sums[:count]
        k, pose = columns.order, columns.pose
        band, tail = self._system.band, self._system.tail

        def at(control: int) -> slice:
            return slice(begin + control, begin + control + count)

        for a in range(k):
            rows = sums[:, POSE * a : POSE * (a + 1)]
            band[0][0][at(a), :, : k - a] += rows[:, :, POSE * a : pose].reshape(count, POSE, k - a, POSE)
            tail[at(a), :POSE] += rows[:, :, columns.border :]
            for imu in range(columns.imus):
                for knot in (0, 1):
                    found = rows[:, :, columns.bias(imu, knot)]
                    apart = self._offset + knot - a
                    if apart >= 0:
                        band[0][1 + imu][at(a), :, apart] += found
                    else:  # the bias stands at the earlier control point: it has the row
                        band[1 + imu][0][at(self._offset + knot), :, -apart] += found.swapaxes(1, 2)
        for imu in range(columns.imus):
            scalars = slice(POSE + BIAS * imu, POSE + BIAS * (imu + 1))
            own = band[1 + imu][1 + imu]
            for knot in (0, 1):
                rows, control = sums[:, columns.bias(imu, knot)], at(self._offset + knot)
                for other in range(knot, 2):
                    own[control, :, other - knot] += rows[:, :, columns.bias(imu, other)]
                tail[control, scalars] += rows[:, :, columns.border :]


def by_span(span: Integers, rows: Floats) -> tuple[Integers, Floats]:
    """Return the spans that have rows, (s,), and all rows of each, (s, m, w); zero rows fill up."""
    n, r, w = rows.shape
    starts = np.flatnonzero(np.diff(span, prepend=-1))
    lengths = np.diff(starts, append=n)
    most = int(lengths.max())
    if n == len(starts) * most:
        return span[starts], rows.reshape(len(starts), most * r, w)
    padded = np.zeros((len(starts), most, r, w))
    which = np.repeat(np.arange(len(starts)), lengths)
    padded[which, np.arange(n) - np.repeat(starts, lengths)] = rows
    return span[starts], padded.reshape(len(starts), most * r, w)
