"""Pulls and information of stretches of time at the solution, the trajectory eliminated.

With the chain's matrix Hxx and the border Hxb, Z = Hxx^-1 Hxb says how the trajectory follows the border parameters.
Each row of the Jacobian, [J_x J_b] with residual e, then acts on them as J = J_b - J_x Z: a stretch of time pulls by
-sum J' e and has the information sum J' J. Over all stretches, with the priors, the pulls sum up to zero and the
information to the Schur complement.

The shifts o of the board's corners, where they are estimated, are eliminated along with the trajectory: hundreds of
them are too many for any number of stretches. They follow as o = A theta, which does not change the sums over all
stretches; one stretch left out leaves them as the whole recording has them.

The means of the biases over the recording, m = L x, get columns too: with W = Hxx^-1 L' (L Hxx^-1 L')^-1 those are
J_x W. They are independent of the others; the means themselves are m = mu - L Z theta.
"""

from collections.abc import Iterator
from itertools import pairwise

import numpy as np

from ....recording import Floats, Integers
from ...trust.clusters import ClusterSums
from ..batch import error_terms
from ..solution import Solution
from ..terms.assembly import (
    FIRST_BIAS_SIGMA,
    TRIAD,
    border_priors,
    by_span,
    random_walk_links,
    second_differences,
    taken_together,
)
from ..terms.visual_terms import VisualTerms, exposure_times
from ..trajectory import BIAS, POSE, KnotGrid, Trajectory

STRETCH_S = 0.5
"""Length of a stretch: short against the memory of residuals that matter."""

_MOST = 200


def bias_sides(solution: Solution) -> Integers:
    """Return the right-hand sides of the last linearisation that are the means of the biases, (6 m,)."""
    imus = len(solution.noise.imus)
    return 1 + 2 * imus + len(solution.noise.pixel_sigma) + np.arange(BIAS * imus)


def cluster_sums(solution: Solution) -> ClusterSums:
    """Return pulls and information of stretches of time of half a second, longer ones of a long recording.

    The columns are those of the layout before the board's corners, also the held ones, and behind them 6 for the biases
    of each IMU: a model that is compared, or a part of the recording, takes these along as free. Valid until the next
    linearisation in the solution's workspace.
    """
    trajectory, noise = solution.state.trajectory, solution.noise
    grid = trajectory.grid
    shifts = board_follows(solution)
    follows = _following(solution, shifts)
    stretch, t_s = _stretches(grid)
    sums = _Sums(len(t_s), follows.shape[2])
    visual = _add_measurements(sums, solution, follows, stretch, apart=len(shifts) > 0)
    if len(shifts):
        _add_board(sums, visual, follows, shifts=shifts, stretch=stretch)
    biases = trajectory.controls[:, POSE:]
    roots = np.sqrt(np.repeat(np.square(noise.walks).ravel(), TRIAD))
    for at, distance, time_s in random_walk_links(grid):
        scale = 1 / (roots * np.sqrt(time_s))
        rows = (follows[at + distance, POSE:] - follows[at, POSE:]) * scale[:, None]
        sums.add(stretch[at], rows, (biases[at] - biases[at + distance]) * scale)
    information, pull = _prior(solution, shifts)
    for rows, right in _hardly_priors(trajectory, follows):
        information += rows.T @ rows
        pull += right @ rows
    seen = sums.information.any(axis=(1, 2))
    return ClusterSums(
        t_s=t_s[seen],
        pull=sums.pull[seen],
        information=sums.information[seen],
        prior_pull=pull,
        prior_information=information,
    )


def board_follows(solution: Solution) -> Floats:
    """Return how the shifts of the board's corners follow the columns of the sums, (w, q); none where they are held."""
    layout, total = solution.layout, solution.step.factor.schur
    wide, dense = np.arange(layout.dense, len(layout)), layout.dense
    if not layout.free[wide].any():
        return np.zeros((0, dense + len(bias_sides(solution))))
    size = 1 / np.sqrt(np.diag(total)[wide])
    own = total[np.ix_(wide, wide)] * np.outer(size, size)
    found = -size[:, None] * np.linalg.solve(own, size[:, None] * total[wide, :dense])
    return np.pad(found, ((0, 0), (0, len(bias_sides(solution)))))


def _following(solution: Solution, shifts: Floats) -> Floats:
    """Return how the control points follow the columns of the sums, (n, d, q)."""
    factor, sides, dense = solution.step.factor, bias_sides(solution), solution.layout.dense
    columns = np.concatenate([np.arange(dense), dense + sides])
    memory = solution.lin.system.workspace.behind_a_factor((factor.controls, factor.size, len(columns)))
    found = factor.chain_solutions(columns, shifts if len(shifts) else None, memory)
    found[..., :dense] *= -1
    found[..., dense:] = found[..., dense:] @ np.linalg.inv(factor.inner(sides))
    return found


class _Sums:
    """Pulls and information of stretches that are being summed up."""

    def __init__(self, stretches: int, size: int) -> None:
        self.pull = np.zeros((stretches, size))
        self.information = np.zeros((stretches, size, size))

    def add(self, stretch: Integers, rows: Floats, right: Floats) -> None:
        """Add rows (n, r, q) and minus their residuals (n, r) of stretches (n,), ascending."""
        edges = np.flatnonzero(np.diff(stretch, prepend=-1, append=-1))
        for begin, end in pairwise(edges):
            number, flat = stretch[begin], rows[begin:end].reshape(-1, rows.shape[2])
            self.information[number] += flat.T @ flat
            self.pull[number] += right[begin:end].ravel() @ flat


def _add_measurements(
    sums: _Sums, solution: Solution, follows: Floats, stretch: Integers, *, apart: bool
) -> list[VisualTerms]:
    """Add the rows of all readings and corners, but for what shifts of the board's corners do.

    Returns
    -------
    list
        Error terms of the corners; `apart`, each stretch for itself in their `coupling`
    """
    state, grid, measurements = solution.state, solution.state.trajectory.grid, solution.measurements
    cameras = state.parameters.cameras
    seen = [grid.places(exposure_times(data, cameras[data.camera])) for data in measurements.visual]
    parts = [np.where(places.inside, stretch[places.first], 0) for places in seen]
    inertial, visual = error_terms(
        measurements, state, solution.layout, solution.noise, probing=False, parts=parts if apart else None
    )
    for term in (*inertial, *visual):
        columns = term.columns
        for part in taken_together(term):
            spans, rows = by_span(term.first[part], term.rows(part))
            reduced = rows[:, :, : columns.border] @ _local(follows, grid, spans, columns.imu)
            for to, own in columns.pieces:
                reduced[:, :, to] += rows[:, :, own]
            sums.add(stretch[spans], reduced, rows[:, :, columns.side])
    return visual


def _add_board(sums: _Sums, visual: list[VisualTerms], follows: Floats, *, shifts: Floats, stretch: Integers) -> None:
    """Add what the shifts of the board's corners do, stretch by stretch.

    With U the rows that are summed up already, and J_o the columns of the shifts, which follow by A,
    (U + J_o A)'(U + J_o A) lacks A'J_o'U + U'J_o A + A'J_o'J_o A.
    """
    for term in visual:
        coupling = term.coupling(1)
        assert coupling is not None
        moved = coupling.moved(follows)
        edges = np.searchsorted(stretch[coupling.first], np.arange(len(coupling.squares) + 1))
        for k, (start, stop) in enumerate(pairwise(edges.tolist())):
            if start == stop:
                continue
            flat = coupling.by_pose.pull(moved, start, stop)
            for at, border in coupling.border:
                flat[:, at] += border[k].T
            towards = shifts.T @ flat
            own = coupling.squares[k] @ shifts.reshape(-1, 3, shifts.shape[1])
            sums.information[k] += towards + towards.T + shifts.T @ own.reshape(flat.shape)
            sums.pull[k] += shifts.T @ coupling.sides[k, :, 0]


def _local(follows: Floats, grid: KnotGrid, spans: Integers, imu: int | None) -> Floats:
    """Return how the unknowns of spans, in the columns of their rows, follow the parameters, (s, w, q)."""
    parts = [follows[spans + k, :POSE] for k in range(grid.order)]
    if imu is not None:
        scalars = slice(POSE + BIAS * imu, POSE + BIAS * (imu + 1))
        parts += [follows[spans + grid.bias_offset + knot, scalars] for knot in (0, 1)]
    return np.concatenate(parts, axis=1)


def _prior(solution: Solution, shifts: Floats) -> tuple[Floats, Floats]:
    """Return information and pull of the priors of the border, and nothing about the biases."""
    layout, parameters, dense = solution.layout, solution.state.parameters, solution.layout.dense
    size = dense + BIAS * len(solution.noise.imus)
    if not len(layout):
        return np.zeros((size, size)), np.zeros(size)
    along = np.eye(len(layout), size)
    along[:dense, dense:], along[dense:] = 0.0, shifts if len(shifts) else 0.0
    information, pull, _ = border_priors(parameters, layout)
    return along.T @ information @ along, along.T @ pull


def _hardly_priors(trajectory: Trajectory, follows: Floats) -> Iterator[tuple[Floats, Floats]]:
    """Yield the rows (n, q) and minus the residuals (n,) of what holds the first biases, and the pose in gaps."""
    biases = trajectory.controls[0, POSE:]
    sigma = np.tile(np.repeat(FIRST_BIAS_SIGMA, TRIAD), len(biases) // BIAS)
    yield follows[0, POSE:] / sigma[:, None], -biases / sigma
    for at, weight in second_differences(trajectory.grid):
        rows = _second_difference(follows[:, :POSE], at, weight)
        right = -_second_difference(trajectory.controls[:, :POSE], at, weight)
        yield rows.reshape(-1, follows.shape[2]), right.ravel()


def _second_difference(values: Floats, at: Integers, weight: Floats) -> Floats:
    """Return three neighbours of values (n, ...) of the control points, weighed."""
    first, second, third = weight.tolist()
    return first * values[at] + second * values[at + 1] + third * values[at + 2]


def _stretches(grid: KnotGrid) -> tuple[Integers, Floats]:
    """Return the stretch that each control point's span lies in, (n,), and the middles of all stretches [s]."""
    start = grid.segments[0].start_s
    span_s = grid.segments[-1].start_s + grid.segments[-1].spans * grid.spacing_s - start
    count = max(1, min(round(span_s / STRETCH_S), _MOST))
    number: list[Integers] = []
    for segment in grid.segments:
        spans = np.minimum(np.arange(segment.spans + grid.order - 1), segment.spans - 1)
        since = segment.start_s - start + (spans + 0.5) * grid.spacing_s
        number.append(np.minimum((since * (count / span_s)).astype(np.int64), count - 1))
    return np.concatenate(number), np.asarray(start + (np.arange(count) + 0.5) * span_s / count, dtype=np.float64)
