"""From rows of the Jacobian to the normal equations.

A term of the cost at one instant touches the `order` pose control points of its span, the bias knots of one IMU at the
span's two ends, or none, and some border parameters. Its whitened rows are written in these columns alone, which are
the same for all instants of a sensor; the products of all rows of a span are summed up, and then added to the band, the
border and the corner.

The priors are added to the corner. Of the cameras together, what was known are their poses to cam0, along with their
lenses. With l the lenses' scalars and b the poses, both as small deviations from what was known, and P their joint
covariance,

    b given l:  mean  K l,  K = P_bl P_ll^-1,     covariance  P_bb - K P_lb

so that the residual b - K l and the prior of the lenses are independent, and together are the joint prior. A lens and
the rotation between two cameras hang together closely: a principal point that is off by a pixel turns the camera.
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Protocol

import numpy as np

from ....frozen import value_class
from ....geometry.rotations import invert_matrix, right_jacobian, rotvec_from_rotation, skew
from ....kernel import library
from ....recording import Floats, Integers, KnownRig
from ....solve.bordered_band import BorderedBand
from ..layout import BorderLayout, lenses_of
from ..parameters import RigParameters
from ..trajectory import BIAS, POSE, KnotGrid, Trajectory

FIRST_BIAS_SIGMA = (1.0, 10.0)
"""Of gyroscope [rad/s] and accelerometer [m/s^2]: hardly a prior."""

_SMOOTHNESS = 1e3  # rad/s^2 and m/s^2: what the trajectory does where nothing is measured
TRIAD = 3
"""Scalars of the bias of one triad."""

_TOGETHER = 1 << 19  # numbers of rows that are summed up together: few calls, and still in the cache


def add_walks(system: BorderedBand, trajectory: Trajectory, walks: tuple[tuple[float, float], ...]) -> float:
    """Add the random walk of the biases from knot to knot, and across the cuts between segments; return its cost.

    Parameters
    ----------
    walks : for each IMU, of gyroscope [rad/s/sqrt(s)] and accelerometer [m/s^2/sqrt(s)]
    """
    grid = trajectory.grid
    cost = 0.0
    for imu, walk in enumerate(walks):
        band = system.band[1 + imu][1 + imu]
        scalars = slice(POSE + BIAS * imu, POSE + BIAS * (imu + 1))
        bias, rhs = trajectory.controls[:, scalars], system.rhs[:, scalars, 0]
        variance = np.repeat(np.square(walk), TRIAD)
        for a, distance, time_s in random_walk_links(grid):
            information = 1 / (variance * time_s)
            difference = bias[a + distance] - bias[a]
            for i in range(BIAS):
                band[a, i, 0, i] += information[i]
                band[a + distance, i, 0, i] += information[i]
                band[a, i, distance, i] -= information[i]
            rhs[a] += information * difference
            rhs[a + distance] -= information * difference
            cost += 0.5 * float((information * difference**2).sum())
        information = np.repeat(FIRST_BIAS_SIGMA, TRIAD) ** -2.0
        band[0, np.arange(BIAS), 0, np.arange(BIAS)] += information
        rhs[0] -= information * bias[0]
        cost += 0.5 * float((information * bias[0] ** 2).sum())
    return cost


def random_walk_links(grid: KnotGrid) -> Iterator[tuple[Integers, int, float]]:
    """Yield which biases a random walk links: control points (n,), how much further the others are, and time [s]."""
    for number, segment in enumerate(grid.segments):
        yield segment.first + np.arange(segment.spans + grid.order - 2), 1, grid.spacing_s
        if number + 1 < len(grid.segments):
            gap = grid.segments[number + 1].start_s - segment.start_s - segment.spans * grid.spacing_s
            last = np.array([segment.first + grid.bias_offset + segment.spans])
            yield last, grid.order - 1, max(gap, grid.spacing_s)


def add_smoothness(system: BorderedBand, trajectory: Trajectory) -> None:
    """Hold second differences of the pose's control points small, by so little that only gaps notice."""
    for at, weight in second_differences(trajectory.grid):
        second = sum(weight[i] * trajectory.controls[at + i, :POSE] for i in range(3))
        for i in range(3):
            for j in range(i, 3):
                for scalar in range(POSE):
                    system.band[0][0][at + i, scalar, j - i, scalar] += weight[i] * weight[j]
            system.rhs[at + i, :POSE, 0] -= weight[i] * second


def second_differences(grid: KnotGrid) -> Iterator[tuple[Integers, Floats]]:
    """Yield the first (n,) of three control points in a row, and their weights (3,), segment by segment."""
    weight = np.array([1.0, -2.0, 1.0]) / (grid.spacing_s**2 * _SMOOTHNESS)
    for segment in grid.segments:
        yield segment.first + np.arange(segment.spans + grid.order - 3), weight


def add_priors(system: BorderedBand, parameters: RigParameters, layout: BorderLayout) -> float:
    """Add the priors of the border parameters; return the cost of those that are estimated."""
    if not len(layout):
        return 0.0
    information, pull, cost = border_priors(parameters, layout)
    system.corner += information
    system.corner_rhs[:, 0] += pull
    return cost


def border_priors(parameters: RigParameters, layout: BorderLayout) -> tuple[Floats, Floats, float]:
    """Return information (p, p) and pull (p,) of the priors, by a step of the border's scalars, and their cost."""
    known = layout.prior_information
    difference = layout.values(parameters) - layout.prior_mean
    dense = slice(layout.dense)  # the corners of a board behind them move as they are, each on its own
    jacobian = layout.values_jacobian(parameters)[dense, dense]
    information, towards = known.copy(), known @ difference
    information[dense, dense] = jacobian.T @ known[dense, dense] @ jacobian
    towards[dense] = jacobian.T @ towards[dense]
    free = np.where(layout.free, difference, 0.0)
    together, pull, cost = rig_prior(layout, parameters)
    return information + together, pull - towards, cost + 0.5 * float(free @ known @ free)


@dataclass(frozen=True, kw_only=True)
class Columns:
    """Columns of the rows of a sensor.

    [order * 6 pose | of its IMU: 6 bias at the first knot, 6 at the second | its border columns | right-hand sides]

    The first right-hand side is minus the whitened residual, the others are probes.

    Attributes
    ----------
    order : of the splines
    imu : whose biases, or None
    blocks : name -> columns of the whole border, of the blocks that the sensor touches, ascending
    sides : which right-hand sides of all it touches, the first one first
    """

    order: int
    imu: int | None
    blocks: dict[str, slice]
    sides: tuple[int, ...]

    @classmethod
    def of(
        cls,
        layout: BorderLayout,
        order: int,
        touched: Callable[[str], bool],
        *,
        imu: int | None,
        probes: tuple[int, ...],
    ) -> "Columns":
        """Return the columns of a sensor that touches the blocks of a layout of which a function says so."""
        blocks = {name: at for name, at in layout.columns.items() if at.start < layout.dense and touched(name)}
        return cls(order=order, imu=imu, blocks=blocks, sides=(0, *probes))

    @cached_property
    def pose(self) -> int:
        """Number of columns of the pose control points."""
        return POSE * self.order

    def bias(self, knot: int) -> slice:
        """Return the columns of the biases at the first (0) or second (1) knot of the span."""
        return slice(self.pose + BIAS * knot, self.pose + BIAS * (knot + 1))

    @cached_property
    def border(self) -> int:
        """First column of the border."""
        return self.pose + (0 if self.imu is None else 2 * BIAS)

    @cached_property
    def own(self) -> dict[str, slice]:
        """Block -> its columns in the rows."""
        found, begin = dict[str, slice](), self.border
        for name, at in self.blocks.items():
            found[name] = slice(begin, begin + at.stop - at.start)
            begin = found[name].stop
        return found

    @cached_property
    def pieces(self) -> list[tuple[slice, slice]]:
        """Columns of the whole border, and the same in the rows, as few and long as they go."""
        found: list[tuple[slice, slice]] = []
        for name, at in self.blocks.items():
            own = self.own[name]
            adjoins = bool(found) and found[-1][0].stop == at.start
            first, own_first = found.pop() if adjoins else (at, own)
            found.append((slice(first.start, at.stop), slice(own_first.start, own.stop)))
        return found

    @cached_property
    def side(self) -> int:
        """First column of the right-hand sides."""
        return self.border + sum(at.stop - at.start for at in self.blocks.values())

    @cached_property
    def width(self) -> int:
        """Number of columns."""
        return self.side + len(self.sides)


class Term(Protocol):
    """Error terms of one sensor."""

    @property
    def first(self) -> Integers:
        """First control point of the span of each instant, (n,), ascending."""
        ...

    @property
    def columns(self) -> Columns:
        """Columns of the rows."""
        ...

    @property
    def height(self) -> int:
        """Number of rows of each instant."""
        ...

    def rows(self, part: slice) -> Floats:
        """Return the whitened rows (n, r, w) of some instants."""
        ...

    def add_to(self, band: library.Band) -> Floats | None:
        """Add the products of all rows by the compiled kernel, and return those of the columns from the border on.

        None where that is to be done from the rows.
        """
        ...


def scalar_groups(imus: int) -> tuple[int, ...]:
    """Return the groups of scalars of a control point: pose, then the biases of every IMU."""
    return (POSE, *(BIAS,) * imus)


def summed_up(system: BorderedBand, grid: KnotGrid, terms: Iterable[Term]) -> None:
    """Add all terms to the normal equations."""
    compiled = library.load_kernel() is not None
    for term in terms:
        columns = term.columns
        if compiled and (corner := term.add_to(_compiled_band(system, columns, grid.bias_offset))) is not None:
            _add_corner(system, columns, corner)
            continue
        for part in taken_together(term):
            rows = term.rows(part)
            spans, gathered = by_span(term.first[part], rows)
            sums = np.matmul(gathered[:, :, : columns.border].transpose(0, 2, 1), gathered)
            _add_spans(system, columns, grid.bias_offset, spans, sums)
            tail = rows.reshape(-1, columns.width)[:, columns.border :]
            _add_corner(system, columns, tail.T @ tail)


def taken_together(term: Term) -> Iterator[slice]:
    """Yield instants that are summed up together: whole spans."""
    first = term.first
    if not len(first):
        return
    begins = np.flatnonzero(np.diff(first, prepend=-1))
    most = max(_TOGETHER * len(begins) // (len(first) * term.height * term.columns.width), 1)
    for begin, end in pairwise([*begins[::most].tolist(), len(first)]):
        yield slice(begin, end)


def _add_spans(system: BorderedBand, columns: Columns, offset: int, spans: Integers, sums: Floats) -> None:
    """Add the sums (s, border, w) of some spans (s,), which overlap each other, to the normal equations."""
    if library.load_kernel() is not None:
        library.add_spans(sums, spans, _compiled_band(system, columns, offset))
        return
    k, pose, count = columns.order, columns.pose, len(spans)
    band, tail = system.band, system.tail
    consecutive = int(spans[-1] - spans[0]) + 1 == count
    sides = [
        (slice(to, to + 1), slice(own, own + 1))
        for to, own in zip(system.parameters + np.array(columns.sides), range(columns.side, columns.width), strict=True)
    ]

    def at(control: int) -> slice | Integers:
        return slice(int(spans[0]) + control, int(spans[0]) + control + count) if consecutive else spans + control

    def add_tail(control: slice | Integers, scalars: slice, rows: Floats) -> None:
        for to, own in (*columns.pieces, *sides):
            tail[control, scalars, to] += rows[:, :, own]

    for a in range(k):
        rows, control = sums[:, POSE * a : POSE * (a + 1)], at(a)
        band[0][0][control, :, : k - a] += rows[:, :, POSE * a : pose].reshape(count, POSE, k - a, POSE)
        add_tail(control, slice(0, POSE), rows)
        if columns.imu is None:
            continue
        for knot in (0, 1):
            found, apart = rows[:, :, columns.bias(knot)], offset + knot - a
            if apart >= 0:
                band[0][1 + columns.imu][control, :, apart] += found
            else:  # the bias stands at the earlier control point: it has the row
                band[1 + columns.imu][0][at(offset + knot), :, -apart] += found.swapaxes(1, 2)
    if columns.imu is None:
        return
    own = band[1 + columns.imu][1 + columns.imu]
    for knot in (0, 1):
        rows, control = sums[:, columns.bias(knot)], at(offset + knot)
        for other in range(knot, 2):
            own[control, :, other - knot] += rows[:, :, columns.bias(other)]
        add_tail(control, slice(POSE + BIAS * columns.imu, POSE + BIAS * (columns.imu + 1)), rows)


def _compiled_band(system: BorderedBand, columns: Columns, offset: int) -> library.Band:
    """Return the normal equations as the compiled kernel takes them."""
    band, imu = system.band, columns.imu
    of_biases = (None,) * 3 if imu is None else (band[0][1 + imu], band[1 + imu][0], band[1 + imu][1 + imu])
    border = [np.arange(to.start, to.stop) for to, _ in columns.pieces]
    return library.Band(
        order=columns.order,
        bias_offset=offset,
        band=(band[0][0], *of_biases),
        tail=system.tail,
        bias_at=POSE + BIAS * (imu or 0),
        columns=np.concatenate([*border, system.parameters + np.array(columns.sides)]),
    )


def _add_corner(system: BorderedBand, columns: Columns, products: Floats) -> None:
    """Add the products of the rows' last columns, from the border on, to the normal equations of the border."""
    start, side = columns.border, columns.side - columns.border
    for to, own in columns.pieces:
        rows = products[own.start - start : own.stop - start]
        for other, columns_of in columns.pieces:
            system.corner[to, other] += rows[:, columns_of.start - start : columns_of.stop - start]
        system.corner_rhs[to, columns.sides] += rows[:, side:]


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


_POSE_ROWS = 6


@value_class
class RigResidual:
    """Poses against what was known of them.

    Attributes
    ----------
    names : (k,) scalars, such as "cam1.T_cam_cam0.rotation[0]"
    residual : (k,) small rotations [rad] and differences of translations [m]
    jacobian : (k, p) derivative by a step of the border's scalars
    """

    names: tuple[str, ...]
    residual: Floats
    jacobian: Floats


def pose_residual(rig: KnownRig, layout: BorderLayout, parameters: RigParameters) -> RigResidual:
    """Return how far the poses of the cameras to cam0 are from what was known."""
    names: list[str] = []
    residual: list[Floats] = []
    jacobian: list[Floats] = []
    cameras = {entry.name: entry for entry in parameters.cameras}
    for name, known in rig.T_cam_cam0.items():
        one, other = cameras["cam0"], cameras[name]
        R = other.R_cam_imu @ one.R_cam_imu.T
        turn = rotvec_from_rotation(known[:3, :3].T @ R)
        moved = other.p_cam_imu - R @ one.p_cam_imu - known[:3, 3]
        straight = invert_matrix(right_jacobian(turn)) @ one.R_cam_imu
        around = R @ skew(one.p_cam_imu) @ one.R_cam_imu
        rows = np.zeros((_POSE_ROWS, len(layout)))
        for block, by_turn, by_place in (("cam0", (-straight, -around), -R), (name, (straight, around), np.eye(3))):
            if (columns := layout.get(f"{block}.T_cam_imu.rotation")) is not None:
                rows[:3, columns], rows[3:, columns] = by_turn
            if (columns := layout.get(f"{block}.T_cam_imu.translation")) is not None:
                rows[3:, columns] = by_place
        names += [f"{name}.T_cam_cam0.{part}[{k}]" for part in ("rotation", "translation") for k in range(3)]
        residual += [turn, moved]
        jacobian.append(rows)
    empty = np.zeros((0, len(layout)))
    return RigResidual(
        names=tuple(names),
        residual=np.concatenate(residual) if residual else np.empty(0),
        jacobian=np.vstack(jacobian) if jacobian else empty,
    )


def from_known(rig: KnownRig, layout: BorderLayout, parameters: RigParameters) -> RigResidual:
    """Return how far all that is known of the cameras together, lenses and poses, is from what was known."""
    poses = pose_residual(rig, layout, parameters)
    column = {name: i for i, name in enumerate(layout.names)}
    lenses = [name for name in lenses_of(rig, parameters)[0] if name in column]
    at = [column[name] for name in lenses]
    away = layout.values(parameters) - layout.prior_mean
    return RigResidual(
        names=(*lenses, *poses.names),
        residual=np.concatenate([away[at], poses.residual]),
        jacobian=np.vstack([np.eye(len(layout))[at], poses.jacobian]),
    )


def rig_prior(layout: BorderLayout, parameters: RigParameters) -> tuple[Floats, Floats, float]:
    """Return information (p, p) and pull (p,) of what is known of the poses, given the lenses, and its cost."""
    rig, size = layout.start.rig, len(layout)
    if rig is None or not rig.T_cam_cam0:
        return np.zeros((size, size)), np.zeros(size), 0.0
    found = pose_residual(rig, layout, parameters)
    lenses, of_lenses = lenses_of(rig, parameters)
    place = {name: i for i, name in enumerate(rig.names)}
    at, told = [place[name] for name in found.names], [place[name] for name in lenses]
    known = np.flatnonzero(np.diag(of_lenses) > 0)
    lenses, told = [lenses[i] for i in known], [told[i] for i in known]
    gain = np.linalg.solve(of_lenses[np.ix_(known, known)], rig.covariance[np.ix_(told, at)]).T
    covariance = rig.covariance[np.ix_(at, at)] - gain @ rig.covariance[np.ix_(told, at)]
    column = {name: i for i, name in enumerate(layout.names)}
    away, jacobian = layout.values(parameters) - layout.prior_mean, found.jacobian.copy()
    residual = found.residual.copy()
    for i, name in enumerate(lenses):
        if name in column:
            residual -= gain[:, i] * away[column[name]]
            jacobian[:, column[name]] -= gain[:, i]
    scale = 1 / np.sqrt(np.diag(covariance))
    whole = np.linalg.inv(covariance * np.outer(scale, scale)) * np.outer(scale, scale)
    return jacobian.T @ whole @ jacobian, -jacobian.T @ whole @ residual, 0.5 * float(residual @ whole @ residual)
