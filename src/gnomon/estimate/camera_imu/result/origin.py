"""The points of the IMUs to which their poses refer: those where a model with one place for each IMU finds itself.

With other lever arms a, held in the model, the rest of the estimate would go K da, K = -C_nn^-1 C_na of the normal
equations, whatever is known of the arms beforehand (`models.origin`). The point whose translation does not move with
them is p*. It is known when everything is estimated: until then the origin is that which the options ask for, or the
mean of `EVEN_WEIGHTS`.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ....frozen import value_class
from ....geometry.rotation_vector import skew
from ....models.frames import EVEN_WEIGHTS, Origin
from ....recording import Floats
from ..layout import BorderLayout
from ..parameters import ImuParameters, RigParameters
from ..solution import Solution
from ..start.initial_trajectory import fitted_splines
from ..trajectory import POSE, Bases, Trajectory
from .uncertainty import Uncertainty

_PER_SPAN = 3
"""Instants in each span of the splines by which they follow the origin."""


@value_class
class _Shift:
    """How far an origin moves (3,) [m], IMU's axes, and its derivative (3, 6) by the lever arms."""

    by: Floats
    by_arms: Floats

    @classmethod
    def between(cls, imu: ImuParameters, origin: Origin) -> "_Shift":
        """Return that from the present origin of an IMU to another one."""
        weights = origin.combination[0]
        return cls(by=origin.of(imu.places), by_arms=np.hstack(list(weights)) @ imu.places_by_arms.reshape(9, 6))


def single_place_origins(solution: Solution) -> list[Origin]:
    """Return p* of each IMU, where the translations do not move with its lever arms.

    Of the body's, that is the mean over the cameras, weighed by how well each is known. Where a translation is not
    known, but for its weak prior, p* has the `EVEN_WEIGHTS`.
    """
    layout, parameters = solution.layout, solution.state.parameters
    even = Origin(point="optimal")
    origins: list[Origin] = []
    for i, imu in enumerate(parameters.imus):
        by_arms, covariance = _by_arms(solution, i)
        own = _Shift.between(imu, even)
        if i:
            step = (
                _beside_the_body(layout, imu, i, by_arms, _Shift.between(parameters.imus[0], origins[0])) - own.by_arms
            )
        else:
            step = -_mean_over_cameras(layout, parameters, by_arms, covariance, own)
        shares = np.stack([-step[:, :3] - step[:, 3:], step[:, :3], step[:, 3:]])
        origins.append(Origin(point="optimal", weights=EVEN_WEIGHTS + shares))
    return origins


def _by_arms(solution: Solution, imu: int) -> tuple[Floats, Floats]:
    """Return how the estimate follows the lever arms of an IMU, (p, 6), and its covariance (p, p) with these held."""
    layout, schur = solution.layout, solution.step.factor.schur
    arms = layout.columns[f"imu{imu}.lever_arms"]
    kept = np.setdiff1d(layout.free_index, np.arange(arms.start, arms.stop))
    scale = 1 / np.sqrt(np.maximum(np.diag(schur)[kept], 1e-300))
    inverse = np.linalg.inv(schur[np.ix_(kept, kept)] * np.outer(scale, scale)) * np.outer(scale, scale)
    covariance, by_arms = np.zeros_like(schur), np.zeros((len(schur), 6))
    covariance[np.ix_(kept, kept)] = inverse
    by_arms[kept] = -inverse @ schur[kept, arms]
    return by_arms, covariance


def _beside_the_body(layout: BorderLayout, imu: ImuParameters, number: int, by_arms: Floats, body: _Shift) -> Floats:
    """Return how the place of an IMU beside the first, whose origin is at p*, goes with its arms, (3, 6), its axes."""
    columns, turn, arms = (
        layout.get(name)
        for name in (f"imu{number}.T_imu_body.translation", f"imu{number}.T_imu_body.rotation", "imu0.lever_arms")
    )
    place, turned, moved = (
        np.zeros((size, 6)) if at is None else by_arms[at] for at, size in ((columns, 3), (turn, 3), (arms, 6))
    )
    return place + imu.R_imu_body @ (body.by_arms @ moved - skew(body.by) @ turned)


def _mean_over_cameras(
    layout: BorderLayout, parameters: RigParameters, by_arms: Floats, covariance: Floats, own: _Shift
) -> Floats:
    """Return how the origin goes with the arms of the body as the cameras see it, (3, 6), the body's axes."""
    total, right = np.zeros((3, 3)), np.zeros((3, 6))
    for entry in parameters.cameras:
        columns, turn = (layout.get(f"{entry.name}.T_cam_imu.{part}") for part in ("translation", "rotation"))
        if columns is None or not np.diag(covariance)[columns].all():
            continue
        R = entry.R_cam_imu
        turned = by_arms[turn] if turn is not None else np.zeros((3, 6))
        precision = R.T @ np.linalg.inv(covariance[columns, columns]) @ R
        total += precision
        right += precision @ (R.T @ by_arms[columns] + own.by_arms - skew(own.by) @ turned)
    return np.linalg.inv(total) @ right if total.any() else right


def moved_to_origins(solution: Solution, found: Uncertainty, origins: Sequence[Origin]) -> tuple[Solution, Uncertainty]:
    """Return the same estimate with the origins of the IMUs at other points, trajectory and uncertainty too.

    As `parameters.moved_to_origin` does with what is published. Residuals stay as they are, but for the gyroscope's
    g-sensitivity, which acts on the specific force at the origin: some 1e-6 rad/s.
    """
    parameters = solution.state.parameters
    shifts = [_Shift.between(imu, origin) for imu, origin in zip(parameters.imus, origins, strict=True)]
    jacobian, body = np.eye(len(found.covariance)), shifts[0]
    place = {name: k for k, name in enumerate(found.names)}

    def follow(path: str, rotation: Floats, shift: _Shift, imu: int) -> None:
        """Fill in that the translation of a pose goes with a shift of the origin of an IMU, turned by a rotation."""
        rows = [place.get(f"{path}.translation[{k}]") for k in range(3)]
        arms = [(f"imu{imu}.lever_arms[{k}]", rotation @ shift.by_arms[:, k]) for k in range(6)]
        turns = [(f"{path}.rotation[{k}]", -rotation @ skew(shift.by)[:, k]) for k in range(3)] if imu == 0 else []
        for name, column in (*arms, *turns):
            for row, value in zip(rows, column.tolist(), strict=True):
                if row is not None and name in place:
                    jacobian[row, place[name]] += value

    cameras, imus = list(parameters.cameras), list(parameters.imus)
    for i, entry in enumerate(cameras):
        follow(f"{entry.name}.T_cam_imu", entry.R_cam_imu, body, 0)
        cameras[i] = replace(entry, p_cam_imu=entry.p_cam_imu + entry.R_cam_imu @ body.by)
    for i, (imu, origin) in enumerate(zip(imus, origins, strict=True)):
        imus[i] = replace(imu, origin=origin)
        if i:
            follow(f"imu{i}.T_imu_body", imu.R_imu_body, body, 0)
            follow(f"imu{i}.T_imu_body", -np.eye(3), shifts[i], i)
            imus[i] = replace(imus[i], p_imu_body=imu.p_imu_body + imu.R_imu_body @ body.by - shifts[i].by)
    state = replace(
        solution.state,
        parameters=replace(parameters, imus=tuple(imus), cameras=tuple(cameras)),
        trajectory=_moved_trajectory(solution.state.trajectory, body.by),
    )
    by_time = found.by_time
    return replace(solution, state=state), replace(
        found,
        covariance=jacobian @ found.covariance @ jacobian.T,
        ordinary=jacobian @ found.ordinary @ jacobian.T,
        held={name: replace(one, by_unit=one.by_unit @ jacobian.T) for name, one in found.held.items()},
        by_time=None if by_time is None else replace(by_time, scalars=jacobian @ by_time.scalars),
    )


def _moved_trajectory(trajectory: Trajectory, shift: Floats) -> Trajectory:
    """Return the trajectory of the point that lies at a shift (3,) [m], body's axes."""
    grid, controls = trajectory.grid, trajectory.controls.copy()
    if not shift.any():
        return trajectory
    for segment in grid.segments:
        position = (np.arange(_PER_SPAN * segment.spans) + 0.5) / _PER_SPAN
        places = grid.places(segment.start_s + grid.spacing_s * position)
        moved = trajectory.motion(places, Bases.at(places, grid)).R @ shift
        rows = slice(segment.first, segment.first + segment.spans + grid.order - 1)
        controls[rows, 3:POSE] += fitted_splines(position, moved, segment.spans, grid.order)
    return replace(trajectory, controls=controls)
