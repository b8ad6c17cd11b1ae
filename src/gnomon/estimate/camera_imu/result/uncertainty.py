"""The covariance of everything that a calibration publishes, and what held parameters would have done.

Beside the free parameters theta, the means of the biases over the recording are published, m = L x. Solving the normal
equations with L as further right-hand sides gives their covariance and that with theta. A parameter c that was held at
a value of its own uncertainty (gravity) adds (d theta / d c) sigma_c; one that was held without need (the size of the
board, the intrinsics) is tested by the step that it would take if it were free.

The equations count all errors as independent. What a recording really shows, clusters of time tell: by the pulls
and the information of stretches of time at the solution, the trajectory eliminated (`cluster_sums`).

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

from collections.abc import Iterator, Mapping
from dataclasses import replace
from itertools import pairwise

import numpy as np

from ....frozen import value_class
from ....recording import Floats, Integers
from ....results.trust import Clusters
from ...trust.changes import estimates_are_judged
from ...trust.clusters import (
    ClusterSums,
    correlation_time,
    group_into_clusters,
    leave_clusters_out,
    robust_variances,
    whole_estimate,
)
from ..batch import error_terms, mean_weights
from ..gauss_newton import GaussNewtonStep
from ..layout import BorderLayout
from ..parameters import CameraParameters, RigParameters
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

_FEWEST_STRETCHES = 12
_ASKED = 3.0  # sigmas
_LEAST_MEMORY = 1
_LENS = ".intrinsics"
"""Stretches: the trajectory that is fitted to them makes neighbouring ones alike, however white the noise is."""


@value_class
class FixedParameterEffect:
    """What a held parameter would do.

    Attributes
    ----------
    names : (h,) scalars
    by_unit : (h, f + 6 m) change of what is published per unit of each
    wanted : (h,) step that they would take together if they were free
    wanted_sigma : (h,) standard deviation of that step, cluster-robust where there are clusters
    """

    names: tuple[str, ...]
    by_unit: Floats
    wanted: Floats
    wanted_sigma: Floats


@value_class
class TimeClusters:
    """Clusters of time and what they are made of.

    Attributes
    ----------
    stretches : sums of short stretches of time, over what was estimated
    phases : sums of clusters of them, with two sets of borders
    scalars : (f + 6 m, q) free scalars and means of the biases by the columns of the sums
    clusters : in numbers
    """

    stretches: ClusterSums
    phases: tuple[ClusterSums, ...]
    scalars: Floats
    clusters: Clusters


@value_class
class TriadMisfit:
    """What a triad shows beside its model: fast motion smaller than it is, or another scale for negative readings.

    Attributes
    ----------
    imu, kind : number of the IMU; 0 for its gyroscope, 1 for its accelerometer
    axis : whose scale is asymmetric, x + size |x|; None where the triad is filtered, x + size x'' [s^2]
    size, sigma : of it
    moved : largest error by it of a parameter, in sigmas
    """

    imu: int
    kind: int
    axis: int | None
    size: float
    sigma: float
    moved: float


@value_class
class Uncertainty:
    """Covariance of what is published.

    Attributes
    ----------
    names : (f,) free scalars; after them stand the 6 m means of the biases
    covariance : (f + 6 m, f + 6 m), cluster-robust where there are clusters
    ordinary : (f + 6 m, f + 6 m) for independent errors
    bias_mean : (m, 6) means of the biases over the trajectory, gyroscope [rad/s] and accelerometer [m/s^2]
    held : by block name
    by_time : clusters of time from which the covariance comes; None for independent errors
    misfits : that are proved
    """

    names: tuple[str, ...]
    covariance: Floats
    ordinary: Floats
    bias_mean: Floats
    held: dict[str, FixedParameterEffect]
    by_time: "TimeClusters | None" = None
    misfits: tuple[TriadMisfit, ...] = ()


def solution_uncertainty(
    solution: Solution, held_blocks: tuple[str, ...], sums: ClusterSums | None = None
) -> Uncertainty:
    """Return the covariance at a solution.

    Parameters
    ----------
    solution : the estimate
    held_blocks : blocks to look at that were not estimated
    sums : of stretches of time, for the cluster-robust covariance; None for that of independent errors
    """
    step, layout = solution.step, solution.layout
    free, sides = layout.free_index, bias_sides(solution)
    schur_sides = step.factor.schur_sides[:, sides]
    gain = step.covariance @ schur_sides[free]  # (f, 6 m) covariance of parameters and means
    means = step.factor.inner(sides) + schur_sides[free].T @ gain
    held = {name: found for name in held_blocks if (found := _held(name, layout, step, schur_sides)) is not None}
    biases = solution.state.trajectory.controls[:, POSE:]
    ordinary = np.block([[step.covariance, gain], [gain.T, means]])
    found = Uncertainty(
        names=tuple(name for name, is_free in zip(layout.names, layout.free, strict=True) if is_free),
        covariance=ordinary,
        ordinary=ordinary,
        bias_mean=(mean_weights(solution.state.trajectory) @ biases).reshape(-1, BIAS),
        held=held,
    )
    return found if sums is None else _from_clusters(found, sums, solution, schur_sides)


def _from_clusters(found: Uncertainty, sums: ClusterSums, solution: Solution, schur_sides: Floats) -> Uncertainty:
    """Return the cluster-robust covariance of the same; too short a recording keeps that for independent errors."""
    if len(sums) < _FEWEST_STRETCHES:
        return found
    layout, shifts = solution.layout, board_follows(solution)
    free, means = layout.free_index, schur_sides.shape[1]
    columns = np.concatenate([free[free < layout.dense], layout.dense + np.arange(means)])
    own = sums.of_parameters(columns)
    many = free >= layout.dense  # the corners of a board, which follow the others
    kept = np.concatenate([np.flatnonzero(~many), len(free) + np.arange(means)])
    along = np.zeros((len(free) + means, len(columns)))
    along[kept] = np.eye(len(columns))
    along[: len(free)][many] = shifts[free[many] - layout.dense][:, columns]
    scalars = np.eye(len(free) + means)
    scalars[len(free) :, : len(free)] = schur_sides[free].T
    scalars = scalars @ along
    block = _block_numbers(found.names, means)[kept]
    lasts = correlation_time(leave_clusters_out(own) @ scalars[kept].T, block)
    phases, length = group_into_clusters(own, max(lasts, _LEAST_MEMORY))
    wider = robust_variances(phases, scalars[kept], block, many=True)
    stretch_s = float(np.median(np.diff(sums.t_s)))
    spread = scalars @ np.linalg.inv(scalars[kept])
    more = spread @ (wider.covariance - found.ordinary[np.ix_(kept, kept)]) @ spread.T
    return replace(
        found,
        covariance=found.ordinary + more,
        held=_held_by_clusters(found.held, sums, layout, columns, max(lasts, _LEAST_MEMORY)),
        by_time=TimeClusters(
            stretches=own,
            phases=tuple(phases),
            scalars=scalars,
            clusters=Clusters(count=wider.clusters, length_s=length * stretch_s, memory_s=lasts * stretch_s),
        ),
    )


def _held_by_clusters(
    held: dict[str, FixedParameterEffect], sums: ClusterSums, layout: BorderLayout, columns: Integers, memory: int
) -> dict[str, FixedParameterEffect]:
    """Return the same with the standard deviations that clusters of time tell of the steps that would be taken.

    They judge the model, but for that of a lens, which widens what is estimated (`with_detector_scale`).
    """
    place = {name: i for i, name in enumerate(layout.names)}
    found: dict[str, FixedParameterEffect] = {}
    for block, entry in held.items():
        index = np.array([place[name] for name in entry.names])
        found[block] = entry
        if (index < layout.dense).all() and (estimates_are_judged() or block.endswith(_LENS)):
            own = sums.of_parameters(np.concatenate([columns, index]))
            step, _ = whole_estimate(own)
            at_rest = replace(
                own, pull=own.pull - own.information @ step, prior_pull=own.prior_pull - own.prior_information @ step
            )
            phases, _ = group_into_clusters(at_rest, memory)
            scalars = np.eye(len(columns) + len(index))[len(columns) :]
            wider = robust_variances(phases, scalars, np.zeros(len(index), np.int64), many=True)
            found[block] = replace(entry, wanted_sigma=entry.wanted_sigma * np.sqrt(wider.factor))
    return found


def _block_numbers(names: tuple[str, ...], means: int) -> Integers:
    """Return the number of the block of each scalar; the means of the biases of each triad are one."""
    blocks = [name.partition("[")[0] for name in names] + [f"bias {i // TRIAD}" for i in range(means)]
    return np.unique(blocks, return_inverse=True)[1].astype(np.int64)


def _held(name: str, layout: BorderLayout, step: GaussNewtonStep, schur_sides: Floats) -> FixedParameterEffect | None:
    columns = layout.get(name)
    if columns is None:
        return None
    index = np.array([c for c in range(columns.start, columns.stop) if not layout.free[c]], dtype=np.int64)
    if not len(index):
        return None
    free = layout.free_index
    schur = step.factor.schur
    by_unit = -step.covariance @ schur[np.ix_(free, index)]  # (f, h)
    means_by_unit = schur_sides[index].T + schur_sides[free].T @ by_unit
    information = schur[np.ix_(index, index)] + schur[np.ix_(index, free)] @ by_unit
    right = step.factor.schur_sides[index, 0] + by_unit.T @ step.factor.schur_sides[free, 0]
    scale = 1 / np.sqrt(np.maximum(np.diag(information), 1e-300))
    covariance = np.linalg.inv(information * np.outer(scale, scale)) * np.outer(scale, scale)
    return FixedParameterEffect(
        names=tuple(layout.names[i] for i in index),
        by_unit=np.concatenate([by_unit, means_by_unit]).T,
        wanted=covariance @ right,
        wanted_sigma=np.sqrt(np.maximum(np.diag(covariance), 0.0)),
    )


def with_detector_scale(found: Uncertainty, parameters: RigParameters, sigmas: Mapping[str, float]) -> Uncertainty:
    """Return the uncertainty with that of a bias of the detectors, which feigns another focal length (Schmidt).

    The bias b is not estimated, only considered: what it moves is added. Where the lens is held, that is what its focal
    length would move; where it was estimated, what goes along with it, C e / (e' C e). Where corners ask for another
    focal length than one that is held, it may as well be that as a bias: b is as large then.

    Parameters
    ----------
    parameters : estimate
    sigmas : of each camera, by name, the standard deviation of b, relative to the focal length
    """
    covariance, ordinary = found.covariance, found.ordinary
    column = {name: i for i, name in enumerate(found.names)}
    for entry in parameters.cameras:
        sigma, lens = sigmas.get(entry.name, 0.0), entry.camera
        if not sigma:
            continue
        held = found.held.get(f"{entry.name}{_LENS}")
        sigma = sigma if held is None else max(sigma, _asked_focal(held, entry))
        scalars = [f"{entry.name}.intrinsics[{len(lens.intrinsics) - k}]" for k in (4, 3)]
        step = dict(zip(scalars, (sigma * lens.intrinsics[-4:-2]).tolist(), strict=True))
        along = np.zeros(len(covariance))
        for row, name in enumerate(() if held is None else held.names):
            if held is not None and name in step:
                along += step[name] * held.by_unit[row]
        free = [column[name] for name in scalars if name in column]
        if free:
            size = np.array([step[name] for name in scalars if name in column])
            along += found.ordinary[:, free] @ np.linalg.solve(found.ordinary[np.ix_(free, free)], size)
        covariance, ordinary = (matrix + np.outer(along, along) for matrix in (covariance, ordinary))
    return replace(found, covariance=covariance, ordinary=ordinary)


def _asked_focal(held: FixedParameterEffect, entry: CameraParameters) -> float:
    """Return by how much corners ask for another focal length than the one held, relative to it; 0 by chance."""
    focal = len(entry.camera.intrinsics) - 4
    wanted = [
        (abs(value) / entry.camera.intrinsics[k], abs(value) / sigma)
        for name, value, sigma in zip(held.names, held.wanted.tolist(), held.wanted_sigma.tolist(), strict=True)
        if (k := int(name.partition("[")[2][:-1])) in {focal, focal + 1}
    ]
    return max((size for size, sigmas in wanted if sigmas > _ASKED), default=0.0)


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
