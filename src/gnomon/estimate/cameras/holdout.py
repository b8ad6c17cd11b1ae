"""Views that an estimate has not seen, each with a pose of its own: how good lenses are where they were not fitted."""

from dataclasses import replace

import numpy as np

from ..camera_imu.terms.corner_sums import CornerNoise
from .first_rig import posed_rig
from .layout import SharedLayout
from .noise import HUBER, usual_sigma
from .normal import accumulate_normal_equations
from .poses import settle_poses
from .rig import CameraRig, RigViews, SeenCorners
from .views import camera_corners

_ROUGHLY = 5
"""Steps after which the scatter of most views is found; by this they are settled."""


def held_out_residuals(views: RigViews, rig: CameraRig) -> dict[str, SeenCorners]:
    """Return the residuals of views that get a pose of their own and nothing else.

    Parameters
    ----------
    views : of the same cameras and board
    rig : lenses, places of the cameras and shape of the board; the poses of its views are not looked at
    """
    return at_poses(views, posed_rig(views, rig.cameras, rig.T_cam_cam0, rig, steps=_ROUGHLY))


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
    return {
        seen.name: SeenCorners(
            view=seen.of_corner,
            frame=seen.exposures.frame[seen.exposures.of_corner],
            point=seen.point,
            pixels=seen.exposures.pixels,
            residual=sums.residual,
            weight=sums.weight,
            spread=np.ones(len(seen.point)),
        )
        for seen, sums in zip(corners, at.sums, strict=True)
    }


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
