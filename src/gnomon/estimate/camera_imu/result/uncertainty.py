"""The covariance of everything that a calibration publishes, and what held parameters would have done.

Beside the free parameters theta, the means of the biases over the recording are published, m = L x. Solving the normal
equations with L as further right-hand sides gives their covariance and that with theta. A parameter c that was held at
a value of its own uncertainty (gravity) adds (d theta / d c) sigma_c; one that was held without need (the size of the
board, the intrinsics) is tested by the step that it would take if it were free.

The equations count all errors as independent. What a recording really shows, clusters of time tell (`cluster_sums`).
"""

from collections.abc import Mapping
from dataclasses import replace

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
from ..batch import mean_weights
from ..gauss_newton import GaussNewtonStep
from ..layout import BorderLayout
from ..parameters import CameraParameters, RigParameters
from ..solution import Solution
from ..terms.assembly import TRIAD
from ..trajectory import BIAS, POSE
from .cluster_sums import bias_sides, board_follows
from .residual_patterns import LAST_TERM, counting_corners, missing_term

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


def with_next_term(found: Uncertainty, solution: Solution) -> Uncertainty:
    """Return the uncertainty with that of the radial term that estimated lenses of radtan or radtan5 lack (Schmidt).

    The coefficients of a series that is cut off depend on where in the image the corners were seen, and no clusters of
    one recording show that. Where corners ask for the term that follows, they are as uncertain as it moves them. What
    the lens does where the corners are hardly changes, and nothing else does.
    """
    column = {name: i for i, name in enumerate(found.names)}
    free = any(name.endswith(".distortion_coeffs[0]") for name in column)
    covariance = found.covariance
    for entry, seen in zip(solution.state.parameters.cameras, counting_corners(solution) if free else (), strict=free):
        lens = [column.get(f"{entry.name}.{name}") for name in entry.camera.parameter_names]
        columns = [place for place in lens if place is not None]
        if entry.camera.distortion in LAST_TERM and len(columns) == len(lens):
            along = np.zeros(len(covariance))
            along[columns] = missing_term(entry.camera, seen)
            covariance = covariance + np.outer(along, along)
    return replace(found, covariance=covariance)


def _asked_focal(held: FixedParameterEffect, entry: CameraParameters) -> float:
    """Return by how much corners ask for another focal length than the one held, relative to it; 0 by chance."""
    focal = len(entry.camera.intrinsics) - 4
    wanted = [
        (abs(value) / entry.camera.intrinsics[k], abs(value) / sigma)
        for name, value, sigma in zip(held.names, held.wanted.tolist(), held.wanted_sigma.tolist(), strict=True)
        if (k := int(name.partition("[")[2][:-1])) in {focal, focal + 1}
    ]
    return max((size for size, sigmas in wanted if sigmas > _ASKED), default=0.0)


_GRAVITY = "gravity.magnitude"


def with_uncertain_gravity(found: Uncertainty, gravity_sigma: float, *, ordinary: bool = False) -> Floats:
    """Return the covariance, or that for independent errors, with the uncertainty of held gravity added."""
    covariance = found.ordinary if ordinary else found.covariance
    if _GRAVITY not in found.held or not np.isfinite(gravity_sigma):
        return covariance
    influence = found.held[_GRAVITY].by_unit[0]
    return covariance + np.outer(influence, influence) * gravity_sigma**2
