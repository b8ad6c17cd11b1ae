"""Poses of views at lenses that are held: where estimates start from, and what hold-out tests rest on."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from ...models.camera import Camera
from ...models.target import Target
from ...recording import Floats
from ..camera_imu.start.board_poses import homography_poses, thin_exposures
from ..camera_imu.terms.corner_sums import CornerNoise
from .layout import SharedLayout
from .noise import usual_sigma
from .normal import ViewNormalEquations, accumulate_normal_equations, inverse_poses
from .rig import CameraRig
from .views import CameraCorners

MOST_STEPS = 12
_AT_REST = 1e-8  # of the cost, of all views or of one
_FEWER = 0.75  # of the views that are moved, from which on the others are not looked at any more
_WEIGHED = (1, 3)  # steps before which the scatter is found anew
_HUBER = 2.0
_MOST_TURN = 0.5  # rad in one step


def first_poses(seen: CameraCorners, camera: Camera) -> tuple[Floats, Floats]:
    """Return the pose of the board in a camera in each of its exposures by homographies, (e, 3, 3) and (e, 3)."""
    if not len(seen):
        return np.empty((0, 3, 3)), np.empty((0, 3))
    return homography_poses(thin_exposures(seen.exposures), camera)


def settle_poses(
    corners: Sequence[CameraCorners],
    target: Target,
    rig: CameraRig,
    *,
    steps: int = MOST_STEPS,
    noise: Mapping[str, CornerNoise] | None = None,
) -> tuple[CameraRig, Floats]:
    """Return the rig with each view's pose where its own robust cost is least, and that cost (v,).

    Each view is damped alone, and left where it came to rest. Without `noise` the corners' scatter about the poses is
    found on the way.
    """
    layout = SharedLayout.poses_only(rig.cameras)
    weights = noise or {name: CornerNoise(sigma_px=1.0, huber=np.inf) for name in rig.cameras}
    at = accumulate_normal_equations(corners, target, rig, layout, weights)
    pose, gradient, cost = at.pose, at.pose_gradient, at.cost
    damping, active = np.full(len(cost), 1e-6), np.ones(len(cost), dtype=bool)
    for step in range(steps):
        if noise is None and step in _WEIGHED:
            weights = _weights(corners, at)
            at = accumulate_normal_equations(corners, target, rig, layout, weights)
            pose, gradient, cost = at.pose, at.pose_gradient, at.cost
        moves = -np.einsum("vij,vj->vi", inverse_poses(pose, damping), gradient)
        turn = np.linalg.norm(moves[:, :3], axis=1, keepdims=True)
        moves *= np.minimum(1.0, _MOST_TURN / np.maximum(turn, 1e-300))
        trial = layout.moved(rig, moves, np.empty(0))
        at = accumulate_normal_equations(corners, target, trial, layout, weights)
        better = active & (at.cost <= cost * (1 + 1e-12))
        gained = np.where(better, cost - at.cost, 0.0)
        one, two = better[:, None], better[:, None, None]
        rig = replace(
            rig,
            R_cam0_target=np.where(two, trial.R_cam0_target, rig.R_cam0_target),
            p_cam0_target=np.where(one, trial.p_cam0_target, rig.p_cam0_target),
        )
        pose, gradient = np.where(two, at.pose, pose), np.where(one, at.pose_gradient, gradient)
        cost = np.where(better, at.cost, cost)
        damping = np.where(better, np.maximum(0.1 * damping, 1e-9), np.maximum(10 * damping, 1e-3))
        if step <= max(_WEIGHED):
            continue
        moving = active & ~(better & (gained <= _AT_REST * cost))
        if gained.sum() <= _AT_REST * cost.sum():
            break
        if moving.sum() < _FEWER * active.sum():
            active, corners = moving, [seen.only(moving[seen.view]) for seen in corners]
    return rig, cost


def _weights(corners: Sequence[CameraCorners], at: ViewNormalEquations) -> dict[str, CornerNoise]:
    return {
        seen.name: CornerNoise(sigma_px=usual_sigma(sums), huber=_HUBER)
        for seen, sums in zip(corners, at.sums, strict=True)
    }
