"""What is estimated from views of a board, and what it is estimated from.

    pixel = lens_c( T_cam_cam0 (R_cam0_target s(p) + p_cam0_target) ) + noise,    s(p): where point p truly is

Each view, an instant at which one camera or several saw the board, has a pose of its own; the lenses, the poses of the
cameras to the first one and the shape of the board are shared by all views.
"""

from collections.abc import Mapping
from dataclasses import field

import numpy as np

from ...frozen import value_class
from ...models.camera import Camera
from ...models.target import Target
from ...recording import CameraFrames, Floats, Integers
from ...results.camera_diagnostics import SolverStep
from ..trust.clusters import ClusterSums


@value_class
class RigViews:
    """The corners of all cameras, gathered by the instant at which they were seen.

    Attributes
    ----------
    target : the board
    cameras : "cam0", ... -> its frames, all of them; the lens in them stands for resolution and topic alone
    t_ns : (v,) timestamp of each view [ns], ascending
    frame : (v, c) which frame of each camera it is; negative where the camera has none that can be used
    """

    target: Target
    cameras: Mapping[str, CameraFrames]
    t_ns: Integers
    frame: Integers

    def __len__(self) -> int:
        return len(self.t_ns)

    def where(self, kept: np.ndarray) -> "RigViews":
        """Return some of the views, (v,) bool or indices in ascending order."""
        return RigViews(target=self.target, cameras=self.cameras, t_ns=self.t_ns[kept], frame=self.frame[kept])


@value_class
class BoardShape:
    """How the board differs from what was stated.

    Attributes
    ----------
    aspect : scale along y over that along x, minus 1
    bow_m : (2,) how far the middle bulges towards the viewer against the ends of the board's middle line along x, and
        along y [m]
    offsets : (k, 3) from the nominal place of each point to where it is, beside aspect and bow [m]
    """

    aspect: float
    bow_m: Floats
    offsets: Floats


@value_class
class CameraRig:
    """Everything that the views depend on.

    Attributes
    ----------
    cameras : "cam0", ... -> lens
    T_cam_cam0 : (c, 4, 4) from cam0's coordinates to each camera's [m]; that of cam0 is I
    R_cam0_target, p_cam0_target : (v, 3, 3) and (v, 3) pose of the board in cam0's frame in each view [m]
    board : its shape
    """

    cameras: Mapping[str, Camera]
    T_cam_cam0: Floats
    R_cam0_target: Floats
    p_cam0_target: Floats
    board: BoardShape


@value_class
class SeenCorners:
    """The corners of one camera at a rig.

    Attributes
    ----------
    view : (m,) view of each corner
    frame, point : (m,) its frame in the recording, and its number on the board
    pixels : (m, 2) as detected [px]
    residual : (m, 2) predicted minus detected [px]; nan where the lens has no image of it
    weight : (m,) robust weight, 0 to 1
    spread : (m,) standard deviation of each corner over that of a usual one
    """

    view: Integers
    frame: Integers
    point: Integers
    pixels: Floats
    residual: Floats
    weight: Floats
    spread: Floats


@value_class
class RigSolution:
    """The minimum, and how certain it is.

    Attributes
    ----------
    views : what it was estimated from
    rig : the estimate
    names : (p,) shared scalars that were estimated, the poses of the views apart: "cam0.intrinsics[0]",
        "cam0.distortion_coeffs[0]", "cam1.T_cam_cam0.rotation[0]" (small rotation on the right), "cam1.T_cam_cam0.
        translation[0]", "target.aspect", "target.bow[0]", "target.offsets[0,0]"
    sums : pull and information of each view at the estimate, its pose eliminated: by them follow the covariance that
        holds where the errors of a view are correlated, halves, and smaller models
    ordinary : (p, p) covariance for independent errors
    corners : "cam0", ... -> residuals
    sigma_px : "cam0", ... -> standard deviation of a corner per axis, from the residuals
    steps : iterations
    converged : whether they came to rest
    """

    views: RigViews
    rig: CameraRig
    names: tuple[str, ...]
    sums: ClusterSums
    ordinary: Floats
    corners: Mapping[str, SeenCorners]
    sigma_px: Mapping[str, float]
    steps: tuple[SolverStep, ...] = field(default=())
    converged: bool = True
