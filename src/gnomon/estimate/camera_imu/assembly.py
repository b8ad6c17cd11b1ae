"""From rows of the Jacobian to the normal equations.

A term of the cost at one instant touches the `order` pose control points of its span, the bias knots at the span's two
ends, and some border parameters. Its whitened rows are written into one small dense matrix a span; the products of all
terms of a span are summed up, and then added to the band, the border and the corner.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Protocol

import numpy as np

from ...recording import Floats, Integers
from ...solve.bordered_band import BorderedBand
from .trajectory import BIAS, POSE, Grid

TRIAD = 3
"""Scalars of the bias of one triad."""

_SPANS = 192  # spans that are summed up together: few calls, and their products still in the cache


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RowShape:
    """Columns of the rows of one kind of term.

    [order * 6 pose | 2 * 3 bias, if the term has one | border parameters | residual | probe, if wanted]

    Attributes
    ----------
    order : of the splines
    bias : first of the three bias scalars that the term reads, among those of all IMUs; None if it reads none
    border : (b,) columns of the border that the term touches
    probe : right-hand side of the probe, or None
    pose : number of columns of the pose control points
    border_columns : columns of the border parameters
    runs : (columns of the border, columns of the rows) of border parameters that follow each other
    residual : column of the whitened residual; the probe's is the next
    width : number of columns
    """

    order: int
    bias: int | None
    border: Integers
    probe: int | None
    pose: int = field(init=False)
    border_columns: slice = field(init=False)
    runs: tuple[tuple[slice, slice], ...] = field(init=False)
    residual: int = field(init=False)
    width: int = field(init=False)

    def __post_init__(self) -> None:
        pose = POSE * self.order
        start = pose + (0 if self.bias is None else 2 * TRIAD)
        residual = start + len(self.border)
        object.__setattr__(self, "pose", pose)
        object.__setattr__(self, "border_columns", slice(start, residual))
        object.__setattr__(self, "runs", _runs(self.border, start))
        object.__setattr__(self, "residual", residual)
        object.__setattr__(self, "width", residual + 1 + (self.probe is not None))


def _runs(border: Integers, start: int) -> tuple[tuple[slice, slice], ...]:
    if not len(border):
        return ()
    cuts = [0, *(np.flatnonzero(np.diff(border) != 1) + 1).tolist(), len(border)]
    return tuple(
        (slice(int(border[a]), int(border[b - 1]) + 1), slice(start + a, start + b)) for a, b in pairwise(cuts)
    )


class Term(Protocol):
    """Error terms of one sensor."""

    @property
    def first(self) -> Integers:
        """First control point of the span of each instant, (n,), ascending."""
        ...

    def rows(self, part: slice) -> Iterator[tuple[str, Floats, RowShape]]:
        """Yield (kind, whitened rows (n, r, w), their columns) of some instants."""
        ...


def groups(imus: int) -> tuple[int, ...]:
    """Return the groups of scalars of a control point: pose, then the biases of every IMU."""
    return (POSE, *(BIAS,) * imus)


def summed_up(system: BorderedBand, grid: Grid, terms: Iterable[Term]) -> dict[str, float]:
    """Add all terms to the normal equations; return the sum of squared residuals of each kind."""
    chi2: dict[str, float] = {}
    total = grid.controls - grid.order + 1
    sums = _SpanSums(system, grid, min(_SPANS, total))
    every = tuple(terms)
    for begin in range(0, total, _SPANS):
        count = min(_SPANS, total - begin)
        sums.clear()
        for term in every:
            first = term.first
            part = slice(int(np.searchsorted(first, begin)), int(np.searchsorted(first, begin + count)))
            if part.start == part.stop:
                continue
            for kind, rows, shape in term.rows(part):
                chi2[kind] = chi2.get(kind, 0.0) + sums.add(first[part] - begin, rows, shape)
        sums.flush(begin, count)
    return chi2


class _SpanSums:
    """Products of the rows of some spans: [pose | biases] by [pose | biases | border | right-hand sides]."""

    def __init__(self, system: BorderedBand, grid: Grid, spans: int) -> None:
        self._system = system
        self._order, self._offset = grid.order, grid.bias_offset
        self._pose = POSE * grid.order
        self._imus = len(system.groups) - 1
        self._tail = self._pose + 2 * BIAS * self._imus
        parameters, sides = system.corner_rhs.shape
        self._side = self._tail + parameters
        self._sums = np.zeros((spans, self._tail, self._side + sides))

    def clear(self) -> None:
        """Forget what was summed up."""
        self._sums[:] = 0.0

    def add(self, span: Integers, rows: Floats, shape: RowShape) -> float:
        """Add rows (n, r, w) of instants in spans (n,), ascending; return their sum of squared residuals."""
        begin = int(span[0])
        gram = _products(span - begin, rows)
        sums = self._sums[begin : begin + len(gram)]
        pose = slice(0, shape.pose)
        sums[:, pose, pose] += gram[:, pose, pose]
        self._add_tail(sums[:, pose], gram[:, pose], shape)
        if shape.bias is not None:
            places = [self._bias(shape.bias, knot) for knot in (0, 1)]
            columns = [slice(shape.pose + TRIAD * knot, shape.pose + TRIAD * (knot + 1)) for knot in (0, 1)]
            for knot in (0, 1):
                sums[:, pose, places[knot]] += gram[:, pose, columns[knot]]
                sums[:, places[knot], places[knot]] += gram[:, columns[knot], columns[knot]]
                self._add_tail(sums[:, places[knot]], gram[:, columns[knot]], shape)
            sums[:, places[0], places[1]] += gram[:, columns[0], columns[1]]
        total = gram[:, shape.border_columns].sum(axis=0)
        border = shape.border
        self._system.corner[np.ix_(border, border)] += total[:, shape.border_columns]
        self._system.corner_rhs[border, 0] -= total[:, shape.residual]
        if shape.probe is not None:
            self._system.corner_rhs[border, shape.probe] += total[:, shape.residual + 1]
        return float(gram[:, shape.residual, shape.residual].sum())

    def _bias(self, scalar: int, knot: int) -> slice:
        """Return the columns of three bias scalars, counted over all IMUs, at one end of the span."""
        imu, within = divmod(scalar, BIAS)
        start = self._pose + BIAS * (2 * imu + knot) + within
        return slice(start, start + TRIAD)

    def _add_tail(self, sums: Floats, gram: Floats, shape: RowShape) -> None:
        for border, columns in shape.runs:
            sums[:, :, self._tail + border.start : self._tail + border.stop] += gram[:, :, columns]
        sums[:, :, self._side] -= gram[:, :, shape.residual]
        if shape.probe is not None:
            sums[:, :, self._side + shape.probe] += gram[:, :, shape.residual + 1]

    def flush(self, begin: int, count: int) -> None:
        """Add the sums of `count` spans, which overlap each other, to the normal equations."""
        sums, k, offset = self._sums[:count], self._order, self._offset
        band, tail = self._system.band, self._system.tail

        def at(control: int) -> slice:
            return slice(begin + control, begin + control + count)

        for a in range(k):
            rows = sums[:, POSE * a : POSE * (a + 1)]
            band[0][0][at(a), :, : k - a] += rows[:, :, POSE * a : self._pose].reshape(count, POSE, k - a, POSE)
            tail[at(a), :POSE] += rows[:, :, self._tail :]
            for imu in range(self._imus):
                start = self._pose + 2 * BIAS * imu
                for knot in (0, 1):
                    columns = rows[:, :, start + BIAS * knot : start + BIAS * (knot + 1)]
                    apart = offset + knot - a
                    if apart >= 0:
                        band[0][1 + imu][at(a), :, apart] += columns
                    else:  # the bias stands at the earlier control point: it has the row
                        band[1 + imu][0][at(offset + knot), :, -apart] += columns.swapaxes(1, 2)
        for imu in range(self._imus):
            scalars = slice(POSE + BIAS * imu, POSE + BIAS * (imu + 1))
            start = self._pose + 2 * BIAS * imu
            own = band[1 + imu][1 + imu]
            for knot in (0, 1):
                rows = sums[:, start + BIAS * knot : start + BIAS * (knot + 1)]
                for other in range(knot, 2):
                    columns = slice(start + BIAS * other, start + BIAS * (other + 1))
                    own[at(offset + knot), :, other - knot] += rows[:, :, columns]
                tail[at(offset + knot), scalars] += rows[:, :, self._tail :]


def _products(span: Integers, rows: Floats) -> Floats:
    """Return the products J'J of the rows (n, r, w) of each span, (spans, w, w)."""
    lengths = np.bincount(span)
    count, most = len(lengths), int(lengths.max())
    n, r, w = rows.shape
    if n == count * most:
        padded = rows.reshape(count, most * r, w)
    else:
        padded = np.zeros((count, most, r, w))
        padded[span, np.arange(n) - np.repeat(np.cumsum(lengths) - lengths, lengths)] = rows
        padded = padded.reshape(count, most * r, w)
    return np.matmul(padded.transpose(0, 2, 1), padded)
