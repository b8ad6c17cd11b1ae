"""Views that an estimate has not seen, each with a pose of its own: how good the lenses are where they were not fitted.

Models are compared on the same corners: one that is far off by all of them is a wrong detection and counts for none,
every other counts in full, also where it is the lens that fails.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from ...recording import Floats
from ..camera_imu.terms.corner_sums import CornerNoise
from .first_rig import posed_rig
from .layout import SharedLayout
from .noise import HUBER, usual_sigma
from .normal import accumulate_normal_equations
from .poses import settle_poses
from .rig import CameraRig, RigViews, SeenCorners
from .views import camera_corners

_OUTLIER = 6.0  # sigmas of a corner's distance, by the best model
_STEPS = 12


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class HeldOutCorners:
    """The corners of one camera in views that were held out.

    Attributes
    ----------
    rms_px : per axis, wrong corners apart [px]; nan without corners
    outliers : share of corners that are wrong by every model that was compared
    lost : share of the other corners that the lens cannot image; each counts as far as the worst of the others
    squares : (v,) sum of squared distances in each view [px^2]
    corners : (v,) how many they are
    """

    rms_px: float
    outliers: float
    lost: float
    squares: Floats
    corners: Floats


def held_out_residuals(views: RigViews, rig: CameraRig) -> dict[str, SeenCorners]:
    """Return the residuals of views that get a pose of their own and nothing else.

    Parameters
    ----------
    views : of the same cameras and board
    rig : lenses, places of the cameras and shape of the board; the poses of its views are not looked at
    """
    return at_poses(views, posed_rig(views, rig.cameras, rig.T_cam_cam0, rig))


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
    rig, _ = settle_poses(corners, views.target, rig, steps=_STEPS, noise=noise)
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


def held_out_rms(trials: Mapping[str, SeenCorners]) -> dict[str, HeldOutCorners]:
    """Return how far the corners of one camera are from what several models foresee, on the same corners.

    Parameters
    ----------
    trials : model -> residuals of the same corners
    """
    distances = {model: np.linalg.norm(seen.residual, axis=1) for model, seen in trials.items()}
    finite = {model: np.where(np.isfinite(d), d, np.inf) for model, d in distances.items()}
    if not finite:
        return {}
    least = np.min(list(finite.values()), axis=0)
    sigma = min((float(np.median(d)) for d in finite.values() if len(d)), default=0.0) / np.sqrt(2 * np.log(2))
    wrong = least > _OUTLIER * max(sigma, 1e-9)
    return {model: _held_out(trials[model], finite[model], wrong) for model in trials}


def _held_out(seen: SeenCorners, distance: Floats, wrong: np.ndarray) -> HeldOutCorners:
    lost = ~np.isfinite(distance) & ~wrong
    counted = ~wrong
    worst = float(distance[counted & ~lost].max(initial=0.0))
    squares = np.where(lost, worst, np.where(counted, distance, 0.0)) ** 2
    views = int(seen.view.max(initial=-1)) + 1
    count = int(counted.sum())
    return HeldOutCorners(
        rms_px=float(np.sqrt(squares.sum() / (2 * count))) if count else float("nan"),
        outliers=float(wrong.mean()) if len(wrong) else 0.0,
        lost=float(lost.sum() / count) if count else 0.0,
        squares=np.bincount(seen.view, squares, views).astype(np.float64),
        corners=np.bincount(seen.view, counted, views).astype(np.float64),
    )


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
