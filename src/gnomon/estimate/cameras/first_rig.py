"""A rig that is about right, from nothing but the views: lenses, then poses, then the cameras to each other."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from ...errors import InitialisationError
from ...models.camera import Camera
from ...recording import Floats, Integers
from ..camera_imu.terms.visual_terms import CornerNoise
from .first_lens import MOST_STEPS, first_lens, first_poses, settle_poses
from .layout import SharedLayout, stated_shape
from .normal import HUBER, accumulate_normal_equations, usual_sigma
from .rig import CameraRig, RigViews, SeenCorners, camera_corners, renumber_camera, view_corners

_FEWEST_SHARED = 3
_NEAR_ROTATION = np.radians(5.0)
_NEAR_SHARE = 0.05  # of the distance of the board
_CANDIDATES = 60
_ENOUGH = 120  # shared views that tell where a camera is to another, before anything is estimated
_ROUGHLY = 5
"""Steps after which the scatter of most views is found; by this they are settled."""


def first_rig(views: RigViews, models: Mapping[str, str], lenses: Mapping[str, Camera] | None = None) -> CameraRig:
    """Return lenses, poses of the cameras to each other and poses of all views, with no guess of anything.

    Parameters
    ----------
    views : of the board
    models : "cam0", ... -> lens model, such as "pinhole-radtan"
    lenses : "cam0", ... -> lens, where they are known already

    Raises
    ------
    InitialisationError
        If a camera saw the board too seldom, no lens explains what it saw, or cameras share no views.
    OptionError
        If there is no such model.
    """
    cameras = dict(lenses) if lenses is not None else first_lenses(views, models)
    return posed_rig(views, cameras, cameras_apart(views, cameras))


def first_lenses(views: RigViews, models: Mapping[str, str]) -> dict[str, Camera]:
    """Return a lens of each camera; see `first_rig`."""
    return {name: first_lens(views, number, models[name]) for number, name in enumerate(views.cameras)}


def posed_rig(
    views: RigViews,
    cameras: Mapping[str, Camera],
    T_cam_cam0: Floats,
    board: CameraRig | None = None,
    *,
    steps: int = MOST_STEPS,
) -> CameraRig:
    """Return a rig with the pose of every view, found anew.

    Parameters
    ----------
    views : of the board
    cameras : "cam0", ... -> lens
    T_cam_cam0 : (c, 4, 4)
    board : a rig whose shape of the board is taken; as stated where there is none
    steps : of each view, at most
    """
    corners = camera_corners(views)
    R, p = np.broadcast_to(np.eye(3), (len(views), 3, 3)).copy(), np.zeros((len(views), 3))
    most = np.zeros(len(views), np.int64)
    for seen in corners:
        if not len(seen):
            continue
        R_cam, p_cam = first_poses(seen, cameras[seen.name])
        T = T_cam_cam0[seen.camera]
        better = np.diff(seen.exposures.start) > most[seen.view]
        at = seen.view[better]
        R[at] = T[:3, :3].T @ R_cam[better]
        p[at] = (p_cam[better] - T[:3, 3]) @ T[:3, :3]
        most[at] = np.diff(seen.exposures.start)[better]
    rig = CameraRig(
        cameras=cameras,
        T_cam_cam0=T_cam_cam0,
        R_cam0_target=R,
        p_cam0_target=p,
        board=stated_shape(views.target) if board is None else board.board,
    )
    return settle_poses(corners, views.target, rig, steps=steps)[0]


def cameras_apart(views: RigViews, cameras: Mapping[str, Camera]) -> Floats:
    """Return T_cam_cam0 (c, 4, 4) from the views that cameras share, along the pairs that share most.

    Raises
    ------
    InitialisationError
        If a camera shares too few views with the others.
    """
    T = np.tile(np.eye(4), (len(cameras), 1, 1))
    if len(cameras) == 1:
        return T
    pairs = _pairs(views)
    some = [_shared(views, *pair) for pair in pairs]
    views = views.where(np.unique(np.concatenate([one[:: max(len(one) // _ENOUGH, 1)] for one in some])))
    poses = [_poses(views, number, cameras) for number in range(len(cameras))]
    for known, new in pairs:
        shared = _shared(views, known, new)
        T[new] = _usual(poses[new][shared] @ np.linalg.inv(poses[known][shared])) @ T[known]
    return T


def number_views_alike(views: RigViews, cameras: Mapping[str, Camera], numberings: Integers) -> RigViews:
    """Return the views with boards that look the same from several ends numbered from one end by all cameras.

    A camera alone may count each view from another end: what it tells of its lens is the same. Views that cameras
    share tell the ends apart by the poses of the cameras to each other, which stay the same.

    Parameters
    ----------
    views : of the board
    cameras : "cam0", ... -> lens
    numberings : (k, n) the number of each of the board's points in each way of counting, first the present one

    Raises
    ------
    InitialisationError
        If a camera shares too few views with the others.
    """
    if len(cameras) == 1 or len(numberings) == 1:
        return views
    turns = np.array([_isometry(views.target.points, numbering) for numbering in numberings])
    for known, new in _pairs(views):
        first, second = (_poses(views, number, cameras) for number in (known, new))
        shared = _shared(views, known, new)
        # (k, s, 4, 4): the pose of one camera to the other if the view were counted in each of the ways
        apart = (second[shared] @ np.linalg.inv(turns)[:, None]) @ np.linalg.inv(first[shared])
        usual = _usual(apart.reshape(-1, 4, 4))
        way = np.zeros(len(views), np.int64)
        way[shared] = np.argmin([[_distance(usual, one) for one in of_way] for of_way in apart], axis=0)
        views = renumber_camera(views, new, way, numberings)
    return views


def _poses(views: RigViews, number: int, cameras: Mapping[str, Camera]) -> Floats:
    """Return T_cam_target (v, 4, 4) of one camera; the identity where it did not see the board."""
    seen = view_corners(views, number)
    alone = replace(seen, camera=0, view=np.arange(len(seen)))
    R, p = first_poses(seen, cameras[seen.name])
    rig = CameraRig(
        cameras={seen.name: cameras[seen.name]},
        T_cam_cam0=np.eye(4)[None],
        R_cam0_target=R,
        p_cam0_target=p,
        board=stated_shape(views.target),
    )
    rig = settle_poses((alone,), views.target, rig)[0] if len(seen) else rig
    T = np.tile(np.eye(4), (len(views), 1, 1))
    T[seen.view, :3, :3], T[seen.view, :3, 3] = rig.R_cam0_target, rig.p_cam0_target
    return T


def _shared(views: RigViews, first: int, second: int) -> Integers:
    return np.flatnonzero((views.frame[:, first] >= 0) & (views.frame[:, second] >= 0))


def _pairs(views: RigViews) -> list[tuple[int, int]]:
    """Return pairs (known camera, new camera), from cam0 on, always the two that share most views."""
    names, known = tuple(views.cameras), [0]
    pairs: list[tuple[int, int]] = []
    while len(known) < len(names):
        others = [number for number in range(len(names)) if number not in known]
        count, a, b = max((len(_shared(views, a, b)), a, b) for a in known for b in others)
        if count < _FEWEST_SHARED:
            lost, held = (" and ".join(names[k] for k in group) for group in (others, known))
            raise InitialisationError(
                f"{lost}: {'no' if count == 0 else f'only {count}'} views of the board at one instant with {held}, of "
                f"{len(views)}; at least {_FEWEST_SHARED} are needed to tell where the cameras are to each other. Show "
                "the board where the images overlap, check that the cameras have one clock, or calibrate each alone."
            )
        pairs.append((a, b))
        known.append(b)
    return pairs


def _usual(apart: Floats) -> Floats:
    """Return the pose (4, 4) that most of some (n, 4, 4) are near to, averaged over these."""
    candidates = apart[:: max(len(apart) // _CANDIDATES, 1)]
    distance = np.array([_distances(one, apart) for one in candidates])
    near = distance < 1.0
    best = int(np.argmax(near.sum(axis=1) - 1e-3 * np.minimum(distance, 1.0).mean(axis=1)))
    chosen = apart[near[best]]
    left, _, right = np.linalg.svd(chosen[:, :3, :3].mean(axis=0))
    found = np.eye(4)
    found[:3, :3] = left @ np.diag([1.0, 1.0, np.linalg.det(left @ right)]) @ right
    found[:3, 3] = np.median(chosen[:, :3, 3], axis=0)
    return found


def _distances(one: Floats, others: Floats) -> Floats:
    """Return how far poses (n, 4, 4) are from one, in units of what is near."""
    cosine = 0.5 * (np.einsum("ij,nij->n", one[:3, :3], others[:, :3, :3]) - 1)
    angle = np.arccos(np.clip(cosine, -1, 1))
    shift = np.linalg.norm(others[:, :3, 3] - one[:3, 3], axis=1)
    return np.hypot(angle / _NEAR_ROTATION, shift / max(_NEAR_SHARE, float(np.linalg.norm(one[:3, 3])) * 0.2))


def _distance(one: Floats, other: Floats) -> float:
    return float(_distances(one, other[None])[0])


def _isometry(points: Floats, numbering: Integers) -> Floats:
    """Return the motion (4, 4) of the board that brings each point to where the one with its new number is."""
    before, after = points, points[numbering]
    a, b = before - before.mean(axis=0), after - after.mean(axis=0)
    # Points in a plane: the third axis is that of a turn about the normal.
    left, _, right = np.linalg.svd(a[:, :2].T @ b[:, :2])
    found = np.eye(4)
    found[:2, :2] = right.T @ left.T
    found[2, 2] = np.linalg.det(found[:2, :2])
    found[:3, 3] = after.mean(axis=0) - found[:3, :3] @ before.mean(axis=0)
    return found


def held_out_residuals(views: RigViews, rig: CameraRig, near: CameraRig | None = None) -> dict[str, SeenCorners]:
    """Return the residuals of views that get a pose of their own and nothing else.

    Parameters
    ----------
    views : of the same cameras and board
    rig : lenses, places of the cameras and shape of the board; the poses of its views are not looked at
    near : a rig that has about the poses of these views; they are found anew where there is none
    """
    if near is None:
        return at_poses(views, posed_rig(views, rig.cameras, rig.T_cam_cam0, rig, steps=_ROUGHLY))
    begun = replace(rig, R_cam0_target=near.R_cam0_target, p_cam0_target=near.p_cam0_target)
    return at_poses(views, settle_poses(camera_corners(views), views.target, begun, steps=_ROUGHLY)[0])


def at_poses(views: RigViews, rig: CameraRig) -> dict[str, SeenCorners]:
    """Return the residuals of views at a rig that holds their poses, each moved to its robust minimum."""
    corners = camera_corners(views)
    plain = {name: CornerNoise(sigma_px=1.0, huber=np.inf) for name in rig.cameras}
    layout = SharedLayout.poses_only(rig.cameras)
    at = accumulate_normal_equations(corners, views.target, rig, layout, plain)
    noise = {
        seen.name: CornerNoise(sigma_px=usual_sigma(sums), huber=HUBER)
        for seen, sums in zip(corners, at.sums, strict=True)
    }
    rig, _ = settle_poses(corners, views.target, rig, noise=noise)
    at = accumulate_normal_equations(corners, views.target, rig, layout, noise)
    return {seen.name: seen.with_residuals(sums, 1.0) for seen, sums in zip(corners, at.sums, strict=True)}


def merge_corners(parts: list[SeenCorners]) -> SeenCorners:
    """Return the corners of several sets of views as one, the views counted on."""
    views = np.cumsum([0, *(int(part.view.max(initial=-1)) + 1 for part in parts[:-1])])
    shifted = [replace(part, view=part.view + first) for part, first in zip(parts, views, strict=True)]
    return SeenCorners(
        **{
            name: np.concatenate([getattr(part, name) for part in shifted])
            for name in ("view", "frame", "point", "pixels", "residual", "weight", "spread")
        }
    )
